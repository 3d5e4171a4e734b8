"""Rendering any region, or any points, of the endless plane from a texture map."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilefab.rng import stream_key
from tilefab.sampling.render_kernels import render_points_into, render_rows_into
from tilefab.sampling.texture_map import TextureMap
from tilefab.types import Array

COORDINATE_LIMIT = 1 << 60
_STRIP_BYTES = 1 << 22


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
    First seed, 5.5.2, turned inside out: instead of asking for each pixel which patch covers it, the periodic tile
    is copied row by row and the runs of every active patch over it. As active patches never overlap, the order is
    immaterial and the result is the same bit for bit.
    """
    _check_coordinates(row, col, rows, cols)
    shape = (rows, cols, texture_map.base.shape[2])
    if out is None:
        out = np.empty(shape, dtype=texture_map.base.dtype)
    elif out.shape != shape or out.dtype != texture_map.base.dtype or not out.flags.c_contiguous:
        raise ValueError(f"out must be C-contiguous {shape} {texture_map.base.dtype}, not {out.shape} {out.dtype}")
    elif not out.flags.writeable:
        raise ValueError("out must be writeable")
    if threads is not None and threads < 1:
        raise ValueError(f"threads must be at least 1, not {threads}")
    key = stream_key(seed, "activation")
    if out.size == 0:
        return out
    strips = max(1, min(rows, out.nbytes // _STRIP_BYTES))
    bounds = [rows * k // strips for k in range(strips + 1)]

    def strip(k: int) -> None:
        _render_strip(texture_map, key, row + bounds[k], col, out[bounds[k] : bounds[k + 1]])

    workers = min(threads or os.cpu_count() or 1, strips)
    if workers == 1:
        for k in range(strips):
            strip(k)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(strip, range(strips)))
    return out


def _render_strip(texture_map: TextureMap, key: np.uint64, row: int, col: int, out: Array) -> None:
    render_rows_into(
        texture_map.base.reshape(-1),
        texture_map.base.shape[1],
        texture_map.tile.reshape(-1),
        *texture_map.tile_shape,
        texture_map.base.shape[2],
        texture_map.patch_tables,
        key,
        row,
        col,
        out.shape[0],
        out.shape[1],
        out.reshape(-1),
    )


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
    key = stream_key(seed, "activation")
    flat_rows: NDArray[np.int64] = np.ascontiguousarray(row_array, dtype=np.int64).ravel()
    flat_cols: NDArray[np.int64] = np.ascontiguousarray(col_array, dtype=np.int64).ravel()
    out = np.empty((flat_rows.size, texture_map.base.shape[2]), dtype=texture_map.base.dtype)
    render_points_into(
        texture_map.base,
        texture_map.tile,
        texture_map.patch_tables,
        key,
        flat_rows,
        flat_cols,
        out,
    )
    return out.reshape(*row_array.shape, out.shape[1])


def _check_coordinates(row: int, col: int, rows: int, cols: int) -> None:
    if rows < 0 or cols < 0:
        raise ValueError(f"a region can't have {rows} rows and {cols} columns")
    if max(abs(row), abs(col), abs(row + rows), abs(col + cols)) > COORDINATE_LIMIT:
        raise ValueError(f"region at ({row}, {col}) of {rows} x {cols} pixels reaches beyond ± 2**60")
