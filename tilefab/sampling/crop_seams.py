"""Where the crops of the plane meet: seams of least cost, found coarse to fine.

Cells are joined in two steps. Side by side, the seam runs down the whole overlap of two crops, its ends free. Then one
seam runs along each row of cells, below which the lower crops show. It is pinned at the middle of every cell, where
just two crops meet, at the place where the best seam of those two alone would pass; between two pins it knows all
four crops and the two upright seams that end on it. So corners are junctions of three, found with the seam, and a
seam depends on four crops at most.

A seam is a shortest path (Efros and Freeman 2001, "Image quilting", section 2.1, with the cost of Kwatra et al.
2003, "Graphcut textures", eq. 1): between two pixels it pays for both, and for both again where it steps aside. It is
searched everywhere at the coarsest level and within a band around the coarser seam at each finer one (Lombaert et al.
2005, "A multilevel banded graph cuts method for fast image segmentation").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.sampling.crop_map import GuideLevels

_BAND_PX = 2
_FAR = np.int64(1) << 60
_FREE = -1


@kernel
def _pixel_cost(pixels: NDArray[np.uint8], table: NDArray[np.int64], channels: int, first: int, second: int) -> int:
    """Cost of a seam at a pixel where crop pixel ``first`` meets ``second``; both are places in ``pixels``.

    Takes the guide's parts rather than the guide: kernels count references to every array of a tuple they pass on.
    """
    squared = np.int64(0)
    for k in range(3):
        difference = np.int64(pixels[first + k]) - np.int64(pixels[second + k])
        squared += difference * difference
    cost = np.int64(table[min(int(squared >> 2), len(table) - 1)])
    if channels == 4:
        weight = max(pixels[first + 3], pixels[second + 3])
        cost += (cost * np.int64(weight)) >> 4
    return int(cost)


@kernel
def _shortest_path(
    cost: NDArray[np.int64],
    low: NDArray[np.int64],
    length: int,
    width: int,
    begin: int,
    end: int,
    total: NDArray[np.int64],
    path: NDArray[np.int64],
) -> None:
    """Cheapest path down a band.

    Row t of the band has the places ``low[t] + k``; place x lies between pixels x - 1 and x of the strip, whose
    costs are ``cost[t, k]`` and ``cost[t, k + 1]``. Places run from 1 to ``width`` - 1. ``begin`` and ``end`` pin the
    ends unless they are `_FREE`. The result is written to ``path``.
    """
    places = total.shape[1]
    for t in range(length):
        for k in range(places):
            x = low[t] + k
            if x < 1 or x > width - 1 or (t == 0 and begin != _FREE and x != begin):
                total[t, k] = _FAR
                continue
            own = cost[t, k] + cost[t, k + 1]
            if t == 0:
                total[t, k] = own
                continue
            before = x - low[t - 1]
            best = total[t - 1, before] if 0 <= before < places else _FAR
            if 0 < before <= places:
                step = total[t - 1, before - 1] + cost[t - 1, before] + cost[t, k]
                best = min(best, step)
            if -1 <= before < places - 1:
                step = total[t - 1, before + 1] + cost[t - 1, before + 1] + cost[t, k + 1]
                best = min(best, step)
            total[t, k] = min(best + own, _FAR)
    k = 0
    if end != _FREE:
        k = min(max(end - low[length - 1], 0), places - 1)
    else:
        for other in range(1, places):
            if total[length - 1, other] < total[length - 1, k]:
                k = other
    path[length - 1] = low[length - 1] + k
    for t in range(length - 1, 0, -1):
        x = path[t]
        k = x - low[t]
        wanted = total[t, k] - cost[t, k] - cost[t, k + 1]
        before = x - low[t - 1]
        if 0 <= before < places and total[t - 1, before] == wanted:
            path[t - 1] = x
        elif (
            0 < before <= places and total[t - 1, before - 1] + cost[t - 1, before] + cost[t, k] == wanted
        ) or before >= places:
            path[t - 1] = max(x - 1, 1)
        else:
            path[t - 1] = min(x + 1, width - 1)


@kernel
def _band_around(
    path: NDArray[np.int64], halving: int, length: int, width: int, places: int, low: NDArray[np.int64]
) -> None:
    """First place of the band in each row: around twice the coarser path."""
    for t in range(length):
        at = path[min(t >> 1, halving - 1)] * 2 - places // 2
        low[t] = max(min(at, width - places), 1)


@kernel
def _pair_seam(
    guide: GuideLevels,
    coarsest: int,
    finest: int,
    places: NDArray[np.int64],
    length: int,
    width: int,
    upright: bool,
    room: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
) -> None:
    """Free seam between the overlaps of two crops, left in the last array of ``room``.

    ``places`` (2, 2) holds row and column, at the guide's own level, of the top left pixel of each crop's part of the
    overlap; ``length`` and ``width`` its size at that level.
    """
    cost, total, low, path = room
    pixels, table, channels = guide.pixels, guide.cost, guide.channels
    for level in range(coarsest, finest - 1, -1):
        n, m = length >> level, width >> level
        cols, begin = guide.cols[level], guide.begin[level]
        along = (cols if upright else 1) * guide.channels
        across = (1 if upright else cols) * guide.channels
        at_first = begin + ((places[0, 0] >> level) * cols + (places[0, 1] >> level)) * guide.channels
        at_second = begin + ((places[1, 0] >> level) * cols + (places[1, 1] >> level)) * guide.channels
        band = min(2 * _BAND_PX + 1, m - 1)
        if level == coarsest:
            band = m - 1
            for t in range(n):
                low[t] = 1
        else:
            _band_around(path, n >> 1, n, m, band, low)
        for t in range(n):
            for k in range(band + 1):
                shift = t * along + (low[t] + k - 1) * across
                cost[t, k] = _pixel_cost(pixels, table, channels, at_first + shift, at_second + shift)
        _shortest_path(cost[:, : band + 1], low, n, m, _FREE, _FREE, total[:, :band], path)


@kernel
def _working_room(
    coarsest: int, finest: int, length: int, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    places = max(width >> coarsest, min(2 * _BAND_PX + 1, (width >> finest) - 1))
    rows = (length >> finest) + 1
    return (
        np.empty((rows, places + 1), dtype=np.int64),
        np.empty((rows, places), dtype=np.int64),
        np.empty(rows, dtype=np.int64),
        np.empty(rows, dtype=np.int64),
    )


@kernel
def upright_seams_into(
    seams: NDArray[np.int16],
    window: NDArray[np.int32],
    from_row: int,
    to_row: int,
    guide: GuideLevels,
    crop_row: NDArray[np.int64],
    crop_col: NDArray[np.int64],
    pitch: int,
    overlap: int,
    coarsest: int,
    finest: int,
) -> None:
    """Seams between cells side by side, for some rows of a window of cells.

    ``seams[i, j, t]``: between cells (i, j - 1) and (i, j), at row t of their crops, the first pixel of the overlap
    that shows the right one. All sizes and places are the guide's own pixels; ``seams`` are those of level
    ``finest``.
    """
    length = pitch + overlap
    room = _working_room(coarsest, finest, length, overlap)
    places = np.empty((2, 2), dtype=np.int64)
    for i in range(from_row, to_row):
        for j in range(1, window.shape[1]):
            left, right = window[i, j - 1], window[i, j]
            places[0, 0], places[0, 1] = crop_row[left], crop_col[left] + pitch
            places[1, 0], places[1, 1] = crop_row[right], crop_col[right]
            _pair_seam(guide, coarsest, finest, places, length, overlap, True, room)
            for t in range(length >> finest):
                seams[i, j, t] = room[3][t]


@kernel
def pins_into(
    pins: NDArray[np.int64],
    window: NDArray[np.int32],
    from_line: int,
    to_line: int,
    guide: GuideLevels,
    crop_row: NDArray[np.int64],
    crop_col: NDArray[np.int64],
    pitch: int,
    overlap: int,
    coarsest: int,
    finest: int,
) -> None:
    """Where the level seam above row i of cells passes the middle of column j: ``pins[i, j]``, at level ``finest``.

    The free seam of the two crops, found at the coarsest level, says where; the cheapest place near that is taken at
    each finer one.
    """
    length = pitch + overlap
    room = _working_room(coarsest, coarsest, length, overlap)
    places = np.empty((2, 2), dtype=np.int64)
    pixels, table, channels = guide.pixels, guide.cost, guide.channels
    for i in range(from_line, to_line):
        for j in range(window.shape[1]):
            above, below = window[i - 1, j], window[i, j]
            places[0, 0], places[0, 1] = crop_row[above] + pitch, crop_col[above]
            places[1, 0], places[1, 1] = crop_row[below], crop_col[below]
            _pair_seam(guide, coarsest, coarsest, places, length, overlap, False, room)
            pin = room[3][(length >> coarsest) // 2]
            for level in range(coarsest - 1, finest - 1, -1):
                cols, begin = guide.cols[level], guide.begin[level]
                middle = (length >> level) // 2
                at_above = (places[0, 0] >> level) * cols + (places[0, 1] >> level) + middle
                at_below = (places[1, 0] >> level) * cols + (places[1, 1] >> level) + middle
                best, best_cost = 2 * pin, _FAR
                for x in range(max(2 * pin - 2, 1), min(2 * pin + 3, (overlap >> level) - 1) + 1):
                    cost = np.int64(0)
                    for t in range(-1, 2):
                        for y in range(x - 1, x + 1):
                            shift = y * cols + t
                            cost += _pixel_cost(
                                pixels,
                                table,
                                channels,
                                begin + (at_above + shift) * channels,
                                begin + (at_below + shift) * channels,
                            )
                    if cost < best_cost:
                        best, best_cost = x, cost
                pin = best
            pins[i, j] = pin


@kernel
def level_seams_into(
    seams: NDArray[np.int16],
    window: NDArray[np.int32],
    upright: NDArray[np.int16],
    pins: NDArray[np.int64],
    from_line: int,
    to_line: int,
    guide: GuideLevels,
    crop_row: NDArray[np.int64],
    crop_col: NDArray[np.int64],
    pitch: int,
    overlap: int,
    coarsest: int,
    finest: int,
) -> None:
    """Seams between rows of cells, for some lines of a window of cells.

    ``seams[i, j, t]``: between rows i - 1 and i, t pixels right of the middle of cell j - 1, the first row of the
    overlap that shows the lower row of cells. There are as many t as pixels in a pitch.
    """
    room = _working_room(coarsest, finest, pitch + 1, overlap)
    cost, total, low, path = room
    pixels, table, channels = guide.pixels, guide.cost, guide.channels
    for i in range(from_line, to_line):
        for j in range(1, window.shape[1]):
            for level in range(coarsest, finest - 1, -1):
                n, m, reach = (pitch >> level) + 1, overlap >> level, pitch >> level
                half_pitch, half_overlap = reach // 2, m // 2
                finer = level - finest
                cols, begin = guide.cols[level], guide.begin[level]
                band = min(2 * _BAND_PX + 1, m - 1)
                if level == coarsest:
                    band = m - 1
                    for t in range(n):
                        low[t] = 1
                else:
                    _band_around(path, (n >> 1) + 1, n, m, band, low)
                for t in range(n):
                    # From the middle of cell j - 1: how far right of the left edge of the upright overlap.
                    right_of = t - half_pitch + half_overlap
                    for k in range(band + 1):
                        y = low[t] + k - 1
                        upper = lower = j
                        if right_of < 0:
                            upper = lower = j - 1
                        elif right_of < m:
                            if right_of < upright[i - 1, j, (reach + y) << finer] >> finer:
                                upper = j - 1
                            if right_of < upright[i, j, y << finer] >> finer:
                                lower = j - 1
                        above, below = window[i - 1, upper], window[i, lower]
                        at_above = ((crop_row[above] >> level) + reach + y) * cols + (crop_col[above] >> level)
                        at_below = ((crop_row[below] >> level) + y) * cols + (crop_col[below] >> level)
                        # A crop begins where the overlap to its left does.
                        at_above += right_of + (j - upper) * reach
                        at_below += right_of + (j - lower) * reach
                        cost[t, k] = _pixel_cost(
                            pixels, table, channels, begin + at_above * channels, begin + at_below * channels
                        )
                first = min(max(pins[i, j - 1] >> finer, 1), m - 1)
                last = min(max(pins[i, j] >> finer, 1), m - 1)
                _shortest_path(cost[:, : band + 1], low, n, m, first, last, total[:, :band], path)
            for t in range(pitch >> finest):
                seams[i, j, t] = path[t]
