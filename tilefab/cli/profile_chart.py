"""``tilefab profile chart`` and ``tilefab profile read``: to the press and back."""

from __future__ import annotations

import dataclasses
from datetime import date
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JsonOption, print_json
from tilefab.pipeline.chart_colours import PatchNote, ScanNote
from tilefab.pipeline.chart_reading import ReadingReport, read_chart
from tilefab.pipeline.charts import CMYK_NAMES, ChartReport, ChartSettings, make_chart
from tilefab.types import SizeMm

_MOST_NOTES = 20


def _names(inks: int | None, names: str | None) -> tuple[str, ...]:
    if names is None:
        count = 4 if inks is None else inks
        return CMYK_NAMES if count == 4 else tuple(f"Ink {ink}" for ink in range(1, count + 1))
    given = tuple(name.strip() for name in names.split(","))
    if inks is not None and inks != len(given):
        raise typer.BadParameter(f"--inks says {inks}, but --ink-names names {len(given)}")
    return given


def _size(text: str) -> SizeMm:
    try:
        width, height = (float(part) for part in text.split(","))
    except ValueError as error:
        raise typer.BadParameter(f"--tile-mm is {text!r}, but must be width and height, as 300,300") from error
    if not (20.0 <= width <= 5000.0 and 20.0 <= height <= 5000.0):
        raise typer.BadParameter(f"a tile of {width:g} x {height:g} mm is not 20 to 5000 mm on each side")
    return SizeMm(width, height)


def chart(
    stem: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="STEM", help="Beginning of the files: STEM_1.tif ..., STEM.cgats."),
    ],
    inks: Annotated[int | None, typer.Option("--inks", min=1, max=8, help="Number of inks. [default: 4]")] = None,
    ink_names: Annotated[
        str | None,
        typer.Option("--ink-names", metavar="A,B,...", help="Names in channel order; Black is laid out as black."),
    ] = None,
    patches: Annotated[int, typer.Option("--patches", min=20, max=20000, help="Patches in all.")] = 800,
    tile_mm: Annotated[str, typer.Option("--tile-mm", metavar="W,H", help="Size of a tile.")] = "300,300",
    dpi: Annotated[float, typer.Option("--dpi", min=30, max=2400, help="Resolution of the print.")] = 360.0,
    patch_mm: Annotated[float, typer.Option("--patch-mm", min=1, max=100, help="Side of a patch.")] = 8.0,
    gap_mm: Annotated[float, typer.Option("--gap-mm", min=0.1, max=50, help="Bare gap between patches.")] = 1.0,
    margin_mm: Annotated[float, typer.Option("--margin-mm", min=0, max=100, help="Bare edge of a tile.")] = 5.0,
    ink_limit: Annotated[
        float | None,
        typer.Option("--ink-limit", metavar="PERCENT", help="Total ink limit. [default: 300, or all inks if less]"),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Other seeds give other recipes and orders.")] = 0,
    bits: Annotated[int, typer.Option("--bits", help="8 or 16.")] = 8,
    labels: Annotated[bool, typer.Option(help="Name rows, columns and tiles in print.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Lay out a characterisation chart: print files and the list that reads it back."""
    settings = ChartSettings(
        ink_names=_names(inks, ink_names),
        patches=patches,
        tile_mm=_size(tile_mm),
        dpi=dpi,
        patch_mm=patch_mm,
        gap_mm=gap_mm,
        margin_mm=margin_mm,
        ink_limit_percent=ink_limit,
        seed=seed,
        bits=bits,
        labels=labels,
    )
    try:
        report = make_chart(stem, settings, created=date.today().isoformat())
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show_chart(report)


def read(
    chart_file: Annotated[
        Path, typer.Argument(metavar="CHART.cgats", help="List of the chart, as profile chart wrote it.")
    ],
    sources: Annotated[
        list[Path],
        typer.Argument(metavar="SCAN|MEASURED...", help="Scans of all tiles, or an instrument's CGATS files."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DATA.ti3", help="Measurement file to write.")],
    scan_profile: Annotated[
        Path | None,
        typer.Option("--scan-profile", metavar="ICC", help="Profile of the scanner, instead of the embedded one."),
    ] = None,
    even_light: Annotated[bool, typer.Option(help="Take the scanner's uneven light out.")] = True,
    as_json: JsonOption = False,
) -> None:
    """Make a measurement file of a printed chart: from scans of its tiles, or from an instrument's files."""
    report = read_chart(
        chart_file,
        sources,
        output,
        created=date.today().isoformat(),
        scan_profile=scan_profile,
        even_light=even_light,
    )
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show_reading(report)


def _show_chart(report: ChartReport) -> None:
    table = Table(title=report.list_file, show_header=False, title_justify="left")
    table.add_row("print files", "\n".join(report.files))
    table.add_row("inks", ", ".join(report.ink_names))
    table.add_row("patches", f"{report.patches}: " + ", ".join(f"{n} {kind}" for kind, n in report.kinds.items()))
    per_tile = ", ".join(str(count) for count in report.patches_per_tile)
    table.add_row("tiles", f"{report.tiles} of {report.grid[0]} x {report.grid[1]} cells, with {per_tile} patches")
    table.add_row("ink", f"at most {report.most_ink_percent:.0f} % of {report.ink_limit_percent:g} % allowed")
    Console().print(table)


def _show_reading(report: ReadingReport) -> None:
    table = Table(title=report.output, show_header=False, title_justify="left")
    table.add_row("patches", str(report.patches) + (f", {report.bands} spectral bands" if report.bands else ""))
    table.add_row("inks", ", ".join(report.ink_names))
    if report.noise_delta_e is not None:
        table.add_row("repeats", f"{report.repeated} recipes, typically ΔE00 {report.noise_delta_e:.2f} apart")
    for scan in report.scans:
        table.add_row(f"tile {scan.tile}", Text(_scan_text(scan)))
    for note in report.notes[:_MOST_NOTES]:
        table.add_row(f"patch {note.sample}", Text(_note_text(note)))
    if len(report.notes) > _MOST_NOTES:
        table.add_row("", f"and {len(report.notes) - _MOST_NOTES} more; --json lists all")
    if report.left_out:
        table.add_row("left out", ", ".join(report.left_out))
    console = Console()
    console.print(table)
    for warning in report.warnings:
        console.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)


def _scan_text(scan: ScanNote) -> str:
    light = "" if scan.lighting_percent is None else f", light evened by {scan.lighting_percent:.1f} %"
    return (
        f"{scan.file}: {scan.scan_dpi:.0f} dpi, turned {scan.turn_degrees:.1f}°, marks within "
        f"{scan.residual_mm:.3f} mm{light}"
    )


def _note_text(note: PatchNote) -> str:
    return f"{note.location}: {note.what}, ΔE {note.delta_e:.1f}"
