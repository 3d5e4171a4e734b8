"""The belt's motion, against stepping through it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.plant.physics.motion import Motion

AIMS = st.lists(
    st.tuples(st.floats(0.01, 3), st.sampled_from([0.0, 0.1, 120.0, 500.0, 2999.0]), st.floats(50, 6000)),
    min_size=1,
    max_size=6,
)


@given(AIMS, st.floats(0, 4))
def test_travel_is_the_integral_of_speed_and_time_at_undoes_it(aims, rest):
    motion, t, x = Motion(), 0.0, 0.0
    for wait, speed, accel in aims:
        motion.aim(t, x, speed, accel)
        stepped, step, n = x, wait / 400, 400
        for i in range(n):
            v = motion.speed_at(t + (i + 0.5) * step)
            assert v >= 0
            stepped += v * step
        before, t = x, t + wait
        x = motion.travel_at(t)
        assert x >= before
        assert x == pytest.approx(stepped, abs=accel * step * step * 2 + 1e-6)
    probe = motion.travel_at(t + rest)
    if motion.speed_at(t + rest) > 1e-6:
        assert motion.time_at(probe) == pytest.approx(t + rest, abs=1e-6)


def test_a_belt_stops_where_it_has_to_and_never_comes_further():
    motion = Motion()
    motion.aim(0, 0, 500, 2000)
    assert motion.travel_at(0.25) == 62.5
    assert motion.travel_at(1.25) == 562.5
    motion.aim(1.25, 562.5, 0, 2000)
    assert motion.travel_at(1.5) == motion.travel_at(100) == 625
    assert motion.time_at(625) == 1.5
    assert motion.time_at(625.001) == math.inf
    assert motion.time_at(600) == pytest.approx(1.25 + 0.25 - math.sqrt(2 * 25 / 2000))


def test_a_belt_that_never_ran_is_nowhere_else():
    assert Motion().time_at(0.1) == math.inf
    assert Motion().travel_at(9) == 0
