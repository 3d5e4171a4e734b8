"""Repetition: counted by hand and by brute force; the lattice's ghost against crops really drawn."""

from __future__ import annotations

import doctest
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.texture import repetition
from tilefab.texture.repetition import (
    Verbatim,
    gather_cells,
    lattice_ghost,
    static_share,
    usage,
    verbatim,
)


def index_map(rows: int, cols: int) -> NDArray[np.int32]:
    return np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)


def patched_wall(seed: int, shape: tuple[int, int], rows: int, cols: int) -> NDArray[np.int32]:
    """A wall onto which crops of all sizes have been laid, one over the other."""
    random = np.random.default_rng(seed)
    index = index_map(*shape)
    wall = random.integers(index.size, size=(rows, cols)).astype(np.int32)
    for _ in range(30):
        height, width = random.integers(1, shape[0] + 1), random.integers(1, shape[1] + 1)
        row, col = random.integers(shape[0] - height + 1), random.integers(shape[1] - width + 1)
        r, c = random.integers(rows - height + 1), random.integers(cols - width + 1)
        wall[r : r + height, c : c + width] = index[row : row + height, col : col + width]
    return wall


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from([(8, 12), (9, 7), (1, 9)]), st.sampled_from([1 / 16, 1 / 4, 0.5, 1.0]))
def test_chunks_are_counted_as_by_looking_at_every_window(seed: int, shape: tuple[int, int], share: float) -> None:
    wall = patched_wall(seed, shape, 20, 23)
    rows, cols = (max(1, round(n * share**0.5)) for n in shape)
    chunks = np.lib.stride_tricks.sliding_window_view(index_map(*shape), (rows, cols)).reshape(-1, rows, cols)
    windows = np.lib.stride_tricks.sliding_window_view(wall, (rows, cols)).reshape(-1, rows * cols)
    found = Counter(map(bytes, np.ascontiguousarray(windows)))
    counts = np.array([found[np.ascontiguousarray(chunk).tobytes()] for chunk in chunks])
    per_area = wall.size / (shape[0] * shape[1])
    result = verbatim(wall, shape, share)
    assert result.mean == pytest.approx(counts.mean() / per_area, rel=1e-12)
    assert result.most == pytest.approx(counts.max() / per_area, rel=1e-12)
    # Only the chunks in the right half.
    valid = np.zeros(shape, dtype=bool)
    valid[:, shape[1] // 2 :] = True
    whole = np.array([valid.ravel()[chunk].all() for chunk in chunks])
    expected = counts[whole].mean() / per_area if whole.any() else 0.0
    assert verbatim(wall, shape, share, valid).mean == pytest.approx(expected, rel=1e-12)


def test_one_chunk_shown_three_times_in_a_wall_of_four_exemplars() -> None:
    wall = np.full((16, 16), 9, dtype=np.int32)
    chunk = index_map(8, 8)[2:4, 5:7]
    for r, c in ((0, 0), (5, 9), (14, 14)):
        wall[r : r + 2, c : c + 2] = chunk
    # 49 places of a chunk of 2 x 2, one of them shown.
    result = verbatim(wall, (8, 8))
    assert result.mean == pytest.approx(3 / 4 / 49, rel=1e-12)
    assert result.most == 3 / 4


def test_a_chunk_may_not_run_over_the_exemplars_edge() -> None:
    # 7 and 8 follow one another, but the first ends a row of the exemplar.
    wall = np.array([[7, 8], [15, 16]], dtype=np.int32)
    assert verbatim(wall, (8, 8)) == Verbatim(0.0, 0.0)


def test_usage_by_hand() -> None:
    wall = np.array([[0, 0, 0, 5], [0, 1, 5, 4]], dtype=np.int32)
    used = usage(wall, (2, 3))
    assert_array_equal(used.count, [[4, 1, 0], [0, 1, 2]])
    assert (used.coverage, used.most_over_mean, used.coverage_10x10) == (4 / 6, 4 / (8 / 6), None)
    valid = np.array([[False, True, True], [True, True, True]])
    used = usage(wall, (2, 3), valid)
    assert_array_equal(used.count, [[4, 1, 0], [0, 1, 2]])
    assert (used.coverage, used.most_over_mean) == (3 / 5, 2 / (4 / 5))


def test_coverage_of_ten_by_ten_is_the_mean_over_windows_of_that_size() -> None:
    # 2 x 2 exemplars: windows of 20 x 20. The first shows one pixel, the second all four; what's left over nothing.
    wall = np.zeros((25, 45), dtype=np.int32)
    wall[:2, 20:22] = [[0, 1], [2, 3]]
    wall[:20, 40:] = 3
    used = usage(wall, (2, 2))
    assert used.coverage == 1.0
    assert used.coverage_10x10 == (1 / 4 + 1) / 2


def test_a_wall_of_invalid_pixels_only() -> None:
    used = usage(np.zeros((2, 2), dtype=np.int32), (1, 2), np.array([[False, True]]))
    assert (used.coverage, used.most_over_mean) == (0.0, 1.0)


def test_cells_are_gathered_in_reading_order() -> None:
    wall = index_map(7, 9)
    cells = gather_cells(wall, (2, 3), (1, 2))
    assert_array_equal(cells[:, 0, 0], [11, 14, 29, 32, 47, 50])
    assert_array_equal(cells[1], [[14, 15, 16], [23, 24, 25]])
    colours = np.stack([wall, -wall], axis=2)
    assert_array_equal(gather_cells(colours, (2, 3), (1, 2))[..., 1], -cells)
    assert gather_cells(wall, 3).shape == (6, 3, 3)


@given(st.integers(0, 10_000), st.integers(1, 9))
def test_static_share_is_that_of_counting(seed: int, n_cells: int) -> None:
    cells = np.random.default_rng(seed).integers(0, 3, (n_cells, 4, 5)).astype(np.int32)
    most = np.stack([(cells == value).sum(axis=0) for value in range(3)]).max(axis=0)
    assert static_share(cells) == np.mean(most > n_cells / 2)


def test_half_of_all_cells_is_not_static() -> None:
    cells = np.array([1, 1, 2, 3], dtype=np.int32).reshape(4, 1, 1)
    assert static_share(cells) == 0.0
    cells[2] = 1
    assert static_share(cells) == 1.0


def slow_picture(seed: int) -> NDArray[np.float64]:
    """A random picture with features some pixels wide, and brighter to the right."""
    noise = np.random.default_rng(seed).normal(0, 10, (12, 15, 3)).repeat(3, axis=0).repeat(3, axis=1)
    return noise + np.arange(45)[:, None]


def random_crops(picture: NDArray[np.float64], count: int, side: int, seed: int) -> NDArray[np.float64]:
    random = np.random.default_rng(seed)
    rows = random.integers(picture.shape[0] - side + 1, size=count)
    cols = random.integers(picture.shape[1] - side + 1, size=count)
    return np.stack([picture[r : r + side, c : c + side] for r, c in zip(rows, cols, strict=True)])


@pytest.mark.parametrize("count", [1, 7, 200])
def test_random_crops_leave_no_ghost(count: int) -> None:
    picture = slow_picture(1)
    ghosts = [lattice_ghost(random_crops(picture, count, 14, seed), picture) for seed in range(400)]
    error = float(np.std(ghosts)) / 20
    assert error < 0.05
    assert np.mean(ghosts) == pytest.approx(1.0, abs=4 * error)


def test_cells_that_all_show_the_same_leave_a_ghost_as_strong_as_they_are_many() -> None:
    picture = np.random.default_rng(2).normal(50, 10, (200, 200))
    cell = picture[30:60, 70:100]
    ghost = lattice_ghost(np.repeat(cell[None], 50, axis=0), picture)
    assert 40 < ghost < 55


def test_a_wall_of_one_colour_has_no_ghost() -> None:
    picture = np.full((9, 9, 3), 41.3, dtype=np.float32)
    assert lattice_ghost(np.full((5, 4, 4, 3), 41.3, dtype=np.float32), picture) == 1.0


@pytest.mark.parametrize(
    ("wall", "message"), [([[0, 4]], "outside"), ([[-1, 0]], "outside"), ([0, 1], "rows, cols"), ([[]], "empty")]
)
def test_maps_that_are_none_are_refused(wall: list[object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        usage(np.array(wall, dtype=np.int32), (2, 2))
    with pytest.raises(ValueError, match=message):
        verbatim(np.array(wall, dtype=np.int32), (2, 2))


def test_misuse_is_refused() -> None:
    wall, mask = index_map(2, 2), np.zeros((2, 2), dtype=bool)
    with pytest.raises(ValueError, match="no pixel"):
        usage(wall, (2, 2), mask)
    with pytest.raises(ValueError, match="differ in shape"):
        usage(wall, (2, 2), mask[:1])
    with pytest.raises(ValueError, match="differ in shape"):
        verbatim(wall, (2, 2), valid=mask[:1])
    with pytest.raises(ValueError, match="a chunk"):
        verbatim(wall, (2, 2), 0.0)
    with pytest.raises(ValueError, match="no lattice"):
        gather_cells(wall, 0)
    with pytest.raises(ValueError, match="fits"):
        gather_cells(wall, 2, (1, 0))
    with pytest.raises(ValueError, match="not empty"):
        static_share(wall)
    with pytest.raises(ValueError, match="don't match"):
        lattice_ghost(np.zeros((2, 3, 3)), np.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="channels"):
        lattice_ghost(np.zeros((2, 3, 3, 2)), np.zeros((4, 4, 3)))
    with pytest.raises(ValueError, match="larger"):
        lattice_ghost(np.zeros((2, 5, 3)), np.zeros((4, 4)))


def test_examples_in_the_docstrings_hold() -> None:
    assert doctest.testmod(repetition) == (0, 4)
