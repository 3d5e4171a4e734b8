"""The operator's desk: shows how a daemon is doing, and passes on what an operator orders."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import tilefab
from tilefab.control import line_machine as machine
from tilefab.control.ledger import ArmState
from tilefab.errors import InterlockError, JournalError
from tilefab.io.journal import ArmRecord, Journal
from tilefab.pipeline.line.alarms import alarm_text
from tilefab.pipeline.line.daemon import LineDaemon, Log
from tilefab.pipeline.line.device_link import LinkFacts
from tilefab.pipeline.line.jobs import prepare_job
from tilefab.pipeline.line.metrics import LineCounters, metrics_text
from tilefab.pipeline.line.status import AlarmView, DeviceView, FaceView, LineStatus

_LAST_FACES = 12
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
        self._doubts: tuple[int, ...] = ()
        self._in_doubt = 0
        self._preparing = asyncio.Lock()

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
            if why:
                raise InterlockError(why, device=daemon.line_file.name)
            daemon.post(event)
            return _DONE[name]
        match name:
            case "ack":
                daemon.post(machine.OperatorAck(_whole(arguments["up_to"])))
                left = len(daemon.line.unacked)
                return "acknowledged" if not left else f"acknowledged; {left} newer alarms are not"
            case "queue":
                return await self._queue(Path(str(arguments["job"])))
            case "reprint":
                return await self._reprint(_whole(arguments["face"]))
            case "settle":
                return await self._settle(_whole(arguments["face"]), ArmState(str(arguments["state"])))
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
        records = await self._attended().keeper.call(lambda journal: journal.arms(states=_TOLD, last=last))
        return [_face(record) for record in reversed(records)]

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

    async def _look(self) -> None:
        daemon = self._attended()
        book = daemon.book

        def read(journal: Journal) -> tuple[Mapping[ArmState, int], list[ArmRecord], list[ArmRecord]]:
            counts = journal.counts(book.run_id) if book is not None else {}
            return counts, journal.arms(states=_TOLD, last=_LAST_FACES), journal.arms(states=[ArmState.IN_DOUBT])

        counts, last, doubts = await daemon.keeper.call(read)
        self._counts = {state.value: count for state, count in counts.items()}
        self._last = tuple(_face(record) for record in reversed(last))
        self._in_doubt = len(doubts)
        self._doubts = tuple(record.face for record in doubts[:_DOUBTS_NAMED])

    async def _queue(self, path: Path) -> str:
        """Put a job behind the others, once its maps are made: beside the line, one after the other, in this order."""
        daemon = self._attended()
        async with self._preparing:
            job = await prepare_job(path, daemon.line_file)
            daemon.jobs.append(job)
        daemon.tell("queued", job=job.plan.name)
        before = len(daemon.jobs) - 1
        return f"{job.plan.name} is queued" + (f" behind {before} other{'s' * (before > 1)}" if before else "")

    async def _reprint(self, face: int) -> str:
        daemon = self._attended()
        run_id = await self._run_of(face)
        attempt = await daemon.keeper.call(lambda journal: journal.order_reprint(run_id, face))
        book = daemon.book
        if book is not None and book.run_id == run_id:
            book.queue.reprint(face, attempt)
            return f"face {face} comes again on one of the next tiles"
        return f"face {face} comes again once its job is queued"

    async def _settle(self, face: int, state: ArmState) -> str:
        daemon = self._attended()
        run_id = await self._run_of(face)
        record = await daemon.keeper.call(lambda journal: journal.settle(run_id, face, state))
        book = daemon.book
        if book is not None and book.run_id == run_id:
            book.queue.give_back(face, record.attempt, state)
        await self._look()
        again = "; it comes again" if state is ArmState.UNPRINTED else ""
        return f"face {face} is settled as {state}{again}"

    async def _run_of(self, face: int) -> int:
        """The run that an operator means: the present one, or else the last."""
        daemon = self._attended()
        if daemon.book is not None:
            return daemon.book.run_id
        runs = await daemon.keeper.call(lambda journal: journal.runs(last=1))
        if not runs:
            raise InterlockError(f"face {face}: this line hasn't printed anything yet", device=daemon.line_file.name)
        return runs[-1].run_id

    def _attended(self) -> LineDaemon:
        if self._daemon is None:
            raise InterlockError("the daemon is only starting", device="line")
        return self._daemon


def _now() -> str:
    return datetime.now(UTC).isoformat()


def _device(facts: LinkFacts) -> DeviceView:
    return DeviceView(facts.connected, facts.last_seen_s, facts.errors)


def _face(record: ArmRecord) -> FaceView:
    return FaceView(
        face=record.face,
        arm_id=record.arm_id,
        state=record.state.value,
        at=record.changed_at.isoformat(),
        tile_seq=record.tile_seq,
        reason=record.reason,
    )


def _whole(value: object) -> int:
    return int(str(value))
