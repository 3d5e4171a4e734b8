"""What the commands share: their arguments and options, and how they read and print."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from tilefab.config import load_job
from tilefab.pipeline.faces import code_is_of, parse_face_code
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.sampling.layout import FACE_LIMIT

JobArgument = Annotated[Path, typer.Argument(metavar="JOB", help="Job file (TOML).")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON, for programs.")]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Folder of the run, instead of the job's own.")
]
ThreadsOption = Annotated[
    int | None, typer.Option("--threads", min=1, help="Threads to use; never changes a pixel. [default: all cores]")
]
FileOption = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")]


def planned_job(job: Path, out: Path | None) -> Plan:
    """Read a job file and find and check all that it names."""
    return plan_job(load_job(job), out)


def face_number(plan: Plan, text: str) -> int:
    """Face that an operator names by its number or by the text of its code."""
    code = parse_face_code(text)
    if code is not None:
        if not code_is_of(plan, code):
            raise typer.BadParameter("this code was made by another job, or by this job with other settings")
        text = str(code.index)
    if not text.isascii() or not text.isdigit() or len(text) > 40 or int(text) >= FACE_LIMIT:
        raise typer.BadParameter(f"{text!r} is neither a face number (0 .. 2**40 - 1) nor the text of a face's code")
    return int(text)


def print_json(value: Any) -> None:
    """Print a result for programs."""
    typer.echo(json.dumps(value, indent=2, ensure_ascii=False, default=str))
