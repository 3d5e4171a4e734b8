"""Finding the places of a slab that a person would recognise if they recurred: a lone vein knot, one pale blotch.

Such a place looks like nothing else on the slab. The slab is reduced until a place is some nine cells across, each cell
described by its colour and by how lively it is, and the neighbourhood of every second cell is compared with every other
neighbourhood that doesn't overlap it, wherever it lies. What stays far from even its nearest likeness, by the measure
of the slab itself, is distinctive. Cells are compared in whole numbers small enough for float32 to hold every sum, so
neither the machine nor the number of threads moves a result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.types import Mask

_MOST_CELLS = 128
_PATCH_CELLS = 9
_LEAST_PATCH_CELLS = 7
_SAMPLES_PER_CELL = 8
_STEPS_PER_UNIT = 2
_QUERY_STEP = 2
_LEAST_QUERIES = 16
_BLOCK = 256
_EXACT = 1 << 24
_SMOOTHING_PATCHES = 0.2
_MAD_TO_SIGMA = 1.4826
# Measured on the shared textures: knots of marble lie at 1.7 times the slab's median distance and 3 deviations from it,
# while the strangest place of pebbles, a grid or noise lies at 1.2 to 1.6 times, or is faint.
_STAND_OUT_DEVIATIONS = 2.0
_STAND_OUT_TIMES = 1.45
_LEAST_DISTANCE_DE = 5.0
_LEAST_OWN_SHARE = 0.6
# Binomial, standard deviation 1.2 cells.
_SOFT = np.array([1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0]) / 64


class Place(NamedTuple):
    """A place of a slab that looks like no other.

    Attributes
    ----------
    row, col
        Its middle, in pixels of the slab.
    radius_px
        Half of the neighbourhood's side.
    score
        How far it stands out, in robust standard deviations of the slab's own places.
    """

    row: int
    col: int
    radius_px: int
    score: float


def distinctive_places(lab_d50: NDArray[np.floating], valid: Mask, size_px: int, most: int = 24) -> list[Place]:
    """Places whose neighbourhood has no near likeness anywhere else on the slab.

    Parameters
    ----------
    lab_d50
        (rows, cols, 3) CIELAB (D50).
    valid
        (rows, cols), True where the slab may be used; a neighbourhood reaching over anything else is not looked at.
    size_px
        Size of the things to find. On a slab more than some 18 times as large, larger things are found only.
    most
        The number of places wanted at most, the most distinctive first.

    Returns
    -------
    list of Place
        At least ``size_px`` apart. Empty for a texture that is alike everywhere, be it flat, noise or pebbles.

    Raises
    ------
    ValueError
        If image and mask don't fit each other, or a number is below 1.
    """
    if lab_d50.ndim != 3 or lab_d50.shape[2] != 3 or lab_d50.shape[:2] != valid.shape:
        raise ValueError(f"image {lab_d50.shape} and mask {valid.shape} don't belong together")
    if size_px < 1 or most < 1:
        raise ValueError(f"{most} places of {size_px} px: both must be at least 1")
    factor = max(1, round(size_px / _PATCH_CELLS), -(-max(valid.shape) // _MOST_CELLS))
    patch = min(max(round(size_px / factor), _LEAST_PATCH_CELLS), _PATCH_CELLS + 2)
    cells, known = _cells(lab_d50, valid, factor)
    if min(known.shape) < 2 * patch:
        return []
    nearest, own, usable = _nearest_likeness(cells, known, patch)
    if np.count_nonzero(usable) < _LEAST_QUERIES:
        return []
    distance = _smoothed(nearest, usable, _SMOOTHING_PATCHES * patch / _QUERY_STEP)
    middle = float(np.median(distance[usable]))
    spread = _MAD_TO_SIGMA * float(np.median(np.abs(distance[usable] - middle)))
    stands_out = (
        usable
        & (distance > middle + _STAND_OUT_DEVIATIONS * spread)
        & (distance >= max(_STAND_OUT_TIMES * middle, _LEAST_DISTANCE_DE))
        & (nearest >= _LEAST_OWN_SHARE * own)
    )
    at = np.argwhere(stands_out)
    order = np.argsort(-distance[stands_out], kind="stable")
    apart_px = max(size_px, patch * factor)
    places: list[Place] = []
    for row, col in at[order]:
        centre_row, centre_col = (round((_QUERY_STEP * int(k) + patch / 2) * factor) for k in (row, col))
        if all(np.hypot(centre_row - p.row, centre_col - p.col) >= apart_px for p in places):
            score = (float(distance[row, col]) - middle) / max(spread, 1 / _STEPS_PER_UNIT)
            places.append(Place(centre_row, centre_col, max(round(patch * factor / 2), 1), score))
        if len(places) == most:
            break
    return places


def _cells(lab_d50: NDArray[np.floating], valid: Mask, factor: int) -> tuple[NDArray[np.float32], Mask]:
    """(cell rows, cell cols, 4) L*, a*, b* and liveliness in steps about the slab's median, and which are all valid."""
    rows, cols = (side // factor for side in valid.shape)
    step = max(1, factor // _SAMPLES_PER_CELL)
    within = -(-factor // step)
    offsets = np.arange(within) * step
    at_row, at_col = ((np.arange(n)[:, None] * factor + offsets).ravel() for n in (rows, cols))
    good = valid[at_row[:, None], at_col].reshape(rows, within, cols, within)
    known: Mask = np.asarray(good.all(axis=(1, 3)))
    samples = np.rint(_STEPS_PER_UNIT * np.nan_to_num(lab_d50[at_row[:, None], at_col])).astype(np.int64)
    samples = samples.reshape(rows, within, cols, within, 3)
    mean = samples.mean(axis=(1, 3))
    square = (samples[..., 0] ** 2).mean(axis=(1, 3))
    lively = np.sqrt(np.maximum(square - mean[..., 0] ** 2, 0))
    cells = np.concatenate([mean, lively[..., None]], axis=-1)
    if known.any():
        cells -= np.median(cells[known], axis=0)
    # A thing may lie half a cell off from its likeness, and grain is no likeness: softened cells forgive the one and
    # leave out the other.
    weight = ndimage.correlate1d(ndimage.correlate1d(known.astype(np.float64), _SOFT, axis=0), _SOFT, axis=1)
    soft = ndimage.correlate1d(ndimage.correlate1d(cells * known[..., None], _SOFT, axis=0), _SOFT, axis=1)
    return np.rint(soft / np.maximum(weight, 1e-9)[..., None]).astype(np.float32), known


def _nearest_likeness(
    cells: NDArray[np.float32], known: Mask, patch: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], Mask]:
    """Root mean square distance per cell of every second patch to its nearest likeness, and to the slab's median.

    Returns
    -------
    nearest, own
        In CIELAB units, by the patch's top left cell over `_QUERY_STEP`.
    usable
        Which of them could be compared.
    """
    dimensions = patch * patch * cells.shape[2]
    limit = int(np.sqrt(_EXACT / (4 * dimensions)))  # |a|^2 + |b|^2 + 2 |a b| stays below 2^24
    windows = np.lib.stride_tricks.sliding_window_view(np.clip(cells, -limit, limit), (patch, patch), axis=(0, 1))
    shape = windows.shape[:2]
    patches = np.ascontiguousarray(windows).reshape(-1, dimensions)
    whole = np.asarray(np.lib.stride_tricks.sliding_window_view(known, (patch, patch)).all(axis=(2, 3)))
    norm = np.einsum("ij,ij->i", patches, patches)
    cost = np.where(whole.ravel(), norm, np.inf).astype(np.float32)
    asked = np.argwhere(whole[::_QUERY_STEP, ::_QUERY_STEP])
    usable = np.zeros(whole[::_QUERY_STEP, ::_QUERY_STEP].shape, dtype=bool)
    nearest, own = np.zeros(usable.shape), np.zeros(usable.shape)
    for start in range(0, len(asked), _BLOCK):
        block = asked[start : start + _BLOCK]
        index = (block[:, 0] * shape[1] + block[:, 1]) * _QUERY_STEP
        apart = patches[index] @ patches.T
        apart *= -2
        apart += cost
        by_place = apart.reshape(-1, *shape)
        for k, (row, col) in enumerate(block * _QUERY_STEP):
            near = np.s_[max(row - patch + 1, 0) : row + patch, max(col - patch + 1, 0) : col + patch]
            by_place[k][near] = np.inf
        least = apart.min(axis=1) + norm[index]
        at = block[:, 0], block[:, 1]
        usable[at] = np.isfinite(least)
        scale = 1 / (_STEPS_PER_UNIT * patch)
        nearest[at] = np.sqrt(np.where(np.isfinite(least), least, 0).astype(np.float64)) * scale
        own[at] = np.sqrt(norm[index].astype(np.float64)) * scale
    return nearest, own, usable


def _smoothed(values: NDArray[np.float64], known: Mask, sigma: float) -> NDArray[np.float64]:
    """Gaussian mean of the known values: a place found at several offsets is reported at the middle of them."""
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigma, mode="constant")
    total = ndimage.gaussian_filter(np.where(known, values, 0), sigma, mode="constant")
    return np.asarray(total / np.maximum(weight, 1e-9))
