"""``tilefab profile drift``: how a press has drifted since it was profiled."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.progress import NOTE_STYLE, Bars
from tilefab.pipeline.drifting import DEFAULT_NOISE_LAB, DriftReport, learn_drift


def drift(
    profile: Annotated[
        Path, typer.Argument(metavar="PROFILE", help="Profile of the press, with the measurements it was built from.")
    ],
    data: Annotated[
        Path,
        typer.Argument(metavar="DATA.ti3", help="A small chart fired now: 12 patches or more of the same inks."),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="STATE.json", help="State to write; replaces an existing one."),
    ],
    start: Annotated[
        Path | None,
        typer.Option("--from", metavar="STATE.json", help="State to go on from. [default: the press as profiled]"),
    ] = None,
    noise: Annotated[
        float, typer.Option("--noise", metavar="LAB", help="Spread of a reading of L*, a*, b*, unevenness included.")
    ] = DEFAULT_NOISE_LAB,
    as_json: JsonOption = False,
) -> None:
    """Learn from a small chart how a press has drifted since it was profiled; a job names the file as `drift`."""
    if not 0.01 <= noise <= 20.0:
        raise typer.BadParameter(f"--noise is {noise:g}, but must be 0.01 to 20")
    with Bars(quiet=as_json) as bars:
        report = learn_drift(profile, data, output, from_path=start, noise_lab=noise, progress=bars)
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show(report)


def _show(report: DriftReport) -> None:
    table = Table(title=report.path, show_header=False, title_justify="left")
    more = "" if report.patches_all == report.patches else f", {report.patches_all} in all"
    table.add_row("patches", f"{report.patches}{more}")
    table.add_row("press as profiled", _errors(report.before_mean, report.before_p95))
    if report.known_mean is not None and report.known_p95 is not None:
        table.add_row("state before", _errors(report.known_mean, report.known_p95))
    table.add_row("state now", _errors(report.after_mean, report.after_p95))
    lightness, red, yellow = report.white_change_lab
    table.add_row("unprinted tile", f"L* {lightness:+.1f}, a* {red:+.1f}, b* {yellow:+.1f}")
    for change in report.changes:
        table.add_row(change.name, change.words)
    console = Console()
    console.print(table)
    for warning in report.warnings:
        console.print(Text(f"warning: {warning}", style=NOTE_STYLE), soft_wrap=True)


def _errors(mean: float, p95: float) -> str:
    return f"off by ΔE00 {mean:.2f} mean, {p95:.2f} at 95 %"
