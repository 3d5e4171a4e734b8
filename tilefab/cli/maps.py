"""``tilefab map``: texture maps, built, looked into, reviewed and traced."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

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
from tilefab.cli.show import show_map
from tilefab.errors import ConfigError
from tilefab.io.texture_map_file import load_texture_map
from tilefab.pipeline.describe import map_facts
from tilefab.pipeline.faces import check_target
from tilefab.pipeline.maps import texture_map, texture_map_path
from tilefab.pipeline.review import check_sheet_path, write_review
from tilefab.pipeline.run_report import job_warnings
from tilefab.pipeline.trace import point_px, trace_face

app = typer.Typer(help="Texture maps: build them, look into them, choose from them.", no_args_is_help=True)


@app.command("build")
def map_build(
    job: JobArgument, out: OutOption = None, threads: ThreadsOption = None, as_json: JsonOption = False
) -> None:
    """Build a job's texture map, or find it built, in the run's folder."""
    plan = planned_job(job, out)
    with Bars() as bars:
        built = texture_map(plan, bars, threads, must_keep=True)
    facts = map_facts(built, texture_map_path(plan))
    if as_json:
        print_json({**facts, "warnings": job_warnings(built)})
    else:
        show_map(facts, job_warnings(built))


@app.command("info")
def map_info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Texture-map file (.tfmap).")],
    as_json: JsonOption = False,
) -> None:
    """Check a texture-map file and show what is in it."""
    loaded = load_texture_map(file)
    facts = map_facts(loaded, file)
    if as_json:
        print_json(facts)
    else:
        show_map(facts, ())


@app.command("review")
def map_review(
    job: JobArgument,
    output: FileOption = Path("review.html"),
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Draw a sheet of a map's crops or patches with their costs, to drop or keep some by hand (.html or .png)."""
    plan = planned_job(job, out)
    check_sheet_path(output)
    check_target(plan, output)
    with Bars() as bars:
        built = texture_map(plan, bars, threads)
        write_review(plan, built, output, bars, threads)
    if as_json:
        print_json({"file": str(output), "design": built.design, "texture_map": built.hash})
    else:
        typer.echo(str(output))


@app.command("trace")
def map_trace(
    job: JobArgument,
    face: Annotated[str, typer.Option(metavar="INDEX", help="Number of the face, or the text of its code.")],
    at: Annotated[
        str | None, typer.Option(metavar="X,Y", help="Point in millimetres from the tile's upper left corner.")
    ] = None,
    px: Annotated[str | None, typer.Option(metavar="X,Y", help="The same in pixels.")] = None,
    out: OutOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Tell which scan, and where on it, a point of a face was taken from."""
    plan = planned_job(job, out)
    text = at if at is not None else px
    if text is None or (at is not None and px is not None):
        raise typer.BadParameter("say where, with either --at X,Y in millimetres or --px X,Y in pixels")
    number = face_number(plan, face)
    try:
        x_px, y_px = point_px(plan, text, in_mm=at is not None)
    except ConfigError as error:
        raise typer.BadParameter(error.message) from error
    with Bars() as bars:
        found = trace_face(plan, texture_map(plan, bars, threads), number, x_px, y_px)
    if as_json:
        print_json(asdict(found))
    elif found.slab is None or found.slab_mm is None:
        typer.echo(f"face {number}: pixel {found.base_px[0]}, {found.base_px[1]} of the map")
    else:
        crop = f", crop {found.crop}" if found.crop is not None else ""
        typer.echo(
            f"{found.slab.name}: {found.slab_mm[0]:g}, {found.slab_mm[1]:g} mm from the upper left corner of the "
            f"prepared slab, pixel {found.slab_px}{crop}"
        )
