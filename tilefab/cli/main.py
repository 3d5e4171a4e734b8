"""``tilefab``: the operator's commands."""

from __future__ import annotations

import dataclasses
import sys
import traceback
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

import tilefab
from tilefab.cli import inspect as line_inspect
from tilefab.cli import line, line_report, maps, profile, synth, texture, tiles
from tilefab.cli.common import (
    FileOption,
    JobArgument,
    JsonOption,
    OutOption,
    ThreadsOption,
    face_number,
    planned_job,
    print_json,
)
from tilefab.cli.progress import Bars
from tilefab.cli.show import show_outcome, show_plan
from tilefab.cli.synth_stop import StoppedEarly
from tilefab.errors import ConfigError, Problem, TilefabError
from tilefab.io.faces import check_preview_path, write_preview
from tilefab.pipeline.describe import outcome_facts, plan_facts
from tilefab.pipeline.faces import (
    check_face_code,
    check_target,
    face_code,
    face_region,
    parse_face_code,
    write_face,
)
from tilefab.pipeline.main_job import do_job
from tilefab.pipeline.maps import job_maps, proof_map
from tilefab.pipeline.run_report import write_report
from tilefab.pipeline.selection import parse_faces
from tilefab.pipeline.wall import render_wall, wall_index
from tilefab.sampling.layout import FACE_LIMIT

REFUSED = 1
INTERRUPTED = 130
INTERRUPTED_NOTE = "interrupted: finished faces are kept; run the same command again to go on"
UNEXPECTED = 70

app = typer.Typer(
    name="tilefab",
    help="Prints stone on ceramic tile: a different, re-creatable face on every tile of a run.",
    epilog="Exit codes: 0 done, 2 wrong usage, 3 job file, 4 image, 5 profile, 6 texture can't be grown, 7 texture-map "
    "file, 8 output, 9 report, 10 device, 11 journal, 1 refused by the system, "
    "70 a defect of tilefab, 130 interrupted.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
job_app = typer.Typer(help="Job files: check one.", no_args_is_help=True)
app.add_typer(job_app, name="job")
app.add_typer(maps.app, name="map")
app.add_typer(profile.app, name="profile")
app.add_typer(line.app, name="line")
app.add_typer(texture.app, name="texture")
line.app.command("inspect")(line_inspect.inspect)
line.app.command("inspected")(line_report.inspected)
line.app.command("report")(line_report.report)
app.command("synth")(synth.synth)
app.command("inspect")(tiles.inspect)
app.command("trace")(tiles.trace)


def _version(show: bool) -> None:
    if show:
        typer.echo(f"tilefab {tilefab.__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and leave.")
    ] = False,
) -> None:
    """Prints stone on ceramic tile: a different, re-creatable face on every tile of a run."""


@job_app.command("check")
def job_check(job: JobArgument, out: OutOption = None, as_json: JsonOption = False) -> None:
    """Check a job file and everything it names; print the resolved job, or every problem at once."""
    try:
        plan = planned_job(job, out)
    except TilefabError as error:
        if not as_json:
            raise
        problems = error.problems if isinstance(error, ConfigError) else [Problem(str(job), None, "", error.message)]
        print_json({"valid": False, "problems": [dataclasses.asdict(p) for p in problems]})
        raise typer.Exit(error.exit_code) from error
    if as_json:
        print_json({"valid": True, **plan_facts(plan)})
    else:
        show_plan(plan)


@app.command("run")
def run(
    job: JobArgument,
    faces: Annotated[
        str | None,
        typer.Option(
            metavar="A:B", help="Faces to make: A to B - 1, single ones, or several with commas. [default: all]"
        ),
    ] = None,
    out: OutOption = None,
    threads: ThreadsOption = None,
    verify: Annotated[bool, typer.Option("--verify", help="Also compare faces that are there already.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Make the faces of a job, with manifest and report. A run that was stopped goes on where it stopped."""
    plan = planned_job(job, out)
    try:
        indices = parse_faces(faces, plan.job.tile.count)
    except ConfigError as error:
        raise typer.BadParameter(error.message) from error
    with Bars() as bars:
        outcome = do_job(plan, indices, bars, created=datetime.now(), threads=threads, verify=verify)
    facts = outcome_facts(outcome)
    if as_json:
        print_json(facts)
    else:
        show_outcome(facts)


@app.command("face")
def face(
    job: JobArgument,
    index: Annotated[str, typer.Argument(metavar="INDEX", help="Number of the face, or the text of its code.")],
    output: FileOption,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Re-create one face: print data if FILE ends in .tif, its fired look if in .png or .jpg."""
    plan = planned_job(job, out)
    number = face_number(plan, index)
    check_target(plan, output)
    with Bars() as bars:
        maps = job_maps(plan, bars, threads)
        if parse_face_code(index) is not None:
            check_face_code(plan, maps.press, index)
        kind = write_face(plan, maps, number, output, threads)
    region = face_region(plan, maps.press, number)
    facts = {
        "face": number,
        "file": str(output),
        "kind": kind,
        "origin": [region.row, region.col],
        "rows": region.rows,
        "cols": region.cols,
        "code": face_code(plan, maps.press, number),
    }
    if as_json:
        print_json(facts)
    else:
        typer.echo(f"{output}: face {number} ({kind}), {region.cols} x {region.rows} pixels")


@app.command("wall")
def wall(
    job: JobArgument,
    rows: Annotated[int, typer.Option(min=1, max=1000, help="Tiles from top to bottom.")],
    cols: Annotated[int, typer.Option(min=1, max=1000, help="Tiles from left to right.")],
    output: FileOption,
    first: Annotated[int, typer.Option(min=0, help="Face at the top left.")] = 0,
    size_px: Annotated[int, typer.Option(min=16, max=30000, help="Longer side of the picture, about.")] = 4000,
    grout_mm: Annotated[float, typer.Option(min=0, max=50, help="Width of the joints.")] = 2.0,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Picture of a wall of many faces in their fired colours (.png, .jpg or .tif)."""
    plan = planned_job(job, out)
    if wall_index(plan, rows - 1, cols - 1, cols, first) >= FACE_LIMIT:
        raise typer.BadParameter("the last face of this wall would be beyond 2**40 - 1; use a smaller --first")
    check_preview_path(output)
    check_target(plan, output)
    with Bars() as bars:
        maps = job_maps(plan, bars, threads)
        picture = render_wall(
            plan,
            proof_map(plan, maps.press, threads),
            rows,
            cols,
            first=first,
            largest_side_px=size_px,
            grout_mm=grout_mm,
            threads=threads,
            progress=lambda share: bars.stage("Laying the wall", share),
        )
        dpi = picture.shape[1] / (cols * plan.tile_mm.width / 25.4)
        write_preview(output, picture, dpi)
    if as_json:
        print_json({"file": str(output), "rows": picture.shape[0], "cols": picture.shape[1], "tiles": [rows, cols]})
    else:
        typer.echo(f"{output}: {rows} x {cols} tiles, {picture.shape[1]} x {picture.shape[0]} pixels")


@app.command("report")
def report(
    job: JobArgument,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="PDF to write, instead of the job's own.")
    ] = None,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw the PDF report of a run anew."""
    plan = planned_job(job, out)
    with Bars() as bars:
        path = write_report(plan, bars, created=datetime.now(), path=output, threads=threads)
    if as_json:
        print_json({"report": str(path)})
    else:
        typer.echo(str(path))


def main() -> None:
    """Entry point: run a command, explain errors in a line each, and end with a documented exit code."""
    try:
        app()
    except TilefabError as error:
        typer.echo("\n".join(f"error: {line}" for line in error.message.splitlines()), err=True)
        sys.exit(error.exit_code)
    except StoppedEarly:
        raise
    except SystemExit as end:
        # Typer ends an interrupted command itself, without a word.
        if end.code == INTERRUPTED:
            typer.echo(INTERRUPTED_NOTE, err=True)
        raise
    except KeyboardInterrupt:
        typer.echo(INTERRUPTED_NOTE, err=True)
        sys.exit(INTERRUPTED)
    except (MemoryError, OSError) as error:
        typer.echo(f"error: {str(error) or 'out of memory'}", err=True)
        sys.exit(REFUSED)
    except Exception as error:
        traceback.print_exc()
        typer.echo(f"error: a defect of tilefab, please report it with the lines above: {error!r}", err=True)
        sys.exit(UNEXPECTED)
