"""The closed loop in colours: production tiles of a drifting press correct it, and no chart is printed.

Usage: python benchmarks/closed_loop.py [--presses NAMES] [--hours H] [--grid N] [--intents NAMES]

A spectral press is profiled from a chart, and a job of warm grey gravel is printed on it, a tile a minute. A tile is
fired 55 minutes after it was printed. The kiln and the inks wander all the time, and two hours in the press makes a
step of ΔE 3. Of each tile 400 regions are measured with noise, a cast of each tile among it, one tile in fifty has
another tile's colours; what they say of the drift goes to the controller, and with each of its corrections the job's
print data are made anew, as the line does it: a press map in inks from the pipeline's own tables.

Printed are differences (CIEDE2000) of regions as they are fired, without noise, from the colours that the job promises:
what the profile says that its first print data look like. "Undrifted" is the press as it was profiled.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from figures import Figures, mean_p95
from machine import machine_name
from numpy.typing import NDArray

from sim.kiln import Firing, drift_of_size
from sim.spectral_press import SpectralPress
from tilefab.chart.design import design_chart
from tilefab.colour import absolute_lab, lab_from_xyz, xyz_from_lab
from tilefab.colour.drift import DriftState, no_drift
from tilefab.colour.drift_evidence import drift_evidence
from tilefab.colour.encoding import decode_lab16
from tilefab.colour.press_model import PressModel
from tilefab.config import load_job
from tilefab.control.drift_control import DriftControl, expected, start_control, step
from tilefab.control.drift_events import Action, CorrectionApplied, Innovation, Propose, StepSeen, TileMeasured
from tilefab.io.cgats_write import measurements_text
from tilefab.io.drift_file import DriftFile
from tilefab.pipeline import press_tables
from tilefab.pipeline.carried import carried_press
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.faces import face_region
from tilefab.pipeline.maps import convert_map, texture_map
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.profiling import ProfileSettings, build_profile
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap, render_points

Float64Array = NDArray[np.float64]

PATCHES = {"ceramic4": 800, "ceramic6": 1000}
LIMIT_PERCENT = 260.0
CHART_NOISE = 0.3
DELAY_MIN = 55
STEP_HOURS = 2.0
STEP_DELTA_E = 3.0
SETTLED_HOURS = STEP_HOURS + 2.0
REGIONS, SIDE = 20, 4
REGION_NOISE, TILE_NOISE = 0.5, 0.2
WRONG_SHARE = 0.02
WALK = np.array([4.0, 2.0, 0.6, 1.0, 0.006])
INK_WALK = 0.03
WALK_PER_HOUR = 0.5
"""Share of what drifts in weeks that the press wanders by in an hour."""

ABOVE = 0.5

_JOB = """\
schema_version = 1
[slab]
scans = ["package:skimage/data/gravel.png"]
dpi = 50
target_lab = [62.0, 3.0, 11.0]
[texture]
design = "crops"
seed = 20261124
[tile]
size_mm = [150, 150]
dpi = 60
count = 100000
[colour]
press_profile = "press.icc"
intent = "{intent}"
ink_limit_percent = 260
[output]
directory = "out"
bits = 8
[report]
pdf = false
"""


@dataclass(frozen=True, eq=False)
class Job:
    """A job on a press, and what is needed to print, fire and measure its tiles.

    Attributes
    ----------
    press
        Of the simulator.
    plan, texture, model
        The job, its texture map, and the press model that its profile carries.
    places
        A map that shows where in the base each pixel comes from.
    """

    press: SpectralPress
    plan: Plan
    texture: TextureMap
    model: PressModel
    places: TextureMap

    def pixels(self, face: int) -> NDArray[np.intp]:
        """(regions, pixels): places in the base of small squares of a face, evenly over it."""
        region = face_region(self.plan, self.texture, face)
        first = np.linspace(0, min(region.rows, region.cols) - SIDE, REGIONS).astype(np.int64)
        inner = (first[:, np.newaxis] + np.arange(SIDE)).reshape(-1)
        rows, cols = (grid.reshape(-1) for grid in np.meshgrid(inner, inner, indexing="ij"))
        found = render_points(self.places, region.row + rows, region.col + cols, seed=self.plan.seed)[:, 0]
        squares = found.reshape(REGIONS, SIDE, REGIONS, SIDE).transpose(0, 2, 1, 3)
        return np.asarray(squares.reshape(REGIONS * REGIONS, SIDE * SIDE), dtype=np.intp)

    def ink_frac(self, plan: Plan) -> Float64Array:
        """(places, N) inks of the base, as the line prints them."""
        counts = convert_map(plan, self.texture, Silent()).base
        return np.asarray(counts.reshape(-1, counts.shape[2]) / np.iinfo(counts.dtype).max, dtype=np.float64)

    def promised(self, inks: Float64Array) -> Float64Array:
        """(places, 3) absolute Lab that the profile says of inks."""
        convert, white = press_tables.fired_colours(self.plan, np.uint8)
        counts = np.rint(inks * 255.0).astype(np.uint8)[np.newaxis]
        return absolute_lab(decode_lab16(convert(counts))[0].astype(np.float64), white)


def fired(press: SpectralPress, inks: Float64Array, firing: Firing | None) -> Float64Array:
    """Regions' mean colours (regions, 3) as they are fired, of inks (regions, pixels, N)."""
    regions, pixels, channels = inks.shape
    recipes, which = np.unique(inks.reshape(-1, channels), axis=0, return_inverse=True)
    xyz = xyz_from_lab(press.lab(recipes, firing))[which.reshape(-1)]
    return lab_from_xyz(xyz.reshape(regions, pixels, 3).mean(axis=1))


def even(lab: Float64Array) -> Float64Array:
    """Mean colours (regions, 3) of pixels (regions, pixels, 3)."""
    return lab_from_xyz(xyz_from_lab(lab).mean(axis=1))


def firings(press: SpectralPress, minutes: int, seed: int) -> Iterator[Firing]:
    """How the press fires, minute by minute: it wanders, and once makes a step."""
    random = np.random.default_rng(seed)
    inks = len(press.ink_names)
    jump = drift_of_size(press, random, STEP_DELTA_E)
    stepped = np.array(
        [
            jump.peak_offset_degc,
            jump.soak_offset_min,
            jump.moisture_offset_percent,
            jump.oxygen_offset_percent,
            jump.glaze_tint,
            *jump.ink_offset_frac,
        ]
    )
    rate = np.concatenate([WALK, np.full(inks, INK_WALK)]) * WALK_PER_HOUR / np.sqrt(60.0)
    at = np.zeros(5 + inks)
    for minute in range(minutes):
        at = at + rate * random.standard_normal(5 + inks)
        peak, soak, moisture, oxygen, tint, *ink = at + stepped * (minute >= 60.0 * STEP_HOURS)
        yield Firing(peak, soak, moisture, oxygen, tint, tuple(ink))


def make_job(name: str, intent: str, folder: Path, grid: int) -> Job:
    """Profile a press, and plan a job on it."""
    press = SpectralPress(name)
    inks = len(press.ink_names)
    black = press.ink_names.index("Black")
    chart = design_chart(inks, PATCHES[name], total_limit_percent=280.0, black_channel=black, seed=31)
    recipes = chart.ink_percent / 100.0
    read = press.lab(recipes) + np.random.default_rng(40).normal(0.0, CHART_NOISE, (len(recipes), 3))
    text = measurements_text(recipes, read, ink_names=press.ink_names, description=name, created="2026-11-24")
    (folder / "press.ti3").write_text(text, encoding="utf-8")
    build_profile(folder / "press.ti3", folder / "press.icc", ProfileSettings(LIMIT_PERCENT, backward_grid=grid))
    (folder / "job.toml").write_text(_JOB.format(intent=intent), encoding="utf-8")
    plan = plan_job(load_job(folder / "job.toml"))
    texture = texture_map(plan, Silent())
    shape = texture.base.shape[:2]
    where = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(*shape, 1)
    places = texture.with_base(where, space="place", channels=("place",))
    return Job(press, plan, texture, carried_press(plan.press_profile)[0].model, places)


@dataclass
class Loop:
    """The controller with its corrections."""

    job: Job
    inks: list[Float64Array]
    predicted: list[Float64Array]
    control: DriftControl
    tiles: int = 0
    steps: int = 0
    rejected: int = 0
    evidence_s: float = 0.0
    conversion_s: list[float] = field(default_factory=list)

    def tell(self, minute: int, number: int, pixels: NDArray[np.intp], lab: Float64Array) -> None:
        """The tile that was fired in a minute was measured: places of its regions, and their colours (regions, 3)."""
        inks = self.job.model.inks
        began = time.process_time()
        ink_frac = self.inks[number][pixels].mean(axis=1)
        # A region's mean colour isn't the colour of its mean inks.
        lab = lab - even(self.predicted[number][pixels]) + self.job.model.lab(ink_frac)
        at = expected(self.control, number)
        state = DriftState(at, no_drift(inks).covariance, inks)
        found = drift_evidence(self.job.model, state, ink_frac, lab, REGION_NOISE)
        event = TileMeasured(
            minute,
            number,
            60.0 * minute,
            60.0 * minute,
            found.at,
            found.information,
            found.vector,
            found.effect,
            found.watch,
            found.misfit,
        )
        self.control, actions = step(self.control, event)
        self.evidence_s += time.process_time() - began
        self.tiles += 1
        for action in actions:
            self._act(minute, action)

    def _act(self, minute: int, action: Action) -> None:
        if isinstance(action, StepSeen):
            self.steps += 1
        elif isinstance(action, Innovation):
            self.rejected += not action.accepted
        elif isinstance(action, Propose):
            job = self.job
            began = time.process_time()
            state = DriftState(action.mean, action.covariance, job.model.inks)
            profile = job.plan.press_profile
            drift = DriftFile(state, profile.ink_names, profile.sha256, self.tiles, action.reason)
            sha256 = hashlib.sha256(action.mean.tobytes()).hexdigest()
            self.inks.append(job.ink_frac(corrected_plan(job.plan, drift, sha256)))
            self.predicted.append(job.promised(self.inks[-1]))
            self.conversion_s.append(time.process_time() - began)
            applied = CorrectionApplied(len(self.inks) - 1, 60.0 * minute, action.mean)
            self.control, _ = step(self.control, applied)


def one_run(figures: Figures, job: Job, title: str, hours: float, seed: int) -> None:
    """A run of some hours."""
    inks = job.model.inks
    first = job.ink_frac(job.plan)
    promised = job.promised(first)
    loop = Loop(job, [first], [promised], start_control(no_drift(inks).covariance, now_s=0.0))
    minutes = round(60 * hours)
    random = np.random.default_rng(seed + 1)
    used = np.zeros(minutes, dtype=np.int64)
    rows: list[tuple[float, float, float]] = []
    figures.title(f"{title}: hour by hour, mean: undrifted / open loop / closed loop")
    for minute, firing in enumerate(firings(job.press, minutes, seed)):
        used[minute] = len(loop.inks) - 1
        number = int(used[minute - DELAY_MIN]) if minute >= DELAY_MIN else 0
        pixels = job.pixels(minute)
        wanted = even(promised[pixels])
        printed = loop.inks[number][pixels]
        shown = fired(job.press, printed, firing)
        rows.append(
            (
                mean_p95(fired(job.press, first[pixels], None), wanted)[0],
                mean_p95(fired(job.press, first[pixels], firing), wanted)[0],
                mean_p95(shown, wanted)[0],
            )
        )
        seen = shown if random.random() >= WRONG_SHARE else shown[random.permutation(len(shown))]
        seen = seen + random.normal(0.0, REGION_NOISE, seen.shape) + random.normal(0.0, TILE_NOISE, 3)
        loop.tell(minute, number, pixels, seen)
        if (minute + 1) % 60 == 0:
            figures.row(f"hour {(minute + 1) // 60}", tuple(np.array(rows[-60:]).mean(axis=0)))
    table = np.array(rows)
    settled = table[round(60 * SETTLED_HOURS) :].mean(axis=0)
    figures.row(f"{title}: open loop above undrifted, settled", (settled[1] - settled[0],))
    figures.row(f"{title}: closed loop above undrifted, settled", (settled[2] - settled[0],), (ABOVE,))
    after = table[round(60 * STEP_HOURS + 1.25 * DELAY_MIN) :][:60].mean(axis=0)
    figures.row(f"{title}: the same in the hour from 1.25 delays after the step", (after[2] - after[0],), (ABOVE,))
    figures.note(
        f"{title}: corrections, steps seen, tiles not believed", f"{len(loop.inks) - 1}, {loop.steps}, {loop.rejected}"
    )
    figures.note(
        f"{title}: CPU time",
        f"evidence and control {1000.0 * loop.evidence_s / loop.tiles:.0f} ms a tile, "
        f"conversion {np.mean(loop.conversion_s):.1f} s a correction",
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presses", default="ceramic4,ceramic6", help="which, by commas")
    parser.add_argument("--intents", default="perceptual", help="rendering intents of the job, by commas")
    parser.add_argument("--hours", type=float, default=8.0, help="length of a run")
    parser.add_argument("--grid", type=int, default=17, help="nodes of the conversion for each of L*, a*, b*; line: 33")
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    if arguments.hours < SETTLED_HOURS + 1.0:
        parser.error(f"--hours must be {SETTLED_HOURS + 1.0:g} or more")
    print(f"on {machine_name()}\ndifferences are CIEDE2000")
    press_tables.BACKWARD_GRID = arguments.grid
    figures = Figures()
    for name in arguments.presses.split(","):
        if name not in PATCHES:
            parser.error(f"no press is called {name}: choose of {', '.join(PATCHES)}")
        for intent in arguments.intents.split(","):
            with tempfile.TemporaryDirectory(prefix="tilefab-bench-") as folder:
                job = make_job(name, intent, Path(folder), arguments.grid)
                one_run(figures, job, f"{name}, {intent}", arguments.hours, arguments.seed)
    figures.end()
    if figures.reached < figures.judged:
        sys.exit(1)


if __name__ == "__main__":
    main()
