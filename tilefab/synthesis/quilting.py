"""Image quilting on a torus (Efros and Freeman 2001, "Image quilting for texture synthesis and transfer").

Overlapping square blocks of the exemplar are laid in reading order, each chosen among those that agree best with
what already lies there, and cut to it along the seam of least colour difference. Here the output has no edges: the
last block of a row also has to agree with the first, and the last row with the first. The first seed, 5.5.1, makes
its repeatable tile so.

Two things differ from the paper. The seam is a minimum cut instead of one path a side, because a block may be
surrounded. And blocks from places already much used cost more, so that one part of a stone doesn't recur.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab import rng
from tilefab.texture.matching import (
    LAB_STEPS_PER_UNIT,
    TemplateSearch,
    matching_image,
    reduced,
    reduced_mask,
    refine_place,
    window_is_valid,
    window_sums,
)
from tilefab.texture.seams import FREE, KEEP, TAKE, UNKNOWN_COST, cut
from tilefab.types import Mask, SizePx

MIN_EXEMPLAR_PX = 24
_MAX_SEARCH_AREA_PX = 1 << 20
_OVERLAP_SHARE = 3
_TOLERANCE = 0.1
_USAGE_PRICE = 0.5
_UNSET = -1


@dataclass(frozen=True)
class Quilt:
    """A quilted tile.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    worst_seam_delta_e, mean_seam_delta_e
        Colour difference (CIE76) between the two pieces along the seams, at the worst pixel and on average.
    block_px, overlap_px
        Block size used and how far blocks overlap.
    """

    source: NDArray[np.int32]
    worst_seam_delta_e: float
    mean_seam_delta_e: float
    block_px: int
    overlap_px: int


def quilt_torus(
    exemplar_lab_d50: NDArray[np.float32],
    valid: Mask,
    size: SizePx,
    seed: int,
    *,
    block_px: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Quilt:
    """Quilt a tile that repeats seamlessly in both directions.

    Parameters
    ----------
    exemplar_lab_d50
        (rows, cols, 3) CIELAB (D50).
    valid
        (rows, cols), True where the exemplar may be used.
    size
        Size of the tile.
    seed
        0 <= seed < 2**63; the same arguments always give the same tile.
    block_px
        Side of a block. Default: a quarter of the exemplar's smaller side, between 24 and 512.
    progress
        Called with the share done, 0 to 1.

    Raises
    ------
    ValueError
        If no whole block of valid exemplar exists, or the tile is smaller than a block.
    """
    base = matching_image(exemplar_lab_d50)
    smaller_px = min(*valid.shape, size.rows, size.cols)
    block = block_px or max(MIN_EXEMPLAR_PX, min(512, smaller_px // 4))
    block = min(block, smaller_px)
    if block < 8:
        raise ValueError(f"exemplar {valid.shape} or tile {size} is too small to quilt: blocks need 8 pixels")
    allowed = window_is_valid(valid, block, block)
    while not allowed.any() and block > 8:
        block = max(8, block * 3 // 4)
        allowed = window_is_valid(valid, block, block)
    if not allowed.any():
        raise ValueError("the exemplar has no usable square of 8 x 8 pixels: its mask leaves too little")
    overlap = max(3, block // _OVERLAP_SHARE)
    factor = 1
    while valid.size > _MAX_SEARCH_AREA_PX * factor * factor and block >= 16 * factor:
        factor *= 2
    quilter = _Quilter(base, valid, allowed, size, block, factor, seed)
    rows = _block_starts(size.rows, block, overlap)
    cols = _block_starts(size.cols, block, overlap)
    for i, row in enumerate(rows):
        for j, col in enumerate(cols):
            quilter.lay(row, col)
            if progress is not None:
                progress((i * len(cols) + j + 1) / (2 * len(rows) * len(cols)))
    repairs = 2 * len(rows) * len(cols)
    for k in range(repairs):
        quilter.repair()
        if progress is not None:
            progress((1 + (k + 1) / repairs) / 2)
    worst, mean = _seam_cost(base, quilter.source)
    return Quilt(quilter.source, worst, mean, block, overlap)


def _block_starts(length: int, block: int, overlap: int) -> list[int]:
    """First pixel of each block so that every neighbour, also across the wrap, overlaps by at least ``overlap``."""
    count = max(1, -(-length // (block - overlap)))
    return [i * length // count for i in range(count)]


class _Quilter:
    def __init__(
        self,
        base: NDArray[np.int16],
        valid: Mask,
        allowed: Mask,
        size: SizePx,
        block: int,
        factor: int,
        seed: int,
    ) -> None:
        self.base, self.allowed, self.block, self.factor = base, allowed, block, factor
        self.source = np.full((size.rows, size.cols), _UNSET, dtype=np.int32)
        self.lab = np.zeros((size.rows, size.cols, 3), dtype=np.int16)
        self.random = rng.generator(seed, "quilting")
        self.search = TemplateSearch(reduced(base, factor))
        coarse_block = block // factor
        self.coarse_allowed = window_is_valid(reduced_mask(valid, factor), coarse_block, coarse_block)
        if not self.coarse_allowed.any():
            self.coarse_allowed = np.zeros_like(self.coarse_allowed)
            places = np.argwhere(allowed) // factor
            places = np.minimum(places, np.array(self.coarse_allowed.shape) - 1)
            self.coarse_allowed[places[:, 0], places[:, 1]] = True
        self.usage = np.zeros(self.search.shape, dtype=np.int64)
        self._rim = np.ones((block, block), dtype=bool)
        self._rim[1:-1, 1:-1] = False
        self._core = np.ix_([block // 2 - 1, block // 2], [block // 2 - 1, block // 2])
        # Bad places are looked for, and given up, on a grid of this many pixels.
        self._grain = max(2, block // 8)
        self._hopeless = np.zeros((-(-size.rows // self._grain), -(-size.cols // self._grain)), dtype=bool)
        self._jumps: NDArray[np.float64] | None = None

    def lay(self, row: int, col: int) -> None:
        """Choose a block for the place (row, col) of the tile, cut it to its neighbours and lay it."""
        window = self._window(row, col)
        filled = self.source[window] != _UNSET
        there = self.lab[window]
        base_row, base_col = self._choose(there, filled)
        labels = np.where(filled, FREE, TAKE).astype(np.uint8)
        labels[self._rim & filled] = KEEP
        labels[self._core] = TAKE
        self.source[window], self.lab[window] = self._cut_in(there, window, base_row, base_col, labels)

    def repair(self) -> None:
        """Lay one more block over the place with the worst seams, and leave it if they get better by it.

        This is the refinement of Kwatra et al. 2003, section 3.2. A place tried in vain isn't tried again.
        """
        if self._jumps is None:
            self._jumps = _seam_jumps(self.base, self.source)
        jumps, block, grain = self._jumps, self.block, self._grain
        sums = np.add.reduceat(
            np.add.reduceat(jumps, np.arange(0, jumps.shape[0], grain), axis=0),
            np.arange(0, jumps.shape[1], grain),
            axis=1,
        )
        local = ndimage.uniform_filter(sums, size=max(3, block // (2 * grain)), mode="wrap")
        local[self._hopeless] = -1.0
        worst_row, worst_col = np.unravel_index(int(local.argmax()), local.shape)
        self._hopeless[worst_row, worst_col] = True
        at_row, at_col = int(worst_row) * grain + grain // 2, int(worst_col) * grain + grain // 2
        window = self._window(at_row - block // 2, at_col - block // 2)
        there = self.lab[window]
        ring = np.ones((block, block), dtype=bool)
        ring[block // 4 : -(block // 4), block // 4 : -(block // 4)] = False
        base_row, base_col = self._choose(there, ring)
        labels = np.full((block, block), FREE, dtype=np.uint8)
        labels[self._rim] = KEEP
        inner = slice(block * 3 // 8, block - block * 3 // 8)
        labels[inner, inner] = TAKE
        source, lab = self._cut_in(there, window, base_row, base_col, labels)
        around = self._window(at_row - block // 2 - 1, at_col - block // 2 - 1, block + 2)
        before = float(jumps[around][:-1, :-1].sum())
        patched = self.source[around].copy()
        patched[1:-1, 1:-1] = source
        after = _seam_jumps(self.base, patched)[:-1, :-1]
        if float(after.sum()) < before:
            self.source[window], self.lab[window] = source, lab
            jumps[self._window(at_row - block // 2 - 1, at_col - block // 2 - 1, block + 1)] = after
            self._hopeless[np.unique(window[0] // grain)[:, None], np.unique(window[1] // grain)] = False

    def _window(self, row: int, col: int, side: int | None = None) -> tuple[NDArray[np.int64], ...]:
        steps = np.arange(side or self.block)
        return np.ix_((row + steps) % self.source.shape[0], (col + steps) % self.source.shape[1])

    def _cut_in(
        self,
        there: NDArray[np.int16],
        window: tuple[NDArray[np.int64], ...],
        base_row: int,
        base_col: int,
        labels: NDArray[np.uint8],
    ) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        block, old = self.block, self.source[window]
        piece = self.base[base_row : base_row + block, base_col : base_col + block]
        squared = ((piece.astype(np.int64) - there) ** 2).sum(axis=2)
        # What the piece already there would have shown beyond its end isn't known: a cut along that end is dear.
        take = cut(np.where(old != _UNSET, squared, UNKNOWN_COST), labels)
        flat = (base_row + np.arange(block))[:, None] * self.base.shape[1] + base_col + np.arange(block)
        return np.where(take, flat, old).astype(np.int32), np.where(take[..., None], piece, there)

    def _choose(self, there: NDArray[np.int16], filled: Mask) -> tuple[int, int]:
        factor, n = self.factor, self.block // self.factor
        if not filled.any():
            places = np.argwhere(self.allowed)
            place = places[int(self.random.integers(len(places)))]
            self._count_usage(int(place[0]) // factor, int(place[1]) // factor)
            return int(place[0]), int(place[1])
        template, mask = reduced(there, factor), reduced_mask(filled, factor)
        sums = self.search.squared_differences(template, mask).astype(np.float64)
        sums = sums[: self.coarse_allowed.shape[0], : self.coarse_allowed.shape[1]]
        allowed = self.coarse_allowed[: sums.shape[0], : sums.shape[1]]
        scale = max(float(sums[allowed].min()), float(np.count_nonzero(mask)))
        price = sums + _USAGE_PRICE * scale * self._mean_usage(n)[: sums.shape[0], : sums.shape[1]]
        price[~allowed] = np.inf
        best = float(price.min())
        candidates = np.flatnonzero(price <= best + _TOLERANCE * max(best, 1.0))
        chosen = int(candidates[int(self.random.integers(len(candidates)))])
        coarse_row, coarse_col = divmod(chosen, price.shape[1])
        self._count_usage(coarse_row, coarse_col)
        if factor == 1:
            return coarse_row, coarse_col
        row, col, _ = refine_place(
            self.base, there, filled, self.allowed, coarse_row * factor, coarse_col * factor, factor
        )
        if row < 0:
            distance = np.abs(np.argwhere(self.allowed) - [coarse_row * factor, coarse_col * factor]).max(axis=1)
            place = np.argwhere(self.allowed)[int(distance.argmin())]
            return int(place[0]), int(place[1])
        return row, col

    def _count_usage(self, row: int, col: int) -> None:
        n = self.block // self.factor
        self.usage[row : row + n, col : col + n] += 1

    def _mean_usage(self, n: int) -> NDArray[np.float64]:
        return window_sums(self.usage, n, n) / (n * n)


def _seam_jumps(base: NDArray[np.int16], source: NDArray[np.int32]) -> NDArray[np.float64]:
    """Cost of the seams right of and below each pixel, (rows, cols): squared colour steps, 0 where there is none.

    On either side of a seam one piece shows a colour and the other would have shown another: the cost is the mean of
    the two squared differences (Kwatra et al. 2003, Eq. 1, squared). The window's last row and column are compared
    with what follows them around the torus.
    """
    flat = base.reshape(-1, base.shape[2]).astype(np.float64)
    total = np.zeros(source.shape)
    for axis, step in ((0, base.shape[1]), (1, 1)):
        neighbour = np.roll(source, -1, axis=axis)
        seam = neighbour != source + step
        here, there = source[seam], neighbour[seam]
        # At an edge of the exemplar nothing is known beyond it: its last pixel stands in for what would follow.
        if axis == 0:
            runs_on = np.where(here + step < len(flat), here + step, here)
            comes_from = np.where(there >= step, there - step, there)
        else:
            runs_on = here + ((here + 1) % base.shape[1] != 0)
            comes_from = there - (there % base.shape[1] != 0)
        ahead = ((flat[runs_on] - flat[there]) ** 2).sum(axis=1)
        behind = ((flat[comes_from] - flat[here]) ** 2).sum(axis=1)
        total[seam] += (ahead + behind) / 2
    return total


def _seam_cost(base: NDArray[np.int16], source: NDArray[np.int32]) -> tuple[float, float]:
    """Worst and mean colour step (CIE76) over all pixels with a seam right of or below them."""
    steps = np.sqrt(_seam_jumps(base, source)) / LAB_STEPS_PER_UNIT
    on_seam = steps[steps > 0]
    return (float(on_seam.max()), float(on_seam.mean())) if on_seam.size else (0.0, 0.0)
