"""Every line that can come about, with every event: nothing is left to chance.

Numbers of alarms only ever get higher, and nothing but their order matters; so lines that differ in them alone are one.
With one code for every kind of trouble, one device that can be lost and two that tell of the button, that leaves some
thousand lines: all are visited, and every step of each is held against the rules.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import cache

import pytest

from tests.line_rules import OPERATOR, WORK, Watch, check_line, check_refusal
from tilefab.control import line_machine as machine
from tilefab.control.line_machine import Event, Line, LineState

CODE, TEXT = "x", "why"
EVENTS: tuple[Event, ...] = (
    *OPERATOR,
    *WORK,
    machine.ChangeoverReady(),
    machine.ChangeoverReady(False, TEXT, CODE),
    machine.DevicesReady(),
    machine.DevicesReady(False, TEXT, CODE),
    machine.Reconciled(),
    machine.Reconciled(True, 2),
    machine.Reconciled(False, 0, TEXT, CODE),
    machine.EStop("plc", True),
    machine.EStop("plc", False),
    machine.EStop("printer", True),
    machine.EStop("printer", False),
    machine.Doubt(CODE, TEXT),
    machine.Fault(CODE, TEXT),
    machine.Warn(CODE, TEXT),
    machine.DeviceLost("plc"),
    machine.DeviceBack("plc"),
)
Place = tuple[Line, Watch]


def told_apart(line: Line, watch: Watch) -> Place:
    """The same with alarms numbered from 1."""
    rank = {alarm.number: n for n, alarm in enumerate(line.alarms, start=1)}
    alarms = tuple(replace(alarm, number=rank[alarm.number]) for alarm in line.alarms)
    unacked = tuple((code, rank[number]) for code, number in watch.unacked)
    return replace(line, alarms=alarms, raised=len(alarms)), replace(watch, unacked=unacked)


def events_of(line: Line) -> tuple[Event, ...]:
    return (*EVENTS, *(machine.OperatorAck(up_to) for up_to in range(line.raised + 1)))


@cache
def places() -> tuple[frozenset[Place], int]:
    """All that can be reached, and by how many steps that was found out."""
    begin: Place = (Line(), Watch())
    seen, waiting, steps = {begin}, deque([begin]), 0
    while waiting:
        line, watch = waiting.popleft()
        for event in events_of(line):
            steps += 1
            after, actions = machine.step(line, event)
            check_line(after)
            place = told_apart(after, watch.see(line, event, after, actions))
            if place not in seen:
                seen.add(place)
                waiting.append(place)
    return frozenset(seen), steps


def test_every_step_from_every_line_keeps_the_rules() -> None:
    seen, steps = places()
    assert {line.state for line, _ in seen} == set(LineState)
    assert len(seen) > 1000
    assert steps > 20 * len(seen)


def test_orders_are_refused_in_words_or_followed() -> None:
    for line in {line for line, _ in places()[0]}:
        for order in OPERATOR:
            check_refusal(line, order)


def test_from_every_line_an_operator_can_get_it_to_run() -> None:
    """No line is ever lost for good."""
    for line in {line for line, _ in places()[0]}:
        after = line
        for event in (machine.DeviceBack("plc"), machine.EStop("plc", False), machine.EStop("printer", False)):
            after, _ = machine.step(after, event)
        while after.asked is not None and after.state is not LineState.ARMING:
            after, _ = machine.step(after, ANSWERS[after.asked])
        after, _ = machine.step(after, machine.OperatorAck(after.raised))
        for order in (machine.OperatorStart(), machine.OperatorResume()):
            after, _ = machine.step(after, order)
        while after.asked is not None:
            after, _ = machine.step(after, ANSWERS[after.asked])
        assert after.state in machine.MOVING, (line, after)


ANSWERS = {
    machine.Question.CHANGEOVER: machine.ChangeoverReady(),
    machine.Question.DEVICES: machine.DevicesReady(),
    machine.Question.FACES: machine.Reconciled(),
}


def test_no_order_is_refused_without_need() -> None:
    """A line at rest with nothing against it can be started or resumed."""
    for line in {line for line, _ in places()[0]}:
        free = not line.missing and not line.unacked and line.asked is None
        if free and line.state in (LineState.IDLE, LineState.STOPPED):
            assert not machine.refusal(line, machine.OperatorStart())
        if free and line.state is LineState.HOLDING:
            assert not machine.refusal(line, machine.OperatorResume())


@pytest.mark.parametrize("state", LineState)
def test_an_emergency_stop_wins_in_every_state(state: LineState) -> None:
    for line in {line for line, _ in places()[0] if line.state is state}:
        after, actions = machine.step(line, machine.EStop("kiln", pressed=True))
        assert after.state is LineState.E_STOPPED
        assert actions[:2] == (machine.StopBelt(), machine.HoldPrinter())
        assert [type(action) for action in actions[2:]] == [machine.RaiseAlarm]


def test_every_kind_of_event_is_among_them() -> None:
    from typing import get_args

    assert {type(event) for event in events_of(Line())} == set(get_args(Event))
