"""The drift controller on a simulated line of one number: how near it comes to the least error that the delay allows.

Usage: python benchmarks/drift_control.py [--minutes N] [--seeds N] [--walks LIST] [--steps N]

A tile is fired every minute and measured at once; it was printed 55 minutes before. The press wanders at random, tiles
are measured with noise (0.3, as a colour difference). How fast it wanders is said by the gain that the best filter
settles at. The index is the mean square of the errors over that of the best filter of all, which knows noise and
wandering exactly, misses no tile, sees no outlier and may correct every minute. Errors count from the second day on,
but where it is said otherwise. The controller has the same settings everywhere, and begins with neither the press's
gain nor its wandering known. Beside it: an integrator that knows nothing of the delay, and an average that pairs each
tile with its own correction; both may correct every minute.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from figures import Figures
from machine import machine_name
from numpy.typing import NDArray

from tilefab.control.drift_control import ControlSettings, expected, start_control, step
from tilefab.control.drift_events import CorrectionApplied, Propose, TileMeasured

Float64Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]

DELAY_MIN = 55
NOISE = 0.3
SPREAD = 3.0
"""Of a fresh state; its unit is that of the noise."""

WARM_MIN = 1440
STEP_WARM_MIN = 700
STEP_AFTER_MIN = 250
STEP = 3.0
LEAST = 1.10
LEAST_WITH_GAIN = 1.35


@dataclass(frozen=True)
class Line:
    """What happens on a line, minute by minute.

    Attributes
    ----------
    drift, noise
        State of the press when each tile is fired, and error of measuring it.
    delay_min
        How long before its firing each tile was printed.
    late_min
        How long after its firing each tile is told of.
    measured
        Whether it is at all.
    wrong
        Gross error of a tile, mostly 0.
    gain
        What the press makes of a correction.
    """

    drift: Float64Array
    noise: Float64Array
    delay_min: Int64Array
    late_min: Int64Array
    measured: NDArray[np.bool_]
    wrong: Float64Array
    gain: float = 1.0


@dataclass(frozen=True)
class Trouble:
    """What is wrong with a line."""

    name: str
    to_reach: float | None = LEAST
    gain: float = 1.0
    missing: float = 0.0
    wrong: float = 0.0
    late: float = 0.0
    delay: Callable[[Int64Array, np.random.Generator], Int64Array] = field(
        default=lambda minutes, _: np.full(len(minutes), DELAY_MIN)
    )
    told_noise: float = 1.0
    interval_s: float | None = None
    first_min: int = WARM_MIN


def _swinging(minutes: Int64Array, _: np.random.Generator) -> Int64Array:
    return np.rint(DELAY_MIN + 20.0 * np.sin(minutes / 200.0)).astype(np.int64)


def _random(minutes: Int64Array, random: np.random.Generator) -> Int64Array:
    return random.integers(35, 76, len(minutes))


TROUBLES = (
    Trouble("none"),
    Trouble("press gain 0.6", LEAST_WITH_GAIN, gain=0.6),
    Trouble("press gain 1.5", LEAST_WITH_GAIN, gain=1.5),
    Trouble("press gain 0.6, the first day included", LEAST_WITH_GAIN, gain=0.6, first_min=2 * DELAY_MIN),
    Trouble("press gain 1.5, the first day included", LEAST_WITH_GAIN, gain=1.5, first_min=2 * DELAY_MIN),
    Trouble("30 % missing, 2 % gross outliers", missing=0.3, wrong=0.02),
    Trouble("a fifth late by up to 20 minutes, so out of order", late=0.2),
    Trouble("delay 35 minutes", delay=lambda minutes, _: np.full(len(minutes), 35)),
    Trouble("delay 75 minutes", delay=lambda minutes, _: np.full(len(minutes), 75)),
    Trouble("delay swinging between 35 and 75 minutes", delay=_swinging),
    Trouble("delay of each tile at random 35 to 75 minutes", delay=_random),
    Trouble(
        "swinging delay, late, missing, outliers at once", None, missing=0.3, wrong=0.02, late=0.2, delay=_swinging
    ),
    Trouble("noise told half as large as it is", told_noise=0.5),
    Trouble("noise told twice as large as it is", told_noise=2.0),
    Trouble("the same as none, a correction every 10 minutes", interval_s=600.0),
    Trouble("30 % missing, 2 % gross outliers, every 10 minutes", None, missing=0.3, wrong=0.02, interval_s=600.0),
)


def walk_variance(best_gain: float) -> float:
    """How much the press wanders in a minute, if the best filter settles at a gain."""
    return best_gain**2 / (1.0 - best_gain) * NOISE**2


def make_line(trouble: Trouble, minutes: int, wander: float, seed: int) -> Line:
    """A line with some trouble."""
    random = np.random.default_rng(seed)
    drift = np.cumsum(random.normal(0.0, math.sqrt(wander), minutes))
    noise = random.normal(0.0, NOISE, minutes)
    signs = random.choice([-1.0, 1.0], minutes)
    wrong = np.where(random.random(minutes) < trouble.wrong, signs * random.uniform(2.0, 12.0, minutes), 0.0)
    late = np.where(random.random(minutes) < trouble.late, random.integers(1, 21, minutes), 0)
    measured = random.random(minutes) >= trouble.missing
    delay = trouble.delay(np.arange(minutes), random)
    return Line(drift, noise, delay, late, measured, wrong, trouble.gain)


Controller = Callable[[int, int, float, float, int], float | None]
"""Told of a tile: minute, its own minute, error and correction in the state's unit, and number of that correction.
Gives a new correction, or None."""


def drift_controller(settings: ControlSettings, told_noise: float = 1.0) -> Controller:
    """The product's."""
    unit = np.eye(1)
    information = unit / (NOISE * told_noise) ** 2
    control = start_control(unit * SPREAD**2, now_s=0.0, settings=settings)
    corrections = 0

    def tile(minute: int, fired: int, error: float, correction: float, number: int) -> float | None:
        nonlocal control, corrections
        at = expected(control, number)
        vector = information @ (np.array([error + correction]) - at)
        event = TileMeasured(fired, number, 60.0 * fired, 60.0 * minute, at, information, vector, unit, unit)
        control, actions = step(control, event)
        new = None
        for action in actions:
            if isinstance(action, Propose):
                corrections += 1
                control, _ = step(control, CorrectionApplied(corrections, 60.0 * minute, action.mean))
                new = float(action.mean[0])
        return new

    return tile


def integrator(share: float) -> Controller:
    """Takes every error for one of the present correction."""
    total = 0.0

    def tile(_minute: int, _fired: int, error: float, _correction: float, _number: int) -> float:
        nonlocal total
        total += share * error
        return total

    return tile


def paired_average(share: float) -> Controller:
    """Averages what each tile says of the press, given its own correction."""
    mean = 0.0

    def tile(_minute: int, _fired: int, error: float, correction: float, _number: int) -> float:
        nonlocal mean
        mean += share * (error + correction - mean)
        return mean

    return tile


def run(line: Line, controller: Controller) -> Float64Array:
    """Errors of all tiles."""
    minutes = len(line.drift)
    told: list[list[int]] = [[] for _ in range(minutes)]
    for fired in range(minutes):
        at = fired + int(line.late_min[fired])
        if line.measured[fired] and at < minutes:
            told[at].append(fired)
    states = [0.0]
    used = np.zeros(minutes, dtype=np.int64)
    errors = np.empty(minutes)
    for minute in range(minutes):
        used[minute] = len(states) - 1
        printed = minute - int(line.delay_min[minute])
        errors[minute] = line.drift[minute] - line.gain * states[used[printed] if printed >= 0 else 0]
        for fired in told[minute]:
            printed = fired - int(line.delay_min[fired])
            number = int(used[printed]) if printed >= 0 else 0
            seen = float(errors[fired] + line.noise[fired] + line.wrong[fired])
            new = controller(minute, fired, seen, states[number], number)
            if new is not None:
                states.append(new)
    return errors


def least_errors(line: Line, wander: float) -> Float64Array:
    """Errors under the best filter, which is told of every tile at once; the first few are infinite."""
    minutes = len(line.drift)
    variance, mean = SPREAD**2, 0.0
    known = np.empty(minutes)
    for minute in range(minutes):
        variance += wander
        gain = variance / (variance + NOISE**2)
        mean += gain * (line.drift[minute] + line.noise[minute] - mean)
        variance *= 1.0 - gain
        known[minute] = mean
    printed = np.arange(minutes) - line.delay_min
    good = printed >= 1
    errors = np.full(minutes, np.inf)
    errors[good] = line.drift[good] - known[printed[good] - 1]
    return errors


def index_of(
    trouble: Trouble, best_gain: float, minutes: int, seeds: int, make: Callable[[], Controller]
) -> tuple[float, float]:
    """Index over some runs, and the mean square of the least errors over what theory says of it."""
    wander = walk_variance(best_gain)
    ours = least = 0.0
    for seed in range(seeds):
        line = make_line(trouble, minutes, wander, 100 + seed)
        ours += float((run(line, make())[trouble.first_min :] ** 2).sum())
        least += float((least_errors(line, wander)[trouble.first_min :] ** 2).sum())
    counted = seeds * (minutes - trouble.first_min)
    theory = best_gain * NOISE**2 + wander * (DELAY_MIN + 1)
    return ours / least, least / counted / theory


def settings_of(trouble: Trouble) -> ControlSettings:
    """The controller's own, but for what the trouble itself changes."""
    usual = ControlSettings()
    return usual if trouble.interval_s is None else replace(usual, least_interval_s=trouble.interval_s)


def response(
    make: Callable[[], Controller], best_gain: float, noise: float, runs: int, gain: float = 1.0
) -> tuple[float, float]:
    """A step's mean response: delays until less than a tenth of it is left for good, and overshoot as a share of it."""
    minutes = STEP_WARM_MIN + STEP_AFTER_MIN + 10
    wander = walk_variance(best_gain) * (noise / NOISE) ** 2
    total = np.zeros(STEP_AFTER_MIN)
    for seed in range(runs):
        begins = STEP_WARM_MIN + seed % 10
        random = np.random.default_rng(1000 + seed)
        walk = np.cumsum(random.normal(0.0, math.sqrt(wander), minutes))
        zeros = np.zeros(minutes, dtype=np.int64)
        line = Line(
            walk,
            random.normal(0.0, noise, minutes),
            zeros + DELAY_MIN,
            zeros,
            np.ones(minutes, dtype=np.bool_),
            np.zeros(minutes),
            gain,
        )
        stepped = replace(line, drift=walk + STEP * (np.arange(minutes) >= begins))
        moved = run(stepped, make()) - run(line, make())
        total += moved[begins : begins + STEP_AFTER_MIN] / (STEP * runs)
    left = np.flatnonzero(np.abs(total) > 0.1)
    return float(left[-1] + 1) / DELAY_MIN, float(max(-total.min(), 0.0))


def indices(figures: Figures, best_gain: float, minutes: int, seeds: int) -> None:
    """The table of indices of one speed of wandering."""
    figures.title(f"index; the best filter's gain is {best_gain:g}; {seeds} runs of {minutes} minutes")
    for trouble in TROUBLES:
        make = partial(drift_controller, settings_of(trouble), trouble.told_noise)
        value, least = index_of(trouble, best_gain, minutes, seeds, make)
        to_reach = None if trouble.to_reach is None else (trouble.to_reach,)
        # Theory is of a fixed delay of 55 minutes.
        note = f"[best filter: {least:.3f} of theory]" if trouble.name == "none" else ""
        figures.row(f"controller: {trouble.name}", (value,), to_reach, note)
    plain, wrong = TROUBLES[0], TROUBLES[5]
    for share in (0.01, 0.02, 0.03):
        value, _ = index_of(plain, best_gain, minutes, seeds, partial(integrator, share))
        figures.row(f"naive integrator, share {share:g}: none", (value,))
    for trouble in (plain, *TROUBLES[1:3], wrong):
        value, _ = index_of(trouble, best_gain, minutes, seeds, partial(paired_average, 0.2))
        figures.row(f"paired average, share 0.2: {trouble.name}", (value,))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=int, default=10_000, help="length of each run")
    parser.add_argument("--seeds", type=int, default=3, help="runs of each line")
    parser.add_argument("--walks", default="0.1,0.2,0.3", help="gains of the best filter, by commas")
    parser.add_argument("--steps", type=int, default=40, help="runs that a step's response is averaged over")
    arguments = parser.parse_args()
    if arguments.minutes < 2 * WARM_MIN:
        parser.error(f"--minutes must be {2 * WARM_MIN} or more")
    print(f"on {machine_name()}\nsettings of the controller: {ControlSettings()}")
    figures = Figures()
    walks = [float(text) for text in arguments.walks.split(",")]
    for best_gain in walks:
        indices(figures, best_gain, arguments.minutes, arguments.seeds)
    figures.title(f"step of {STEP:g}: delays to a tenth of it / overshoot; mean of {arguments.steps} runs")
    for best_gain in walks:
        for noise in (0.3, 0.6):
            found = response(partial(drift_controller, ControlSettings()), best_gain, noise, arguments.steps)
            figures.row(f"controller, noise {noise:g}, best gain {best_gain:g}", found, (1.25, 0.1))
    for gain in (0.6, 1.5):
        found = response(partial(drift_controller, ControlSettings()), 0.2, NOISE, arguments.steps, gain)
        figures.row(f"controller, press gain {gain:g}, not yet known", found)
    figures.row("paired average, share 0.2", response(partial(paired_average, 0.2), 0.2, NOISE, 10))
    figures.row("naive integrator, share 0.01", response(partial(integrator, 0.01), 0.2, NOISE, 10))
    figures.end()
    if figures.reached < figures.judged:
        sys.exit(1)


if __name__ == "__main__":
    main()
