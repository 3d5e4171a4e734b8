"""Which faces a fired tile can show: those printed lately whose tiles weren't seen yet."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence, Set
from datetime import datetime, timedelta
from statistics import median

from tilefab.control.ledger import ArmState
from tilefab.io.journal import PrintRecord

_OVERLAP = timedelta(minutes=2)
"""Arms of the last minutes are read again: what became of their tiles changes."""
TRANSITS = 51
"""Latest tiles whose ways tell how long one usually takes."""
_LONGEST_CYCLE_MIN = 75.0
"""As long as a kiln takes; what a tile's way is taken for before any came out."""


class ExpectedTiles:
    """Follows a line's journal.

    Parameters
    ----------
    window
        How long a tile may be under way from printer to camera.
    clock_rate
        How much faster than the clock on the wall the line goes.
    """

    def __init__(self, window: timedelta, clock_rate: float = 1.0) -> None:
        self._window = window
        self._longest = timedelta(minutes=_LONGEST_CYCLE_MIN) / clock_rate
        self._prints: dict[int, PrintRecord] = {}
        self._arms_of: dict[tuple[int, int], set[int]] = {}
        self._unseen: set[int] = set()
        self._transits: deque[float] = deque(maxlen=TRANSITS)
        self._newest: datetime | None = None
        self._last_of: dict[int, datetime] = {}

    def update(
        self,
        now: datetime,
        prints: Callable[[datetime], Sequence[PrintRecord]],
        seen: Callable[[Sequence[int]], frozenset[int]],
    ) -> None:
        """Take in what was printed since the last time.

        Parameters
        ----------
        now
            The time.
        prints
            Reads arms printed since some moment.
        seen
            Says which of some arms' tiles were seen. Asked once for each arm.
        """
        begin = now - 2 * self._window
        if self._newest is not None:
            # The newest may be of a clock that was ahead.
            begin = max(begin, min(self._newest, now) - _OVERLAP)
        found = prints(begin)
        fresh = [record.arm_id for record in found if record.arm_id not in self._prints]
        self._unseen |= set(fresh) - (seen(fresh) if fresh else frozenset())
        for record in found:
            self._prints[record.arm_id] = record
            self._arms_of.setdefault((record.run_id, record.face), set()).add(record.arm_id)
            self._last_of[record.run_id] = max(record.printed_at, self._last_of.get(record.run_id, record.printed_at))
        if found:
            self._newest = max(record.printed_at for record in found)
        # A clock that was set forward must not make everything forgotten at once: the newest count as of now.
        oldest = min(now, self._newest or now) - 2 * self._window
        for arm_id in [arm_id for arm_id, record in self._prints.items() if record.printed_at < oldest]:
            self._forget(arm_id)
        self._last_of = {run_id: at for run_id, at in self._last_of.items() if at >= oldest}

    def candidates(self, taken_at: datetime) -> Mapping[int, list[int]]:
        """Faces by run that a tile seen at a moment can show; the run that it is of most likely comes first."""
        begin = taken_at - self._window
        by_run: dict[int, list[PrintRecord]] = {}
        for arm_id in self._unseen:
            record = self._prints[arm_id]
            if begin <= record.printed_at <= taken_at and record.state is not ArmState.DIVERTED:
                by_run.setdefault(record.run_id, []).append(record)
        transit = self.transit

        def unlikeliness(run_id: int) -> tuple[float, int]:
            records = by_run[run_id]
            if transit is None:
                return -len(records), -run_id
            return min(abs((taken_at - r.printed_at - transit).total_seconds()) for r in records), -run_id

        return {run_id: sorted({r.face for r in by_run[run_id]}) for run_id in sorted(by_run, key=unlikeliness)}

    @property
    def runs(self) -> tuple[int, ...]:
        """Runs that printed anything lately, in the order in which they did so last."""
        return tuple(sorted(self._last_of, key=lambda run_id: (self._last_of[run_id], run_id)))

    @property
    def newest_run(self) -> int | None:
        """The run that printed last."""
        return self.runs[-1] if self._last_of else None

    def print_of(self, run_id: int, face: int, taken_at: datetime) -> tuple[PrintRecord | None, bool]:
        """The arm that put a face on a tile seen at a moment, and whether its tile was seen before.

        A face that was printed more than once: the arm whose tile wasn't seen and whose time fits best.
        """
        records = [self._prints[arm_id] for arm_id in self._arms_of.get((run_id, face), ())]
        seen = {record.arm_id for record in records} - self._unseen
        return chosen_print(records, seen, taken_at, self.transit)

    @property
    def transit(self) -> timedelta | None:
        """Usual time from printer to camera; ``None`` before any tile was seen."""
        return timedelta(seconds=median(self._transits)) if self._transits else None

    def saw(self, record: PrintRecord, taken_at: datetime) -> None:
        """Take in that an arm's tile was seen."""
        self._unseen.discard(record.arm_id)
        self.took(taken_at - record.printed_at)

    def took(self, way: timedelta) -> None:
        """Take in how long a tile was under way from printer to camera."""
        if timedelta(0) <= way <= self._window:
            self._transits.append(way.total_seconds())

    def _forget(self, arm_id: int) -> None:
        record = self._prints.pop(arm_id)
        self._unseen.discard(arm_id)
        arms = self._arms_of[record.run_id, record.face]
        arms.discard(arm_id)
        if not arms:
            del self._arms_of[record.run_id, record.face]

    def leaving(self, begin: datetime, end: datetime) -> int:
        """How many tiles should have come to the camera after ``begin``, up to ``end``."""
        transit = self.transit or self._longest
        return sum(
            begin < record.printed_at + transit <= end
            for record in self._prints.values()
            if record.state is ArmState.PASSED
        )


def chosen_print(
    records: Sequence[PrintRecord], seen: Set[int], taken_at: datetime, transit: timedelta | None
) -> tuple[PrintRecord | None, bool]:
    """Of the arms that printed a face, the one whose tile is seen at a moment; and whether it was seen before."""
    unseen = [r for r in records if r.arm_id not in seen and r.state is not ArmState.DIVERTED]
    able = [r for r in unseen if r.printed_at <= taken_at] or unseen
    if not able:
        known = [r for r in records if r.arm_id in seen]
        return (max(known, key=lambda r: r.arm_id), True) if known else (None, False)
    if transit is None:
        return min(able, key=lambda r: r.arm_id), False
    return min(able, key=lambda r: (abs(taken_at - r.printed_at - transit), r.arm_id)), False
