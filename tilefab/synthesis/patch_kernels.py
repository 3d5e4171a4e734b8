"""Searching nearest patches: PatchMatch over integer images, the same for any number of threads.

PatchMatch (Barnes et al. 2009, "PatchMatch: a randomized correspondence algorithm for structural image editing") with
two changes. It visits the result like the squares of a checkerboard, one colour after the other, and reads the other
colour's and its own earlier places only, so that bands of rows can be searched at once. And a place has a price beside
its distance: Kaspar et al. 2015, Eq. 5, where the price is of the occurrence of its pixels.

Images are flat int16, four channels to a pixel. A patch is named by its top left pixel.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel, squared_row

PATCH_PX = 10
"""Side of a patch: N of Kaspar et al. 2015, section 3."""
CHANNELS = 4
"""Three of colour and the guidance channel."""
_ROW_VALUES = PATCH_PX * CHANNELS
_FAR = 1 << 60
_MOST_COPIES = 8
"""Of a place shown more often only so many copies are looked at, evenly spread."""


@kernel
def patch_difference(
    first: NDArray[np.int16],
    at: int,
    first_stride: int,
    second: NDArray[np.int16],
    begin: int,
    second_stride: int,
    bound: int,
) -> int:
    """Squared difference of two patches, or anything from ``bound`` up once it gets there (Eq. 2)."""
    total = 0
    for row in range(PATCH_PX):
        total += squared_row(first, at + row * first_stride, second, begin + row * second_stride)
        if total >= bound:
            return total
    return total


@kernel
def mixed(word: np.uint64) -> np.uint64:
    """The finaliser of MurmurHash3: each bit of the result depends on each bit of the word."""
    word ^= word >> np.uint64(33)
    word *= np.uint64(0xFF51AFD7ED558CCD)
    word ^= word >> np.uint64(33)
    word *= np.uint64(0xC4CEB9FE1A85EC53)
    word ^= word >> np.uint64(33)
    return word


@kernel
def again_price(
    place: int,
    me: int,
    row: int,
    col: int,
    field_cols: int,
    starts: NDArray[np.int64],
    order: NDArray[np.int64],
    prices: NDArray[np.int64],
) -> int:
    """Price of showing a place again at a shift at which much is shown again already; 0 for the first of a pair.

    ``order[starts[p] : starts[p + 1]]`` are the patches that show place p, in reading order. ``prices[down, right +
    field columns]`` is the price of a shift.
    """
    dearest = 0
    count = starts[place + 1] - starts[place]
    step = 1 + count // _MOST_COPIES
    for k in range(starts[place], starts[place + 1], step):
        other = int(order[k])
        down = row - other // field_cols
        right = col - other % field_cols
        if other == me or down < 0 or (down == 0 and right < 0):
            continue
        dearest = max(dearest, int(prices[down, right + field_cols]))
    return dearest


@kernel
def count_shifts(
    starts: NDArray[np.int64], order: NDArray[np.int64], field_cols: int, counts: NDArray[np.int64]
) -> None:
    """For each pair of patches that show one place, count the shift from the earlier to the later."""
    for place in range(len(starts) - 1):
        step = 1 + (starts[place + 1] - starts[place]) // _MOST_COPIES
        for k in range(starts[place], starts[place + 1], step):
            first = order[k]
            row = first // field_cols
            col = first % field_cols
            for m in range(k + step, starts[place + 1], step):
                second = order[m]
                counts[second // field_cols - row, second % field_cols - col + field_cols] += step * step


@kernel
def search(
    target: NDArray[np.int16],
    target_cols: int,
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    period: tuple[int, int],
    exemplar: NDArray[np.int16],
    exemplar_cols: int,
    allowed: NDArray[np.bool_],
    price: NDArray[np.int64],
    crowd: NDArray[np.int64],
    most: int,
    starts: NDArray[np.int64],
    order: NDArray[np.int64],
    shift_price: NDArray[np.int64],
    field: NDArray[np.int32],
    found: NDArray[np.int32],
    cost: NDArray[np.int64],
    colour: int,
    begin: int,
    end: int,
    key: np.uint64,
    tries: int,
) -> None:
    """One colour of one pass over some rows of the field.

    Parameters
    ----------
    target, target_cols
        The result's image, flat, and its columns; where the result repeats, its first rows and columns once more.
    rows_px, cols_px
        Row and column of the target at which each row and column of the field has its patches.
    period
        Rows and columns after which the target repeats; (0, 0) if it doesn't.
    exemplar, exemplar_cols, allowed
        What patches are taken from, and where one may begin (flat).
    price, crowd, most
        For each place its price in squared steps, and how often its pixels are shown: a random candidate shown
        more often than ``most`` is taken only for one shown still more often (Kaspar et al. 2015, 3.2).
    starts, order, shift_price
        See `again_price`; with an empty ``order`` nothing is priced so.
    field, found, cost
        Places before and after, and squared difference of each patch to its place.
    colour, begin, end
        Which squares of the checkerboard, and which rows.
    key, tries
        Of the pass, and how many random candidates each patch looks at.
    """
    field_rows, field_cols = field.shape
    target_stride, exemplar_stride = target_cols * CHANNELS, exemplar_cols * CHANNELS
    exemplar_rows = len(allowed) // exemplar_cols
    last_row, last_col = exemplar_rows - PATCH_PX, exemplar_cols - PATCH_PX
    wraps, priced = period[0] > 0, len(order) > 0
    for i in range(begin, end):
        for j in range((i + colour) & 1, field_cols, 2):
            at = int(rows_px[i] * target_cols + cols_px[j]) * CHANNELS
            me = i * field_cols + j
            best = int(np.int64(field[i, j]))
            nearest = patch_difference(target, at, target_stride, exemplar, best * CHANNELS, exemplar_stride, _FAR)
            score = nearest + int(price[best])
            if priced:
                score += again_price(best, me, i, j, field_cols, starts, order, shift_price)
            best_row, best_col = best // exemplar_cols, best % exemplar_cols
            radius = max(exemplar_rows, exemplar_cols)
            for k in range(4 + tries):
                if k < 4:
                    ni = i + (k == 1) - (k == 0)
                    nj = j + (k == 3) - (k == 2)
                    down, right = 0, 0
                    if wraps:
                        if ni < 0:
                            ni += field_rows
                            down = period[0]
                        elif ni >= field_rows:
                            ni -= field_rows
                            down = -period[0]
                        if nj < 0:
                            nj += field_cols
                            right = period[1]
                        elif nj >= field_cols:
                            nj -= field_cols
                            right = -period[1]
                    elif ni < 0 or ni >= field_rows or nj < 0 or nj >= field_cols:
                        continue
                    place = int(np.int64(field[ni, nj]))
                    row = place // exemplar_cols + int(rows_px[i] - rows_px[ni]) + down
                    col = place % exemplar_cols + int(cols_px[j] - cols_px[nj]) + right
                    if row < 0 or col < 0 or row > last_row or col > last_col:
                        continue
                else:
                    word = mixed(key + np.uint64(me * 64 + k))
                    low_row, low_col = max(0, best_row - radius), max(0, best_col - radius)
                    rows = min(last_row, best_row + radius) - low_row + 1
                    cols = min(last_col, best_col + radius) - low_col + 1
                    row = low_row + ((int(np.int64(word & np.uint64(0xFFFFFFFF))) * rows) >> 32)
                    col = low_col + ((int(np.int64(word >> np.uint64(32))) * cols) >> 32)
                    radius = max(1, radius >> 1)
                place = row * exemplar_cols + col
                if place == best or not allowed[place]:
                    continue
                if k >= 4 and crowd[place] > most and crowd[place] >= crowd[best]:
                    continue
                asked = int(price[place])
                if priced:
                    asked += again_price(place, me, i, j, field_cols, starts, order, shift_price)
                if asked >= score:
                    continue
                difference = patch_difference(
                    target, at, target_stride, exemplar, place * CHANNELS, exemplar_stride, score - asked
                )
                if difference < score - asked:
                    best, score, nearest = place, difference + asked, difference
                    best_row, best_col = row, col
            found[i, j] = best
            cost[i, j] = nearest


def search_plain(
    target: NDArray[np.int16],
    rows_px: NDArray[np.int64],
    cols_px: NDArray[np.int64],
    exemplar: NDArray[np.int16],
    allowed: NDArray[np.bool_],
    price: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """What a search would find if it looked everywhere: the twin that tests hold the kernel against.

    Parameters
    ----------
    target, exemplar
        (rows, cols, 4) int16.
    rows_px, cols_px
        Where patches begin.
    allowed, price
        (exemplar rows, exemplar cols).

    Returns
    -------
    places, difference
        Cheapest place of each patch, the first of equals, and its squared difference.
    """
    windows = np.lib.stride_tricks.sliding_window_view
    of_exemplar = windows(exemplar.astype(np.int64), (PATCH_PX, PATCH_PX), axis=(0, 1))
    of_target = windows(target.astype(np.int64), (PATCH_PX, PATCH_PX), axis=(0, 1))
    rows, cols = of_exemplar.shape[:2]
    places = np.empty((len(rows_px), len(cols_px)), dtype=np.int32)
    differences = np.empty(places.shape, dtype=np.int64)
    for i, row in enumerate(rows_px):
        for j, col in enumerate(cols_px):
            difference = ((of_exemplar - of_target[row, col]) ** 2).sum(axis=(2, 3, 4))
            score = np.where(allowed[:rows, :cols], difference + price[:rows, :cols], _FAR)
            best_row, best_col = np.unravel_index(int(score.argmin()), score.shape)
            places[i, j] = best_row * exemplar.shape[1] + best_col
            differences[i, j] = difference[best_row, best_col]
    return places, differences
