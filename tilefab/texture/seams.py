"""Minimum-cost seams between two overlapping images.

A cut separates the pixels taken from the new image from those left as they are, so that the jump across the cut is
as small as possible (Kwatra et al. 2003, "Graphcut textures", section 3; the first seed's 5.5.1 cuts its patches
so). All costs are integers, so the cut is the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from tilefab.types import Mask

Number = TypeVar("Number", bound=np.generic)

_SOURCE = 0
_SINK = 1
_FORCED_CAPACITY = 2**30
UNKNOWN_COST = 2**20
"""Cost of a pixel where one of the images isn't known; also the largest cost that counts."""
_BAND_PX = 2
_DIRECT_AREA_PX = 5000

FREE = 0
"""Label of a pixel that the cut may give to either side."""
TAKE = 1
"""Label of a pixel that must come from the new image."""
KEEP = 2
"""Label of a pixel that must stay as it is."""


def cut(cost: NDArray[np.int64], labels: NDArray[np.uint8]) -> Mask:
    """Which pixels to take from the new image, by minimum cut.

    Parameters
    ----------
    cost
        (rows, cols), integer >= 0: how badly the two images disagree at each pixel. A cut between neighbours pays
        the sum of both costs, plus one, so that of two equal cuts the shorter wins. Clipped at 2**20.
    labels
        (rows, cols) of `FREE`, `TAKE` and `KEEP`.

    Returns
    -------
    ndarray of bool
        (rows, cols), True where the new image is taken. Every `TAKE` pixel is True and every `KEEP` pixel False.

    Raises
    ------
    ValueError
        If the shapes differ.

    Notes
    -----
    Areas over 5,000 free pixels are cut at half size first; the seam found is then moved within a band of two
    pixels either side (the coarse-to-fine banding of Lombaert et al. 2005).

    Examples
    --------
    >>> cost = np.array([[9, 0, 9, 9], [9, 9, 0, 9]])
    >>> labels = np.array([[1, 0, 0, 2], [1, 0, 0, 2]], dtype=np.uint8)
    >>> cut(cost, labels).astype(int)
    array([[1, 1, 0, 0],
           [1, 1, 0, 0]])
    """
    if cost.shape != labels.shape:
        raise ValueError(f"cost {cost.shape} and labels {labels.shape} differ in shape")
    cost = np.clip(cost, 0, UNKNOWN_COST).astype(np.int64)
    free = labels == FREE
    if min(cost.shape) < 8 or np.count_nonzero(free) <= _DIRECT_AREA_PX:
        return _cut_directly(cost, labels)
    coarse = cut(_coarse_cost(cost), _coarse_labels(labels))
    guess = np.repeat(np.repeat(coarse, 2, axis=0), 2, axis=1)[: cost.shape[0], : cost.shape[1]]
    guess = (guess & (labels != KEEP)) | (labels == TAKE)
    inside = _filtered(guess, ndimage.minimum_filter1d, beyond=1)
    outside = ~_filtered(guess, ndimage.maximum_filter1d, beyond=0)
    banded = labels.copy()
    banded[free & inside] = TAKE
    banded[free & outside] = KEEP
    return _cut_directly(cost, banded)


def _filtered(mask: Mask, rank_filter: Callable[..., NDArray[np.uint8]], beyond: int) -> Mask:
    """Erode or dilate a mask by a square of the band's width, one axis after the other."""
    values = mask.view(np.uint8)
    for axis in (0, 1):
        values = rank_filter(values, 2 * _BAND_PX + 1, axis=axis, mode="constant", cval=beyond)
    return values.view(np.bool_)


def _quarters(values: NDArray[Number]) -> tuple[NDArray[Number], ...]:
    """Four arrays of half the size: the top left, top right, bottom left and bottom right pixels of 2 x 2 blocks.

    Edge pixels are repeated where a block would reach beyond the array.
    """
    padded = (
        np.pad(values, [(0, n % 2) for n in values.shape], mode="edge") if any(n % 2 for n in values.shape) else values
    )
    return padded[::2, ::2], padded[::2, 1::2], padded[1::2, ::2], padded[1::2, 1::2]


def _coarse_cost(cost: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cost at half size: that of the worst of four pixels."""
    a, b, c, d = _quarters(cost)
    return np.maximum(np.maximum(a, b), np.maximum(c, d))


def _coarse_labels(labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Labels at half size: a coarse pixel is forced where any of its four pixels is, unless they are forced both ways.

    Were all four needed, a rim one pixel wide or a lone pixel would be lost, and with it what the cut has to go by.
    """
    # FREE, TAKE and KEEP are 0, 1 and 2: the bits of their union tell what a block holds, and both bits mean FREE.
    a, b, c, d = _quarters(labels)
    union = a | b | c | d
    return np.where(union == (TAKE | KEEP), FREE, union).astype(np.uint8)


def _cut_directly(cost: NDArray[np.int64], labels: NDArray[np.uint8]) -> Mask:
    take: Mask = labels == TAKE
    free = labels == FREE
    if not free.any():
        return take
    # Neighbouring free pixels are joined to each other; forced ones are merged into the terminals.
    node = np.full(labels.shape, -1, dtype=np.int32)
    node[take] = _SOURCE
    node[labels == KEEP] = _SINK
    n_free = int(np.count_nonzero(free))
    node[free] = np.arange(2, 2 + n_free, dtype=np.int32)
    heads, tails, weights = [], [], []
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        between = np.flatnonzero((free[first] | free[second]) & (node[first] != node[second]))
        heads.append(node[first].ravel()[between])
        tails.append(node[second].ravel()[between])
        weights.append(cost[first].ravel()[between] + cost[second].ravel()[between] + 1)
    head, tail, weight = np.concatenate(heads), np.concatenate(tails), np.concatenate(weights)
    size = n_free + 2
    graph = sparse.coo_matrix(
        (np.tile(weight, 2), (np.concatenate([head, tail]), np.concatenate([tail, head]))), shape=(size, size)
    ).tocsr()
    graph.data = np.minimum(graph.data, _FORCED_CAPACITY)
    capacity = sparse.csr_matrix(
        (graph.data.astype(np.int32), graph.indices.astype(np.int32), graph.indptr.astype(np.int32)),
        shape=graph.shape,
    )
    flow = maximum_flow(capacity, _SOURCE, _SINK).flow
    residual = capacity - flow
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    reached = breadth_first_order(residual, _SOURCE, return_predecessors=False)
    taken = np.zeros(size, dtype=bool)
    taken[reached] = True
    result: Mask = take.copy()
    result[free] = taken[node[free]]
    return result


def boundary_cost(cost: NDArray[np.int64] | NDArray[np.float64], mask: Mask) -> tuple[float, float]:
    """Worst and mean cost of the cut around a mask.

    Parameters
    ----------
    cost
        (rows, cols) cost of each pixel, in any unit.
    mask
        (rows, cols), True inside. Pixels beyond the array count as outside but cost nothing.

    Returns
    -------
    tuple of float
        The largest and the mean cost over all pairs of neighbours with the cut between them; a pair costs the mean
        of its two pixels. Both 0.0 if there is no boundary.
    """
    pairs = []
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        on_cut = mask[first] != mask[second]
        pairs.append(((cost[first] + cost[second]) / 2)[on_cut])
    costs = np.concatenate(pairs)
    if costs.size == 0:
        return 0.0, 0.0
    return float(costs.max()), float(costs.mean())
