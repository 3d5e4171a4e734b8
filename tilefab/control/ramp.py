"""Kiln set-points from where they are to where a recipe wants them, within what ware and bricks stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_S_PER_MIN = 60.0


@dataclass(frozen=True)
class RampLimits:
    """What a kiln may be asked for.

    Attributes
    ----------
    lowest_degc, highest_degc
        Bounds of a set-point.
    ramp_degc_min
        How fast a set-point may move, up or down, in degrees a minute.
    """

    lowest_degc: float
    highest_degc: float
    ramp_degc_min: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lowest_degc) and self.lowest_degc < self.highest_degc < math.inf):
            raise ValueError(f"no set-point lies between {self.lowest_degc} and {self.highest_degc} °C")
        if not 0 < self.ramp_degc_min < math.inf:
            raise ValueError(f"a ramp of {self.ramp_degc_min} °C/min leads nowhere")


def set_point_problem(target: Sequence[float], limits: RampLimits) -> str:
    """What is wrong with set-points that are asked for; empty if nothing is.

    >>> set_point_problem([900.0, 1300.0], RampLimits(20, 1250, 5))
    'zone 2: 1300 °C is outside 20 .. 1250 °C'
    """
    for zone, wanted in enumerate(target, start=1):
        if not limits.lowest_degc <= wanted <= limits.highest_degc:  # also false for NaN
            return f"zone {zone}: {wanted:g} °C is outside {limits.lowest_degc:g} .. {limits.highest_degc:g} °C"
    return ""


def next_set_points(
    now: Sequence[float], target: Sequence[float], elapsed_s: float, limits: RampLimits
) -> tuple[float, ...]:
    """Set-points to command next; zones move together, so that each has done the same share of its way.

    Parameters
    ----------
    now
        Set-points of each zone as they are, degrees Celsius. Outside the limits they may be: then they move inwards.
    target
        Where they are to be, within the limits.
    elapsed_s
        Time since they were moved last, seconds; the slowest zone moves at most ``elapsed_s`` times the ramp.
    limits
        Bounds and ramp.

    Returns
    -------
    tuple of float
        ``target`` itself, exactly, once it can be reached.

    Raises
    ------
    ValueError
        If the zones don't match, the target is outside the limits, or a value isn't finite.

    >>> next_set_points([1000.0, 900.0], [1100.0, 950.0], 60.0, RampLimits(20, 1250, 10))
    (1010.0, 905.0)
    """
    if len(now) != len(target) or not now:
        raise ValueError(f"set-points of {len(now)} zones can't become those of {len(target)}")
    if not all(math.isfinite(value) for value in now) or not 0 <= elapsed_s < math.inf:
        raise ValueError("set-points and elapsed time must be finite, time not negative")
    problem = set_point_problem(target, limits)
    if problem:
        raise ValueError(problem)
    farthest = max(abs(wanted - here) for here, wanted in zip(now, target, strict=True))
    reach = limits.ramp_degc_min * elapsed_s / _S_PER_MIN
    if farthest <= reach:
        return tuple(float(wanted) for wanted in target)
    share = reach / farthest
    return tuple(here + share * (wanted - here) for here, wanted in zip(now, target, strict=True))


def ramp_minutes(now: Sequence[float], target: Sequence[float], limits: RampLimits) -> float:
    """Minutes that set-points need to get from here to there."""
    farthest = max((abs(wanted - here) for here, wanted in zip(now, target, strict=True)), default=0.0)
    return farthest / limits.ramp_degc_min
