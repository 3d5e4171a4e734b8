"""What it costs to join any two crops: the tables that choices are made by."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.sampling.crop_map import TYPICAL_COST
from tilefab.types import Array

_AT_ONCE = 64
_FAR = np.float32(1e30)
_LARGEST_COST = 15 * TYPICAL_COST
_ROWS_A_TASK = 32
_SAMPLE_STEP = 97


class JoiningCosts(NamedTuple):
    """(crops, crops) uint16 each: of the column's crop to the right of, and below, the row's.

    ``delta_e_per_unit`` turns a cost into the mean of CIE76**1.5 along the seam.
    """

    side: NDArray[np.uint16]
    below: NDArray[np.uint16]
    delta_e_per_unit: float


def joining_costs(
    guide_level: NDArray[np.uint8],
    crop_row: NDArray[np.int64],
    crop_col: NDArray[np.int64],
    pitch: int,
    overlap: int,
    threads: int,
    progress: Callable[[float], None],
) -> JoiningCosts:
    """Cost of the best seam between the overlaps of every two crops.

    Parameters
    ----------
    guide_level
        (rows, cols, 3 or 4) uint8 guide of a `CropMap`, at one scale.
    crop_row, crop_col
        (crops,) places of the crops, and
    pitch, overlap
        their sizes, in pixels of that scale.
    threads
        How many share the work.
    progress
        Called with the share done.

    Returns
    -------
    JoiningCosts
        Scaled to a median of `TYPICAL_COST`; all 0 where nothing differs.
    """
    side = pitch + overlap
    crops = len(crop_row)

    def strips(rows: slice, cols: slice, upright: bool) -> NDArray[np.float32]:
        """(crops, along, across, channels)."""
        parts = []
        for r, c in zip(crop_row, crop_col, strict=True):
            part = guide_level[r : r + side, c : c + side][rows, cols]
            parts.append(part if upright else part.transpose(1, 0, 2))
        return np.ascontiguousarray(np.array(parts, dtype=np.float32))

    everything = slice(None)
    begin, end = slice(0, overlap), slice(pitch, side)
    pairs = (
        (strips(everything, end, True), strips(everything, begin, True)),
        (strips(end, everything, False), strips(begin, everything, False)),
    )
    raw = [np.empty((crops, crops), dtype=np.float32) for _ in pairs]
    tasks = [(k, first) for k in range(2) for first in range(0, crops, _ROWS_A_TASK)]
    across = [np.ascontiguousarray(second.transpose(1, 2, 3, 0)) for _, second in pairs]
    done = 0

    def work(task: tuple[int, int]) -> None:
        nonlocal done
        k, first = task
        last = min(first + _ROWS_A_TASK, crops)
        best_seams_into(raw[k][first:last], pairs[k][0][first:last], across[k])
        done += 1
        progress(done / len(tasks))

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, tasks))
    sample = np.concatenate([table.ravel()[::_SAMPLE_STEP] for table in raw])
    typical = float(np.median(sample))
    scale = TYPICAL_COST / typical if typical > 0 else 0.0

    def quantised(table: Array) -> NDArray[np.uint16]:
        return np.minimum(np.rint(table * np.float32(scale)), _LARGEST_COST).astype(np.uint16)

    # Two pixels of half units are paid for at every step: 2 * 2**1.5.
    per_unit = 1 / (scale * side * 2 * 2**1.5) if scale else 0.0
    return JoiningCosts(quantised(raw[0]), quantised(raw[1]), per_unit)


@kernel
def best_seams_into(costs: NDArray[np.float32], firsts: NDArray[np.float32], seconds: NDArray[np.float32]) -> None:
    """Cost of the cheapest seam of each of ``firsts`` (crops, along, across, channels) with each of ``seconds``.

    ``seconds`` is (along, across, channels, crops): the innermost loop goes over many crops at a time. The same
    shortest path as in `tilefab.sampling.crop_seams`, costs only.
    """
    length, width, channels, crops = seconds.shape
    now = np.empty((width, _AT_ONCE), dtype=np.float32)
    before = np.empty((width, _AT_ONCE), dtype=np.float32)
    total = np.empty((width + 1, _AT_ONCE), dtype=np.float32)
    following = np.empty((width + 1, _AT_ONCE), dtype=np.float32)
    weight = np.empty(_AT_ONCE, dtype=np.float32)
    for first in range(len(firsts)):
        for low in range(0, crops, _AT_ONCE):
            count = min(_AT_ONCE, crops - low)
            total[:] = _FAR
            following[:] = _FAR
            for t in range(length):
                for x in range(width):
                    cost = now[x]
                    cost[:] = 0
                    for channel in range(3):
                        value = firsts[first, t, x, channel]
                        other = seconds[t, x, channel, low : low + count]
                        for k in range(count):
                            difference = value - other[k]
                            cost[k] += difference * difference
                    for k in range(_AT_ONCE):
                        cost[k] = np.sqrt(cost[k] * np.sqrt(cost[k]))
                    if channels == 4:
                        value = firsts[first, t, x, 3]
                        other = seconds[t, x, 3, low : low + count]
                        for k in range(count):
                            weight[k] = max(value, other[k])
                        for k in range(count):
                            cost[k] += cost[k] * weight[k] * np.float32(1 / 16)
                for x in range(1, width):
                    best = following[x]
                    if t == 0:
                        for k in range(_AT_ONCE):
                            best[k] = now[x - 1, k] + now[x, k]
                        continue
                    straight, left, right = total[x], total[x - 1], total[x + 1]
                    cost_left, cost_right, was_left, was_right = now[x - 1], now[x], before[x - 1], before[x]
                    for k in range(_AT_ONCE):
                        step = min(
                            straight[k],
                            min(left[k] + was_left[k] + cost_left[k], right[k] + was_right[k] + cost_right[k]),
                        )
                        best[k] = step + cost_left[k] + cost_right[k]
                total, following = following, total
                now, before = before, now
                total[0] = _FAR
                total[width] = _FAR
            for k in range(count):
                least = total[1, k]
                for x in range(2, width):
                    least = min(least, total[x, k])
                costs[first, low + k] = least
