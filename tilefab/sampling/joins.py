"""How well the crops of a piece of the plane join, measured along the seams that are really cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.sampling.crop_map import CropMap
from tilefab.sampling.crop_plan import CropPlan, plan_region
from tilefab.types import Mask

_GUIDE_UNIT = 2.0
_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class Joins:
    """Every join of two cells that touch, in a window of the plane.

    Attributes
    ----------
    row, col
        (joins,) cell of the plane: the right, or the lower, one of the two.
    below
        (joins,) True where the cells lie one below the other, False side by side.
    first, second
        (joins,) crops: left or upper, and right or lower.
    delta_e
        (joins,) mean CIE76 difference of the two crops along the seam, as the map's guide shows them.
    crops
        (rows, cols) crop of each cell of the window, and
    first_row, first_col
        its top left cell.
    """

    row: NDArray[np.int64]
    col: NDArray[np.int64]
    below: Mask
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    delta_e: NDArray[np.float64]
    crops: NDArray[np.int32]
    first_row: int
    first_col: int


def measure_joins(crop_map: CropMap, row: int, col: int, rows: int, cols: int, *, seed: int, threads: int = 1) -> Joins:
    """Measure the joins of a window of cells.

    Parameters
    ----------
    crop_map
        The map.
    row, col, rows, cols
        The window, in cells.
    seed
        Job seed.
    threads
        For finding the seams.

    Notes
    -----
    Both crops go on below the seam for half an overlap, so each pair of pixels on it is compared in both (Kwatra et al.
    2003, "Graphcut textures", equation 1). Near the corner of a cell, where a third crop shows, its two are compared
    all the same.
    """
    shift = crop_map.guide_shift
    pitch, overlap = crop_map.pitch_px >> shift, crop_map.overlap_px >> shift
    half = overlap // 2
    plan = plan_region(
        crop_map, row * pitch, col * pitch, rows * pitch, cols * pitch, seed=seed, level=shift, threads=threads
    )
    guide = crop_map.guide[..., :3]
    crop_row, crop_col = crop_map.crop_row.astype(np.int64) >> shift, crop_map.crop_col.astype(np.int64) >> shift
    # Cells of the window, counted from the plan's first; it has at least one more on each side.
    i, j = np.meshgrid(np.arange(rows) + row - plan.first_row, np.arange(cols) + col - plan.first_col, indexing="ij")
    along = np.arange(pitch)
    parts = []
    for below in (False, True):
        # The first row or column of the window has its other cell outside it.
        at_i, at_j = (i[1:, :].ravel(), j[1:, :].ravel()) if below else (i[:, 1:].ravel(), j[:, 1:].ravel())
        first = plan.crops[at_i - 1, at_j] if below else plan.crops[at_i, at_j - 1]
        second = plan.crops[at_i, at_j]
        delta_e = np.empty(len(at_i))
        for low in range(0, len(at_i), _AT_ONCE):
            part = slice(low, low + _AT_ONCE)
            place = _seam_places(plan, at_i[part], at_j[part], below, half, pitch)
            a, b = first[part, None], second[part, None]
            total = np.zeros(place.shape)
            for step in (-1, 0):
                if below:
                    one = guide[crop_row[a] + pitch + place + step, crop_col[a] + half + along]
                    other = guide[crop_row[b] + place + step, crop_col[b] + half + along]
                else:
                    one = guide[crop_row[a] + half + along, crop_col[a] + pitch + place + step]
                    other = guide[crop_row[b] + half + along, crop_col[b] + place + step]
                total += np.sqrt(((one.astype(np.float64) - other) ** 2).sum(axis=2))
            delta_e[part] = total.mean(axis=1) / (2 * _GUIDE_UNIT)
        parts.append((at_i + plan.first_row, at_j + plan.first_col, np.full(len(at_i), below), first, second, delta_e))
    at_row, at_col, is_below, firsts, seconds, costs = (np.concatenate(pair) for pair in zip(*parts, strict=True))
    top, left = row - plan.first_row, col - plan.first_col
    return Joins(
        row=at_row,
        col=at_col,
        below=is_below,
        first=firsts.astype(np.int64),
        second=seconds.astype(np.int64),
        delta_e=costs,
        crops=plan.crops[top : top + rows, left : left + cols],
        first_row=row,
        first_col=col,
    )


def _seam_places(
    plan: CropPlan, i: NDArray[np.int64], j: NDArray[np.int64], below: bool, half: int, pitch: int
) -> NDArray[np.int64]:
    """(joins, pitch) where the seam before each cell lies in the overlap, along the cell."""
    if not below:
        return plan.upright[i, j, half : half + pitch].astype(np.int64)
    # A seam between rows is kept from the middle of one cell to the middle of the next.
    middle = pitch // 2
    return np.concatenate([plan.across[i, j][:, middle:], plan.across[i, j + 1][:, :middle]], axis=1).astype(np.int64)
