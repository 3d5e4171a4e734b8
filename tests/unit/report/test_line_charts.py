"""Charts over time: clocks, round times, gaps, thinning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.line_report_samples import BEGUN_S, empty
from tilefab.report.charts import Axes
from tilefab.report.line_charts import TimeAxis, around, binned, clock_text, onsets, signed, span_text
from tilefab.report.line_view import CorrectionView, SpanView

DAY = 86400.0


def axis(seconds: float, offset_min: int = 0) -> TimeAxis:
    return TimeAxis.of(replace(empty(), ended_s=BEGUN_S + seconds, utc_offset_min=offset_min))


@given(st.floats(1.0, 400 * DAY), st.integers(-14 * 60, 14 * 60))
def test_ticks_are_few_and_inside(seconds: float, offset: int) -> None:
    found = axis(seconds, offset).ticks()
    assert len(found) <= 10
    assert all(BEGUN_S - 1e-3 <= at_s <= BEGUN_S + seconds + 1e-3 for at_s, _ in found)
    assert len({at_s for at_s, _ in found}) == len(found)


def test_ticks_are_round_on_the_factorys_clock() -> None:
    found = axis(8 * 3600.0, 330).ticks()
    assert [label for _, label in found] == [f"{hour}:00" for hour in range(11, 19)]
    # 05:00 UTC is 10:30 there.
    assert found[0][0] == BEGUN_S + 1800.0


def test_ticks_name_days_and_seconds_where_they_tell_more() -> None:
    assert "25 Nov" in [label for _, label in axis(DAY).ticks()]
    assert all(" " in label for _, label in axis(20 * DAY).ticks())
    assert [label for _, label in axis(60.0).ticks()][:2] == ["05:00:00", "05:00:10"]


def test_what_is_marked_lies_inside() -> None:
    view = replace(
        empty(),
        ended_s=BEGUN_S + 100.0,
        downtime=(SpanView(BEGUN_S - 50.0, BEGUN_S + 10.0, "", ""), SpanView(BEGUN_S + 200.0, BEGUN_S + 300.0, "", "")),
        holds=(SpanView(BEGUN_S + 90.0, None, "", ""),),
        corrections=(CorrectionView(1, BEGUN_S - 5.0, ""), CorrectionView(2, BEGUN_S + 5.0, "")),
    )
    found = TimeAxis.of(view)
    assert found.stops == ((BEGUN_S, BEGUN_S + 10.0),)
    assert found.holds == ((BEGUN_S + 90.0, BEGUN_S + 100.0),)
    assert found.corrections == ((2, BEGUN_S + 5.0),)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0 s"),
        (89.0, "89 s"),
        (90.0, "2 min"),
        (3570.0, "1 h 00 min"),
        (7500.0, "2 h 05 min"),
        (3 * DAY, "3 d 0 h"),
    ],
)
def test_spans_in_words(seconds: float, text: str) -> None:
    assert span_text(seconds) == text


def test_clocks_and_signs() -> None:
    assert clock_text(BEGUN_S, 60, seconds=True).endswith("06:00:00")
    assert (signed(0.004), signed(-0.004), signed(1234.5, 1)) == ("0.00", "0.00", "+1 234.5")


@given(st.lists(st.tuples(st.floats(0.0, 1000.0), st.floats(-5.0, 5.0)), min_size=1, max_size=300))
def test_bins_keep_extremes_and_means(points: list[tuple[float, float]]) -> None:
    at_s, values = np.array(points).T
    axes = Axes(0.0, 0.0, 1.0, 1.0, 0.0, 1000.0, 0.0, 1.0)
    middle, lowest, mean, highest = binned(axes, at_s, values)
    assert lowest.min() == values.min()
    assert highest.max() == values.max()
    assert (np.diff(middle) > 0).all()
    assert (lowest <= mean + 1e-9).all()
    assert (mean <= highest + 1e-9).all()


def test_onsets_are_firsts() -> None:
    marks = np.array([True, True, False, True, False, False, True, True, True])
    assert np.flatnonzero(onsets(marks)).tolist() == [0, 3, 6]
    assert onsets(np.zeros(0, bool)).size == 0


def test_axes_hold_what_they_show() -> None:
    assert around([1.0, 3.0], least=1.0) == pytest.approx((0.92, 3.08))
    assert around([2.0, 2.0], least=1.0) == (1.5, 2.5)
    assert around([], least=2.0) == (-1.0, 1.0)
    assert around([0.2, float("nan")], least=1.0, zero=True) == (0.0, 1.0)
    assert around([5.0], least=1.0, zero=True) == pytest.approx((0.0, 5.4))
