"""What is known of a line at one moment."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class LineState(StrEnum):
    """What a line is doing."""

    IDLE = "idle"
    """Nothing was begun since the daemon started."""
    ARMING = "arming"
    """On its way to run: job, devices and faces are brought in order, the belt stands."""
    RUNNING = "running"
    """Tiles are fed and get faces."""
    HOLDING = "holding"
    """Something was in doubt, or an operator said so: the belt stands, the printer holds."""
    DRAINING = "draining"
    """No tile is fed, the belt brings those with a face to the diverter."""
    STOPPED = "stopped"
    """The job ended, or was ended in order."""
    E_STOPPED = "e_stopped"
    """An emergency stop was pressed."""
    FAULTED = "faulted"
    """Something happened that the line can't go on from."""


MOVING = frozenset({LineState.RUNNING, LineState.DRAINING})
"""States in which the belt is meant to move."""

ACTIVE = MOVING | {LineState.ARMING}
"""States of a line that moves or is about to."""

RESTING = frozenset(LineState) - ACTIVE
"""States that only an operator leads out of."""


class Question(StrEnum):
    """What was asked of whoever runs the machine."""

    CHANGEOVER = "taking up the next job"
    DEVICES = "checking the devices"
    FACES = "finding out what became of the last faces"


class Then(StrEnum):
    """What comes once the tiles on the belt are through."""

    PRINT = "print"
    """More tiles of the same job."""
    END = "end"
    """The next job, or rest if there is none; or this one's last faces, should one have come back."""
    STOP = "stop"
    """Rest, as an operator ordered."""


@dataclass(frozen=True)
class Alarm:
    """An alarm that is up.

    Attributes
    ----------
    number
        Each alarm of a line has a higher one than all before.
    code, text
        What kind it is, and what happened.
    acked
        Whether an operator has acknowledged it.
    """

    number: int
    code: str
    text: str
    acked: bool = False


@dataclass(frozen=True)
class Line:
    """All that the state machine knows.

    Attributes
    ----------
    state
        What the line is doing.
    reason
        Why it holds, is e-stopped or faulted.
    missing
        Devices that don't answer. A daemon begins with all of its devices in it.
    e_stops
        Devices that tell of a pressed emergency stop.
    alarms
        Those that are up, oldest first; at most one of each code.
    raised
        Number of the newest alarm ever raised.
    asked
        The question that waits for its answer.
    then
        What comes once the belt is drained; kept through a hold.
    needs_job
        Whether the next arming takes up a job.
    """

    state: LineState = LineState.IDLE
    reason: str = ""
    missing: frozenset[str] = frozenset()
    e_stops: frozenset[str] = frozenset()
    alarms: tuple[Alarm, ...] = ()
    raised: int = 0
    asked: Question | None = None
    then: Then = Then.PRINT
    needs_job: bool = True

    @property
    def unacked(self) -> tuple[Alarm, ...]:
        """Alarms that nobody acknowledged."""
        return tuple(alarm for alarm in self.alarms if not alarm.acked)
