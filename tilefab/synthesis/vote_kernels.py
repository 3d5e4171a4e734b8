"""Votes of overlapping patches, and what each pixel shows in the end.

Images are flat int16 or (rows, cols, 4); places are flat indices of pixels of the exemplar.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX

_ROW_VALUES = PATCH_PX * CHANNELS
_FAR = 1 << 60


@kernel
def tally(
    exemplar: NDArray[np.int16],
    exemplar_cols: int,
    field: NDArray[np.int32],
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    period_rows: int,
    begin: int,
    end: int,
    sums: NDArray[np.int32],
) -> None:
    """Add up, for the rows from ``begin`` to ``end``, what all patches that cover them show.

    ``sums`` is (rows, values of a row), zero before; columns beyond the result's are folded back by the caller.
    """
    for i in range(len(rows_px)):
        for down in range(PATCH_PX):
            row = rows_px[i] + down
            if period_rows > 0 and row >= period_rows:
                row -= period_rows
            if row < begin or row >= end:
                continue
            line = sums[row - begin]
            for j in range(len(cols_px)):
                at = (np.int64(field[i, j]) + down * exemplar_cols) * CHANNELS
                to = cols_px[j] * CHANNELS
                for k in range(_ROW_VALUES):
                    line[to + k] += np.int32(exemplar[at + k])


@kernel
def tally_weighted(
    exemplar: NDArray[np.int16],
    weights: NDArray[np.int64],
    exemplar_cols: int,
    field: NDArray[np.int32],
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    period_rows: int,
    begin: int,
    end: int,
    sums: NDArray[np.int64],
    totals: NDArray[np.int64],
) -> None:
    """As `tally`, each pixel of the exemplar with a weight of its own; ``totals`` adds up the weights."""
    for i in range(len(rows_px)):
        for down in range(PATCH_PX):
            row = rows_px[i] + down
            if period_rows > 0 and row >= period_rows:
                row -= period_rows
            if row < begin or row >= end:
                continue
            line, total = sums[row - begin], totals[row - begin]
            for j in range(len(cols_px)):
                place = np.int64(field[i, j]) + down * exemplar_cols
                for right in range(PATCH_PX):
                    weight = weights[place + right]
                    total[cols_px[j] + right] += weight
                    to = (cols_px[j] + right) * CHANNELS
                    for channel in range(CHANNELS):
                        line[to + channel] += weight * exemplar[(place + right) * CHANNELS + channel]


@kernel
def choose(
    exemplar: NDArray[np.int16],
    exemplar_cols: int,
    field: NDArray[np.int32],
    mean: NDArray[np.int16],
    mean_cols: int,
    covering_rows: NDArray[np.int64],
    covering_cols: NDArray[np.int64],
    begin: int,
    end: int,
    source: NDArray[np.int32],
) -> None:
    """Of all patches over a pixel, take the pixel nearest their mean; of equals, the first in the exemplar.

    ``covering_rows[row, k]`` is the row of the field whose patches cover a row of the result with their k-th row, or
    -1; columns alike.
    """
    for row in range(begin, end):
        for col in range(source.shape[1]):
            at = (row * mean_cols + col) * CHANNELS
            least, chosen = _FAR, -1
            for down in range(PATCH_PX):
                i = covering_rows[row, down]
                if i < 0:
                    continue
                for right in range(PATCH_PX):
                    j = covering_cols[col, right]
                    if j < 0:
                        continue
                    place = int(np.int64(field[i, j])) + down * exemplar_cols + right
                    difference = 0
                    for channel in range(CHANNELS):
                        step = np.int64(exemplar[place * CHANNELS + channel]) - mean[at + channel]
                        difference += int(step * step)
                    if difference < least or (difference == least and place < chosen):
                        least, chosen = difference, place
            source[row, col] = chosen


@kernel
def seam_step(
    exemplar: NDArray[np.int16], exemplar_cols: int, pixels: int, here: int, there: int, down: int, right: int
) -> int:
    """Cost of a seam between a pixel that shows ``here`` and its neighbour that shows ``there``; 0 where none is.

    What each would show if the other's piece ran on is compared with what is shown (Kwatra et al. 2003, Eq. 1,
    squared). At an edge of the exemplar its last pixel stands in for what would follow.
    """
    shift = down * exemplar_cols + right
    edge = exemplar_cols - 1 if right > 0 else 0
    opposite = 0 if right > 0 else exemplar_cols - 1
    at_edge = right != 0 and here % exemplar_cols == edge
    if there == here + shift and not at_edge:
        return 0
    ahead = here + shift
    if ahead < 0 or ahead >= pixels or at_edge:
        ahead = here
    behind = there - shift
    if behind < 0 or behind >= pixels or (right != 0 and there % exemplar_cols == opposite):
        behind = there
    total = 0
    for channel in range(CHANNELS):
        step = np.int64(exemplar[ahead * CHANNELS + channel]) - exemplar[there * CHANNELS + channel]
        back = np.int64(exemplar[behind * CHANNELS + channel]) - exemplar[here * CHANNELS + channel]
        total += int(step * step + back * back)
    return total


@kernel
def settle(
    exemplar: NDArray[np.int16],
    exemplar_cols: int,
    valid: NDArray[np.bool_],
    dearness: NDArray[np.int64],
    mean: NDArray[np.int16],
    mean_cols: int,
    wraps: bool,
    seam_weight: int,
    colour: int,
    begin: int,
    end: int,
    source: NDArray[np.int32],
    settled: NDArray[np.int32],
) -> None:
    """Let each pixel of one colour of the checkerboard join a neighbour's piece if that makes its seams cheaper.

    A pixel's cost is its squared difference to the mean of the votes and ``seam_weight`` times that of its seams, each
    times the dearness (1 and up) of the exemplar where it lies.
    """
    rows, cols = source.shape
    pixels = len(valid)
    for row in range(begin, end):
        for col in range((row + colour) & 1, cols, 2):
            at = (row * mean_cols + col) * CHANNELS
            least, chosen = _FAR, int(np.int64(source[row, col]))
            for k in range(5):
                place = int(np.int64(source[row, col]))
                if k > 0:
                    i = row + (k == 2) - (k == 1)
                    j = col + (k == 4) - (k == 3)
                    if wraps:
                        i, j = i % rows, j % cols
                    elif i < 0 or i >= rows or j < 0 or j >= cols:
                        continue
                    neighbour = int(np.int64(source[i, j]))
                    if (k == 3 and neighbour % exemplar_cols == exemplar_cols - 1) or (
                        k == 4 and neighbour % exemplar_cols == 0
                    ):
                        continue
                    joined = neighbour + ((k == 1) - (k == 2)) * exemplar_cols + (k == 3) - (k == 4)
                    if joined < 0 or joined >= pixels or joined == place or not valid[joined]:
                        continue
                    place = joined
                cost = 0
                for channel in range(CHANNELS):
                    step = np.int64(exemplar[place * CHANNELS + channel]) - mean[at + channel]
                    cost += int(step * step)
                for m in range(1, 5):
                    down, right = (m == 2) - (m == 1), (m == 4) - (m == 3)
                    i, j = row + down, col + right
                    if wraps:
                        i, j = i % rows, j % cols
                    elif i < 0 or i >= rows or j < 0 or j >= cols:
                        continue
                    there = int(np.int64(source[i, j]))
                    jump = seam_step(exemplar, exemplar_cols, pixels, place, there, down, right)
                    cost += seam_weight * jump * int(max(dearness[place], dearness[there]))
                if cost < least:
                    least, chosen = cost, place
            settled[row, col] = chosen


def tally_plain(
    exemplar: NDArray[np.int16],
    weights: NDArray[np.int64],
    field: NDArray[np.int32],
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    size: tuple[int, int],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The votes one after the other, on a torus of ``size``: the twin of both tallies.

    Parameters
    ----------
    exemplar, weights
        (rows, cols, 4) int16 and (rows, cols) int64.
    field, rows_px, cols_px
        Places of the patches, and where they begin in the result.
    size
        Rows and columns of the result.

    Returns
    -------
    sums, totals
        (rows, cols, 4) weighted sums of colours, (rows, cols) sums of weights.
    """
    sums, totals = np.zeros((*size, CHANNELS), dtype=np.int64), np.zeros(size, dtype=np.int64)
    for i, row in enumerate(rows_px):
        for j, col in enumerate(cols_px):
            at_row, at_col = divmod(int(field[i, j]), exemplar.shape[1])
            patch = np.s_[at_row : at_row + PATCH_PX, at_col : at_col + PATCH_PX]
            where = np.ix_((row + np.arange(PATCH_PX)) % size[0], (col + np.arange(PATCH_PX)) % size[1])
            sums[where] += weights[patch][..., np.newaxis] * exemplar[patch]
            totals[where] += weights[patch]
    return sums, totals


def choose_plain(
    exemplar: NDArray[np.int16],
    field: NDArray[np.int32],
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    mean: NDArray[np.int16],
) -> NDArray[np.int32]:
    """The twin of `choose`, patch by patch on a torus of the size of ``mean`` (rows, cols, 4)."""
    rows, cols = mean.shape[:2]
    least, chosen = np.full((rows, cols), _FAR), np.full((rows, cols), -1, dtype=np.int64)
    for i, row in enumerate(rows_px):
        for j, col in enumerate(cols_px):
            at_row, at_col = divmod(int(field[i, j]), exemplar.shape[1])
            for down in range(PATCH_PX):
                for right in range(PATCH_PX):
                    here = ((row + down) % rows, (col + right) % cols)
                    place = (at_row + down) * exemplar.shape[1] + at_col + right
                    colour = exemplar[at_row + down, at_col + right].astype(np.int64)
                    difference = int(((colour - mean[here]) ** 2).sum())
                    if (difference, place) < (int(least[here]), int(chosen[here])):
                        least[here], chosen[here] = difference, place
    return chosen.astype(np.int32)
