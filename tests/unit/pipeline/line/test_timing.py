from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.pipeline.line.timing import Latencies, Throughput


def test_without_any_time_every_quantile_is_nought() -> None:
    assert Latencies().quantile_s(0.999) == 0.0


@given(
    st.lists(st.floats(1e-4, 10.0), min_size=1, max_size=200),
    st.floats(0.01, 1.0),
)
def test_a_quantile_is_never_below_the_true_one_and_at_most_a_bin_above(times: list[float], share: float) -> None:
    latencies = Latencies()
    for seconds in times:
        latencies.add(seconds)
    rank = next(n for n in range(1, len(times) + 1) if n >= share * len(times))
    true = sorted(times)[rank - 1]
    assert true <= latencies.quantile_s(share) <= true * 1.0501
    assert latencies.count == len(times)
    assert latencies.largest_s == max(times)


def test_times_beyond_all_bins_are_told_as_they_are() -> None:
    latencies = Latencies()
    latencies.add(100.0)
    assert latencies.quantile_s(0.5) == 100.0


def test_a_rate_covers_the_last_minute() -> None:
    now = [0.0]
    rate = Throughput(lambda: now[0])
    for second in range(120):
        now[0] = float(second)
        rate.count()
    assert rate.per_minute == pytest.approx(61.0)
    now[0] += 30.0
    assert rate.per_minute == pytest.approx(31.0)
    now[0] += 60.0
    assert rate.per_minute == 0.0


def test_a_rate_of_a_line_that_has_just_begun_is_over_the_time_since() -> None:
    now = [0.0]
    rate = Throughput(lambda: now[0])
    now[0] = 10.0
    for _ in range(5):
        rate.count()
    assert rate.per_minute == pytest.approx(30.0)
