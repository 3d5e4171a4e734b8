"""Average run lengths: published ones by both ways, and the simulation against the charts themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tilefab.inspection.run_length_kernels import CUSUM, EWMA, SHEWHART, fill_run_lengths, normal_pair
from tilefab.inspection.run_lengths import Chart, average_run_length, simulate_run_lengths
from tilefab.inspection.spc import CusumChart, CusumState, EwmaChart, ShewhartChart
from tilefab.rng import stream_key

# Montgomery, "Introduction to Statistical Quality Control", chapters 5 (single values) and 9 (CUSUM); Lucas and
# Saccucci, Technometrics 32 (1990) (EWMA).
PUBLISHED: tuple[tuple[Chart, float, float], ...] = (
    (ShewhartChart(3.0), 0.0, 370.4),
    (ShewhartChart(3.0), 1.0, 43.9),
    (ShewhartChart(3.0), 2.0, 6.3),
    (CusumChart(0.5, 5.0), 0.0, 465.0),
    (CusumChart(0.5, 5.0), 0.5, 38.0),
    (CusumChart(0.5, 5.0), 1.0, 10.4),
    (CusumChart(0.5, 4.0), 0.0, 168.0),
    (CusumChart(0.5, 4.0), 1.0, 8.38),
    (EwmaChart(0.2, 2.962), 0.0, 500.0),
    (EwmaChart(0.2, 2.962), 1.0, 10.5),
    (EwmaChart(0.1, 2.814), 0.0, 500.0),
    (EwmaChart(0.1, 2.814), 1.0, 10.3),
)


@pytest.mark.parametrize(("chart", "shift", "published"), PUBLISHED)
def test_the_equation_gives_the_published_lengths(chart: Chart, shift: float, published: float) -> None:
    assert average_run_length(chart, shift) == pytest.approx(published, rel=0.01)


@pytest.mark.parametrize("chart", [ShewhartChart(3.0), CusumChart(0.5, 5.0), EwmaChart(0.2, 2.962)])
def test_simulation_agrees_with_the_equation(chart: Chart) -> None:
    found = simulate_run_lengths(chart, 20_000, seed=4)
    assert found.mean == pytest.approx(average_run_length(chart), abs=4.5 * found.standard_error)
    assert found.standard_error < 0.01 * found.mean
    shifted = simulate_run_lengths(chart, 20_000, shift=-1.0, seed=5)
    assert shifted.mean == pytest.approx(average_run_length(chart, 1.0), abs=4.5 * shifted.standard_error)


def test_an_ewma_of_weight_one_is_single_values() -> None:
    assert average_run_length(EwmaChart(1.0, 2.5), 0.7) == pytest.approx(
        average_run_length(ShewhartChart(2.5), 0.7), rel=1e-6
    )


def twin(key: np.uint64, run: int, chart: Chart, shift: float) -> int:
    """How many values the chart itself takes until its signal, from the same stream."""
    sums, average, count = CusumState(), 0.0, 0
    while True:
        for value in normal_pair(key, run, count // 2):
            if isinstance(chart, CusumChart):
                sums, signal = chart.update(sums, value + shift)
            elif isinstance(chart, EwmaChart):
                average, signal = chart.update(average, value + shift)
            else:
                signal = chart.update(value + shift)
            count += 1
            if signal:
                return count


@pytest.mark.parametrize(
    ("kind", "chart", "pace", "bound"),
    [
        (SHEWHART, ShewhartChart(2.0), 0.0, 2.0),
        (EWMA, EwmaChart(0.2, 2.0), 0.2, EwmaChart(0.2, 2.0).bound),
        (CUSUM, CusumChart(0.5, 3.0), 0.5, 3.0),
    ],
)
def test_the_kernel_runs_as_the_charts_do(kind: int, chart: Chart, pace: float, bound: float) -> None:
    key, lengths = stream_key(9, "twins"), np.zeros(25, dtype=np.int64)
    fill_run_lengths(key, 3, kind, pace, bound, 0.3, 100_000, lengths)
    assert lengths.tolist() == [twin(key, 3 + run, chart, 0.3) for run in range(25)]


def test_runs_are_the_same_however_divided() -> None:
    key, whole, part = stream_key(1, "runs"), np.zeros(30, np.int64), np.zeros(10, np.int64)
    fill_run_lengths(key, 0, CUSUM, 0.5, 4.0, 0.0, 100_000, whole)
    fill_run_lengths(key, 20, CUSUM, 0.5, 4.0, 0.0, 100_000, part)
    assert whole[20:].tolist() == part.tolist()


def test_runs_are_cut() -> None:
    lengths = np.zeros(3, np.int64)
    fill_run_lengths(stream_key(1, "runs"), 0, SHEWHART, 0.0, 50.0, 0.0, 100, lengths)
    assert lengths.tolist() == [100] * 3


def test_the_stream_is_normal() -> None:
    key = stream_key(2, "normal")
    values = np.array([normal_pair(key, run, pair) for run in range(40) for pair in range(250)]).ravel()
    assert values.mean() == pytest.approx(0.0, abs=4 / math.sqrt(values.size))
    assert values.var() == pytest.approx(1.0, abs=0.05)
    assert np.abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 4 / math.sqrt(values.size)
    assert len(np.unique(values)) == values.size


def test_one_run_has_no_error() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        simulate_run_lengths(ShewhartChart(), 1)
