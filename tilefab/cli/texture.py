"""``tilefab texture``: textures judged against their exemplars, and their maps applied to further layers."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli import synth
from tilefab.cli.common import JsonOption, ThreadsOption, print_json
from tilefab.cli.progress import NOTE_STYLE, Bars
from tilefab.pipeline.scoring import Gate, Score, score_texture

FAILED = 1

app = typer.Typer(help="Textures grown from an exemplar: judge one, apply its map.", no_args_is_help=True)
app.command("apply")(synth.apply)

_MEASURES = (
    ("Portilla-Simoncelli", "portilla_simoncelli", "joint statistics of detail at all scales, relative"),
    ("power spectrum", "radial_psd", "contrast at each scale, natural logarithms"),
    ("bidirectional", "bidirectional_de76", "motifs missing or made up, CIE76, at a quarter of the scale"),
    ("gradients", "gradient", "strength of edges, relative"),
)


@app.command("score")
def score(
    texture: Annotated[Path, typer.Argument(metavar="OUT", help="Image of the texture.")],
    exemplar: Annotated[Path, typer.Argument(metavar="EXEMPLAR", help="Image that it was grown from.")],
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map", metavar="FILE.npz", help="Map of places that was kept; without it one is found by looking."
        ),
    ] = None,
    strict: Annotated[bool, typer.Option("--strict", help=f"End with {FAILED} if a gate isn't passed.")] = False,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how near a texture is to its exemplar, and whether it repeats, is blurred or shows its seams."""
    with Bars() as bars:
        scored = score_texture(texture, exemplar, bars, map_file, threads or 1)
    if as_json:
        print_json({**dataclasses.asdict(scored), "passed": scored.passed})
    else:
        _show(scored)
    if strict and not scored.passed:
        raise typer.Exit(FAILED)


def _show(scored: Score) -> None:
    console = Console()
    measures = Table(title=Text(f"{scored.texture} against {scored.exemplar}"), show_header=False, title_justify="left")
    for label, name, meaning in _MEASURES:
        measures.add_row(label, f"{getattr(scored, name):.3f}", f"{meaning}; 0 is the same")
    found = ", by a map found by looking" if scored.map_estimated else ""
    measures.add_row("coverage", f"{scored.coverage:.3f}", f"share of the exemplar that is shown{found}")
    measures.add_row("seams", f"{scored.seam_delta_e:.2f}", f"mean colour step between pieces, CIE76{found}")
    console.print(measures)
    gates = Table(show_header=False)
    for gate in scored.gates:
        gates.add_row(gate.name, _number(gate), gate.limit, _verdict(gate))
    console.print(gates)
    failed = sum(not gate.passed for gate in scored.gates)
    console.print(f"{failed} of {len(scored.gates)} gates failed" if failed else "all gates passed")
    for note in scored.notes:
        console.print(Text(f"note: {note}", style=NOTE_STYLE), soft_wrap=True)


def _number(gate: Gate) -> str:
    return f"{gate.value:.4f}" if gate.name == "hard seams" else f"{gate.value:.3f}"


def _verdict(gate: Gate) -> Text:
    return Text("pass", style="green") if gate.passed else Text(f"FAIL: {gate.meaning}", style="red")
