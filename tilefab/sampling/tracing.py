"""Where in the slab a point of the plane comes from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.rng import stream_key
from tilefab.sampling.crop_map import CropMap
from tilefab.sampling.crop_plan import CropPlan, plan_points_into, plan_region
from tilefab.sampling.texture_map import SlabArea, TextureMap
from tilefab.sampling.tile_kernels import render_points_into
from tilefab.sampling.tile_map import TileMap
from tilefab.types import Array, Mask


def trace_points(
    texture_map: TextureMap, rows: NDArray[np.int64], cols: NDArray[np.int64], *, seed: int
) -> NDArray[np.int64]:
    """Pixel of the base that each of some points of the plane shows.

    Parameters
    ----------
    texture_map
        The map, in whatever colours.
    rows, cols
        (points,) int64 coordinates, not far apart: the whole rectangle around them is planned at once.
    seed
        Job seed.

    Returns
    -------
    ndarray of int64
        (points, 2) row and column of the base.
    """
    at = np.empty((len(rows), 2), dtype=np.int64)
    if len(rows) == 0:
        return at
    if isinstance(texture_map, CropMap):
        top, left = int(rows.min()), int(cols.min())
        size = int(rows.max()) + 1 - top, int(cols.max()) + 1 - left
        return trace_plan_points(texture_map, plan_region(texture_map, top, left, *size, seed=seed), rows, cols)
    if not isinstance(texture_map, TileMap):
        raise TypeError(f"a {type(texture_map).__name__} is of no design that can be traced")
    key = stream_key(seed, "activation")
    source = texture_map.tile_source.astype(np.int64)[..., None]
    base_cols = texture_map.base.shape[1]
    for axis, base in enumerate(_numbers((texture_map.base.shape[0], base_cols))):
        tile = np.ascontiguousarray(source // base_cols if axis == 0 else source % base_cols)
        out = np.empty((len(rows), 1), dtype=np.int64)
        render_points_into(base, tile, texture_map.patch_tables, key, rows, cols, out)
        at[:, axis] = out[:, 0]
    return at


def trace_plan_points(
    crop_map: CropMap, plan: CropPlan, rows: NDArray[np.int64], cols: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Pixel of the base, at the plan's level, that points of a planned region show; see `trace_points`."""
    at = np.empty((len(rows), 2), dtype=np.int64)
    which = np.arange(len(rows), dtype=np.int64)
    shape = (max(crop_map.base.shape[0] >> plan.level, 1), max(crop_map.base.shape[1] >> plan.level, 1))
    for axis, base in enumerate(_numbers(shape)):
        out = np.empty((len(rows), 1), dtype=np.int64)
        plan_points_into(base, crop_map, plan, rows, cols, which, out)
        at[:, axis] = out[:, 0]
    return at


def seam_mask(crop_map: CropMap, plan: CropPlan) -> Mask:
    """(rows, cols) of a planned region: True where the pixel to the right or below comes from another crop."""
    row, col = np.meshgrid(
        np.arange(plan.row, plan.row + plan.rows), np.arange(plan.col, plan.col + plan.cols), indexing="ij"
    )
    at = trace_plan_points(crop_map, plan, row.ravel(), col.ravel()).reshape(plan.rows, plan.cols, 2)
    # Pixels of one crop lie in the slab as they lie in the plane.
    shift = at - np.stack([row, col], axis=2)
    seams: Mask = np.zeros((plan.rows, plan.cols), dtype=bool)
    seams[:, :-1] |= (shift[:, 1:] != shift[:, :-1]).any(axis=2)
    seams[:-1] |= (shift[1:] != shift[:-1]).any(axis=2)
    return seams


def _numbers(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Row and column numbers as images that take no memory: rendered, they tell where a pixel comes from."""
    rows, cols = shape
    return (
        np.broadcast_to(np.arange(rows, dtype=np.int64)[:, None, None], (rows, cols, 1)),
        np.broadcast_to(np.arange(cols, dtype=np.int64)[None, :, None], (rows, cols, 1)),
    )


def slab_at(texture_map: TextureMap, row: int, col: int) -> SlabArea | None:
    """Which slab a pixel of the base shows; ``None`` if it lies between them."""
    for area in texture_map.slabs:
        if 0 <= row - area.base_row < area.rows and 0 <= col - area.base_col < area.cols:
            return area
    return None
