"""The texture map: parts that don't fit are refused, and its hash tells all that decides pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tilefab.sampling import Patches, TileMap
from tilefab.sampling.texture_map import SlabArea

HandMap = Callable[..., TileMap]


def int32(*values: int) -> np.ndarray:
    return np.array(values, dtype=np.int32)


HAND_MAP_HASH = "333bbb1921ab07a9378d6a26ef146d4bbe397153a7f8b1b4f3fed154858222be"
RUNS = [[0, 0, 1], [0, 2, 1], [1, 0, 3], [0, 0, 2], [1, 0, 2], [2, 1, 1], [0, 0, 2]]


def changed_run(index: int, run: list[int]) -> np.ndarray:
    return np.array([*RUNS[:index], run, *RUNS[index + 1 :]], dtype=np.int32)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"base": np.zeros((5, 7), dtype=np.uint8)}, "C-contiguous"),
        ({"base": np.zeros((5, 14, 2), dtype=np.uint8)[:, ::2]}, "C-contiguous"),
        ({"base": np.asfortranarray(np.zeros((5, 7, 2), dtype=np.uint8))}, "C-contiguous"),
        ({"channels": ("C",)}, "2 channels but 1 names"),
        ({"channels": ("C", "M", "Y")}, "2 channels but 3 names"),
        ({"base": np.zeros((5, 7, 9), dtype=np.uint8), "channels": tuple("123456789")}, "9 channels"),
        ({"base": np.zeros((5, 7, 0), dtype=np.uint8), "channels": ()}, "0 channels"),
        ({"tile_source": np.zeros(24, dtype=np.int32)}, "tile must be"),
        ({"tile_source": np.zeros((0, 6), dtype=np.int32)}, "tile must be"),
        ({"tile_source": np.full((4, 6), 35, dtype=np.int32)}, "outside the base"),
        ({"tile_source": np.full((4, 6), -1, dtype=np.int32)}, "outside the base"),
        ({"activation_threshold": -1}, "32-bit"),
        ({"activation_threshold": 1 << 32}, "32-bit"),
        ({"count_a": -1}, "differ in length"),
        ({"count_a": 4}, "differ in length"),
        ({"cell_col": int32(1, 2)}, "differ in length"),
        ({"base_row": int32(0, 2)}, "differ in length"),
        ({"base_col": int32(4, 0, 5, 5)}, "differ in length"),
        ({"rows": int32(2, 3)}, "differ in length"),
        ({"cols": int32(3, 2)}, "differ in length"),
        ({"worst_delta_e": np.zeros(2, dtype=np.float32)}, "differ in length"),
        ({"mean_delta_e": np.zeros(2, dtype=np.float32)}, "differ in length"),
        ({"run_offset": np.array([0, 3, 7])}, "differ in length"),
        ({"overlaps": np.zeros((3, 2), dtype=bool)}, "differ in length"),
        ({"overlaps": np.zeros((2, 2), dtype=bool)}, "differ in length"),
        ({"run_offset": np.array([1, 3, 6, 7])}, "out of order"),
        ({"run_offset": np.array([0, 3, 6, 6])}, "out of order"),
        ({"run_offset": np.array([0, 6, 3, 7])}, "out of order"),
        ({"run_offset": np.array([0, 3, 3, 7])}, "out of order"),  # a patch without a pixel
        ({"base_row": int32(-1, 2, 3)}, "outside the base"),
        ({"base_row": int32(0, 2, 5)}, "outside the base"),
        ({"base_row": int32(0, 3, 3)}, "outside the base"),
        ({"base_col": int32(4, -1, 5)}, "outside the base"),
        ({"base_col": int32(4, 0, 6)}, "outside the base"),
        ({"runs": changed_run(6, [1, 0, 2])}, "outside the base"),
        ({"runs": changed_run(6, [-1, 0, 2])}, "outside the base"),
        ({"runs": changed_run(6, [0, -1, 2])}, "outside the base"),
        ({"runs": changed_run(6, [0, 1, 2])}, "outside the base"),
        ({"runs": changed_run(6, [0, 0, 0])}, "outside the base"),
        ({"runs": changed_run(4, [0, 0, 2])}, "reading order"),
        ({"runs": changed_run(5, [1, 1, 1])}, "reading order"),
        ({"runs": changed_run(1, [0, 0, 1])}, "reading order"),
    ],
)
def test_parts_that_do_not_fit_are_refused(hand_map: HandMap, changes: dict[str, Any], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        hand_map(**changes)


@pytest.mark.parametrize("threshold", [0, (1 << 32) - 1])
def test_the_ends_of_the_range_are_accepted(hand_map: HandMap, threshold: int) -> None:
    assert hand_map(activation_threshold=threshold).activation_threshold == threshold


def test_a_map_needs_no_patches(hand_map: HandMap) -> None:
    none = np.zeros(0, dtype=np.int32)
    bare = Patches(
        count_a=0,
        **dict.fromkeys(("cell_row", "cell_col", "base_row", "base_col", "rows", "cols"), none),
        run_offset=np.zeros(1, dtype=np.int64),
        runs=np.zeros((0, 3), dtype=np.int32),
        overlaps=np.zeros((0, 0), dtype=bool),
        worst_delta_e=np.zeros(0, dtype=np.float32),
        mean_delta_e=np.zeros(0, dtype=np.float32),
    )
    assert len(hand_map(patches=bare).patches) == 0
    assert_array_equal(bare.area_px, [])


def test_masks_and_areas_come_from_the_runs(hand_map: HandMap) -> None:
    patches = hand_map().patches
    assert len(patches) == 3
    assert_array_equal(patches.mask(0).astype(int), [[1, 0, 1], [1, 1, 1]])
    assert_array_equal(patches.mask(1).astype(int), [[1, 1], [1, 1], [0, 1]])
    assert_array_equal(patches.mask(2).astype(int), [[1, 1]])
    assert_array_equal(patches.area_px, [5, 5, 2])


def test_the_tile_is_copied_from_the_base_and_cannot_be_written(hand_map: HandMap) -> None:
    texture_map = hand_map()
    assert texture_map.tile_shape == (4, 6)
    assert texture_map.tile.shape == (4, 6, 2)
    for r, c in np.ndindex(4, 6):
        assert_array_equal(texture_map.tile[r, c], texture_map.base[divmod(int(texture_map.tile_source[r, c]), 7)])
    with pytest.raises(ValueError, match="read-only"):
        texture_map.tile[0, 0, 0] = 1


def test_the_hash_is_pinned(hand_map: HandMap) -> None:
    assert hand_map().hash == HAND_MAP_HASH


def swapped(values: np.ndarray) -> np.ndarray:
    """Other values of the same shape, as little changed as can be."""
    values = values.copy()
    values.flat[-1] = ~values.flat[-1] if values.dtype == bool else values.flat[-1] + 1
    return values


ARRAYS = ["base", "tile_source", "overlaps", "worst_delta_e", "mean_delta_e", "cell_row", "cell_col"]


@pytest.mark.parametrize(
    "changes",
    [
        {"activation_threshold": (1 << 31) + 1},
        {"space": "ink16"},
        {"channels": ("C", "M")},
        {"channels": ("CK", "")},
        {"dpi": 400.5},
        {"count_a": 1},
        {"slabs": ()},
        {"slabs": (SlabArea("b", 0, 0, 5, 7),)},
        {"slabs": (SlabArea("a", 0, 0, 5, 6),)},
        {"provenance": {}},
        {"provenance": {"scan": "b.tif"}},
        {"provenance": {"scan": "a.tif", "more": ""}},
        {"base": np.arange(70, dtype=np.uint16).reshape(5, 7, 2)},
        {"base_row": int32(0, 2, 2)},
        {"base_col": int32(3, 0, 5)},
        {"rows": int32(3, 3, 1)},
        {"cols": int32(3, 3, 2)},
        {"runs": changed_run(6, [0, 0, 1])},
    ],
)
def test_the_hash_changes_with_every_fact(hand_map: HandMap, changes: dict[str, Any]) -> None:
    assert hand_map(**changes).hash != HAND_MAP_HASH


def test_the_hash_changes_with_the_shape_of_an_array(hand_map: HandMap) -> None:
    fitting = {"base_col": int32(1, 0, 3)}
    other = hand_map(base=np.arange(70, dtype=np.uint8).reshape(7, 5, 2), **fitting)
    assert other.hash != hand_map(**fitting).hash


def test_the_hash_changes_with_where_the_runs_of_a_patch_begin(hand_map: HandMap) -> None:
    runs = np.array([[0, 0, 1], [0, 1, 1], [1, 0, 1], [2, 0, 1], [0, 0, 1]], dtype=np.int32)
    hashes = {hand_map(runs=runs, run_offset=np.array([0, n, 4, 5])).hash for n in (1, 2, 3)}
    assert len(hashes) == 3


@pytest.mark.parametrize("name", ARRAYS)
def test_the_hash_changes_with_every_array(hand_map: HandMap, name: str) -> None:
    texture_map = hand_map()
    owner = texture_map.patches if hasattr(texture_map.patches, name) else texture_map
    assert hand_map(**{name: swapped(getattr(owner, name))}).hash != HAND_MAP_HASH


def test_every_array_is_in_the_list_that_is_hashed(hand_map: HandMap) -> None:
    arrays = hand_map().arrays()
    assert list(arrays) == ["base", "tile_source"] + [
        f"patch_{name}"
        for name in (
            *("cell_row", "cell_col", "base_row", "base_col", "rows", "cols", "run_offset", "runs"),
            *("overlaps", "worst_delta_e", "mean_delta_e"),
        )
    ]


def test_the_hash_of_a_copy_is_the_same(hand_map: HandMap) -> None:
    texture_map = hand_map()
    copy = replace(
        texture_map,
        base=texture_map.base.copy(),
        tile_source=np.asfortranarray(texture_map.tile_source),
        patches=replace(
            texture_map.patches,
            runs=np.ascontiguousarray(texture_map.patches.runs.T).T,
            run_offset=texture_map.patches.run_offset.astype(">i8"),
        ),
        provenance=dict(texture_map.provenance),
    )
    assert copy.hash == HAND_MAP_HASH


def test_the_hash_is_of_values_not_of_their_types(hand_map: HandMap) -> None:
    texture_map = hand_map(
        activation_threshold=np.int64(1 << 31),
        count_a=np.int32(2),
        dpi=np.float64(400),
        slabs=(SlabArea("a", np.int32(0), np.int64(0), np.int32(5), np.int32(7)),),
        channels=["C", "K"],
    )
    assert texture_map.hash == HAND_MAP_HASH


def test_the_order_of_the_provenance_does_not_matter(hand_map: HandMap) -> None:
    assert hand_map(provenance={"a": "1", "b": "2"}).hash == hand_map(provenance={"b": "2", "a": "1"}).hash


def test_with_base_keeps_every_pixel_in_its_place(hand_map: HandMap) -> None:
    texture_map = hand_map()
    base = np.asfortranarray(np.arange(105, dtype=np.uint16).reshape(5, 7, 3))
    other = texture_map.with_base(base, "ink16", ("C", "B", "K"), press="p1")
    assert other.base.flags.c_contiguous
    assert_array_equal(other.base, base)
    assert (other.space, other.channels, other.dpi) == ("ink16", ("C", "B", "K"), 400.0)
    assert other.provenance == {"scan": "a.tif", "press": "p1"}
    assert texture_map.provenance == {"scan": "a.tif"}
    assert other.patches is texture_map.patches
    assert_array_equal(other.tile, base.reshape(-1, 3)[texture_map.tile_source])
    assert texture_map.tile.dtype == np.uint8
    assert other.hash != texture_map.hash
    back = other.with_base(texture_map.base, "ink8", ("C", "K"))
    assert replace(back, provenance=texture_map.provenance).hash == HAND_MAP_HASH


@pytest.mark.parametrize("shape", [(5, 6, 2), (6, 7, 2), (7, 5, 2)])
def test_with_base_refuses_another_size(hand_map: HandMap, shape: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="can't replace"):
        hand_map().with_base(np.zeros(shape, dtype=np.uint8), "ink8", ("C", "K"))


def test_with_base_refuses_channels_without_a_name(hand_map: HandMap) -> None:
    with pytest.raises(ValueError, match="channels"):
        hand_map().with_base(np.zeros((5, 7, 3), dtype=np.uint8), "ink8", ("C", "K"))
