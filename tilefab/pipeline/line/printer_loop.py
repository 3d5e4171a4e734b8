"""The printer's loop: gives each tile that the eye sees a face, and learns what became of it."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from tilefab.control.ledger import OPEN, ArmState
from tilefab.control.tile_tracking import Calibration, TileShape, print_start_counts
from tilefab.devices import (
    ArmCommand,
    ArmStatus,
    Detection,
    Outcome,
    OutcomeState,
    PrinterIdentity,
    PrinterSession,
    PrinterStatus,
)
from tilefab.errors import DeviceError
from tilefab.io.journal import ArmChange
from tilefab.pipeline.line.book import ActiveArm, FaceBook
from tilefab.pipeline.line.host import LineHost
from tilefab.pipeline.line.keeper import JournalKeeper, WriteBehind
from tilefab.pipeline.line.probe import Probe, nothing
from tilefab.pipeline.line.timing import Latencies

_EDGES_KEPT = 64
_OUTCOMES_EVERY_S = 0.1
_CHECKSUM_WAIT_S = 0.5
_UNFINISHED = (OutcomeState.QUEUED, OutcomeState.PRINTING)


@dataclass(frozen=True)
class PrintJob:
    """What every face of a job has in common, as the printer wants it.

    Attributes
    ----------
    rows, cols, channels, bits
        Of a face, bleed included.
    row_pitch_millicounts
        Distance of two rows in thousandths of an encoder count.
    bleed_counts
        How far before the tile its face begins.
    shape
        What tiles look like to the eye.
    """

    rows: int
    cols: int
    channels: int
    bits: int
    row_pitch_millicounts: int
    bleed_counts: int
    shape: TileShape


class PrinterLoop:
    """Talks to the printer's control.

    Parameters
    ----------
    host
        The line.
    keeper
        The journal.
    probe
        See `tilefab.pipeline.line.probe`.
    """

    def __init__(self, host: LineHost, keeper: JournalKeeper, probe: Probe = nothing) -> None:
        self._host, self._probe = host, probe
        self._behind = WriteBehind(keeper, self._written, lambda reason: host.fault("journal", reason))
        self.identity: PrinterIdentity | None = None
        self.status: PrinterStatus | None = None
        self.job: PrintJob | None = None
        self.calibration: Calibration | None = None
        self.edges: dict[int, int] = {}
        """Encoder counts of the latest leading edges, by detect_seq."""
        self.arming_s = Latencies()
        """From the answer that told of a tile to the printer's acceptance of its face."""
        self.blank_tiles = 0
        """Tiles that got no face while the line printed; the diverter scraps them."""
        self._seen = 0
        self._unmeasured: deque[int] = deque()
        self._waiting: deque[Detection] = deque()
        self._unsure: ArmCommand | None = None
        self._hold_wanted = self._clear_wanted = self._cleared = False
        self._acked: int | None = None
        self._outcome_seen = 0
        self._outcomes_due = 0.0
        self._unsummed: dict[int, float] = {}

    def begin_at(self, calibration: Calibration, job: PrintJob) -> None:
        """Give faces to the tiles that come from now on."""
        self.calibration, self.job = calibration, job
        self._seen = calibration.detect_seq
        self.edges.clear()
        self._unmeasured.clear()
        self._waiting.clear()
        self._unsure = None
        self._unsummed.clear()

    def hold(self) -> None:
        """Begin no further print, from the next cycle on."""
        self._hold_wanted, self._clear_wanted, self._cleared = True, False, False

    def clear(self) -> None:
        """Let the printer print, from the next cycle on."""
        self._hold_wanted, self._clear_wanted = False, True

    def acknowledge(self) -> None:
        """Take back the faults that were read last, as soon as the belt rests; the printer goes on holding."""
        status = self.status
        if status is not None and (status.e_stop or status.ink_out or status.nozzle_out):
            self._acked = status.fault_counter

    async def greet(self, session: PrinterSession) -> None:
        """Begin a session."""
        identity = await session.hello()
        if self.identity is not None and (identity.inks, identity.bits, identity.counts_per_mm) != (
            self.identity.inks,
            self.identity.bits,
            self.identity.counts_per_mm,
        ):
            self._host.fault("printer_changed", "the printer has other inks or another encoder than before")
        self.identity = identity

    async def cycle(self, session: PrinterSession) -> None:
        """One round: state, holding, faces for new tiles, what became of earlier ones."""
        if self._hold_wanted:
            await session.hold()
            self._hold_wanted = False
        if self._clear_wanted:
            await self._clear(session)
        asked = asyncio.get_running_loop().time()
        status = await session.status()
        before = self._take_status(status)
        if self._acked is not None and before is not None and before.encoder_counts == status.encoder_counts:
            await self._acknowledge(session, self._acked)
        if self.calibration is None or status.boot_id != self.calibration.printer_boot:
            return
        if self._unsure is not None and self._host.may_print:
            await self._arm_again(session, self._unsure)
        await self._new_edges(session, status)
        while self._waiting and self._host.may_print:
            if not await self._arm(session, self._waiting[0], status, asked):
                break
            self._waiting.popleft()
        if not self._host.may_print:
            self._waiting.clear()
        await self._lengths(session)
        await self.look_at_outcomes(session, status)

    def _take_status(self, status: PrinterStatus) -> PrinterStatus | None:
        before, self.status = self.status, status
        self._look_at(before, status)
        return before

    async def _acknowledge(self, session: PrinterSession, fault_counter: int) -> None:
        # Clearing also ends the hold, which must not last beyond a standing belt's next look.
        self._acked, self._hold_wanted = None, True
        await session.clear(fault_counter)
        await session.hold()
        self._hold_wanted = False

    async def _clear(self, session: PrinterSession) -> None:
        # Only what was looked at is cleared: an emergency stop seen here makes the line hold.
        status = await session.status()
        self._take_status(status)
        if self._held_meanwhile():
            return
        done = await session.clear(status.fault_counter)
        if self._held_meanwhile():
            # The next cycle sees to it.
            self._hold_wanted = True
            return
        self._clear_wanted, self._cleared = False, done
        if not done:
            self._host.doubt("printer_held", "the printer can't be cleared: see to its ink, nozzles and stop button")

    def _held_meanwhile(self) -> bool:
        return not self._clear_wanted

    def _look_at(self, before: PrinterStatus | None, status: PrinterStatus) -> None:
        host = self._host
        if before is not None and before.boot_id != status.boot_id:
            # Faults are counted anew: the same number is another fault.
            self._acked = None
        if before is None or before.e_stop != status.e_stop:
            host.e_stop("printer", status.e_stop)
        for code in ("ink_out", "nozzle_out"):
            if getattr(status, code) and (before is None or not getattr(before, code)):
                host.print_spoilt(code)
        if self.calibration is not None and status.boot_id != self.calibration.printer_boot:
            # Told once: until the line is brought up, nothing is known of any tile.
            self.calibration = None
            host.doubt("printer_rebooted", "the printer was restarted: where its tiles are is no longer known")
            return
        if (
            not host.moving
            or not self._cleared
            or not (status.held or status.ink_out or status.nozzle_out or status.underrun)
        ):
            return
        if status.underrun:
            host.doubt("underrun", "a face reached the printer too late; its tile is scrapped")
        elif status.ink_out:
            host.doubt("ink_out", "the printer ran out of ink")
        elif status.nozzle_out:
            host.doubt("nozzle_out", "the printer reports a failed nozzle")
        elif status.deadman:
            host.doubt("deadman_printer", "the printer heard nothing for too long and holds")
        elif status.held and not status.e_stop:
            host.doubt("printer_held", "the printer holds by itself")

    async def _new_edges(self, session: PrinterSession, status: PrinterStatus) -> None:
        while self._seen < status.detect_seq:
            found = await session.detections(self._seen + 1)
            if not found:
                self._host.doubt("tiles_missed", f"the printer no longer knows tile {self._seen + 1} at its eye")
                self._seen = status.detect_seq
                return
            for edge in found:
                if edge.detect_seq != self._seen + 1:
                    self._host.doubt(
                        "tiles_missed", f"after tile {self._seen} at its eye the printer tells of {edge.detect_seq}"
                    )
                self._take_edge(edge)

    def _take_edge(self, edge: Detection) -> None:
        job = self.job
        last = self.edges.get(edge.detect_seq - 1)
        if job is not None and last is not None:
            problem = job.shape.edge_problem(edge.encoder_counts - last)
            if problem:
                self._host.doubt("double_feed", problem)
        self._seen = edge.detect_seq
        self.edges[edge.detect_seq] = edge.encoder_counts
        self._waiting.append(edge)
        self._unmeasured.append(edge.detect_seq)
        while len(self.edges) > _EDGES_KEPT:
            del self.edges[next(iter(self.edges))]

    async def _lengths(self, session: PrinterSession) -> None:
        """Measure tiles once they have left the eye."""
        job = self.job
        if job is None or not self._unmeasured or self.status is None:
            return
        oldest = self._unmeasured[0]
        edge = self.edges.get(oldest)
        if edge is not None and self.status.encoder_counts - edge < job.shape.length_counts:
            return
        for found in await session.detections(oldest):
            if found.length_counts == 0:
                gone = self.status.encoder_counts - found.encoder_counts
                if gone > job.shape.length_counts + job.shape.pitch_counts:
                    self._host.doubt("double_feed", job.shape.length_problem(gone))
                return
            while self._unmeasured and self._unmeasured[0] <= found.detect_seq:
                self._unmeasured.popleft()
            problem = job.shape.length_problem(found.length_counts)
            if problem:
                self._host.doubt("double_feed", problem)

    async def _arm(self, session: PrinterSession, edge: Detection, status: PrinterStatus, asked: float) -> bool:
        """Give a tile the next face; whether the tile is dealt with."""
        host, job, identity, calibration = self._host, self.job, self.identity, self.calibration
        book = host.book
        if job is None or identity is None or calibration is None or book is None:
            return True
        if not book.pool:
            self.blank_tiles += book.queue.remaining > 0
            host.faces_wanted()
            return True
        start = print_start_counts(edge.encoder_counts, identity.eye_to_head_counts, job.bleed_counts)
        if start - status.encoder_counts < identity.min_lead_counts:
            self.blank_tiles += 1
            host.warn("armed_late", f"tile {edge.detect_seq} came too close to the head before it had a face")
            return True
        intent = book.pool.popleft()
        command = ArmCommand(
            arm_id=intent.arm_id,
            face=intent.face,
            detect_seq=edge.detect_seq,
            start_encoder=start,
            rows=job.rows,
            cols=job.cols,
            row_pitch_millicounts=job.row_pitch_millicounts,
            channels=job.channels,
            bits=job.bits,
        )
        tile_seq = calibration.tile_seq(edge.detect_seq)
        book.active[intent.arm_id] = ActiveArm(intent, edge.detect_seq, tile_seq, ArmState.INTENT)
        host.faces_wanted()
        self._probe("arm.before")
        return await self._send(session, command, book, asked)

    async def _arm_again(self, session: PrinterSession, command: ArmCommand) -> None:
        """Ask again what was asked before without an answer: the printer does nothing twice."""
        book = self._host.book
        if book is None or command.arm_id not in book.active:
            self._unsure = None
            return
        await self._send(session, command, book, None)

    async def _send(self, session: PrinterSession, command: ArmCommand, book: FaceBook, asked: float | None) -> bool:
        self._unsure = command
        try:
            reply = await session.arm(command)
        except DeviceError:
            # The tile is dealt with: if the printer took the face, asking again will tell.
            if self._waiting and self._waiting[0].detect_seq == command.detect_seq:
                self._waiting.popleft()
            raise
        self._unsure = None
        if reply.status in (ArmStatus.ACCEPTED, ArmStatus.DUPLICATE):
            if asked is not None:
                self.arming_s.add(asyncio.get_running_loop().time() - asked)
            self._probe("arm.accepted")
            arm = book.update(command.arm_id, state=ArmState.ARMED)
            if self._host.streamer is not None:
                self._host.streamer.submit(command.arm_id, command.face, arm.intent.correction)
            self._behind.write([self._change(arm, ArmState.ARMED)], "armed")
            return True
        if reply.status is ArmStatus.NOT_ABOVE_LAST:
            # The number was used for something else: the arm stays open until the line is reconciled.
            self._host.doubt(
                "arm_refused",
                f"the printer accepted arm {reply.last_accepted_arm}, so {command.arm_id} can't follow: another host "
                "commands it",
            )
            return True
        arm = book.active.pop(command.arm_id)
        book.pool.appendleft(arm.intent)
        if reply.status is ArmStatus.QUEUE_FULL:
            return False
        if reply.status is ArmStatus.TOO_LATE:
            self.blank_tiles += 1
            self._host.warn("armed_late", f"tile {command.detect_seq} was too close to the head for a face")
        elif reply.status is ArmStatus.HELD:
            self._host.doubt("printer_held", "the printer holds by itself")
        else:
            self._host.doubt(
                "arm_refused",
                f"the printer refused arm {command.arm_id} for tile {command.detect_seq}: {reply.status.name.lower()}",
            )
        return True

    async def look_at_outcomes(self, session: PrinterSession, status: PrinterStatus) -> None:
        """Learn what became of arms."""
        book, now = self._host.book, asyncio.get_running_loop().time()
        if book is None or not book.armed:
            return
        if status.last_outcome_arm == self._outcome_seen and now < self._outcomes_due:
            return
        self._outcome_seen, self._outcomes_due = status.last_outcome_arm, now + _OUTCOMES_EVERY_S
        wanted = {arm.intent.arm_id: arm for arm in book.armed}
        begin: int | None = min(wanted)
        while begin is not None:
            found = await session.outcomes(begin)
            changes = [
                change
                for outcome in found
                if outcome.arm_id in wanted and outcome.state not in _UNFINISHED
                for change in self._finished(book, wanted[outcome.arm_id], outcome, now)
            ]
            if changes:
                self._probe("outcome.read")
                self._behind.write(changes, "printed")
            last = found[-1].arm_id if found else max(wanted)
            begin = last + 1 if last < max(wanted) else None

    def _finished(self, book: FaceBook, arm: ActiveArm, outcome: Outcome, now: float) -> list[ArmChange]:
        host, arm_id, face = self._host, arm.intent.arm_id, arm.intent.face
        if outcome.face != face or outcome.detect_seq != arm.detect_seq:
            host.doubt(
                "printer_confused", f"the printer tells of arm {arm_id} with another face or tile than it was given"
            )
            return self._end(book, arm, ArmState.IN_DOUBT, outcome, "the printer tells of another face or tile")
        if outcome.state is OutcomeState.PRINTED:
            wanted = host.streamer.checksum(arm_id) if host.streamer is not None else None
            if wanted is None:
                if now - self._unsummed.setdefault(arm_id, now) < _CHECKSUM_WAIT_S:
                    self._outcomes_due = now
                    return []
                host.doubt(
                    "printer_confused", f"the printer tells that it printed arm {arm_id}, which wasn't sent whole"
                )
                return self._end(book, arm, ArmState.PARTIAL, outcome, "told of as printed, but wasn't sent whole")
            self._unsummed.pop(arm_id, None)
            if wanted != outcome.data_crc32:
                host.doubt("wrong_data", f"face {face} was printed from other data than was sent; its tile is scrapped")
                return self._end(book, arm, ArmState.PARTIAL, outcome, "printed from other data than was sent")
            if arm.tile_seq is None:
                printed = self._change(arm, ArmState.PRINTED, outcome)
                reason = "its tile can't be trusted, and is never released"
                return [printed, *self._end(book, arm, ArmState.DIVERTED, outcome, reason)]
            if host.spoilt:
                printed = self._change(arm, ArmState.PRINTED, outcome)
                reason = "ink or a nozzle failed under it: its tile is never released"
                return [printed, *self._end(book, arm, ArmState.DIVERTED, outcome, reason)]
            arm = book.update(arm_id, state=ArmState.PRINTED)
            return [self._change(arm, ArmState.PRINTED, outcome)]
        if host.streamer is not None:
            host.streamer.cancel(arm_id)
        if outcome.state is OutcomeState.PARTIAL:
            host.doubt("partial", f"face {face} was printed only to row {outcome.rows_printed}; its tile is scrapped")
            return self._end(book, arm, ArmState.PARTIAL, outcome, "printed in part")
        if outcome.state is OutcomeState.MISSED:
            host.warn(
                "tile_missing", f"nothing was printed for tile {arm.tile_seq}; face {face} comes again on a later one"
            )
        return self._end(book, arm, ArmState.UNPRINTED, outcome, outcome.state.name.lower())

    def _end(self, book: FaceBook, arm: ActiveArm, state: ArmState, outcome: Outcome, reason: str) -> list[ArmChange]:
        # It leaves the book once the journal has it: until then the face can't be put down again.
        book.update(arm.intent.arm_id, state=state)
        return [self._change(arm, state, outcome, reason)]

    def _change(self, arm: ActiveArm, state: ArmState, outcome: Outcome | None = None, reason: str = "") -> ArmChange:
        calibration = self.calibration
        return ArmChange(
            arm_id=arm.intent.arm_id,
            state=state,
            detect_seq=arm.detect_seq,
            tile_seq=arm.tile_seq,
            printer_boot=calibration.printer_boot if calibration is not None else None,
            plc_boot=calibration.plc_boot if calibration is not None else None,
            rows_printed=outcome.rows_printed if outcome is not None else None,
            data_crc32=outcome.data_crc32 if outcome is not None else None,
            reason=reason,
        )

    def _written(self, changes: Sequence[ArmChange]) -> None:
        """Go on from what the journal has: a printed tile may be released, a face without a print comes again."""
        book = self._host.book
        for change in changes:
            if book is None or change.arm_id not in book.active:
                continue
            if change.state is ArmState.PRINTED:
                book.update(change.arm_id, recorded=True)
                self._host.releases_wanted()
            elif change.state not in OPEN:
                book.close(change.arm_id, change.state)

    async def written(self) -> None:
        """Wait until everything begun is in the journal."""
        await self._behind.through()
