"""``tilefab inspect`` and ``tilefab trace``: what a fired tile is, and how good."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tilefab.cli.common import JobArgument, JsonOption, OutOption, ThreadsOption, planned_job, print_json
from tilefab.cli.progress import NOTE_STYLE, Bars
from tilefab.config import load_line
from tilefab.inspection.records import Recognition, TileInspection
from tilefab.io.faces import check_preview_path
from tilefab.pipeline.faces import check_target

if TYPE_CHECKING:
    from tilefab.pipeline.inspection.looking import LookedAt
    from tilefab.pipeline.inspection.tracing import TracedTile

UNKNOWN = 1
"""Exit code where the tile is none of the job's, or can't be measured."""

ImageArgument = Annotated[Path, typer.Argument(metavar="IMAGE", help="Photograph or scan of one fired tile.")]
FacesOption = Annotated[
    str | None,
    typer.Option(
        "--faces",
        metavar="A:B",
        help="Faces that it may show. [default: those on record as printed, else all of the job]",
    ),
]
LineFileOption = Annotated[
    Path | None,
    typer.Option("--line", metavar="LINE", help="File of the line that printed it: its journal is asked, too."),
]
ScaleOption = Annotated[
    float | None,
    typer.Option("--px-per-mm", min=0.1, max=100.0, help="Calibration of the image. [default: the line's, or unknown]"),
]
ProfileOption = Annotated[
    Path | None,
    typer.Option(
        "--camera-profile", metavar="ICC", help="Profile of the camera. [default: the image's, the line's, or sRGB]"
    ),
]


def inspect(
    image: ImageArgument,
    job: JobArgument,
    faces: FacesOption = None,
    line: LineFileOption = None,
    px_per_mm: ScaleOption = None,
    camera_profile: ProfileOption = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="Picture of the tile beside its face, with defects (.png or .jpg)."
        ),
    ] = None,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Recognise a fired tile, measure it against its own face, and grade it. Ends with 1 if it is none of the job's."""
    # What it takes to measure a tile is loaded by those who do.
    from tilefab.pipeline.inspection.looking import Looking, look_at
    from tilefab.pipeline.inspection.tile_sheet import write_tile_sheet

    if picture is not None:
        check_preview_path(picture)
    plan = planned_job(job, out)
    if picture is not None:
        check_target(plan, picture)
    line_file = None if line is None else load_line(line)
    with Bars(quiet=as_json) as bars:
        looked = look_at(image, plan, Looking(faces, px_per_mm, camera_profile), line_file, bars, threads)
    found = looked.tile.inspection
    if picture is not None:
        write_tile_sheet(picture, looked.tile)
    if as_json:
        facts = {"image": str(image), "candidates": looked.candidates, "correction": looked.tile.correction}
        print_json({**facts, **dataclasses.asdict(found)})
    else:
        _show(found, looked)
    if found.recognition.face is None or looked.tile.xyz is None:
        raise typer.Exit(UNKNOWN)


def trace(
    image: ImageArgument,
    job: JobArgument,
    faces: FacesOption = None,
    line: LineFileOption = None,
    px_per_mm: ScaleOption = None,
    camera_profile: ProfileOption = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.tif", help="Write the print data of its face again, as printed."),
    ] = None,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Tell which face a fired tile is, and when and how it was printed and fired. Ends with 1 if none of the job's."""
    from tilefab.pipeline.inspection.looking import Looking, look_at
    from tilefab.pipeline.inspection.tracing import reprint_tile, trace_tile

    if output is not None and output.suffix.lower() not in (".tif", ".tiff"):
        raise typer.BadParameter(f"{output}: print data go into a .tif file")
    plan = planned_job(job, out)
    if output is not None:
        check_target(plan, output)
    line_file = None if line is None else load_line(line)
    compared = None
    with Bars(quiet=as_json) as bars:
        looked = look_at(image, plan, Looking(faces, px_per_mm, camera_profile), line_file, bars, threads)
        traced = trace_tile(plan, looked.maps, looked.tile.inspection.recognition, looked.prints, line_file)
        face = traced.recognition.face
        if output is not None and face is not None:
            compared = reprint_tile(
                plan, looked.maps, face, output, prints=looked.prints, line_file=line_file, threads=threads
            )
    if as_json:
        facts = {"file_written": None if compared is None else str(output), "candidates": looked.candidates}
        print_json({**facts, **dataclasses.asdict(traced)})
    else:
        _show_trace(traced, looked.candidates)
        if compared is not None:
            same = ": the same that the printer received" if compared else ""
            typer.echo(f"print data written to {output}{same}")
    if face is None:
        raise typer.Exit(UNKNOWN)


def _show(found: TileInspection, looked: LookedAt) -> None:
    table = _table(found.recognition, looked.candidates)
    colour, size = found.colour, found.dimensions
    if colour is not None:
        x, y = colour.worst_at_mm
        table.add_row(
            "colour",
            f"ΔE00 {colour.delta_e_mean:.2f} mean, {colour.delta_e_p95:.2f} at 95 %, {colour.delta_e_worst:.2f} at "
            f"most (at {x:.0f}, {y:.0f} mm)",
        )
        table.add_row("", f"CMC(2:1) {colour.cmc_mean:.2f} mean, {colour.cmc_p95:.2f} at 95 %")
        table.add_row("", f"ΔL* {colour.lightness:+.2f}, ΔC* {colour.chroma:+.2f}, ΔH* {colour.hue:+.2f}")
    if size is not None:
        known = "" if size.scale_known else " (by the work size: the image isn't calibrated)"
        table.add_row(
            "size", f"{size.width_mm:.2f} x {size.height_mm:.2f} mm, {size.size_deviation_percent:+.2f} %{known}"
        )
        table.add_row(
            "shape",
            f"straightness {size.straightness_percent:+.2f} %, rectangularity {size.rectangularity_percent:+.2f} %",
        )
    if colour is not None:
        x, y = found.shift_mm
        table.add_row("print", f"{x:+.2f}, {y:+.2f} mm off the middle, turned {found.turn_deg:+.2f}°")
        for defect in found.defects:
            table.add_row(
                defect.kind.replace("_", " "),
                f"at {defect.x_mm:.1f}, {defect.y_mm:.1f} mm, {defect.width_mm:.1f} x {defect.height_mm:.1f} mm, "
                f"ΔE {defect.delta_e:.1f}: {defect.grade}",
            )
        if not found.defects:
            table.add_row("defects", "none found")
        table.add_row("grade", Text(str(found.grade), style="bold"))
        for reason in found.reasons:
            table.add_row("", Text(reason, style=NOTE_STYLE))
    Console().print(table)


def _table(seen: Recognition, candidates: int) -> Table:
    table = Table(show_header=False)
    if seen.face is None:
        table.add_row("face", Text(seen.reason, style=NOTE_STYLE))
        if seen.problem is None:
            table.add_row("", f"{candidates:,} faces were looked among")
        return table
    turned = f", turned by {90 * seen.quarter_turns}°" if seen.quarter_turns else ""
    table.add_row("face", f"{seen.face}{turned}, of {candidates:,} looked among")
    table.add_row(
        "sure", f"{100 * seen.confidence:.2f} %; likeness {seen.likeness:.2f}, of the next {seen.runner_up:.2f}"
    )
    if seen.visible < 0.995:
        table.add_row("seen", f"{100 * seen.visible:.0f} % of it")
    return table


def _show_trace(traced: TracedTile, candidates: int) -> None:
    table = _table(traced.recognition, candidates)
    if traced.recognition.face is not None:
        if traced.arm_id is not None:
            often = f"; the last of {traced.prints} prints of this face" if traced.prints > 1 else ""
            table.add_row("print", f"run {traced.run_id}, arm {traced.arm_id}{often}")
        for name, at in (
            ("printed", traced.printed_at),
            ("into the kiln", traced.passed_at),
            ("fired", traced.fired_at),
        ):
            if at is not None:
                table.add_row(name, _time(at))
        if traced.image:
            table.add_row("inspected", f"{traced.image}: {traced.grade}")
        table.add_row("profile", f"{traced.profile} ({traced.profile_sha256[:12]})")
        if traced.correction:
            made = "" if traced.corrected_at is None else f" of {_time(traced.corrected_at)}"
            table.add_row("correction", f"{traced.correction}{made}: {traced.reason}")
        elif traced.arm_id is not None:
            table.add_row("correction", "none: as the job says")
        if traced.file:
            table.add_row("file", traced.file)
        table.add_row("code", traced.code)
    Console().print(table)


def _time(at: datetime) -> str:
    return f"{at.astimezone():%Y-%m-%d %H:%M:%S}"
