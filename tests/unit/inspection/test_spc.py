"""Constants against published tables, limits and indices against hand computation, charts step by step."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.inspection.spc import (
    CusumChart,
    CusumState,
    EwmaChart,
    ShewhartChart,
    chart_constants,
    cpk,
    mean_range_limits,
)

# D. C. Montgomery, "Introduction to Statistical Quality Control", appendix VI: n, d2, d3, A2, D3, D4.
PUBLISHED = (
    (2, 1.128, 0.853, 1.880, 0.0, 3.267),
    (3, 1.693, 0.888, 1.023, 0.0, 2.574),
    (4, 2.059, 0.880, 0.729, 0.0, 2.282),
    (5, 2.326, 0.864, 0.577, 0.0, 2.114),
    (7, 2.704, 0.833, 0.419, 0.076, 1.924),
    (10, 3.078, 0.797, 0.308, 0.223, 1.777),
    (15, 3.472, 0.756, 0.223, 0.347, 1.653),
    (25, 3.931, 0.708, 0.153, 0.459, 1.541),
)
finite = st.floats(-50.0, 50.0)


@pytest.mark.parametrize("row", PUBLISHED, ids=lambda row: f"n{row[0]}")
def test_constants_are_those_of_the_tables(row: tuple[float, ...]) -> None:
    found = chart_constants(int(row[0]))
    assert (found.d2, found.d3, found.a2, found.d_low, found.d_high) == pytest.approx(row[1:], abs=1.1e-3)


def test_constants_of_two_values_are_exact() -> None:
    two = chart_constants(2)
    assert two.d2 == pytest.approx(2.0 / math.sqrt(math.pi), abs=1e-9)
    assert two.d3 == pytest.approx(math.sqrt(2.0 - 4.0 / math.pi), abs=1e-9)


@pytest.mark.parametrize("n", [1, 0, 101])
def test_no_constants_for_odd_groups(n: int) -> None:
    with pytest.raises(ValueError, match="take 2 to 100"):
        chart_constants(n)


def test_limits_by_hand() -> None:
    limits = mean_range_limits([[1.0, 3.0], [2.0, 2.0], [4.0, 6.0], [5.0, 1.0]])
    assert (limits.n, limits.groups, limits.mean, limits.range_mean) == (2, 4, 3.0, 2.0)
    assert limits.mean_high == pytest.approx(3.0 + 1.87997 * 2.0, abs=1e-4)
    assert limits.mean_low == pytest.approx(3.0 - 1.87997 * 2.0, abs=1e-4)
    assert (limits.range_low, limits.range_high) == pytest.approx((0.0, 6.53306), abs=1e-4)
    assert limits.sigma == pytest.approx(2.0 / 1.12838, abs=1e-4)


def test_limits_find_the_standard_deviation_of_normal_values() -> None:
    groups = np.random.default_rng(3).normal(10.0, 0.4, (4000, 5))
    limits = mean_range_limits(groups)
    assert limits.sigma == pytest.approx(0.4, rel=0.02)
    beyond = (groups.mean(axis=1) > limits.mean_high) | (groups.mean(axis=1) < limits.mean_low)
    assert beyond.mean() == pytest.approx(0.0027, abs=0.002)


@pytest.mark.parametrize("groups", [np.zeros((0, 5)), np.zeros(5), np.full((2, 5), np.nan)])
def test_limits_refuse_what_is_no_table(groups: np.ndarray) -> None:
    with pytest.raises(ValueError, match="finite values"):
        mean_range_limits(groups)


def test_capability_by_hand() -> None:
    values = [9.0, 10.0, 11.0, 10.0]
    found = cpk(values, 7.0, 12.0)
    within, overall = 1.0 / (2.0 / math.sqrt(math.pi)), math.sqrt(2.0 / 3.0)
    assert (found.count, found.mean) == (4, 10.0)
    assert (found.sigma_within, found.sigma_overall) == pytest.approx((within, overall))
    assert (found.cpk, found.ppk) == pytest.approx((2.0 / (3.0 * within), 2.0 / (3.0 * overall)))
    assert cpk(values, None, 12.0).cpk == found.cpk
    assert cpk(values, 7.0, None).cpk == pytest.approx(1.5 * found.cpk)


def test_capability_beyond_the_limit_is_below_zero() -> None:
    found = cpk([2.0, 3.0, 2.5], None, 1.0)
    assert found.cpk < 0.0
    assert found.ppk < 0.0


def test_capability_without_variation() -> None:
    assert cpk([1.0, 1.0], None, 2.0).cpk == math.inf
    assert cpk([1.0, 1.0], None, 0.5).cpk == -math.inf
    assert cpk([1.0, 1.0], None, 1.0).cpk == 0.0


def test_a_wandering_mean_shows_in_ppk_only() -> None:
    generator = np.random.default_rng(8)
    still = generator.normal(0.0, 1.0, 2000)
    found = cpk(still + np.linspace(0.0, 8.0, still.size), -20.0, 20.0)
    assert found.sigma_within == pytest.approx(1.0, rel=0.05)
    assert found.ppk < 0.5 * found.cpk


@pytest.mark.parametrize(
    ("values", "lower", "upper", "said"),
    [
        ([1.0], 0.0, 2.0, "at least 2"),
        ([1.0, math.inf], 0.0, 2.0, "finite"),
        ([1.0, 2.0], None, None, "lower or an upper"),
        ([1.0, 2.0], 2.0, 2.0, "must be below"),
    ],
)
def test_capability_refuses(values: list[float], lower: float | None, upper: float | None, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        cpk(values, lower, upper)


def test_ewma_by_hand() -> None:
    chart = EwmaChart(0.25, 3.0)
    assert chart.bound == pytest.approx(3.0 * math.sqrt(0.25 / 1.75))
    average, signals = 0.0, []
    for value in (1.0, -1.0, 5.0):
        average, signal = chart.update(average, value)
        signals.append(signal)
    assert average == pytest.approx(0.25 * 5.0 + 0.75 * (0.25 * -1.0 + 0.75 * 0.25))
    assert signals == [0, 0, 1]


def test_ewma_of_weight_one_is_single_values() -> None:
    chart = EwmaChart(1.0, 3.0)
    found = [chart.update(0.7, value) for value in (2.9, 3.1, -3.1)]
    assert [average for average, _ in found] == pytest.approx([2.9, 3.1, -3.1])
    assert [signal for _, signal in found] == [0, 1, -1]
    assert [ShewhartChart().update(value) for value in (2.9, 3.1, -3.1)] == [0, 1, -1]


@given(st.lists(finite, min_size=1, max_size=40))
def test_cusum_sums_are_the_worst_stretch(values: list[float]) -> None:
    chart, state = CusumChart(0.5, 1000.0), CusumState()
    for value in values:
        state, _ = chart.update(state, value)
    tails = [sum(value - 0.5 for value in values[start:]) for start in range(len(values) + 1)]
    assert state.high == pytest.approx(max(0.0, *tails), abs=1e-9)
    tails = [sum(-value - 0.5 for value in values[start:]) for start in range(len(values) + 1)]
    assert state.low == pytest.approx(max(0.0, *tails), abs=1e-9)


@given(st.lists(finite, min_size=1, max_size=40))
def test_charts_know_no_side(values: list[float]) -> None:
    state, mirrored = CusumState(), CusumState()
    average = mirror = 0.0
    for value in values:
        state, signal = CusumChart().update(state, value)
        mirrored, opposite = CusumChart().update(mirrored, -value)
        assert (state.high, state.low) == (mirrored.low, mirrored.high)
        if min(state.high, state.low) <= CusumChart().limit:
            assert signal == -opposite
        average, up = EwmaChart().update(average, value)
        mirror, down = EwmaChart().update(mirror, -value)
        assert (average, up) == (-mirror, -down)


def test_cusum_signals_both_ways() -> None:
    assert CusumChart().update(CusumState(4.9, 0.0), 1.0) == (CusumState(5.4, 0.0), 1)
    assert CusumChart().update(CusumState(0.0, 4.9), -1.0) == (CusumState(0.0, 5.4), -1)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_charts_refuse_what_is_no_number(value: float) -> None:
    with pytest.raises(ValueError, match="can't be charted"):
        EwmaChart().update(0.0, value)
    with pytest.raises(ValueError, match="can't be charted"):
        CusumChart().update(CusumState(), value)
    with pytest.raises(ValueError, match="can't be charted"):
        ShewhartChart().update(value)


def test_settings_are_checked() -> None:
    for weight in (0.0, 1.1, math.nan):
        with pytest.raises(ValueError, match="weight"):
            EwmaChart(weight)
    with pytest.raises(ValueError, match="limit"):
        EwmaChart(0.2, 0.0)
    with pytest.raises(ValueError, match="slack"):
        CusumChart(-0.1)
    with pytest.raises(ValueError, match="limit"):
        ShewhartChart(0.0)
