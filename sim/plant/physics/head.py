"""The print head and its controller: faces armed at encoder positions, rows that must be there in time."""

from __future__ import annotations

import dataclasses
import hashlib
import random
from collections import deque
from collections.abc import Callable
from typing import Any

from sim.plant.checks import crc32_joined
from sim.plant.config import BeltConfig, PrinterConfig
from sim.plant.physics.faces import ArmAnswer, Armed, Memory, Order, Seen, State, StripAnswer
from sim.plant.physics.flaws import Flaw, KeptPrint, Shelf
from sim.plant.physics.tiles import Print
from sim.plant.physics.timeline import Timeline

DEAD_MAN_S = 0.5
_KEPT = 64
_FULL = 1000.0


class Head:
    """The printer's controller.

    Parameters
    ----------
    timeline
        The plant's clock and belt.
    belt, printer
        Lengths, and what the printer can.
    boots
        Where boot identities come from.
    on_print
        Called with each print that has put down rows.
    on_count
        Called with the names of things to be counted.
    tile_there
        The sensor before the head: whether any of a tile will lie under what is printed from one travel to another.
    """

    def __init__(
        self,
        timeline: Timeline,
        belt: BeltConfig,
        printer: PrinterConfig,
        boots: random.Random,
        on_print: Callable[[Print], None],
        on_count: Callable[[str], None],
        tile_there: Callable[[float, float], bool],
    ) -> None:
        self._timeline = timeline
        self._belt = belt
        self._printer = printer
        self._boots = boots
        self._on_print = on_print
        self._on_count = on_count
        self._tile_there = tile_there
        self.memory = Memory()
        self.shelf = Shelf(printer.keep_bytes if printer.keep_prints else 0)
        self.ink = [_FULL] * printer.inks
        self.e_stop_pressed = False
        self.nozzles_out = False
        self.flaws: list[Flaw] = []
        self._doubles: list[Flaw] = []
        self.boot_id = 0
        self.up = False
        self.power_up()

    # Power

    def power_up(self) -> None:
        """Start held, with encoder and detections at 0; only the non-volatile memory is as it was."""
        old = self.boot_id
        while self.boot_id in (0, old):
            self.boot_id = self._boots.randrange(1, 1 << 32)
        self.up = True
        self._boot_x = self._timeline.x
        self.session: int | None = None
        self.held = True
        self.e_stop = self.ink_out = self.nozzle_out = self.deadman = self.underrun = False
        self.fault_counter = 0
        self.detect_seq = 0
        self._seen: deque[Seen] = deque(maxlen=_KEPT)
        self._heard = self._timeline.wall
        self._watching = False
        if self.e_stop_pressed:
            self._latch("e_stop")
        if min(self.ink) <= 0:
            self._latch("ink_out")
        if self.nozzles_out:
            self._latch("nozzle_out")

    def power_down(self, *, forget: bool = False) -> None:
        """Lose power: what was queued is missed, what was being printed is partial; `forget` wipes the memory too."""
        self.up = False
        self.session = None
        for armed in list(self.memory.arms.values()):
            if armed.state is State.PRINTING:
                self._end(armed, State.PARTIAL, self._rows_begun(armed))
            elif armed.state is State.QUEUED:
                self._end(armed, State.MISSED, 0)
        if forget:
            self.memory = Memory()

    # Sessions and the dead-man

    def hello(self, session: int) -> bool:
        """Open a session; False if a higher one was open before."""
        if session < self.memory.session:
            return False
        self.memory.session = self.session = session
        self.alive()
        return True

    def alive(self) -> None:
        """The host has shown that it lives."""
        self._heard = self._timeline.wall
        if not self._watching and self.session is not None:
            self._watching = True
            boot = self.boot_id
            self._timeline.at_wall(self._heard + DEAD_MAN_S, lambda: self._dead_man(boot))

    def _dead_man(self, boot: int) -> None:
        if boot != self.boot_id or not self.up:
            return
        due = self._heard + DEAD_MAN_S
        if self._timeline.wall >= due - 1e-9:
            self._watching = False
            self._latch("deadman")
        else:
            self._timeline.at_wall(due, lambda: self._dead_man(boot))

    # Faults

    def _latch(self, name: str) -> None:
        if not getattr(self, name):
            setattr(self, name, True)
            self.fault_counter = (self.fault_counter + 1) & 0xFFFF
        self.held = True

    def press_e_stop(self, pressed: bool) -> None:
        """The e-stop button goes in or out; while it goes in, what is being printed ends."""
        self.e_stop_pressed = pressed
        if pressed and self.up:
            self._latch("e_stop")
            for armed in list(self.memory.arms.values()):
                if armed.state is State.PRINTING:
                    self._end(armed, State.PARTIAL, self._rows_begun(armed))

    def set_ink(self, ink: int, permille: float) -> None:
        """An ink's tank has this much."""
        self.ink[ink] = permille
        if permille <= 0 and self.up:
            self._latch("ink_out")

    def set_nozzles(self, out: bool, flaw: Flaw | None = None, *, noticed: bool = True) -> None:
        """A nozzle fails, or all are well again.

        Parameters
        ----------
        out
            Whether one fails.
        flaw
            What it leaves out, from now on; None for nothing to be seen.
        noticed
            Whether the controller finds out.
        """
        if not out:
            self.nozzles_out = False
            self.flaws = [other for other in self.flaws if other.kind != "nozzle"]
            return
        self.nozzles_out |= noticed
        if flaw is not None:
            self.flaws.append(flaw)
        for armed in self.memory.arms.values():
            if armed.state is State.PRINTING:
                armed.nozzle_out = True
                if flaw is not None:
                    armed.flaws += (dataclasses.replace(flaw, from_row=self._rows_begun(armed)),)
        if noticed and self.up:
            self._latch("nozzle_out")

    def set_banding(self, flaw: Flaw | None) -> None:
        """From the next print on rows are stronger and weaker in turn, or even again."""
        self.flaws = [other for other in self.flaws if other.kind != "banding"]
        if flaw is not None:
            self.flaws.append(flaw)

    def print_twice(self, flaw: Flaw, count: int) -> None:
        """So many of the next prints are laid down a second time."""
        self._doubles += [flaw] * count

    def hold(self) -> None:
        """From now on no print starts."""
        self.held = True

    def clear(self, fault_counter: int) -> int:
        """Clear faults and the hold; 0 done, 1 a stale counter, 2 a cause persists."""
        if fault_counter != self.fault_counter:
            return 1
        if self.e_stop_pressed or min(self.ink) <= 0 or self.nozzles_out:
            return 2
        self.held = self.e_stop = self.ink_out = self.nozzle_out = self.deadman = self.underrun = False
        self.alive()
        return 0

    # The eye

    def eye_covered(self, x: float) -> int:
        """A leading edge at the eye; its number, 0 if the printer is without power."""
        if not self.up:
            return 0
        self.detect_seq += 1
        self._seen.append(Seen(self.detect_seq, self.counts(x)))
        return self.detect_seq

    def eye_free(self, boot_id: int, detect_seq: int, x: float) -> None:
        """The trailing edge that belongs to a leading one."""
        if self.up and boot_id == self.boot_id:
            for seen in reversed(self._seen):
                if seen.detect_seq == detect_seq:
                    seen.length_counts = max(1, self.counts(x) - seen.encoder)
                    break

    def seen(self, from_seq: int) -> list[Seen]:
        """Detections still remembered, oldest first, from a number on."""
        return [seen for seen in self._seen if seen.detect_seq >= from_seq]

    def counts(self, x: float) -> int:
        """Encoder counts since boot at a travel (mm)."""
        return int((x - self._boot_x) * self._belt.counts_per_mm + 1e-6)

    # Arming

    def arm(self, order: Order) -> ArmAnswer:
        """Take an order to print a face at an encoder position."""
        known = self.memory.arms.get(order.arm_id)
        if known is not None and known.order == order:
            return ArmAnswer.DUPLICATE
        if order.arm_id <= self.memory.last_accepted:
            return ArmAnswer.NOT_ABOVE
        if self.held:
            return ArmAnswer.NOT_READY
        if not any(seen.detect_seq == order.detect_seq for seen in self._seen):
            return ArmAnswer.UNKNOWN_DETECTION
        if not self._fits(order):
            return ArmAnswer.BAD_GEOMETRY
        if order.start_encoder < self.counts(self._timeline.x) + self.min_lead_counts:
            return ArmAnswer.TOO_LATE
        if self.queued >= self._printer.queue_len:
            return ArmAnswer.QUEUE_FULL
        start_x = self._boot_x + order.start_encoder / self._belt.counts_per_mm
        armed = Armed(
            order,
            start_x,
            ahead_mm=start_x - self._timeline.x,
            pitch_mm=order.row_pitch_millicounts / 1000 / self._belt.counts_per_mm,
            digest=hashlib.sha256() if self._printer.verify == "sha256" else None,
        )
        self.memory.last_accepted = order.arm_id
        self.memory.arms[order.arm_id] = armed
        if len(self.memory.arms) > _KEPT:
            self.memory.arms.popitem(last=False)
        self._timeline.at_travel(armed.start_x, lambda: self._start(armed))
        return ArmAnswer.ACCEPTED

    def _fits(self, order: Order) -> bool:
        if not (order.rows and order.cols and order.row_pitch_millicounts):
            return False
        if not 1 <= order.channels <= self._printer.inks or order.bits != self._printer.bits:
            return False
        ends = [
            armed.order.start_encoder + armed.order.rows * armed.order.row_pitch_millicounts / 1000
            for armed in self.memory.arms.values()
            if armed.live
        ]
        return not ends or order.start_encoder >= max(ends)

    def disarm(self, arm_id: int) -> int:
        """Cancel a face; 0 done, 1 too late, 2 unknown."""
        armed = self.memory.arms.get(arm_id)
        if armed is None:
            return 2
        if armed.state is State.QUEUED:
            self._end(armed, State.CANCELLED, 0)
        return 0 if armed.state is State.CANCELLED else 1

    # Printing

    def _start(self, armed: Armed) -> None:
        if armed.state is not State.QUEUED:
            return
        if self.held or not self._tile_there(armed.start_x, armed.start_x + armed.order.rows * armed.pitch_mm):
            self._end(armed, State.MISSED, 0)
        elif not armed.rows_received:
            self._end(armed, State.MISSED, 0)
            self._latch("underrun")
            self._on_count("underruns")
        else:
            armed.state = State.PRINTING
            armed.nozzle_out = self.nozzles_out or any(flaw.kind == "nozzle" for flaw in self.flaws)
            armed.flaws = (*self.flaws, *self._doubles[:1])
            del self._doubles[:1]
            self._watch(armed)

    def _watch(self, armed: Armed) -> None:
        received = armed.rows_received

        def due() -> None:
            if armed.state is not State.PRINTING:
                return
            if armed.rows_received > received:
                self._watch(armed)
            elif received == armed.order.rows:
                self._end(armed, State.PRINTED, received)
            else:
                self._end(armed, State.PARTIAL, received)
                self._latch("underrun")
                self._on_count("underruns")

        self._timeline.at_travel(armed.start_x + received * armed.pitch_mm, due)

    def _end(self, armed: Armed, state: State, rows: int) -> None:
        armed.state = state
        armed.rows_printed = rows
        self.memory.last_outcome = armed.order.arm_id
        if state is State.MISSED:
            self._on_count("missed")
        if rows:
            self._use_ink(armed, rows)
            whole = armed.rows_received == armed.order.rows
            self._on_print(
                Print(
                    arm=armed.order.arm_id,
                    face=armed.order.face,
                    detect_seq=armed.order.detect_seq,
                    rows=rows,
                    rows_ordered=armed.order.rows,
                    complete=state is State.PRINTED,
                    crc32=armed.crc32,
                    sha256=armed.digest.hexdigest() if armed.digest and whole else None,
                    nozzle_out=armed.nozzle_out,
                    armed_ahead_mm=round(armed.ahead_mm, 3),
                    margin_mm=round(armed.margin_mm, 3),
                    start_x=armed.start_x,
                    length_mm=armed.order.rows * armed.pitch_mm,
                    printed_mm=rows * armed.pitch_mm,
                    at=self._timeline.t,
                    flaws=armed.flaws,
                    kept=self._kept(armed, rows),
                )
            )
        armed.digest = armed.data = None

    def _kept(self, armed: Armed, rows: int) -> KeptPrint | None:
        if armed.data is None:
            return None
        order = armed.order
        data = bytes(memoryview(armed.data)[: rows * armed.row_bytes])
        return self.shelf.put(KeptPrint(data, order.cols, order.channels, order.bits, armed.pitch_mm))

    def _use_ink(self, armed: Armed, rows: int) -> None:
        if self._printer.ink_faces:
            share = _FULL / self._printer.ink_faces * rows / armed.order.rows
            for ink in range(armed.order.channels):
                self.set_ink(ink, max(0.0, self.ink[ink] - share))

    def _rows_begun(self, armed: Armed) -> int:
        reached = int((self._timeline.x - armed.start_x) / armed.pitch_mm + 1e-9) + 1
        return max(0, min(reached, armed.rows_received))

    # Data

    def taking(self, session: int) -> bool:
        """Whether data of a session is taken."""
        return self.up and session == self.session

    def armed(self, arm_id: int) -> Armed | None:
        """A face that can still take rows."""
        armed = self.memory.arms.get(arm_id)
        return armed if armed is not None and armed.live and self.up else None

    @property
    def credit(self) -> int:
        """Bytes that the buffer can take now."""
        used = 0
        for armed in self.memory.arms.values():
            if not armed.live or not armed.rows_received:
                continue
            done = 0
            if armed.state is State.PRINTING:
                done = int((self._timeline.x - armed.start_x) / armed.pitch_mm + 1e-9)
            used += (armed.rows_received - min(done, armed.rows_received)) * armed.row_bytes
        return max(0, self._printer.buffer_bytes - used)

    def take(
        self,
        arm_id: int,
        row: int,
        rows: int,
        size: int,
        crc32: int | None,
        digest: Any = None,
        data: bytearray | None = None,
    ) -> StripAnswer:
        """Take a strip that has arrived whole.

        Parameters
        ----------
        crc32
            Checksum of its bytes; None if it isn't the one that was announced.
        digest
            The face's running SHA-256 with these bytes in it, where one is kept.
        data
            Its bytes, where prints are kept.
        """
        armed = self.armed(arm_id)
        if armed is None:
            return StripAnswer.UNKNOWN_ARM
        if row != armed.rows_received or not rows or row + rows > armed.order.rows or size != rows * armed.row_bytes:
            return StripAnswer.OUT_OF_ORDER
        if crc32 is None:
            return StripAnswer.BAD_CRC
        if size > self.credit:
            return StripAnswer.NO_CREDIT
        due = armed.start_x + armed.rows_received * armed.pitch_mm
        armed.margin_mm = min(armed.margin_mm, due - self._timeline.x)
        if data is not None and armed.data is not None:
            armed.data += data
        else:
            # Of a print that isn't there from its first row on nothing is kept.
            armed.data = None if armed.rows_received else data
        armed.rows_received += rows
        armed.crc32 = crc32_joined(armed.crc32, crc32, size)
        if digest is not None:
            armed.digest = digest
        return StripAnswer.TAKEN

    # Views

    @property
    def min_lead_counts(self) -> int:
        """How far ahead of the head a face must be armed."""
        return round(self._printer.min_lead_mm * self._belt.counts_per_mm)

    @property
    def encoder(self) -> int:
        """Encoder counts since boot."""
        return self.counts(self._timeline.x)

    @property
    def queued(self) -> int:
        """Faces that wait for their tile."""
        return sum(armed.state is State.QUEUED for armed in self.memory.arms.values())

    @property
    def printing(self) -> bool:
        """Whether rows are being put down."""
        return any(armed.state is State.PRINTING for armed in self.memory.arms.values())

    def outcomes(self, from_arm: int) -> list[Armed]:
        """Accepted faces still remembered, ascending, from an arm on."""
        return [armed for arm_id, armed in self.memory.arms.items() if arm_id >= from_arm]
