"""The journal as the line's loop uses it: in a thread of its own, so that a slow disk never holds up the loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import TypeVar

from tilefab.control.ledger import ArmState
from tilefab.errors import JournalError
from tilefab.io.journal import ArmChange, ArmRecord, Intent, Journal, RunFacts
from tilefab.pipeline.line.probe import Probe, nothing

_T = TypeVar("_T")


class JournalKeeper:
    """Runs a journal in one thread.

    Parameters
    ----------
    url, line
        As for `Journal.open`.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(self, url: str, line: str, probe: Probe = nothing) -> None:
        self._url, self._line, self._probe = url, line, probe
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="tilefab-journal")
        self._journal: Journal | None = None
        self._asked = 0
        self._waiting: dict[int, float] = {}

    @property
    def is_open(self) -> bool:
        """Whether the journal is open."""
        return self._journal is not None

    async def open(self) -> None:
        """Open the journal."""
        self._journal = await self._run(lambda: Journal.open(self._url, line=self._line))

    async def reopen_if_lost(self) -> bool:
        """Open the journal anew if it failed for good; whether it did."""
        if not await self.call(lambda journal: journal.lost):
            return False
        with suppress(JournalError):
            await self.call(Journal.close)
        self._journal = None
        await self.open()
        return True

    @property
    def waiting_s(self) -> float:
        """For how long the oldest thing that was asked for has been waited for."""
        return time.monotonic() - min(self._waiting.values()) if self._waiting else 0.0

    async def begin_session(self, *, above: int) -> int:
        """Number of a new session with the devices, above every earlier one and above ``above``."""
        session = await self.call(lambda journal: journal.begin_session(above=above))
        self._probe("session.begun")
        return session

    async def close(self) -> None:
        """Close the journal; whatever was asked for before is done first."""
        if self._journal is not None:
            await self.call(Journal.close)
            self._journal = None
        self._thread.shutdown()

    async def call(self, work: Callable[[Journal], _T]) -> _T:
        """Do something with the journal, in its thread."""
        journal = self._journal
        if journal is None:
            raise ValueError("the journal isn't open")
        return await self._run(lambda: work(journal))

    async def start_run(self, facts: RunFacts) -> int:
        """Number of a run, new or gone on with."""
        return await self.call(lambda journal: journal.start_run(facts))

    async def intend(self, run_id: int, faces: Sequence[tuple[int, int]], correction: int) -> list[Intent]:
        """Put down, for good, which faces come next; see `Journal.intend`."""
        self._probe("intent.before")
        intents = await self.call(lambda journal: journal.intend(run_id, faces, correction=correction))
        self._probe("intent.committed")
        return intents

    async def mark(self, changes: Sequence[ArmChange], step: str) -> None:
        """Put down changes of arms, for good, all or none."""
        if not changes:
            return
        self._probe(f"{step}.before")
        await self.call(lambda journal: journal.mark(changes))
        self._probe(f"{step}.committed")

    async def arms(self, run_id: int | None = None, states: Sequence[ArmState] | None = None) -> list[ArmRecord]:
        """Arms of a run, or of all."""
        return await self.call(lambda journal: journal.arms(run_id, states=states))

    async def note(self, kind: str, **detail: object) -> None:
        """Put down an event."""
        await self.call(lambda journal: journal.note(kind, **detail))

    async def _run(self, work: Callable[[], _T]) -> _T:
        self._asked += 1
        number = self._asked
        self._waiting[number] = time.monotonic()
        done = asyncio.get_running_loop().run_in_executor(self._thread, work)
        done.add_done_callback(lambda _: self._waiting.pop(number))
        return await done


class WriteBehind:
    """Changes that are put down while the loop goes on; in the order in which they were given.

    Parameters
    ----------
    keeper
        The journal.
    written
        Called with changes that are in the journal for good.
    failed
        Called with what went wrong.
    """

    def __init__(
        self,
        keeper: JournalKeeper,
        written: Callable[[Sequence[ArmChange]], None],
        failed: Callable[[str], None],
    ) -> None:
        self._keeper, self._written, self._failed = keeper, written, failed
        self._tasks: set[asyncio.Task[None]] = set()

    def write(self, changes: Sequence[ArmChange], step: str) -> None:
        """Put changes down, without waiting."""
        task = asyncio.get_running_loop().create_task(self._write(changes, step))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def through(self) -> None:
        """Wait until everything given so far is in the journal, or has failed."""
        while self._tasks:
            await asyncio.wait(self._tasks)

    async def _write(self, changes: Sequence[ArmChange], step: str) -> None:
        try:
            await self._keeper.mark(changes, step)
        except Exception as error:
            self._failed(f"the journal can't be written: {error}")
        else:
            self._written(changes)
