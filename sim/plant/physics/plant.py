"""The whole plant: loader, belt, eye, print head, diverter, kiln and gauge on one timeline."""

from __future__ import annotations

import random
from collections import deque
from pathlib import Path

from sim.plant.config import PlantConfig
from sim.plant.physics.camera import Camera
from sim.plant.physics.conveyor import Conveyor, Passage, Trouble
from sim.plant.physics.firing import FiringDrift
from sim.plant.physics.gauge import Gauge
from sim.plant.physics.head import Head
from sim.plant.physics.kiln import Kiln
from sim.plant.physics.tiles import Print, Tile, Truth
from sim.plant.physics.timeline import Timeline

_TOUCH_MM = 2.0
_RANK_LEAD, _RANK_TRAIL = 0, 1


class Plant:
    """The plant without wires; whoever uses it hands in the time and, in threads, keeps others out.

    Parameters
    ----------
    config
        What it is like.
    wall
        Wall time of the start, in seconds of any monotonic clock.
    epoch_s
        The same in seconds since 1970, for the names of the camera's images.
    """

    def __init__(self, config: PlantConfig, wall: float = 0.0, epoch_s: float = 0.0) -> None:
        self.config = config
        belt = config.belt
        self.timeline = Timeline(config.clock.rate, wall)
        self.truth = Truth(config.keep_tiles, Path(config.truth_file) if config.truth_file else None)
        self._chance = random.Random(f"loader:{config.loader.seed}")
        boots = random.Random(f"boots:{config.loader.seed}")
        self._tiles_made = 0
        self._feed_waits = False
        self._next_place = 0.0
        self._doubles = self._gaps = 0
        self._on_belt: deque[Tile] = deque()
        self._passage: Passage | None = None
        self._eye = 0
        self._detected = (0, 0)
        self.head = Head(self.timeline, belt, config.printer, boots, self._printed, self._count, self._tile_there)
        self.gauge = Gauge(config.gauge.seed)
        self.conveyor = Conveyor(self.timeline, belt, boots, self._driven)
        kiln, camera = config.kiln, config.camera
        self.drift = FiringDrift(config.printer.inks, kiln.walk_delta_e, kiln.seed) if kiln.press else None
        self.kiln = Kiln(self.timeline, kiln, boots, self._fired, self.conveyor.kiln_fills, self.drift)
        self.camera: Camera | None = None
        if camera.folder:
            self.camera = Camera(self.timeline, camera, epoch_s, config.loader.tile_width_mm)

    def advance(self, wall: float) -> None:
        """Bring everything up to a wall time (s)."""
        self.timeline.advance(wall)

    def _count(self, name: str) -> None:
        self.truth.counts[name] += 1

    # Faults of the plant

    def e_stop(self, pressed: bool) -> None:
        """The e-stop button goes in or is released; belt and printer both see it."""
        self.head.press_e_stop(pressed)
        self.conveyor.set_cause(Trouble.E_STOP, pressed)

    def jam(self, slip_mm: float = 0.0) -> None:
        """A tile gets stuck between eye and head; it may slip back on the belt by some mm."""
        eye_to_head = self.config.belt.eye_to_head_mm
        here = [
            tile
            for tile in self._on_belt
            if tile.lead_x + tile.length_mm <= self.timeline.x <= tile.lead_x + eye_to_head
        ]
        if here and slip_mm:
            here[0].lead_x += slip_mm
            self.truth.touch(here[0])
        self.conveyor.set_cause(Trouble.JAM, True)

    def jam_clear(self, *, remove: bool = False) -> None:
        """The jam is over; the tile nearest before the diverter may have been taken off the belt."""
        if remove and self._on_belt:
            self._remove(self._on_belt[0])
        self.conveyor.set_cause(Trouble.JAM, False)

    def double_feed(self, count: int = 1) -> None:
        """The loader's next tile comes with another that touches it."""
        self._doubles += count

    def missing_tile(self, where: str = "loader", count: int = 1) -> None:
        """A tile is missing: the loader doesn't put it down, or it falls off the belt between eye and head."""
        if where == "loader":
            self._gaps += count
            return
        eye_to_head, x = self.config.belt.eye_to_head_mm, self.timeline.x
        here = [tile for tile in self._on_belt if tile.lead_x + tile.length_mm <= x < tile.lead_x + eye_to_head]
        for tile in here[:count]:
            self._remove(tile)

    def _remove(self, tile: Tile) -> None:
        self._on_belt.remove(tile)
        self.truth.settle(tile, "removed", self.timeline.t)
        self._forget_prints(tile)

    def _forget_prints(self, tile: Tile) -> None:
        """What was printed on a tile isn't kept any longer."""
        for print_ in tile.prints:
            self.head.shelf.take(print_.kept)
            print_.kept = None

    # The loader

    def _driven(self) -> None:
        if self.conveyor.feed and not self._feed_waits:
            self._schedule_feed()

    def _schedule_feed(self) -> None:
        loader = self.config.loader
        if loader.tiles and self._tiles_made >= loader.tiles:
            return
        self._feed_waits = True
        self.timeline.at_travel(max(self.timeline.x, self._next_place), self._feed)

    def _feed(self) -> None:
        self._feed_waits = False
        if not self.conveyor.feed:
            return
        loader, conveyor = self.config.loader, self.conveyor
        length = loader.tile_length_mm or conveyor.tile_length_mm
        length += self._chance.uniform(-1, 1) * loader.length_jitter_mm
        pitch = conveyor.tile_pitch_mm + self._chance.uniform(-1, 1) * loader.jitter_mm
        x = self.timeline.x + self.config.belt.load_to_eye_mm
        conveyor.tiles_fed += 1
        taken = length
        if self._gaps:
            self._gaps -= 1
        else:
            self._place(x, length)
            if self._doubles:
                self._doubles -= 1
                self._place(x + length, length)
                taken += length
        self._next_place = self.timeline.x + taken + max(pitch - length, _TOUCH_MM)
        self._schedule_feed()

    def _place(self, x: float, length: float) -> None:
        self._tiles_made += 1
        tile = Tile(self._tiles_made, x, length)
        self.truth.add(tile)
        self.timeline.at_travel(x, lambda: self._lead(tile, x), rank=_RANK_LEAD)
        self.timeline.at_travel(x + length, lambda: self._trail(x + length), rank=_RANK_TRAIL)

    # The eye

    def _lead(self, tile: Tile, x: float) -> None:
        self._eye += 1
        if self._eye == 1 or self._passage is None:
            passage = self._passage = Passage(x)
            self.conveyor.eye_covered(passage)
            self._detected = (self.head.boot_id, self.head.eye_covered(x))
            self.timeline.at_travel(
                x + self.config.belt.eye_to_head_mm + self.config.belt.head_to_diverter_mm,
                lambda: self._divert(passage),
            )
        self._passage.tiles.append(tile)
        tile.plc_boot, tile.tile_seq = self._passage.plc_boot, self._passage.tile_seq
        tile.printer_boot, tile.detect_seq = self._detected
        self._on_belt.append(tile)
        self.truth.touch(tile)

    def _trail(self, x: float) -> None:
        self._eye -= 1
        if not self._eye and self._passage is not None:
            self.head.eye_free(*self._detected, x)
            self.conveyor.eye_free(self._passage, x - self._passage.lead_x)
            self._passage = None

    # The head

    def _tile_there(self, first_x: float, last_x: float) -> bool:
        head = self.config.belt.eye_to_head_mm
        return any(
            tile.lead_x + head < last_x and tile.lead_x + head + tile.length_mm > first_x for tile in self._on_belt
        )

    def _printed(self, print_: Print) -> None:
        head = self.config.belt.eye_to_head_mm
        best: Tile | None = None
        most = 0.0
        for tile in self._on_belt:
            first, last = tile.lead_x + head, tile.lead_x + head + tile.length_mm
            shared = min(last, print_.start_x + print_.printed_mm) - max(first, print_.start_x)
            if shared > most:
                best, most = tile, shared
        if best is not None:
            print_.on_tile = True
            print_.offset_mm = round(print_.start_x - best.lead_x - head, 6)
            print_.centre_mm = round(print_.offset_mm + (print_.length_mm - best.length_mm) / 2, 6)
        self.truth.printed(print_, best)
        if best is None:
            self.head.shelf.take(print_.kept)
            print_.kept = None
        elif self.drift is not None:
            best.laid = self.drift.laid(self.timeline.t)

    # The diverter and what comes after

    def _divert(self, passage: Passage) -> None:
        passes = self.conveyor.decide(passage)
        for tile in passage.tiles:
            if tile.fate != "on_belt":
                continue
            self._on_belt.remove(tile)
            self.truth.settle(tile, "passed" if passes else "diverted", self.timeline.t)
            if passes:
                self._to_kiln(tile)
            else:
                self._forget_prints(tile)

    def _to_kiln(self, tile: Tile) -> None:
        def enter() -> None:
            self.truth.settle(tile, "in_kiln", self.timeline.t)
            self.kiln.enter(tile)

        self.timeline.at_travel(self.timeline.x + self.config.belt.diverter_to_kiln_mm, enter)

    def _fired(self, tile: Tile, whole: bool) -> None:
        if self.camera is not None:
            self.camera.see(tile, whole)
        self._forget_prints(tile)
        self.truth.settle(tile, "fired" if whole else "broken", self.timeline.t)
        if whole:
            self.gauge.see(tile.id, self.kiln.temperatures())

    def close(self) -> None:
        """Close the truth file."""
        self.truth.close()
