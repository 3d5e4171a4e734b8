"""``tilefab profile``: building press profiles from measurements."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from tilefab.cli.profile_chart import chart, read
from tilefab.pipeline.profiling import ProfileReport, build_profile

app = typer.Typer(help="Press profiles: build one from a measured chart.", no_args_is_help=True)


@app.callback()
def profile() -> None:
    """Press profiles: build one from a measured chart."""


app.command("chart")(chart)
app.command("read")(read)


@app.command()
def build(
    measurements: Annotated[
        Path,
        typer.Argument(metavar="DATA.ti3", help="Measured chart: CGATS or .ti3 with ink percentages and Lab."),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="OUT.icc", help="Profile to write; replaces an existing one."),
    ],
    ink_limit: Annotated[
        float, typer.Option("--ink-limit", metavar="PERCENT", help="Total ink limit in percent.")
    ] = 280.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
) -> None:
    """Build an ICC profile of a press from a measured chart."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    with bar:
        task = bar.add_task("reading the measurements", total=1.0)
        report = build_profile(
            measurements,
            output,
            ink_limit_percent=ink_limit,
            progress=lambda what, share: bar.update(task, description=what, completed=share),
        )
    if as_json:
        typer.echo(json.dumps(dataclasses.asdict(report), indent=2))
    else:
        _show(report, output)


def _show(report: ProfileReport, output: Path) -> None:
    table = Table(title=f"{output} ({report.size_bytes} bytes)", show_header=False, title_justify="left")
    table.add_row("patches", str(report.patches))
    table.add_row("inks", ", ".join(report.ink_names))
    table.add_row("ink limit", f"{report.ink_limit_percent:g} %")
    table.add_row("unprinted tile", _lab(report.white_lab))
    table.add_row("darkest print", _lab(report.dark_lab))
    for what, mean, most in (
        ("model, fitted patches", report.model_fit_mean, report.model_fit_p95),
        ("model, held-out patches", report.held_out_mean, report.held_out_p95),
        ("round trip in gamut", report.round_trip_mean, report.round_trip_p95),
    ):
        table.add_row(what, f"ΔE00 {mean:.2f} mean, {most:.2f} at 95 %")
    Console().print(table)


def _lab(lab: tuple[float, float, float]) -> str:
    return f"Lab {lab[0]:.1f} {lab[1]:.1f} {lab[2]:.1f}"
