"""``tilefab profile build``: from a measured chart to a press profile."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.table import Table

from tilefab.cli.common import JsonOption, print_json
from tilefab.cli.progress import Bars
from tilefab.pipeline.profiling import ProfileReport, ProfileSettings, build_profile

PriceOption = Annotated[
    list[str] | None,
    typer.Option("--price", metavar="INK=N", help="What an ink costs, in any unit; repeat it. Inks not named cost 1."),
]
InkMaxOption = Annotated[
    list[str] | None,
    typer.Option("--ink-max", metavar="INK=PERCENT", help="Most of one ink; repeat it. [default: 100 each]"),
]


def by_name(given: list[str] | None, option: str) -> dict[str, float] | None:
    """Values by ink, of options like ``Blue=2.5``."""
    values = {}
    for text in given or []:
        name, mark, number = text.rpartition("=")
        try:
            values[name.strip()] = float(number)
        except ValueError:
            mark = ""
        if not mark or not name.strip():
            raise typer.BadParameter(f"{option} is {text!r}, but must be an ink and a number, as Blue=2.5")
    return values or None


def build(
    measurements: Annotated[
        Path,
        typer.Argument(metavar="DATA.ti3", help="Measured chart: CGATS or .ti3 with ink percentages and colours."),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="OUT.icc", help="Profile to write; replaces an existing one."),
    ],
    ink_limit: Annotated[
        float | None,
        typer.Option(
            "--ink-limit", metavar="PERCENT", help="Total ink limit. [default: 280, or what the chart reaches]"
        ),
    ] = None,
    version: Annotated[int, typer.Option("--version", help="ICC version: 2 or 4.")] = 2,
    separation: Annotated[
        Literal["standard", "least-ink"],
        typer.Option("--separation", help="standard: black as printers are used to; least-ink: the cheapest recipe."),
    ] = "standard",
    price: PriceOption = None,
    ink_max: InkMaxOption = None,
    as_json: JsonOption = False,
) -> None:
    """Build an ICC profile of a press from a measured chart."""
    if version not in (2, 4):
        raise typer.BadParameter(f"--version is {version}, but must be 2 or 4")
    settings = ProfileSettings(
        ink_limit_percent=ink_limit,
        version=4 if version == 4 else 2,
        separation="least_ink" if separation == "least-ink" else "standard",
        ink_prices=by_name(price, "--price"),
        ink_limits_percent=by_name(ink_max, "--ink-max"),
    )
    with Bars() as bars:
        report = build_profile(measurements, output, settings, progress=bars)
    if as_json:
        print_json(dataclasses.asdict(report))
    else:
        _show(report, output)


def _show(report: ProfileReport, output: Path) -> None:
    table = Table(title=f"{output} ({report.size_bytes} bytes)", show_header=False, title_justify="left")
    left_out = f", {report.left_out} left out" if report.left_out else ""
    table.add_row("patches", f"{report.patches}{left_out}")
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
    table.add_row("model against the press", f"ΔE00 {report.expected_error:.2f}, estimated")
    table.add_row("noise of a reading", f"{report.noise_lab:.2f} in L*, a*, b*")
    if report.spectral_rms is not None:
        lamp = report.spectral_delta_e_a
        shown = "" if lamp is None else f", ΔE00 {lamp:.2f} mean under illuminant A"
        table.add_row("spectra, held-out patches", f"{report.spectral_rms:.4f} RMS{shown}")
    Console().print(table)


def _lab(lab: tuple[float, float, float]) -> str:
    return f"Lab {lab[0]:.1f} {lab[1]:.1f} {lab[2]:.1f}"
