"""Set-points on their way."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.control.ramp import RampLimits, next_set_points, ramp_minutes, set_point_problem

LIMITS = RampLimits(20.0, 1250.0, 5.0)
ZONES = st.integers(1, 8)


def degrees(count: int) -> st.SearchStrategy[list[float]]:
    return st.lists(st.floats(20, 1250), min_size=count, max_size=count)


PAIRS = ZONES.flatmap(lambda count: st.tuples(degrees(count), degrees(count)))


def test_zones_move_together_and_arrive_together() -> None:
    steps = [(1000.0, 900.0)]
    while steps[-1] != (1020.0, 860.0):
        steps.append(next_set_points(steps[-1], (1020.0, 860.0), 60.0, LIMITS))
    assert len(steps) == 9
    assert steps[4] == pytest.approx((1010.0, 880.0))
    assert ramp_minutes((1000.0, 900.0), (1020.0, 860.0), LIMITS) == 8.0


def test_the_way_down_is_as_slow_as_the_way_up() -> None:
    assert next_set_points([1200.0], [20.0], 60.0, LIMITS) == (1195.0,)
    assert next_set_points([20.0], [1200.0], 60.0, LIMITS) == (25.0,)


@given(PAIRS, st.floats(0, 1e5), st.floats(0.1, 15))
def test_a_step_is_within_ramp_and_limits_and_never_leads_away(
    pair: tuple[list[float], list[float]], elapsed_s: float, ramp: float
) -> None:
    now, target = pair
    found = next_set_points(now, target, elapsed_s, RampLimits(20.0, 1250.0, ramp))
    for here, there, wanted in zip(now, found, target, strict=True):
        assert abs(there - here) <= ramp * elapsed_s / 60 + 1e-9
        assert min(here, wanted) - 1e-9 <= there <= max(here, wanted) + 1e-9


@given(PAIRS, st.floats(1, 600))
def test_it_arrives_exactly_and_on_time(pair: tuple[list[float], list[float]], elapsed_s: float) -> None:
    now, target = tuple(pair[0]), tuple(pair[1])
    steps = math.ceil(ramp_minutes(now, target, LIMITS) * 60 / elapsed_s) + 1
    for _ in range(steps):
        now = next_set_points(now, target, elapsed_s, LIMITS)
    assert now == target


def test_without_time_nothing_moves() -> None:
    assert next_set_points([500.0, 600.0], [700.0, 600.0], 0.0, LIMITS) == (500.0, 600.0)


def test_set_points_outside_the_limits_move_inwards() -> None:
    assert next_set_points([1300.0], [1250.0], 60.0, LIMITS) == (1295.0,)


@pytest.mark.parametrize("wanted", [19.9, 1250.1, math.nan, math.inf])
def test_a_target_outside_the_limits_is_refused(wanted: float) -> None:
    assert set_point_problem([500.0, wanted], LIMITS).startswith("zone 2: ")
    with pytest.raises(ValueError, match="zone 2"):
        next_set_points([500.0, 500.0], [500.0, wanted], 60.0, LIMITS)


@pytest.mark.parametrize(
    ("now", "target", "elapsed_s"),
    [
        ([500.0], [500.0, 500.0], 1.0),
        ([], [], 1.0),
        ([math.nan], [500.0], 1.0),
        ([500.0], [600.0], -1.0),
        ([500.0], [600.0], math.inf),
    ],
)
def test_nonsense_is_refused(now: list[float], target: list[float], elapsed_s: float) -> None:
    with pytest.raises(ValueError):
        next_set_points(now, target, elapsed_s, LIMITS)


@pytest.mark.parametrize(
    "limits", [(500, 500, 5), (500, 400, 5), (20, math.inf, 5), (math.nan, 500, 5), (20, 500, 0), (20, 500, math.nan)]
)
def test_limits_must_leave_room(limits: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError):
        RampLimits(*limits)
