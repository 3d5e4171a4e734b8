"""What a line must never do, held against whatever happens to it: shared by tests and `benchmarks/line_machine.py`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tilefab.control import line_machine as machine
from tilefab.control.line_machine import Action, Event, Line, LineState

DEVICES = ("plc", "printer", "kiln")
QUESTIONS = (machine.BeginChangeover, machine.CheckDevices, machine.Reconcile)
ANSWERS = {
    machine.ChangeoverReady: machine.BeginChangeover,
    machine.DevicesReady: machine.CheckDevices,
    machine.Reconciled: machine.Reconcile,
}
TROUBLE = (machine.Doubt, machine.Fault, machine.DeviceLost)


@dataclass(frozen=True)
class Watch:
    """Keeps book of a line by events and actions alone, and fails where a rule is broken.

    Attributes
    ----------
    belt, feed, printer
        Whether belt and feed run and the printer may print, as ordered.
    licence
        Whether an operator said go, and nothing has spoken against it since.
    settled
        Whether it was found out, under this licence, what became of every face.
    pressed, missing
        Devices that tell of a pressed emergency stop, and those that don't answer.
    unacked
        Number of each alarm that nobody acknowledged, by code, as sorted pairs.
    open
        The question without an answer.
    """

    belt: bool = False
    feed: bool = False
    printer: bool = False
    licence: bool = False
    settled: bool = False
    pressed: frozenset[str] = frozenset()
    missing: frozenset[str] = frozenset()
    unacked: tuple[tuple[str, int], ...] = ()
    open: type[Action] | None = None

    def see(self, before: Line, event: Event, after: Line, actions: Iterable[Action]) -> Watch:
        """Follow one step; raises `AssertionError` where it breaks a rule."""
        actions = tuple(actions)
        now = self._told(event)
        if isinstance(event, machine.OperatorStart | machine.OperatorResume) and after.state is not before.state:
            assert before.state in machine.RESTING, "only a line at rest is started"
            assert not now.unacked, "started over an alarm"
            assert not now.missing, "started without a device"
            assert not now.pressed, "started against an emergency stop"
            assert now.open is None, "started while something was still being found out"
            now = replace(now, licence=True, settled=False)
        elif before.state in machine.RESTING:
            assert after.state not in machine.ACTIVE, "it started by itself"
        if self._against(event):
            assert after.state not in machine.ACTIVE, "it went on over trouble"
            if before.state in machine.ACTIVE:
                kinds = {type(action) for action in actions}
                assert {machine.StopBelt, machine.HoldPrinter} <= kinds, "trouble didn't stop it in the same step"
        for action in actions:
            now = now._done(action)
        now._agrees_with(after)
        return now

    def _against(self, event: Event) -> bool:
        """Whether an event speaks against going on."""
        return isinstance(event, TROUBLE) or (isinstance(event, machine.EStop) and event.pressed)

    def _told(self, event: Event) -> Watch:
        match event:
            case machine.EStop(device, pressed):
                pushed = self.pressed | {device} if pressed else self.pressed - {device}
                now = replace(self, pressed=pushed)
            case machine.DeviceLost(name):
                now = replace(self, missing=self.missing | {name})
            case machine.DeviceBack(name):
                now = replace(self, missing=self.missing - {name})
            case machine.OperatorAck(up_to):
                now = replace(self, unacked=tuple(pair for pair in self.unacked if pair[1] > up_to))
            case _:
                now = self
        question = ANSWERS.get(type(event))
        if question is not None and question is self.open:
            now = replace(now, open=None)
            if event == machine.Reconciled():
                now = replace(now, settled=True)
        if self._against(event) or isinstance(event, machine.OperatorHold):
            now = replace(now, licence=False, settled=False)
        return now

    def _done(self, action: Action) -> Watch:
        match action:
            case machine.RunBelt(feed):
                self._may_move()
                assert self.printer, "the belt runs before the printer is ready"
                return replace(self, belt=True, feed=feed)
            case machine.ClearPrinter():
                self._may_move()
                return replace(self, printer=True)
            case machine.StopBelt():
                return replace(self, belt=False, feed=False)
            case machine.HoldPrinter():
                return replace(self, printer=False)
            case machine.RaiseAlarm(code, _, number):
                assert all(number > other for _, other in self.unacked), "numbers of alarms must rise"
                others = [pair for pair in self.unacked if pair[0] != code]
                return replace(self, unacked=tuple(sorted([*others, (code, number)])))
            case machine.BeginChangeover() | machine.CheckDevices() | machine.Reconcile():
                assert self.licence, "asked without an operator's leave"
                assert self.open is None, "asked two things at once"
                assert not self.belt, "asked while the belt runs"
                assert not self.printer, "asked while the printer may print"
                return replace(self, open=type(action), settled=False)
        return self

    def _may_move(self) -> None:
        assert self.licence, "moved without an operator's leave"
        assert self.settled, "moved before it was found out what became of the last faces"
        assert self.open is None, "moved while something was still being found out"
        assert not self.pressed, "moved against an emergency stop"
        assert not self.missing, "moved without a device"

    def _agrees_with(self, line: Line) -> None:
        """The state says what was ordered."""
        assert self.belt is (line.state in machine.MOVING), "the belt does other than the state says"
        assert self.printer is self.belt, "the printer does other than the belt"
        assert self.feed is (line.state is LineState.RUNNING), "the feed does other than the state says"
        assert self.pressed == line.e_stops, "a button was forgotten"
        assert self.missing == line.missing, "a device was forgotten"
        assert dict(self.unacked) == {alarm.code: alarm.number for alarm in line.unacked}, "an alarm was lost"
        assert (self.open is not None) is (line.asked is not None), "a question was forgotten"


def check_line(line: Line) -> None:
    """What is true of a line at any time."""
    state = line.state
    assert not line.e_stops or state is LineState.E_STOPPED
    if state in machine.ACTIVE:
        assert not line.missing
        assert not line.reason
    if state is LineState.ARMING:
        assert line.asked is not None
    if state in machine.MOVING:
        assert line.asked is None
        assert not line.needs_job
    if state is LineState.E_STOPPED:
        assert line.e_stops or line.unacked
    if state is LineState.FAULTED:
        assert line.unacked
    if state in machine.RESTING - {LineState.HOLDING}:
        assert line.then is machine.Then.PRINT, "a start would not print"
    if state in (LineState.HOLDING, LineState.E_STOPPED, LineState.FAULTED):
        assert line.reason
    numbers = [alarm.number for alarm in line.alarms]
    assert numbers == sorted(set(numbers))
    assert not numbers or numbers[-1] <= line.raised
    assert len({alarm.code for alarm in line.alarms}) == len(numbers)


def check_refusal(line: Line, event: Event) -> None:
    """An order is refused in words, or followed; a refused one changes nothing."""
    why = machine.refusal(line, event)
    after, actions = machine.step(line, event)
    noted = [action.text for action in actions if isinstance(action, machine.Note) and " refused: " in action.text]
    if why:
        assert after == line
        assert noted
        assert noted[0].endswith(why)
        assert len(actions) == 1
    else:
        assert not noted


OPERATOR = [machine.OperatorStart(), machine.OperatorHold(), machine.OperatorResume(), machine.OperatorStop()]
WORK = [machine.JobDone(), *(machine.Drained(done, more) for done in (False, True) for more in (False, True))]
CODES = st.sampled_from(["jam", "partial", "e_stop", "plc_lost", "journal"])
TEXTS = st.sampled_from(["one", "another"])
NAMES = st.sampled_from(DEVICES)


class LineRules(RuleBasedStateMachine):
    """Anything may happen to a line, in any order; the rules hold."""

    @initialize(missing=st.frozensets(NAMES))
    def begin(self, missing: frozenset[str]) -> None:
        self.line = Line(missing=missing)
        self.watch = Watch(missing=missing)

    def happens(self, event: Event) -> None:
        check_refusal(self.line, event)
        after, actions = machine.step(self.line, event)
        self.watch = self.watch.see(self.line, event, after, actions)
        self.line = after

    @rule(order=st.sampled_from(OPERATOR))
    def order(self, order: Event) -> None:
        self.happens(order)

    @rule(data=st.data())
    def ack(self, data: st.DataObject) -> None:
        self.happens(machine.OperatorAck(data.draw(st.integers(0, self.line.raised))))

    @rule()
    def put_in_order(self) -> None:
        """What an operator does after trouble: all devices on, buttons out, everything acknowledged."""
        for name in sorted(self.line.missing):
            self.happens(machine.DeviceBack(name))
        for name in sorted(self.line.e_stops):
            self.happens(machine.EStop(name, pressed=False))
        self.happens(machine.OperatorAck(self.line.raised))

    @rule(stop_before=st.sampled_from([0, 1, 2, 3, 3, 3]))
    def bring_up(self, stop_before: int) -> None:
        """What an operator does to have it run, up to so many answers."""
        self.put_in_order()
        while self.line.asked is not None and self.line.state is not LineState.ARMING:
            self.answer_asked(ok=False, doubt=0)
        resumed = self.line.state is LineState.HOLDING
        self.happens(machine.OperatorResume() if resumed else machine.OperatorStart())
        for _ in range(stop_before):
            if self.line.asked is not None:
                self.answer_asked(ok=True, doubt=0)

    @precondition(lambda self: self.line.asked is not None)
    @rule(ok=st.sampled_from([True, True, True, False]), doubt=st.sampled_from([0, 0, 0, 2]))
    def answer(self, ok: bool, doubt: int) -> None:
        self.answer_asked(ok, doubt)

    def answer_asked(self, ok: bool, doubt: int) -> None:
        match self.line.asked:
            case machine.Question.CHANGEOVER:
                self.happens(machine.ChangeoverReady(ok, "" if ok else "no"))
            case machine.Question.DEVICES:
                self.happens(machine.DevicesReady(ok, "" if ok else "no"))
            case _:
                self.happens(machine.Reconciled(ok, doubt if ok else 0, "" if ok else "no"))

    @rule(event=st.sampled_from([machine.ChangeoverReady(), machine.DevicesReady(), machine.Reconciled()]))
    def stray_answer(self, event: Event) -> None:
        self.happens(event)

    @precondition(lambda self: self.line.state in machine.ACTIVE)
    @rule(event=st.sampled_from(WORK))
    def work(self, event: Event) -> None:
        self.happens(event)

    @rule(event=st.sampled_from(WORK))
    def stray_work(self, event: Event) -> None:
        self.happens(event)

    @rule(device=NAMES, pressed=st.booleans())
    def e_stop(self, device: str, pressed: bool) -> None:
        self.happens(machine.EStop(device, pressed))

    @rule(code=CODES, text=TEXTS, kind=st.sampled_from([machine.Doubt, machine.Fault, machine.Warn]))
    def trouble(self, code: str, text: str, kind: type[Event]) -> None:
        self.happens(kind(code, text))

    @rule(name=NAMES, back=st.booleans())
    def device(self, name: str, back: bool) -> None:
        self.happens(machine.DeviceBack(name) if back else machine.DeviceLost(name, "no answer in 0.2 s"))

    @invariant()
    def holds(self) -> None:
        check_line(self.line)
