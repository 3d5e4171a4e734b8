"""Patches on the plane: none ever covers another, each stays in its rhombus, and painting them is what render does."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.rng import stream_key
from tilefab.sampling import Patches, TileMap, render
from tilefab.sampling.activation import active_patches_reference

SEED = 20


def pixels_of(patches: Patches, k: int, row: int, col: int) -> NDArray[np.int64]:
    """Pixels of one patch, (pixels, 2), when its bounding box begins at (row, col)."""
    return np.add(np.argwhere(patches.mask(k)), np.array([row, col], dtype=np.int64))


def paint(texture_map: TileMap, row: int, col: int, rows: int, cols: int, seed: int) -> tuple[Any, NDArray[np.int64]]:
    """Region of the plane, painted patch by patch from the masks, and how many patches cover each pixel."""
    tile_rows, tile_cols = texture_map.tile_shape
    picture = texture_map.tile[np.ix_((row + np.arange(rows)) % tile_rows, (col + np.arange(cols)) % tile_cols)].copy()
    owners = np.zeros((rows, cols), dtype=np.int64)
    patches, key = texture_map.patches, int(stream_key(seed, "activation"))
    for cell_row in range(row // tile_rows - 1, (row + rows) // tile_rows + 2):
        for cell_col in range(col // tile_cols - 1, (col + cols) // tile_cols + 2):
            for k in active_patches_reference(
                key, cell_row, cell_col, patches.count_a, patches.overlaps, texture_map.activation_threshold
            ):
                base = pixels_of(patches, k, patches.base_row[k], patches.base_col[k])
                # In exact integers: far out, a coordinate is no longer a small number.
                top = cell_row * tile_rows + int(patches.cell_row[k]) - row
                left = cell_col * tile_cols + int(patches.cell_col[k]) - col
                here = pixels_of(patches, k, top, left)
                seen = ((here >= 0) & (here < [rows, cols])).all(axis=1)
                here, base = here[seen], base[seen]
                owners[here[:, 0], here[:, 1]] += 1
                picture[here[:, 0], here[:, 1]] = texture_map.base[base[:, 0], base[:, 1]]
    return picture, owners


@pytest.mark.parametrize("seed", [0, SEED, 2**63 - 1])
@pytest.mark.parametrize("origin", [(0, 0), (-137, -203), (2**40 + 3, -(2**40) - 5), (-(2**60), 2**60 - 400)])
def test_no_pixel_is_covered_twice_and_render_paints_the_same(built: Any, origin: tuple[int, int], seed: int) -> None:
    texture_map = built.map
    tile_rows, tile_cols = texture_map.tile_shape
    rows, cols = 4 * tile_rows + 5, 4 * tile_cols + 7
    picture, owners = paint(texture_map, *origin, rows, cols, seed)
    assert owners.max() == 1
    # Patches replace a good part of the plane, but not all.
    assert 0.1 < owners.mean() < 0.9
    assert_array_equal(render(texture_map, *origin, rows, cols, seed=seed, threads=1), picture)


def test_no_patch_of_one_set_could_ever_touch_one_of_the_other(built: Any) -> None:
    """Stronger than that none active does: all of A in a cell and all of B in its neighbours, painted together."""
    texture_map = built.map
    patches = texture_map.patches
    tile_rows, tile_cols = texture_map.tile_shape

    def union(cells: list[tuple[int, int]], group: range) -> NDArray[np.bool_]:
        covered = np.zeros((7 * tile_rows, 7 * tile_cols), dtype=bool)
        for cell_row, cell_col in cells:
            for k in group:
                top = (3 + cell_row) * tile_rows + patches.cell_row[k]
                at = pixels_of(patches, k, top, (3 + cell_col) * tile_cols + patches.cell_col[k])
                covered[at[:, 0], at[:, 1]] = True
        return covered

    in_a, in_b = range(patches.count_a), range(patches.count_a, len(patches))
    beside = [(0, 1), (0, -1), (1, 0), (-1, 0)]
    assert not (union([(0, 0)], in_a) & union(beside, in_b)).any()
    diagonal = [(1, 1), (1, -1), (-1, 1), (-1, -1), (2, 0), (-2, 0), (0, 2), (0, -2)]
    for group in (in_a, in_b):
        here = union([(0, 0)], group)
        assert here.any()
        for cell in diagonal:
            assert not (here & union([cell], group)).any()


def test_overlaps_are_told_truly(built: Any) -> None:
    patches = built.map.patches
    pixels = [
        {(r, c) for r, c in pixels_of(patches, k, patches.cell_row[k], patches.cell_col[k]).tolist()}
        for k in range(len(patches))
    ]
    for i in range(len(patches)):
        for j in range(len(patches)):
            same_set = (i < patches.count_a) == (j < patches.count_a)
            assert patches.overlaps[i, j] == (same_set and i != j and bool(pixels[i] & pixels[j]))


def test_every_patch_lies_within_its_rhombus(built: Any) -> None:
    patches = built.map.patches
    tile_rows, tile_cols = built.map.tile_shape
    crossing = 0
    for k in range(len(patches)):
        at = pixels_of(patches, k, patches.cell_row[k], patches.cell_col[k])
        for r, c in at.tolist():
            down = abs(Fraction(2 * r + 1, 2 * tile_rows) - Fraction(1, 2))
            right = abs(Fraction(2 * c + 1, 2 * tile_cols) - Fraction(1, 2))
            assert down + right < 1
        crossing += bool((at < 0).any() or (at >= [tile_rows, tile_cols]).any())
    # Some reach over the edge of the cell: without them the grid would show.
    assert crossing >= 2


def test_where_no_patch_lies_the_tile_repeats(built: Any) -> None:
    texture_map = built.map
    tile_rows, tile_cols = texture_map.tile_shape
    _, owners = paint(texture_map, -50, -60, 3 * tile_rows, 3 * tile_cols, SEED)
    picture = render(texture_map, -50, -60, 3 * tile_rows, 3 * tile_cols, seed=SEED)
    periodic = texture_map.tile[
        np.ix_(np.arange(-50, 3 * tile_rows - 50) % tile_rows, np.arange(-60, 3 * tile_cols - 60) % tile_cols)
    ]
    assert_array_equal(picture[owners == 0], periodic[owners == 0])
    assert (picture != periodic).any(axis=2)[owners == 1].mean() > 0.8
