"""Which crop a cell shows: as the plain recursion says, the same from any window, evenly and without period."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import stats

from tilefab.rng import stream_key
from tilefab.sampling import CropMap
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_map import BARRED, RATION_PERIOD, overlap_penalty
from tilefab.sampling.crop_reference import CropReference, choose_crops_reference

FAR = 2**40
cells = st.one_of(st.integers(-9, 9), st.integers(-FAR, FAR), st.sampled_from([-FAR, FAR, -(2**55), 2**55]))
seeds = st.integers(0, 2**63 - 1)


def choose(crop_map: CropMap, row: int, col: int, rows: int, cols: int, seed: int = 0) -> NDArray[np.int32]:
    return choose_crops(crop_map, stream_key(seed, "crops"), row, col, rows, cols)


# The oracle is too slow to look for the smallest example that fails.
@settings(max_examples=12, phases=[Phase.explicit, Phase.generate])
@given(row=cells, col=cells, seed=seeds, name=st.sampled_from(["inks", "shifted", "rationed"]))
def test_choices_are_those_of_the_plain_recursion(
    crop_maps: dict[str, CropMap], row: int, col: int, seed: int, name: str
) -> None:
    crops = choose(crop_maps[name], row, col, 3, 4, seed)
    assert_array_equal(crops, choose_crops_reference(crop_maps[name], row, col, 3, 4, seed=seed))


@pytest.mark.parametrize("sweeps", [0, 1, 2])
@pytest.mark.parametrize(
    "changes",
    [
        {"candidates": 24},
        {"candidates": 40},
        {"candidates": 1},
        {"candidates": 6, "step_px": 4},
        {"candidates": 6, "step_px": 8, "rationed": 15, "barred": (3, 4, 5, 22)},
        {"rationed": 15, "barred": (3, 4, 5, 22)},
        # More dropped than are ever tried together.
        {"candidates": 5, "barred": tuple(range(4, 39))},
        {"candidates": 5, "rationed": 30, "barred": tuple(range(30, 40))},
        {"crops": 2, "candidates": 2},
        {"crops": 1, "candidates": 1},
    ],
    ids=[
        "part",
        "all",
        "one tried",
        "continuing",
        "continuing in turn",
        "turns and drops",
        "most dropped",
        "turns only",
        "two crops",
        "one crop",
    ],
)
def test_whatever_the_dictionary(crop_map_of: Callable[..., CropMap], sweeps: int, changes: dict[str, object]) -> None:
    crop_map = crop_map_of(sweeps=sweeps, **changes)
    for seed, (row, col) in enumerate([(0, 0), (-FAR - 3, FAR)]):
        assert_array_equal(
            choose(crop_map, row, col, 3, 3, seed), choose_crops_reference(crop_map, row, col, 3, 3, seed=seed)
        )


def test_equal_costs_go_to_the_first_tried(crop_map_of: Callable[..., CropMap]) -> None:
    nothing = np.zeros((40, 40), dtype=np.uint16)
    crop_map = crop_map_of(side_cost=nothing, below_cost=nothing, price=np.zeros(40, dtype=np.int32))
    assert_array_equal(choose(crop_map, -4, 7, 4, 4), choose_crops_reference(crop_map, -4, 7, 4, 4, seed=0))


@settings(max_examples=60)
@given(st.data())
def test_any_window_shows_the_same(crop_maps: dict[str, CropMap], data: st.DataObject) -> None:
    crop_map = crop_maps[data.draw(st.sampled_from(["inks", "shifted", "rationed"]))]
    row, col, seed = data.draw(cells), data.draw(cells), data.draw(seeds)
    rows, cols = data.draw(st.integers(1, 40)), data.draw(st.integers(1, 40))
    whole = choose(crop_map, row, col, rows, cols, seed)
    r, c = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    r2, c2 = data.draw(st.integers(r + 1, rows)), data.draw(st.integers(c + 1, cols))
    assert_array_equal(choose(crop_map, row + r, col + c, r2 - r, c2 - c, seed), whole[r:r2, c:c2])


@pytest.mark.parametrize("sweeps", [0, 1, 2])
def test_a_choice_depends_on_nothing_beyond_its_reach(crop_map_of: Callable[..., CropMap], sweeps: int) -> None:
    crop_map = crop_map_of(sweeps=sweeps)
    plane = CropReference(crop_map, seed=0)
    asked: set[tuple[int, int]] = set()
    shown = plane.shown

    def remembered(cell: tuple[int, int], sweep: int) -> int:
        asked.add(cell)
        return shown(cell, sweep)

    plane.shown = remembered  # type: ignore[assignment]
    plane.crop_at((1, 1))  # of the class that decides last
    reach = max(max(abs(r - 1), abs(c - 1)) for r, c in asked)
    assert reach <= 4 * (sweeps + 1) - 1 < crop_map.reach_cells
    assert reach >= 2 * (sweeps + 1)


def test_sweeps_make_joining_cheaper(crop_map_of: Callable[..., CropMap]) -> None:
    def cost(sweeps: int) -> float:
        crop_map = crop_map_of(sweeps=sweeps)
        crops = choose(crop_map, 0, 0, 60, 60)
        near = overlap_penalty(crop_map.crop_row, crop_map.crop_col, crop_map.pitch_px)
        total = 0.0
        for table, one, other in (
            (crop_map.side_cost, crops[:, :-1], crops[:, 1:]),
            (crop_map.below_cost, crops[:-1], crops[1:]),
        ):
            total += (table[one, other].astype(np.int64) + near[one, other]).mean() / 2
        return total

    costs = [cost(sweeps) for sweeps in (0, 1, 2)]
    assert costs[0] > costs[1] > costs[2]
    # Crops that know nothing of each other pay about the median, and a share of what is hardest to join.
    assert costs[2] < 0.85 * crop_map_of().side_cost.mean()


def one_first_class(crop_map: CropMap, seed: int, rows: int, cols: int) -> NDArray[np.int32]:
    """Crops of the cells that draw by hash alone."""
    return choose(crop_map, 0, 0, 2 * rows, 2 * cols, seed)[::2, ::2]


def independence_p(crops: NDArray[np.int32], number: int) -> list[float]:
    """p-values of the chi-square tests: each crop as often, and each pair of neighbours, to the right and below."""
    values = [stats.chisquare(np.bincount(crops.ravel(), minlength=number)).pvalue]
    for one, other in ((crops[:, :-1], crops[:, 1:]), (crops[:-1], crops[1:]), (crops[:-1, :-1], crops[1:, 1:])):
        pairs = np.bincount((one.astype(np.int64) * number + other).ravel(), minlength=number**2)
        values.append(stats.chisquare(pairs).pvalue)
    return values


def test_the_first_class_is_uniform_and_independent(crop_map_of: Callable[..., CropMap]) -> None:
    # A million cells of the class that the others depend on.
    crop_map = crop_map_of(crops=7, candidates=1, sweeps=0)
    crops = one_first_class(crop_map, 5, 1000, 1000)
    values = independence_p(crops, 7)
    assert min(values) > 0.001
    assert max(values) < 0.9999
    # The check itself finds a dependence of one cell in a hundred on its neighbour.
    tampered = crops.copy()
    tampered[:, 1::100] = tampered[:, :-1:100]
    assert min(independence_p(tampered, 7)) < 1e-9


def largest_peak(lightness: NDArray[np.float64]) -> float:
    """Largest power over the frequencies of a picture, as p-value.

    Each power is compared with the mean of those around it, so a smooth spectrum is none of its business; in noise
    the ratio is exponential.
    """
    power = np.abs(np.fft.fft2(lightness - lightness.mean())) ** 2
    around = np.zeros_like(power)
    for down in range(-3, 4):
        for right in range(-3, 4):
            if (down, right) != (0, 0):
                around += np.roll(power, (down, right), (0, 1))
    ratio = power * 48 / around
    ratio[0, 0] = 0
    # Where each ratio is a quotient of means of exponentials, F(2, 96), of which half are independent.
    p = float(stats.f(2, 96).sf(ratio.max()))
    return float(-np.expm1(power.size / 2 * np.log1p(-p)))


def test_the_plane_has_no_period(crop_maps: dict[str, CropMap]) -> None:
    values = []
    for crop_map in crop_maps.values():
        lightness = np.array(
            [
                crop_map.base[r : r + crop_map.crop_px, c : c + crop_map.crop_px, 0].mean()
                for r, c in zip(crop_map.crop_row, crop_map.crop_col, strict=True)
            ]
        )
        for seed in range(3):
            cells_shown = lightness[choose(crop_map, -25, -25, 50, 50, seed)]
            values.append(largest_peak(cells_shown))
            # The check itself: a period of five cells that makes up 6 % of the variance is found.
            wave = np.sin(2 * np.pi * (2 * np.arange(50)[:, None] + np.arange(50)) / 10) * cells_shown.std() * 0.35
            assert largest_peak(cells_shown + wave) < 1e-9
    assert min(values) > 1e-7


def test_a_period_is_found() -> None:
    tile = np.random.default_rng(0).random((5, 5))
    assert largest_peak(np.tile(tile, (10, 10))) < 1e-9
    assert largest_peak(np.random.default_rng(1).random((50, 50))) > 0.01


def test_seeds_are_other_planes(crop_map: CropMap) -> None:
    planes = [choose(crop_map, 0, 0, 30, 30, seed) for seed in (0, 1, 2**62, 2**63 - 1)]
    for k in range(4):
        for other in range(k):
            assert (planes[k] == planes[other]).mean() < 0.2


def test_the_plane_does_not_recur(crop_map: CropMap) -> None:
    here = choose(crop_map, 0, 0, 30, 30)
    for far in (4, 10, 2**16, 2**31, 2**32, 2**48):
        for row, col in ((far, 0), (0, far), (-far, far)):
            assert (choose(crop_map, row, col, 30, 30) == here).mean() < 0.25


@pytest.mark.parametrize("sweeps", [0, 1, 2])
@pytest.mark.parametrize("candidates", [4, 24, 40])
def test_dropped_crops_are_never_shown(crop_map_of: Callable[..., CropMap], sweeps: int, candidates: int) -> None:
    for barred in ((0, 7, 39), tuple(range(1, 39)), tuple(k for k in range(40) if k != 17)):
        crop_map = crop_map_of(barred=barred, sweeps=sweeps, candidates=candidates)
        shown = np.unique(choose(crop_map, -20, 3, 50, 50))
        assert not set(shown.tolist()) & set(barred)
        assert set(shown.tolist()) == set(range(40)) - set(barred) or len(shown) > 10


def test_dropped_crops_are_not_shown_even_where_all_others_are_out_of_turn(
    crop_map_of: Callable[..., CropMap],
) -> None:
    crop_map = crop_map_of(rationed=4, barred=tuple(range(4, 40)), candidates=40, sweeps=0)
    assert choose(crop_map, 0, 0, 40, 40).max() < 4


def turn_of(cell_row: int, cell_col: int) -> int:
    return (cell_row // 2 + 2 * (cell_col // 2)) % RATION_PERIOD


@pytest.mark.parametrize("sweeps", [0, 2])
def test_a_striking_feature_recurs_at_a_knights_move_or_further(
    crop_map_of: Callable[..., CropMap], sweeps: int
) -> None:
    """Blocks of 2 x 2 cells have one turn where (block row + 2 block col) mod 5 is the same.

    Those are the multiples of (1, 2) and (2, -1) blocks away: the nearest cells of two such blocks are one row and
    three columns apart, or three rows and one column.
    """
    crop_map = crop_map_of(rationed=15, sweeps=sweeps)
    top, left = -31, 2**33 + 5
    crops = choose(crop_map, top, left, 80, 80)
    nearest = 99
    for feature in range(RATION_PERIOD):
        shown = np.argwhere(crop_map.ration[crops] == feature)
        assert len(shown) > 20
        for r, c in shown:
            assert turn_of(top + int(r), left + int(c)) == feature
        block = (shown + np.array([top, left])) // 2
        other_block = (block[:, None] != block[None]).any(axis=2)
        apart = np.abs(shown[:, None] - shown[None]).max(axis=2)
        nearest = min(nearest, int(apart[other_block].min()))
        along = np.abs(shown[:, None] - shown[None]).sum(axis=2)
        assert along[other_block].min() >= 4
    assert nearest == 3


def test_neighbours_seldom_show_the_same_part_of_the_slab(crop_map_of: Callable[..., CropMap]) -> None:
    crop_map = crop_map_of(rows=200, cols=200, crops=80, candidates=60)
    crops = choose(crop_map, 0, 0, 60, 60)
    near = overlap_penalty(crop_map.crop_row, crop_map.crop_col, crop_map.pitch_px)
    by_chance = near.mean()
    for one, other in ((crops[:-1, :-1], crops[1:, 1:]), (crops[:-1, 1:], crops[1:, :-1])):
        assert near[one, other].mean() < by_chance
    assert (crops[:, 1:] == crops[:, :-1]).mean() < 0.01


def test_barred_means_barred_in_words_and_numbers() -> None:
    assert BARRED > 2 * (1 << 24)
