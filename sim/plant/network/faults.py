"""Faults of messages: which apply to which message, and what they make of an answer."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from sim.plant.wire.forge import Form, garbled, with_wrong

FORGED_KINDS = frozenset({"wrong_unit", "wrong_function", "wrong_count", "old_tid"})
MESSAGE_KINDS = FORGED_KINDS | {
    *("mute", "late", "twice", "garble", "truncate", "noise", "reorder", "drop", "half_open", "replay"),
}
Acts = Literal["now", "late", "never"]
_MOST_NOISE = 24


@dataclass
class Fault:
    """A fault of messages.

    Attributes
    ----------
    device
        Device or one of its connections, such as `plc` or `plc_rtu`.
    count
        How many messages it still strikes; None for any number.
    probability
        Of striking a message that it could.
    until
        Wall time (s) at which it ends; None for never.
    delay_s
        How late an answer comes, or for how long a swapped one is held back.
    acts
        Whether the device still does what it was asked when its answer is lost or late.
    match
        Function code or message type that it strikes; None for all.
    skip
        Messages to leave alone first.
    """

    device: str
    kind: str
    chance: random.Random
    count: int | None = 1
    probability: float = 1.0
    until: float | None = None
    delay_s: float = 0.3
    acts: Acts = "now"
    match: int | None = None
    skip: int = 0
    anywhere: bool = False
    struck: int = 0


@dataclass(frozen=True)
class Plan:
    """What is to be done about a message."""

    faults: tuple[Fault, ...] = ()

    def kind(self, kind: str) -> Fault | None:
        """The fault of a kind that strikes, if one does."""
        return next((fault for fault in self.faults if fault.kind == kind), None)


class FaultBook:
    """Faults that are set now; counts of those that struck."""

    def __init__(self) -> None:
        self._faults: list[Fault] = []
        self.struck: dict[str, int] = {}

    def add(self, fault: Fault) -> None:
        """Set a fault."""
        self._faults.append(fault)

    def clear(self) -> None:
        """Take all faults away."""
        self._faults.clear()

    @property
    def active(self) -> int:
        """How many faults are set."""
        return len(self._faults)

    def strike(self, names: Sequence[str], label: int, now: float) -> Plan:
        """Find out which faults strike a message, and count them down.

        Parameters
        ----------
        names
            Names that the device goes by.
        label
            Function code or message type.
        now
            Wall time (s).
        """
        if not self._faults:
            return Plan()
        striking = []
        for fault in [*self._faults]:
            if fault.until is not None and now >= fault.until:
                self._faults.remove(fault)
                continue
            if fault.device not in names or (fault.match is not None and fault.match != label):
                continue
            if fault.skip:
                fault.skip -= 1
                continue
            if fault.chance.random() >= fault.probability:
                continue
            striking.append(fault)
            fault.struck += 1
            key = f"{fault.device}.{fault.kind}"
            self.struck[key] = self.struck.get(key, 0) + 1
            if fault.count is not None:
                fault.count -= 1
                if fault.count <= 0:
                    self._faults.remove(fault)
        return Plan(tuple(striking))


@dataclass
class Link:
    """One connection, as the faults see it; `revive` ends the deafness of one that can't be opened anew."""

    send: Callable[[bytes], None]
    drop: Callable[[], None]
    later: Callable[[float, Callable[[], None]], None]
    form: Form
    deaf: bool = False
    last: bytes = b""
    held: bytes = b""
    revive: Callable[[], None] | None = None

    def flush(self) -> None:
        """Send the answer that was held back."""
        held, self.held = self.held, b""
        if held:
            self.send(held)


def answer_through(plan: Plan, link: Link, act: Callable[[], bytes | None]) -> None:
    """Do what a message asks and answer it, as far as the faults that strike it let it.

    Parameters
    ----------
    plan
        Faults that strike.
    link
        Where the answer goes.
    act
        Does what is asked and gives the answer; None for no answer.
    """
    if link.deaf:
        return
    half_open = plan.kind("half_open")
    if half_open:
        link.deaf = True
        if link.revive:
            link.later(half_open.delay_s, link.revive)
        return
    lost = plan.kind("mute") or plan.kind("drop")
    if lost:
        if lost.acts != "never":
            act()
        if lost.kind == "drop":
            link.drop()
        return
    late = plan.kind("late")
    if late and late.acts == "late":
        link.later(late.delay_s, lambda: _answer(plan, link, act()))
    elif late:
        reply = act()
        link.later(late.delay_s, lambda: _answer(plan, link, reply))
    else:
        _answer(plan, link, act())


def _answer(plan: Plan, link: Link, reply: bytes | None) -> None:
    if reply is None or link.deaf:
        return
    true = reply
    # What is wrong in content is made of a whole answer, once: after that it may be damaged in any way.
    for fault in [fault for fault in plan.faults if fault.kind in FORGED_KINDS][:1]:
        reply = with_wrong(link.form, reply, fault.kind, fault.chance)
    for fault in plan.faults:
        reply = _distorted(fault, link, reply)
    link.last = true
    swapped = plan.kind("reorder")
    if swapped:
        link.flush()
        link.held = reply
        link.later(swapped.delay_s, link.flush)
        return
    link.send(reply)
    if plan.kind("twice"):
        link.send(reply)
    link.flush()


def _distorted(fault: Fault, link: Link, reply: bytes) -> bytes:
    if fault.kind == "garble":
        return garbled(link.form, reply, fault.chance, anywhere=fault.anywhere)
    if fault.kind == "truncate":
        return reply[: fault.chance.randrange(1, max(2, len(reply)))]
    if fault.kind == "noise":
        return fault.chance.randbytes(fault.chance.randrange(1, _MOST_NOISE)) + reply
    if fault.kind == "replay":
        return link.last or reply
    return reply
