"""The conveyor's loop: moves the belt, releases tiles whose faces are recorded, learns which passed."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tilefab.control.ledger import ArmState
from tilefab.control.reconcile import ConveyorMemory
from tilefab.control.tile_tracking import Calibration, cross_check
from tilefab.devices import PlcCommand, PlcSession, PlcStatus
from tilefab.errors import DeviceRefused
from tilefab.io.journal import ArmChange
from tilefab.pipeline.line.host import LineHost
from tilefab.pipeline.line.keeper import JournalKeeper, WriteBehind
from tilefab.pipeline.line.probe import Probe, nothing

_RELEASE_WINDOW = 32
_CHECK_TOLERANCE_MM = 3.0
_UNSEEN_TILE_S = 0.5
"""For how long one of two devices may know of a tile that the other hasn't told of."""


@dataclass(frozen=True)
class BeltSettings:
    """What a recipe asks of the belt.

    Attributes
    ----------
    speed_mm_s
        Of the belt.
    tile_length_mm, tile_pitch_mm
        Along the travel.
    """

    speed_mm_s: float
    tile_length_mm: float
    tile_pitch_mm: float


AT_REST = BeltSettings(speed_mm_s=0.0, tile_length_mm=3000.0, tile_pitch_mm=4000.0)
"""Until a job says more: a belt that an earlier daemon left running must stop, and no tile on it is too long."""


class ConveyorLoop:
    """Talks to the conveyor's controller.

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
        self.status: PlcStatus | None = None
        self.run_belt = False
        self.feed = False
        self.settings = AT_REST
        self.calibration: Calibration | None = None
        self.counts_per_mm = 0.0
        self.spoilt_boot = 0
        """Boot in which the controller holds releases of tiles of an earlier one."""
        self.edges: dict[int, int] = {}
        """The printer's edges, see `PrinterLoop.edges`: shared, not copied."""
        self._commanded: PlcCommand | None = None
        self._commanded_boot = -1
        self._ack_fault: int | None = None
        self._acked_anew = 0
        self._unseen: tuple[int, float] | None = None

    def begin_at(self, calibration: Calibration) -> None:
        """Follow tiles from here on."""
        self.calibration = calibration
        self._unseen = None

    def acknowledge(self) -> None:
        """Acknowledge the latched faults that were read last, with the next command."""
        if self.status is not None:
            self._ack_fault = self.status.fault_counter
            # Also what was acknowledged before must be said again: the button may have been pressed then.
            self._commanded, self._acked_anew = None, self._acked_anew + 1

    async def cycle(self, session: PlcSession) -> None:
        """One round: what the belt does, which tiles were decided, and what it should do."""
        status = await session.poll()
        self._take_status(status)
        if self.calibration is not None and status.boot_id == self.calibration.plc_boot:
            self._check_tiles(status)
            self._decided(status)
        await self._command(session, status)

    def _take_status(self, status: PlcStatus) -> None:
        before, self.status = self.status, status
        self._look_at(before, status)

    def _look_at(self, before: PlcStatus | None, status: PlcStatus) -> None:
        host = self._host
        if before is not None and before.boot_id != status.boot_id:
            # Faults are counted anew: the same number is another fault.
            self._ack_fault = None
        for flag, code in (
            (status.jam, "jam"),
            (status.double_feed, "double_feed"),
            (status.diverter_fault, "diverter_fault"),
        ):
            if flag:
                host.tiles_moved(code)
        if before is None or before.e_stop != status.e_stop:
            host.e_stop("plc", status.e_stop)
        if self.calibration is not None and status.boot_id != self.calibration.plc_boot:
            # Told once: until the line is brought up, nothing is known of any tile.
            self.calibration = None
            host.doubt(
                "plc_rebooted", "the conveyor's controller was restarted: where its tiles are is no longer known"
            )
            return
        latched = (
            (status.jam, "jam", "tiles are jammed on the belt"),
            (status.double_feed, "double_feed", "the conveyor saw a tile too long, or two at once"),
            (status.diverter_fault, "diverter_fault", "the diverter doesn't move as it should"),
            (status.deadman_tripped, "deadman_plc", "the conveyor heard nothing for too long and stopped"),
        )
        if host.moving:
            for flag, code, reason in latched:
                if flag:
                    host.doubt(code, reason)

    def _check_tiles(self, status: PlcStatus) -> None:
        """Hold the two counts of tiles against each other."""
        calibration = self.calibration
        if calibration is None or not self._host.moving or not self.counts_per_mm:
            return
        now = asyncio.get_running_loop().time()
        tolerance = round(_CHECK_TOLERANCE_MM * self.counts_per_mm)
        problem = cross_check(calibration, self.edges, status.tile_seq, status.tile_position_counts, tolerance)
        newest = max(self.edges, default=calibration.detect_seq)
        behind = calibration.tile_seq(newest) != status.tile_seq
        if problem:
            self._host.doubt("tiles_disagree", problem)
        if not behind:
            self._unseen = None
        elif self._unseen is None or self._unseen[0] != newest:
            self._unseen = (newest, now)
        elif now - self._unseen[1] > _UNSEEN_TILE_S:
            self._host.doubt(
                "tiles_disagree",
                f"the printer has seen tile {calibration.tile_seq(newest)}, the conveyor {status.tile_seq}",
            )

    def _decided(self, status: PlcStatus) -> None:
        book, calibration = self._host.book, self.calibration
        if book is None or calibration is None:
            return
        memory = ConveyorMemory(status.boot_id, status.decided_seq, status.passed_bits)
        changes = []
        for arm in book.in_state(ArmState.PRINTED):
            if arm.tile_seq is None:
                continue
            try:
                passed = memory.fate(arm.tile_seq)
            except LookupError as error:
                book.update(arm.intent.arm_id, state=ArmState.IN_DOUBT)
                changes.append(ArmChange(arm.intent.arm_id, ArmState.IN_DOUBT, reason=str(error)))
                self._host.doubt("tile_lost", str(error))
                continue
            if passed is None:
                continue
            state = ArmState.PASSED if passed else ArmState.DIVERTED
            reason = "" if passed else "released too late" if not arm.released else "diverted although released"
            if not passed:
                self._host.doubt(
                    "good_tile_diverted", f"tile {arm.tile_seq} with face {arm.intent.face} was scrapped: {reason}"
                )
            book.update(arm.intent.arm_id, state=state)
            changes.append(ArmChange(arm.intent.arm_id, state, reason=reason))
            self._host.tile_done(passed)
        if changes:
            self._probe("decided.read")
            self._behind.write(changes, "decided")

    def _written(self, changes: Sequence[ArmChange]) -> None:
        book = self._host.book
        for change in changes:
            if book is not None and change.arm_id in book.active:
                book.close(change.arm_id, change.state)

    async def written(self) -> None:
        """Wait until everything begun is in the journal."""
        await self._behind.through()

    def _wanted(self, status: PlcStatus) -> PlcCommand:
        settings = self.settings
        base, bits = self._releases(status)
        return PlcCommand(
            run_belt=self.run_belt,
            feed=self.run_belt and self.feed,
            speed_mm_s=settings.speed_mm_s,
            tile_length_mm=settings.tile_length_mm,
            tile_pitch_mm=settings.tile_pitch_mm,
            release_base=base,
            release_bits=bits,
            ack_fault=self._ack_fault if self._ack_fault is not None else 0,
        )

    def _releases(self, status: PlcStatus) -> tuple[int, int]:
        """The tiles that may pass, from the oldest one on: those whose faces the journal holds as printed."""
        book = self._host.book
        if book is None or self.calibration is None or status.boot_id != self.calibration.plc_boot:
            return 0, 0
        tiles = [arm.tile_seq for arm in book.in_state(ArmState.PRINTED) if arm.recorded and arm.tile_seq is not None]
        if not tiles:
            return 0, 0
        base = tiles[0]
        return base, sum(1 << tile - base for tile in tiles if 0 <= tile - base < _RELEASE_WINDOW)

    async def _command(self, session: PlcSession, status: PlcStatus) -> None:
        wanted = self._wanted(status)
        same_boot = status.boot_id == self._commanded_boot
        if same_boot and wanted == self._commanded:
            return
        if self._ack_fault is not None and self._ack_fault != status.fault_counter:
            # A newer fault came: acknowledging it unseen would be wrong.
            self._ack_fault = None
            wanted = replace(wanted, ack_fault=0)
        releasing = self._arms_of(wanted)
        if releasing:
            self._probe("release.before")
            self._note_releases(releasing, asked_release=True)
        self._commanded, acknowledging = None, self._acked_anew
        try:
            after = await session.command(wanted)
        except DeviceRefused as error:
            self._host.doubt("plc_refused", error.message)
            return
        if releasing and after.boot_id != status.boot_id:
            # It was restarted in between, and took releases of tiles that it has yet to count.
            self.spoilt_boot = after.boot_id
        self._take_status(after)
        if acknowledging == self._acked_anew:
            self._commanded, self._commanded_boot = wanted, after.boot_id
        if releasing:
            self._note_releases(releasing, released=True)
            self._probe("release.acked")

    def _arms_of(self, command: PlcCommand) -> list[int]:
        """Arms whose tiles a command releases."""
        book = self._host.book
        if book is None or not command.release_bits:
            return []
        return [
            arm.intent.arm_id
            for arm in book.in_state(ArmState.PRINTED)
            if arm.tile_seq is not None
            and 0 <= arm.tile_seq - command.release_base < _RELEASE_WINDOW
            and command.release_bits >> arm.tile_seq - command.release_base & 1
        ]

    def _note_releases(self, arms: list[int], **changes: bool) -> None:
        book = self._host.book
        for arm_id in arms:
            if book is not None and arm_id in book.active:
                book.update(arm_id, **changes)
