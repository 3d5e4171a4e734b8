"""``tilefab profile check``: what can be told of a press profile."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

import tilefab
from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.progress import Bars
from tilefab.pipeline.profile_check import check_facts, check_profile, check_sheet_path, write_sheet
from tilefab.pipeline.profile_smoothness import LINES
from tilefab.report.profile_view import ProfileCheckView

_GRADE_STYLES = {"good": "green", "fair": "yellow", "poor": "red", "none": "dim"}


def check(
    profile: Annotated[Path, typer.Argument(metavar="PROFILE", help="ICC output profile for 1 to 8 inks.")],
    data: Annotated[
        Path | None,
        typer.Option(
            "--data", metavar="DATA.ti3", help="Measurements to compare with. [default: those in the profile]"
        ),
    ] = None,
    image: Annotated[
        Path | None, typer.Option("--image", metavar="SCAN", help="Scan of a slab: how much of it can be printed.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="SHEET.pdf", help="Sheet to draw; .png: SHEET_1.png ..., one a page."),
    ] = None,
    lines: Annotated[
        int, typer.Option("--lines", min=100, max=200_000, help="Lines in Lab that smoothness is measured along.")
    ] = LINES,
    as_json: JsonOption = False,
) -> None:
    """Check a press profile: colour, separation, smoothness and gamut, as figures and as a sheet."""
    if output is not None:
        check_sheet_path(output)
    with Bars(quiet=as_json) as bars:
        view = check_profile(profile, data=data, image=image, lines=lines, progress=bars)
        files = (
            ()
            if output is None
            else write_sheet(view, output, created=date.today().isoformat(), version=tilefab.__version__)
        )
    if as_json:
        print_json({**check_facts(view), "files": [str(file) for file in files]})
    else:
        _show(view, files)


def _show(view: ProfileCheckView, files: tuple[Path, ...]) -> None:
    facts = view.facts
    table = Table(title=f"{facts.path}: {facts.description}", show_header=False, title_justify="left")
    table.add_row("inks", ", ".join(facts.ink_names))
    limit = "unknown" if facts.ink_limit_percent is None else f"{facts.ink_limit_percent:.0f} %"
    table.add_row("total ink", limit)
    reached = view.gamut.share_reached
    within = "" if reached is None else f", {100.0 * reached:.0f} % of them reached within ΔE 1"
    table.add_row("gamut", f"{view.gamut.volume:.0f} cubic units of Lab{within}")
    for verdict in view.verdicts:
        line = Text(f"{verdict.grade}: ", style=_GRADE_STYLES[verdict.grade]) + Text(verdict.text, style="default")
        table.add_row(verdict.what.lower(), line)
    if files:
        table.add_row("sheet", "\n".join(str(file) for file in files))
    console = Console()
    console.print(table)
    for warning in view.warnings:
        console.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)
