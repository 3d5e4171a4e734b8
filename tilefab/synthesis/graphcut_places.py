"""Where `graphcut` takes its next patch from: the placement strategies of Kwatra et al. 2003, section 3.3.

The second seed-thesis, 3.1.4, describes the same three. Sums of squared differences are found by FFT and are exact
integers, so every machine chooses alike.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilefab.synthesis.graphcut_canvas import Canvas, Placement
from tilefab.synthesis.graphcut_kernels import UNSET
from tilefab.texture.matching import (
    TemplateSearch,
    overlap_differences,
    reduced,
    reduced_mask,
    refine_place,
    window_is_valid,
    window_sums,
)
from tilefab.types import Mask

_MAX_SEARCH_AREA_PX = 1 << 20
_TOLERANCE = 10
_OVERLAP_SHARE = 3
_MAX_PATCH_PX = 512
_MIN_OVERLAP_SHARE = 16
_WEIGHT_SHIFT = 6


class Strategy(Protocol):
    """How patches are found.

    Attributes
    ----------
    shape
        Largest rows and columns of a patch.
    """

    shape: tuple[int, int]

    def to_fill(self, row: int, col: int, count: int) -> list[Placement]:
        """Up to ``count`` patches that agree with what lies there, for a window whose first unset pixel is given."""
        ...

    def to_mend(self, row: int, col: int, count: int) -> list[Placement]:
        """Up to ``count`` patches that may cover a bad seam at (row, col)."""
        ...


def _some(price: NDArray[np.int64], allowed: Mask, count: int, random: np.random.Generator) -> list[tuple[int, int]]:
    """Places drawn from those that cost hardly more than the cheapest; if these are too few, the cheapest.

    Kwatra et al. draw with a probability that falls exponentially with the cost.
    """
    flat = np.where(allowed, price, np.iinfo(np.int64).max).ravel()
    best = int(flat.min())
    near = np.flatnonzero(flat <= best + best // _TOLERANCE)
    if near.size >= count:
        chosen = random.permutation(near)[:count]
    else:
        nearest = min(4 * count, flat.size - 1)
        order = np.flatnonzero(flat <= np.partition(flat, nearest)[nearest])
        chosen = order[np.argsort(flat[order], kind="stable")][:count]
    return [(int(k) // price.shape[1], int(k) % price.shape[1]) for k in chosen if allowed.ravel()[k]]


class SubPatches:
    """Sub-patch matching: what lies in a square window is looked for in the exemplar.

    Parameters
    ----------
    canvas
        What is being filled.
    base
        (rows, cols, channels) int16 from `matching_image`.
    side_px
        Of the window.
    random
        Where draws come from.

    Notes
    -----
    Exemplars of more than a megapixel are searched at reduced size, and places then refined at full size.
    """

    def __init__(self, canvas: Canvas, base: NDArray[np.int16], side_px: int, random: np.random.Generator) -> None:
        self.shape = (side_px, side_px)
        self._canvas, self._base, self._random = canvas, base, random
        valid = canvas.exemplar.valid
        self._allowed = window_is_valid(valid, side_px, side_px)
        factor = 1
        while valid.size > _MAX_SEARCH_AREA_PX * factor * factor and side_px >= 16 * factor:
            factor *= 2
        self._factor = factor
        self._search = TemplateSearch(reduced(base, factor))
        n = side_px // factor
        self._coarse_allowed = window_is_valid(reduced_mask(valid, factor), n, n)
        if not self._coarse_allowed.any():
            places = np.argwhere(self._allowed) // factor
            places = np.minimum(places, np.array(self._coarse_allowed.shape) - 1)
            self._coarse_allowed[places[:, 0], places[:, 1]] = True
        self._ring = np.ones(self.shape, dtype=bool)
        if side_px >= 4:
            self._ring[side_px // 4 : side_px - side_px // 4, side_px // 4 : side_px - side_px // 4] = False

    def to_fill(self, row: int, col: int, count: int) -> list[Placement]:
        """See `Strategy`: the window overlaps what lies above it and left of it by a third."""
        size, overlap = self._canvas.size, self.shape[0] // _OVERLAP_SHARE
        if (self._canvas.source != UNSET).any():
            row, col = row - overlap, col - overlap
        if not self._canvas.toroidal:
            row, col = min(max(row, 0), size.rows - self.shape[0]), min(max(col, 0), size.cols - self.shape[1])
        window = self._canvas.source[self._canvas.window(row, col, *self.shape)]
        return self._placements(row, col, window, window != UNSET, count)

    def to_mend(self, row: int, col: int, count: int) -> list[Placement]:
        """See `Strategy`: the window's outer parts are matched, its inner half, where the bad seam lies, isn't."""
        side = self.shape[0]
        row, col = row - side // 2, col - side // 2
        size = self._canvas.size
        if self._canvas.toroidal:
            row, col = row % size.rows, col % size.cols
        else:
            row, col = min(max(row, 0), size.rows - side), min(max(col, 0), size.cols - side)
        window = self._canvas.source[self._canvas.window(row, col, *self.shape)]
        return self._placements(row, col, window, self._ring, count)

    def anywhere(self) -> Placement:
        """A patch that is valid throughout, the first in reading order."""
        row, col = divmod(int(self._allowed.argmax()), self._allowed.shape[1])
        return Placement(0, 0, row, col, *self.shape)

    def _placements(self, row: int, col: int, there: NDArray[np.int32], mask: Mask, count: int) -> list[Placement]:
        if not mask.any():
            places = np.argwhere(self._allowed)
            chosen = places[int(self._random.integers(len(places)))]
            found = [(int(chosen[0]), int(chosen[1]))]
        else:
            found = self._find(there, mask, count)
        return [Placement(row, col, r, c, *self.shape) for r, c in found]

    def _find(self, there: NDArray[np.int32], mask: Mask, count: int) -> list[tuple[int, int]]:
        factor, side, exemplar = self._factor, self.shape[0], self._canvas.exemplar
        names = np.maximum(there, 0)
        template = exemplar.colours[names]
        # Up to five times the weight where no seam should pass.
        weights = np.where(mask, 1 + (exemplar.weights[names] >> _WEIGHT_SHIFT), 0).astype(np.uint8)
        n = side // factor
        coarse_mask = np.where(reduced_mask(mask, factor), weights[::factor, ::factor][:n, :n], 0)
        if not coarse_mask.any():
            coarse_mask[:] = 1
        sums = self._search.squared_differences(reduced(template, factor), coarse_mask.astype(np.uint8))
        usage = window_sums(self._canvas.prices, side, side)[::factor, ::factor]
        rows, cols = (min(n) for n in zip(sums.shape, usage.shape, self._coarse_allowed.shape, strict=True))
        sums, usage, allowed = sums[:rows, :cols], usage[:rows, :cols], self._coarse_allowed[:rows, :cols]
        # A window shown once already costs half of what the best one disagrees by.
        scale = max(int(sums[allowed].min()), int(np.count_nonzero(coarse_mask)))
        price = 2 * side * side * sums + scale * usage
        chosen = _some(price, allowed, count, self._random)
        if factor == 1:
            return chosen
        refined = []
        for r, c in chosen:
            r, c, _ = refine_place(self._base, template, mask, self._allowed, r * factor, c * factor, factor)
            if r >= 0:
                refined.append((int(r), int(c)))
        if not refined:
            places = np.argwhere(self._allowed)
            r, c = chosen[0]
            nearest = int(np.abs(places - [r * factor, c * factor]).max(axis=1).argmin())
            refined.append((int(places[nearest, 0]), int(places[nearest, 1])))
        return refined


class EntirePatches:
    """Entire patch matching, or random placement: all of the exemplar is laid, wherever it agrees best or at random.

    Parameters
    ----------
    canvas, base, random
        As for `SubPatches`.
    matched
        False for random placement.

    Notes
    -----
    A patch has 512 pixels a side at most, and less than a toroidal output: of a larger exemplar, parts are drawn.
    """

    def __init__(
        self, canvas: Canvas, base: NDArray[np.int16], random: np.random.Generator, *, matched: bool = True
    ) -> None:
        rim = 2 if canvas.toroidal else 0
        limits = [min(_MAX_PATCH_PX, max(1, n - rim)) for n in (canvas.size.rows, canvas.size.cols)]
        self.shape = (min(base.shape[0], limits[0]), min(base.shape[1], limits[1]))
        self._canvas, self._base, self._random, self._matched = canvas, base, random, matched

    def to_fill(self, row: int, col: int, count: int) -> list[Placement]:
        """See `Strategy`: the patch reaches back over what is there by an eighth to three quarters of its size."""
        if not (self._canvas.source != UNSET).any():
            return self._clipped([(row, col)], self._part())
        # The windows of several would hold different parts of what is still unset: their seams can't be compared.
        return self._find(row, col, 8, min(count, 1))

    def to_mend(self, row: int, col: int, count: int) -> list[Placement]:
        """See `Strategy`: the bad seam lies in the inner half of the patch."""
        return self._find(row, col, 4, count)

    def _part(self) -> tuple[int, int]:
        spare = [n - m for n, m in zip(self._base.shape[:2], self.shape, strict=True)]
        return int(self._random.integers(spare[0] + 1)), int(self._random.integers(spare[1] + 1))

    def _find(self, row: int, col: int, margin: int, count: int) -> list[Placement]:
        rows, cols = self.shape
        part = self._part()
        first = row - rows * 3 // 4, col - cols * 3 // 4
        reach = row - rows // margin - first[0] + 1, col - cols // margin - first[1] + 1
        if self._matched:
            price, allowed = self._disagreement(part, first, reach)
            chosen = _some(price, allowed, count, self._random)
        else:
            draw = self._random.integers
            chosen = [(int(draw(reach[0])), int(draw(reach[1]))) for _ in range(count)]
        return self._clipped([(first[0] + r, first[1] + c) for r, c in chosen], part)

    def _disagreement(
        self, part: tuple[int, int], first: tuple[int, int], reach: tuple[int, int]
    ) -> tuple[NDArray[np.int64], Mask]:
        """Mean squared difference where the patch overlaps what lies there (equation 4), and where enough."""
        canvas, (rows, cols) = self._canvas, self.shape
        height, width = rows + reach[0] - 1, cols + reach[1] - 1
        there = canvas.source[canvas.window(*first, height, width)]
        filled = there != UNSET
        if not canvas.toroidal:
            at_row, at_col = first[0] + np.arange(height), first[1] + np.arange(width)
            filled &= ((at_row >= 0) & (at_row < canvas.size.rows))[:, None]
            filled &= (at_col >= 0) & (at_col < canvas.size.cols)
        patch = slice(part[0], part[0] + rows), slice(part[1], part[1] + cols)
        names = np.maximum(there, 0)
        sums, counts = overlap_differences(
            canvas.exemplar.colours[names], filled, self._base[patch], canvas.exemplar.valid[patch]
        )
        enough = counts >= min(rows * cols // _MIN_OVERLAP_SHARE, int(counts.max()))
        return 64 * sums // np.maximum(counts, 1), enough

    def _clipped(self, starts: list[tuple[int, int]], part: tuple[int, int]) -> list[Placement]:
        size, (rows, cols) = self._canvas.size, self.shape
        if self._canvas.toroidal:
            return [Placement(r % size.rows, c % size.cols, *part, rows, cols) for r, c in starts]
        placements = []
        for r, c in starts:
            row, col = max(r, 0), max(c, 0)
            end_row, end_col = min(r + rows, size.rows), min(c + cols, size.cols)
            placements.append(Placement(row, col, part[0] + row - r, part[1] + col - c, end_row - row, end_col - col))
        return placements
