"""The kiln: how a firing differs from the normal one, and random drifts of a wanted size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.inks import Spectrum
from sim.instrument import delta_e_2000

_RECIPES = 1000
_TOLERANCE = 0.002
_STEPS = 40


@dataclass(frozen=True)
class Firing:
    """How a firing differs from the normal one; all zero is the normal one.

    Attributes
    ----------
    peak_offset_degc
        Peak temperature above the normal one, kelvin: hotter fades inks, moves their bands and yellows the glaze.
    soak_offset_min
        Time at the peak above the normal one, minutes: longer fades inks, in other shares than heat does.
    moisture_offset_percent
        Moisture of the body before printing above the normal one, percent points: drops spread further.
    oxygen_offset_percent
        Oxygen in the kiln above the normal one, percent points: less of it turns hues brownish.
    glaze_tint
        Yellow absorbance of the glaze above the normal one, log10 units.
    ink_offset_frac
        Each ink's strength above the normal one, as a share (a new batch, a weak head); empty for none.
    """

    peak_offset_degc: float = 0.0
    soak_offset_min: float = 0.0
    moisture_offset_percent: float = 0.0
    oxygen_offset_percent: float = 0.0
    glaze_tint: float = 0.0
    ink_offset_frac: tuple[float, ...] = ()


class FiredPress(Protocol):
    """What a drift needs of a press."""

    @property
    def ink_names(self) -> tuple[str, ...]:
        """Ink names in channel order."""

    def lab(self, ink_frac: NDArray[np.floating], firing: Firing | None = None) -> Spectrum:
        """Absolute Lab under D50, (P, 3), of recipes (P, N)."""


def random_recipes(
    inks: int, count: int, generator: np.random.Generator, limit_frac: float = 3.0
) -> NDArray[np.float64]:
    """Uniformly random recipes, (count, inks) ink fractions, each sum at most a limit.

    Recipes above the limit are drawn again up to four inks. With more inks nearly all would be, so they are
    scaled down to a random total below the limit instead.
    """
    if inks > 4:
        recipes = generator.random((count, inks))
        total = recipes.sum(axis=1)
        wanted = np.where(total > limit_frac, limit_frac * np.sqrt(generator.random(count)), total)
        return np.asarray(recipes * (wanted / total)[:, np.newaxis], dtype=np.float64)
    kept = np.empty((0, inks))
    while len(kept) < count:
        recipes = generator.random((2 * count, inks))
        kept = np.vstack([kept, recipes[recipes.sum(axis=1) <= limit_frac]])
    return kept[:count]


def drift_of_size(press: FiredPress, generator: np.random.Generator, delta_e: float) -> Firing:
    """A firing drifted in a random direction until recipes differ by a wanted mean colour difference.

    Parameters
    ----------
    press
        The press.
    generator
        Source of the direction, and of the random recipes that the difference is averaged over.
    delta_e
        Wanted mean CIEDE2000 from the normal firing, more than 0 and at most 8; met within 1 %.

    Returns
    -------
    Firing

    Raises
    ------
    ValueError
        If the size is out of range.
    """
    if not 0.0 < delta_e <= 8.0:
        raise ValueError(f"delta_e {delta_e} is outside 0 .. 8")
    inks = len(press.ink_names)
    # About what a line shows over weeks, relative to each other: 4 K, 2 min, 0.6 points, 1 point, 0.006, 3 %.
    direction = generator.standard_normal(5 + inks) * np.array([4.0, 2.0, 0.6, 1.0, 0.006] + [0.03] * inks)
    recipes = random_recipes(inks, _RECIPES, generator)
    normal = press.lab(recipes)

    def firing(size: float) -> Firing:
        peak, soak, moisture, oxygen, tint, *ink = (float(value) for value in size * direction)
        return Firing(peak, soak, moisture, oxygen, tint, tuple(ink))

    # The difference grows almost in proportion to the size, so scaling by what is missing converges at once.
    size = 1.0
    for _ in range(_STEPS):
        drifted = firing(size)
        reached = float(delta_e_2000(normal, press.lab(recipes, drifted)).mean())
        if abs(reached / delta_e - 1.0) < _TOLERANCE:
            return drifted
        size *= delta_e / reached
    raise ValueError(f"no drift of mean {delta_e} found in this direction")
