"""Keeping the use of an exemplar uniform: what a place costs, by how often its pixels are shown already.

Kaspar et al. 2015, 3.2: the occurrence of a pixel (Eq. 3), what it would be if all were shown equally often (Eq. 4),
and a price in proportion (Eq. 5, 6). From here: the price also adds up over the iterations, like a controller's
integral part, until the use is even; and showing a place again at a shift at which much of the result repeats itself
costs too, or the best arrangement of an exemplar would be to tile it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.synthesis.patch_kernels import PATCH_PX, count_shifts
from tilefab.synthesis.pyramid import STEPS_PER_UNIT
from tilefab.types import Mask

PATCH_UNIT = PATCH_PX * PATCH_PX * STEPS_PER_UNIT * STEPS_PER_UNIT
"""Squared steps over a patch whose pixels all differ by one unit of CIELAB: prices are given in it."""
CROWDED = 2
"""How many times its share of the result a place may be shown (Kaspar et al. 2015, 3.2)."""
_LEAST_PRICE, _GREATEST_PRICE = -200.0, 200.0
_SMALLEST_OVERLAP = 0.3
_ORDINARY_VARIANCE = 250.0
_NEAR = 2


@dataclass(frozen=True)
class UsageOptions:
    """How dear it is to show a place often; in squared units of CIELAB, mean over a patch.

    Attributes
    ----------
    price
        Of a place shown as often as its share: lambda of Eq. 5.
    barrier, barrier_share
        What it costs beside to show a place more often than this many times its share, for each further time.
    gain
        By how much the price rises with each iteration for a place shown twice as often as its share.
    again
        Price of a shift at which all of the result shows the same again, in proportion beyond ``chance``.
    chance
        Share of the result that may be the same again at any shift.
    """

    price: float = 30.0
    barrier: float = 200.0
    barrier_share: float = 1.1
    gain: float = 1.0
    again: float = 500.0
    chance: float = 0.02

    def for_contrast(self, image: NDArray[np.int16], valid: Mask) -> UsageOptions:
        """Prices lower in proportion for an exemplar of less contrast than most stones, whose patches differ by less.

        Parameters
        ----------
        image
            (rows, cols, 4) int16, the finest scale; its three colours count.
        valid
            (rows, cols), True where it may be used.
        """
        variance = float(image[valid][:, :-1].astype(np.float64).var(axis=0).sum()) / STEPS_PER_UNIT**2
        # In proportion to contrast, not to its square: else faint stones were shown unevenly.
        share = round(min(1.0, math.sqrt(variance / _ORDINARY_VARIANCE)), 3)
        return replace(
            self,
            price=self.price * share,
            barrier=self.barrier * share,
            gain=self.gain * share,
            again=self.again * share,
        )


@dataclass(frozen=True, eq=False)
class Prices:
    """What `tilefab.synthesis.patch_kernels.search` is told of the use of the exemplar; see there."""

    price: NDArray[np.int64]
    crowd: NDArray[np.int64]
    most: int


@dataclass(frozen=True, eq=False)
class Shifts:
    """Which patches show each place, and what showing one again costs; see `again_price`."""

    starts: NDArray[np.int64]
    order: NDArray[np.int64]
    price: NDArray[np.int64]


NO_SHIFTS = Shifts(np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros((1, 1), dtype=np.int64))
"""Nothing is priced."""


class Usage:
    """The use of one scale of an exemplar, as it changes.

    Parameters
    ----------
    allowed
        (rows, cols), True where a patch may begin.
    options
        Prices.
    coarser
        Of the coarser scale before: what had been added to prices there is where this one begins.
    """

    def __init__(self, allowed: Mask, options: UsageOptions, coarser: Usage | None = None) -> None:
        self._options = options
        self._shape = allowed.shape
        self._allowed = allowed
        covered = window_counts(allowed.astype(np.int64))
        self._usable_px = int(np.count_nonzero(covered))
        self._added = np.zeros(allowed.shape)
        if coarser is not None:
            # The last row at which a patch fits stays the last one.
            rows, cols = (
                np.minimum(np.arange(fine) * (coarse - PATCH_PX + 1) // (fine - PATCH_PX + 1), coarse - PATCH_PX)
                for fine, coarse in zip(allowed.shape, coarser._shape, strict=True)
            )
            self._added = coarser._added[rows[:, np.newaxis], cols]

    def prices(self, field: NDArray[np.int32], *, raise_prices: bool) -> Prices:
        """Prices for the next pass, given the places shown now; ``raise_prices``: an iteration begins."""
        options = self._options
        occurrence = self.occurrence(field)
        crowd = window_means_of(occurrence)
        # Eq. 4, for a field of any stride: patches x pixels of a patch, spread over what is usable.
        fair = field.size * PATCH_PX * PATCH_PX / self._usable_px
        share = crowd / (fair * PATCH_PX * PATCH_PX)
        if raise_prices and options.gain > 0:
            self._added = np.clip(self._added + options.gain * (share - 1.0), _LEAST_PRICE, _GREATEST_PRICE)
        price = options.price * share + options.barrier * np.maximum(share - options.barrier_share, 0.0) + self._added
        price -= price[self._allowed].min()
        return Prices(
            np.rint(price * PATCH_UNIT).astype(np.int64).ravel(),
            crowd.ravel(),
            int(CROWDED * fair * PATCH_PX * PATCH_PX),
        )

    def occurrence(self, field: NDArray[np.int32]) -> NDArray[np.int64]:
        """How many patches show each pixel of the exemplar (Eq. 3)."""
        counts = np.bincount(field.ravel(), minlength=self._shape[0] * self._shape[1]).astype(np.int64)
        return window_counts(counts.reshape(self._shape))

    def shifts(self, field: NDArray[np.int32]) -> Shifts:
        """At which shifts the result shows the same again, priced."""
        flat = field.ravel()
        order = np.argsort(flat, kind="stable").astype(np.int64)
        starts = np.zeros(self._shape[0] * self._shape[1] + 1, dtype=np.int64)
        np.cumsum(np.bincount(flat, minlength=len(starts) - 1), out=starts[1:])
        rows, cols = field.shape
        counts = np.zeros((rows, 2 * cols + 1), dtype=np.int64)
        count_shifts(starts, order, cols, counts)
        # Pieces that moved by a pixel against each other still look alike.
        near = ndimage.convolve(counts, np.ones((3, 3), dtype=np.int64), mode="constant")
        overlap = (rows - np.arange(rows))[:, np.newaxis] * (cols - np.abs(np.arange(2 * cols + 1) - cols))
        share = near / np.maximum(overlap, _SMALLEST_OVERLAP * field.size)
        share[: _NEAR + 1, cols - _NEAR : cols + _NEAR + 1] = 0.0
        price = np.maximum(share - self._options.chance, 0.0) * self._options.again
        return Shifts(starts, order, np.rint(price * PATCH_UNIT).astype(np.int64))


def window_counts(begins: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many patches cover each pixel, given how many begin at each: (rows, cols) to (rows, cols)."""
    padded = np.pad(begins, ((PATCH_PX, 0), (PATCH_PX, 0)))
    total = padded.cumsum(axis=0).cumsum(axis=1)
    return _differences(total)


def window_means_of(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sum over the patch that begins at each pixel, beyond the edge nothing: (rows, cols) to (rows, cols) (Eq. 6)."""
    padded = np.pad(values, ((1, PATCH_PX - 1), (1, PATCH_PX - 1)))
    return _differences(padded.cumsum(axis=0).cumsum(axis=1))


def _differences(total: NDArray[np.int64]) -> NDArray[np.int64]:
    n = PATCH_PX
    return np.asarray(total[n:, n:] - total[:-n, n:] - total[n:, :-n] + total[:-n, :-n])
