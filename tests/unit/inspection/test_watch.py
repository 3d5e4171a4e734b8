"""The watch over innovations: all charts at once, restarted after signals, kept between tiles as plain JSON."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.inspection.run_rules import nelson_rules
from tilefab.inspection.spc import CusumChart, EwmaChart, ShewhartChart
from tilefab.inspection.watch import WatchCharts, WatchSignals, WatchState, watch, watch_all

values_of = st.lists(st.floats(-4.0, 4.0), max_size=50)


def followed(values: list[float]) -> tuple[WatchState, list[WatchSignals]]:
    state, said = WatchState(), []
    for value in values:
        state, signals = watch(state, value)
        said.append(signals)
    return state, said


@given(values_of)
def test_one_by_one_is_as_all_at_once(values: list[float]) -> None:
    _, said = followed(values)
    for one, at_once in zip(said, watch_all(values), strict=True):
        assert (one.shewhart, one.ewma, one.cusum) == (at_once.shewhart, at_once.ewma, at_once.cusum)
        assert (one.average, one.high, one.low) == (at_once.average, at_once.high, at_once.low)
    rules = nelson_rules(values, 0.0, 1.0)
    for place, one in enumerate(said):
        assert one.rules == tuple(rule for rule, points in enumerate(rules, 1) if place in points)


@given(values_of, values_of)
def test_state_survives_a_restart(before: list[float], after: list[float]) -> None:
    state, _ = followed(before)
    again = WatchState.from_plain(json.loads(json.dumps(state.plain())))
    assert again == state
    for value in after:
        state, one = watch(state, value)
        again, other = watch(again, value)
        assert one == other
    assert state.seen == len(before) + len(after)


def test_a_shift_is_found_and_the_charts_begin_anew() -> None:
    state, said = followed([1.5] * 6)
    assert [one.cusum for one in said] == [0, 0, 0, 0, 0, 1]
    assert said[-1].high == pytest.approx(6.0)
    assert said[-1].alarming
    assert (state.high, state.low) == (0.0, 0.0)
    _, down = followed([-1.5] * 6)
    assert [one.cusum for one in down] == [0, 0, 0, 0, 0, -1]


def test_a_single_outlier_is_no_alarm() -> None:
    _, said = followed([0.0, 4.0, 0.0])
    assert [one.shewhart for one in said] == [0, 1, 0]
    assert said[1].rules == (1,)
    assert not any(one.alarming for one in said)


def test_all_quiet_when_nothing_is_wrong() -> None:
    values = np.random.default_rng(2).standard_normal(20_000).tolist()
    said = watch_all(values)
    assert sum(one.cusum != 0 for one in said) == pytest.approx(20_000 / 465, rel=0.35)
    assert sum(one.ewma != 0 for one in said) == pytest.approx(20_000 / 500, rel=0.35)


def test_other_charts_can_be_chosen() -> None:
    charts = WatchCharts(ShewhartChart(1.0), EwmaChart(0.5, 1.0), CusumChart(0.0, 1.0))
    _, said = watch(WatchState(), 1.2, charts)
    assert (said.shewhart, said.ewma, said.cusum) == (1, 1, 1)


def test_refuses_what_is_no_number() -> None:
    with pytest.raises(ValueError, match="can't be charted"):
        watch(WatchState(), math.nan)
