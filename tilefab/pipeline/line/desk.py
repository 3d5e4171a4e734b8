"""The operator's desk: shows how a daemon is doing, and passes on what an operator orders."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeVar

import tilefab
from tilefab.control import line_machine as machine
from tilefab.control.ledger import ArmState
from tilefab.errors import InterlockError, JournalError
from tilefab.io.journal import ArmRecord, CorrectionRecord, Journal, RunRecord
from tilefab.pipeline.line.alarms import alarm_text
from tilefab.pipeline.line.daemon import LineDaemon, Log
from tilefab.pipeline.line.device_link import LinkFacts
from tilefab.pipeline.line.jobs import prepare_job
from tilefab.pipeline.line.metrics import LineCounters, metrics_text
from tilefab.pipeline.line.orders import MOST_CORRECTIONS_TOLD
from tilefab.pipeline.line.status import (
    AlarmView,
    CorrectionView,
    DeviceView,
    DoubtView,
    FaceView,
    LineStatus,
)

_T = TypeVar("_T")
_LAST_FACES = 12
_RUNS_LOOKED_AT = 1000
_TOLD = frozenset(ArmState) - {ArmState.INTENT}
"""States of arms that a tile came for; a dozen others are always put down ahead."""
_DOUBTS_NAMED = 20
_REFRESH_S = 0.5
_ALARMS_KEPT = 1000

_ORDERS: Mapping[str, machine.Event] = {
    "start": machine.OperatorStart(),
    "hold": machine.OperatorHold(),
    "resume": machine.OperatorResume(),
    "stop": machine.OperatorStop(),
}
_DONE = {
    "start": "starting: devices are checked and the last faces settled before the belt moves",
    "hold": "holding",
    "resume": "resuming: devices are checked and the last faces settled before the belt moves",
    "stop": "stopping: tiles with a face are brought through",
}


class Desk:
    """Implements `tilefab.pipeline.line.orders.LineControl`; lives in the daemon's loop.

    Parameters
    ----------
    log
        Where the daemon's events go after the desk has seen them.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._daemon: LineDaemon | None = None
        self._started_s = time.time()
        self._alarms_raised = 0
        self._since: dict[int, str] = {}
        self._counts: Mapping[str, int] = {}
        self._last: tuple[FaceView, ...] = ()
        self._doubts: tuple[DoubtView, ...] = ()
        self._in_doubt = 0
        self._preparing = asyncio.Lock()
        self._reading = asyncio.Lock()
        self._reader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="tilefab-desk")
        self._journal: Journal | None = None

    def attend(self, daemon: LineDaemon) -> None:
        """Look after a daemon."""
        self._daemon = daemon

    def log(self, kind: str, **facts: object) -> None:
        """See an event of the daemon, and pass it on."""
        if kind == "alarm":
            self._alarms_raised += 1
            self._since[int(str(facts["number"]))] = _now()
            while len(self._since) > _ALARMS_KEPT:
                del self._since[next(iter(self._since))]
        self._log(kind, **facts)

    async def refresh(self) -> None:
        """Keep what comes from the journal fresh, until cancelled."""
        while True:
            # A journal that fails faults the line by itself; what is shown stays as it was.
            with suppress(JournalError):
                await self._look()
            await asyncio.sleep(_REFRESH_S)

    async def close(self) -> None:
        """Read no more."""

        def close() -> None:
            if self._journal is not None:
                self._journal.close()

        async with self._reading:
            await asyncio.get_running_loop().run_in_executor(self._reader, close)
        self._reader.shutdown()

    def status(self) -> LineStatus:
        """How the line is doing."""
        daemon = self._attended()
        line, plc, printer, job, book = (
            daemon.line,
            daemon.conveyor.status,
            daemon.printer.status,
            daemon.job,
            daemon.book,
        )
        kiln = daemon.kiln.status if daemon.kiln is not None else None
        alarms = tuple(self.alarms())
        correction = daemon.work.correction
        return LineStatus(
            line=daemon.line_file.name,
            state=line.state.value,
            reason=line.reason,
            since=daemon.since.isoformat(),
            version=tilefab.__version__,
            job=job.plan.name if job is not None else "",
            run_id=book.run_id if book is not None else None,
            faces_wanted=job.plan.job.tile.count if job is not None else 0,
            counts=self._counts,
            in_doubt=self._in_doubt,
            faces_in_doubt=self._doubts,
            correction=_correction(correction) if correction is not None else None,
            belt_running=plc is not None and plc.belt_running,
            belt_speed_mm_s=plc.belt_speed_mm_s if plc is not None else 0.0,
            faces_per_minute=daemon.throughput.per_minute,
            armed_ahead=len(book.armed) if book is not None else 0,
            ink_names=job.plan.ink_names if job is not None else (),
            ink_frac=printer.ink_frac if printer is not None else (),
            kiln_degc=kiln.temperatures_degc if kiln is not None else (),
            kiln_set_degc=kiln.set_points_degc if kiln is not None else (),
            kiln_tiles=kiln.tiles_inside if kiln is not None else 0,
            devices={link.name: _device(link.facts) for link in daemon.links},
            alarms=alarms,
            last_alarm=max((alarm.number for alarm in alarms), default=0),
            last_faces=self._last,
            queue=tuple(waiting.plan.name for waiting in daemon.jobs if waiting is not job),
        )

    async def command(self, name: str, arguments: Mapping[str, object]) -> str:
        """Carry out an order; what was done, in a line.

        Raises
        ------
        TilefabError
            If the line can't do so now.
        """
        daemon = self._attended()
        daemon.tell("order", name=name, **arguments)
        if name in _ORDERS:
            event = _ORDERS[name]
            why = machine.refusal(daemon.line, event)
            if name == "start" and not why and daemon.book is None and not daemon.jobs:
                why = "no job waits: queue one"
            if why:
                raise InterlockError(why, device=daemon.line_file.name)
            held = daemon.line.state in machine.RESTING
            daemon.post(event)
            return "stopped" if name == "stop" and held else _DONE[name]
        match name:
            case "ack":
                daemon.post(machine.OperatorAck(_whole(arguments["up_to"])))
                left = len(daemon.line.unacked)
                return "acknowledged" if not left else f"acknowledged; {left} newer alarms are not"
            case "queue":
                return await self._queue(Path(str(arguments["job"])))
            case "reprint":
                return await self._reprint(_whole(arguments["face"]), _maybe(arguments.get("run")))
            case "settle":
                state = ArmState(str(arguments["state"]))
                return await self._settle(_whole(arguments["face"]), state, _maybe(arguments.get("run")))
            case _:
                raise InterlockError(f"there is no order {name!r}", device=daemon.line_file.name)

    def metrics(self) -> bytes:
        """What Prometheus is told."""
        daemon = self._attended()
        counters = LineCounters(
            tiles_passed=daemon.tiles_passed,
            tiles_diverted=daemon.tiles_diverted,
            blank_tiles=daemon.printer.blank_tiles,
            alarms=self._alarms_raised,
            started_s=self._started_s,
            latencies={"arming": daemon.printer.arming_s},
        )
        return metrics_text(self.status(), counters)

    async def faces(self, last: int) -> Sequence[FaceView]:
        """The latest attempts to print a face, newest first."""
        return await self._read(lambda journal: [_face(arm) for arm in reversed(journal.arms(states=_TOLD, last=last))])

    def alarms(self) -> Sequence[AlarmView]:
        """Alarms that are up, oldest first."""
        return [
            AlarmView(
                number=alarm.number,
                code=alarm.code,
                since=self._since.get(alarm.number, ""),
                message=alarm.text,
                what_to_do=alarm_text(alarm.code).what_to_do,
                acked=alarm.acked,
            )
            for alarm in self._attended().line.alarms
        ]

    async def correct(self, run_id: int, drift: Mapping[str, object], reason: str) -> int:
        """Correct the colours of coming faces; see `LineControl.correct`."""
        return await self._attended().corrector.correct(run_id, drift, reason)

    async def corrections(self, run_id: int | None) -> tuple[int, Sequence[CorrectionView]]:
        """A run and its corrections; see `LineControl.corrections`."""
        run = await self._run(run_id)
        newest = range(max(1, run.correction + 1 - MOST_CORRECTIONS_TOLD), run.correction + 1)
        found = await self._read(lambda journal: journal.corrections(run.run_id, newest))
        return run.run_id, [_correction(record) for record in found]

    def warn(self, code: str, text: str) -> None:
        """Raise an alarm; the line goes on."""
        self._attended().warn(code, text)

    async def _look(self) -> None:
        daemon = self._attended()
        if (book := daemon.book) is not None:
            # The journal that writes keeps these counts; one that only reads would count a whole run each time.
            counts = await daemon.keeper.call(lambda journal: journal.counts(book.run_id))
            self._counts = {state.value: count for state, count in counts.items()}

        def read(journal: Journal) -> None:
            doubts = journal.arms(states=[ArmState.IN_DOUBT])
            self._last = tuple(_face(record) for record in reversed(journal.arms(states=_TOLD, last=_LAST_FACES)))
            self._in_doubt = len(doubts)
            self._doubts = tuple(DoubtView(record.run_id, record.face) for record in doubts[:_DOUBTS_NAMED])

        await self._read(read)

    async def _read(self, work: Callable[[Journal], _T]) -> _T:
        """Read from the journal, one at a time, in a thread and by a connection that the line doesn't wait for."""

        def read() -> _T:
            if self._journal is None:
                line_file = self._attended().line_file
                self._journal = Journal.look(line_file.journal_url, line=line_file.name)
            try:
                return work(self._journal)
            except JournalError:
                lost, self._journal = self._journal, None
                lost.close()
                raise

        async with self._reading:
            return await asyncio.get_running_loop().run_in_executor(self._reader, read)

    async def _queue(self, path: Path) -> str:
        """Put a job behind the others, once its maps are made: beside the line, one after the other, in this order."""
        daemon = self._attended()
        async with self._preparing:
            job = await prepare_job(path, daemon.line_file)
            daemon.jobs.append(job)
        daemon.tell("queued", job=job.plan.name)
        before = len(daemon.jobs) - 1
        return f"{job.plan.name} is queued" + (f" behind {before} other{'s' * (before > 1)}" if before else "")

    async def _reprint(self, face: int, run_id: int | None) -> str:
        daemon = self._attended()
        run = await self._run(run_id)
        attempt = await daemon.keeper.call(lambda journal: journal.order_reprint(run.run_id, face))
        book = daemon.book
        what = f"face {face} of {run.facts.name} (run {run.run_id})"
        if book is not None and book.run_id == run.run_id:
            book.queue.reprint(face, attempt)
            return f"{what} comes again on one of the next tiles"
        return f"{what} comes again once its job is queued"

    async def _settle(self, face: int, state: ArmState, run_id: int | None) -> str:
        daemon = self._attended()
        if run_id is None:
            run_id = await self._run_in_doubt(face)
        run = await self._run(run_id)
        record = await daemon.keeper.call(lambda journal: journal.settle(run.run_id, face, state))
        book = daemon.book
        if book is not None and book.run_id == run.run_id:
            book.queue.give_back(face, record.attempt, state)
        again = "; it comes again" if state is ArmState.UNPRINTED else ""
        return f"face {face} of {run.facts.name} (run {run.run_id}) is settled as {state}{again}"

    async def _run_in_doubt(self, face: int) -> int:
        """The only run in which a face is in doubt: with several, a guess could print one twice."""
        daemon = self._attended()
        doubts = await daemon.keeper.call(lambda journal: journal.arms(states=[ArmState.IN_DOUBT]))
        found = [record.run_id for record in doubts if record.face == face]
        if len(found) == 1:
            return found[0]
        why = f"it is in doubt in the runs {', '.join(map(str, found))}: say which with --run" if found else "it isn't"
        raise InterlockError(f"face {face} can't be settled as one in doubt: {why}", device=daemon.line_file.name)

    async def _run(self, run_id: int | None) -> RunRecord:
        """A run; without a number the present one, or else the last."""
        daemon = self._attended()
        if run_id is None and daemon.book is not None:
            run_id = daemon.book.run_id
        runs = await daemon.keeper.call(lambda journal: journal.runs(last=_RUNS_LOOKED_AT))
        for run in reversed(runs):
            if run_id is None or run.run_id == run_id:
                return run
        what = "it hasn't printed anything yet" if run_id is None else f"it has no run {run_id}"
        raise InterlockError(f"{daemon.line_file.name}: {what}", device=daemon.line_file.name)

    def _attended(self) -> LineDaemon:
        if self._daemon is None:
            raise InterlockError("the daemon is only starting", device="line")
        return self._daemon


def _now() -> str:
    return datetime.now(UTC).isoformat()


def _device(facts: LinkFacts) -> DeviceView:
    return DeviceView(facts.connected, facts.last_seen_s, facts.errors)


def _correction(record: CorrectionRecord) -> CorrectionView:
    return CorrectionView(record.number, record.made_at.isoformat(), record.reason, record.press_key)


def _face(record: ArmRecord) -> FaceView:
    return FaceView(
        face=record.face,
        arm_id=record.arm_id,
        state=record.state.value,
        at=record.changed_at.isoformat(),
        tile_seq=record.tile_seq,
        reason=record.reason,
        correction=record.correction,
    )


def _whole(value: object) -> int:
    return int(str(value))


def _maybe(value: object) -> int | None:
    return None if value is None else _whole(value)
