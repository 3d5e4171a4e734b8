"""Recipes of charts: limits, kinds, distances, repeats, for every number of inks."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tilefab.chart.design import FULL, KINDS, NEAR_COUNTS, ChartDesign, design_chart


def make(inks: int, patches: int, limit: float | None = None, **options: object) -> ChartDesign:
    black = 3 if inks >= 4 else None
    total = min(100.0 * inks, 300.0) if limit is None else limit
    return design_chart(
        inks,
        patches,
        total_limit_percent=total,
        **{"black_channel": black, "seed": 5, **options},
    )


@pytest.mark.parametrize("inks", range(1, 9))
@pytest.mark.parametrize("patches", [100, 900])
def test_every_number_of_inks(inks: int, patches: int) -> None:
    design = make(inks, patches)
    counts = design.ink_counts.astype(int)
    assert counts.shape == (patches, inks)
    assert set(design.kinds) <= set(KINDS)
    assert counts.sum(axis=1).max() <= min(100 * inks, 300) * FULL / 100
    originals = np.flatnonzero(design.repeat_of < 0)
    distinct = counts[originals]
    nearest = cKDTree(distinct).query(distinct, k=2, p=np.inf)[0][:, 1]
    assert nearest.min() >= NEAR_COUNTS
    for patch in np.flatnonzero(design.repeat_of >= 0):
        np.testing.assert_array_equal(counts[patch], counts[design.repeat_of[patch]])
        assert design.repeat_of[design.repeat_of[patch]] < 0


def test_the_same_seed_gives_the_same_chart() -> None:
    one, again, other = make(4, 300), make(4, 300), make(4, 300, seed=6)
    np.testing.assert_array_equal(one.ink_counts, again.ink_counts)
    np.testing.assert_array_equal(one.repeat_of, again.repeat_of)
    assert (one.ink_counts != other.ink_counts).any()


def test_all_corners_of_four_inks_are_there() -> None:
    have = {tuple(recipe) for recipe in make(4, 300, 400.0).ink_counts.tolist()}
    assert have >= set(itertools.product((0, FULL), repeat=4))
    within = {corner for corner in itertools.product((0, FULL), repeat=4) if sum(corner) <= 2.5 * FULL}
    assert {tuple(recipe) for recipe in make(4, 100, 250.0).ink_counts.tolist()} >= within


def test_singles_pairs_and_threes_of_eight_inks_are_there() -> None:
    have = {tuple(recipe) for recipe in make(8, 1500).ink_counts.tolist()}
    for count in (1, 2, 3):
        for group in itertools.combinations(range(8), count):
            assert tuple(FULL if ink in group else 0 for ink in range(8)) in have


def test_limits_of_single_inks() -> None:
    limits = (100.0, 80.0, 60.0, 95.0)
    design = make(4, 300, 260.0, ink_limits_percent=limits)
    assert (design.ink_percent.max(axis=0) <= np.array(limits) + 1e-9).all()
    np.testing.assert_allclose(design.ink_percent.max(axis=0), limits, atol=0.4)


def test_ramps_are_dense_at_both_ends() -> None:
    design = make(4, 800)
    alone = design.ink_percent[(design.ink_counts[:, 1:] == 0).all(axis=1) & (design.repeat_of < 0), 0]
    levels = np.sort(alone)
    steps = np.diff(levels)
    assert levels[0] == 0.0
    assert levels[-1] == 100.0
    assert len(levels) >= 15
    assert steps[:3].mean() < 0.6 * steps.max()
    assert steps[-2:].min() < 0.6 * steps.max()


def test_recipes_of_many_inks_use_few_at_once_and_some_use_all() -> None:
    design = make(8, 1000)
    spread = np.array([kind == "spread" for kind in design.kinds])
    at_once = (design.ink_counts[spread] > 0).sum(axis=1)
    assert 0.75 <= (at_once <= 4).mean() <= 0.95
    assert (at_once == 8).any()
    used = (design.ink_counts > 0).sum(axis=0)
    # Black is no other than the rest here, but the ramps of neutrals have more of it or less.
    assert used.min() > 0.5 * used.max()


def test_there_are_more_recipes_where_there_is_little_ink() -> None:
    design = make(4, 1500)
    spread = np.array([kind == "spread" for kind in design.kinds])
    amounts = design.ink_percent[spread]
    assert (amounts < 50.0).mean() > 0.55


def test_whites_and_repeats_can_be_asked_for() -> None:
    design = make(4, 200, whites=9, repeats=20)
    assert (design.ink_counts == 0).all(axis=1).sum() == 9
    assert sum(kind == "repeat" for kind in design.kinds) == 20
    totals = design.ink_percent.sum(axis=1)[[kind == "repeat" for kind in design.kinds]]
    assert totals.min() < 60.0
    assert totals.max() > 200.0


@pytest.mark.parametrize(
    "change",
    [
        {"inks": 0},
        {"inks": 9},
        {"patches": 19},
        {"limit": 500.0},
        {"limit": 50.0},
        {"ink_limits_percent": (100.0,)},
        {"ink_limits_percent": (100.0, 100.0, 100.0, 0.0)},
        {"black_channel": 4},
        {"whites": 0},
        {"repeats": 95},
    ],
)
def test_what_makes_no_chart(change: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        make(**{"inks": 4, "patches": 100, **change})
