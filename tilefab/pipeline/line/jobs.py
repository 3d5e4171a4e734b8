"""Jobs of a line: the one being printed, and those that come after it."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import dataclass
from pathlib import Path

from tilefab.config import load_job
from tilefab.config.line import LineFile, Recipe
from tilefab.control.tile_tracking import TileShape
from tilefab.devices import PrinterIdentity
from tilefab.errors import ConfigError, InterlockError, OutputError
from tilefab.io.journal import RunFacts
from tilefab.pipeline.line.conveyor_loop import BeltSettings
from tilefab.pipeline.line.kiln_loop import KilnRecipe
from tilefab.pipeline.line.printer_loop import PrintJob
from tilefab.pipeline.line.source import FaceSource, open_source
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.progress import Silent
from tilefab.units import MM_PER_INCH

_MAKER = "import os; os.nice(10); from tilefab.cli.main import main; main()"
"""Makes maps with what the line leaves of the processors."""


@dataclass(frozen=True)
class LineJob:
    """A job with the recipe that it is printed with.

    Attributes
    ----------
    plan
        The job.
    recipe_name, recipe
        From the line's file.
    """

    plan: Plan
    recipe_name: str
    recipe: Recipe

    @property
    def belt(self) -> BeltSettings:
        """What it asks of the belt: tiles travel along their height, as faces' rows do."""
        length = self.plan.tile_mm.height
        return BeltSettings(self.recipe.belt_speed_mm_s, length, length + self.recipe.tile_gap_mm)

    @property
    def kiln(self) -> KilnRecipe:
        """What it asks of the kiln."""
        wanted = self.recipe.kiln_set_points_degc
        return KilnRecipe(None if wanted is None else tuple(wanted), self.recipe.cycle_min)

    def run_facts(self, source: FaceSource) -> RunFacts:
        """What the journal puts down of it."""
        return RunFacts(
            job_hash=self.plan.job_hash,
            name=self.plan.name,
            job_file=str(self.plan.job_file.path),
            faces=self.plan.job.tile.count,
            seed=self.plan.seed,
            map_hash=source.maps.press.hash,
        )


def line_job(plan: Plan, line_file: LineFile) -> LineJob:
    """Find the recipe of a job.

    Raises
    ------
    ConfigError
        If the line has no such recipe.
    """
    name = plan.job.line.recipe
    recipe = line_file.line.recipes.get(name)
    if recipe is None:
        known = ", ".join(sorted(line_file.line.recipes)) or "none"
        message = f"the line {line_file.path} has no recipe {name!r}, but: {known}"
        raise ConfigError([plan.job_file.problem("line", "recipe", message)])
    return LineJob(plan, name, recipe)


def check_printer(source: FaceSource, identity: PrinterIdentity) -> None:
    """Make sure that a printer can print a job.

    Raises
    ------
    InterlockError
        If it has other inks, or takes other data.
    """
    if (identity.inks, identity.bits) != (source.channels, source.bits):
        raise InterlockError(
            f"{source.plan.name} has {source.channels} inks of {source.bits} bits, the printer {identity.inks} of "
            f"{identity.bits}: choose another press profile, or set bits in [output]",
            device="printer",
        )


def print_job(job: LineJob, source: FaceSource, identity: PrinterIdentity) -> PrintJob:
    """Faces of a job in the printer's own counts."""
    counts_per_row = MM_PER_INCH / job.plan.job.tile.dpi * identity.counts_per_mm
    belt = job.belt
    return PrintJob(
        rows=source.size.rows,
        cols=source.size.cols,
        channels=source.channels,
        bits=source.bits,
        row_pitch_millicounts=round(counts_per_row * 1000),
        bleed_counts=round(job.plan.bleed_px * counts_per_row),
        shape=TileShape(
            length_counts=round(belt.tile_length_mm * identity.counts_per_mm),
            pitch_counts=round(belt.tile_pitch_mm * identity.counts_per_mm),
        ),
    )


async def prepare_job(path: Path, line_file: LineFile) -> LineJob:
    """Check a job that is to be printed later, and make its maps, in a process of its own.

    Making maps keeps a processor busy for minutes; in the daemon's own process that would hold up the line.

    Raises
    ------
    ConfigError, ImageError, ProfileError
        If the job can't be printed.
    OutputError
        If its maps can't be made.
    """
    job = line_job(await asyncio.to_thread(lambda: plan_job(load_job(path))), line_file)
    try:
        maker = await asyncio.create_subprocess_exec(
            sys.executable,
            "-c",
            _MAKER,
            "map",
            "build",
            str(path),
            "--json",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
        )
    except OSError as error:
        raise OutputError(f"{path}: its maps can't be made: {error.strerror}", path=str(path)) from error
    try:
        _, told = await maker.communicate()
    except asyncio.CancelledError:
        maker.kill()
        await maker.wait()
        raise
    if maker.returncode:
        last = told.decode(errors="replace").strip().splitlines()[-1:] or [f"it ended with code {maker.returncode}"]
        raise OutputError(f"{path}: its maps can't be made: {last[0].removeprefix('error: ')}", path=str(path))
    return job


def open_job(job: LineJob, strip_rows: int) -> FaceSource:
    """Open the faces of a prepared job; blocking."""
    return open_source(job.plan, Silent(), strip_rows)
