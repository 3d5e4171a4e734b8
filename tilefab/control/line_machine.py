"""The line as a state machine: what it does about everything that may happen, as a pure function.

::

    IDLE -- start --> ARMING ------------> RUNNING -- stop, job done --> DRAINING --> STOPPED
                        ^  ^                  |                             |  |         |
                        |  '---- resume -- HOLDING <-- hold, doubt, lost ---'  |       start
                        |                                                      |         |
                        '-------------------- next job <-----------------------'  <------'

    any state -- e-stop --> E_STOPPED -- button out, all acknowledged --> STOPPED
    any other -- fault ---> FAULTED --- all acknowledged ---------------> STOPPED

ARMING puts up to three questions to whoever runs the machine, one after the other: `BeginChangeover` (if a job is to be
taken up), `CheckDevices` and `Reconcile`. Each must be answered exactly once, whatever state the line is in by then,
also when the work was given up (``ok=False``): until it is, start and resume are refused. So an answer can never be
taken for that of another arming.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from tilefab.control.line_actions import (
    AckPlc,
    Action,
    BeginChangeover,
    CancelArms,
    CheckDevices,
    ClearAlarms,
    ClearPrinter,
    HoldPrinter,
    Note,
    RaiseAlarm,
    Reconcile,
    RunBelt,
    StopBelt,
)
from tilefab.control.line_events import (
    ChangeoverReady,
    DeviceBack,
    DeviceLost,
    DevicesReady,
    Doubt,
    Drained,
    EStop,
    Event,
    Fault,
    JobDone,
    OperatorAck,
    OperatorHold,
    OperatorResume,
    OperatorStart,
    OperatorStop,
    Reconciled,
    Warn,
)
from tilefab.control.line_state import ACTIVE, MOVING, RESTING, Alarm, Line, LineState, Question, Then

__all__ = [
    "ACTIVE",
    "MOVING",
    "RESTING",
    "AckPlc",
    "Action",
    "Alarm",
    "BeginChangeover",
    "CancelArms",
    "ChangeoverReady",
    "CheckDevices",
    "ClearAlarms",
    "ClearPrinter",
    "DeviceBack",
    "DeviceLost",
    "DevicesReady",
    "Doubt",
    "Drained",
    "EStop",
    "Event",
    "Fault",
    "HoldPrinter",
    "JobDone",
    "Line",
    "LineState",
    "Note",
    "OperatorAck",
    "OperatorHold",
    "OperatorResume",
    "OperatorStart",
    "OperatorStop",
    "Question",
    "RaiseAlarm",
    "Reconcile",
    "Reconciled",
    "RunBelt",
    "StopBelt",
    "Then",
    "Warn",
    "refusal",
    "step",
]

Result = tuple[Line, tuple[Action, ...]]


def step(line: Line, event: Event) -> Result:
    """What a line becomes by an event, and what is to be done about it; defined for every state and event."""
    return _HANDLERS[type(event)](line, event)


def refusal(line: Line, event: Event) -> str:
    """Why an operator's order isn't followed now, for him to read; empty if it is."""
    match event:
        case OperatorStart():
            return _start_refusal(line)
        case OperatorResume():
            if line.state is not LineState.HOLDING:
                return _WHY_NO_RESUME[line.state]
            return _obstacle(line)
        case OperatorHold():
            return "" if line.state in ACTIVE or line.state is LineState.HOLDING else _AT_REST[line.state]
        case OperatorStop():
            if line.state in (LineState.E_STOPPED, LineState.FAULTED):
                return _AT_REST[line.state]
            return ""
        case _:
            return ""


def _start_refusal(line: Line) -> str:
    if line.state is LineState.HOLDING:
        return "the line is holding: resume it, or stop it first"
    if line.state in (LineState.E_STOPPED, LineState.FAULTED):
        return _AT_REST[line.state]
    if line.state in ACTIVE:
        return f"the line is {line.state} already"
    return _obstacle(line)


_AT_REST = {
    LineState.IDLE: "the line is idle: there is nothing to hold",
    LineState.STOPPED: "the line is stopped: there is nothing to hold",
    LineState.E_STOPPED: "the line is e-stopped: pull out the emergency stop, then acknowledge",
    LineState.FAULTED: "the line is faulted: put right what the alarm says, then acknowledge",
}
_WHY_NO_RESUME = {
    LineState.IDLE: "the line is idle: start it",
    LineState.STOPPED: "the line is stopped: start it",
    LineState.E_STOPPED: "the line is e-stopped: pull out the emergency stop and acknowledge, then start it",
    LineState.FAULTED: "the line is faulted: put right what the alarm says and acknowledge, then start it",
    LineState.ARMING: "the line is on its way to run already",
    LineState.RUNNING: "the line is running",
    LineState.DRAINING: "the line is draining: wait until it has stopped, then start it",
}


def _obstacle(line: Line) -> str:
    """What keeps a line at rest from running; empty if nothing does."""
    if line.missing:
        names = ", ".join(sorted(line.missing))
        return f"no answer from {names}: see to power and cable; the line notices by itself when it is back"
    if line.unacked:
        codes = ", ".join(alarm.code for alarm in line.unacked)
        return f"not acknowledged: {codes}; look at it, put it right, then acknowledge"
    if line.asked is not None:
        return f"the line is still {line.asked}: try again in a moment"
    return ""


# Orders


def _start(line: Line, event: OperatorStart) -> Result:
    why = refusal(line, event)
    if why:
        return line, (Note(f"start refused: {why}"),)
    return _arm(line, "started by the operator")


def _resume(line: Line, event: OperatorResume) -> Result:
    why = refusal(line, event)
    if why:
        return line, (Note(f"resume refused: {why}"),)
    return _arm(line, "resumed by the operator")


def _arm(line: Line, text: str) -> Result:
    """Bring a line at rest on its way; acknowledged alarms are over."""
    line = replace(line, state=LineState.ARMING, reason="", alarms=line.unacked)
    line, question = _ask(line, Question.CHANGEOVER if line.needs_job else Question.DEVICES)
    return line, (ClearAlarms(), Note(text), StopBelt(), HoldPrinter(), question)


def _ask(line: Line, question: Question) -> tuple[Line, Action]:
    return replace(line, asked=question), _QUESTIONS[question]


_QUESTIONS: dict[Question, Action] = {
    Question.CHANGEOVER: BeginChangeover(),
    Question.DEVICES: CheckDevices(),
    Question.FACES: Reconcile(),
}


def _operator_hold(line: Line, event: OperatorHold) -> Result:
    if line.state in ACTIVE:
        return _hold(line, "held by the operator")
    why = refusal(line, event)
    return line, (Note(f"hold refused: {why}"),) if why else ()


def _hold(line: Line, reason: str, *actions: Action) -> Result:
    return replace(line, state=LineState.HOLDING, reason=reason), (StopBelt(), HoldPrinter(), *actions, Note(reason))


def _stop(line: Line, event: OperatorStop) -> Result:
    match line.state:
        case LineState.RUNNING:
            line = replace(line, state=LineState.DRAINING, then=Then.STOP)
            return line, (RunBelt(feed=False), Note("stopping: tiles with a face are brought through"))
        case LineState.DRAINING:
            return replace(line, then=Then.STOP), ()
        case LineState.ARMING | LineState.HOLDING:
            line = replace(line, state=LineState.STOPPED, reason="", then=Then.PRINT)
            return line, (StopBelt(), HoldPrinter(), CancelArms(), Note("stopped by the operator"))
        case LineState.E_STOPPED | LineState.FAULTED:
            return line, (Note(f"stop refused: {refusal(line, event)}"),)
        case _:
            return line, ()


def _ack(line: Line, event: OperatorAck) -> Result:
    alarms = tuple(replace(alarm, acked=alarm.acked or alarm.number <= event.up_to) for alarm in line.alarms)
    if line.state in ACTIVE:
        # What was acknowledged while the line ran can't be what holds it.
        kept = tuple(alarm for alarm in alarms if not alarm.acked)
        return replace(line, alarms=kept), (ClearAlarms(),) if kept != line.alarms else ()
    line, actions = _leave_stop(replace(line, alarms=alarms))
    return line, (AckPlc(), *actions)


def _leave_stop(line: Line) -> Result:
    """From an emergency stop or a fault to rest, once the button is out and everything acknowledged."""
    if line.state not in (LineState.E_STOPPED, LineState.FAULTED) or line.e_stops or line.unacked:
        return line, ()
    return replace(line, state=LineState.STOPPED, reason=""), (Note(f"no longer {line.state}"),)


# Answers


def _changeover_ready(line: Line, event: ChangeoverReady) -> Result:
    if line.asked is not Question.CHANGEOVER:
        return line, ()
    line = replace(line, asked=None, needs_job=not event.ok)
    if line.state is not LineState.ARMING:
        return line, ()
    if not event.ok:
        return _hold_with(line, event.code, event.reason)
    line, question = _ask(line, Question.DEVICES)
    return line, (question,)


def _devices_ready(line: Line, event: DevicesReady) -> Result:
    if line.asked is not Question.DEVICES:
        return line, ()
    line = replace(line, asked=None)
    if line.state is not LineState.ARMING:
        return line, ()
    if not event.ok:
        return _hold_with(line, event.code, event.reason)
    line, question = _ask(line, Question.FACES)
    return line, (AckPlc(), question)


def _reconciled(line: Line, event: Reconciled) -> Result:
    if line.asked is not Question.FACES:
        return line, ()
    line = replace(line, asked=None)
    if line.state is not LineState.ARMING:
        return line, ()
    if not event.ok:
        return _hold_with(line, event.code, event.reason)
    if event.doubt:
        faces = "1 face is" if event.doubt == 1 else f"{event.doubt} faces are"
        return _hold_with(line, "faces_in_doubt", event.reason or f"{faces} in doubt")
    feed = line.then is Then.PRINT
    state = LineState.RUNNING if feed else LineState.DRAINING
    return replace(line, state=state), (ClearPrinter(), RunBelt(feed=feed), Note(f"{state}"))


# Trouble


def _raise(line: Line, code: str, text: str, *, anew: bool = False) -> Result:
    """Raise an alarm, in the place of an earlier one of its code; one that is up in the same words stays as it is."""
    same = next((alarm for alarm in line.alarms if alarm.code == code), None)
    if same is not None and same.text == text and not anew:
        return line, ()
    alarm = Alarm(line.raised + 1, code, text)
    others = tuple(other for other in line.alarms if other.code != code)
    return replace(line, alarms=(*others, alarm), raised=alarm.number), (RaiseAlarm(code, text, alarm.number),)


def _hold_with(line: Line, code: str, text: str) -> Result:
    """Hold because of an alarm: one that was up already must be acknowledged anew."""
    line, actions = _raise(line, code, text, anew=True)
    return _hold(line, text, *actions)


def _e_stop(line: Line, event: EStop) -> Result:
    if not event.pressed:
        return _leave_stop(replace(line, e_stops=line.e_stops - {event.device}))
    if event.device in line.e_stops:
        return line, ()
    text = "the emergency stop was pressed"
    line, actions = _raise(replace(line, e_stops=line.e_stops | {event.device}), "e_stop", text, anew=True)
    line = replace(line, state=LineState.E_STOPPED, reason=text, then=Then.PRINT)
    return line, (StopBelt(), HoldPrinter(), *actions)


def _doubt(line: Line, event: Doubt) -> Result:
    if line.state in ACTIVE:
        return _hold_with(line, event.code, event.reason)
    return _raise(line, event.code, event.reason)


def _fault(line: Line, event: Fault) -> Result:
    line, actions = _raise(line, event.code, event.reason, anew=line.state is not LineState.FAULTED)
    if line.state in (LineState.E_STOPPED, LineState.FAULTED):
        return line, actions
    line = replace(line, state=LineState.FAULTED, reason=event.reason, then=Then.PRINT)
    return line, (StopBelt(), HoldPrinter(), *actions)


def _warn(line: Line, event: Warn) -> Result:
    return _raise(line, event.code, event.reason)


def _device_lost(line: Line, event: DeviceLost) -> Result:
    line = replace(line, missing=line.missing | {event.name})
    text = f"no answer from {event.name}" + (f": {event.reason}" if event.reason else "")
    if line.state in ACTIVE:
        return _hold_with(line, f"{event.name}_lost", text)
    if line.state is LineState.HOLDING:
        return _raise(line, f"{event.name}_lost", text)
    # At rest devices may be switched off; start asks for them.
    return line, (Note(text),)


def _device_back(line: Line, event: DeviceBack) -> Result:
    if event.name not in line.missing:
        return line, ()
    return replace(line, missing=line.missing - {event.name}), (Note(f"{event.name} answers"),)


# Jobs


def _job_done(line: Line, _: JobDone) -> Result:
    if line.state is not LineState.RUNNING:
        return line, ()
    line = replace(line, state=LineState.DRAINING, then=Then.END)
    return line, (RunBelt(feed=False), Note("the job's last faces are on tiles"))


def _drained(line: Line, event: Drained) -> Result:
    stop = line.then is Then.STOP
    if event.job_done and not line.needs_job:
        line = replace(line, needs_job=True, then=Then.STOP if stop else Then.PRINT)
        if line.state in (LineState.ARMING, LineState.RUNNING):
            # It was held and resumed while the job was being ended: there is nothing left to go on with.
            return _hold(line, "the job ended in the meantime: resume for the next one")
    if line.state is not LineState.DRAINING:
        return line, ()
    line = replace(line, then=Then.PRINT)
    if not stop and not event.job_done:
        line = replace(line, state=LineState.RUNNING)
        return line, (RunBelt(feed=True), Note("drained, but faces came back: they are printed now"))
    if not stop and event.more:
        line, question = _ask(replace(line, state=LineState.ARMING), Question.CHANGEOVER)
        return line, (StopBelt(), HoldPrinter(), Note("drained: the next job is taken up"), question)
    return replace(line, state=LineState.STOPPED), (StopBelt(), HoldPrinter(), Note("drained and stopped"))


_HANDLERS: dict[type[Any], Callable[[Line, Any], Result]] = {
    OperatorStart: _start,
    OperatorHold: _operator_hold,
    OperatorResume: _resume,
    OperatorStop: _stop,
    OperatorAck: _ack,
    ChangeoverReady: _changeover_ready,
    DevicesReady: _devices_ready,
    Reconciled: _reconciled,
    EStop: _e_stop,
    Doubt: _doubt,
    Fault: _fault,
    Warn: _warn,
    DeviceLost: _device_lost,
    DeviceBack: _device_back,
    JobDone: _job_done,
    Drained: _drained,
}
