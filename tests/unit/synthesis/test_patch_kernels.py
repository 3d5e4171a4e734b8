"""Searching patches: as good as looking everywhere, never better, nowhere forbidden, in bands or at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.jit import SQUARED_LANES
from tilefab.synthesis.patch_kernels import (
    _MOST_COPIES,
    CHANNELS,
    PATCH_PX,
    again_price,
    count_shifts,
    patch_difference,
    search,
    search_plain,
)
from tilefab.synthesis.usage import NO_SHIFTS, Shifts

FAR = 1 << 60


def smooth(rows: int, cols: int, seed: int) -> NDArray[np.int16]:
    """A picture in which patches near a good one are good too, (rows, cols, 4)."""
    random = np.random.default_rng(seed)
    waves = np.zeros((rows, cols, CHANNELS))
    row, col = np.arange(rows)[:, None], np.arange(cols)
    for channel in range(CHANNELS):
        for _ in range(6):
            down, right, phase = random.uniform(-0.5, 0.5), random.uniform(-0.5, 0.5), random.uniform(0, 7)
            waves[..., channel] += np.rint(90 * np.sin(down * row + right * col + phase))
    return waves.astype(np.int16)


@dataclass(frozen=True, eq=False)
class Hunt:
    """All that a search is told."""

    target: NDArray[np.int16]
    rows_px: NDArray[np.int64]
    cols_px: NDArray[np.int64]
    period: tuple[int, int]
    exemplar: NDArray[np.int16]
    allowed: NDArray[np.bool_]
    price: NDArray[np.int64]
    crowd: NDArray[np.int64]
    most: int = 1 << 40
    shifts: Shifts = NO_SHIFTS

    def step(
        self, field: NDArray[np.int32], key: int, colour: int, tries: int, edges: list[int]
    ) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """One colour, band by band."""
        found, cost = field.copy(), np.zeros(field.shape, dtype=np.int64)
        paid = self.shifts
        for begin, end in pairwise(edges):
            search(
                self.target.reshape(-1), self.target.shape[1], self.rows_px, self.cols_px, self.period,
                self.exemplar.reshape(-1), self.exemplar.shape[1], self.allowed.reshape(-1), self.price.reshape(-1),
                self.crowd.reshape(-1), self.most, paid.starts, paid.order, paid.price, field, found, cost,
                colour, begin, end, np.uint64(key), tries,
            )  # fmt: skip
        return found, cost

    def run(self, field: NDArray[np.int32], passes: int, tries: int) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Passes over both colours; the places and what each was found to differ by."""
        cost = np.zeros(field.shape, dtype=np.int64)
        for number in range(passes):
            cost[:] = 0
            for colour in (0, 1):
                field, told = self.step(field, 977 * number + colour + 1, colour, tries, [0, len(self.rows_px)])
                cost += told
        return field, cost

    def somewhere(self, seed: int) -> NDArray[np.int32]:
        """Random places that are allowed."""
        places = np.flatnonzero(self.allowed)
        shape = (len(self.rows_px), len(self.cols_px))
        return np.random.default_rng(seed).choice(places, shape).astype(np.int32)


def made_up(seed: int, *, toroidal: bool = False, stride: int = 1, priced: bool = True) -> Hunt:
    random = np.random.default_rng(seed)
    target, exemplar = smooth(22, 26, seed), smooth(31, 28, seed + 100)
    rows, cols = (22, 26) if toroidal else (22 - PATCH_PX + 1, 26 - PATCH_PX + 1)
    if toroidal:
        target = np.pad(target, ((0, PATCH_PX - 1), (0, PATCH_PX - 1), (0, 0)), mode="wrap")
    allowed = np.zeros(exemplar.shape[:2], dtype=bool)
    allowed[: 31 - PATCH_PX + 1, : 28 - PATCH_PX + 1] = random.random((22, 19)) < 0.85
    price = random.integers(0, 200_000 if priced else 1, exemplar.shape[:2])
    return Hunt(
        np.ascontiguousarray(target),
        np.arange(0, rows, stride),
        np.arange(0, cols, stride),
        (22, 26) if toroidal else (0, 0),
        exemplar,
        allowed,
        price,
        np.zeros(exemplar.shape[:2], dtype=np.int64),
    )


def difference_of(hunt: Hunt, i: int, j: int, place: int) -> int:
    row, col = divmod(place, hunt.exemplar.shape[1])
    down, right = hunt.rows_px[i], hunt.cols_px[j]
    first = hunt.target[down : down + PATCH_PX, right : right + PATCH_PX].astype(np.int64)
    return int(((first - hunt.exemplar[row : row + PATCH_PX, col : col + PATCH_PX]) ** 2).sum())


@pytest.mark.parametrize("priced", [True, False])
@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("toroidal", [True, False])
def test_a_long_search_finds_what_looking_everywhere_finds(toroidal: bool, stride: int, priced: bool) -> None:
    hunt = made_up(3, toroidal=toroidal, stride=stride, priced=priced)
    best, differences = search_plain(hunt.target, hunt.rows_px, hunt.cols_px, hunt.exemplar, hunt.allowed, hunt.price)
    found, cost = hunt.run(hunt.somewhere(1), 250, 12)
    prices = hunt.price.reshape(-1)
    assert hunt.allowed.reshape(-1)[found].all()
    assert (cost + prices[found] >= differences + prices[best]).all()
    assert np.mean(cost + prices[found] == differences + prices[best]) > 0.95
    # Two passes are not enough for that: the search isn't an exhaustive one in disguise.
    hasty, told = hunt.run(hunt.somewhere(1), 1, 2)
    assert np.mean(told + prices[hasty] == differences + prices[best]) < 0.9


def test_differences_told_are_true() -> None:
    hunt = made_up(5, toroidal=True, stride=2)
    found, cost = hunt.run(hunt.somewhere(2), 2, 3)
    expected = [[difference_of(hunt, i, j, int(found[i, j])) for j in range(found.shape[1])] for i in range(len(found))]
    assert_array_equal(cost, expected)


@pytest.mark.parametrize("colour", [0, 1])
def test_bands_and_the_whole_find_the_same(colour: int) -> None:
    hunt = made_up(6, toroidal=True)
    field = hunt.somewhere(3)
    whole, cost = hunt.step(field, 5, colour, 4, [0, 22])
    for edges in ([0, 1, 2, 22], [0, 7, 15, 22], list(range(23))):
        found, told = hunt.step(field, 5, colour, 4, edges)
        assert_array_equal(found, whole)
        assert_array_equal(told, cost)
    other = (np.add.outer(np.arange(22), np.arange(26)) & 1) != colour
    assert_array_equal(whole[other], field[other])
    assert np.mean(whole[~other] != field[~other]) > 0.5
    assert np.any(hunt.step(field, 6, colour, 4, [0, 22])[0] != whole)


@pytest.mark.parametrize("stride", [1, 2])
def test_a_good_place_spreads_round_a_torus(stride: int) -> None:
    # The target is a cut of the exemplar from across its own edge: only neighbours beyond the edge know the places.
    size = 20
    exemplar = np.tile(smooth(size, size, 9), (3, 3, 1))[: 2 * size + PATCH_PX, : 2 * size + PATCH_PX]
    target = np.pad(exemplar[:size, :size], ((0, PATCH_PX - 1), (0, PATCH_PX - 1), (0, 0)), mode="wrap")
    allowed = np.zeros(exemplar.shape[:2], dtype=bool)
    allowed[: -PATCH_PX + 1, : -PATCH_PX + 1] = True
    nothing = np.zeros(exemplar.shape[:2], dtype=np.int64)
    at = np.arange(0, size, stride)
    hunt = Hunt(np.ascontiguousarray(target), at, at, (size, size), exemplar, allowed, nothing, nothing)
    wrong = size // 2 * exemplar.shape[1] + size // 2
    field = np.full((len(at), len(at)), wrong, dtype=np.int32)
    field[0, 0] = size * exemplar.shape[1] + size
    # Tries: none. In one pass over one colour the two neighbours across the edge learn it, at once.
    found, cost = hunt.step(field, 1, 1, 0, [0, len(at)])
    for i, j in ((-1, 0), (0, -1), (1, 0), (0, 1)):
        assert cost[i, j] == 0
        down, right = (at[k] - size * (k < 0) for k in (i, j))
        assert found[i, j] == (size + down) * exemplar.shape[1] + size + right
    # Without a torus, only those on this side.
    flat = replace(hunt, period=(0, 0)).step(field, 1, 1, 0, [0, len(at)])[0]
    assert flat[0, 1] == found[0, 1]
    assert flat[-1, 0] != found[-1, 0]
    assert flat[0, -1] != found[0, -1]
    # And from the opposite corner.
    field[:] = wrong
    field[-1, -1] = (size + at[-1]) * exemplar.shape[1] + size + at[-1]
    found, cost = hunt.step(field, 1, 1, 0, [0, len(at)])
    for i, j in ((0, -1), (-1, 0), (-2, -1), (-1, -2)):
        assert cost[i, j] == 0
        down, right = (at[k] + size * (k == 0) for k in (i, j))
        assert found[i, j] == (size + down) * exemplar.shape[1] + size + right


def test_a_crowded_place_is_not_tried_at_random() -> None:
    hunt = made_up(8, priced=False)
    best, _ = search_plain(hunt.target, hunt.rows_px, hunt.cols_px, hunt.exemplar, hunt.allowed, hunt.price)
    places = np.setdiff1d(np.flatnonzero(hunt.allowed), best)
    here = int(places[len(places) // 2])
    field = np.full(best.shape, here, dtype=np.int32)
    near = here + np.array([-1, 1, -hunt.exemplar.shape[1], hunt.exemplar.shape[1]])

    def moved_to(crowd_of_best: int, most: int) -> NDArray[np.int32]:
        # Neighbours show this place and lead to those beside it; whatever else is found is found at random.
        crowd = np.full(hunt.exemplar.shape[:2], 5, dtype=np.int64)
        crowd.reshape(-1)[best.ravel()] = crowd_of_best
        found = replace(hunt, crowd=crowd, most=most).step(field, 3, 0, 300, [0, len(field)])[0]
        return found[(found != here) & ~np.isin(found, near)]

    assert 0 < np.isin(moved_to(6, 6), best).mean() < 1
    # More than the most, and more than what is shown now: no.
    assert not np.isin(moved_to(6, 5), best).any()
    assert moved_to(6, 5).size
    # More than the most, but less than what is shown now: yes, and nothing else.
    assert np.isin(moved_to(4, 3), best).all()
    assert moved_to(4, 3).size


def test_a_patch_differs_by_the_sum_of_squares() -> None:
    random = np.random.default_rng(1)
    first, second = (random.integers(-1020, 2041, (14, 17, CHANNELS)).astype(np.int16) for _ in range(2))
    at, begin = (2 * 17 + 5) * CHANNELS, (3 * 17 + 1) * CHANNELS
    expected = int(((first[2:12, 5:15].astype(np.int64) - second[3:13, 1:11]) ** 2).sum())
    told = patch_difference(first.reshape(-1), at, 17 * CHANNELS, second.reshape(-1), begin, 17 * CHANNELS, FAR)
    assert told == expected
    # Beyond the bound anything from it up will do, below it only the truth.
    for bound in (1, expected // 2, expected, expected + 1):
        told = patch_difference(first.reshape(-1), at, 17 * CHANNELS, second.reshape(-1), begin, 17 * CHANNELS, bound)
        assert told == expected if bound > expected else told >= bound


@pytest.mark.parametrize(("low", "high"), [(-1, 1), (0, 7326), (-3663, 3663), (-1000, 6326)])
def test_rows_are_squared_as_numpy_squares_them(low: int, high: int) -> None:
    """Up to 40 squares of 7326: just under 2**31."""
    assert SQUARED_LANES == PATCH_PX * CHANNELS
    random = np.random.default_rng(high)
    for extreme in (False, True):
        for offset in range(5):
            values = [random.integers(low, high + 1, (PATCH_PX, 50)).astype(np.int16) for _ in range(2)]
            if extreme:
                signs = random.random((PATCH_PX, 50)) < 0.5
                values = [np.where(signs, *ends).astype(np.int16) for ends in ((low, high), (high, low))]
            rows = ((values[0][:, offset : offset + 40].astype(np.int64) - values[1][:, 3:43]) ** 2).sum(axis=1)
            assert rows.max() < 2**31
            told = patch_difference(values[0].reshape(-1), offset, 50, values[1].reshape(-1), 3, 50, FAR)
            assert told == rows.sum()
            # A bound of nothing ends it after one row: that row alone.
            alone = patch_difference(values[0].reshape(-1), offset, 50, values[1].reshape(-1), 3, 50, 0)
            assert alone == rows[0]


def showing(field: NDArray[np.int32], places: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    order = np.argsort(field.ravel(), kind="stable")
    return np.searchsorted(field.ravel()[order], np.arange(places + 1)), order


def test_shifts_are_counted() -> None:
    rows, cols, places = 9, 12, 18
    field = np.random.default_rng(2).permutation(np.arange(rows * cols) % places).reshape(rows, cols).astype(np.int32)
    counts = np.zeros((rows, 2 * cols + 1), dtype=np.int64)
    count_shifts(*showing(field, places), cols, counts)
    expected = np.zeros_like(counts)
    flat = field.ravel()
    for first in range(len(flat)):
        for second in range(first + 1, len(flat)):
            if flat[first] == flat[second]:
                expected[second // cols - first // cols, second % cols - first % cols + cols] += 1
    assert np.bincount(flat).max() < _MOST_COPIES
    assert_array_equal(counts, expected)


def test_of_many_copies_some_are_counted_for_all() -> None:
    counts = np.zeros((20, 61), dtype=np.int64)
    field = np.zeros((20, 30), dtype=np.int32)
    count_shifts(*showing(field, 1), 30, counts)
    assert abs(counts.sum() / (600 * 599 / 2) - 1) < 0.2


@pytest.mark.parametrize("copies", [3, 31, 200])
def test_showing_again_costs_the_dearest_shift(copies: int) -> None:
    random = np.random.default_rng(copies)
    rows, cols = 20, 18
    field = np.ones(rows * cols, dtype=np.int32)
    shown = np.sort(random.choice(rows * cols, copies, replace=False))
    field[shown] = 0
    prices = random.integers(0, 1000, (rows, 2 * cols + 1))
    starts, order = showing(field.reshape(rows, cols), 2)
    looked_at = shown[:: 1 + copies // _MOST_COPIES]
    for me in (0, 100, int(shown[0]), int(shown[-1]), rows * cols - 1):
        row, col = divmod(me, cols)
        expected = 0
        for other in looked_at:
            if other < me:
                expected = max(expected, int(prices[row - other // cols, col - other % cols + cols]))
        assert again_price(0, me, row, col, cols, starts, order, prices) == expected
    assert again_price(0, int(shown[0]), *divmod(int(shown[0]), cols), cols, starts, order, prices) == 0


def test_a_search_keeps_away_from_shifts_that_are_dear() -> None:
    hunt = made_up(11, priced=False)
    best, _ = search_plain(hunt.target, hunt.rows_px, hunt.cols_px, hunt.exemplar, hunt.allowed, hunt.price)
    starts, order = showing(best, hunt.allowed.size)
    dear = np.full((len(best), 2 * best.shape[1] + 1), 1 << 40, dtype=np.int64)
    priced = replace(hunt, shifts=Shifts(starts, order, dear))
    found = best
    for colour in (0, 1):
        found, _ = priced.step(found, 3 + colour, colour, 200, [0, len(best)])
    again = np.array([(order[starts[p] : starts[p + 1]] < me).any() for me, p in enumerate(best.ravel())])
    again = again.reshape(best.shape)
    assert 0.05 < again.mean() < 0.95
    # Who shows a place again gives it up for one that nobody shows before; the first to show one have no reason to.
    assert (found != best)[again].mean() > 0.95
    assert_array_equal(found[~again], best[~again])
