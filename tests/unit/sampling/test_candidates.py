"""Candidate patches: sizes, places and cuts."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.sampling.candidates import (
    Candidate,
    CandidateFinder,
    _in_rhombus,
    boundary_cost_delta_e,
    choose_places,
    largest_valid_square,
    patch_radii,
)
from tilefab.texture.matching import matching_image


@pytest.mark.parametrize(
    ("tile", "valid_px", "count", "radii"),
    [
        ((1000, 1400), 4000, 5, [50, 78, 122, 191, 300]),
        ((8000, 8000), 9000, 3, [200, 282, 400]),  # never more than 400 px, so the smallest is 200
        ((1000, 1000), 303, 2, [50, 100]),  # bounded by the largest usable square
        ((64, 80), 96, 5, [3, 5, 7, 12, 19]),
        ((12, 12), 100, 5, [3]),
        ((9, 100), 100, 5, []),
        ((100, 100), 11, 5, []),
        ((100, 100), 12, 1, [3]),
    ],
)
def test_radii_go_from_small_to_large(tile: tuple[int, int], valid_px: int, count: int, radii: list[int]) -> None:
    assert patch_radii(tile, valid_px, count) == radii


@given(hnp.arrays(bool, st.tuples(st.integers(1, 9), st.integers(1, 9)), fill=st.just(True)))
def test_largest_valid_square(valid: NDArray[np.bool_]) -> None:
    sides = [
        side
        for side in range(1, min(valid.shape) + 1)
        for r in range(valid.shape[0] - side + 1)
        for c in range(valid.shape[1] - side + 1)
        if valid[r : r + side, c : c + side].all()
    ]
    assert largest_valid_square(valid) == max(sides, default=0)


@given(st.integers(1, 40), st.integers(1, 40))
def test_the_rhombus_is_exact(tile_rows: int, tile_cols: int) -> None:
    rows, cols = np.arange(-tile_rows, 2 * tile_rows), np.arange(-tile_cols, 2 * tile_cols)
    inside = _in_rhombus(rows, cols, tile_rows, tile_cols)
    for i in range(0, len(rows), 3):
        for j in range(0, len(cols), 2):
            down = abs(Fraction(2 * int(rows[i]) + 1, 2 * tile_rows) - Fraction(1, 2))
            right = abs(Fraction(2 * int(cols[j]) + 1, 2 * tile_cols) - Fraction(1, 2))
            assert inside[i, j] == (down + right < 1)


def chosen_by_hand(
    base: NDArray[np.int16],
    tile: NDArray[np.int16],
    tile_source: NDArray[np.int32],
    place: NDArray[np.int64],
    tries: NDArray[np.int64],
    ring: NDArray[np.int64],
    same_px: int,
    max_same: int,
) -> int:
    best, chosen = None, -1
    for j, (row, col) in enumerate(tries.tolist()):
        total = same = 0
        for dr, dc in ring.tolist():
            at = (int(place[0]) + dr) % tile.shape[0], (int(place[1]) + dc) % tile.shape[1]
            origin = divmod(int(tile_source[at]), base.shape[1])
            same += abs(origin[0] - row - dr) < same_px and abs(origin[1] - col - dc) < same_px
            total += int(((base[row + dr, col + dc].astype(int) - tile[at]) ** 2).sum())
        if same <= max_same and (best is None or total < best):
            best, chosen = total, j
    return chosen


@settings(max_examples=40)
@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(0, 3), st.sampled_from([2, 200]))
def test_places_are_chosen_as_by_hand(seed: int, same_px: int, max_same: int, levels: int) -> None:
    random = np.random.default_rng(seed)
    base = random.integers(0, levels, (14, 17, 3)).astype(np.int16)
    tile_source = random.integers(0, 14 * 17, (6, 7)).astype(np.int32)
    tile_source[2:5, 1:5] = np.arange(3)[:, None] * 17 + np.arange(4) + 55  # a piece of stone
    tile = base.reshape(-1, 3)[tile_source]
    places = random.integers(0, 6, (4, 2))
    tries = random.integers(3, 11, (4, 9, 2))
    ring = random.integers(-3, 4, (6, 2))
    result = choose_places(base, tile, tile_source, places, tries, ring, same_px, max_same)
    for i in range(4):
        expected = chosen_by_hand(base, tile, tile_source, places[i], tries[i], ring, same_px, max_same)
        assert result[i] == expected


@pytest.fixture(scope="module", params=["inks", "masked"])
def found(request: pytest.FixtureRequest, maps: dict[str, Any]) -> tuple[Any, CandidateFinder, list[Candidate]]:
    built = maps[request.param]
    finder = CandidateFinder(matching_image(built.lab), built.valid, built.source, 3)
    return built, finder, finder.find(7, 60, threads=1)


def test_candidates_are_single_pieces_around_their_middle(
    found: tuple[Any, CandidateFinder, list[Candidate]],
) -> None:
    built, _, candidates = found
    assert len(candidates) > 30
    for candidate in candidates:
        mask = candidate.mask
        assert ndimage.label(mask)[1] == 1
        assert mask[0].any()
        assert mask[-1].any()
        assert mask[:, 0].any()
        assert mask[:, -1].any()
        # Radius 7: the inner 0.4 is always taken, nothing beyond 1.5.
        assert 3.14 * (0.3 * 7) ** 2 < np.count_nonzero(mask) < 3.15 * (1.6 * 7) ** 2
        assert max(mask.shape) <= 2 * 10 + 1
        rows, cols = mask.shape
        area = (
            slice(candidate.base_row, candidate.base_row + rows),
            slice(candidate.base_col, candidate.base_col + cols),
        )
        assert built.valid[area].all()
        at = np.add(np.argwhere(mask), (candidate.cell_row, candidate.cell_col))
        assert _in_rhombus(at[:, 0], at[:, 1], *built.source.shape).diagonal().all()
        assert candidate.worst_delta_e >= candidate.mean_delta_e >= 0


def test_candidates_differ_from_what_they_replace(found: tuple[Any, CandidateFinder, list[Candidate]]) -> None:
    built, _, candidates = found
    same = total = 0
    for candidate in candidates:
        at = np.argwhere(candidate.mask)
        there = built.source[
            (at[:, 0] + candidate.cell_row) % built.source.shape[0],
            (at[:, 1] + candidate.cell_col) % built.source.shape[1],
        ]
        instead = (at[:, 0] + candidate.base_row) * built.lab.shape[1] + at[:, 1] + candidate.base_col
        same += np.count_nonzero(there == instead)
        total += len(at)
    assert same < 0.02 * total


def test_threads_change_nothing(found: tuple[Any, CandidateFinder, list[Candidate]]) -> None:
    _, finder, candidates = found
    calls: list[int] = []
    again = finder.find(7, 60, threads=3, progress=lambda: calls.append(1))
    assert len(calls) == 60
    assert len(again) == len(candidates)
    for one, other in zip(candidates, again, strict=True):
        assert_array_equal(one.mask, other.mask)
        assert {**one.__dict__, "mask": 0} == {**other.__dict__, "mask": 0}


def test_seeds_give_other_candidates(found: tuple[Any, CandidateFinder, list[Candidate]]) -> None:
    built, _, candidates = found
    other = CandidateFinder(matching_image(built.lab), built.valid, built.source, 4).find(7, 60, threads=1)
    places = {(c.base_row, c.base_col, c.cell_row, c.cell_col) for c in candidates}
    assert not places & {(c.base_row, c.base_col, c.cell_row, c.cell_col) for c in other}


def test_too_large_a_patch_has_no_place(found: tuple[Any, CandidateFinder, list[Candidate]]) -> None:
    assert found[1].find(50, 10, threads=1) == []


def test_boundary_cost_is_in_delta_e() -> None:
    # Squared differences in half units: 4 is a difference of 1, 16 of 2.
    squared = np.array([[4, 16, 36]])
    assert boundary_cost_delta_e(squared, np.array([[True, False, False]])) == (1.5, 1.5)
    assert boundary_cost_delta_e(squared, np.array([[True, False, True]])) == (2.5, 2.0)
