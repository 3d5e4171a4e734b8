"""The sampler's inner loops. Arrays in, pixels out; see `tilefab.sampling.render` for what they mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import copy_elements, kernel
from tilefab.sampling.activation import active_patches
from tilefab.sampling.tile_map import PatchTables
from tilefab.types import Array


@kernel
def render_rows_into(
    base: Array,
    base_cols: int,
    tile: Array,
    tile_rows: int,
    tile_cols: int,
    channels: int,
    patches: PatchTables,
    key: np.uint64,
    row: int,
    col: int,
    rows: int,
    cols: int,
    out: Array,
) -> None:
    """Render the region of rows x cols pixels whose top left pixel is (row, col) into ``out``.

    ``base``, ``tile`` and ``out`` are flat arrays of interleaved pixels. Every run lies within them, since a texture
    map is checked when it is made.
    """
    for r in range(rows):
        tile_row = (row + r) % tile_rows
        c = 0
        while c < cols:
            tile_col = (col + c) % tile_cols
            length = min(tile_cols - tile_col, cols - c)
            begin = (tile_row * tile_cols + tile_col) * channels
            copy_elements(out, (r * cols + c) * channels, tile, begin, length * channels)
            c += length
    active = np.empty(len(patches.overlaps), dtype=np.int64)
    clashes = np.empty(len(patches.overlaps), dtype=np.int64)
    # A patch reaches at most half a cell beyond its own cell: the rhombus ends at the neighbours' centres.
    first_row = (row - (tile_rows + 1) // 2) // tile_rows
    last_row = (row + rows - 1 + (tile_rows + 1) // 2) // tile_rows
    first_col = (col - (tile_cols + 1) // 2) // tile_cols
    last_col = (col + cols - 1 + (tile_cols + 1) // 2) // tile_cols
    for cell_row in range(first_row, last_row + 1):
        for cell_col in range(first_col, last_col + 1):
            n = active_patches(
                key, cell_row, cell_col, patches.count_a, patches.overlaps, patches.threshold, active, clashes
            )
            for k in range(n):
                patch = active[k]
                top = cell_row * tile_rows + patches.cell_row[patch] - row
                left = cell_col * tile_cols + patches.cell_col[patch] - col
                if top >= rows or left >= cols or top + patches.rows[patch] <= 0 or left + patches.cols[patch] <= 0:
                    continue
                for run in range(patches.run_offset[patch], patches.run_offset[patch + 1]):
                    r = top + patches.runs[run, 0]
                    if r < 0 or r >= rows:
                        continue
                    start = left + patches.runs[run, 1]
                    c = max(start, 0)
                    length = min(start + patches.runs[run, 2], cols) - c
                    if length > 0:
                        base_row, base_col = (
                            patches.base_row[patch] + patches.runs[run, 0],
                            patches.base_col[patch] + c - left,
                        )
                        begin = (base_row * base_cols + base_col) * channels
                        copy_elements(out, (r * cols + c) * channels, base, begin, length * channels)


@kernel
def render_points_into(
    base: Array,
    tile: Array,
    patches: PatchTables,
    key: np.uint64,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    out: Array,
) -> None:
    """Render the pixel (rows[i], cols[i]) into ``out[i]`` for every i.

    A pixel lies in the rhombus of its own cell and in that of the neighbour across the nearest edge, in no other.
    """
    tile_rows, tile_cols = tile.shape[0], tile.shape[1]
    # Active patches of the cell last asked for, one memory for each of the two sets.
    active = np.empty((2, len(patches.overlaps)), dtype=np.int64)
    clashes = np.empty(len(patches.overlaps), dtype=np.int64)
    known_row = np.zeros(2, dtype=np.int64)
    known_col = np.zeros(2, dtype=np.int64)
    known_count = np.full(2, -1, dtype=np.int64)
    for i in range(len(rows)):
        cell_row, cell_col = rows[i] // tile_rows, cols[i] // tile_cols
        in_row, in_col = rows[i] - cell_row * tile_rows, cols[i] - cell_col * tile_cols
        found = False
        for side in range(2):
            if side == 1:
                down = (2 * in_row + 1 - tile_rows) * tile_cols
                right = (2 * in_col + 1 - tile_cols) * tile_rows
                if abs(down) > abs(right):
                    step = 1 if down > 0 else -1
                    cell_row, in_row = cell_row + step, in_row - step * tile_rows
                else:
                    step = 1 if right > 0 else -1
                    cell_col, in_col = cell_col + step, in_col - step * tile_cols
            group = (cell_row + cell_col) & 1
            if known_count[group] < 0 or known_row[group] != cell_row or known_col[group] != cell_col:
                known_count[group] = active_patches(
                    key,
                    cell_row,
                    cell_col,
                    patches.count_a,
                    patches.overlaps,
                    patches.threshold,
                    active[group],
                    clashes,
                )
                known_row[group], known_col[group] = cell_row, cell_col
            for k in range(known_count[group]):
                patch = active[group, k]
                r, c = in_row - patches.cell_row[patch], in_col - patches.cell_col[patch]
                if r < 0 or c < 0 or r >= patches.rows[patch] or c >= patches.cols[patch]:
                    continue
                low, high = patches.run_offset[patch], patches.run_offset[patch + 1]
                while high - low > 1:
                    middle = (low + high) // 2
                    if patches.runs[middle, 0] < r or (patches.runs[middle, 0] == r and patches.runs[middle, 1] <= c):
                        low = middle
                    else:
                        high = middle
                if (
                    patches.runs[low, 0] == r
                    and patches.runs[low, 1] <= c < patches.runs[low, 1] + patches.runs[low, 2]
                ):
                    for channel in range(base.shape[2]):
                        out[i, channel] = base[patches.base_row[patch] + r, patches.base_col[patch] + c, channel]
                    found = True
                    break
            if found:
                break
        if not found:
            tile_row, tile_col = rows[i] % tile_rows, cols[i] % tile_cols
            for channel in range(base.shape[2]):
                out[i, channel] = tile[tile_row, tile_col, channel]
