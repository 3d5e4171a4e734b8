"""Which crop each cell of the plane shows: decided in dependent order, within a bounded reach.

The cells form a 2 x 2 pattern of four classes, of which no two of one class touch. The first class draws by hash;
the second is given the first to its left and right, the third those above and below, the last all four; each takes
the cheapest of a hashed part of the dictionary, and of the crops that continue its neighbours: the cost of joining
known neighbours, the price that makes use of the slab even, and a penalty for showing what a cell that touches shows
already. Then the same order is gone through
again, every cell given all its neighbours (iterated conditional modes, Besag 1986). A step reads only cells one
further out, so a choice depends on as many rings of cells as there were steps, and on nothing else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.rng import philox_4x32
from tilefab.sampling.crop_map import BARRED, RATION_PERIOD, STEPS_OF_ORDER, ChoiceTables, CropMap

_LARGEST = 2**31 - 1
_SWEEP_SHIFT = np.uint64(59)
_NONE = -1
_ONLY_BARRED = BARRED // 2
"""No crop that may be shown costs as much, and every other costs more."""
BLOCK_CELLS = 2
"""Side of the blocks of cells that rationed crops take turns in."""
_KNIGHT = 2


def choose_crops(crop_map: CropMap, key: np.uint64, row: int, col: int, rows: int, cols: int) -> NDArray[np.int32]:
    """Crops shown by a window of cells.

    Parameters
    ----------
    crop_map
        The map.
    key
        Stream of the job's choices, from `tilefab.rng.stream_key`.
    row, col
        Top left cell; may be negative.
    rows, cols
        Size of the window, in cells.

    Returns
    -------
    ndarray of int32
        (rows, cols): number of the crop each cell shows; the same whatever window it was asked for in.
    """
    tables = crop_map.choice_tables
    margin = STEPS_OF_ORDER * (tables.sweeps + 1) - 1
    window = np.zeros((rows + 2 * margin, cols + 2 * margin), dtype=np.int32)
    choose_into(window, row - margin, col - margin, key, tables)
    return np.ascontiguousarray(window[margin : margin + rows, margin : margin + cols])


@kernel
def _add(total: NDArray[np.int32], table: NDArray[np.uint16], low: int, count: int) -> None:
    part = table[low : low + count]
    for k in range(count):
        total[k] += np.int32(part[k])


@kernel
def _turn(cell_row: int, cell_col: int) -> int:
    """Whose turn a block of cells is among rationed crops: blocks of one turn lie a knight's move apart."""
    return (cell_row // BLOCK_CELLS + _KNIGHT * (cell_col // BLOCK_CELLS)) % RATION_PERIOD


@kernel
def _cost_of(
    crop: int, around: NDArray[np.int32], diagonals: NDArray[np.int32], turn: int, tables: ChoiceTables
) -> int:
    """Cost of one crop, given the cells around that are known: left, right, above, below."""
    cost: int = np.int64(tables.price[crop]) + tables.ration[turn, crop]
    if around[0] != _NONE:
        cost += tables.side[around[0], crop]
    if around[1] != _NONE:
        cost += tables.side_back[around[1], crop]
    if around[2] != _NONE:
        cost += tables.below[around[2], crop]
    if around[3] != _NONE:
        cost += tables.below_back[around[3], crop]
    for k in range(4):
        if diagonals[k] != _NONE:
            cost += tables.corner[diagonals[k], crop]
    return cost


@kernel
def _cheapest(
    start: int,
    tried: int,
    around: NDArray[np.int32],
    diagonals: NDArray[np.int32],
    turn: int,
    tables: ChoiceTables,
    total: NDArray[np.int32],
) -> tuple[int, int]:
    """Cheapest of ``tried`` crops from ``start`` on in the dictionary, and its cost; of equals, the first."""
    crops = len(tables.price)
    best, best_cost = 0, _LARGEST
    for part in range(2):
        low = start if part == 0 else 0
        count = min(tried, crops - start) if part == 0 else start + tried - crops
        if count <= 0:
            continue
        price = tables.price[low : low + count]
        for k in range(count):
            total[k] = price[k]
        if tables.rationed:
            ration = tables.ration[turn, low : low + count]
            for k in range(count):
                total[k] += ration[k]
        if around[0] != _NONE:
            _add(total, tables.side[around[0]], low, count)
        if around[1] != _NONE:
            _add(total, tables.side_back[around[1]], low, count)
        if around[2] != _NONE:
            _add(total, tables.below[around[2]], low, count)
        if around[3] != _NONE:
            _add(total, tables.below_back[around[3]], low, count)
        for k in range(4):
            if diagonals[k] != _NONE:
                _add(total, tables.corner[diagonals[k]], low, count)
        # Two passes, for the first is done many numbers at a time.
        least = total[0]
        for k in range(1, count):
            least = min(least, total[k])
        if least < best_cost:
            best_cost = least
            for k in range(count):
                if total[k] == least:
                    best = low + k
                    break
    return best, best_cost


@kernel
def choose_into(window: NDArray[np.int32], row: int, col: int, key: np.uint64, tables: ChoiceTables) -> None:
    """Choose the crops of a window whose top left cell is (row, col); only cells some way in are final.

    A ring of 4 x (sweeps + 1) - 1 cells is lost: the step number s, counted from 0, needs the ring s further out.
    """
    rows, cols = window.shape
    crops = np.uint64(len(tables.price))
    total = np.empty(len(tables.price), dtype=np.int32)
    around = np.empty(4, dtype=np.int32)
    diagonals = np.empty(4, dtype=np.int32)
    step = 0
    for sweep in range(tables.sweeps + 1):
        for turn in range(STEPS_OF_ORDER):
            for i in range(step, rows - step):
                if (row + i) & 1 != turn >> 1:
                    continue
                for j in range(step, cols - step):
                    if (col + j) & 1 != turn & 1:
                        continue
                    word, _ = philox_4x32(
                        key, np.uint64(row + i), np.uint64(col + j) ^ (np.uint64(sweep) << _SWEEP_SHIFT)
                    )
                    start = int(np.int64(word % crops))
                    block = _turn(row + i, col + j)
                    # Turn 1 lies beside cells of turn 0, turn 2 below and above them, with turn 1 at its corners.
                    known_beside = sweep > 0 or turn == 1 or turn == 3
                    known_above = sweep > 0 or turn >= 2
                    around[0] = window[i, j - 1] if known_beside else _NONE
                    around[1] = window[i, j + 1] if known_beside else _NONE
                    around[2] = window[i - 1, j] if known_above else _NONE
                    around[3] = window[i + 1, j] if known_above else _NONE
                    diagonals[0] = window[i - 1, j - 1] if known_above else _NONE
                    diagonals[1] = window[i - 1, j + 1] if known_above else _NONE
                    diagonals[2] = window[i + 1, j - 1] if known_above else _NONE
                    diagonals[3] = window[i + 1, j + 1] if known_above else _NONE
                    if sweep == 0 and turn == 0:
                        window[i, j] = _first(start, block, tables)
                        continue
                    best, cost = _cheapest(start, tables.candidates, around, diagonals, block, tables, total)
                    if cost >= _ONLY_BARRED:
                        best, cost = _cheapest(start, len(tables.price), around, diagonals, block, tables, total)
                    # Crops that continue a neighbour are few, and always tried.
                    for k in range(4):
                        other = tables.follows[around[k], k] if around[k] != _NONE else _NONE
                        if other != _NONE:
                            own = _cost_of(other, around, diagonals, block, tables)
                            if own < cost:
                                best, cost = other, own
                    if sweep == 0 or cost < _cost_of(window[i, j], around, diagonals, block, tables):
                        window[i, j] = best
            step += 1


@kernel
def _first(start: int, block: int, tables: ChoiceTables) -> int:
    """First crop from ``start`` on that may be shown in a block at all."""
    crops = len(tables.price)
    for k in range(crops):
        crop = (start + k) % crops
        if tables.price[crop] < _ONLY_BARRED and tables.ration[block, crop] == 0:
            return crop
    # Out of turn is better than never to be shown.
    for k in range(crops):
        crop = (start + k) % crops
        if tables.price[crop] < _ONLY_BARRED:
            return crop
    return start
