"""The line's journal, as its inspector reads it: what was printed and corrected, without ever being in the way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta

from tilefab.errors import JournalError
from tilefab.io.journal import CorrectionRecord, Journal, PrintRecord, RunRecord
from tilefab.pipeline.inspection.expected import ExpectedTiles

_RUNS = 8
"""Latest runs whose tiles are looked for, whenever they were printed."""

_WHOLE_FOR = timedelta(seconds=30)
"""All prints of a run are read anew after this."""


class LineJournal:
    """Follows the journal; opens it anew when reading fails.

    Parameters
    ----------
    look
        Opens it to read.
    expected
        Told of what was printed.
    """

    def __init__(self, look: Callable[[], Journal], expected: ExpectedTiles) -> None:
        self._look, self.expected = look, expected
        self._journal: Journal | None = None
        self._corrections: dict[int, tuple[CorrectionRecord, ...]] = {}
        self._whole: dict[int, tuple[datetime, Mapping[int, Sequence[PrintRecord]]]] = {}
        self.runs: Mapping[int, RunRecord] = {}
        self.problem = ""

    def close(self) -> None:
        """Close it; twice is once."""
        if self._journal is not None:
            self._journal.close()
            self._journal = None

    def follow(self, now: datetime, seen: Callable[[Sequence[int]], frozenset[int]]) -> bool:
        """Take in what is new; whether the journal could be read. ``problem`` tells why not.

        ``seen`` says which of some arms' tiles were seen.
        """
        try:
            if self._journal is None:
                self._journal = self._look()
            journal = self._journal
            self.runs = {run.run_id: run for run in journal.runs(last=_RUNS)}
            self.expected.update(now, lambda since: journal.prints(since=since), seen)
            for run in self.runs.values():
                made = self.corrections(run.run_id)
                if run.correction != (made[-1].number if made else 0):
                    self._corrections[run.run_id] = tuple(journal.corrections(run.run_id))
        except JournalError as error:
            self.problem = error.message
            self.close()
            return False
        self.problem = ""
        self._corrections = {run_id: made for run_id, made in self._corrections.items() if run_id in self.runs}
        return True

    @property
    def present(self) -> RunRecord | None:
        """The run that printed last."""
        run_id = self.expected.newest_run
        return None if run_id is None else self.runs.get(run_id)

    def corrections(self, run_id: int) -> Sequence[CorrectionRecord]:
        """Corrections of a run, rising."""
        return self._corrections.get(run_id, ())

    def correction(self, run_id: int, number: int) -> CorrectionRecord | None:
        """A correction of a run; ``None`` for 0, as the job says."""
        return next((made for made in self.corrections(run_id) if made.number == number), None)

    def whole_run(self, run_id: int, now: datetime) -> Mapping[int, Sequence[PrintRecord]]:
        """All arms of a run that printed, by face; none if the journal can't be read just now."""
        kept = self._whole.get(run_id)
        if kept is not None and timedelta(0) <= now - kept[0] < _WHOLE_FOR:
            return kept[1]
        if self._journal is None:
            return {}
        by_face: dict[int, list[PrintRecord]] = {}
        try:
            for record in self._journal.prints(run_id):
                by_face.setdefault(record.face, []).append(record)
        except JournalError as error:
            self.problem = error.message
            self.close()
            return {}
        self._whole = {run: kept for run, kept in self._whole.items() if run in self.runs} | {run_id: (now, by_face)}
        return by_face
