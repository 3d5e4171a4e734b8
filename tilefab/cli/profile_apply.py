"""``tilefab profile apply``: an image to print data."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, cast, get_args

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JsonOption, ThreadsOption, print_json
from tilefab.cli.progress import Bars
from tilefab.colour import Intent
from tilefab.pipeline.applying import ApplyReport, ApplySettings, apply_link, apply_profile


def apply(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="RGB or gray image; with --link, what it takes.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="OUT.tif", help="Print data to write.")],
    profile: Annotated[
        Path | None,
        typer.Option("--profile", metavar="PROFILE", help="Press profile; with --link only to embed it."),
    ] = None,
    link: Annotated[Path | None, typer.Option("--link", metavar="LINK", help="Device link.")] = None,
    intent: Annotated[
        str | None,
        typer.Option("--intent", metavar="I", help=f"{', '.join(get_args(Intent))}. [default: perceptual]"),
    ] = None,
    source_profile: Annotated[
        Path | None,
        typer.Option(
            "--source-profile", metavar="ICC", help="The image's profile, instead of the embedded one or sRGB."
        ),
    ] = None,
    bits: Annotated[int | None, typer.Option("--bits", help="8 or 16. [default: as the image]")] = None,
    ink_limit: Annotated[
        float | None, typer.Option("--ink-limit", metavar="PERCENT", help="Most ink of a pixel, all inks added up.")
    ] = None,
    dpi: Annotated[
        float | None, typer.Option("--dpi", min=10, max=20000, help="Resolution to state. [default: the image's]")
    ] = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Separate an image for a press: through its profile, or print data through a device link."""
    if link is None and profile is None:
        raise typer.BadParameter("say what to convert through: --profile PROFILE or --link LINK")
    if link is not None and (intent is not None or source_profile is not None):
        raise typer.BadParameter("a link has its intent and its source in it: leave --intent and --source-profile out")
    if intent is not None and intent not in get_args(Intent):
        raise typer.BadParameter(f"--intent is {intent!r}, but must be one of {', '.join(get_args(Intent))}")
    try:
        settings = ApplySettings(bits, ink_limit, dpi, threads)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    with Bars() as bars:
        if link is not None:
            report = apply_link(image, output, link, bars, profile_path=profile, settings=settings)
        else:
            report = apply_profile(
                image,
                output,
                cast(Path, profile),
                bars,
                intent=cast(Intent, intent or "perceptual"),
                source_profile=source_profile,
                settings=settings,
            )
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show(report)


def _show(report: ApplyReport) -> None:
    table = Table(title=report.output, show_header=False, title_justify="left")
    table.add_row("print data", f"{report.cols} x {report.rows} pixels, {report.bits} bit, {report.dpi:g} dpi")
    for name, mean in zip(report.ink_names, report.mean_ink_percent, strict=True):
        table.add_row(Text(name), f"{mean:.2f} % on average")
    limited = f", {100 * report.share_limited:.1f} % of pixels reduced" if report.share_limited else ""
    table.add_row("total ink", f"at most {report.max_total_ink_percent:.1f} %{limited}")
    table.add_row("speed", f"{report.mpx_per_second:.1f} million pixels a second")
    console = Console()
    console.print(table)
    for note in report.notes:
        console.print(Text(f"note: {note}", style="yellow"), soft_wrap=True)
