"""Tables for people on standard output."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.pipeline.describe import plan_facts
from tilefab.pipeline.plan import Plan


def _table(title: str, rows: Iterable[tuple[str, str]]) -> None:
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for label, value in rows:
        table.add_row(label, Text(value))
    console = Console()
    console.print(Text(title, style="bold"), soft_wrap=True)
    console.print(table)


def show_plan(plan: Plan) -> None:
    """Print a resolved job."""
    facts = plan_facts(plan)
    rows: list[tuple[str, str]] = []
    for section, values in facts.items():
        if isinstance(values, Mapping):
            rows += [(f"{section}.{name}", _text(value)) for name, value in values.items()]
        else:
            rows.append((section, _text(values)))
    _table(f"{plan.job_file.path}: in order", rows)


def show_map(facts: Mapping[str, object], warnings: Iterable[str]) -> None:
    """Print the facts of a texture map."""
    _table(str(facts["file"]), [(name, _text(value)) for name, value in facts.items() if name != "file"])
    _warn(warnings)


def show_outcome(facts: Mapping[str, Any]) -> None:
    """Print what a run did, what was done to the slab, and the warnings."""
    _table(
        str(facts["output"]),
        [
            ("faces", f"{facts['written']} written, {facts['kept']} there already"),
            ("report", str(facts["report"] or "none")),
            ("texture map", str(facts["texture_map"])[:16]),
            ("colour", _colour_text(facts["colour"])),
            *((str(entry["step"]).lower(), str(entry["what"])) for entry in facts["preparation"]),
        ],
    )
    _warn(facts["warnings"])


def _colour_text(colour: Mapping[str, Any]) -> str:
    beyond = f"{100 * colour['out_of_gamut_share']:.1f} % of the stone is out of gamut"
    if colour["out_of_gamut_share"]:
        beyond += f", by ΔE00 {colour['out_of_gamut_mean']:.1f} (95 %: {colour['out_of_gamut_p95']:.1f})"
    return (
        f"ΔE00 {colour['delta_e_mean']:.2f} to the stone (95 %: {colour['delta_e_p95']:.2f}); {beyond}; "
        f"ink {colour['mean_total_ink_percent']:.0f} % (at most {colour['max_total_ink_percent']:.0f} %)"
    )


def _warn(warnings: Iterable[str]) -> None:
    console = Console()
    for warning in warnings:
        console.print(Text(f"warning: {warning}", style="yellow"), soft_wrap=True)


def _text(value: object) -> str:
    if isinstance(value, Mapping):
        return ": ".join(_text(item) for item in value.values())
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping) for item in value):
        return "\n".join(_text(item) for item in value)
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return "-" if value is None else str(value)
