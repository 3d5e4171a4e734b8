"""What may become of a face on the line: states of an arm, the ways between them, and which faces come next.

An *arm* is one attempt to print one face on one tile. A face is never printed again by itself once any row of it may
have been printed: only ``UNPRINTED`` puts it back, or an operator who orders a reprint.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

MOST_FACES = 1 << 40
"""Most faces of a run."""


class ArmState(StrEnum):
    """What is known of an arm."""

    INTENT = "intent"
    """Put down, and perhaps sent to the printer."""
    ARMED = "armed"
    """Accepted by the printer."""
    PRINTED = "printed"
    """Every row printed; its tile is on its way to the diverter."""
    PASSED = "passed"
    """Its tile went to the kiln."""
    DIVERTED = "diverted"
    """Its tile went to scrap."""
    PARTIAL = "partial"
    """Some rows printed; its tile goes to scrap."""
    UNPRINTED = "unprinted"
    """No row printed: the face comes again."""
    IN_DOUBT = "in_doubt"
    """Can't be decided; its tile goes to scrap, and an operator settles what becomes of the face."""


OPEN = frozenset({ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED})
"""States that the line itself still leaves."""

FINAL = frozenset({ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL, ArmState.UNPRINTED})
"""States that nothing leaves."""

UNSETTLED = OPEN | {ArmState.IN_DOUBT}
"""States that something still leaves: a face has at most one such arm."""

TRANSITIONS: Mapping[ArmState, frozenset[ArmState]] = {
    ArmState.INTENT: frozenset(
        {ArmState.ARMED, ArmState.UNPRINTED, ArmState.IN_DOUBT, ArmState.PRINTED, ArmState.PARTIAL}
    ),
    ArmState.ARMED: frozenset({ArmState.PRINTED, ArmState.PARTIAL, ArmState.UNPRINTED, ArmState.IN_DOUBT}),
    ArmState.PRINTED: frozenset({ArmState.PASSED, ArmState.DIVERTED, ArmState.IN_DOUBT}),
    ArmState.IN_DOUBT: frozenset({ArmState.PASSED, ArmState.DIVERTED, ArmState.UNPRINTED}),
}
"""Where each state may lead; only an operator leads out of doubt."""


def check_transition(old: ArmState, new: ArmState, *, by_operator: bool = False) -> None:
    """Refuse a change of an arm that the ledger doesn't know.

    Parameters
    ----------
    old, new
        States before and after.
    by_operator
        Whether a person said so; nobody else settles a doubt.

    Raises
    ------
    ValueError
        If an arm can't go this way.
    """
    if new not in TRANSITIONS.get(old, frozenset()):
        raise ValueError(f"an arm that is {old} can't become {new}")
    if by_operator != (old is ArmState.IN_DOUBT):
        who = "settle" if old is ArmState.IN_DOUBT else "change"
        raise ValueError(
            f"an arm that is {old} isn't for {'an operator' if by_operator else 'the line'} to {who} to {new}"
        )


@dataclass(frozen=True)
class FaceStates:
    """Where the faces of a run stand, without listing those that nothing is special about.

    Attributes
    ----------
    faces
        How many faces the run has, 1 to 2**40.
    next_new
        Every face from here on was never tried.
    gaps
        Ranges ``[begin, end)`` of faces below ``next_new`` that were never tried.
    unprinted
        Faces to come again, each with its last attempt.
    reprints
        Faces that an operator ordered again, each with its last attempt, oldest order first.
    unsettled
        Faces under way or in doubt, with the attempt and its state.
    """

    faces: int
    next_new: int = 0
    gaps: tuple[tuple[int, int], ...] = ()
    unprinted: tuple[tuple[int, int], ...] = ()
    reprints: tuple[tuple[int, int], ...] = ()
    unsettled: tuple[tuple[int, int, ArmState], ...] = ()


class FaceQueue:
    """Which faces come next: those to come again, then reprints, then those never tried, each in order.

    Holds only exceptions, so a run may have 2**40 faces.

    Parameters
    ----------
    states
        Where the faces stand, as the journal has it.

    Examples
    --------
    >>> queue = FaceQueue(FaceStates(faces=3))
    >>> queue.take(2)
    [(0, 1), (1, 1)]
    >>> queue.give_back(0, 1, ArmState.UNPRINTED)
    >>> queue.take(5)
    [(0, 2), (2, 1)]
    """

    def __init__(self, states: FaceStates) -> None:
        if not 1 <= states.faces <= MOST_FACES or not 0 <= states.next_new <= states.faces:
            raise ValueError(f"a run of {states.faces} faces can't go on with face {states.next_new}")
        self.faces = states.faces
        self._next_new = states.next_new
        self._gaps = deque(states.gaps)
        self._in_gaps = sum(end - begin for begin, end in states.gaps)
        self._again = [(face, attempt + 1) for face, attempt in states.unprinted]
        heapq.heapify(self._again)
        self._reprints = deque((face, attempt + 1) for face, attempt in states.reprints)
        self._waiting = {*self._again, *self._reprints}

    @property
    def remaining(self) -> int:
        """How many faces still want to be taken."""
        return len(self._again) + len(self._reprints) + self._in_gaps + self.faces - self._next_new

    def take(self, most: int = 1) -> list[tuple[int, int]]:
        """Next faces, each with the number of the attempt (the first is 1); fewer, or none, at the run's end."""
        taken: list[tuple[int, int]] = []
        while len(taken) < most and (found := self._take_one()) is not None:
            taken.append(found)
        return taken

    def give_back(self, face: int, attempt: int, state: ArmState) -> None:
        """Say what became of an attempt that was taken; the face comes again if no row of it was printed."""
        self._check(face, attempt)
        again = (face, attempt + 1)
        if state is ArmState.UNPRINTED and again not in self._waiting:
            self._waiting.add(again)
            heapq.heappush(self._again, again)

    def reprint(self, face: int, attempt: int) -> None:
        """Append an operator's reprint, which the journal has put down as this attempt; twice is once."""
        self._check(face, attempt)
        if (face, attempt) not in self._waiting:
            self._waiting.add((face, attempt))
            self._reprints.append((face, attempt))

    def _check(self, face: int, attempt: int) -> None:
        if not 0 <= face < self.faces or attempt < 1:
            raise ValueError(f"attempt {attempt} of face {face} isn't one of a run of {self.faces} faces")

    def _take_one(self) -> tuple[int, int] | None:
        if self._again or self._reprints:
            found = heapq.heappop(self._again) if self._again else self._reprints.popleft()
            self._waiting.remove(found)
            return found
        if self._gaps:
            begin, end = self._gaps.popleft()
            if begin + 1 < end:
                self._gaps.appendleft((begin + 1, end))
            self._in_gaps -= 1
            return begin, 1
        if self._next_new < self.faces:
            self._next_new += 1
            return self._next_new - 1, 1
        return None
