"""Bringing the line up: with the belt at rest, find out what became of every face, and where every tile is."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict, dataclass

from tilefab.control.ledger import ArmState, FaceQueue
from tilefab.control.reconcile import (
    ConveyorMemory,
    Known,
    OpenArm,
    PrintedArm,
    PrinterMemory,
    PrintState,
    Reconciliation,
    Verdict,
    reconcile,
)
from tilefab.control.tile_tracking import Calibration, Standstill, calibrate
from tilefab.devices import DisarmStatus, OutcomeState, PlcStatus, PrinterSession, PrinterStatus
from tilefab.errors import InterlockError
from tilefab.io.journal import ArmChange, ArmRecord, Intent
from tilefab.pipeline.line.book import ActiveArm, FaceBook
from tilefab.pipeline.line.keeper import JournalKeeper
from tilefab.pipeline.line.probe import Probe, nothing

CALIBRATED = "calibrated"
"""Kind of the journal's note of a calibration."""
TILES_MOVED = "tiles_moved"
"""Kind of the journal's note that tiles may have been moved by other means than the belt."""

PRINT_SPOILT = "print_spoilt"
"""Kind of the journal's note that ink or a nozzle failed while something was printed."""

BARRED = "its tile is never released"
"""Reason of an arm that the printer still holds, but whose tile can't be trusted."""

_REST_S = 0.15
_STILL_WITHIN_S = 20.0
_LATEST_ARMS = 256
_OPEN = (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED)
_ACCEPTED = (ArmState.ARMED, ArmState.PRINTED, ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL)
_SLIP_MM = 3.0


@dataclass(frozen=True)
class BroughtUp:
    """What bringing the line up found.

    Attributes
    ----------
    calibration
        Match of the counts of printer and conveyor.
    in_doubt
        Faces that had to be marked in doubt.
    streaming
        Arms that the printer still holds, with their faces and corrections, to be sent on.
    """

    calibration: Calibration
    in_doubt: tuple[int, ...]
    streaming: tuple[tuple[int, int, int], ...]


class BringUp:
    """Reads the devices at rest and settles the journal.

    Parameters
    ----------
    keeper
        The journal.
    read
        Reads both devices; both anew at each call.
    ask_printer
        Runs something with the printer's new session.
    checksum
        CRC-32 of a face of the present run with one of its corrections.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(
        self,
        keeper: JournalKeeper,
        read: Callable[[], Awaitable[tuple[PrinterStatus, PlcStatus]]],
        ask_printer: Callable[[Callable[[PrinterSession], Awaitable[None]]], Awaitable[None]],
        checksum: Callable[[int, int], int],
        probe: Probe = nothing,
    ) -> None:
        self._keeper, self._read, self._ask_printer = keeper, read, ask_printer
        self._checksum, self._probe = checksum, probe

    async def standstill(self, counts_per_mm: float) -> Standstill:
        """Wait until neither device sees the belt move, and read both."""
        before = await self._read()
        deadline = asyncio.get_running_loop().time() + _STILL_WITHIN_S
        while True:
            if asyncio.get_running_loop().time() > deadline:
                raise InterlockError("the belt doesn't come to rest, or its encoder trembles", device="plc")
            await asyncio.sleep(_REST_S)
            printer, plc = now = await self._read()
            still = (
                printer.encoder_counts == before[0].encoder_counts and plc.position_counts == before[1].position_counts
            )
            if still and not plc.belt_running and counts_per_mm:
                return Standstill(
                    printer_boot=printer.boot_id,
                    encoder_counts=printer.encoder_counts,
                    detect_seq=printer.detect_seq,
                    plc_boot=plc.boot_id,
                    position_counts=plc.position_counts,
                    tile_seq=plc.tile_seq,
                )
            before = now

    async def settle(self, book: FaceBook, *, moved: bool, spoilt: bool, counts_per_mm: float) -> BroughtUp:
        """Settle every open arm, and match the counts anew.

        Parameters
        ----------
        book
            Faces of the present run; its active arms are set anew.
        moved
            Whether tiles may have been moved by other means than the belt since the last time.
        spoilt
            Whether ink or a nozzle failed while something was printed since.
        counts_per_mm
            Of the encoder.
        """
        still = await self.standstill(counts_per_mm)
        last, moved_since, spoilt_since = await self._last_calibration()
        calibration = calibrate(still)
        trusted = not moved and not moved_since and _still_holds(last, calibration, round(_SLIP_MM * counts_per_mm))
        records = await self._keeper.arms(states=_OPEN)
        in_pool = {intent.arm_id for intent in book.pool}
        records = [record for record in records if record.arm_id not in in_pool]
        accepted = await self._keeper.call(
            lambda journal: max((r.arm_id for r in journal.arms(last=_LATEST_ARMS) if r.state in _ACCEPTED), default=0)
        )
        _, plc = await self._read()
        memory = await self._printer_memory(records, trusted, book.run_id)
        conveyor = ConveyorMemory(plc.boot_id, plc.decided_seq, plc.passed_bits)
        arms = [_open_arm(record, book) for record in records]
        found = reconcile(arms, memory, conveyor, Known(last, accepted, trusted, spoilt or spoilt_since))
        self._probe("reconcile.read")
        found = await self._checked(found, {record.arm_id: record for record in records}, book)
        await self._write(found, still)
        # The journal is the authority on what comes next, too: whatever was under way when the line was stopped, no
        # face falls out of the queue.
        states = await self._keeper.call(lambda journal: journal.face_states(book.run_id))
        book.queue = FaceQueue(states)
        self._take(found, records, memory, book)
        await self._keeper.note(CALIBRATED, **asdict(calibration))
        self._probe("calibrated.committed")
        by_id = {record.arm_id: record for record in records}
        return BroughtUp(
            calibration,
            tuple(by_id[v.arm_id].face for v in found.verdicts if v.state is ArmState.IN_DOUBT),
            tuple(
                (arm, by_id[arm].face, by_id[arm].correction)
                for arm in sorted(found.continuing)
                if by_id[arm].run_id == book.run_id
            ),
        )

    async def _last_calibration(self) -> tuple[Calibration | None, bool, bool]:
        """The last calibration put down, and whether since then tiles were moved, or prints spoilt."""
        note, *others = await self._keeper.call(
            lambda journal: [journal.latest_note(kind) for kind in (CALIBRATED, TILES_MOVED, PRINT_SPOILT)]
        )
        begin = note.note_id if note is not None else 0
        moved, spoilt = (other is not None and other.note_id > begin for other in others)
        if note is None:
            return None, moved, spoilt
        return Calibration(**{name: int(str(value)) for name, value in note.detail.items()}), moved, spoilt

    async def _printer_memory(self, records: list[ArmRecord], trusted: bool, run_id: int) -> PrinterMemory:
        """What the printer remembers of open arms; those that can't go on are disarmed first."""
        found: dict[int, PrintedArm] = {}
        status: list[PrinterStatus] = []

        async def read(session: PrinterSession) -> None:
            found.clear()
            await _read_outcomes(session, records, found)
            for record in records:
                arm = found.get(record.arm_id)
                if arm is None or arm.state is not PrintState.QUEUED or (trusted and record.run_id == run_id):
                    continue
                if await session.disarm(record.arm_id) is DisarmStatus.UNKNOWN:
                    continue
            await _read_outcomes(session, records, found)
            status.append(await session.status())

        await self._ask_printer(read)
        return PrinterMemory(status[-1].boot_id, status[-1].last_accepted_arm, found)

    async def _checked(self, found: Reconciliation, records: dict[int, ArmRecord], book: FaceBook) -> Reconciliation:
        """Take faces that were printed from other data than they should have been out of those that may pass."""
        verdicts, waiting = list(found.verdicts), dict(found.waiting)
        for verdict in found.verdicts:
            record = records[verdict.arm_id]
            if verdict.state is not ArmState.PRINTED or verdict.arm_id not in waiting:
                continue
            if record.run_id == book.run_id and await self._sum_of(record) == verdict.data_crc32:
                continue
            del waiting[verdict.arm_id]
            reason = "its data can't be checked" if record.run_id != book.run_id else "printed from other data"
            verdicts.append(Verdict(verdict.arm_id, ArmState.DIVERTED, f"{reason}: its tile is never released"))
        return Reconciliation(tuple(verdicts), waiting, found.continuing)

    async def _sum_of(self, record: ArmRecord) -> int:
        """Render an arm's face for its checksum, beside the loop: that takes longer than the devices' patience."""
        work = asyncio.ensure_future(asyncio.to_thread(self._checksum, record.face, record.correction))
        try:
            return await asyncio.shield(work)
        except asyncio.CancelledError:
            # Faces share a buffer, which isn't free before.
            await asyncio.wait({work})
            raise

    async def _write(self, found: Reconciliation, still: Standstill) -> None:
        changes = [
            ArmChange(
                arm_id=verdict.arm_id,
                state=verdict.state,
                detect_seq=verdict.detect_seq,
                tile_seq=verdict.tile_seq,
                printer_boot=still.printer_boot if verdict.tile_seq is not None else None,
                plc_boot=still.plc_boot if verdict.tile_seq is not None else None,
                rows_printed=verdict.rows_printed,
                data_crc32=verdict.data_crc32,
                reason=verdict.reason,
            )
            for verdict in found.verdicts
        ]
        # Said for good: a tile that isn't to be trusted now isn't at the next time either.
        changes += [
            ArmChange(arm_id=arm_id, state=ArmState.ARMED, reason=BARRED)
            for arm_id, tile_seq in found.continuing.items()
            if tile_seq is None
        ]
        await self._keeper.mark(changes, "reconcile")

    def _take(self, found: Reconciliation, records: list[ArmRecord], memory: PrinterMemory, book: FaceBook) -> None:
        """Set the book to what was found."""
        known, book.active = book.active, {}
        for record in records:
            intent = Intent(record.arm_id, record.run_id, record.face, record.attempt, record.correction)
            before = known.get(record.arm_id)
            if record.arm_id in found.waiting:
                book.active[record.arm_id] = ActiveArm(
                    intent,
                    before.detect_seq if before is not None else 0,
                    found.waiting[record.arm_id],
                    ArmState.PRINTED,
                    recorded=True,
                    asked_release=before is None or before.asked_release,
                )
            elif record.arm_id in found.continuing:
                detect_seq = memory.outcomes[record.arm_id].detect_seq
                tile_seq = found.continuing[record.arm_id]
                book.active[record.arm_id] = ActiveArm(intent, detect_seq, tile_seq, ArmState.ARMED)


async def _read_outcomes(session: PrinterSession, records: list[ArmRecord], found: dict[int, PrintedArm]) -> None:
    """Read what the printer remembers of open arms."""
    if not records:
        return
    begin, end = min(r.arm_id for r in records), max(r.arm_id for r in records)
    while begin <= end:
        outcomes = await session.outcomes(begin)
        if not outcomes:
            return
        for outcome in outcomes:
            found[outcome.arm_id] = PrintedArm(
                outcome.face,
                _STATES[outcome.state],
                outcome.detect_seq,
                outcome.rows_printed,
                outcome.data_crc32,
            )
        begin = outcomes[-1].arm_id + 1


_STATES = {state: PrintState[state.name] for state in OutcomeState}


def _open_arm(record: ArmRecord, book: FaceBook) -> OpenArm:
    known = book.active.get(record.arm_id)
    released = None if known is None else known.asked_release
    barred = record.reason == BARRED
    return OpenArm(record.arm_id, record.face, record.state, record.tile_seq, record.plc_boot, released, barred)


def _still_holds(last: Calibration | None, now: Calibration, slip_counts: int) -> bool:
    """Whether both devices counted the same since the last match."""
    if last is None or (last.printer_boot, last.plc_boot, last.seq_offset) != (
        now.printer_boot,
        now.plc_boot,
        now.seq_offset,
    ):
        return False
    half = 1 << 31
    apart = (now.position_offset_counts - last.position_offset_counts + half) % (1 << 32) - half
    return abs(apart) <= slip_counts
