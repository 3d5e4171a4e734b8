"""How firing differs from normal: slow drifts that are set, a random walk of everything, heat and time of a tile."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

_KNOT_S = 300.0
_HOUR_S = 3600.0
# What a line shows over weeks, as `sim.kiln.drift_of_size` has it: together a mean CIEDE2000 of about a half.
_USUAL = {
    "peak_offset_degc": 4.0,
    "soak_offset_min": 2.0,
    "moisture_offset_percent": 0.6,
    "oxygen_offset_percent": 1.0,
    "glaze_tint": 0.006,
}
_USUAL_INK_FRAC = 0.03
_USUAL_DELTA_E = 0.5

QUANTITIES = dict(zip(("peak", "soak", "moisture", "oxygen", "glaze_tint"), _USUAL, strict=True))
"""Quantities that may drift, besides the strength of each ink: short names of those of `sim.kiln.Firing`."""


@dataclass(frozen=True)
class Laid:
    """What a tile brings from where it was printed; as in `sim.kiln.Firing`."""

    moisture_offset_percent: float
    glaze_tint: float
    ink_offset_frac: tuple[float, ...]


@dataclass(frozen=True)
class Fired:
    """How a tile was fired, each value as in `sim.kiln.Firing`, and when it was hottest (plant seconds)."""

    at: float
    peak_offset_degc: float
    soak_offset_min: float
    moisture_offset_percent: float
    oxygen_offset_percent: float
    glaze_tint: float
    ink_offset_frac: tuple[float, ...]

    def view(self) -> dict[str, Any]:
        """Its facts, ready for JSON."""
        return asdict(self)


@dataclass
class _Slope:
    """A value on its way to another, evenly."""

    t0: float = 0.0
    start: float = 0.0
    goal: float = 0.0
    seconds: float = 0.0

    def at(self, t: float) -> float:
        """The value at a time not before the last change."""
        share = min(1.0, (t - self.t0) / self.seconds) if self.seconds > 0 else 1.0
        return self.start + share * (self.goal - self.start)


class FiringDrift:
    """How printing and firing differ from normal, apart from what zones and firing time do.

    Times are handed in, in plant seconds, and never run backwards.

    Parameters
    ----------
    inks
        How many inks there are.
    walk_delta_e
        How far colours walk at random in an hour, about, CIEDE2000.
    seed
        Of the walk.
    """

    def __init__(self, inks: int, walk_delta_e: float, seed: int) -> None:
        self._inks = tuple(f"ink {ink}" for ink in range(inks))
        self._usual = _USUAL | dict.fromkeys(self._inks, _USUAL_INK_FRAC)
        self._slopes = {name: _Slope() for name in self._usual}
        self._walk = walk_delta_e
        self._seed = seed
        self._knot = 0
        self._before = dict.fromkeys(self._usual, 0.0)
        self._after = dict.fromkeys(self._usual, 0.0)
        self._step()

    def aim(self, t: float, values: Mapping[str, float], seconds: float) -> None:
        """From plant time `t` on quantities drift evenly to other values; those of inks are named by `ink_name`."""
        for name, value in values.items():
            self._slopes[name] = _Slope(t, self._slopes[name].at(t), value, seconds)

    def ink_name(self, ink: int) -> str:
        """Name of the strength of an ink.

        Raises
        ------
        ValueError
            If there is no such ink.
        """
        if not 0 <= ink < len(self._inks):
            raise ValueError(f"no ink {ink}: there are {len(self._inks)}, from 0 on")
        return self._inks[ink]

    def laid(self, t: float) -> Laid:
        """What a tile printed now brings with it."""
        now = self._now(t)
        return Laid(now["moisture_offset_percent"], now["glaze_tint"], tuple(round(now[ink], 6) for ink in self._inks))

    def fired(self, t: float, laid: Laid, hotter_degc: float, longer_min: float) -> Fired:
        """How a tile is fired that is hottest now.

        Parameters
        ----------
        laid
            What it brings.
        hotter_degc, longer_min
            By how much zones are hotter and the time at the peak is longer than normal.
        """
        now = self._now(t)
        return Fired(
            at=round(t, 3),
            peak_offset_degc=round(now["peak_offset_degc"] + hotter_degc, 4),
            soak_offset_min=round(now["soak_offset_min"] + longer_min, 4),
            moisture_offset_percent=round(laid.moisture_offset_percent, 4),
            oxygen_offset_percent=round(now["oxygen_offset_percent"], 4),
            glaze_tint=round(laid.glaze_tint, 6),
            ink_offset_frac=laid.ink_offset_frac,
        )

    def _now(self, t: float) -> dict[str, float]:
        while self._walk and t >= (self._knot + 1) * _KNOT_S:
            self._knot += 1
            self._before = self._after
            self._step()
        share = t / _KNOT_S - self._knot if self._walk else 0.0
        return {
            name: slope.at(t) + self._before[name] + share * (self._after[name] - self._before[name])
            for name, slope in self._slopes.items()
        }

    def _step(self) -> None:
        """Draw where the walk is at the next knot."""
        size = self._walk / _USUAL_DELTA_E * math.sqrt(_KNOT_S / _HOUR_S)
        chance = random.Random(f"walk:{self._seed}:{self._knot}")
        self._after = {
            name: value + size * self._usual[name] * chance.gauss(0.0, 1.0) for name, value in self._before.items()
        }
