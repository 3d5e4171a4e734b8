"""Corrections in the middle of a run: other inks for the same colours, from the next faces on.

A face's print data are a function of job, face and correction. The journal has a correction before any face is put down
to be printed with it, and each arm says which it is of, so that after anything its data can be made again and checked.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

import tilefab
from tilefab.config.line import LineFile
from tilefab.control.ledger import OPEN
from tilefab.errors import InterlockError, TextureMapError
from tilefab.io.drift_file import drift_text, parse_drift
from tilefab.io.journal import CorrectionRecord, Journal
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.line.book import FaceBook
from tilefab.pipeline.line.correction_maps import CorrectionMaps
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.present_run import PresentRun
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.source import FaceSource
from tilefab.pipeline.line.streaming import Streamer
from tilefab.pipeline.plan import Plan
from tilefab.sampling import TextureMap

_S_PER_MIN = 60.0
_NAME = "the correction"


def _utc_now() -> datetime:
    return datetime.now(UTC)


class Corrector:
    """Corrects the present run, and keeps ready whatever maps its arms were put down with.

    Parameters
    ----------
    line_file
        The line: how often it may be corrected, and how long fired tiles are inspected against their maps.
    keeper
        The journal.
    work
        The present run.
    maps
        Where maps come from.
    tell
        Writes an event to the log and the journal.
    probe
        See `tilefab.pipeline.line.probe`.
    now
        The clock that the journal's times are of.
    """

    def __init__(
        self,
        line_file: LineFile,
        keeper: JournalKeeper,
        work: PresentRun,
        maps: CorrectionMaps,
        tell: Callable[..., None],
        probe: Probe = nothing,
        now: Callable[[], datetime] = _utc_now,
    ) -> None:
        self._settings = line_file.line.inspection
        self._keeper, self._work, self._maps = keeper, work, maps
        self._tell, self._probe, self._now = tell, probe, now
        self._making = False
        self._keys: dict[int, str] = {}

    async def correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        """Print the faces that aren't put down yet for a press that has drifted so.

        Takes as long as making a map does. Asked again for what is in use already, it changes nothing.

        Parameters
        ----------
        run_id
            The present run.
        drift
            The state, as in a drift state file; see `tilefab.io.drift_file`.
        reason
            For people.

        Returns
        -------
        int
            Number of the correction.

        Raises
        ------
        InterlockError
            If another run is the present one, another correction is being made, or the last one is too recent.
        TilefabError
            If the state isn't one of this press, or its map can't be made.
        """
        if self._making:
            raise InterlockError("another correction is being made: wait until it is in use", device="line")
        self._making = True
        try:
            return await self._correct(run_id, drift, reason)
        finally:
            self._making = False

    async def _correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        job_plan, source, book = self._present(run_id)
        text, plan = await asyncio.to_thread(_corrected, job_plan, drift)
        latest = self._work.correction
        if latest is not None and latest.press_key == plan.press_key:
            return latest.number
        self._check_interval(latest)
        self._probe("correction.before")
        press = await self._opened(plan, source)
        self._probe("correction.made")
        self._present(run_id)  # it may have ended meanwhile

        async def use() -> int:
            record = await self._keeper.call(
                lambda journal: journal.correct(run_id, press_key=plan.press_key, drift=text, reason=reason)
            )
            self._probe("correction.committed")
            self._put(source, record, press)
            self._work.use_correction(book, record)
            self._probe("correction.used")
            return record.number

        # Whoever asked may go away; what the journal has is used.
        number = await asyncio.shield(asyncio.ensure_future(use()))
        facts = {"run_id": run_id, "number": number, "press_key": plan.press_key, "reason": reason}
        self._tell("correction", **facts, version=tilefab.__version__)
        await self._tidy(job_plan, source)
        return number

    async def keep_up(self) -> None:
        """Open the maps of the latest correction and of every arm that is under way, before the belt moves.

        Raises
        ------
        TilefabError
            If one can't be had: nothing may be printed or checked without it.
        """
        work = self._work
        book, source, job = work.book, work.source, work.job
        if book is None or source is None or job is None:
            return
        run_id, open_maps = book.run_id, source.corrections

        def read(journal: Journal) -> tuple[CorrectionRecord | None, list[CorrectionRecord]]:
            latest = journal.latest_correction(run_id)
            wanted = {arm.correction for arm in journal.arms(run_id, states=OPEN)} - {0}
            wanted |= {latest.number} if latest is not None else set()
            return latest, journal.corrections(run_id, wanted - open_maps)

        latest, missing = await self._keeper.call(read)
        for record in missing:
            plan = await asyncio.to_thread(_recorded, job.plan, record)
            self._put(source, record, await self._opened(plan, source))
        if latest is not None:
            work.use_correction(book, latest)

    def let_go(self, streamer: Streamer | None) -> None:
        """Close the maps that no face wants any more."""
        book, source, present = self._work.book, self._work.source, self._work.correction
        if book is None or source is None or book.coming:
            return  # faces that are being put down may be of a correction that was followed meanwhile
        wanted = {present.number} if present is not None else set()
        wanted |= {intent.correction for intent in book.pool}
        wanted |= {arm.intent.correction for arm in book.active.values()}
        source.keep_only(wanted | streamer.corrections if streamer is not None else wanted)

    def _present(self, run_id: int) -> tuple[Plan, FaceSource, FaceBook]:
        book, source, job = self._work.book, self._work.source, self._work.job
        if book is None or source is None or job is None:
            raise InterlockError("no job is open: there is nothing to correct", device="line")
        if book.run_id != run_id:
            raise InterlockError(f"run {run_id} isn't the present one, but {book.run_id}", device="line")
        return job.plan, source, book

    def _check_interval(self, latest: CorrectionRecord | None) -> None:
        if latest is None:
            return
        settings = self._settings
        passed_min = (self._now() - latest.made_at).total_seconds() / _S_PER_MIN * settings.clock_rate
        # A clock that was put back must not bar corrections until it has caught up.
        if 0 <= passed_min < settings.correction_interval_min:
            raise InterlockError(
                f"correction {latest.number} was made {passed_min:.1f} min ago, and the line's file lets "
                f"{settings.correction_interval_min:g} min pass between two: wait",
                device="line",
            )

    async def _opened(self, plan: Plan, source: FaceSource) -> TextureMap:
        """A correction's map, made if need be, also in the place of a damaged one; one that the source takes."""
        texture_hash = source.maps.texture.hash
        await self._maps.make(plan)
        try:
            press = await asyncio.to_thread(self._maps.load, plan, texture_hash)
        except TextureMapError:
            await asyncio.to_thread(self._maps.forget, plan)
            await self._maps.make(plan)
            press = await asyncio.to_thread(self._maps.load, plan, texture_hash)
        source.check(press)
        return press

    def _put(self, source: FaceSource, record: CorrectionRecord, press: TextureMap) -> None:
        source.put(record.number, press)
        self._keys[record.number] = record.press_key

    async def _tidy(self, plan: Plan, source: FaceSource) -> None:
        self._keys = {number: key for number, key in self._keys.items() if number in source.corrections}
        keep_s = self._settings.window_min * _S_PER_MIN / self._settings.clock_rate
        await asyncio.to_thread(self._maps.tidy, plan, list(self._keys.values()), keep_s)


def _corrected(plan: Plan, drift: Mapping[str, object]) -> tuple[str, Plan]:
    """A drift state in the words of its file, and the job printed for it."""
    state, _ = parse_drift(json.dumps(drift).encode(), _NAME)
    text = drift_text(state)
    return text, corrected_plan(plan, *parse_drift(text.encode(), _NAME))


def _recorded(plan: Plan, record: CorrectionRecord) -> Plan:
    """The job printed as one of its corrections."""
    name = f"correction {record.number} of run {record.run_id}"
    corrected = corrected_plan(plan, *parse_drift(record.drift.encode(), name))
    if corrected.press_key != record.press_key:
        raise InterlockError(
            f"{name}: this version of tilefab makes other inks of it than the one that put it down: use that version "
            "until the run is over",
            device="line",
        )
    return corrected
