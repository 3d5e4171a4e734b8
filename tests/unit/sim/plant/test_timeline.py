"""The order and the exact times of what happens."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.plant.physics.timeline import Timeline


def test_everything_happens_in_order_at_its_own_time_and_travel():
    line, seen = Timeline(2.0, 10.0), []

    def note(name):
        return lambda: seen.append((name, line.t, line.x, line.wall))

    line.set_speed(100, 100)
    line.at_travel(50, note("travel"))
    line.at_time(0.5, note("time"))
    line.at_wall(11.0, note("wall"))
    line.at_travel(250, note("far"), rank=1)
    line.at_travel(250, note("far first"), rank=0)
    line.advance(20)
    assert seen == [
        ("time", 0.5, 12.5, 10.25),
        ("travel", 1.0, 50, 10.5),
        ("wall", 2.0, 150, 11.0),
        ("far first", 3.0, 250, 11.5),
        ("far", 3.0, 250, 11.5),
    ]
    assert (line.t, line.x, line.wall) == (20, 1950, 20)


def test_what_happens_can_change_what_happens_next():
    line, seen = Timeline(1.0, 0.0), []
    line.set_speed(100, 1e9)

    def stop():
        line.set_speed(0, 1000)
        line.at_time(line.t + 1, lambda: seen.append(line.x))

    line.at_travel(200, stop)
    line.at_travel(300, lambda: seen.append("never"))
    line.advance(10)
    assert seen == [pytest.approx(205)]
    assert line.speed == 0


def test_another_rate_moves_what_is_due_at_a_plant_time_and_not_what_is_due_at_a_wall_time():
    line, seen = Timeline(1.0, 0.0), []
    line.at_wall(5, lambda: seen.append(("wall", line.wall, line.t)))
    line.at_time(100, lambda: seen.append(("plant", line.wall, line.t)))
    line.advance(1)
    line.set_rate(100)
    line.advance(6)
    assert seen == [("plant", pytest.approx(1.99), 100), ("wall", 5, pytest.approx(401))]


def test_an_earlier_wall_time_changes_nothing():
    line = Timeline(1.0, 0.0)
    line.set_speed(10, 1e9)
    line.advance(5)
    x = line.x
    line.advance(3)
    assert (line.t, line.x, line.wall) == (5, x, 5)


@given(st.lists(st.floats(0, 2000), max_size=30), st.lists(st.floats(0.01, 3), max_size=30), st.floats(1, 1000))
def test_travel_never_goes_back_and_is_never_short_of_what_happened(places, steps, rate):
    line, seen = Timeline(rate, 0.0), []
    for place in places:
        line.at_travel(place, lambda place=place: seen.append((place, line.x, line.t)))
    wall = 0.0
    for i, step in enumerate(steps):
        wall += step
        line.advance(wall)
        line.set_speed([300, 0, 20][i % 3], 500)
    assert [entry[0] for entry in seen] == sorted(entry[0] for entry in seen)
    assert [entry[1] for entry in seen] == sorted(entry[1] for entry in seen)
    assert [entry[2] for entry in seen] == sorted(entry[2] for entry in seen)
    assert all(x == pytest.approx(place, abs=1e-9) for place, x, _ in seen)
    line.advance(wall)
    assert (
        sum(place < line.x - 1e-6 for place in places) <= len(seen) <= sum(place <= line.x + 1e-6 for place in places)
    )
