"""What goes to the controller comes out as proposals, holds and signals of charts; runs are told apart."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tilefab.control.drift_control import start_control
from tilefab.control.drift_control_state import ControlSettings
from tilefab.control.drift_events import CorrectionApplied, Rejected, Tick, TileMeasured
from tilefab.pipeline.inspection.correcting import (
    RUN_NUMBERS,
    control_number,
    control_settings,
    follow_corrections,
    learn,
    quiet,
)
from tilefab.pipeline.inspection.remembering import PressState, RunState, press_state, run_state

SETTINGS = ControlSettings(least_interval_s=600.0, fewest_tiles=3)
ZERO = np.zeros(3)


def press(settings: ControlSettings = SETTINGS) -> PressState:
    """A press whose state is its L*, a* and b* themselves."""
    return PressState(start_control(np.eye(3), now_s=0.0, settings=settings))


def tile(number: int, lab: tuple[float, float, float], *, at_s: float, correction: int = 0) -> TileMeasured:
    """A tile that was seen at once, with a noise of 0.1."""
    information = np.eye(3) / 0.01
    return TileMeasured(
        tile=number,
        correction=correction,
        fired_at_s=at_s,
        measured_at_s=at_s,
        at=ZERO,
        information=information,
        vector=information @ np.array(lab),
        effect=np.eye(3),
        watch=np.eye(3),
    )


def test_numbers_of_corrections_are_told_apart_over_runs() -> None:
    assert control_number(3, 0) == 3 * RUN_NUMBERS
    assert control_number(3, 2) - control_number(3, 1) == 1
    with pytest.raises(ValueError, match="fewer than"):
        control_number(3, RUN_NUMBERS)


def test_settings_come_from_the_lines_file() -> None:
    usual = ControlSettings()
    assert control_settings(10.0, 0.25).least_interval_s == 600.0
    assert control_settings(10.0, 0.25).walk_per_hour == pytest.approx(usual.walk_per_hour)
    assert control_settings(10.0, 0.5).walk_per_hour == pytest.approx(4.0 * usual.walk_per_hour)


def test_tiles_that_are_off_lead_to_a_proposal_and_charted_innovations() -> None:
    state = follow_corrections(press(), 1, [], ZERO, now_s=0.0, in_use=True)
    assert state is not None
    proposals = []
    for number in range(30):
        event = tile(number, (1.0, 0.0, 0.0), at_s=60.0 * (number + 1), correction=control_number(1, 0))
        learnt = learn(state, [event])
        state = learnt.state
        (charted,) = learnt.innovations
        assert charted.innovation.tile == number
        proposals += [learnt.proposal] if learnt.proposal is not None else []
    assert proposals
    assert proposals[0].mean == pytest.approx([1.0, 0.0, 0.0], abs=0.15)


def test_unreadable_images_hold_corrections_and_good_tiles_release_them() -> None:
    state = press()
    held, released = [], []
    for number in range(60):
        learnt = learn(state, [Rejected(10.0 * number, "black")])
        state = learnt.state
        held += [hold.code for hold in learnt.holds]
    for number in range(60):
        learnt = learn(state, [tile(number, (0.0, 0.0, 0.0), at_s=1000.0 + 10.0 * number)])
        state = learnt.state
        released += [release.code for release in learnt.releases]
    assert held
    assert set(held) == set(released)


def test_a_value_that_goes_on_being_off_is_told_by_its_charts() -> None:
    """Tiles that walk away faster than the controller thinks they can."""
    state = press(ControlSettings(walk_per_hour=1e-6, adaptation=0.0))
    told: list[tuple[int, str]] = []
    signals: list[str] = []
    for number in range(60):
        learnt = learn(state, [tile(number, (0.0, 0.008 * number, 0.0), at_s=20.0 * number)])
        state = learnt.state
        told += learnt.drifting
        signals += [signal for charted in learnt.innovations for signal in charted.signals]
    assert {place for place, _ in told} == {1}
    assert "a* of tiles comes out higher" in told[0][1]
    assert {"a:ewma+", "a:cusum+"} <= set(signals)
    assert not any(signal.startswith(("a:ewma-", "a:cusum-")) for signal in signals)
    assert not quiet(state, 1)
    assert quiet(press(), 1)


def test_tiles_that_arent_believed_dont_move_the_charts() -> None:
    state = press()
    for number in range(20):
        state = learn(state, [tile(number, (0.0, 0.0, 0.0), at_s=20.0 * number)]).state
    learnt = learn(state, [tile(99, (40.0, -40.0, 40.0), at_s=401.0)])
    (charted,) = learnt.innovations
    assert not charted.innovation.accepted
    assert charted.signals == ()
    assert learnt.state.charts == state.charts


def test_a_tile_that_is_told_of_twice_is_ignored() -> None:
    learnt = learn(press(), [tile(1, (0.0, 0.0, 0.0), at_s=1.0), tile(1, (0.0, 0.0, 0.0), at_s=2.0)])
    assert len(learnt.innovations) == 1
    assert len(learnt.ignored) == 1


def test_corrections_of_a_run_are_told_once_and_in_order() -> None:
    made = [(1, np.array([1.0, 0.0, 0.0])), (2, np.array([2.0, 0.0, 0.0]))]
    state = follow_corrections(press(), 5, made, ZERO, now_s=10.0, in_use=True)
    assert state is not None
    numbers = [number for number, _ in state.control.corrections]
    assert numbers[-3:] == [control_number(5, 0), control_number(5, 1), control_number(5, 2)]
    assert state.control.applied == pytest.approx([2.0, 0.0, 0.0])
    assert follow_corrections(state, 5, made, ZERO, now_s=20.0, in_use=True) is None


def test_a_run_that_isnt_printed_any_more_doesnt_take_the_place_of_the_present_one() -> None:
    state = follow_corrections(press(), 5, [], ZERO, now_s=10.0, in_use=True)
    assert state is not None
    late = follow_corrections(state, 4, [(1, np.ones(3))], ZERO, now_s=20.0, in_use=False)
    assert late is not None
    assert late.control.corrections[-1][0] == control_number(4, 1)
    again = follow_corrections(late, 5, [], ZERO, now_s=20.0, in_use=True)
    assert again is not None
    assert again.control.corrections[-1][0] == control_number(5, 0)
    assert follow_corrections(again, 4, [(1, np.ones(3))], ZERO, now_s=30.0, in_use=False) is None


def test_a_new_run_on_a_known_press_is_corrected_at_once() -> None:
    state = follow_corrections(press(), 1, [], ZERO, now_s=0.0, in_use=True)
    assert state is not None
    for number in range(40):
        event = tile(number, (1.5, 0.0, 0.0), at_s=60.0 * (number + 1), correction=control_number(1, 0))
        learnt = learn(state, [event])
        state = learnt.state
        if learnt.proposal is not None:
            at_s = 60.0 * (number + 1)
            state = learn(state, [CorrectionApplied(control_number(1, 1), at_s, learnt.proposal.mean)]).state
    before = state.control.corrected_s
    begun = follow_corrections(state, 2, [], ZERO, now_s=60.0 * 41 + 700.0, in_use=True)
    assert begun is not None
    assert begun.control.corrected_s == before
    learnt = learn(begun, [Tick(60.0 * 41 + 701.0, firing=True)])
    assert learnt.proposal is not None
    assert learnt.proposal.mean == pytest.approx([1.5, 0.0, 0.0], abs=0.1)


def test_a_press_about_which_nothing_is_known_is_not_corrected_at_a_runs_beginning() -> None:
    state = follow_corrections(press(), 1, [], ZERO, now_s=0.0, in_use=True)
    assert state is not None
    assert learn(state, [Tick(5000.0, firing=True)]).proposal is None


def test_what_is_remembered_goes_on_as_if_nothing_had_been() -> None:
    state = follow_corrections(press(), 1, [(1, np.ones(3))], ZERO, now_s=0.0, in_use=True)
    assert state is not None
    for number in range(12):
        event = tile(number, (0.05 * number, 0.0, 0.0), at_s=20.0 * number, correction=control_number(1, 0))
        state = learn(state, [event]).state
    again = press_state(state.text(), SETTINGS)
    event = tile(50, (0.7, 0.1, 0.0), at_s=300.0, correction=control_number(1, 1))
    assert learn(again, [event]).state.text() == learn(state, [event]).state.text()
    assert again.charts == state.charts


@pytest.mark.parametrize("text", ["{}", "5", "[]", '{"schema_version": 2}', '{"schema_version": 1}', "no json"])
def test_what_cant_be_remembered_is_refused(text: str) -> None:
    with pytest.raises(ValueError):
        press_state(text, SETTINGS)
    with pytest.raises(ValueError):
        run_state(text)


def test_a_runs_state_is_the_same_after_a_restart() -> None:
    state = RunState(reference_lab=(60.0, 1.0, 2.0), defects=((("chip", 0.0), ("nozzle_line", 40.5)), ()))
    assert run_state(state.text()) == state
    assert run_state(RunState().text()) == RunState()
    assert json.loads(state.text())["schema_version"] == 1


def test_a_run_of_more_corrections_than_the_controller_keeps_is_followed_to_its_last() -> None:
    state = press()
    made: list[tuple[int, np.ndarray]] = []
    for number in range(1, 201):
        made.append((number, np.full(3, number / 100.0)))
        told = follow_corrections(state, 1, made, ZERO, now_s=300.0 * number, in_use=True)
        assert told is not None
        state = told
        assert state.control.applied == pytest.approx(made[-1][1])
        # Told once: nothing is new at the next round, so the interval runs.
        assert follow_corrections(state, 1, made, ZERO, now_s=300.0 * number + 1.0, in_use=True) is None
    # Another run comes and goes; the first one is still at its last.
    other = follow_corrections(state, 2, [(1, np.ones(3))], ZERO, now_s=70_000.0, in_use=True)
    assert other is not None
    assert other.control.applied == pytest.approx(np.ones(3))
    assert follow_corrections(other, 1, made, ZERO, now_s=70_001.0, in_use=False) is None
