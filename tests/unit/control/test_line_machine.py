"""The line's state machine, as its operator meets it."""

from __future__ import annotations

import pytest

from tilefab.control import line_machine as machine
from tilefab.control.line_machine import Action, Event, Line, LineState, Then

DEVICES = frozenset({"plc", "printer"})
UP = (machine.ChangeoverReady(), machine.DevicesReady(), machine.Reconciled())


def after(line: Line, *events: Event) -> Line:
    for event in events:
        line, _ = machine.step(line, event)
    return line


def done(line: Line, event: Event) -> tuple[Action, ...]:
    """What is to be done about an event, without the notes."""
    return tuple(action for action in machine.step(line, event)[1] if not isinstance(action, machine.Note))


def notes(line: Line, event: Event) -> str:
    return "; ".join(a.text for a in machine.step(line, event)[1] if isinstance(a, machine.Note))


def running() -> Line:
    line = after(Line(), machine.OperatorStart(), *UP)
    assert line.state is LineState.RUNNING
    return line


def draining() -> Line:
    return after(running(), machine.OperatorStop())


def arming() -> Line:
    return after(Line(), machine.OperatorStart())


ACTIVE = {"arming": arming, "running": running, "draining": draining}
active = pytest.mark.parametrize("line", [make() for make in ACTIVE.values()], ids=list(ACTIVE))


def test_a_start_asks_for_job_devices_and_faces_before_anything_moves() -> None:
    start = machine.OperatorStart()
    assert done(Line(), start) == (
        machine.ClearAlarms(),
        machine.StopBelt(),
        machine.HoldPrinter(),
        machine.BeginChangeover(),
    )
    line = after(Line(), start)
    assert done(line, machine.ChangeoverReady()) == (machine.CheckDevices(),)
    line = after(line, machine.ChangeoverReady())
    assert done(line, machine.DevicesReady()) == (machine.AckPlc(), machine.Reconcile())
    line = after(line, machine.DevicesReady())
    assert done(line, machine.Reconciled()) == (machine.ClearPrinter(), machine.RunBelt(feed=True))
    assert after(line, machine.Reconciled()).state is LineState.RUNNING


def test_a_job_that_is_open_is_not_taken_up_again() -> None:
    line = after(running(), machine.OperatorHold(), machine.OperatorResume())
    assert line.asked is machine.Question.DEVICES


def test_a_device_that_never_answered_is_waited_for() -> None:
    line = Line(missing=DEVICES)
    assert after(line, machine.OperatorStart()).state is LineState.IDLE
    assert machine.refusal(line, machine.OperatorStart()) == (
        "no answer from plc, printer: see to power and cable; the line notices by itself when it is back"
    )
    line = after(line, machine.DeviceBack("plc"), machine.DeviceBack("printer"))
    assert after(line, machine.OperatorStart()).state is LineState.ARMING


@active
@pytest.mark.parametrize(
    ("event", "code"),
    [
        (machine.Doubt("jam", "tiles are jammed"), "jam"),
        (machine.DeviceLost("printer", "no answer in 0.2 s"), "printer_lost"),
    ],
    ids=["doubt", "lost"],
)
def test_trouble_stops_belt_and_printer_in_the_same_step(line: Line, event: Event, code: str) -> None:
    held, actions = machine.step(line, event)
    assert held.state is LineState.HOLDING
    assert actions[:2] == (machine.StopBelt(), machine.HoldPrinter())
    assert isinstance(actions[2], machine.RaiseAlarm)
    assert actions[2].code == held.unacked[0].code == code
    assert held.reason == held.unacked[0].text


def test_a_lost_device_is_told_with_its_reason() -> None:
    line = after(running(), machine.DeviceLost("printer", "no answer in 0.2 s"))
    assert line.reason == "no answer from printer: no answer in 0.2 s"
    assert line.missing == {"printer"}


def test_a_device_lost_during_a_hold_wants_to_be_seen_as_well() -> None:
    line = after(running(), machine.OperatorHold(), machine.DeviceLost("plc"), machine.DeviceBack("plc"))
    assert (line.reason, [alarm.code for alarm in line.unacked]) == ("held by the operator", ["plc_lost"])


def test_at_rest_devices_may_be_switched_off_without_an_alarm() -> None:
    line = after(draining(), machine.Drained(job_done=False))
    assert line.state is LineState.STOPPED
    off = after(line, machine.DeviceLost("plc"))
    assert (off.state, off.alarms, off.missing) == (LineState.STOPPED, (), {"plc"})
    assert notes(line, machine.DeviceLost("plc")) == "no answer from plc"
    assert "no answer from plc" in machine.refusal(off, machine.OperatorStart())


def test_resume_wants_devices_acknowledgement_and_known_faces() -> None:
    resume = machine.OperatorResume()
    line = after(arming(), machine.ChangeoverReady(), machine.DevicesReady(), machine.DeviceLost("plc", "gone"))
    assert "no answer from plc" in machine.refusal(line, resume)
    line = after(line, machine.DeviceBack("plc"))
    assert machine.refusal(line, resume) == "not acknowledged: plc_lost; look at it, put it right, then acknowledge"
    line = after(line, machine.OperatorAck(line.raised))
    assert machine.refusal(line, resume) == (
        "the line is still finding out what became of the last faces: try again in a moment"
    )
    assert after(line, resume) == line
    assert notes(line, resume) == f"resume refused: {machine.refusal(line, resume)}"
    line = after(line, machine.Reconciled(ok=False, reason="given up"))
    assert line.state is LineState.HOLDING
    assert not machine.refusal(line, resume)
    line = after(line, resume)
    assert line.state is LineState.ARMING
    assert line.asked is machine.Question.DEVICES
    assert not line.alarms


def test_an_answer_that_comes_too_late_moves_nothing() -> None:
    line = after(arming(), machine.ChangeoverReady(), machine.DevicesReady(), machine.OperatorHold())
    assert done(line, machine.Reconciled()) == ()
    assert after(line, machine.Reconciled()).state is LineState.HOLDING
    assert done(after(line, machine.Reconciled(), machine.OperatorResume()), machine.Reconciled()) == ()


@pytest.mark.parametrize(
    ("events", "answer", "code"),
    [
        ((), machine.ChangeoverReady(ok=False, reason="no map"), "changeover_failed"),
        (UP[:1], machine.DevicesReady(ok=False, reason="jam"), "not_ready"),
        (UP[:1], machine.DevicesReady(ok=False, reason="jam", code="jam"), "jam"),
        (UP[:2], machine.Reconciled(ok=False, reason="belt moved"), "not_reconciled"),
        (UP[:2], machine.Reconciled(doubt=2, reason="faces 3 and 7 are in doubt"), "faces_in_doubt"),
    ],
)
def test_a_bad_answer_holds_with_its_reason(events: tuple[Event, ...], answer: Event, code: str) -> None:
    line = after(arming(), *events, answer)
    assert (line.state, line.asked) == (LineState.HOLDING, None)
    assert [(alarm.code, alarm.text) for alarm in line.unacked] == [(code, line.reason)]
    assert line.reason == answer.reason  # type: ignore[union-attr]
    again = after(line, machine.OperatorAck(line.raised), machine.OperatorResume())
    wanted = machine.Question.DEVICES if events else machine.Question.CHANGEOVER
    assert again.asked is wanted


def test_faces_in_doubt_are_counted_if_they_are_not_named() -> None:
    line = after(arming(), *UP[:2])
    assert after(line, machine.Reconciled(doubt=1)).reason == "1 face is in doubt"
    assert after(line, machine.Reconciled(doubt=2)).reason == "2 faces are in doubt"


def test_the_button_must_be_out_everywhere_and_acknowledged() -> None:
    line = after(running(), machine.EStop("plc", True), machine.EStop("printer", True))
    assert line.state is LineState.E_STOPPED
    line = after(line, machine.EStop("plc", False), machine.OperatorAck(line.raised))
    assert line.state is LineState.E_STOPPED
    assert "pull out the emergency stop" in machine.refusal(line, machine.OperatorStart())
    line = after(line, machine.EStop("printer", False))
    assert line.state is LineState.STOPPED
    assert after(line, machine.OperatorResume()).state is LineState.STOPPED
    assert after(line, machine.OperatorStart()).state is LineState.ARMING


def test_a_button_that_is_told_of_twice_was_pressed_once() -> None:
    line = after(running(), machine.EStop("plc", True))
    assert machine.step(line, machine.EStop("plc", True)) == (line, ())


def test_acknowledging_an_emergency_stop_lets_the_conveyor_unlatch_it() -> None:
    """The conveyor tells of the button as pressed until it was acknowledged, so the acknowledgement goes first."""
    line = after(running(), machine.EStop("plc", True))
    assert done(line, machine.OperatorAck(line.raised)) == (machine.AckPlc(),)


def test_an_acknowledgement_covers_only_what_was_seen() -> None:
    line = after(running(), machine.EStop("plc", True))
    seen = line.raised
    line = after(line, machine.EStop("plc", False), machine.EStop("plc", True), machine.EStop("plc", False))
    line = after(line, machine.OperatorAck(seen))
    assert line.state is LineState.E_STOPPED
    assert [alarm.number for alarm in line.unacked] == [line.raised]
    assert after(line, machine.OperatorAck(line.raised)).state is LineState.STOPPED


def test_what_is_told_again_in_the_same_words_is_one_alarm() -> None:
    jam = machine.Doubt("jam", "tiles are jammed")
    line = after(running(), jam)
    assert machine.step(line, jam) == (line, ())
    acked = after(line, machine.OperatorAck(line.raised))
    assert machine.step(acked, jam) == (acked, ())


def test_other_words_are_news() -> None:
    line = after(running(), machine.Doubt("partial", "face 5"))
    line = after(line, machine.OperatorAck(line.raised), machine.Doubt("partial", "face 6"))
    assert [(alarm.number, alarm.text, alarm.acked) for alarm in line.alarms] == [(2, "face 6", False)]


def test_the_same_trouble_after_a_resume_is_news() -> None:
    jam = machine.Doubt("jam", "tiles are jammed")
    line = after(running(), jam)
    line = after(line, machine.OperatorAck(1), machine.OperatorResume(), *UP[1:])
    assert (line.state, line.alarms) == (LineState.RUNNING, ())
    line = after(line, jam)
    assert [(alarm.number, alarm.acked) for alarm in line.alarms] == [(2, False)]


def test_trouble_of_which_a_running_line_was_warned_holds_it_all_the_same() -> None:
    line = after(running(), machine.Warn("kiln_zone", "zone 3"), machine.Doubt("kiln_zone", "zone 3"))
    assert line.state is LineState.HOLDING
    assert [alarm.number for alarm in line.unacked] == [2]


def test_a_warning_stops_nothing_but_wants_to_be_seen_before_the_next_resume() -> None:
    line = after(running(), machine.Warn("armed_late", "tile 7 got no face"))
    assert line.state is LineState.RUNNING
    assert len(line.unacked) == 1
    held = after(line, machine.OperatorHold())
    assert "armed_late" in machine.refusal(held, machine.OperatorResume())
    assert done(line, machine.OperatorAck(1)) == (machine.ClearAlarms(),)
    assert after(line, machine.OperatorAck(1)).alarms == ()


@active
def test_a_fault_needs_an_acknowledgement_and_a_start(line: Line) -> None:
    faulted, actions = machine.step(line, machine.Fault("journal", "disk full"))
    assert faulted.state is LineState.FAULTED
    assert actions[:2] == (machine.StopBelt(), machine.HoldPrinter())
    for order in (machine.OperatorStart(), machine.OperatorResume(), machine.OperatorStop()):
        assert after(faulted, order) == faulted
    assert after(faulted, machine.OperatorAck(0)).state is LineState.FAULTED
    assert after(faulted, machine.OperatorAck(faulted.raised)).state is LineState.STOPPED


def test_a_fault_under_an_emergency_stop_is_not_lost() -> None:
    line = after(running(), machine.EStop("plc", True))
    seen = line.raised
    line = after(line, machine.Fault("journal", "disk full"), machine.EStop("plc", False), machine.OperatorAck(seen))
    assert (line.state, [alarm.code for alarm in line.unacked]) == (LineState.E_STOPPED, ["journal"])


def test_a_stop_drains_what_has_a_face() -> None:
    line = running()
    assert done(line, machine.OperatorStop()) == (machine.RunBelt(feed=False),)
    line = after(line, machine.OperatorStop())
    assert (line.state, line.then) == (LineState.DRAINING, Then.STOP)
    assert machine.step(line, machine.OperatorStop()) == (line, ())
    assert done(line, machine.Drained(job_done=False)) == (machine.StopBelt(), machine.HoldPrinter())
    line = after(line, machine.Drained(job_done=False))
    assert (line.state, line.needs_job) == (LineState.STOPPED, False)


@pytest.mark.parametrize("line", [arming(), after(running(), machine.OperatorHold())], ids=["arming", "holding"])
def test_a_stop_of_a_line_that_stands_takes_faces_back(line: Line) -> None:
    assert done(line, machine.OperatorStop()) == (machine.StopBelt(), machine.HoldPrinter(), machine.CancelArms())
    assert after(line, machine.OperatorStop()).state is LineState.STOPPED


def test_an_ordered_stop_outlives_a_hold() -> None:
    line = after(draining(), machine.Doubt("jam", "x"), machine.OperatorAck(1), machine.OperatorResume(), *UP[1:])
    assert (line.state, line.then) == (LineState.DRAINING, Then.STOP)
    line = after(line, machine.Drained(job_done=True, more=True))
    assert (line.state, line.needs_job) == (LineState.STOPPED, True)


def test_the_end_of_a_job_leads_to_the_next_one() -> None:
    line = after(running(), machine.JobDone())
    assert (line.state, line.then) == (LineState.DRAINING, Then.END)
    drained = machine.Drained(job_done=True, more=True)
    assert done(line, drained) == (machine.StopBelt(), machine.HoldPrinter(), machine.BeginChangeover())
    line = after(line, drained)
    assert line.state is LineState.ARMING
    assert after(line, *UP).state is LineState.RUNNING


def test_the_end_of_the_last_job_is_rest() -> None:
    line = after(running(), machine.JobDone(), machine.Drained(job_done=True))
    assert (line.state, line.needs_job, line.then) == (LineState.STOPPED, True, Then.PRINT)


def test_a_face_that_comes_back_while_draining_is_printed_before_the_job_ends() -> None:
    line = after(running(), machine.JobDone())
    back = machine.Drained(job_done=False, more=True)
    assert done(line, back) == (machine.RunBelt(feed=True),)
    line = after(line, back)
    assert (line.state, line.needs_job, line.then) == (LineState.RUNNING, False, Then.PRINT)


def test_a_stop_ordered_at_the_end_of_a_job_keeps_the_next_one_waiting() -> None:
    line = after(running(), machine.JobDone(), machine.OperatorStop(), machine.Drained(job_done=True, more=True))
    assert (line.state, line.needs_job) == (LineState.STOPPED, True)


def test_a_job_that_ended_during_a_hold_is_not_gone_on_with() -> None:
    line = after(running(), machine.JobDone(), machine.OperatorHold(), machine.Drained(job_done=True, more=True))
    assert (line.state, line.needs_job) == (LineState.HOLDING, True)
    line = after(line, machine.OperatorResume())
    assert line.asked is machine.Question.CHANGEOVER
    assert after(line, *UP).state is LineState.RUNNING


def test_an_ordered_stop_holds_for_the_next_job_too() -> None:
    line = after(draining(), machine.OperatorHold(), machine.Drained(job_done=True, more=True))
    line = after(line, machine.OperatorResume(), *UP)
    assert (line.state, line.then) == (LineState.DRAINING, Then.STOP)


def test_a_start_forgets_a_stop_that_was_ordered_before() -> None:
    line = after(draining(), machine.Fault("defect", "x"), machine.OperatorAck(1), machine.OperatorStart(), *UP)
    assert (line.state, line.then) == (LineState.RUNNING, Then.PRINT)


def test_a_job_that_ends_after_a_hold_was_resumed_holds_again() -> None:
    line = after(running(), machine.JobDone(), machine.OperatorHold(), machine.OperatorResume())
    line = after(line, machine.Drained(job_done=True, more=True))
    assert (line.state, line.needs_job) == (LineState.HOLDING, True)
    line = after(line, machine.DevicesReady(ok=False, reason="given up"))
    assert after(line, machine.OperatorResume(), *UP).state is LineState.RUNNING


@pytest.mark.parametrize(
    ("line", "order", "words"),
    [
        (Line(), machine.OperatorResume(), "the line is idle: start it"),
        (Line(), machine.OperatorHold(), "nothing to hold"),
        (running(), machine.OperatorStart(), "the line is running already"),
        (running(), machine.OperatorResume(), "the line is running"),
        (draining(), machine.OperatorResume(), "wait until it has stopped, then start it"),
        (after(running(), machine.OperatorHold()), machine.OperatorStart(), "resume it, or stop it first"),
    ],
)
def test_refusals_say_what_to_do(line: Line, order: Event, words: str) -> None:
    assert words in machine.refusal(line, order)
    assert after(line, order) == line


def test_orders_that_change_nothing_are_no_mistakes() -> None:
    held = after(running(), machine.OperatorHold())
    assert machine.step(held, machine.OperatorHold()) == (held, ())
    assert machine.step(Line(), machine.OperatorStop()) == (Line(), ())


def test_a_line_is_small_however_long_it_is_troubled() -> None:
    line = running()
    for n in range(500):
        line = after(line, machine.Warn("armed_late", f"tile {n}"), machine.Warn("tile_missing", f"tile {n}"))
    assert len(line.alarms) == 2
    assert line.raised == 1000
