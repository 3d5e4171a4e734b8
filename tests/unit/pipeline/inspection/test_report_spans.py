"""Stops, alarms, kiln and shifts, from the notes of a line."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from tilefab.inspection.records import ColourFigures, Grade
from tilefab.io.inspection_records import InspectionRecord
from tilefab.io.journal import NoteRecord
from tilefab.pipeline.inspection.report_spans import kiln_zones, line_alarms, shade_lots, shifts, stops

T0 = datetime(2026, 11, 24, 5, 50, tzinfo=UTC)
S0 = T0.timestamp()


def note(minutes: float, kind: str, **detail: object) -> NoteRecord:
    return NoteRecord(1, T0 + timedelta(minutes=minutes), kind, detail)


def state(minutes: float, before: str, now: str, reason: str = "") -> NoteRecord:
    return note(minutes, "state", state=now, before=before, reason=reason)


def test_a_stop_lasts_until_the_line_runs_again() -> None:
    notes = [
        state(0, "arming", "running"),
        state(10, "running", "holding", "a jam"),
        state(12, "holding", "arming"),
        state(13, "arming", "running"),
        state(20, "running", "draining"),
        state(22, "draining", "stopped"),
    ]
    found = stops(notes, S0 + 3600)
    assert [(stop.begun_s - S0, (stop.ended_s or 0) - S0, stop.code, stop.text) for stop in found] == [
        (600, 780, "holding", "a jam")
    ]


def test_a_stop_that_no_one_ended_lasts_to_the_end() -> None:
    notes = [state(10, "running", "e_stopped", "pressed"), state(11, "e_stopped", "holding")]
    (stop,) = stops(notes, S0 + 3600)
    assert (stop.begun_s, stop.ended_s) == (S0 + 600, S0 + 3600)
    assert stop.code == "e_stopped"
    assert stops([], S0) == ()
    # Stopped in order during a hold: it is over then.
    (over,) = stops([state(1, "running", "holding"), state(4, "holding", "stopped")], S0 + 3600)
    assert over.ended_s == S0 + 240


def test_alarms_are_told_as_they_came() -> None:
    notes = [note(1, "alarm", number=1, code="jam", text="a tile is stuck"), state(2, "running", "holding")]
    (alarm,) = line_alarms(notes)
    assert (alarm.begun_s, alarm.code, alarm.text) == (S0 + 60, "jam", "a tile is stuck")


def test_the_kiln_over_time() -> None:
    notes = [note(m, "kiln", temperatures_degc=[500.0 + m, 1190.0], set_points_degc=[500.0, 1195.0]) for m in (0, 1, 2)]
    first, second = kiln_zones(notes)
    assert first.temp_degc == (500.0, 501.0, 502.0)
    assert (second.name, second.setpoint_degc) == ("zone 2", 1195.0)
    assert first.at_s == (S0, S0 + 60, S0 + 120)
    assert kiln_zones([]) == ()
    assert kiln_zones([note(0, "kiln", temperatures_degc="broken")]) == ()


def test_shifts_go_by_the_clock_of_the_factory() -> None:
    # 05:50 UTC is 06:50 there: the morning shift, until 14:00 there.
    found = shifts(S0, S0 + 12 * 3600, timedelta(hours=1))
    assert [shift.name for shift in found] == ["Tue 24 Nov, 06:00", "Tue 24 Nov, 14:00"]
    assert found[0].begun_s == datetime(2026, 11, 24, 5, 0, tzinfo=UTC).timestamp()
    assert found[0].ended_s == found[1].begun_s
    assert shifts(S0, S0 + 60, timedelta(hours=1)) == ()
    night = shifts(S0, S0 + 3600, timedelta(0))
    assert [shift.name for shift in night] == ["Mon 23 Nov, 22:00", "Tue 24 Nov, 06:00"]


def tile(lot: str, off: tuple[float, float, float], minutes: float) -> InspectionRecord:
    predicted = (60.0, 2.0, 10.0)
    fired = tuple(one + other for one, other in zip(predicted, off, strict=True))
    colour = ColourFigures(1, 2, 3, (0, 0), 1, 2, 0, 0, 0, fired, predicted)  # type: ignore[arg-type]
    at = T0 + timedelta(minutes=minutes)
    return InspectionRecord(1, "i", at, at, 1, 1, 1, 0, at, False, None, Grade.FIRST, 1.0, 1.0, lot, colour, None, None)


def test_lots_are_of_differences() -> None:
    tiles = [tile("B", (1.0, 0, 0), 5), tile("A", (0.2, 0, 0), 1), tile("A", (-0.2, 0, 0), 3), tile("", (9, 9, 9), 4)]
    first, second = shade_lots(tiles)
    assert (first.name, first.tiles, second.name) == ("A", 2, "B")
    assert first.difference_lab == pytest.approx((0.0, 0.0, 0.0))
    assert first.spread_delta_e == pytest.approx(0.2, rel=0.2)
    assert second.difference_lab[0] == pytest.approx(1.0)
    assert (first.first_s, first.last_s) == (S0 + 60, S0 + 180)
    assert first.rgb is not None
