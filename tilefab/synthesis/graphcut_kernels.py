"""Kernels of `graphcut`: what a seam costs, the graph of a window, and its minimum cut.

A pixel of the output is named by the pixel of the exemplar that it shows, so the cost of a seam between two
neighbours follows from the two names alone. Old seams needn't be kept in a list to be remembered.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel

UNSET = -1
"""In a source map: nothing lies here yet."""

FREE = 0
"""Label of a pixel that the cut may give to either side."""
TAKE = 1
"""Label of a pixel that must come from the new patch."""
KEEP = 2
"""Label of a pixel that must stay as it is."""
IGNORE = 3
"""Label of a pixel that isn't there: beyond the output, or neither laid nor coverable yet."""

_COST_STEPS = 16
_WEIGHT_SHIFT = 4

RIGHT, BELOW, LEFT, ABOVE = 1, 2, 4, 8
"""Bits of `known`: which neighbours of a pixel of the exemplar exist and are valid."""


@kernel
def pair_cost(
    first: int,
    second: int,
    down: int,
    step: int,
    colours: NDArray[np.int16],
    known: NDArray[np.uint8],
    gradients: NDArray[np.int32],
    floor: int,
    weights: NDArray[np.uint8],
) -> int:
    """Cost of showing two pixels of the exemplar side by side, or one above the other.

    Parameters
    ----------
    first, second
        Flat indices into the exemplar: of the left and the right pixel, or of the upper and the lower.
    down
        0 if side by side, 1 if one above the other.
    step
        From a pixel of the exemplar to the next in that direction: 1, or the exemplar's columns.
    colours
        (pixels, channels) int16, from `matching_image`.
    known
        (pixels,) of `RIGHT`, `BELOW`, `LEFT` and `ABOVE`.
    gradients
        (2, pixels) int32 >= 0: across and down, see `graphcut_canvas.gradients`.
    floor
        > 0: added to the four gradients, so that the cost is finite in flat parts; and the unit of their sum.
    weights
        (pixels,) uint8: the greater, the dearer is a seam there.

    Returns
    -------
    int
        0 if the second pixel follows the first in the exemplar, else 1 or more.

    Notes
    -----
    Kwatra et al. 2003, equations 1 and 6, times the weights of the second seed-thesis, 3.3.3, here from 1 to 17 for
    either pixel. But differences are squared: with their plain norm many a cut takes the shortest way, straight
    across what doesn't match. Where one of the patches would leave the exemplar, or its mask, the other side counts
    twice; where both would, the two colours shown are compared.
    """
    on = known[first] & (BELOW if down else RIGHT) != 0
    back = known[second] & (ABOVE if down else LEFT) != 0
    if on and second == first + step:
        return 0
    # The patch of the first pixel goes on beside the second, and that of the second comes from beside the first.
    ahead = first + step if on else first
    behind = second - step if back else second
    at_second = at_first = np.int64(0)
    for k in range(colours.shape[1]):
        d = np.int64(colours[ahead, k]) - np.int64(colours[second, k])
        at_second += d * d
        d = np.int64(colours[behind, k]) - np.int64(colours[first, k])
        at_first += d * d
    if on and not back:
        at_first = at_second
    elif back and not on:
        at_second = at_first
    gradient = (
        np.int64(gradients[down, first])
        + np.int64(gradients[down, second])
        + np.int64(gradients[down, ahead])
        + np.int64(gradients[down, behind])
    )
    cost = (at_first + at_second) * _COST_STEPS * floor // (gradient + floor) + 1
    unit = np.int64(1) << _WEIGHT_SHIFT
    return int((cost * (unit + weights[first]) * (unit + weights[second])) >> (2 * _WEIGHT_SHIFT))


@kernel
def window_costs(
    source: NDArray[np.int32],
    step_down: int,
    colours: NDArray[np.int16],
    known: NDArray[np.uint8],
    gradients: NDArray[np.int32],
    floor: int,
    weights: NDArray[np.uint8],
) -> NDArray[np.int64]:
    """Cost of the seams right of and below each pixel of a window, (rows, cols); 0 beyond its last row and column.

    Twin: `window_costs_plain`.
    """
    rows, cols = source.shape
    total = np.zeros((rows, cols), np.int64)
    for r in range(rows):
        for c in range(cols):
            here = source[r, c]
            if here == UNSET:
                continue
            if c + 1 < cols and source[r, c + 1] != UNSET:
                total[r, c] += pair_cost(here, source[r, c + 1], 0, 1, colours, known, gradients, floor, weights)
            if r + 1 < rows and source[r + 1, c] != UNSET:
                total[r, c] += pair_cost(
                    here, source[r + 1, c], 1, step_down, colours, known, gradients, floor, weights
                )
    return total


def window_costs_plain(
    source: NDArray[np.int32],
    step_down: int,
    colours: NDArray[np.int16],
    known: NDArray[np.uint8],
    gradients: NDArray[np.int32],
    floor: int,
    weights: NDArray[np.uint8],
) -> NDArray[np.int64]:
    """Plain twin of `window_costs` and `pair_cost`."""
    total = np.zeros(source.shape, dtype=np.int64)
    for down, step, on_bit, back_bit in ((0, 1, RIGHT, LEFT), (1, step_down, BELOW, ABOVE)):
        first, second = (source[:-1], source[1:]) if down else (source[:, :-1], source[:, 1:])
        on, back = known[first] & on_bit != 0, known[second] & back_bit != 0
        ahead, behind = np.where(on, first + step, first), np.where(back, second - step, second)
        seen = [
            ((colours[a].astype(np.int64) - colours[b]) ** 2).sum(axis=2) for a, b in ((ahead, second), (behind, first))
        ]
        jump = np.where(on == back, seen[0] + seen[1], 2 * np.where(on, seen[0], seen[1]))
        slope = gradients[down].astype(np.int64)
        gradient = slope[first] + slope[second] + slope[ahead] + slope[behind]
        cost = jump * _COST_STEPS * floor // (gradient + floor) + 1
        factor = (1 << _WEIGHT_SHIFT) + weights.astype(np.int64)
        cost = (cost * factor[first] * factor[second]) >> (2 * _WEIGHT_SHIFT)
        cost[(on & (second == first + step)) | (first == UNSET) | (second == UNSET)] = 0
        here = total[:-1] if down else total[:, :-1]
        here += cost
    return total


@kernel
def window_graph(
    source: NDArray[np.int32],
    labels: NDArray[np.uint8],
    place: int,
    prices: NDArray[np.int64],
    step_down: int,
    colours: NDArray[np.int16],
    known: NDArray[np.uint8],
    gradients: NDArray[np.int32],
    floor: int,
    weights: NDArray[np.uint8],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Graph of a window whose minimum cut says where a new patch is to be shown.

    Parameters
    ----------
    source
        (rows, cols) int32: what lies there, `UNSET` where nothing does.
    labels
        (rows, cols) of `FREE`, `TAKE`, `KEEP` and `IGNORE`; what is unset can't be free or kept.
    place
        Flat index that the new patch would have at the window's first pixel. It may lie beyond the exemplar, as long
        as the patch lies inside wherever it may be shown.
    prices
        (rows, cols) int64: what showing the new patch at a pixel costs more than leaving it, seams apart.
    step_down
        The exemplar's columns.
    colours, known, gradients, floor, weights
        See `pair_cost`.

    Returns
    -------
    capacities
        (4, (rows + 2) * (cols + 2)) int64 >= 0: of the arcs to the right, left, below and above of each pixel, within
        a border of one pixel. Only free pixels are joined.
    terminals
        ((rows + 2) * (cols + 2),) int64: capacity from the source (new patch) if > 0, to the sink if < 0.

    Notes
    -----
    Kwatra et al. 2003, section 3.1, put a node on each old seam, tied to both pixels and to the new patch, so that
    the old seam's cost is paid as long as both pixels stay. Such a node may be left out: the cost of a pair as a
    function of two choices is submodular as long as the old seam costs no more than both new ones together
    (Kolmogorov and Zabih 2004, "What energy functions can be minimized via graph cuts?"), and splits into one arc
    each way and something for either pixel if it stays. Where an old seam is dearer than that, it counts for as much
    as both.
    """
    rows, cols = source.shape
    width = cols + 2
    offsets = np.array([1, -1, width, -width])
    capacities = np.zeros((4, (rows + 2) * width), np.int64)
    terminals = np.zeros((rows + 2) * width, np.int64)
    for r in range(rows):
        for c in range(cols):
            node = (r + 1) * width + c + 1
            label = labels[r, c]
            if label == IGNORE:
                continue
            if label == FREE:
                terminals[node] -= prices[r, c]
            new_here = place + r * step_down + c
            for down in range(2):
                across = 1 - down
                step = step_down if down else 1
                r2, c2 = r + down, c + across
                if r2 >= rows or c2 >= cols:
                    continue
                other = labels[r2, c2]
                if other == IGNORE or (label != FREE and other != FREE):
                    continue
                new_there = place + r2 * step_down + c2
                here, there = source[r, c], source[r2, c2]
                beyond = node + offsets[2 * down]
                both = first = second = 0
                # What both cost if they stay; if only the first is new; and if only the second is.
                if here != UNSET and there != UNSET:
                    both = pair_cost(here, there, down, step, colours, known, gradients, floor, weights)
                if there != UNSET and label != KEEP:
                    first = pair_cost(new_here, there, down, step, colours, known, gradients, floor, weights)
                if here != UNSET and other != KEEP:
                    second = pair_cost(here, new_there, down, step, colours, known, gradients, floor, weights)
                # Beside a forced pixel the cost is the free one's alone.
                if label == KEEP:
                    terminals[beyond] += both - second
                elif label == TAKE:
                    terminals[beyond] += first
                elif other == KEEP:
                    terminals[node] += both - first
                elif other == TAKE:
                    terminals[node] += second
                else:
                    both = min(both, first + second)
                    of_first = max(both - first, min(second, both // 2))
                    capacities[2 * down, node] = first - (both - of_first)
                    capacities[2 * down + 1, beyond] = second - of_first
                    terminals[node] += of_first
                    terminals[beyond] += both - of_first
    return capacities, terminals
