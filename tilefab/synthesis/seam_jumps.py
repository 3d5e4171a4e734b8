"""What the seams of a patchwork cost, place by place: what decides where one is repaired."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.texture.matching import LAB_STEPS_PER_UNIT

WEIGHT_SHIFT = 4
"""A weight of 255 makes a seam this many times dearer, as a power of two: 1 + 255 / 16."""


def weighted_cost(
    cost: NDArray[np.int64], first: NDArray[np.uint8] | None, second: NDArray[np.uint8] | None
) -> NDArray[np.int64]:
    """Cost of a seam where two pixels meet, dearer by the greater of their weights (0 to 255), up to 17 times.

    ``None`` for weights of 0. As walls of crops weigh them.
    """
    if first is None or second is None:
        return cost
    return cost + ((cost * np.maximum(first, second).astype(np.int64)) >> WEIGHT_SHIFT)


def seam_jumps(
    base: NDArray[np.int16],
    source: NDArray[np.int32],
    *,
    toroidal: bool = True,
    weights: NDArray[np.uint8] | None = None,
) -> NDArray[np.float64]:
    """Cost of the seams right of and below each pixel: squared colour steps, 0 where there is none.

    Parameters
    ----------
    base
        (exemplar rows, exemplar cols, channels) int16 from `tilefab.texture.matching.matching_image`.
    source
        (rows, cols) int32 map of places.
    toroidal
        Whether the last row and column are compared with the first. Otherwise nothing follows them.
    weights
        (exemplar rows, exemplar cols) uint8: see `weighted_cost`.

    Returns
    -------
    ndarray of float64
        (rows, cols).

    Notes
    -----
    On either side of a seam one piece shows a colour and the other would have shown another: the cost is the mean of
    the two squared differences (Kwatra et al. 2003, "Graphcut textures", Eq. 1, squared).
    """
    flat = base.reshape(-1, base.shape[2]).astype(np.float64)
    heights = None if weights is None else 1.0 + weights.reshape(-1) / float(1 << WEIGHT_SHIFT)
    total = np.zeros(source.shape)
    for axis, step in ((0, base.shape[1]), (1, 1)):
        neighbour = np.roll(source, -1, axis=axis)
        seam = neighbour != source + step
        if not toroidal:
            seam[(slice(None),) * axis + (-1,)] = False
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
        cost = (ahead + behind) / 2
        total[seam] += cost if heights is None else cost * np.maximum(heights[here], heights[there])
    return total


def seam_delta_e(base: NDArray[np.int16], source: NDArray[np.int32], *, toroidal: bool = True) -> tuple[float, float]:
    """Worst and mean colour step (CIE76) over all pixels with a seam right of or below them; 0.0 if there are none.

    Parameters are those of `seam_jumps`.
    """
    steps = np.sqrt(seam_jumps(base, source, toroidal=toroidal)) / LAB_STEPS_PER_UNIT
    on_seam = steps[steps > 0]
    return (float(on_seam.max()), float(on_seam.mean())) if on_seam.size else (0.0, 0.0)
