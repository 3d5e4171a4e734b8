"""Rendering crops: pixel by pixel as the plain oracle, the same however a region is asked for, in any format."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.sampling import CropMap, plan_region, render, render_plan, render_points, render_reduced
from tilefab.sampling.crop_reference import CropReference, crop_pixel_reference, render_crop_reference
from tilefab.sampling.render import COORDINATE_LIMIT
from tilefab.types import Array

FAR = 2**40
MODULE = sys.modules["tilefab.sampling.render"]
NAMES = ["inks", "shifted", "rationed"]
LIMIT_ROOM = 2**60 - 2**10
origins = st.one_of(st.integers(-200, 200), st.integers(-FAR, FAR), st.sampled_from([-FAR, FAR, -(2**60), 2**60 - 400]))
seeds = st.integers(0, 2**63 - 1)


@pytest.mark.parametrize("origin", [(0, 0), (-41, -13), (FAR - 7, -FAR - 20), (-(2**60), 2**60 - 40)])
def test_render_is_the_plain_oracle(crop_map: CropMap, origin: tuple[int, int]) -> None:
    picture = render(crop_map, *origin, 35, 40, seed=3)
    assert_array_equal(picture, render_crop_reference(crop_map, *origin, 35, 40, seed=3))


# The oracle is too slow to look for the smallest example that fails.
@settings(max_examples=10, phases=[Phase.explicit, Phase.generate])
@given(st.data())
def test_any_region_at_any_level_is_the_plain_oracles(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(NAMES))]
    level = data.draw(st.integers(0, crop_map.coarsest_level))
    row, col = (data.draw(origins) >> level for _ in range(2))
    rows, cols, seed = data.draw(st.integers(1, 30)), data.draw(st.integers(1, 30)), data.draw(seeds)
    reduced = render_reduced(crop_map, row, col, rows, cols, level=level, seed=seed)
    assert_array_equal(reduced, render_crop_reference(crop_map, row, col, rows, cols, seed=seed, level=level))


@pytest.mark.parametrize("far", [0, FAR, LIMIT_ROOM])
def test_points_are_the_plain_oracles(crop_map: CropMap, far: int) -> None:
    random = np.random.default_rng(4)
    rows, cols = np.add(random.integers(-25, 25, (2, 60)), [[far], [-far]])
    points = render_points(crop_map, rows, cols, seed=3)
    plane = CropReference(crop_map, seed=3)
    for row, col, colour in zip(rows.tolist(), cols.tolist(), points, strict=True):
        assert_array_equal(colour, plane.pixel(row, col))
    assert_array_equal(points[0], crop_pixel_reference(crop_map, int(rows[0]), int(cols[0]), seed=3))


@settings(max_examples=50)
@given(st.data())
def test_any_division_of_any_region_gives_the_same_pixels(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(NAMES))]
    row, col, seed = data.draw(origins), data.draw(origins), data.draw(seeds)
    rows, cols = data.draw(st.integers(1, 200)), data.draw(st.integers(1, 200))
    whole = render(crop_map, row, col, rows, cols, seed=seed, threads=1)
    row_cuts = sorted({0, rows, *data.draw(st.lists(st.integers(0, rows), max_size=3))})
    col_cuts = sorted({0, cols, *data.draw(st.lists(st.integers(0, cols), max_size=3))})
    parts = [(r, r2, c, c2) for r, r2 in itertools.pairwise(row_cuts) for c, c2 in itertools.pairwise(col_cuts)]
    for r, r2, c, c2 in data.draw(st.permutations(parts)):
        part = render(crop_map, row + r, col + c, r2 - r, c2 - c, seed=seed)
        assert_array_equal(part, whole[r:r2, c:c2])
    n = data.draw(st.integers(1, 40))
    r, c = np.random.default_rng(n).integers(0, (rows, cols), (n, 2)).T
    assert_array_equal(render_points(crop_map, row + r, col + c, seed=seed), whole[r, c])


def test_single_rows_columns_and_pixels(crop_map: CropMap) -> None:
    whole = render(crop_map, -60, -70, 120, 120, seed=0)
    for k in range(120):
        assert_array_equal(render(crop_map, -60 + k, -70, 1, 120, seed=0)[0], whole[k])
        assert_array_equal(render(crop_map, -60, -70 + k, 120, 1, seed=0)[:, 0], whole[:, k])
    for k in range(0, 120, 7):
        assert_array_equal(render(crop_map, -60 + k, -70 + k, 1, 1, seed=0)[0, 0], whole[k, k])
    row, col = np.arange(-60, 60), np.arange(-70, 50)
    assert_array_equal(render_points(crop_map, row[:, None], col, seed=0), whole)


@settings(max_examples=40)
@given(st.data())
def test_threads_strips_and_buffers_change_nothing(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(NAMES))]
    row, col = data.draw(origins), data.draw(origins)
    rows, cols = data.draw(st.integers(0, 200)), data.draw(st.integers(0, 150))
    whole = render(crop_map, row, col, rows, cols, seed=1, threads=1)
    assert whole.shape == (rows, cols, crop_map.base.shape[2])
    with pytest.MonkeyPatch.context() as patch:
        # Strips are megabytes; here a region is to have many.
        patch.setattr(MODULE, "_STRIP_BYTES", data.draw(st.integers(1, 5000)))
        out = np.full_like(whole, 77)
        result = render(crop_map, row, col, rows, cols, seed=1, out=out, threads=data.draw(st.integers(1, 4)))
        assert result is out
        assert_array_equal(out, whole)


@settings(max_examples=30)
@given(st.data())
def test_strips_of_a_plan_are_the_whole(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(NAMES))]
    row, col = data.draw(origins), data.draw(origins)
    rows, cols = data.draw(st.integers(1, 150)), data.draw(st.integers(1, 100))
    plan = plan_region(crop_map, row, col, rows, cols, seed=4, threads=data.draw(st.integers(1, 4)))
    whole = render(crop_map, row, col, rows, cols, seed=4)
    assert_array_equal(render_plan(crop_map, plan), whole)
    cuts = sorted({0, rows, *data.draw(st.lists(st.integers(0, rows), max_size=4))})
    strips = [render_plan(crop_map, plan, first=r, rows=r2 - r) for r, r2 in itertools.pairwise(cuts)]
    assert_array_equal(np.concatenate(strips), whole)
    assert_array_equal(render_plan(crop_map, plan, first=cuts[-2]), whole[cuts[-2] :])
    buffer = np.zeros((cuts[1], *whole.shape[1:]), dtype=whole.dtype)
    assert render_plan(crop_map, plan, rows=cuts[1], out=buffer, threads=3) is buffer
    assert_array_equal(buffer, whole[: cuts[1]])


@settings(max_examples=25)
@given(st.data())
def test_any_part_of_a_preview_is_the_same(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(NAMES))]
    level = data.draw(st.integers(0, crop_map.coarsest_level + 2))
    row, col = (data.draw(origins) >> level for _ in range(2))
    rows, cols = data.draw(st.integers(1, 40)), data.draw(st.integers(1, 40))
    whole = render_reduced(crop_map, row, col, rows, cols, level=level, seed=9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MODULE, "_STRIP_BYTES", data.draw(st.integers(1, 5000)))
        threads = data.draw(st.integers(1, 3))
        assert_array_equal(render_reduced(crop_map, row, col, rows, cols, level=level, seed=9, threads=threads), whole)
    r, c = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    part = render_reduced(crop_map, row + r, col + c, rows - r, cols - c, level=level, seed=9)
    assert_array_equal(part, whole[r:, c:])


def test_level_0_is_the_plane_and_beyond_the_coarsest_means_are_taken(crop_map: CropMap) -> None:
    whole = render(crop_map, -40, -48, 64, 64, seed=2)
    assert_array_equal(render_reduced(crop_map, -40, -48, 64, 64, level=0, seed=2), whole)
    level = crop_map.coarsest_level
    fine = render_reduced(crop_map, -40, -48, 64, 64, level=level, seed=2)
    coarse = render_reduced(crop_map, -20, -24, 32, 32, level=level + 1, seed=2)
    blocks = fine.astype(np.float64).reshape(32, 2, 32, 2, -1).mean(axis=(1, 3))
    expected = np.floor(blocks + 0.5) if fine.dtype.kind == "u" else blocks.astype(fine.dtype)
    assert_array_equal(coarse, expected)


@pytest.mark.parametrize(("step", "tolerance"), [(16, 0.25), (1, 0.65)], ids=["aligned", "anywhere"])
def test_previews_are_near_the_means_of_the_plane(
    crop_map_of: Callable[..., CropMap], step: int, tolerance: float
) -> None:
    """Crops whose places aren't whole pixels of the halved slab are shown up to one such pixel away."""
    sizes = {"pitch_px": 32, "overlap_px": 16, "rows": 160, "cols": 160, "channels": 1}
    crop_map = crop_map_of(**sizes)
    crop_map = crop_map_of(
        **sizes, crop_row=crop_map.crop_row // step * step, crop_col=crop_map.crop_col // step * step
    )
    # A base that looks as the guide does.
    crop_map = crop_map.with_base(crop_map.guide[..., :1].copy(), "lightness", ("L",))
    whole = render(crop_map, 0, 0, 800, 800, seed=0).astype(np.float64)
    for level in (1, 2, 3, 4):
        factor = 1 << level
        reduced = render_reduced(crop_map, 0, 0, 800 // factor, 800 // factor, level=level, seed=0)
        means = whole.reshape(800 // factor, factor, 800 // factor, factor).mean(axis=(1, 3))
        apart = np.abs(reduced[..., 0] - means)
        assert apart.mean() < tolerance * means.std()


def test_negative_values_are_rounded_like_any(crop_map_of: Callable[..., CropMap]) -> None:
    crop_map = crop_map_of(channels=1)
    base = -1 - crop_map.base.astype(np.int32)
    down = crop_map.with_base(base, "shifted", ("a",))
    up = crop_map.with_base(base + 1000 * 4, "shifted", ("a",))
    for level in range(crop_map.coarsest_level + 3):
        reduced = [render_reduced(m, -9, -9, 30, 30, level=level, seed=0) for m in (down, up)]
        assert_array_equal(reduced[0] + 4000, reduced[1])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float32])
@pytest.mark.parametrize("channels", range(1, 9))
def test_every_pixel_keeps_its_place_in_any_format(
    crop_maps: dict[str, CropMap], index_base: Callable[[int, int], NDArray[np.int32]], dtype: type, channels: int
) -> None:
    crop_map = crop_maps["shifted"]
    rows, cols = crop_map.base.shape[:2]
    where = render(crop_map.with_base(index_base(rows, cols), "index", ("i",)), -30, -40, 110, 130, seed=6)[..., 0]
    random = np.random.default_rng(channels)
    base = (random.random((rows, cols, channels)) * 60000).astype(np.uint16).astype(dtype)
    other = crop_map.with_base(base, "other", tuple("abcdefgh"[:channels]))
    picture = render(other, -30, -40, 110, 130, seed=6)
    assert picture.dtype == dtype
    assert_array_equal(picture, base.reshape(-1, channels)[where])
    r, c = random.integers(0, (110, 130), (100, 2)).T
    points = render_points(other, r - 30, c - 40, seed=6)
    assert points.dtype == dtype
    assert_array_equal(points, picture[r, c])
    plan = plan_region(crop_map, -30, -40, 110, 130, seed=6)
    assert_array_equal(render_plan(other, plan), picture)


def test_every_pixel_is_of_its_cells_crop_and_in_its_place(
    crop_map: CropMap, index_base: Callable[[int, int], NDArray[np.int32]]
) -> None:
    """Whatever the seams: a pixel shows a crop of the cell it lies in or of one that touches it, within that crop."""
    shape = crop_map.base.shape[:2]
    where = render(crop_map.with_base(index_base(*shape), "index", ("i",)), -50, -50, 130, 130, seed=1)[..., 0]
    plan = plan_region(crop_map, -50 - crop_map.pitch_px, -50 - crop_map.pitch_px, 300, 300, seed=1)
    pitch, half = crop_map.pitch_px, crop_map.overlap_px // 2
    for r in range(0, 130, 3):
        for c in range(0, 130, 3):
            base_row, base_col = divmod(int(where[r, c]), shape[1])
            shown = []
            for cell_row in {(r - 50 - half) // pitch, (r - 50 + half) // pitch}:
                for cell_col in {(c - 50 - half) // pitch, (c - 50 + half) // pitch}:
                    crop = plan.crops[cell_row - plan.first_row, cell_col - plan.first_col]
                    top, left = cell_row * pitch - half, cell_col * pitch - half
                    shown.append(
                        (int(crop_map.crop_row[crop]) + r - 50 - top, int(crop_map.crop_col[crop]) + c - 50 - left)
                    )
            assert (base_row, base_col) in shown


def test_nothing_is_fixed(crop_map: CropMap, index_base: Callable[[int, int], NDArray[np.int32]]) -> None:
    index = crop_map.with_base(index_base(*crop_map.base.shape[:2]), "index", ("i",))
    pictures = [render(index, 0, 0, 150, 150, seed=seed)[..., 0] for seed in (0, 1, 2**62, 2**63 - 1)]
    for k in range(4):
        for other in range(k):
            assert (pictures[k] == pictures[other]).mean() < 0.2


def test_a_map_is_left_as_it_was(crop_map: CropMap) -> None:
    before = {name: array.copy() for name, array in crop_map.arrays().items()}
    render(crop_map, -10, -10, 100, 100, seed=1)[:] = 0
    render_points(crop_map, [1, 2], [3, 4], seed=1)[:] = 0
    render_reduced(crop_map, 0, 0, 20, 20, level=1, seed=1)[:] = 0
    for name, array in crop_map.arrays().items():
        assert_array_equal(array, before[name])


@pytest.mark.parametrize(("rows", "cols"), [(0, 5), (5, 0), (0, 0)])
def test_empty_regions(crop_map: CropMap, rows: int, cols: int) -> None:
    channels = crop_map.base.shape[2]
    assert render(crop_map, 3, -7, rows, cols, seed=0).shape == (rows, cols, channels)
    assert render_reduced(crop_map, 3, -7, rows, cols, level=1, seed=0).shape == (rows, cols, channels)
    nowhere = np.zeros((rows, cols), dtype=np.int64)
    assert render_points(crop_map, nowhere, nowhere, seed=0).shape == (rows, cols, channels)


def test_the_limit_itself_is_within_range(crop_map: CropMap) -> None:
    assert COORDINATE_LIMIT == 2**60
    for row, col in ((-(2**60), -(2**60)), (2**60 - 5, 2**60 - 5), (-(2**60), 2**60 - 5)):
        corner = render(crop_map, row, col, 5, 5, seed=0)
        assert_array_equal(corner, render_crop_reference(crop_map, row, col, 5, 5, seed=0))
        assert_array_equal(corner[0, 0], render_points(crop_map, row, col, seed=0))


def test_the_smallest_cells_reach_as_far(crop_map_of: Callable[..., CropMap]) -> None:
    crop_map = crop_map_of(pitch_px=2, overlap_px=2, seam_levels=0, sweeps=1)
    for row, col in ((0, 0), (-(2**60), 2**60 - 12), (2**60 - 12, -(2**60))):
        assert_array_equal(
            render(crop_map, row, col, 12, 12, seed=0), render_crop_reference(crop_map, row, col, 12, 12, seed=0)
        )


@pytest.mark.parametrize(
    ("row", "col", "rows", "cols", "match"),
    [
        (COORDINATE_LIMIT + 1, 0, 0, 0, "beyond"),
        (0, -COORDINATE_LIMIT - 1, 5, 5, "beyond"),
        (COORDINATE_LIMIT - 4, 0, 5, 5, "beyond"),
        (0, 0, -1, 5, "-1 rows"),
        (0, 0, 5, -1, "-1 columns"),
    ],
)
def test_regions_out_of_range_are_refused(
    crop_maps: dict[str, CropMap], row: int, col: int, rows: int, cols: int, match: str
) -> None:
    with pytest.raises(ValueError, match=match):
        render(crop_maps["inks"], row, col, rows, cols, seed=0)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"level": -1}, "level -1"),
        ({"row": 2**59, "level": 2}, "beyond"),
        ({"rows": -1}, "rows"),
        ({"seed": -1}, "seed"),
        ({"seed": 2**63}, "seed"),
        ({"threads": 0}, "threads"),
    ],
)
def test_previews_out_of_range_are_refused(crop_maps: dict[str, CropMap], changes: dict[str, int], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        render_reduced(
            crop_maps["inks"], **{"row": 0, "col": 0, "rows": 3, "cols": 3, "level": 1, "seed": 0, **changes}
        )


@pytest.mark.parametrize(("first", "rows"), [(-1, 2), (0, 11), (5, 6), (11, None), (3, -1)])
def test_strips_outside_a_plan_are_refused(crop_maps: dict[str, CropMap], first: int, rows: int | None) -> None:
    crop_map = crop_maps["inks"]
    plan = plan_region(crop_map, 0, 0, 10, 10, seed=0)
    with pytest.raises(ValueError, match="planned"):
        render_plan(crop_map, plan, first=first, rows=rows)


@pytest.mark.parametrize("level", [-1, 3])
def test_levels_without_seams_are_not_planned(crop_maps: dict[str, CropMap], level: int) -> None:
    with pytest.raises(ValueError, match=f"level {level}"):
        plan_region(crop_maps["inks"], 0, 0, 10, 10, seed=0, level=level)


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_seeds_out_of_range_are_refused(crop_maps: dict[str, CropMap], seed: int) -> None:
    for rows in (0, 4):
        with pytest.raises(ValueError, match="seed"):
            render(crop_maps["inks"], 0, 0, rows, 4, seed=seed)
    with pytest.raises(ValueError, match="seed"):
        render_points(crop_maps["inks"], [], [], seed=seed)


def read_only() -> NDArray[np.uint8]:
    out = np.zeros((4, 5, 4), dtype=np.uint8)
    out.flags.writeable = False
    return out


@pytest.mark.parametrize(
    "out",
    [
        np.zeros((4, 5, 3), dtype=np.uint8),
        np.zeros((4, 5, 4), dtype=np.uint16),
        np.zeros((4, 10, 4), dtype=np.uint8)[:, ::2],
        read_only(),
    ],
    ids=["channels", "depth", "strided", "read-only"],
)
def test_unusable_buffers_are_refused(crop_maps: dict[str, CropMap], out: Array) -> None:
    with pytest.raises(ValueError, match="out must be"):
        render(crop_maps["inks"], 0, 0, 4, 5, seed=0, out=out)
    with pytest.raises(ValueError, match="out must be"):
        render_plan(crop_maps["inks"], plan_region(crop_maps["inks"], 0, 0, 4, 5, seed=0), out=out)


def test_points_over_pages_of_the_plane(crop_maps: dict[str, CropMap]) -> None:
    """Points are taken by pages; neither their order nor the pages they share change what they show."""
    crop_map = crop_maps["inks"]
    random = np.random.default_rng(0)
    rows, cols = random.integers(-1100, 1100, (2, 200))
    together = render_points(crop_map, rows, cols, seed=0)
    order = random.permutation(200)
    assert_array_equal(render_points(crop_map, rows[order], cols[order], seed=0), together[order])
    for k in range(0, 200, 20):
        assert_array_equal(render(crop_map, int(rows[k]), int(cols[k]), 1, 1, seed=0)[0, 0], together[k])


def test_points_need_whole_coordinates(crop_maps: dict[str, CropMap]) -> None:
    bad: list[Any] = [0.0, [1.5], [True], [2**60 + 1], [-(2**60) - 1], np.uint64(2**64 - 1)]
    for value in bad:
        with pytest.raises(ValueError, match=r"must be integers|beyond"):
            render_points(crop_maps["inks"], value, 0, seed=0)


def test_one_crop_repeats_with_the_cells(crop_map_of: Callable[..., CropMap]) -> None:
    crop_map = crop_map_of(crops=1, candidates=1)
    picture = render(crop_map, -32, -32, 64, 64, seed=0)
    assert_array_equal(picture, np.tile(picture[:16, :16], (4, 4, 1)))


def test_another_base_shows_the_same_places(crop_map: CropMap) -> None:
    turned = crop_map.with_base(crop_map.base[..., ::-1], "turned", crop_map.channels[::-1])
    assert_array_equal(render(turned, 5, 5, 60, 60, seed=0), render(crop_map, 5, 5, 60, 60, seed=0)[..., ::-1])
    assert replace(crop_map, dpi=200.0).hash != crop_map.hash
