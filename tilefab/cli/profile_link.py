"""``tilefab profile link``: the same colours from other inks, or from fewer."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.profile_build import PriceOption, by_name
from tilefab.cli.progress import Bars
from tilefab.pipeline.linking import DEFAULT_TOLERANCE, LinkReport, LinkSettings, link_profiles


def link(
    source: Annotated[Path, typer.Option("--from", metavar="PROFILE", help="Profile that print data were made for.")],
    target: Annotated[
        Path, typer.Option("--to", metavar="PROFILE", help="Profile of the press to print on; may be the same.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="LINK.icc", help="Device link to write.")],
    ink_limit: Annotated[
        float | None, typer.Option("--ink-limit", metavar="PERCENT", help="Total ink limit. [default: the profile's]")
    ] = None,
    tolerance: Annotated[
        float, typer.Option("--tolerance", metavar="DE", help="How far colours may move for less ink, CIEDE2000.")
    ] = DEFAULT_TOLERANCE,
    price: PriceOption = None,
    image: Annotated[
        Path | None, typer.Option("--image", metavar="SCAN", help="Image to save most ink on, and to tell it of.")
    ] = None,
    version: Annotated[int, typer.Option("--version", help="ICC version: 2 or 4.")] = 2,
    as_json: JsonOption = False,
) -> None:
    """Build a device link that prints the same colours with the least ink, and tell what it saves."""
    if version not in (2, 4):
        raise typer.BadParameter(f"--version is {version}, but must be 2 or 4")
    settings = LinkSettings(ink_limit, tolerance, by_name(price, "--price"), 4 if version == 4 else 2, image)
    with Bars() as bars:
        report = link_profiles(source, target, output, settings, progress=bars)
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show(report, output)


def _show(report: LinkReport, output: Path) -> None:
    table = Table(title=Text(f"{output} ({report.size_bytes} bytes)"), show_header=False, title_justify="left")
    names = ", ".join(report.ink_names_in)
    if report.ink_names_in != report.ink_names_out:
        names += f" to {', '.join(report.ink_names_out)}"
    table.add_row("inks", Text(names))
    table.add_row("ink limit", f"{report.ink_limit_percent:.0f} %")
    table.add_row("judged on", Text(report.judged))
    table.add_row("mean ink", f"{report.ink_in_percent:.1f} % before, {report.ink_out_percent:.1f} % after")
    table.add_row("ink saved", f"{report.saved_percent:.1f} %")
    if report.cost_saved_percent is not None:
        table.add_row("cost saved", f"{report.cost_saved_percent:.1f} %")
    table.add_row(
        "colours moved",
        f"ΔE00 {report.delta_e_mean:.2f} mean, {report.delta_e_p95:.2f} at 95 %, {report.delta_e_max:.2f} at most",
    )
    Console().print(table)
