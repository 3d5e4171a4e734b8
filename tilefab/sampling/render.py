"""Rendering any region, or any points, of the endless plane from a texture map of either design."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilefab.rng import stream_key
from tilefab.sampling.crop_kernels import render_plan_rows_into
from tilefab.sampling.crop_map import CropMap
from tilefab.sampling.crop_plan import CropPlan, plan_points_into, plan_region
from tilefab.sampling.texture_map import TextureMap
from tilefab.sampling.tile_kernels import render_points_into, render_rows_into
from tilefab.sampling.tile_map import TileMap
from tilefab.types import Array

COORDINATE_LIMIT = 1 << 60
_STRIP_BYTES = 1 << 22
_LARGER_THAN_CACHE_BYTES = 1 << 25
_REDUCED_BYTES = 1 << 26
_PAGE_PX = 1 << 10
_PAGE_CELLS = 8


def render(
    texture_map: TextureMap,
    row: int,
    col: int,
    rows: int,
    cols: int,
    *,
    seed: int,
    out: Array | None = None,
    threads: int | None = None,
) -> Array:
    """Render a region of the endless plane.

    Parameters
    ----------
    texture_map
        The map to copy pixels from.
    row, col
        Top left pixel of the region; negative ones included, up to ± 2**60.
    rows, cols
        Size of the region, >= 0.
    seed
        Job seed, 0 <= seed < 2**63: another seed is another plane.
    out
        Buffer to render into: C-contiguous (rows, cols, channels) of the map's dtype. Made if not given.
    threads
        How many threads share the work; ``None``: one per processor. The result doesn't depend on it.

    Returns
    -------
    ndarray
        (rows, cols, channels), ``out`` if it was given.

    Raises
    ------
    ValueError
        If a coordinate, a size, the seed, ``threads`` or ``out`` is unusable.

    Notes
    -----
    The first seed asks for each pixel which patch covers it (5.5.2). Turned inside out, that is one copy for every
    row run of a patch, or of a crop.
    """
    _check_coordinates(row, col, rows, cols)
    workers = _checked_threads(threads)
    out = _checked_buffer(texture_map, rows, cols, out)
    if out.size == 0:
        stream_key(seed, "unused")  # a bad seed is an error all the same
        return out
    if isinstance(texture_map, CropMap):
        plan = plan_region(texture_map, row, col, rows, cols, seed=seed, threads=workers)
        return render_plan(texture_map, plan, out=out, threads=workers)
    tile_map = _tile_map(texture_map)
    key = stream_key(seed, "activation")
    flat = tile_map.base.reshape(-1)

    def strip(begin: int, end: int) -> None:
        part = out[begin:end]
        render_rows_into(
            flat,
            tile_map.base.shape[1],
            tile_map.tile.reshape(-1),
            *tile_map.tile_shape,
            tile_map.base.shape[2],
            tile_map.patch_tables,
            key,
            row + begin,
            col,
            part.shape[0],
            part.shape[1],
            part.reshape(-1),
        )

    _in_strips(out, workers, strip)
    return out


def render_plan(
    texture_map: CropMap,
    plan: CropPlan,
    *,
    first: int = 0,
    rows: int | None = None,
    out: Array | None = None,
    threads: int | None = None,
) -> Array:
    """Render a planned region, or a strip of it.

    A face that is printed strip by strip, or in several maps of one design (inks, proof), is planned once.

    Parameters
    ----------
    texture_map
        The map that the plan was made from, or the same over another base.
    plan
        From `tilefab.sampling.plan_region`.
    first, rows
        Which rows of the region; all from ``first`` on if not given.
    out, threads
        As for `render`.

    Returns
    -------
    ndarray
        (rows, plan.cols, channels).

    Raises
    ------
    ValueError
        If the rows, ``threads`` or ``out`` are unusable.
    """
    rows = plan.rows - first if rows is None else rows
    if first < 0 or rows < 0 or first + rows > plan.rows:
        raise ValueError(f"rows {first} to {first + rows} are not within the {plan.rows} planned")
    workers = _checked_threads(threads)
    out = _checked_buffer(texture_map, rows, plan.cols, out)
    base = texture_map.base_level(plan.level)
    flat = base.reshape(-1)
    pitch, overlap = texture_map.pitch_px >> plan.level, texture_map.overlap_px >> plan.level
    streaming = out.nbytes >= _LARGER_THAN_CACHE_BYTES

    def strip(begin: int, end: int) -> None:
        part = out[begin:end]
        render_plan_rows_into(
            flat,
            base.shape[1],
            base.shape[2],
            plan.level,
            texture_map.crop_row,
            texture_map.crop_col,
            pitch,
            overlap,
            plan.row - plan.first_row * pitch,
            plan.col - plan.first_col * pitch,
            plan.crops,
            plan.upright,
            plan.seam_shift,
            plan.turn_begin,
            plan.turns,
            plan.starts_above,
            first + begin,
            part.shape[0],
            part.shape[1],
            streaming,
            part.reshape(-1),
        )

    _in_strips(out, workers, strip)
    return out


def render_reduced(
    texture_map: CropMap, row: int, col: int, rows: int, cols: int, *, level: int, seed: int, threads: int | None = None
) -> Array:
    """Render a region of the plane at 1 / 2**level of its size, without rendering it whole.

    Parameters
    ----------
    texture_map
        The map.
    row, col, rows, cols
        The region, in pixels of that size.
    level
        Halvings, >= 0. Up to ``texture_map.coarsest_level`` the crops themselves are halved and joined at that size;
        beyond it the result of that level is halved further.
    seed, threads
        As for `render`.

    Returns
    -------
    ndarray
        (rows, cols, channels) of the map's dtype: near the means over blocks of the full plane, but for the width of
        a pixel along seams.

    Raises
    ------
    ValueError
        If a coordinate, the level, the seed or ``threads`` is unusable.
    """
    if not isinstance(texture_map, CropMap):
        raise TypeError(f"a {type(texture_map).__name__} has no reduced levels; render it and reduce the picture")
    if level < 0:
        raise ValueError(f"level {level} is negative")
    own = min(level, texture_map.coarsest_level)
    factor = 1 << (level - own)
    _check_coordinates(row << level, col << level, rows << level, cols << level)
    workers = _checked_threads(threads)
    channels = texture_map.base.shape[2]
    out = np.empty((rows, cols, channels), dtype=texture_map.base.dtype)
    if out.size == 0:
        return out
    # Strips bound the memory where much more is rendered than asked for.
    step = max(1, _REDUCED_BYTES // (cols * factor * factor * channels * out.itemsize))
    for top in range(0, rows, step):
        count = min(step, rows - top)
        plan = plan_region(
            texture_map,
            (row + top) * factor,
            col * factor,
            count * factor,
            cols * factor,
            seed=seed,
            level=own,
            threads=workers,
        )
        part = render_plan(texture_map, plan, threads=workers)
        if factor > 1:
            total = part.reshape(count, factor, cols, factor, channels).mean(axis=(1, 3))
            part = np.floor(total + 0.5).astype(out.dtype) if out.dtype.kind in "ui" else total.astype(out.dtype)
        out[top : top + count] = part
    return out


def render_points(texture_map: TextureMap, rows: ArrayLike, cols: ArrayLike, *, seed: int) -> Array:
    """Render single pixels of the endless plane, the same as `render` would show there.

    Parameters
    ----------
    texture_map
        The map to copy pixels from.
    rows, cols
        Integer coordinates, arrays of one shape (or that broadcast to one), up to ± 2**60.
    seed
        Job seed, 0 <= seed < 2**63.

    Returns
    -------
    ndarray
        (..., channels) of the map's dtype.

    Raises
    ------
    ValueError
        If coordinates aren't integers or are out of range.

    Notes
    -----
    With crops, points are taken together by the cells they lie in: what a cell shows is found once for all of them.
    """
    row_array, col_array = np.broadcast_arrays(np.asarray(rows), np.asarray(cols))
    for name, array in (("rows", row_array), ("cols", col_array)):
        if array.size and array.dtype.kind not in "iu":
            raise ValueError(f"{name} must be integers, not {array.dtype}")
    if row_array.size:
        low = min(int(row_array.min()), int(col_array.min()))
        high = max(int(row_array.max()), int(col_array.max()))
        _check_coordinates(low, low, 0, 0)
        _check_coordinates(high, high, 0, 0)
    flat_rows: NDArray[np.int64] = np.ascontiguousarray(row_array, dtype=np.int64).ravel()
    flat_cols: NDArray[np.int64] = np.ascontiguousarray(col_array, dtype=np.int64).ravel()
    out = np.empty((flat_rows.size, texture_map.base.shape[2]), dtype=texture_map.base.dtype)
    if isinstance(texture_map, CropMap):
        _render_crop_points(texture_map, flat_rows, flat_cols, seed, out)
    else:
        tile_map = _tile_map(texture_map)
        key = stream_key(seed, "activation")
        render_points_into(tile_map.base, tile_map.tile, tile_map.patch_tables, key, flat_rows, flat_cols, out)
    return out.reshape(*row_array.shape, out.shape[1])


def _render_crop_points(
    crop_map: CropMap, rows: NDArray[np.int64], cols: NDArray[np.int64], seed: int, out: Array
) -> None:
    """Page by page: each page of the plane that holds points is planned once, no larger than its points need."""
    stream_key(seed, "crops")
    page = max(_PAGE_CELLS * crop_map.pitch_px, _PAGE_PX)
    page_row, page_col = rows // page, cols // page
    order = np.lexsort((page_col, page_row))
    changes = np.flatnonzero(np.diff(page_row[order]) | np.diff(page_col[order])) + 1
    for which in np.split(order, changes) if len(order) else []:
        top, left = int(rows[which].min()), int(cols[which].min())
        bottom, right = int(rows[which].max()) + 1, int(cols[which].max()) + 1
        plan = plan_region(crop_map, top, left, bottom - top, right - left, seed=seed)
        plan_points_into(crop_map.base, crop_map, plan, rows, cols, which, out)


def _in_strips(out: Array, workers: int, strip: Callable[[int, int], None]) -> None:
    rows = out.shape[0]
    strips = max(1, min(rows, out.nbytes // _STRIP_BYTES))
    bounds = [rows * k // strips for k in range(strips + 1)]
    workers = min(workers, strips)
    if workers == 1:
        for k in range(strips):
            strip(bounds[k], bounds[k + 1])
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(strip, bounds[:-1], bounds[1:]))


def _tile_map(texture_map: TextureMap) -> TileMap:
    if not isinstance(texture_map, TileMap):
        raise TypeError(f"a {type(texture_map).__name__} is of no design that can be rendered")
    return texture_map


def _checked_buffer(texture_map: TextureMap, rows: int, cols: int, out: Array | None) -> Array:
    shape = (rows, cols, texture_map.base.shape[2])
    if out is None:
        return np.empty(shape, dtype=texture_map.base.dtype)
    if out.shape != shape or out.dtype != texture_map.base.dtype or not out.flags.c_contiguous:
        raise ValueError(f"out must be C-contiguous {shape} {texture_map.base.dtype}, not {out.shape} {out.dtype}")
    if not out.flags.writeable:
        raise ValueError("out must be writeable")
    return out


def _checked_threads(threads: int | None) -> int:
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    return threads or os.cpu_count() or 1


def _check_coordinates(row: int, col: int, rows: int, cols: int) -> None:
    if rows < 0 or cols < 0:
        raise ValueError(f"a region can't have {rows} rows and {cols} columns")
    if max(abs(row), abs(col), abs(row + rows), abs(col + cols)) > COORDINATE_LIMIT:
        raise ValueError(f"region at ({row}, {col}) of {rows} x {cols} pixels reaches beyond ± 2**60")
