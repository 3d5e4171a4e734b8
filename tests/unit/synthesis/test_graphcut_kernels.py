"""Cuts of grids: as SciPy cuts them, and for windows as good as the best of all ways to show a patch."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.graphcut_canvas import Exemplar
from tilefab.synthesis.graphcut_flow import grid_cut, grid_cut_plain
from tilefab.synthesis.graphcut_kernels import (
    FREE,
    IGNORE,
    KEEP,
    TAKE,
    UNSET,
    pair_cost,
    window_costs,
    window_costs_plain,
    window_graph,
)

ROWS, COLS = 9, 11


def random_grid(random: np.random.Generator, rows: int, cols: int, high: int) -> tuple[NDArray[np.int64], ...]:
    arcs = np.zeros((4, rows + 2, cols + 2), dtype=np.int64)
    inside = slice(1, -1)
    arcs[0, inside, 1:-2] = random.integers(0, high, (rows, cols - 1))
    arcs[1, inside, 2:-1] = random.integers(0, high, (rows, cols - 1))
    arcs[2, 1:-2, inside] = random.integers(0, high, (rows - 1, cols))
    arcs[3, 2:-1, inside] = random.integers(0, high, (rows - 1, cols))
    ends = np.zeros((rows + 2, cols + 2), dtype=np.int64)
    share = random.choice([0.05, 0.3, 1.0])
    ends[inside, inside] = random.integers(-2 * high, 2 * high, (rows, cols)) * (random.random((rows, cols)) < share)
    return arcs.reshape(4, -1), ends.ravel()


@pytest.mark.parametrize("high", [1, 2, 5, 1000])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (6, 2), (7, 8), (40, 31)])
def test_grids_are_cut_as_scipy_cuts_them(size: tuple[int, int], high: int) -> None:
    random = np.random.default_rng(high)
    for _ in range(12):
        arcs, ends = random_grid(random, *size, high + 1)
        expected = grid_cut_plain(arcs, ends, size[1] + 2)
        assert_array_equal(grid_cut(arcs.copy(), ends.copy(), size[1] + 2), expected)


def made_up(seed: int, channels: int = 3, holes: bool = True) -> Exemplar:
    random = np.random.default_rng(seed)
    valid = random.random((ROWS, COLS)) > (0.1 if holes else -1.0)
    weights = random.integers(0, 256, (ROWS, COLS)).astype(np.uint8)
    base = random.integers(-60, 200, (ROWS, COLS, channels)).astype(np.int16)
    return Exemplar.of(base, valid, weights)


def flat_arguments(exemplar: Exemplar) -> tuple[Any, ...]:
    return COLS, exemplar.colours, exemplar.known, exemplar.gradients, exemplar.floor, exemplar.weights


@pytest.mark.parametrize("channels", [1, 3, 5])
def test_costs_are_those_of_the_plain_twin(channels: int) -> None:
    random = np.random.default_rng(channels)
    exemplar = made_up(channels, channels)
    places = np.flatnonzero(exemplar.valid)
    source = random.choice(places, (20, 17)).astype(np.int32)
    source[random.random(source.shape) < 0.1] = UNSET
    source[5:9, 5:9] = (2 + np.arange(4))[:, None] * COLS + 3 + np.arange(4)
    found = exemplar.costs(source)
    assert_array_equal(found, window_costs_plain(source, *flat_arguments(exemplar)))
    assert found.max() > 0


def test_a_patch_has_no_seam_within() -> None:
    exemplar = made_up(2, holes=False)
    whole = np.arange(ROWS * COLS, dtype=np.int32).reshape(ROWS, COLS)
    assert not exemplar.costs(whole).any()
    # The last pixel of a row isn't followed by the first of the next.
    assert exemplar.costs(np.array([[COLS - 1, COLS]], dtype=np.int32))[0, 0] > 0


def test_a_seam_costs_what_the_equation_says() -> None:
    base = np.zeros((2, 4, 1), dtype=np.int16)
    base[0, :, 0] = 0, 10, 40, 70
    exemplar = Exemplar.of(base, np.ones((2, 4), dtype=bool))
    # Pixel 0 then pixel 2: the first patch would go on with 10 instead of 40, the second came from 10 instead of 0.
    jump = 30**2 + 10**2
    gradient = sum(int(exemplar.gradients[0, k]) for k in (0, 2, 1, 1))
    expected = jump * 16 * exemplar.floor // (gradient + exemplar.floor) + 1
    assert exemplar.costs(np.array([[0, 2]], dtype=np.int32))[0, 0] == expected
    # Nothing follows pixel 3: the other side counts twice.
    gradient = sum(int(exemplar.gradients[0, k]) for k in (3, 1, 3, 0))
    expected = 2 * 70**2 * 16 * exemplar.floor // (gradient + exemplar.floor) + 1
    assert exemplar.costs(np.array([[3, 1]], dtype=np.int32))[0, 0] == expected


def energy_of(
    choice: NDArray[np.bool_],
    labels: NDArray[np.uint8],
    source: NDArray[np.int32],
    place: int,
    prices: NDArray[np.int64],
    exemplar: Exemplar,
) -> int:
    """By the definition: between free pixels an old seam costs no more than both new ones in its place."""
    arguments = flat_arguments(exemplar)[1:]

    def cost(first: int, second: int, down: int) -> int:
        if UNSET in (first, second):
            return 0
        return int(pair_cost(first, second, down, COLS if down else 1, *arguments))

    rows, cols = source.shape
    total = int(prices[choice].sum())
    for r, c, down in product(range(rows), range(cols), (0, 1)):
        r2, c2 = r + down, c + 1 - down
        if r2 >= rows or c2 >= cols:
            continue
        new = [place + r * COLS + c, place + r2 * COLS + c2]
        old = [int(source[r, c]), int(source[r2, c2])]
        if choice[r, c] and choice[r2, c2]:
            continue
        if not choice[r, c] and not choice[r2, c2]:
            price = cost(old[0], old[1], down)
            if labels[r, c] == labels[r2, c2] == FREE:
                price = min(price, cost(new[0], old[1], down) + cost(old[0], new[1], down))
            total += price
        elif choice[r, c]:
            total += cost(new[0], old[1], down)
        else:
            total += cost(old[0], new[1], down)
    return total


@pytest.mark.parametrize("seed", range(10))
def test_a_window_is_cut_as_well_as_can_be(seed: int) -> None:
    random = np.random.default_rng(seed)
    exemplar = made_up(seed, holes=False)
    source = random.integers(0, ROWS * COLS, (3, 4)).astype(np.int32)
    if seed % 2:
        source = np.where(np.arange(4) < 2, 3 * COLS + 5, COLS) + np.arange(3)[:, None] * COLS + np.arange(4)
        source = source.astype(np.int32)
    labels = random.choice([FREE, FREE, FREE, TAKE, KEEP], (3, 4)).astype(np.uint8)
    place = 2 * COLS + 4
    prices = np.where(labels == FREE, random.integers(-4000, 4000, (3, 4)), 0)
    arcs, ends = window_graph(source, labels, place, prices, *flat_arguments(exemplar))
    assert arcs.min() >= 0
    cut = grid_cut(arcs, ends, 6).reshape(5, 6)[1:-1, 1:-1]
    cut = (cut & (labels == FREE)) | (labels == TAKE)
    energies = []
    for bits in product([False, True], repeat=12):
        choice = np.array(bits).reshape(3, 4)
        if choice[labels == TAKE].all() and not choice[labels == KEEP].any():
            energies.append(energy_of(choice, labels, source, place, prices, exemplar))
    assert energy_of(cut, labels, source, place, prices, exemplar) == min(energies)
    assert len(set(energies)) > 1


def test_what_is_ignored_is_cut_from_nothing() -> None:
    exemplar = made_up(3, holes=False)
    source = np.full((3, 3), UNSET, dtype=np.int32)
    source[1, :2] = 40, 12
    labels = np.full((3, 3), IGNORE, dtype=np.uint8)
    labels[1] = KEEP, FREE, TAKE
    arcs, ends = window_graph(source, labels, 13, np.zeros((3, 3), np.int64), *flat_arguments(exemplar))
    there = np.zeros((5, 5), dtype=bool)
    there[2, 2] = True
    assert not arcs[:, ~there.ravel()].any()
    assert not ends[~there.ravel()].any()
    assert window_costs(source, *flat_arguments(exemplar)).sum() > 0
