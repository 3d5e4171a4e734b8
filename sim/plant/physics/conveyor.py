"""The conveyor's controller: faults that latch, commands that are levels, tiles it tracks and decides about."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntFlag

from sim.plant.config import BeltConfig
from sim.plant.physics.tiles import Tile
from sim.plant.physics.timeline import Timeline

DEAD_MAN_S = 0.5
SCAN_S = 0.01
_MOST_BITS = 64
_DOUBLE = 1.3
"""The eye covered for this many tile lengths: two tiles in one."""


class Trouble(IntFlag):
    """Faults that latch."""

    E_STOP = 2
    JAM = 4
    DEAD_MAN = 8
    DOUBLE_FEED = 16
    DIVERTER = 128


@dataclass(frozen=True)
class Command:
    """The command block as it stood when the controller acted on it."""

    cmd_seq: int
    run_belt: bool
    feed: bool
    speed_mm_s: float
    tile_length_mm: float
    tile_pitch_mm: float
    release_base: int
    release_bits: int
    ack_fault: int


@dataclass
class Passage:
    """What the eye saw as one: a tile, or tiles that touch."""

    lead_x: float
    tiles: list[Tile] = field(default_factory=list)
    plc_boot: int = 0
    tile_seq: int = 0


@dataclass(frozen=True)
class ConveyorView:
    """What the controller shows, in physical units; positions in encoder counts since its boot."""

    scan_counter: int
    boot_id: int
    belt_running: bool
    trouble: Trouble
    feed_enabled: bool
    ready: bool
    kiln_full: bool
    belt_speed_mm_s: float
    position: int
    tile_seq: int
    tile_position: int
    decided_seq: int
    passed_bits: int
    cmd_ack: int
    fault_counter: int
    tiles_fed: int


class Conveyor:
    """The controller of the belt, its loader and its diverter.

    Parameters
    ----------
    timeline
        The plant's clock and belt.
    belt
        Lengths and accelerations.
    boots
        Where boot identities come from.
    on_drive
        Called after each change of what the belt or the loader is to do.
    """

    def __init__(
        self, timeline: Timeline, belt: BeltConfig, boots: random.Random, on_drive: Callable[[], None]
    ) -> None:
        self._timeline = timeline
        self._belt = belt
        self._boots = boots
        self._on_drive: Callable[[], None] = lambda: None
        self.causes = Trouble(0)
        self.kiln_full = False
        self._hung = False
        self.boot_id = 0
        self.up = False
        self.power_up()
        self._on_drive = on_drive

    def power_up(self) -> None:
        """Start with nothing remembered: counters at 0, no releases, the belt stopped."""
        old = self.boot_id
        while self.boot_id in (0, old):
            self.boot_id = self._boots.randrange(1, 1 << 16)
        self.up = True
        self._hung = False
        self._boot_wall, self._boot_x = self._timeline.wall, self._timeline.x
        self._trouble = Trouble(0)
        self._command: Command | None = None
        self._waiting: Command | None = None
        self._may_run = False
        self._released: set[int] = set()
        self._heartbeat = self._timeline.wall
        self._watching = False
        self._tile_seq = self._tile_x = self._decided_seq = self._passed_bits = 0
        self._cmd_ack = self._fault_counter = 0
        self.tiles_fed = 0
        self._covered = 0.0
        self.run = self.feed = False
        for cause in (Trouble.E_STOP, Trouble.JAM, Trouble.DIVERTER):
            if cause in self.causes:
                self._latch(cause)
        self._drive()

    def power_down(self) -> None:
        """Stop at once, as without current."""
        self.up = False
        self._may_run = False
        self._drive()

    def alive(self) -> None:
        """The host has shown that it lives."""
        self._heartbeat = self._timeline.wall

    def command(self, command: Command) -> None:
        """Take a command block; it is acted on with the next scan, if it is newer than the last."""
        self._waiting = command
        scans = int((self._timeline.wall - self._boot_wall) / SCAN_S) + 1
        boot = self.boot_id
        self._timeline.at_wall(self._boot_wall + scans * SCAN_S, lambda: self._scan(boot))

    def hang(self, hung: bool) -> None:
        """The program hangs, so that no command and no dead-man switch acts, or goes on."""
        if self._hung and not hung:
            self._hung = False
            self.alive()
            self._scan(self.boot_id)
        self._hung = hung

    def _scan(self, boot: int) -> None:
        command = self._waiting
        if command is None or boot != self.boot_id or not self.up or self._hung:
            return
        self._waiting = None
        if self._command is not None and not 0 < (command.cmd_seq - self._command.cmd_seq) % 65536 < 32768:
            return
        self._command = command
        self._cmd_ack = command.cmd_seq
        self._released |= {
            (command.release_base + bit) & 0xFFFFFFFF for bit in range(32) if command.release_bits >> bit & 1
        }
        self._released = {seq for seq in self._released if seq > self._decided_seq}
        if self._trouble:
            if command.ack_fault == self._fault_counter:
                self._trouble &= self.causes
        elif command.run_belt:
            self._may_run = True
        self._drive()

    def set_cause(self, cause: Trouble, present: bool) -> None:
        """A cause of a fault comes or goes."""
        if present:
            self.causes |= cause
            if self.up:
                self._latch(cause)
        else:
            self.causes &= ~cause

    def _latch(self, trouble: Trouble) -> None:
        if trouble not in self._trouble:
            self._trouble |= trouble
            self._fault_counter = (self._fault_counter + 1) & 0xFFFF
        self._may_run = False
        self._drive()

    def _drive(self) -> None:
        command = self._command
        self.run = bool(self.up and command and command.run_belt and self._may_run and not self._trouble)
        known = command is not None and command.tile_length_mm > 0 and command.tile_pitch_mm > 0
        self.feed = bool(self.run and command and command.feed and known and not self.kiln_full)
        speed = min(command.speed_mm_s, self._belt.most_speed_mm_s) if command and self.run else 0.0
        hard = Trouble.E_STOP in self._trouble or not self.up
        if speed != self._timeline.target_speed or (hard and self._timeline.speed > 0):
            slower = self._belt.e_stop_decel_mm_s2 if hard else self._belt.decel_mm_s2
            self._timeline.set_speed(speed, self._belt.accel_mm_s2 if speed > self._timeline.speed else slower)
        if self.run and not self._watching:
            self._watching = True
            self.alive()
            boot = self.boot_id
            self._timeline.at_wall(self._heartbeat + DEAD_MAN_S, lambda: self._dead_man(boot))
        self._on_drive()

    def _dead_man(self, boot: int) -> None:
        if boot != self.boot_id:
            return
        if not (self.up and self.run):
            self._watching = False
            return
        due = self._heartbeat + DEAD_MAN_S
        if self._timeline.wall >= due - 1e-9 and not self._hung:
            self._watching = False
            self._latch(Trouble.DEAD_MAN)
        else:
            self._timeline.at_wall(max(due, self._timeline.wall + SCAN_S), lambda: self._dead_man(boot))

    def kiln_fills(self, full: bool) -> None:
        """The kiln has no room for more, or has again."""
        if full != self.kiln_full:
            self.kiln_full = full
            self._drive()

    @property
    def tile_length_mm(self) -> float:
        """Length of the tiles that the controller was told of; 0 before the first command."""
        return self._command.tile_length_mm if self._command else 0.0

    @property
    def tile_pitch_mm(self) -> float:
        """Pitch at which tiles are to be fed; 0 before the first command."""
        return self._command.tile_pitch_mm if self._command else 0.0

    def eye_covered(self, passage: Passage) -> None:
        """A leading edge at the eye."""
        if not self.up:
            return
        self._tile_seq = (self._tile_seq + 1) & 0xFFFFFFFF
        self._tile_x = self.counts(passage.lead_x)
        passage.plc_boot, passage.tile_seq = self.boot_id, self._tile_seq

    def eye_free(self, passage: Passage, length_mm: float) -> None:
        """A trailing edge at the eye."""
        known = self.tile_length_mm
        if self.up and passage.plc_boot == self.boot_id and known and length_mm > _DOUBLE * known:
            self._latch(Trouble.DOUBLE_FEED)

    def decide(self, passage: Passage) -> bool:
        """Say whether what comes to the diverter passes; without power or a release it doesn't."""
        if not self.up or passage.plc_boot != self.boot_id:
            return False
        passes = passage.tile_seq in self._released and Trouble.DIVERTER not in self._trouble
        self._released.discard(passage.tile_seq)
        step = min(passage.tile_seq - self._decided_seq, _MOST_BITS)
        self._passed_bits = (self._passed_bits << step | passes) & (1 << _MOST_BITS) - 1
        self._decided_seq = passage.tile_seq
        return passes

    def counts(self, x: float) -> int:
        """Encoder counts since boot at a travel (mm), in 32 bits."""
        return int((x - self._boot_x) * self._belt.counts_per_mm + 1e-6) & 0xFFFFFFFF

    def view(self) -> ConveyorView:
        """What the controller shows now."""
        timeline = self._timeline
        return ConveyorView(
            scan_counter=int((timeline.wall - self._boot_wall) / SCAN_S) & 0xFFFF,
            boot_id=self.boot_id,
            belt_running=timeline.speed > 0,
            trouble=self._trouble,
            feed_enabled=self.feed,
            ready=not self._trouble,
            kiln_full=self.kiln_full,
            belt_speed_mm_s=timeline.speed,
            position=self.counts(timeline.x),
            tile_seq=self._tile_seq,
            tile_position=int(self._tile_x),
            decided_seq=self._decided_seq,
            passed_bits=self._passed_bits,
            cmd_ack=self._cmd_ack,
            fault_counter=self._fault_counter,
            tiles_fed=self.tiles_fed & 0xFFFFFFFF,
        )
