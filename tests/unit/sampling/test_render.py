"""Rendering: the same pixels however a region is asked for, in any format, anywhere on the plane."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.sampling import TileMap, render, render_points
from tilefab.sampling.render import COORDINATE_LIMIT
from tilefab.sampling.tile_reference import pixel_reference, render_reference

FAR = 2**40
# The function hides the module of the same name in the package.
MODULE = sys.modules["tilefab.sampling.render"]
NAMES = ["inks", "masked", "job"]
origins = st.one_of(st.integers(-200, 200), st.integers(-FAR, FAR), st.sampled_from([-FAR, FAR, -(2**60), 2**60 - 400]))


@pytest.mark.parametrize("origin", [(0, 0), (-41, -13), (FAR - 7, -FAR - 20), (-(2**60), 2**60 - 25)])
def test_render_is_the_sampler_of_the_first_seed(built: Any, origin: tuple[int, int]) -> None:
    picture = render(built.map, *origin, 22, 25, seed=3)
    assert_array_equal(picture, render_reference(built.map, *origin, 22, 25, seed=3))


def test_the_hand_made_map_pixel_by_pixel(hand_map: Callable[..., TileMap]) -> None:
    texture_map = hand_map(overlaps=~np.eye(3, dtype=bool))
    assert_array_equal(
        render(texture_map, -9, -13, 25, 31, seed=8), render_reference(texture_map, -9, -13, 25, 31, seed=8)
    )


@pytest.mark.parametrize("far", [0, FAR, 2**60 - 2**20])
def test_points_are_the_sampler_of_the_first_seed(built: Any, far: int) -> None:
    random = np.random.default_rng(4)
    rows, cols = np.add(random.integers(-500, 500, (2, 300)), [[far], [-far]])
    points = render_points(built.map, rows, cols, seed=3)
    for row, col, colour in zip(rows.tolist(), cols.tolist(), points, strict=True):
        assert_array_equal(colour, pixel_reference(built.map, row, col, seed=3))


@settings(max_examples=60)
@given(st.data())
def test_any_division_of_any_region_gives_the_same_pixels(maps: dict[str, Any], data: st.DataObject) -> None:
    texture_map = maps[data.draw(st.sampled_from(NAMES))].map
    row, col = data.draw(origins), data.draw(origins)
    rows, cols = data.draw(st.integers(1, 260)), data.draw(st.integers(1, 260))
    seed = data.draw(st.integers(0, 2**63 - 1))
    whole = render(texture_map, row, col, rows, cols, seed=seed, threads=1)
    row_cuts = sorted({0, rows, *data.draw(st.lists(st.integers(0, rows), max_size=3))})
    col_cuts = sorted({0, cols, *data.draw(st.lists(st.integers(0, cols), max_size=3))})
    parts = [(r, r2, c, c2) for r, r2 in itertools.pairwise(row_cuts) for c, c2 in itertools.pairwise(col_cuts)]
    for r, r2, c, c2 in data.draw(st.permutations(parts)):
        part = render(texture_map, row + r, col + c, r2 - r, c2 - c, seed=seed)
        assert_array_equal(part, whole[r:r2, c:c2])
    n = data.draw(st.integers(1, 40))
    r, c = np.random.default_rng(n).integers(0, (rows, cols), (n, 2)).T
    assert_array_equal(render_points(texture_map, row + r, col + c, seed=seed), whole[r, c])


@settings(max_examples=40)
@given(st.data())
def test_threads_strips_and_buffers_change_nothing(maps: dict[str, Any], data: st.DataObject) -> None:
    texture_map = maps[data.draw(st.sampled_from(NAMES))].map
    row, col = data.draw(origins), data.draw(origins)
    rows, cols = data.draw(st.integers(0, 200)), data.draw(st.integers(0, 150))
    whole = render(texture_map, row, col, rows, cols, seed=1, threads=1)
    assert whole.shape == (rows, cols, texture_map.base.shape[2])
    with pytest.MonkeyPatch.context() as patch:
        # Strips are a megabyte; here a region is to have many.
        patch.setattr(MODULE, "_STRIP_BYTES", data.draw(st.integers(1, 5000)))
        out = np.full_like(whole, 77)
        result = render(texture_map, row, col, rows, cols, seed=1, out=out, threads=data.draw(st.integers(1, 4)))
        assert result is out
        assert_array_equal(out, whole)
        assert_array_equal(render(texture_map, row, col, rows, cols, seed=1), whole)


@pytest.mark.parametrize("threads", [1, 2, 3, 4, None])
def test_real_strips_in_threads(maps: dict[str, Any], threads: int | None) -> None:
    texture_map = maps["job"].map
    rows, cols = 1003, 501
    whole = render(texture_map, -77, 31, rows, cols, seed=2, threads=threads)
    assert whole.nbytes > 5 << 20
    again = np.concatenate(
        [render(texture_map, -77 + r, 31, min(50, rows - r), cols, seed=2) for r in range(0, rows, 50)]
    )
    assert_array_equal(whole, again)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("channels", range(1, 9))
def test_every_pixel_keeps_its_place_in_any_format(
    maps: dict[str, Any], index_base: Callable[[int, int], NDArray[np.int32]], dtype: type, channels: int
) -> None:
    texture_map = maps["masked"].map
    rows, cols = texture_map.base.shape[:2]
    where = render(texture_map.with_base(index_base(rows, cols), "index", ("i",)), -30, -40, 150, 170, seed=6)[..., 0]
    random = np.random.default_rng(channels)
    base = (random.random((rows, cols, channels)) * 60000).astype(np.uint16).astype(dtype)
    other = texture_map.with_base(base, "other", tuple("abcdefgh"[:channels]))
    picture = render(other, -30, -40, 150, 170, seed=6)
    assert picture.dtype == dtype
    assert_array_equal(picture, base.reshape(-1, channels)[where])
    r, c = random.integers(0, (150, 170), (200, 2)).T
    points = render_points(other, r - 30, c - 40, seed=6)
    assert points.dtype == dtype
    assert_array_equal(points, picture[r, c])


def test_only_valid_stone_is_printed(maps: dict[str, Any], index_base: Callable[[int, int], NDArray[np.int32]]) -> None:
    built = maps["masked"]
    where = render(built.map.with_base(index_base(*built.valid.shape), "index", ("i",)), 0, 0, 600, 600, seed=0)
    assert built.valid.ravel()[where].all()
    # And much of it: more than the tile alone could show.
    assert len(np.unique(where)) > 1.15 * len(np.unique(built.source))


def test_seeds_are_other_planes(built: Any) -> None:
    pictures = [render(built.map, 0, 0, 200, 200, seed=seed) for seed in (0, 1, 2**62, 2**63 - 1)]
    for i in range(4):
        for j in range(i):
            assert 0.1 < (pictures[i] != pictures[j]).any(axis=2).mean() < 0.95


def test_the_plane_does_not_repeat(built: Any) -> None:
    tile_rows, tile_cols = built.map.tile_shape
    here = render(built.map, 0, 0, 2 * tile_rows, 2 * tile_cols, seed=0)
    for far in (2, 2**16, 2**31, 2**32, 2**48):
        for dr, dc in ((far, 0), (0, far), (-far, -far)):
            there = render(built.map, dr * tile_rows, dc * tile_cols, 2 * tile_rows, 2 * tile_cols, seed=0)
            assert (here != there).any(axis=2).mean() > 0.1


def test_without_activation_the_tile_repeats(hand_map: Callable[..., TileMap]) -> None:
    texture_map = hand_map(activation_threshold=0)
    picture = render(texture_map, -8, -12, 16, 24, seed=0)
    assert_array_equal(picture, np.tile(texture_map.tile, (4, 4, 1)))


def test_a_map_is_left_as_it_was(maps: dict[str, Any]) -> None:
    texture_map = maps["inks"].map
    before = {name: array.copy() for name, array in texture_map.arrays().items()}
    render(texture_map, -10, -10, 300, 300, seed=1)[:] = 0
    render_points(texture_map, [1, 2], [3, 4], seed=1)[:] = 0
    for name, array in texture_map.arrays().items():
        assert_array_equal(array, before[name])


@pytest.mark.parametrize(("rows", "cols"), [(0, 5), (5, 0), (0, 0)])
def test_empty_regions(maps: dict[str, Any], rows: int, cols: int) -> None:
    assert render(maps["inks"].map, 2**60, -(2**60), rows * 0, cols * 0, seed=0).shape == (0, 0, 4)
    assert render(maps["inks"].map, 3, -7, rows, cols, seed=0).shape == (rows, cols, 4)


@pytest.mark.parametrize(
    ("row", "col", "rows", "cols", "match"),
    [
        (COORDINATE_LIMIT + 1, 0, 0, 0, "beyond"),
        (-COORDINATE_LIMIT - 1, 0, 5, 5, "beyond"),
        (0, COORDINATE_LIMIT + 1, 0, 0, "beyond"),
        (0, -COORDINATE_LIMIT - 1, 5, 5, "beyond"),
        (COORDINATE_LIMIT - 4, 0, 5, 5, "beyond"),
        (0, COORDINATE_LIMIT - 4, 5, 5, "beyond"),
        (2**100, 0, 1, 1, "beyond"),
        (0, 0, -1, 5, "-1 rows"),
        (0, 0, 5, -1, "-1 columns"),
    ],
)
def test_regions_out_of_range_are_refused(
    maps: dict[str, Any], row: int, col: int, rows: int, cols: int, match: str
) -> None:
    with pytest.raises(ValueError, match=match):
        render(maps["inks"].map, row, col, rows, cols, seed=0)


def test_the_limit_itself_is_within_range(maps: dict[str, Any]) -> None:
    assert COORDINATE_LIMIT == 2**60
    texture_map = maps["inks"].map
    low = render(texture_map, -(2**60), -(2**60), 5, 5, seed=0)
    high = render(texture_map, 2**60 - 5, 2**60 - 5, 5, 5, seed=0)
    assert_array_equal(low[0, 0], render_points(texture_map, -(2**60), -(2**60), seed=0))
    assert_array_equal(high[4, 4], render_points(texture_map, 2**60 - 1, 2**60 - 1, seed=0))


@pytest.mark.parametrize("seed", [-1, 2**63])
def test_seeds_out_of_range_are_refused(maps: dict[str, Any], seed: int) -> None:
    with pytest.raises(ValueError, match="seed"):
        render(maps["inks"].map, 0, 0, 4, 4, seed=seed)
    with pytest.raises(ValueError, match="seed"):
        render_points(maps["inks"].map, 0, 0, seed=seed)


@pytest.mark.parametrize("threads", [0, -1])
def test_without_threads_there_is_nobody_to_do_it(maps: dict[str, Any], threads: int) -> None:
    with pytest.raises(ValueError, match="threads"):
        render(maps["inks"].map, 0, 0, 4, 4, seed=0, threads=threads)


def read_only() -> NDArray[np.uint8]:
    out = np.zeros((4, 5, 4), dtype=np.uint8)
    out.flags.writeable = False
    return out


@pytest.mark.parametrize(
    "out",
    [
        np.zeros((4, 5, 3), dtype=np.uint8),
        np.zeros((5, 4, 4), dtype=np.uint8),
        np.zeros((4, 5, 4), dtype=np.int8),
        np.zeros((4, 5, 4), dtype=np.uint16),
        np.zeros((4, 10, 4), dtype=np.uint8)[:, ::2],
        np.zeros((4, 5, 4), dtype=np.uint8, order="F"),
        read_only(),
    ],
    ids=["channels", "shape", "sign", "depth", "strided", "fortran", "read-only"],
)
def test_unusable_buffers_are_refused(maps: dict[str, Any], out: NDArray[Any]) -> None:
    with pytest.raises(ValueError, match="out must be"):
        render(maps["inks"].map, 0, 0, 4, 5, seed=0, out=out)


def test_points_of_any_shape(maps: dict[str, Any]) -> None:
    texture_map = maps["inks"].map
    whole = render(texture_map, -5, -6, 20, 30, seed=0)
    grid = render_points(texture_map, np.arange(-5, 15)[:, None], np.arange(-6, 24)[None, :], seed=0)
    assert_array_equal(grid, whole)
    assert_array_equal(render_points(texture_map, -5, -6, seed=0), whole[0, 0])
    assert_array_equal(render_points(texture_map, np.uint8(3), np.int16(4), seed=0), whole[8, 10])
    assert_array_equal(render_points(texture_map, [[1], [2]], [-3], seed=0), whole[6:8, 3:4])
    big = np.arange(2**40, 2**40 + 20, dtype=np.uint64)
    assert_array_equal(render_points(texture_map, big, 7, seed=0), render(texture_map, 2**40, 7, 20, 1, seed=0)[:, 0])


@pytest.mark.parametrize("shape", [(0,), (0, 3), (3, 0)])
def test_no_points(maps: dict[str, Any], shape: tuple[int, ...]) -> None:
    nowhere = np.zeros(shape, dtype=np.int64)
    assert render_points(maps["inks"].map, nowhere, nowhere, seed=0).shape == (*shape, 4)
    assert render_points(maps["inks"].map, [], [], seed=0).shape == (0, 4)


@pytest.mark.parametrize("bad", [0.0, [1.5], [True], "3", [2**60 + 1], [-(2**60) - 1], np.uint64(2**64 - 1)])
def test_points_out_of_range_or_between_pixels_are_refused(maps: dict[str, Any], bad: Any) -> None:
    for rows, cols in ((bad, 0), (0, bad)):
        with pytest.raises(ValueError, match=r"must be integers|beyond"):
            render_points(maps["inks"].map, rows, cols, seed=0)


@pytest.mark.parametrize("side", [(40, 30), (41, 31)])
def test_patches_that_reach_to_the_tips_of_the_rhombus(hand_map: Callable[..., TileMap], side: tuple[int, int]) -> None:
    """One column and one row of pixels as long as the rhombus allows: the most a region has to look around itself."""
    rows, cols = side
    tall = [r for r in range(-rows, 2 * rows) if abs(2 * r + 1 - rows) + 1.5 < 2 * rows - 1]
    wide = [c for c in range(-cols, 2 * cols) if abs(2 * c + 1 - cols) + 1.5 < 2 * cols - 1]
    tall_runs = [[r, 0, 1] for r in range(len(tall))]

    def int32(*values: int) -> NDArray[np.int32]:
        return np.array(values, dtype=np.int32)

    texture_map = hand_map(
        base=np.arange(2 * 90 * 90, dtype=np.uint16).reshape(90, 90, 2),
        tile_source=np.arange(rows * cols, dtype=np.int32).reshape(rows, cols),
        count_a=1,
        cell_row=int32(tall[0], rows // 2),
        cell_col=int32(cols // 2, wide[0]),
        base_row=int32(1, 80),
        base_col=int32(70, 2),
        rows=int32(len(tall), 1),
        cols=int32(1, len(wide)),
        run_offset=np.array([0, len(tall), len(tall) + 1]),
        runs=np.array([*tall_runs, [0, 0, len(wide)]], dtype=np.int32),
        overlaps=np.zeros((2, 2), dtype=bool),
        worst_delta_e=np.zeros(2, dtype=np.float32),
        mean_delta_e=np.zeros(2, dtype=np.float32),
        activation_threshold=2**32 - 1,
    )
    assert min(tall[0], wide[0]) < -14
    whole = render(texture_map, -60, -60, 150, 150, seed=0)
    for k in range(150):
        assert_array_equal(render(texture_map, -60 + k, -60, 1, 150, seed=0)[0], whole[k])
        assert_array_equal(render(texture_map, -60, -60 + k, 150, 1, seed=0)[:, 0], whole[:, k])
    grid = np.arange(-60, 90)
    assert_array_equal(render_points(texture_map, grid[:, None], grid, seed=0), whole)
