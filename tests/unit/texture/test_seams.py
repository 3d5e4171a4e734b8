"""Minimum cuts: exactly minimal, forced labels kept, coarse to fine hardly worse."""

from __future__ import annotations

import doctest
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.texture import seams
from tilefab.texture.seams import FREE, KEEP, TAKE, boundary_cost, cut


def energy(cost: NDArray[np.int64], masks: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Cost of one or more labellings (..., rows, cols), from the definition in the docstring."""
    across = (cost[:, :-1] + cost[:, 1:] + 1) * (masks[..., :, :-1] != masks[..., :, 1:])
    down = (cost[:-1] + cost[1:] + 1) * (masks[..., :-1, :] != masks[..., 1:, :])
    total: NDArray[np.int64] = across.sum(axis=(-2, -1)) + down.sum(axis=(-2, -1))
    return total


@cache
def labellings(rows: int, cols: int) -> NDArray[np.bool_]:
    numbers = np.arange(1 << (rows * cols))[:, None]
    return (numbers >> np.arange(rows * cols) & 1).astype(bool).reshape(-1, rows, cols)


def check_against_all_labellings(cost: NDArray[np.int64], labels: NDArray[np.uint8]) -> None:
    masks = labellings(*cost.shape)
    allowed = masks[(masks | (labels != TAKE)).all(axis=(1, 2)) & ~(masks & (labels == KEEP)).any(axis=(1, 2))]
    energies = energy(cost, allowed)
    taken = cut(cost, labels)
    assert taken.dtype == bool
    assert int(energy(cost, taken)) == int(energies.min())
    # Of all minimal cuts, the one that takes least: that there is one such is a property of minimum cuts, and it
    # makes the result unique.
    assert_array_equal(taken, allowed[energies == energies.min()].all(axis=0))


@settings(max_examples=150)
@given(st.data())
def test_a_cut_is_the_best_of_all_labellings(data: st.DataObject) -> None:
    shape = data.draw(st.sampled_from([(3, 4), (4, 3), (2, 6), (1, 9), (3, 3)]))
    high = data.draw(st.sampled_from([1, 6, 1000]))
    cost = data.draw(hnp.arrays(np.int64, shape, elements=st.integers(0, high)))
    labels = data.draw(hnp.arrays(np.uint8, shape, elements=st.sampled_from([FREE, FREE, FREE, TAKE, KEEP])))
    check_against_all_labellings(cost, labels)


@pytest.mark.parametrize("seed", range(12))
def test_a_cut_of_a_larger_grid_is_the_best_of_all_labellings(seed: int) -> None:
    random = np.random.default_rng(seed)
    labels = np.full((3, 5), FREE, dtype=np.uint8)
    labels[0, 0], labels[-1, -1], labels[seed % 3, 4 - seed % 2] = TAKE, KEEP, KEEP
    check_against_all_labellings(random.integers(0, 30, (3, 5)), labels)


@pytest.mark.parametrize("label", [FREE, TAKE, KEEP])
def test_without_the_other_side_there_is_nothing_to_cut(label: int) -> None:
    labels = np.full((5, 7), FREE, dtype=np.uint8)
    labels[2, 3] = label
    assert_array_equal(cut(np.ones((5, 7), dtype=np.int64), labels), np.full((5, 7), label == TAKE))


def test_all_forced() -> None:
    labels = np.where(np.indices((4, 4)).sum(axis=0) % 2 == 0, TAKE, KEEP).astype(np.uint8)
    assert_array_equal(cut(np.full((4, 4), 2**20), labels), labels == TAKE)


def test_costs_are_clipped() -> None:
    labels = np.array([[TAKE, FREE, FREE, FREE, KEEP]], dtype=np.uint8)
    # Clipped, both ways round cost the same, and the smaller set is taken; unclipped, the left one would be dearer.
    cost = np.array([[2**40, 2**40, 2**20, 2**20, 2**20]])
    assert_array_equal(cut(cost, labels), [[True, False, False, False, False]])
    cost = np.array([[-5, -5, -9, 0, 0]])
    assert_array_equal(cut(cost, labels), [[True, False, False, False, False]])


def test_of_equal_costs_the_shorter_cut_wins() -> None:
    labels = np.full((7, 9), FREE, dtype=np.uint8)
    labels[:, 0], labels[:, -1], labels[1:6, 1:3] = TAKE, KEEP, TAKE
    taken = cut(np.zeros((7, 9), dtype=np.int64), labels)
    assert int(energy(np.zeros((7, 9), dtype=np.int64), taken)) == 7


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError, match="differ in shape"):
        cut(np.zeros((3, 4), dtype=np.int64), np.zeros((4, 3), dtype=np.uint8))


def rough(seed: int) -> NDArray[np.int64]:
    return np.random.default_rng(seed).integers(0, 2000, (113, 121))


def veined(seed: int) -> NDArray[np.int64]:
    random = np.random.default_rng(seed)
    slow = random.integers(0, 400, (15, 16)).repeat(8, axis=0).repeat(8, axis=1)[:113, :121]
    return slow + random.integers(0, 60, (113, 121))


def ring_labels(seed: int) -> NDArray[np.uint8]:
    row, col = np.indices((113, 121))
    distance = (row - 56) ** 2 + (col - 60) ** 2
    labels = np.full((113, 121), FREE, dtype=np.uint8)
    labels[distance < 12**2], labels[distance > 54**2] = TAKE, KEEP
    return labels


def scattered_labels(seed: int) -> NDArray[np.uint8]:
    random = np.random.default_rng(1000 + seed)
    labels = np.full((113, 121), FREE, dtype=np.uint8)
    labels[:, 0], labels[:, -1] = TAKE, KEEP
    labels[random.integers(0, 113, 15), random.integers(5, 60, 15)] = TAKE
    labels[random.integers(0, 113, 15), random.integers(61, 116, 15)] = KEEP
    return labels


def rim_labels(seed: int) -> NDArray[np.uint8]:
    """As in quilting: a rim one pixel wide must stay, the middle must be taken."""
    labels = np.full((113, 121), KEEP, dtype=np.uint8)
    labels[1:-1, 1:-1] = FREE
    labels[55:57, 59 + seed : 61 + seed] = TAKE
    return labels


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("make_labels", [ring_labels, scattered_labels, rim_labels])
@pytest.mark.parametrize(("make_cost", "bound"), [(rough, 1.06), (veined, 1.12)])
def test_coarse_to_fine_is_hardly_worse_than_direct(
    make_cost: Callable[[int], NDArray[np.int64]],
    bound: float,
    make_labels: Callable[[int], NDArray[np.uint8]],
    seed: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cost, labels = make_cost(seed), make_labels(seed)
    assert np.count_nonzero(labels == FREE) > seams._DIRECT_AREA_PX
    banded = cut(cost, labels)
    assert banded[labels == TAKE].all()
    assert not banded[labels == KEEP].any()
    monkeypatch.setattr(seams, "_DIRECT_AREA_PX", 10**9)
    direct = cut(cost, labels)
    best, found = int(energy(cost, direct)), int(energy(cost, banded))
    assert best > 0
    assert best <= found <= bound * best


def test_areas_up_to_the_limit_and_narrow_ones_are_cut_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    cost, labels = rough(5)[:7], scattered_labels(5)[:7]
    monkeypatch.setattr(seams, "_DIRECT_AREA_PX", 10)
    narrow = cut(cost, labels)
    monkeypatch.setattr(seams, "_DIRECT_AREA_PX", 10**9)
    assert_array_equal(narrow, cut(cost, labels))


def test_boundary_cost_by_hand() -> None:
    cost = np.array([[1.0, 5.0, 9.0], [2.0, 4.0, 8.0]])
    mask = np.array([[True, False, False], [True, True, False]])
    # Pairs across the cut: (1, 5), (5, 4) and (4, 8).
    assert boundary_cost(cost, mask) == (6.0, pytest.approx((3.0 + 4.5 + 6.0) / 3, rel=1e-15))


@pytest.mark.parametrize("inside", [True, False])
def test_without_boundary_there_is_no_cost(inside: bool) -> None:
    assert boundary_cost(np.ones((3, 3)), np.full((3, 3), inside)) == (0.0, 0.0)


@given(st.data())
def test_boundary_cost_is_that_of_all_pairs(data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 6), st.integers(1, 6)))
    cost = data.draw(hnp.arrays(np.int64, shape, elements=st.integers(0, 100)))
    mask = data.draw(hnp.arrays(bool, shape))
    pairs = []
    for r in range(shape[0]):
        for c in range(shape[1]):
            for r2, c2 in ((r + 1, c), (r, c + 1)):
                if r2 < shape[0] and c2 < shape[1] and mask[r, c] != mask[r2, c2]:
                    pairs.append((int(cost[r, c]) + int(cost[r2, c2])) / 2)
    worst, mean = boundary_cost(cost, mask)
    assert worst == max(pairs, default=0.0)
    assert mean == pytest.approx(sum(pairs) / len(pairs) if pairs else 0.0, rel=1e-12)


def test_example_in_the_docstring_holds() -> None:
    assert doctest.testmod(seams) == (0, 3)
