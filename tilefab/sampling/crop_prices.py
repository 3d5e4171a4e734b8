"""Prices that make use of the slab even: what is cheap to join anywhere would be shown far too often."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilefab.rng import stream_key
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_map import BARRED, TYPICAL_COST, CropMap
from tilefab.types import Mask

_ROUNDS = 30
_CELLS = 90
_FIRST_STEP = 0.75 * TYPICAL_COST
_FIRST_STEP_OF_CROPS = 0.35 * TYPICAL_COST
_SLOWING = 0.25
# A little unevenness is left alone: joining well is worth more.
_EVEN_ENOUGH = 1.4
_LARGEST_EXCESS = 1.5
_MOST_OF_A_CROP = 1.5
_LEAST_OF_A_CROP = 0.3
_GRID_PX = 512
_APART = 1 << 20


class _Boxes(NamedTuple):
    """A rectangle for each crop: first and last rows and columns + 1, in pixels of a reduced base."""

    top: NDArray[np.int64]
    left: NDArray[np.int64]
    bottom: NDArray[np.int64]
    right: NDArray[np.int64]


def crop_usage(
    crop_map: CropMap, counts: NDArray[np.floating] | NDArray[np.integer] | Mask, factor: int
) -> NDArray[np.float64]:
    """How often each place of the slab is shown, by how often each crop is.

    Parameters
    ----------
    crop_map
        The map.
    counts
        (crops,) how often each is shown.
    factor
        The result is this much smaller than the base.

    Returns
    -------
    ndarray
        (base rows // factor, base cols // factor), rounded up; a crop counts for the square of a cell in its middle.
    """
    half = crop_map.overlap_px // 2
    return _sums_of_boxes(_boxes(crop_map, half, crop_map.pitch_px, factor), counts, _reduced_shape(crop_map, factor))


def fair_prices(crop_map: CropMap, barred: Mask, seed: int, progress: Callable[[float], None]) -> CropMap:
    """Return the map with prices that make use of the slab about equal.

    Round by round, part of the plane is chosen; crops of overused places become dearer, those of neglected ones
    cheaper, by smaller and smaller steps (Richardson 1972 and Lucy 1974 do the same to the image of a star). Crops
    themselves are kept to about equal numbers too: cells that show one of few crops at one place would show through
    as a lattice in the mean of many.

    Parameters
    ----------
    crop_map
        With any prices.
    barred
        (crops,) True where a crop must not be shown.
    seed
        Job seed.
    progress
        Called with the share done.
    """
    factor = max(1, max(crop_map.base.shape[:2]) // _GRID_PX)
    can_show = crop_usage(crop_map, (~barred).astype(np.int64), factor) > 0.5
    cores = _boxes(crop_map, crop_map.overlap_px // 2, crop_map.pitch_px, factor)
    shown = np.count_nonzero(~barred)
    price = np.zeros(len(barred))
    key = stream_key(seed, "prices")
    for number in range(_ROUNDS):
        crops = choose_crops(crop_map, key, number * _APART, 0, _CELLS, _CELLS)
        counts = np.bincount(crops.ravel(), minlength=len(barred))
        usage = crop_usage(crop_map, counts, factor)
        usage /= usage[can_show].mean()
        of_places = _means_in_boxes(cores, np.where(can_show, _beyond(usage, 1 / _EVEN_ENOUGH, _EVEN_ENOUGH), 0.0))
        of_crops = _beyond(counts * (shown / crops.size), _LEAST_OF_A_CROP, _MOST_OF_A_CROP)
        step = _FIRST_STEP * np.clip(of_places, -1.0, _LARGEST_EXCESS)
        step += _FIRST_STEP_OF_CROPS * np.clip(of_crops, -1.0, _LARGEST_EXCESS)
        price = np.clip(price + step / (1 + _SLOWING * number), -BARRED // 64, BARRED // 64)
        crop_map = replace(crop_map, price=np.where(barred, BARRED, np.rint(price)).astype(np.int32))
        progress((number + 1) / _ROUNDS)
    return crop_map


def _beyond(values: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    """How far values lie below ``low`` (negative) or above ``high``."""
    return np.maximum(values - high, 0) + np.minimum(values - low, 0)


def _reduced_shape(crop_map: CropMap, factor: int) -> tuple[int, int]:
    rows, cols = crop_map.base.shape[:2]
    return -(-rows // factor), -(-cols // factor)


def _boxes(crop_map: CropMap, margin_px: int, side_px: int, factor: int) -> _Boxes:
    """Squares of the crops, ``margin_px`` in from their top left corners."""
    rows, cols = _reduced_shape(crop_map, factor)
    size = max(1, round(side_px / factor))
    top = (crop_map.crop_row.astype(np.int64) + margin_px) // factor
    left = (crop_map.crop_col.astype(np.int64) + margin_px) // factor
    return _Boxes(top, left, np.minimum(top + size, rows), np.minimum(left + size, cols))


def _sums_of_boxes(
    boxes: _Boxes, weights: NDArray[np.floating] | NDArray[np.integer] | Mask, shape: tuple[int, int]
) -> NDArray[np.float64]:
    step = np.zeros((shape[0] + 1, shape[1] + 1))
    values = np.asarray(weights, dtype=np.float64)
    for rows, cols, sign in (
        (boxes.top, boxes.left, 1),
        (boxes.bottom, boxes.right, 1),
        (boxes.top, boxes.right, -1),
        (boxes.bottom, boxes.left, -1),
    ):
        np.add.at(step, (rows, cols), sign * values)
    return np.asarray(step.cumsum(axis=0).cumsum(axis=1)[:-1, :-1])


def _means_in_boxes(boxes: _Boxes, values: NDArray[np.float64]) -> NDArray[np.float64]:
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    total[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
    top, left, bottom, right = boxes
    inside = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    return np.asarray(inside / ((bottom - top) * (right - left)))
