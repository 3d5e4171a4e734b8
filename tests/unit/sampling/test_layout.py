"""Where faces lie: no two share a cell, successive ones show well-separated shifts, walls join exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tilefab.rng import random_words, stream_key
from tilefab.sampling import PlaneLayout, Region, render
from tilefab.sampling.render import COORDINATE_LIMIT

INDEX = st.integers(0, 2**40 - 1)
SEED = st.integers(0, 2**63 - 1)


def scatter(
    seed: int = 5,
    face: tuple[int, int] = (190, 260),
    bleed: int = 4,
    tile: tuple[int, int] = (64, 80),
) -> PlaneLayout:
    return PlaneLayout("scatter", seed, *face, bleed, *tile)


def wall(columns: int, bleed: int = 6, face: tuple[int, int] = (70, 90)) -> PlaneLayout:
    return PlaneLayout("continuous", 5, *face, bleed, 64, 80, columns)


@given(SEED, INDEX)
def test_slots_are_one_to_one(seed: int, index: int) -> None:
    """The slot is enough to find the index again: run the Feistel network backwards."""
    slot_row, slot_col = scatter(seed)._slot(index)
    assert -(2**19) <= slot_row < 2**19
    assert -(2**19) <= slot_col < 2**19
    left, right, key = slot_row + 2**19, slot_col + 2**19, stream_key(seed, "slot")
    for round_number in reversed(range(6)):
        word, _ = random_words(key, round_number << 20 | left)
        left, right = right ^ (word & 0xFFFFF), left
    assert left << 20 | right == index


def test_many_slots_differ_and_are_spread_over_the_lattice() -> None:
    layout = scatter()
    slots = np.array([layout._slot(index) for index in range(4000)])
    assert len(np.unique(slots, axis=0)) == 4000
    # Sixteen parts of the lattice, 250 faces each on average: within five standard deviations.
    counts = np.histogram2d(slots[:, 0], slots[:, 1], bins=4, range=[(-(2**19), 2**19)] * 2)[0]
    assert np.abs(counts - 250).max() < 5 * np.sqrt(250)


def cells_of(region: Region, tile_rows: int, tile_cols: int) -> set[tuple[int, int]]:
    return {
        (r, c)
        for r in range(region.row // tile_rows, (region.row + region.rows - 1) // tile_rows + 1)
        for c in range(region.col // tile_cols, (region.col + region.cols - 1) // tile_cols + 1)
    }


@pytest.mark.parametrize("tile", [(64, 80), (198, 268), (500, 33), (1, 1)])
def test_no_cell_serves_two_faces_wherever_they_lie(tile: tuple[int, int]) -> None:
    """As slots are one-to-one, it's enough that a face never leaves its own, at any phase."""
    face = (190, 260) if tile != (1, 1) else (3, 2)
    layout = scatter(face=face, tile=tile)
    rows, cols = face[0] + 8, face[1] + 8
    pitch = [(-(-n // t) + 1) for n, t in zip((rows, cols), tile, strict=True)]
    for index in (*range(1500), 2**40 - 1, 2**39, 2**20, 2**20 - 1):
        region = layout.face(index)
        slot = layout._slot(index)
        for cell in cells_of(region, *tile):
            assert (cell[0] // pitch[0], cell[1] // pitch[1]) == slot


def test_no_two_of_many_faces_share_a_cell() -> None:
    layout, taken = scatter(), {}
    for index in (*range(3000), *range(2**40 - 500, 2**40)):
        for cell in cells_of(layout.face(index), 64, 80):
            assert taken.setdefault(cell, index) == index
    assert len(taken) > 3500 * 4 * 4 * 0.9


@pytest.mark.parametrize(("cell", "reach"), [((64, 80), 20), ((64, 80), 32), ((198, 268), 99), ((9, 9), 4)])
def test_no_cell_that_reaches_beyond_itself_shows_on_two_faces(cell: tuple[int, int], reach: int) -> None:
    layout = PlaneLayout("scatter", 5, 190, 260, 4, *cell, reach_px=reach)
    taken: dict[tuple[int, int], int] = {}
    pitch = [-(-(n + 2 * reach) // c) + 1 for n, c in zip((198, 268), cell, strict=True)]
    for index in (*range(1500), 2**40 - 1, 2**20):
        face = layout.face(index)
        visible = Region(face.row - reach, face.col - reach, face.rows + 2 * reach, face.cols + 2 * reach)
        slot = layout._slot(index)
        for at in cells_of(visible, *cell):
            assert (at[0] // pitch[0], at[1] // pitch[1]) == slot
            assert taken.setdefault(at, index) == index


def test_a_reach_is_not_negative() -> None:
    with pytest.raises(ValueError, match="reach"):
        PlaneLayout("scatter", 5, 190, 260, 4, 64, 80, reach_px=-1)


@pytest.mark.parametrize("seed", [0, 5, 2**63 - 1])
@pytest.mark.parametrize("first", [0, 2**40 - 2000])
def test_successive_faces_show_well_separated_shifts(seed: int, first: int) -> None:
    """Any 8 successive faces are at least 0.27 of a tile apart, around the torus (8 on a grid: 0.35 at most)."""
    layout = scatter(seed, tile=(1000, 1400))
    regions = [layout.face(first + k) for k in range(2000)]
    phases = np.array([(region.row % 1000 / 1000, region.col % 1400 / 1400) for region in regions])
    for apart in range(1, 8):
        distance = np.abs(phases[apart:] - phases[:-apart])
        distance = np.minimum(distance, 1 - distance)
        assert np.hypot(distance[:, 0], distance[:, 1]).min() > 0.269
    counts = np.histogram2d(phases[:, 0], phases[:, 1], bins=5, range=[(0, 1)] * 2)[0]
    assert np.abs(counts - 80).max() <= 8  # far more even than chance: that would give 80 ± 27


def test_seeds_shift_the_phases() -> None:
    faces = [scatter(seed).face(0) for seed in range(40)]
    assert len({(face.row % 64, face.col % 80) for face in faces}) > 35
    assert len({(face.row, face.col) for face in faces}) == 40


@given(SEED, INDEX, st.integers(1, 20000), st.integers(1, 20000), st.integers(0, 200), st.integers(1, 9000))
def test_every_face_is_within_the_plane(seed: int, index: int, rows: int, cols: int, bleed: int, tile: int) -> None:
    region = PlaneLayout("scatter", seed, rows, cols, bleed, tile, tile).face(index)
    assert (region.rows, region.cols) == (rows + 2 * bleed, cols + 2 * bleed)
    for corner in (region.row, region.col, region.row + region.rows, region.col + region.cols):
        assert abs(corner) <= COORDINATE_LIMIT


@pytest.mark.parametrize(
    ("index", "region"),
    [
        (0, (122735050, -126114747, 198, 268)),
        (1, (-53284741, -27160382, 198, 268)),
        (2, (-88471317, 138020064, 198, 268)),
        (1000, (-90139197, -65882360, 198, 268)),
        (1048576, (-88017871, -173751959, 198, 268)),
        (1099511627775, (-167704636, 46706857, 198, 268)),
    ],
)
def test_faces_are_pinned(index: int, region: tuple[int, int, int, int]) -> None:
    assert scatter().face(index) == Region(*region)


@pytest.mark.parametrize("layout", [scatter(), wall(3)])
@pytest.mark.parametrize("index", [-1, 2**40, 2**64])
def test_faces_out_of_range_are_refused(layout: PlaneLayout, index: int) -> None:
    with pytest.raises(ValueError, match="outside"):
        layout.face(index)


def test_faces_of_a_wall_lie_in_reading_order() -> None:
    layout = wall(3)
    assert layout.face(0) == Region(-6, -6, 82, 102)
    assert layout.face(1) == Region(-6, 84, 82, 102)
    assert layout.face(3) == Region(64, -6, 82, 102)
    assert layout.face(7) == Region(134, 84, 82, 102)
    assert wall(1).face(2**40 - 1) == Region((2**40 - 1) * 70 - 6, -6, 82, 102)


@pytest.mark.parametrize("bleed", [0, 1, 9])
def test_faces_of_a_wall_join_exactly(maps: dict[str, Any], bleed: int) -> None:
    texture_map, layout = maps["inks"].map, wall(3, bleed)

    def face(index: int) -> Any:
        region = layout.face(index)
        return render(texture_map, region.row, region.col, region.rows, region.cols, seed=layout.seed)

    whole = render(texture_map, 0, 0, 3 * 70, 3 * 90, seed=layout.seed)
    overlap = 2 * bleed
    for index in range(9):
        here = face(index)
        row, col = divmod(index, 3)
        inside = here[bleed : bleed + 70, bleed : bleed + 90]
        assert_array_equal(inside, whole[row * 70 : row * 70 + 70, col * 90 : col * 90 + 90])
        if overlap and col < 2:
            assert_array_equal(here[:, -overlap:], face(index + 1)[:, :overlap])
        if overlap and row < 2:
            assert_array_equal(here[-overlap:], face(index + 3)[:overlap])


def test_patches_cross_the_joints_of_a_wall(maps: dict[str, Any]) -> None:
    """Were faces of a wall rendered each for itself, the joints would show: stone runs on across them."""
    texture_map = maps["inks"].map
    base = np.arange(texture_map.base[..., 0].size, dtype=np.int32).reshape(*texture_map.base.shape[:2], 1)
    where = render(texture_map.with_base(base, "index", ("i",)), 0, 0, 700, 900, seed=5)[..., 0]
    runs_on = where[:, 1:] == where[:, :-1] + 1
    joints = runs_on[:, 89:899:90].mean()
    assert joints > 0.75
    assert abs(joints - runs_on.mean()) < 0.08
