"""Image quilting (Efros and Freeman 2001, "Image quilting for texture synthesis and transfer"), flat or on a torus.

Overlapping square blocks of the exemplar are laid in reading order, each chosen among those that agree best with
what already lies there, and cut to it along the seam of least colour difference (their section 2). On a torus the
output has no edges: the last block of a row also has to agree with the first, and the last row with the first. The
first seed, 5.5.1, makes its repeatable tile so.

Three things differ from the paper. The seam is a minimum cut instead of one path a side, because a block may be
surrounded. Blocks from places already much used cost more, so that one part of a stone doesn't recur. And when all
are laid, more blocks are laid over the worst seams (Kwatra et al. 2003, "Graphcut textures", section 3.2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab import rng
from tilefab.synthesis.protocol import Step, SynthesisRequest, SynthesisResult, Watch
from tilefab.synthesis.seam_jumps import seam_jumps, weighted_cost
from tilefab.texture.matching import (
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
_LARGEST_BLOCK_PX = 512
_SMALLEST_BLOCK_PX = 8
_MAX_SEARCH_AREA_PX = 1 << 20
_OVERLAP_SHARE = 3
_TOLERANCE = 0.1
_USAGE_PRICE = 0.5
_UNSET = -1

Window = tuple[NDArray[np.int64], ...]


@dataclass(frozen=True, eq=False)
class Quilt:
    """A quilted texture.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    block_px, overlap_px
        Block size used and how far blocks overlap at least.
    laid
        Share of the blocks that were laid; below 1 only if it was stopped. The rest is filled with blocks at random.
    complete
        Whether it was finished.
    """

    source: NDArray[np.int32]
    block_px: int
    overlap_px: int
    laid: float = 1.0
    complete: bool = True


def quilt(request: SynthesisRequest, watch: Watch | None = None) -> SynthesisResult:
    """Quilt a texture: the method ``"quilting"``.

    Parameters
    ----------
    request
        What is wanted; ``feature_px`` is the side of a block. By default a quarter of the exemplar's smaller side,
        between 24 and 512. There is nothing for ``threads`` and ``fast`` to do.
    watch
        Told after each block; where it stops early, blocks still to be laid are replaced by ones at random.

    Raises
    ------
    ValueError
        If no whole block of valid exemplar exists, or the exemplar or a repeating result is smaller than 8 pixels.
    """
    size = request.size
    if min(size.rows, size.cols) < _SMALLEST_BLOCK_PX and not request.toroidal:
        # A block is the least that can be laid: what is wanted is cut out of it.
        larger = SizePx(max(_SMALLEST_BLOCK_PX, size.rows), max(_SMALLEST_BLOCK_PX, size.cols))
        grown = quilt(replace(request, size=larger), watch)
        return replace(grown, source=np.ascontiguousarray(grown.source[: size.rows, : size.cols]))
    quilted = lay_quilt(request, watch)
    notes: tuple[str, ...] = ()
    if quilted.laid < 1.0:
        notes = (
            f"Stopped when {100 * quilted.laid:.0f} % was quilted: the rest is filled with pieces that don't join",
        )
    return SynthesisResult(quilted.source, quilted.complete, notes)


def lay_quilt(request: SynthesisRequest, watch: Watch | None = None) -> Quilt:
    """Quilt a texture and tell the size of its blocks; see `quilt`."""
    valid, size = request.valid, request.size
    smaller_px = min(*valid.shape, size.rows, size.cols)
    block = request.feature_px or max(MIN_EXEMPLAR_PX, min(_LARGEST_BLOCK_PX, smaller_px // 4))
    block = min(max(block, _SMALLEST_BLOCK_PX), smaller_px)
    if block < _SMALLEST_BLOCK_PX:
        raise ValueError(
            f"quilting needs {_SMALLEST_BLOCK_PX} pixels a side: the exemplar has {valid.shape[1]} x {valid.shape[0]}, "
            f"the result {size.cols} x {size.rows}"
        )
    allowed = window_is_valid(valid, block, block)
    while not allowed.any() and block > _SMALLEST_BLOCK_PX:
        block = max(_SMALLEST_BLOCK_PX, block * 3 // 4)
        allowed = window_is_valid(valid, block, block)
    if not allowed.any():
        raise ValueError("the exemplar has no usable square of 8 x 8 pixels: its mask leaves too little")
    overlap = max(3, block // _OVERLAP_SHARE)
    factor = 1
    while valid.size > _MAX_SEARCH_AREA_PX * factor * factor and block >= 16 * factor:
        factor *= 2
    quilter = _Quilter(request, allowed, block, factor)
    starts = _block_starts if request.toroidal else _open_block_starts
    places = [(row, col) for row in starts(size.rows, block, overlap) for col in starts(size.cols, block, overlap)]
    repairs = 2 * len(places)
    for k, (row, col) in enumerate(places):
        quilter.lay(row, col)
        step = Step((k + 1) / (len(places) + repairs), lambda: quilter.filled(places))
        if watch is not None and not watch(step):
            laid = (k + 1) / len(places)
            return Quilt(quilter.filled(places), block, overlap, laid, complete=False)
    for k in range(repairs):
        quilter.repair()
        step = Step((len(places) + k + 1) / (len(places) + repairs), quilter.source.copy)
        if watch is not None and not watch(step) and k + 1 < repairs:
            return Quilt(quilter.source, block, overlap, complete=False)
    return Quilt(quilter.source, block, overlap)


def _block_starts(length: int, block: int, overlap: int) -> list[int]:
    """First pixel of each block so that every neighbour, also across the wrap, overlaps by at least ``overlap``."""
    count = max(1, -(-length // (block - overlap)))
    return [i * length // count for i in range(count)]


def _open_block_starts(length: int, block: int, overlap: int) -> list[int]:
    """First pixel of each block, the last one ending where the result does."""
    count = 1 + max(0, -(-(length - block) // (block - overlap)))
    return [i * (length - block) // max(1, count - 1) for i in range(count)]


class _Quilter:
    def __init__(self, request: SynthesisRequest, allowed: Mask, block: int, factor: int) -> None:
        base, size = matching_image(request.exemplar), request.size
        self.base, self.allowed, self.block, self.factor = base, allowed, block, factor
        self.toroidal, self.weights, self.seed = request.toroidal, request.weights, request.seed
        self.source = np.full((size.rows, size.cols), _UNSET, dtype=np.int32)
        self.shown = np.zeros((size.rows, size.cols, base.shape[2]), dtype=np.int16)
        self.random = rng.generator(request.seed, "quilting")
        self.search = TemplateSearch(reduced(base, factor))
        coarse_block = block // factor
        self.coarse_allowed = window_is_valid(reduced_mask(request.valid, factor), coarse_block, coarse_block)
        if not self.coarse_allowed.any():
            self.coarse_allowed = np.zeros_like(self.coarse_allowed)
            places = np.argwhere(allowed) // factor
            places = np.minimum(places, np.array(self.coarse_allowed.shape) - 1)
            self.coarse_allowed[places[:, 0], places[:, 1]] = True
        self.usage = np.zeros(self.search.shape, dtype=np.int64)
        self._core = np.ix_([block // 2 - 1, block // 2], [block // 2 - 1, block // 2])
        # Bad places are looked for, and given up, on a grid of this many pixels.
        self._grain = max(2, block // 8)
        self._hopeless = np.zeros((-(-size.rows // self._grain), -(-size.cols // self._grain)), dtype=bool)
        self._jumps: NDArray[np.float64] | None = None

    def lay(self, row: int, col: int) -> None:
        """Choose a block for the place (row, col) of the result, cut it to its neighbours and lay it."""
        window = self._window(row, col)
        filled = self.source[window] != _UNSET
        there = self.shown[window]
        base_row, base_col = self._choose(there, filled)
        labels = np.where(filled, FREE, TAKE).astype(np.uint8)
        labels[self._rim(row, col) & filled] = KEEP
        labels[self._core] = TAKE
        self.source[window], self.shown[window] = self._cut_in(there, window, base_row, base_col, labels)

    def repair(self) -> None:
        """Lay one more block over the place with the worst seams, and leave it if they get better by it.

        This is the refinement of Kwatra et al. 2003, section 3.2. A place tried in vain isn't tried again.
        """
        if self._jumps is None:
            self._jumps = self._jumps_of(self.source)
        block, grain = self.block, self._grain
        at_row, at_col = self._worst_place()
        row, col = at_row - block // 2, at_col - block // 2
        if not self.toroidal:
            row = min(max(row, 0), self.source.shape[0] - block)
            col = min(max(col, 0), self.source.shape[1] - block)
        window = self._window(row, col)
        there = self.shown[window]
        ring = np.ones((block, block), dtype=bool)
        ring[_inner(at_row - row, block // 4, block), _inner(at_col - col, block // 4, block)] = False
        base_row, base_col = self._choose(there, ring)
        labels = np.full((block, block), FREE, dtype=np.uint8)
        margin = block * 3 // 8
        labels[_inner(at_row - row, margin, block), _inner(at_col - col, margin, block)] = TAKE
        labels[self._rim(row, col)] = KEEP
        source, shown = self._cut_in(there, window, base_row, base_col, labels)
        touched, looked_at, inside = self._surroundings(row, col)
        before = float(self._jumps[touched].sum())
        patched = self.source[looked_at].copy()
        patched[inside] = source
        rows, cols = len(touched[0]), touched[1].shape[1]
        after = self._jumps_of(patched)[:rows, :cols]
        if float(after.sum()) < before:
            self.source[window], self.shown[window] = source, shown
            self._jumps[touched] = after
            self._hopeless[np.unique(window[0] // grain)[:, None], np.unique(window[1] // grain)] = False

    def filled(self, places: list[tuple[int, int]]) -> NDArray[np.int32]:
        """The map so far, with blocks at random where none was laid yet."""
        source = self.source.copy()
        if (source != _UNSET).all():
            return source
        random, allowed = rng.generator(self.seed, "unquilted"), np.argwhere(self.allowed)
        steps = np.arange(self.block)
        for row, col in places:
            window = self._window(row, col)
            there = source[window]
            base_row, base_col = (int(k) for k in allowed[int(random.integers(len(allowed)))])
            flat = (base_row + steps)[:, None] * self.base.shape[1] + base_col + steps
            source[window] = np.where(there == _UNSET, flat, there)
        return source

    def _worst_place(self) -> tuple[int, int]:
        assert self._jumps is not None
        block, grain = self.block, self._grain
        sums = np.add.reduceat(
            np.add.reduceat(self._jumps, np.arange(0, self._jumps.shape[0], grain), axis=0),
            np.arange(0, self._jumps.shape[1], grain),
            axis=1,
        )
        mode = "wrap" if self.toroidal else "constant"
        local = ndimage.uniform_filter(sums, size=max(3, block // (2 * grain)), mode=mode)
        local[self._hopeless] = -1.0
        worst_row, worst_col = np.unravel_index(int(local.argmax()), local.shape)
        self._hopeless[worst_row, worst_col] = True
        return int(worst_row) * grain + grain // 2, int(worst_col) * grain + grain // 2

    def _surroundings(self, row: int, col: int) -> tuple[Window, Window, tuple[slice, slice]]:
        """What a block at (row, col) changes seams of, what must be known to measure them, and it in the latter."""
        touched, looked_at, inside = [], [], []
        for first, length in zip((row, col), self.source.shape, strict=True):
            begin, end, beyond = first - 1, first + self.block, first + self.block + 1
            if not self.toroidal:
                begin, end, beyond = max(begin, 0), min(end, length), min(beyond, length)
            touched.append(np.arange(begin, end) % length)
            looked_at.append(np.arange(begin, beyond) % length)
            inside.append(slice(first - begin, first - begin + self.block))
        return np.ix_(*touched), np.ix_(*looked_at), (inside[0], inside[1])

    def _jumps_of(self, source: NDArray[np.int32]) -> NDArray[np.float64]:
        return seam_jumps(self.base, source, toroidal=self.toroidal, weights=self.weights)

    def _rim(self, row: int, col: int) -> Mask:
        """Outermost pixels of a block; not those at the edge of a result that has edges: there nothing joins on."""
        rows, cols = self.source.shape
        rim = np.ones((self.block, self.block), dtype=bool)
        top, left = (0 if at == 0 and not self.toroidal else 1 for at in (row, col))
        bottom = self.block - (self.toroidal or row + self.block < rows)
        right = self.block - (self.toroidal or col + self.block < cols)
        rim[top:bottom, left:right] = False
        return rim

    def _window(self, row: int, col: int) -> Window:
        steps = np.arange(self.block)
        return np.ix_((row + steps) % self.source.shape[0], (col + steps) % self.source.shape[1])

    def _cut_in(
        self, there: NDArray[np.int16], window: Window, base_row: int, base_col: int, labels: NDArray[np.uint8]
    ) -> tuple[NDArray[np.int32], NDArray[np.int16]]:
        block, old = self.block, self.source[window]
        place = slice(base_row, base_row + block), slice(base_col, base_col + block)
        piece = self.base[place]
        cost = ((piece.astype(np.int64) - there) ** 2).sum(axis=2)
        if self.weights is not None:
            cost = weighted_cost(cost, self.weights[place], self.weights.reshape(-1)[np.maximum(old, 0)])
        # What the piece already there would have shown beyond its end isn't known: a cut along that end is dear.
        take = cut(np.where(old != _UNSET, cost, UNKNOWN_COST), labels)
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


def _inner(at: int, margin: int, length: int) -> slice:
    """Pixels of a block all but a margin, moved so that ``at`` is in their middle, as far as they lie in the block."""
    shift = at - length // 2
    return slice(max(margin + shift, 0), min(length - margin + shift, length))
