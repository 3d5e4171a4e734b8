"""The main job: faces, then the report, then what the operator should know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tilefab.io.manifest import Manifest
from tilefab.pipeline.colour_facts import colour_facts
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.run import RunResult, run_job
from tilefab.pipeline.run_report import job_warnings, preparation_log, write_report
from tilefab.report import ColourView


@dataclass(frozen=True)
class JobOutcome:
    """What became of a job.

    Attributes
    ----------
    run
        The faces.
    report
        The PDF, or ``None`` if the job wants none.
    preparation
        What was done to the slab: (step, sentence).
    warnings
        What the operator should know before using the faces.
    colour
        How near the print comes to the stone, and the ink that it takes.
    """

    run: RunResult
    report: Path | None
    preparation: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    colour: ColourView


def do_job(
    plan: Plan,
    indices: Sequence[int],
    progress: Progress,
    *,
    created: datetime,
    threads: int | None = None,
    verify: bool = False,
) -> JobOutcome:
    """Make faces and report on them; see `run_job` and `write_report` for what may go wrong.

    Parameters
    ----------
    plan, indices, progress, threads, verify
        See `run_job`.
    created
        Date and time that the report shows.
    """
    result = run_job(plan, indices, progress, threads=threads, verify=verify)
    # Report and warnings speak of all the faces in the folder, and measure their colours once.
    colour = colour_facts(plan, result.maps, sorted(Manifest(plan.output).records))
    report = None
    if plan.job.report.pdf is not False:
        report = write_report(plan, progress, created=created, threads=threads, maps=result.maps, colour=colour)
    texture = result.maps.texture
    return JobOutcome(result, report, preparation_log(texture), job_warnings(texture, colour), colour)
