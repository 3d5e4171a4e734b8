"""The output of `graphcut` while it grows: what lies where, what its seams cost, and how to lay a patch on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.synthesis.graphcut_flow import grid_cut
from tilefab.synthesis.graphcut_kernels import (
    ABOVE,
    BELOW,
    FREE,
    IGNORE,
    KEEP,
    LEFT,
    RIGHT,
    TAKE,
    UNSET,
    window_costs,
    window_graph,
)
from tilefab.types import Mask, SizePx

_OVERUSE = 1.25
_OVERUSE_PRICE = 6

PRICE_SHARE = 1 / 100
"""Showing a pixel once more costs this share of the mean seam per use."""


@dataclass(frozen=True, eq=False)
class Exemplar:
    """An exemplar, ready to be cut: see `graphcut_kernels.pair_cost`.

    Attributes
    ----------
    valid
        (rows, cols), True where it may be used.
    colours, known, gradients, floor, weights
        As `graphcut_kernels.pair_cost` takes them.
    """

    valid: Mask
    colours: NDArray[np.int16]
    known: NDArray[np.uint8]
    gradients: NDArray[np.int32]
    floor: int
    weights: NDArray[np.uint8]

    @classmethod
    def of(cls, base: NDArray[np.int16], valid: Mask, weights: NDArray[np.uint8] | None = None) -> Exemplar:
        """From a `matching_image`, its mask and its weights, if any.

        A seam costs half where the sum of the four gradients is four times the exemplar's mean gradient.
        """
        slopes = gradients(base)
        pixels = valid.size
        return cls(
            valid,
            base.reshape(pixels, -1),
            known_neighbours(valid).ravel(),
            slopes.reshape(2, pixels),
            max(1, int(4 * slopes[:, valid].sum()) // max(1, 2 * int(np.count_nonzero(valid)))),
            np.zeros(pixels, dtype=np.uint8) if weights is None else weights.ravel(),
        )

    def costs(self, source: NDArray[np.int32]) -> NDArray[np.int64]:
        """See `graphcut_kernels.window_costs`."""
        return window_costs(
            source, self.valid.shape[1], self.colours, self.known, self.gradients, self.floor, self.weights
        )


def gradients(base: NDArray[np.int16]) -> NDArray[np.int32]:
    """Gradient across and down at each pixel, (2, rows, cols) int32: Sobel's operator, the norm over the channels."""
    squares = np.zeros((2, *base.shape[:2]), dtype=np.int64)
    for channel in np.moveaxis(base.astype(np.int64), 2, 0):
        squares += [ndimage.sobel(channel, axis=axis, mode="nearest") ** 2 for axis in (1, 0)]
    # Square roots are rounded correctly by every processor, so these integers are the same everywhere.
    return np.rint(np.sqrt(squares.astype(np.float64))).astype(np.int32)


def known_neighbours(valid: Mask) -> NDArray[np.uint8]:
    """Which neighbours of each pixel exist and are valid, (rows, cols): bits of `graphcut_kernels`."""
    known = np.zeros(valid.shape, dtype=np.uint8)
    known[:, :-1] |= np.where(valid[:, 1:], RIGHT, 0).astype(np.uint8)
    known[:-1] |= np.where(valid[1:], BELOW, 0).astype(np.uint8)
    known[:, 1:] |= np.where(valid[:, :-1], LEFT, 0).astype(np.uint8)
    known[1:] |= np.where(valid[:-1], ABOVE, 0).astype(np.uint8)
    return known


@dataclass(frozen=True)
class Placement:
    """A patch and where it may be laid.

    Attributes
    ----------
    row, col
        First pixel of the window in the output.
    from_row, from_col
        First pixel of the patch in the exemplar.
    rows, cols
        Size of both.
    """

    row: int
    col: int
    from_row: int
    from_col: int
    rows: int
    cols: int


@dataclass(frozen=True, eq=False)
class Trial:
    """A patch cut to what lies around it, not yet laid.

    Attributes
    ----------
    placement
        Where.
    shown
        (rows + 2, cols + 2) int32: the source map of the window and of the pixels around it.
    costs
        Likewise, what its seams would cost; see `graphcut_kernels.window_costs`.
    taken
        Likewise, where the patch would be shown.
    price
        Sum of ``costs``, and what the use of the exemplar costs.
    """

    placement: Placement
    shown: NDArray[np.int32]
    costs: NDArray[np.int64]
    taken: Mask
    price: int


class Canvas:
    """A source map that is being filled.

    Parameters
    ----------
    exemplar
        What it is filled from.
    size
        Its size.
    toroidal
        Whether its last row and column lie beside its first.

    Attributes
    ----------
    source
        (rows, cols) int32, `UNSET` where nothing lies.
    costs
        (rows, cols) int64, cost of the seams right of and below each pixel.
    prices
        (exemplar rows, exemplar cols) int64: for each pixel, how often it is shown, and once more for each time beyond
        its due, dearer.
    """

    def __init__(self, exemplar: Exemplar, size: SizePx, toroidal: bool) -> None:
        self.exemplar, self.size, self.toroidal = exemplar, size, toroidal
        self.source = np.full((size.rows, size.cols), UNSET, dtype=np.int32)
        self.costs = np.zeros(self.source.shape, dtype=np.int64)
        self.prices = np.zeros(exemplar.valid.shape, dtype=np.int64)
        self._usage = np.zeros(exemplar.valid.size, dtype=np.int64)
        self._due = max(1, int(_OVERUSE * self.source.size) // int(np.count_nonzero(exemplar.valid)))
        self._total_cost = self._seam_px = 0

    @property
    def use_price(self) -> int:
        """What showing a pixel of the exemplar costs for each step of `prices`."""
        return int(PRICE_SHARE * self._total_cost) // max(1, self._seam_px)

    def window(self, row: int, col: int, rows: int, cols: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Index of a window; beyond an edge it goes on at the other."""
        down = (row + np.arange(rows, dtype=np.int64)) % self.size.rows
        return down[:, None], ((col + np.arange(cols, dtype=np.int64)) % self.size.cols)[None, :]

    def around(self, at: Placement) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], Mask]:
        """Index of a window with the pixels around it, and which of those there are, and not twice."""
        there = np.ones((at.rows + 2, at.cols + 2), dtype=bool)
        if self.toroidal:
            if at.rows + 2 > self.size.rows:
                there[0] = there[-1] = False
            if at.cols + 2 > self.size.cols:
                there[:, 0] = there[:, -1] = False
        else:
            there[0] &= at.row > 0
            there[-1] &= at.row + at.rows < self.size.rows
            there[:, 0] &= at.col > 0
            there[:, -1] &= at.col + at.cols < self.size.cols
        return self.window(at.row - 1, at.col - 1, at.rows + 2, at.cols + 2), there

    def cost_around(self, at: Placement) -> int:
        """What the seams in and around a window cost now, counted as in `Trial.price`."""
        index, there = self.around(at)
        return int(self.exemplar.costs(np.where(there, self.source[index], UNSET)).sum())

    def try_patch(self, at: Placement) -> Trial:
        """Cut a patch along the cheapest seam to what lies in and around its window.

        All old seams there are weighed against new ones: the patch is shown where that costs least altogether, which
        may be nowhere but where nothing lies yet (Kwatra et al. 2003, sections 3.1 and 3.2).
        """
        exemplar, cols = self.exemplar, self.exemplar.valid.shape[1]
        index, there = self.around(at)
        shown = np.where(there, self.source[index], UNSET)
        flat = (at.from_row + np.arange(at.rows))[:, None] * cols + at.from_col + np.arange(at.cols)
        usable = exemplar.valid.ravel()[flat]
        labels = np.where(shown == UNSET, IGNORE, KEEP).astype(np.uint8)
        inside = labels[1:-1, 1:-1]
        labels[1:-1, 1:-1] = np.where(usable, np.where(inside == KEEP, FREE, TAKE), inside)
        prices = np.zeros(shown.shape, dtype=np.int64)
        steps = self.prices.ravel()
        prices[1:-1, 1:-1] = self.use_price * (steps[flat] - steps[np.maximum(shown[1:-1, 1:-1], 0)])
        capacities, terminals = window_graph(
            shown,
            labels,
            (at.from_row - 1) * cols + at.from_col - 1,
            prices,
            cols,
            exemplar.colours,
            exemplar.known,
            exemplar.gradients,
            exemplar.floor,
            exemplar.weights,
        )
        cut = grid_cut(capacities, terminals, at.cols + 4).reshape(at.rows + 4, at.cols + 4)
        taken = (cut[1:-1, 1:-1] & (labels == FREE)) | (labels == TAKE)
        shown[1:-1, 1:-1] = np.where(taken[1:-1, 1:-1], flat, shown[1:-1, 1:-1])
        costs = exemplar.costs(shown)
        return Trial(at, shown, costs, taken, int(costs.sum()) + int(prices[taken & (labels == FREE)].sum()))

    def lay(self, trial: Trial) -> None:
        """Lay a patch that was tried; nothing in or around its window may have changed since."""
        at = trial.placement
        window = self.window(at.row, at.col, at.rows, at.cols)
        taken = trial.taken[1:-1, 1:-1]
        self._count_use(self.source[window][taken], trial.shown[1:-1, 1:-1][taken])
        self.source[window] = trial.shown[1:-1, 1:-1]
        index, there = self.around(at)
        if self.toroidal and not there.all():
            # The window is so large that its seams with itself, around the torus, weren't counted.
            self.costs = self.exemplar.costs(np.pad(self.source, (0, 1), mode="wrap"))[:-1, :-1]
            self._total_cost, self._seam_px = int(self.costs.sum()), int(np.count_nonzero(self.costs))
            return
        # Right of and below the window too little is seen to count by.
        there[-1] = there[:, -1] = False
        counted = np.nonzero(there)
        places = index[0][counted[0], 0], index[1][0, counted[1]]
        old, new = self.costs[places], trial.costs[counted]
        self.costs[places] = new
        self._total_cost += int(new.sum()) - int(old.sum())
        self._seam_px += int(np.count_nonzero(new)) - int(np.count_nonzero(old))

    def _count_use(self, old: NDArray[np.int32], new: NDArray[np.int32]) -> None:
        old = old[old != UNSET]
        np.subtract.at(self._usage, old, 1)
        np.add.at(self._usage, new, 1)
        prices = self.prices.reshape(-1)
        for changed in (old, new):
            usage = self._usage[changed]
            prices[changed] = usage + _OVERUSE_PRICE * np.maximum(usage - self._due, 0)

    def with_rest(self, rest: Placement) -> NDArray[np.int32]:
        """The source map with copies of a patch where nothing lies yet."""
        rows, cols = (np.arange(n) % m for n, m in zip(self.source.shape, (rest.rows, rest.cols), strict=True))
        tiles = (rest.from_row + rows)[:, None] * self.exemplar.valid.shape[1] + rest.from_col + cols
        return np.where(self.source == UNSET, tiles, self.source).astype(np.int32)
