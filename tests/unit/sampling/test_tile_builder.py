"""Building maps: repeatable, only from valid stone, with costs that can be checked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.sampling import TileMap, TileOptions, build_tile_map, render
from tilefab.synthesis import SynthesisRequest
from tilefab.synthesis.quilting import quilt
from tilefab.texture.matching import matching_image
from tilefab.types import Mask, SizePx


def build_plain(
    lab: NDArray[np.float32],
    source: NDArray[np.int32],
    valid: Mask | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> TileMap:
    return build_tile_map(
        lab,
        np.ones(lab.shape[:2], dtype=bool) if valid is None else valid,
        source,
        TileOptions(**{"threads": 1, **options}),
        stored=lab,
        space="lab",
        channels=("L", "a", "b"),
        dpi=100.0,
        progress=progress,
    )


def test_the_map_keeps_what_it_was_given(built: Any) -> None:
    assert_array_equal(built.map.base, built.stored)
    assert_array_equal(built.map.tile_source, built.source)
    assert built.map.tile_source.dtype == np.int32
    assert built.map.dpi == 100.0
    assert built.map.slabs[0].name == "slab 1"


def test_as_many_patches_as_asked_for_half_of_them_in_each_set(built: Any) -> None:
    n = len(built.map.patches)
    assert n == built.options.patches
    assert built.map.patches.count_a == n // 2
    share = 2 * built.options.active_per_cell / n
    assert built.map.activation_threshold == int(share * 2**32)


def test_more_active_than_there_are_means_all(maps: dict[str, Any]) -> None:
    assert maps["inks"].build_again(active_per_cell=1e9).activation_threshold == 2**32 - 1
    assert maps["inks"].build_again(active_per_cell=0.0).activation_threshold == 0


@pytest.mark.parametrize("name", ["inks", "masked"])
def test_threads_change_nothing(maps: dict[str, Any], name: str) -> None:
    assert maps[name].build_again(threads=2).hash == maps[name].map.hash
    assert maps[name].build_again(threads=None).hash == maps[name].map.hash


def test_another_seed_is_another_map(maps: dict[str, Any]) -> None:
    assert maps["inks"].build_again(seed=6).hash != maps["inks"].map.hash


def test_patches_are_valid_stone_only(built: Any) -> None:
    patches = built.map.patches
    assert not built.valid.all() or built.map.space != "lab16"
    for k in range(len(patches)):
        at = np.add(np.argwhere(patches.mask(k)), (patches.base_row[k], patches.base_col[k]))
        assert built.valid[at[:, 0], at[:, 1]].all()


def test_costs_are_those_of_the_boundary(built: Any) -> None:
    """Recomputed from the finished map, pixel pair by pixel pair."""
    base, patches = matching_image(built.lab).astype(np.int64), built.map.patches
    tile = base.reshape(-1, 3)[built.source]
    tile_rows, tile_cols = built.map.tile_shape
    for k in range(len(patches)):
        mask = np.pad(patches.mask(k), 1)
        rows, cols = np.arange(mask.shape[0]) - 1, np.arange(mask.shape[1]) - 1
        there = tile[np.ix_((rows + patches.cell_row[k]) % tile_rows, (cols + patches.cell_col[k]) % tile_cols)]
        instead = base[np.ix_(rows + patches.base_row[k], cols + patches.base_col[k])]
        delta_e = np.sqrt(((there - instead) ** 2).sum(axis=2)) / 2
        pairs = []
        for r, c in np.argwhere(mask).tolist():
            for r2, c2 in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if not mask[r2, c2]:
                    pairs.append((delta_e[r, c] + delta_e[r2, c2]) / 2)
        assert patches.worst_delta_e[k] == np.float32(max(pairs))
        assert patches.mean_delta_e[k] == pytest.approx(np.mean(pairs), rel=1e-6)


def test_patches_fit_far_better_than_chance(built: Any) -> None:
    base = matching_image(built.lab).astype(np.float64)
    at_random = np.sqrt(((base[3:70, 7:90] - base[-67:, -83:]) ** 2).sum(axis=2)).mean() / 2
    assert np.median(built.map.patches.mean_delta_e) < 0.42 * at_random


def test_patches_come_in_all_sizes(built: Any) -> None:
    area = np.sort(built.map.patches.area_px)
    assert area[-1] > 8 * area[0]
    # Each of five sizes has its share: the largest fifth covers most.
    assert area[-len(area) // 5 :].sum() > 0.35 * area.sum()


def test_progress_rises_to_one(maps: dict[str, Any]) -> None:
    told: list[float] = []
    build_plain(maps["inks"].lab, maps["inks"].source, patches=20, progress=told.append)
    assert told == sorted(told)
    assert 0 < told[0] < 0.1
    assert told[-1] == 1.0


def test_one_colour_gives_one_colour() -> None:
    lab = np.full((80, 90, 3), (62.0, 1.5, 7.0), dtype=np.float32)
    source = quilt(SynthesisRequest(lab, np.ones((80, 90), dtype=bool), SizePx(50, 60), 1)).source
    texture_map = build_plain(lab, source, patches=30, active_per_cell=8.0)
    assert len(texture_map.patches) == 30
    assert not texture_map.patches.worst_delta_e.any()
    assert not texture_map.patches.mean_delta_e.any()
    picture = render(texture_map, -100, -100, 300, 300, seed=0)
    assert (picture == np.float32((62.0, 1.5, 7.0))).all()


def bare_tile(texture_map: TileMap) -> bool:
    rows, cols = texture_map.tile_shape
    picture = render(texture_map, -2 * rows, 4 * cols, 3 * rows, 3 * cols, seed=1)
    return bool((picture == np.tile(texture_map.tile, (3, 3, 1))).all())


@pytest.mark.parametrize("patches", [0, 1])
def test_without_patches_the_tile_repeats(maps: dict[str, Any], patches: int) -> None:
    texture_map = build_plain(maps["inks"].lab, maps["inks"].source, patches=patches)
    assert len(texture_map.patches) == 0
    assert texture_map.patches.count_a == 0
    assert bare_tile(texture_map)


def test_two_patches_are_one_for_each_set(maps: dict[str, Any]) -> None:
    texture_map = build_plain(maps["inks"].lab, maps["inks"].source, patches=2, active_per_cell=1.0)
    assert len(texture_map.patches) == 2
    assert texture_map.patches.count_a == 1
    assert texture_map.activation_threshold == 2**32 - 1
    assert not bare_tile(texture_map)


def test_a_tile_too_small_for_patches_has_none(stone: Callable[..., NDArray[np.float32]]) -> None:
    lab = stone(40, 40, 1)
    source = quilt(SynthesisRequest(lab, np.ones((40, 40), dtype=bool), SizePx(9, 9), 1)).source
    texture_map = build_plain(lab, source, patches=20)
    assert len(texture_map.patches) == 0
    assert bare_tile(texture_map)


def test_a_mask_too_ragged_for_patches_gives_none(stone: Callable[..., NDArray[np.float32]]) -> None:
    lab, valid = stone(60, 60, 1), np.ones((60, 60), dtype=bool)
    valid[::9] = valid[:, ::9] = False
    source = quilt(SynthesisRequest(lab, valid, SizePx(40, 40), 1)).source
    texture_map = build_plain(lab, source, valid, patches=20)
    assert len(texture_map.patches) == 0
    assert bare_tile(texture_map)


@pytest.mark.parametrize("part", ["valid", "stored"])
def test_images_of_other_sizes_are_refused(maps: dict[str, Any], part: str) -> None:
    built = maps["inks"]
    valid, stored = built.valid, built.stored
    if part == "valid":
        valid = valid[:-1]
    else:
        stored = np.ascontiguousarray(stored.transpose(1, 0, 2))
    with pytest.raises(ValueError, match="differ in size"):
        build_tile_map(
            built.lab,
            valid,
            built.source,
            TileOptions(patches=4),
            stored=stored,
            space="ink8",
            channels=("C", "B", "Y", "K"),
            dpi=100.0,
        )
