"""What the state machine wants done; whoever runs it does them in order, before the next event is looked at."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StopBelt:
    """Stop belt and feed."""


@dataclass(frozen=True)
class RunBelt:
    """Run the belt, with or without feeding tiles."""

    feed: bool


@dataclass(frozen=True)
class HoldPrinter:
    """Let no further print begin."""


@dataclass(frozen=True)
class ClearPrinter:
    """Let the printer print."""


@dataclass(frozen=True)
class AckPlc:
    """Acknowledge what the conveyor's controller has latched, as it was read last; moves nothing."""


@dataclass(frozen=True)
class CancelArms:
    """Take back every face that the printer hasn't begun."""


@dataclass(frozen=True)
class BeginChangeover:
    """Make the next job the present one, unless it is already; answered once by `ChangeoverReady`."""


@dataclass(frozen=True)
class CheckDevices:
    """See that every device is in order and the kiln at the recipe; answered once by `DevicesReady`."""


@dataclass(frozen=True)
class Reconcile:
    """With the belt at rest, find out what became of every arm; answered once by `Reconciled`."""


@dataclass(frozen=True)
class RaiseAlarm:
    """An alarm was raised.

    Attributes
    ----------
    code, text
        As in `tilefab.pipeline.line.alarms`, and what happened.
    number
        Of the alarm: each is higher than all before.
    """

    code: str
    text: str
    number: int


@dataclass(frozen=True)
class ClearAlarms:
    """Alarms that were acknowledged are over."""


@dataclass(frozen=True)
class Note:
    """Put down for people what was decided."""

    text: str


Action = (
    StopBelt
    | RunBelt
    | HoldPrinter
    | ClearPrinter
    | AckPlc
    | CancelArms
    | BeginChangeover
    | CheckDevices
    | Reconcile
    | RaiseAlarm
    | ClearAlarms
    | Note
)
