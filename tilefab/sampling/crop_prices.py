"""Prices that make use of the slab even: what is cheap to join anywhere would be shown far too often."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tilefab.rng import stream_key
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_map import BARRED, TYPICAL_COST, CropMap
from tilefab.types import Mask

_ROUNDS = 30
_CELLS = 90
_FIRST_STEP = 0.75 * TYPICAL_COST
_SLOWING = 0.25
_EVEN_ENOUGH = 1.4
_LARGEST_EXCESS = 1.5
_GRID_PX = 512
_APART = 1 << 20


def crop_usage(crop_map: CropMap, counts: NDArray[np.int64] | NDArray[np.float64], factor: int) -> NDArray[np.float64]:
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
    rows, cols = (-(-side // factor) for side in crop_map.base.shape[:2])
    top, left, bottom, right = _cores(crop_map, factor)
    step = np.zeros((rows + 1, cols + 1))
    weights = np.asarray(counts, dtype=np.float64)
    for r, c, sign in ((top, left, 1), (bottom, right, 1), (top, right, -1), (bottom, left, -1)):
        np.add.at(step, (r, c), sign * weights)
    return step.cumsum(axis=0).cumsum(axis=1)[:-1, :-1]


def _cores(crop_map: CropMap, factor: int) -> tuple[NDArray[np.int64], ...]:
    margin = crop_map.overlap_px // 2
    size = max(1, round(crop_map.pitch_px / factor))
    top = (crop_map.crop_row.astype(np.int64) + margin) // factor
    left = (crop_map.crop_col.astype(np.int64) + margin) // factor
    rows, cols = (-(-side // factor) for side in crop_map.base.shape[:2])
    return top, left, np.minimum(top + size, rows), np.minimum(left + size, cols)


def fair_prices(crop_map: CropMap, valid: Mask, barred: Mask, seed: int, progress: Callable[[float], None]) -> CropMap:
    """Return the map with prices that make use of the slab about equal.

    Round by round, part of the plane is chosen; crops of overused places become dearer, those of neglected ones
    cheaper, by smaller and smaller steps (Richardson 1972 and Lucy 1974 do the same to the image of a star).

    Parameters
    ----------
    crop_map
        With any prices.
    valid
        (rows, cols), True where the slab may be used.
    barred
        (crops,) True where a crop must not be shown.
    seed
        Job seed.
    progress
        Called with the share done.
    """
    factor = max(1, max(crop_map.base.shape[:2]) // _GRID_PX)
    can_show = crop_usage(crop_map, ~barred, factor) > 0.5
    top, left, bottom, right = _cores(crop_map, factor)
    price = np.zeros(len(barred))
    key = stream_key(seed, "prices")
    for number in range(_ROUNDS):
        crops = choose_crops(crop_map, key, number * _APART, 0, _CELLS, _CELLS)
        usage = crop_usage(crop_map, np.bincount(crops.ravel(), minlength=len(barred)), factor)
        usage /= usage[can_show].mean()
        # A little unevenness is left alone: joining well is worth more.
        excess = np.where(
            usage > _EVEN_ENOUGH,
            usage - _EVEN_ENOUGH,
            np.where(can_show & (usage < 1 / _EVEN_ENOUGH), usage - 1 / _EVEN_ENOUGH, 0.0),
        )
        total = np.zeros((excess.shape[0] + 1, excess.shape[1] + 1))
        total[1:, 1:] = excess.cumsum(axis=0).cumsum(axis=1)
        area = (bottom - top) * (right - left)
        mean = (total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]) / area
        price += _FIRST_STEP * np.clip(mean, -1.0, _LARGEST_EXCESS) / (1 + _SLOWING * number)
        price = np.clip(price, -BARRED // 64, BARRED // 64)
        crop_map = replace(crop_map, price=np.where(barred, BARRED, np.rint(price)).astype(np.int32))
        progress((number + 1) / _ROUNDS)
    return crop_map
