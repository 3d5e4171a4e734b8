"""The sampler as the first seed tells it, pixel by pixel in plain Python: the oracle for the fast one.

Slow on purpose: it shares nothing with the kernels but the map, and can be read beside section 5.5.2.
"""

from __future__ import annotations

import numpy as np

from tilefab.rng import stream_key
from tilefab.sampling.activation import active_patches_reference
from tilefab.sampling.tile_map import TileMap
from tilefab.types import Array


def pixel_reference(texture_map: TileMap, row: int, col: int, *, seed: int) -> Array:
    """Colour of one pixel of the endless plane, (channels,)."""
    tile_rows, tile_cols = texture_map.tile_shape
    cell_row, cell_col = row // tile_rows, col // tile_cols
    # How far the pixel lies from the middle of its cell decides which neighbour's rhombus it lies in.
    down = ((row % tile_rows) + 0.5) / tile_rows - 0.5
    right = ((col % tile_cols) + 0.5) / tile_cols - 0.5
    if abs(down) > abs(right):
        neighbour = (cell_row + (1 if down > 0 else -1), cell_col)
    else:
        neighbour = (cell_row, cell_col + (1 if right > 0 else -1))
    patches = texture_map.patches
    key = int(stream_key(seed, "activation"))
    for cell in ((cell_row, cell_col), neighbour):
        active = active_patches_reference(
            key, *cell, patches.count_a, patches.overlaps, texture_map.activation_threshold
        )
        for patch in active:
            r = row - cell[0] * tile_rows - int(patches.cell_row[patch])
            c = col - cell[1] * tile_cols - int(patches.cell_col[patch])
            mask = patches.mask(patch)
            if 0 <= r < mask.shape[0] and 0 <= c < mask.shape[1] and mask[r, c]:
                colour: Array = texture_map.base[patches.base_row[patch] + r, patches.base_col[patch] + c]
                return colour
    return np.asarray(texture_map.tile[row % tile_rows, col % tile_cols])


def render_reference(texture_map: TileMap, row: int, col: int, rows: int, cols: int, *, seed: int) -> Array:
    """Region of the endless plane, one pixel after the other: twin of `tilefab.sampling.render`."""
    out = np.empty((rows, cols, texture_map.base.shape[2]), dtype=texture_map.base.dtype)
    for r in range(rows):
        for c in range(cols):
            out[r, c] = pixel_reference(texture_map, row + r, col + c, seed=seed)
    return out
