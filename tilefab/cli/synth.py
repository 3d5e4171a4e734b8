"""``tilefab synth``: growing a texture from an exemplar, and applying what was grown to further layers."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import FileOption, JsonOption, ThreadsOption, print_json
from tilefab.cli.progress import NOTE_STYLE, Bars
from tilefab.cli.synth_stop import Stop, StoppedEarly, leave_at_once, run_stoppable
from tilefab.pipeline.growing import GrowFiles, GrowReport, GrowSettings, apply_map, grow_texture, remove_unfinished
from tilefab.rng import SEED_LIMIT
from tilefab.synthesis import DEFAULT_METHOD, LARGEST_SIDE_PX, METHODS
from tilefab.types import SizePx

INTERRUPTED = 130
STOPPING = "stopping after this step, and writing what there is; interrupt once more to end at once"

SideOption = Annotated[int, typer.Option(min=1, max=LARGEST_SIDE_PX, help="Size of the texture in pixels.")]


def synth(
    exemplar: Annotated[
        Path, typer.Argument(metavar="EXEMPLAR", help="Image of any depth and number of channels; alpha marks holes.")
    ],
    output: FileOption,
    rows: SideOption,
    cols: SideOption,
    seed: Annotated[
        int, typer.Option(min=0, max=SEED_LIMIT - 1, help="The same seed always gives the same texture.")
    ] = 0,
    method: Annotated[str, typer.Option(metavar="M", help=f"{', '.join(METHODS)}.")] = DEFAULT_METHOD,
    toroidal: Annotated[bool, typer.Option("--toroidal", help="Make it repeat seamlessly in both directions.")] = False,
    mask: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Image of the exemplar's size, white where it isn't to be used.")
    ] = None,
    weights: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Image of its size: the brighter, the less may be cut there.")
    ] = None,
    feature_px: Annotated[
        int | None, typer.Option(min=1, help="Size of the largest thing to keep whole; without it the method chooses.")
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Less time for a little less quality.")] = False,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="FILE.npz", help="Keep the map of places, to apply it to further layers."),
    ] = None,
    layers: Annotated[
        list[str] | None,
        typer.Option(
            "--layer", metavar="IN=OUT", help="Further image of its size (height, gloss ...) to make the same of."
        ),
    ] = None,
    preview: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Picture of what there is so far, written while it works.")
    ] = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Grow a texture of any size from an exemplar, out of exact copies of its pixels.

    Interrupted once, it writes what there is by then and ends with 130.
    """
    if method not in METHODS:
        raise typer.BadParameter(f"there is no method {method!r}; choose one of {', '.join(METHODS)}")
    files = GrowFiles(
        exemplar, output, mask, weights, tuple(_layer_files(text) for text in layers or []), map_file, preview
    )
    settings = GrowSettings(SizePx(rows, cols), seed, method, toroidal, feature_px, fast, threads)
    try:
        with Bars() as bars:
            stop = Stop(lambda: bars.note(STOPPING))
            report = run_stoppable(lambda: grow_texture(files, settings, bars, stop), stop)
    except KeyboardInterrupt:
        remove_unfinished(files)
        typer.echo("interrupted: not everything was written", err=True)
        leave_at_once(INTERRUPTED)
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show(report)
    if not report.complete:
        raise StoppedEarly(INTERRUPTED)


def apply(
    map_file: Annotated[Path, typer.Argument(metavar="MAP.npz", help="Map of places that `tilefab synth` kept.")],
    layer: Annotated[
        Path, typer.Argument(metavar="LAYER", help="Image of the size of the exemplar it was grown from.")
    ],
    output: FileOption,
    as_json: JsonOption = False,
) -> None:
    """Make of a further layer (height, gloss ...) what was grown of its exemplar: exact copies of its pixels."""
    applied = apply_map(map_file, layer, output)
    if as_json:
        print_json(dataclasses.asdict(applied))
        return
    kind = f"{applied.channels} channel{'s' if applied.channels > 1 else ''} of {applied.kind}"
    typer.echo(f"{applied.output}: {applied.cols} x {applied.rows} pixels, {kind}")
    _notes(Console(), applied.notes)


def _layer_files(text: str) -> tuple[Path, Path]:
    """Both files of IN=OUT; of several signs, the one before which a file is named."""
    places = [k for k, sign in enumerate(text) if sign == "=" and 0 < k < len(text) - 1]
    if not places:
        raise typer.BadParameter(f"{text!r} doesn't name two files; write --layer IN=OUT")
    at = next((k for k in places if Path(text[:k]).is_file()), places[0])
    return Path(text[:at]), Path(text[at + 1 :])


def _show(report: GrowReport) -> None:
    table = Table(title=Text(report.output), show_header=False, title_justify="left")
    repeats = ", repeats seamlessly" if report.toroidal else ""
    table.add_row("texture", f"{report.cols} x {report.rows} pixels{repeats}")
    table.add_row("method", f"{report.method}, seed {report.seed}, {report.seconds:.1f} s")
    table.add_row("exemplar", f"{100 * report.coverage:.1f} % of it is shown")
    table.add_row(
        "seams", f"CIE76 {report.mean_seam_delta_e:.2f} on average, {report.worst_seam_delta_e:.1f} at the worst place"
    )
    for name, path in (("map", report.map), *(("layer", path) for path in report.layers)):
        if path is not None:
            table.add_row(name, Text(path))
    console = Console()
    console.print(table)
    _notes(console, report.notes)


def _notes(console: Console, notes: tuple[str, ...]) -> None:
    for note in notes:
        console.print(Text(f"note: {note}", style=NOTE_STYLE), soft_wrap=True)
