"""What may happen to a line: what an operator orders, what its devices tell, what the daemon found out."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OperatorStart:
    """Begin to print, from rest."""


@dataclass(frozen=True)
class OperatorHold:
    """Stop the belt at once and keep everything as it is."""


@dataclass(frozen=True)
class OperatorResume:
    """Go on from a hold."""


@dataclass(frozen=True)
class OperatorStop:
    """Feed no further tile, bring those with a face through, and rest."""


@dataclass(frozen=True)
class OperatorAck:
    """Acknowledge alarms that were seen.

    Attributes
    ----------
    up_to
        Number of the newest alarm that the operator had before his eyes: later ones stay unacknowledged.
    """

    up_to: int


@dataclass(frozen=True)
class ChangeoverReady:
    """Answer to `BeginChangeover`: whether the next job is now the present one; if not, why, and the alarm's code."""

    ok: bool = True
    reason: str = ""
    code: str = "changeover_failed"


@dataclass(frozen=True)
class DevicesReady:
    """Answer to `CheckDevices`: whether all are in order, nothing latched but dead-men, the kiln at the recipe."""

    ok: bool = True
    reason: str = ""
    code: str = "not_ready"


@dataclass(frozen=True)
class Reconciled:
    """Answer to `Reconcile`.

    Attributes
    ----------
    ok
        Whether what became of every arm is in the journal.
    doubt
        Faces that were newly found to be in doubt.
    reason
        Why not, if not ok; which faces, if any are in doubt.
    code
        Of the alarm, if not ok.
    """

    ok: bool = True
    doubt: int = 0
    reason: str = ""
    code: str = "not_reconciled"


@dataclass(frozen=True)
class EStop:
    """A device's emergency stop was pressed, or is pressed no more.

    Attributes
    ----------
    device
        The device that tells: one button may be told of by several, and all must say that it is out.
    pressed
        Which of the two.
    """

    device: str
    pressed: bool


@dataclass(frozen=True)
class Doubt:
    """Something isn't as it must be. The same may be told again and again while it lasts, in the same words."""

    code: str
    reason: str


@dataclass(frozen=True)
class Fault:
    """Something after which the line can't go on."""

    code: str
    reason: str


@dataclass(frozen=True)
class Warn:
    """Something an operator should see, without stopping for it."""

    code: str
    reason: str


@dataclass(frozen=True)
class DeviceLost:
    """A device doesn't answer any more."""

    name: str
    reason: str = ""


@dataclass(frozen=True)
class DeviceBack:
    """A device answers, for the first time or again."""

    name: str


@dataclass(frozen=True)
class JobDone:
    """No face of the job wants a tile any more, as far as is known; told again while it is so."""


@dataclass(frozen=True)
class Drained:
    """No tile with a face is left before the diverter; told again while it is so.

    Attributes
    ----------
    job_done
        Whether every face of the job got its tile: one that was missed on the way wants another.
    more
        Whether another job waits.
    """

    job_done: bool
    more: bool = False


Event = (
    OperatorStart
    | OperatorHold
    | OperatorResume
    | OperatorStop
    | OperatorAck
    | ChangeoverReady
    | DevicesReady
    | Reconciled
    | EStop
    | Doubt
    | Fault
    | Warn
    | DeviceLost
    | DeviceBack
    | JobDone
    | Drained
)
