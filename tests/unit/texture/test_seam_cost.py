"""Seam cost: by hand, and as the definition has it pair by pair."""

from __future__ import annotations

import doctest
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tilefab.texture import seam_cost as module
from tilefab.texture.seam_cost import SeamCost, seam_cost

SHAPE = (5, 4)


def direct(source: NDArray[np.int32], lab: NDArray[np.float64], toroidal: bool = False) -> tuple[list[float], int]:
    """Costs of all seams and how many can't be measured, from Kwatra et al. 2003, equation 1."""
    rows, cols = lab.shape[:2]

    def inside(place: tuple[int, int]) -> bool:
        return place[0] in range(rows) and place[1] in range(cols)

    costs, unmeasured = [], 0
    for r, c in np.ndindex(source.shape):
        for step in ((0, 1), (1, 0)):
            there = (r + step[0], c + step[1])
            if toroidal:
                there = (there[0] % source.shape[0], there[1] % source.shape[1])
            elif there[0] >= source.shape[0] or there[1] >= source.shape[1]:
                continue
            a_p = divmod(int(source[r, c]), cols)
            b_q = divmod(int(source[there]), cols)
            a_q = (a_p[0] + step[0], a_p[1] + step[1])
            b_p = (b_q[0] - step[0], b_q[1] - step[1])
            if a_q == b_q:
                continue
            sides = [(x, y) for x, y in ((a_p, b_p), (a_q, b_q)) if inside(x) and inside(y)]
            if sides:
                costs.append(sum(math.dist(lab[x], lab[y]) for x, y in sides) / len(sides))
            else:
                unmeasured += 1
    return costs, unmeasured


def some_wall(seed: int) -> NDArray[np.int32]:
    """A wall of small crops, some of them one row or column of the exemplar."""
    random = np.random.default_rng(seed)
    index = np.arange(SHAPE[0] * SHAPE[1], dtype=np.int32).reshape(SHAPE)
    wall = np.zeros((9, 11), dtype=np.int32)
    for r in range(0, 9, 3):
        for c in range(0, 11, 2):
            row, col = random.integers(SHAPE[0] - 2), random.integers(SHAPE[1] - 1)
            there = wall[r : r + 3, c : c + 2]
            there[:] = index[row : row + 3, col : col + 2][:, : there.shape[1]]
    wall[0] = random.integers(index.size, size=11)
    return wall


@given(st.integers(0, 10_000), st.booleans(), st.sampled_from([1, 2, 3, 5]))
def test_every_pair_costs_what_the_definition_says(seed: int, toroidal: bool, channels: int) -> None:
    wall = some_wall(seed)
    lab = np.random.default_rng(seed).uniform(-50, 50, (*SHAPE, channels))
    costs, unmeasured = direct(wall, lab, toroidal)
    result = seam_cost(wall, lab, toroidal=toroidal)
    assert result.worst_delta_e == pytest.approx(max(costs), rel=1e-12)
    assert (result.length_px, result.unmeasured_px) == (len(costs), unmeasured)
    assert result.mean_delta_e == pytest.approx(np.mean(costs), rel=1e-12)
    assert result.p95_delta_e == pytest.approx(np.percentile(costs, 95), rel=1e-12)
    assert result.per_px_area == pytest.approx(sum(costs) / wall.size, rel=1e-12)


def test_an_unbroken_copy_has_no_seam() -> None:
    source = np.arange(20, dtype=np.int32).reshape(SHAPE)
    assert seam_cost(source[1:4, 1:], np.random.default_rng(1).uniform(0, 100, (*SHAPE, 3))) == SeamCost(
        0, 0, 0, 0, 0, 0
    )


def test_a_tile_laid_side_by_side_meets_itself() -> None:
    lab = np.zeros((1, 4, 1))
    lab[0, :, 0] = [1, 2, 40, 8]
    source = np.array([[1, 2]], dtype=np.int32)
    assert seam_cost(source, lab).length_px == 0
    # 40 is followed by 2 instead of 8, which 1 precedes; nothing is known above or below.
    assert seam_cost(source, lab, toroidal=True) == SeamCost(22.5, 22.5, 22.5, 1, 22.5 / 2, 2)


def test_the_next_row_of_the_exemplar_is_no_continuation() -> None:
    # Indices 3 and 4 follow one another, but 3 ends the first row: neither crop goes on.
    lab = np.zeros((*SHAPE, 3))
    assert seam_cost(np.array([[3, 4]], dtype=np.int32), lab) == SeamCost(0.0, 0.0, 0.0, 0, 0.0, 1)


def test_where_one_crop_ends_the_other_side_counts_alone() -> None:
    lab = np.zeros((1, 4, 3))
    lab[0, :, 0] = [1, 2, 40, 8]
    # A = ... 3 ends; B = 2, continued to the left by 1: |A(p) - B(p)| = 8 - 2.
    assert seam_cost(np.array([[3, 2]], dtype=np.int32), lab).mean_delta_e == 6.0
    # B = 0 begins; A = 2 goes on with 3: |A(q) - B(q)| = 8 - 1.
    assert seam_cost(np.array([[2, 0]], dtype=np.int32), lab).mean_delta_e == 7.0


def test_crops_that_agree_across_the_seam_cost_nothing_however_coarse_the_picture() -> None:
    lab = np.zeros((1, 8, 3), dtype=np.float32)
    lab[0, :, 1] = [0, 90, -20, 30, 0, 90, -20, 30]
    source = np.array([[0, 1, 6, 7]], dtype=np.int32)
    assert seam_cost(source, lab) == SeamCost(0.0, 0.0, 0.0, 1, 0.0, 0)


@pytest.mark.parametrize(
    ("source", "lab_shape", "message"),
    [
        (np.array([[0, 20]], dtype=np.int32), (5, 4, 3), "outside"),
        (np.array([[-1, 0]], dtype=np.int32), (5, 4, 3), "outside"),
        (np.array([0, 1], dtype=np.int32), (5, 4, 3), "rows, cols"),
        (np.array([[0, 1]], dtype=np.int32), (5, 4), "channels"),
    ],
)
def test_misuse_is_refused(source: NDArray[np.int32], lab_shape: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        seam_cost(source, np.zeros(lab_shape))


def test_example_in_the_docstring_holds() -> None:
    assert doctest.testmod(module) == (0, 3)
