"""The run that a line prints now: its job, its faces, and the jobs that come after it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

from tilefab.control.ledger import ArmState, FaceQueue
from tilefab.errors import InterlockError, JournalError, TilefabError
from tilefab.io.journal import ArmChange, CorrectionRecord
from tilefab.pipeline.line.book import INTENTS_AHEAD, FaceBook
from tilefab.pipeline.line.host import LineHost
from tilefab.pipeline.line.jobs import LineJob
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource

_RUNS_LOOKED_AT = 1000


class PresentRun:
    """Takes jobs out of the queue, and keeps faces of the present one put down ahead.

    Parameters
    ----------
    host
        The line.
    keeper
        The journal.
    jobs
        What to print, in this order.
    open_source
        Opens the faces of a job; blocking, run in a thread.
    strip_rows
        Rows of a face that are rendered at once.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(
        self,
        host: LineHost,
        keeper: JournalKeeper,
        jobs: Sequence[LineJob],
        open_source: Callable[[LineJob, int], FaceSource],
        strip_rows: int,
        probe: Probe = nothing,
    ) -> None:
        self._host, self._keeper, self._probe = host, keeper, probe
        self._open_source, self._strip_rows = open_source, strip_rows
        self.jobs: deque[LineJob] = deque(jobs)
        """The present job, and those that wait."""
        self.job: LineJob | None = None
        self.source: FaceSource | None = None
        self.book: FaceBook | None = None
        self.correction: CorrectionRecord | None = None
        """What coming faces are printed with; ``None``: as the job's file says."""
        self._filling: asyncio.Task[None] | None = None

    async def use_journal(self) -> None:
        """Open a journal that was lost anew; what comes next is read from it, as after a restart."""
        if await self._keeper.reopen_if_lost() and (book := self.book) is not None:
            states = await self._keeper.call(lambda journal: journal.face_states(book.run_id))
            self.book = FaceBook(book.run_id, FaceQueue(states))

    async def take(self) -> bool:
        """Open the job that comes first in the queue, unless it is open; whether it was opened now.

        Raises
        ------
        InterlockError
            If there is none, or it can't be printed: then it left the queue.
        """
        await self._drop_finished()
        if self.book is not None:
            return False
        if not self.jobs:
            raise InterlockError("no job waits: queue one", device="line", code="changeover_failed")
        job = self.jobs[0]
        try:
            source = await asyncio.to_thread(self._open_source, job, self._strip_rows)
            run_id = await self._keeper.start_run(job.run_facts(source))
        except TilefabError as error:
            # It can't be begun or gone on with as it is; those behind it must not wait for it.
            self.jobs.popleft()
            why = f"{error.message}; {job.plan.name} was taken out of the queue"
            raise InterlockError(why, device="line", code="changeover_failed") from error
        states, correction = await self._keeper.call(
            lambda journal: (journal.face_states(run_id), journal.latest_correction(run_id))
        )
        self.job, self.source, self.book = job, source, FaceBook(run_id, FaceQueue(states))
        self.correction = correction
        return True

    async def _drop_finished(self) -> None:
        """Take jobs out of the queue that were printed before, as those that a restarted daemon is given again."""
        runs = await self._keeper.call(lambda journal: journal.runs(last=_RUNS_LOOKED_AT))
        finished = {run.facts.job_hash: run.facts.faces for run in runs if run.finished_at is not None}
        while self.book is None and self.jobs:
            job = self.jobs[0]
            if job.plan.job.tile.count > finished.get(job.plan.job_hash, 0):
                return
            self.jobs.popleft()
            self._host.warn(
                "job_refused",
                f"all faces of {job.plan.name} were printed: for more of them raise its count, for others change its "
                "seed, for single ones order reprints",
            )

    async def end(self) -> None:
        """Put down that the job is done, once nothing of it is written any more."""
        book = self.book
        if book is None:
            return
        await self._keeper.call(lambda journal: journal.finish_run(book.run_id))
        self._probe("run.finished")
        self.book = self.source = self.job = self.correction = None
        self.jobs.popleft()

    def use_correction(self, book: FaceBook, record: CorrectionRecord) -> None:
        """Print the faces of a run that aren't put down yet with a correction, unless a later one is in use."""
        if self.book is None or self.book.run_id != book.run_id:
            return
        if self.correction is None or record.number > self.correction.number:
            self.correction = record

    # Faces.

    def want_faces(self, start: Callable[[FaceBook], asyncio.Task[None]]) -> None:
        """Have faces put down if there are few left; ``start`` starts `fill` as a task."""
        if self._filling is None and self.book is not None and len(self.book.pool) < INTENTS_AHEAD // 2:
            self._filling = start(self.book)

    async def fill(self, book: FaceBook) -> None:
        """Put down the next faces, so that tiles never wait for a disk."""
        try:
            while len(book.pool) < INTENTS_AHEAD and (faces := book.queue.take(INTENTS_AHEAD - len(book.pool))):
                book.coming = len(faces)
                number = self.correction.number if self.correction is not None else 0
                book.pool.extend(await self._keeper.intend(book.run_id, faces, number))
                book.coming = 0
        except JournalError as error:
            # Faces that were taken come back when the line is brought up.
            self._host.fault("journal", error.message)
        finally:
            self._filling = None
        self.expect(book)

    def expect(self, book: FaceBook) -> None:
        """Let the coming faces be planned."""
        if self._host.streamer is not None:
            self._host.streamer.expect([intent.face for intent in book.pool])

    async def filled(self) -> None:
        """Wait until no face is being put down."""
        if self._filling is not None:
            await asyncio.wait([self._filling])

    async def give_up_pool(self) -> None:
        """Say of faces that no tile came for that they weren't printed."""
        book = self.book
        if book is None:
            return
        intents = list(book.pool)
        book.pool.clear()
        changes = [ArmChange(intent.arm_id, ArmState.UNPRINTED, reason="no tile came for it") for intent in intents]
        with suppress(JournalError):
            await self._keeper.mark(changes, "reconcile")
            for intent in intents:
                book.queue.give_back(intent.face, intent.attempt, ArmState.UNPRINTED)
