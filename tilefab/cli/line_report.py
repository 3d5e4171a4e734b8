"""``tilefab line inspected`` and ``report``: what journal and inspector put down, for operators and managers."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.progress import NOTE_STYLE, Bars
from tilefab.config import load_line

if TYPE_CHECKING:
    from tilefab.pipeline.inspection.overview import RunOverview

LineArgument = Annotated[Path, typer.Argument(metavar="LINE", help="The line's file (TOML).")]


def report(
    line: LineArgument,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE.pdf", help="PDF to write; FILE.json is written beside it.")
    ] = Path("line_report.pdf"),
    run: Annotated[
        int | None, typer.Option("--run", metavar="N", min=1, help="Number of the run. [default: the newest]")
    ] = None,
    begun: Annotated[
        str | None,
        typer.Option("--from", metavar="TIME", help="Only prints from then on: 2026-11-24T06:00, local time."),
    ] = None,
    ended: Annotated[str | None, typer.Option("--to", metavar="TIME", help="And before then.")] = None,
    shift: Annotated[
        str | None,
        typer.Option("--shift", metavar="TIME", help="The eight hours from then on: the same as --from and --to."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write the report of a run or of a shift: a PDF, and beside it the same in JSON.

    Where more than one run printed in a shift, each has its own file, with the run's number in its name.
    """
    # Whoever draws needs fonts and colours; other commands don't.
    from tilefab.pipeline.inspection.line_reporting import Span, write_line_reports

    if output.suffix.lower() != ".pdf":
        raise typer.BadParameter(f"{output}: the report goes into a .pdf file")
    if shift is not None and (begun is not None or ended is not None):
        raise typer.BadParameter("--shift says both --from and --to: give either")
    since, until = (
        None if text is None else _time(option, text) for option, text in (("--from", begun), ("--to", ended))
    )
    if shift is not None:
        since = _time("--shift", shift)
        until = since + timedelta(hours=8)
    if since is not None and until is not None and since >= until:
        raise typer.BadParameter("--to must be later than --from")
    line_file = load_line(line)
    now = datetime.now(UTC)
    offset = now.astimezone().utcoffset() or timedelta(0)
    with Bars(quiet=as_json) as bars:
        written = write_line_reports(line_file, output, run, Span(since, until), bars, now=now, utc_offset=offset)
    if as_json:
        print_json({"files": [str(path) for path in written]})
    else:
        for path in written:
            typer.echo(str(path))


def inspected(
    line: LineArgument = Path("line.toml"),
    last: Annotated[
        int, typer.Option("--last", metavar="N", min=1, max=10_000, help="How many tiles to tell of.")
    ] = 12,
    as_json: JsonOption = False,
) -> None:
    """Show how the tiles of a line's newest run came out of the kiln so far."""
    from tilefab.pipeline.inspection.overview import run_overview

    found = run_overview(load_line(line), last)
    if as_json:
        print_json(dataclasses.asdict(found))
    else:
        _show(found)


def _show(found: RunOverview) -> None:
    console = Console()
    grades = ", ".join(f"{many} {grade}" for grade, many in found.grades.items() if many)
    facts = Table(title=f"run {found.run_id}: {found.name}", show_header=False, title_justify="left")
    facts.add_row("printed", f"{found.printed:,} of {found.planned:,} faces")
    facts.add_row("inspected", f"{found.inspected:,} tiles" + (f": {grades}" if grades else ""))
    if found.delta_e_mean is not None:
        facts.add_row(
            "latest", f"ΔE00 {found.delta_e_mean:.2f} in the mean of {len(found.latest)} from their own faces"
        )
    facts.add_row("corrections", str(found.corrections))
    for alarm in found.alarms:
        facts.add_row("alarm", Text(alarm, style=NOTE_STYLE))
    console.print(facts)
    if not found.latest:
        return
    tiles = Table("seen", "face", "ΔE00 mean", "95 %", "ΔL*", "ΔC*", "correction", "shade", "grade")
    for tile in found.latest:
        colour = tile.colour
        numbers = ("", "", "", "")
        if colour is not None:
            numbers = (
                f"{colour.delta_e_mean:.2f}",
                f"{colour.delta_e_p95:.2f}",
                f"{colour.lightness:+.2f}",
                f"{colour.chroma:+.2f}",
            )
        made = "" if not tile.correction else str(tile.correction)
        tiles.add_row(
            f"{tile.taken_at.astimezone():%H:%M:%S}", str(tile.face), *numbers, made, tile.shade_lot, tile.grade
        )
    console.print(tiles)


def _time(option: str, text: str) -> datetime:
    """A time as people write it; without a zone, the local one."""
    try:
        return datetime.fromisoformat(text).astimezone(UTC)
    except (ValueError, OverflowError):
        raise typer.BadParameter(f"{option} {text!r} is no time: write it as 2026-11-24T06:00") from None
