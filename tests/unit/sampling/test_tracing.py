"""Tracing: every pixel of the plane is found again in the base, and seams lie where the source changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tilefab.sampling import CropMap, SlabArea, TextureMap, TileMap, plan_region, render, render_plan, render_points
from tilefab.sampling.tracing import seam_mask, slab_at, trace_plan_points, trace_points


def numbered(texture_map: TextureMap) -> TextureMap:
    """The same map over a base whose pixels are their own flat index."""
    rows, cols = texture_map.base.shape[:2]
    return texture_map.with_base(np.arange(rows * cols, dtype=np.int32).reshape(rows, cols, 1), "index", ("i",))


def check(texture_map: TextureMap, seed: int) -> None:
    random = np.random.default_rng(seed)
    rows, cols = random.integers(-90, 150, 400), random.integers(1000, 1300, 400)
    at = trace_points(texture_map, rows, cols, seed=seed)
    index = at[:, 0] * texture_map.base.shape[1] + at[:, 1]
    assert_array_equal(index, render_points(numbered(texture_map), rows, cols, seed=seed)[:, 0])


@pytest.mark.parametrize("seed", [0, 7, 2**63 - 1])
def test_points_of_crops_are_found_in_the_base(crop_map: CropMap, seed: int) -> None:
    check(crop_map, seed % 1000)


def test_points_of_a_tile_are_found_in_the_base(hand_map: Callable[..., TileMap], maps: dict[str, Any]) -> None:
    check(hand_map(), 3)
    check(maps["masked"].map, 4)


def test_no_points_are_no_places(crop_map: CropMap) -> None:
    none = np.zeros(0, dtype=np.int64)
    assert trace_points(crop_map, none, none, seed=1).shape == (0, 2)


@pytest.mark.parametrize("level", [0, 1])
def test_a_reduced_plan_is_traced_in_the_reduced_base(crop_map: CropMap, level: int) -> None:
    plan = plan_region(crop_map, -20, 33, 40, 50, seed=6, level=level)
    row, col = np.meshgrid(np.arange(-20, 20), np.arange(33, 83), indexing="ij")
    at = trace_plan_points(crop_map, plan, row.ravel(), col.ravel())
    picture = crop_map.base_level(level)[at[:, 0], at[:, 1]].reshape(40, 50, -1)
    assert_array_equal(picture, render_plan(crop_map, plan))


def test_seams_are_where_neighbours_of_the_plane_are_none_in_the_slab(crop_map: CropMap) -> None:
    seams = seam_mask(crop_map, plan_region(crop_map, -50, 12, 90, 110, seed=2))
    cols = crop_map.base.shape[1]
    index = render(numbered(crop_map), -50, 12, 91, 111, seed=2)[..., 0].astype(np.int64)
    right, down = index[:90, 1:] - index[:90, :-1] != 1, index[1:, :110] - index[:-1, :110] != cols
    expected = right[:, :110] | down
    # At the region's own edges only the neighbour inside counts.
    assert_array_equal(seams[:-1, :-1], expected[:-1, :-1])
    assert 0.01 < seams.mean() < 0.5


def test_which_slab_a_pixel_is_of(hand_map: Callable[..., TileMap]) -> None:
    one, two = SlabArea("one", 0, 0, 5, 3), SlabArea("two", 1, 4, 4, 3)
    texture_map = hand_map(slabs=(one, two))
    assert slab_at(texture_map, 4, 2) == one
    assert slab_at(texture_map, 1, 4) == two
    assert slab_at(texture_map, 0, 4) is None
    assert slab_at(texture_map, 2, 3) is None
