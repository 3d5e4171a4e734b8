"""Which patches a cell shows: kernel and twin agree, no overlap is left, chance is fair and has no memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy import stats

from tilefab.rng import stream_key
from tilefab.sampling.activation import active_patches, active_patches_reference

CELL = st.integers(-(2**63), 2**63 - 1)
KEY = stream_key(11, "activation")


def active(key: int, row: int, col: int, count_a: int, overlaps: NDArray[np.bool_], threshold: int) -> list[int]:
    result, clashes = np.full(len(overlaps), -7, dtype=np.int64), np.full(len(overlaps), 99, dtype=np.int64)
    n = active_patches(np.uint64(key), row, col, count_a, overlaps, np.uint64(threshold), result, clashes)
    return [int(patch) for patch in result[:n]]


@st.composite
def overlap_matrices(draw: st.DrawFn) -> NDArray[np.bool_]:
    n = draw(st.integers(0, 14))
    upper = np.triu(draw(hnp.arrays(bool, (n, n))), 1)
    overlaps: NDArray[np.bool_] = upper | upper.T
    return overlaps


@given(
    st.integers(0, 2**64 - 1),
    CELL,
    CELL,
    overlap_matrices(),
    st.integers(0, 14),
    st.integers(0, 2**32 - 1) | st.just(2**32 - 1),
)
@example(0, -(2**63), -(2**63), np.zeros((5, 5), dtype=bool), 2, 2**32 - 1)
@example(1, 2**63 - 1, 2**63 - 1, np.zeros((5, 5), dtype=bool), 2, 2**31)
@example(2, -(2**63), 2**63 - 1, ~np.eye(9, dtype=bool), 4, 2**32 - 1)
def test_the_kernel_is_its_plain_twin(
    key: int, row: int, col: int, overlaps: NDArray[np.bool_], count_a: int, threshold: int
) -> None:
    count_a = min(count_a, len(overlaps))
    found = active(key, row, col, count_a, overlaps, threshold)
    assert found == active_patches_reference(key, row, col, count_a, overlaps, threshold)
    assert found == sorted(set(found))
    group = range(count_a) if (row + col) % 2 == 0 else range(count_a, len(overlaps))
    assert set(found) <= set(group)
    assert not overlaps[np.ix_(found, found)].any()


@settings(max_examples=60)
@given(CELL, CELL, overlap_matrices())
def test_algorithm_2_as_the_first_seed_tells_it(row: int, col: int, overlaps: NDArray[np.bool_]) -> None:
    """All patches active: while the matrix has a true, find the first row with most, remove it and its column."""
    names, matrix = list(range(len(overlaps))), overlaps.astype(int)
    while matrix.any():
        first = max(range(len(names)), key=lambda k: (matrix[k].sum(), -k))
        matrix = np.delete(np.delete(matrix, first, axis=0), first, axis=1)
        del names[first]
    count_a = len(overlaps) if (row + col) % 2 == 0 else 0
    # The largest threshold leaves out one word in 2**32.
    assert active(int(KEY), row, col, count_a, overlaps, 2**32 - 1) == names


def test_maps_of_cells_near_and_far(built: Any) -> None:
    patches, threshold = built.map.patches, built.map.activation_threshold
    random = np.random.default_rng(1)
    cells = [(r, c) for r in range(-3, 4) for c in range(-3, 4)] + random.integers(-(2**60), 2**60, (30, 2)).tolist()
    most = 0
    for row, col in cells:
        found = active(int(KEY), row, col, patches.count_a, patches.overlaps, threshold)
        assert found == active_patches_reference(int(KEY), row, col, patches.count_a, patches.overlaps, threshold)
        most = max(most, len(found))
    assert most >= 3


@pytest.mark.parametrize("row", [0, 1])
def test_no_threshold_no_patches(row: int) -> None:
    assert active(5, row, 0, 3, np.zeros((7, 7), dtype=bool), 0) == []


def activity(key: np.uint64, rows: NDArray[np.int64], cols: NDArray[np.int64], share: float) -> NDArray[np.float64]:
    """Which of 40 + 40 patches without overlaps are active in each cell, (cells, 40) of 0 and 1."""
    overlaps = np.zeros((80, 80), dtype=bool)
    result = np.zeros((len(rows), 80))
    for i, (row, col) in enumerate(zip(rows.tolist(), cols.tolist(), strict=True)):
        result[i, active(int(key), row, col, 40, overlaps, int(share * 2**32))] = 1.0
    even = (rows + cols) % 2 == 0
    assert not result[even, 40:].any()
    assert not result[~even, :40].any()
    return np.where(even[:, None], result[:, :40], result[:, 40:])


@pytest.fixture(scope="module", params=[0.2, 0.5])
def field(request: pytest.FixtureRequest) -> tuple[float, NDArray[np.float64]]:
    """Activity over 60 x 70 cells around the origin: (60, 70, 40)."""
    row, col = np.indices((60, 70)).reshape(2, -1) - 30
    return request.param, activity(KEY, row, col, request.param).reshape(60, 70, 40)


def test_every_patch_is_active_in_its_share_of_cells(field: tuple[float, NDArray[np.float64]]) -> None:
    share, active_in = field
    row, col = np.indices(active_in.shape[:2])
    for parity in (0, 1):
        cells = active_in[(row + col) % 2 == parity]
        n = len(cells)
        deviation = (cells.sum(axis=0) - n * share) / np.sqrt(n * share * (1 - share))
        # Fixed streams: these bounds are met or not, for good. Two-sided, one in a hundred thousand.
        chi_square = float((deviation**2).sum())
        assert stats.chi2.ppf(5e-6, 40) < chi_square < stats.chi2.isf(5e-6, 40)
        assert np.abs(deviation).max() < 4.5
        per_cell = cells.sum(axis=1)
        assert abs(per_cell.var() / (40 * share * (1 - share)) - 1) < 5 * np.sqrt(2 / n)


@pytest.mark.parametrize("shift", [(0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0), (0, 32), (16, 16)])
def test_neighbouring_cells_know_nothing_of_each_other(
    field: tuple[float, NDArray[np.float64]], shift: tuple[int, int]
) -> None:
    share, active_in = field
    dr, dc = shift
    centred = (active_in - share) / np.sqrt(share * (1 - share))
    rows, cols = centred.shape[:2]
    here = centred[: rows - dr, max(0, -dc) : cols - max(0, dc)]
    there = centred[dr:, max(0, dc) : cols - max(0, -dc)]
    product = (here * there).reshape(-1, 40)
    n = len(product)
    assert abs(product.mean()) < 4.5 / np.sqrt(n * 40)
    assert np.abs(product.mean(axis=0)).max() < 5 / np.sqrt(n)


def test_patches_of_a_cell_know_nothing_of_each_other(field: tuple[float, NDArray[np.float64]]) -> None:
    _, active_in = field
    cells = active_in.reshape(-1, 40)
    correlation = np.corrcoef(cells.T) - np.eye(40)
    assert np.abs(correlation).max() < 5 / np.sqrt(len(cells))


@pytest.mark.parametrize("other", [12, 11 + 2**32, 11 + 2**62])
def test_seeds_know_nothing_of_each_other(other: int) -> None:
    row, col = np.indices((40, 40)).reshape(2, -1)
    first = 2 * activity(KEY, row, col, 0.5) - 1
    second = 2 * activity(stream_key(other, "activation"), row, col, 0.5) - 1
    assert abs((first * second).mean()) < 4.5 / np.sqrt(first.size)


@pytest.mark.parametrize("far", [2**31, 2**32, 2**53, 2**59])
def test_far_cells_are_not_near_ones_again(far: int) -> None:
    row, col = np.indices((30, 30)).reshape(2, -1)
    near = 2 * activity(KEY, row, col, 0.5) - 1
    for dr, dc in ((far, 0), (0, far), (-far, 0), (0, -far)):
        there = 2 * activity(KEY, row + dr, col + dc, 0.5) - 1
        assert abs((near * there).mean()) < 4.5 / np.sqrt(near.size)
    # Nor does the plane mirror or transpose itself.
    across = 2 * activity(KEY, col, row, 0.5) - 1
    assert abs((near * across)[row < col].mean()) < 4.5 / np.sqrt(near[row < col].size)
