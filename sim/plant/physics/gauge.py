"""The instrument at the kiln's exit: the colour of the tile that came out last."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

_BASE_LAB = (62.0, 3.0, 11.0)
_BEST_DEGC = 1180.0


@dataclass(frozen=True)
class Reading:
    """One reading: its number since boot, CIELAB, and which tile of all that came out."""

    number: int
    lab: tuple[float, float, float]
    tile: int


class Gauge:
    """Measures the last tile that came out whole; hotter firing darkens it.

    Parameters
    ----------
    seed
        Of the differences between tiles.
    """

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._lab: tuple[float, float, float] | None = None
        self.tiles = 0
        self.readings = 0
        self.up = True

    def power_up(self) -> None:
        """Start counting readings at 0."""
        self.up = True
        self.readings = 0

    def see(self, tile_id: int, degc: Sequence[float]) -> None:
        """A tile comes out of a kiln of these temperatures (°C)."""
        self.tiles += 1
        chance = random.Random(f"{self._seed}:{tile_id}")
        hot = sum(degc) / len(degc) - _BEST_DEGC
        lightness, a, b = (value + chance.gauss(0, 0.15) for value in _BASE_LAB)
        self._lab = (lightness - 0.01 * hot, a, b - 0.004 * hot)

    def measure(self) -> Reading | None:
        """Measure; None while nothing has come out."""
        if self._lab is None:
            return None
        self.readings += 1
        return Reading(self.readings, self._lab, self.tiles)
