"""A plant without wires, driven by hand: its wall clock is a number, and nothing happens but in `until`."""

from __future__ import annotations

from typing import Any
from zlib import crc32

from sim.plant.config import parse_plant
from sim.plant.physics.conveyor import Command, Trouble
from sim.plant.physics.faces import ArmAnswer, Order, StripAnswer
from sim.plant.physics.plant import Plant
from sim.plant.physics.tiles import Tile

EYE_TO_HEAD = 2600.0
TO_DIVERTER = EYE_TO_HEAD + 2000
COUNTS = 20


class Bench:
    """A plant, and a host that does everything right unless told otherwise."""

    def __init__(self, **tables: Any) -> None:
        self.plant = Plant(parse_plant(tables))
        self.wall = 0.0
        self.cmd_seq = 0
        self.alive = True

    @property
    def x(self) -> float:
        return self.plant.timeline.x

    @property
    def head(self) -> Any:
        return self.plant.head

    @property
    def conveyor(self) -> Any:
        return self.plant.conveyor

    def until(self, wall: float) -> None:
        """Let time pass, with the heartbeats of a living host."""
        while self.wall < wall:
            self.wall = min(wall, self.wall + 0.25 if self.alive else wall)
            self.plant.advance(self.wall)
            if self.alive:
                self.conveyor.alive()
                self.head.alive()

    def after(self, seconds: float) -> None:
        self.until(self.wall + seconds)

    def until_travel(self, x: float) -> None:
        """Let the belt come to a travel in mm, to within a millionth."""
        while self.x < x - 1e-6:
            due = self.plant.timeline.wall_at_travel(x)
            assert due < float("inf"), "the belt never comes there"
            self.until(max(due, self.wall + 1e-9))

    def command(self, run: bool = True, feed: bool = True, **changes: Any) -> None:
        """Send a command block and let the controller act on it."""
        self.cmd_seq += 1
        values = {
            "cmd_seq": self.cmd_seq,
            "run_belt": run,
            "feed": feed,
            "speed_mm_s": 500.0,
            "tile_length_mm": 600.0,
            "tile_pitch_mm": 700.0,
            "release_base": 1,
            "release_bits": 0,
            "ack_fault": 0,
        }
        self.conveyor.command(Command(**(values | changes)))
        self.after(0.02)

    def open(self, session: int = 1) -> None:
        """Open a session with the printer and clear its hold."""
        assert self.head.hello(session)
        assert self.head.clear(self.head.fault_counter) == 0

    def start(self, **changes: Any) -> None:
        """Run the belt with tiles on it and a printer that is ready."""
        self.open()
        self.command(**changes)

    def wait_for_tile(self, seq: int = 1) -> None:
        """Let the next tiles come until one is seen."""
        while self.head.detect_seq < seq:
            self.after(0.05)

    def order(self, arm: int, seq: int = 1, **changes: Any) -> Order:
        """An order for a face of 600 rows of 1 mm that begins at the leading edge of a tile."""
        seen = next((entry for entry in self.head.seen(0) if entry.detect_seq == seq), None)
        values: dict[str, Any] = {
            "arm_id": arm,
            "face": arm + 100,
            "detect_seq": seq,
            "start_encoder": (seen.encoder if seen else 0) + round(EYE_TO_HEAD * COUNTS),
            "rows": 600,
            "cols": 10,
            "row_pitch_millicounts": COUNTS * 1000,
            "channels": 4,
            "bits": 8,
        }
        return Order(**(values | changes))

    def arm(self, arm: int, seq: int = 1, **changes: Any) -> ArmAnswer:
        return ArmAnswer(self.head.arm(self.order(arm, seq, **changes)))

    def send(self, arm: int, row: int, rows: int, *, row_bytes: int = 40, good: bool = True) -> StripAnswer:
        """Send a strip."""
        data = face(arm, row_bytes)[row * row_bytes : (row + rows) * row_bytes]
        return StripAnswer(self.head.take(arm, row, rows, len(data), crc32(data) if good else None))

    def outcome(self, arm: int) -> Any:
        return next(armed for armed in self.head.outcomes(arm) if armed.order.arm_id == arm)

    def tiles(self) -> list[Tile]:
        return sorted(self.plant.truth._tiles.values(), key=lambda tile: tile.id)

    def truth(self) -> dict[int, dict[str, Any]]:
        return {tile["id"]: tile for tile in self.plant.truth.view()["tiles"]}

    @property
    def trouble(self) -> Trouble:
        return self.conveyor.view().trouble

    def counts(self) -> dict[str, Any]:
        return self.plant.truth.summary()


def face(arm: int, row_bytes: int = 40) -> bytes:
    """The bytes of a face's 600 rows."""
    return bytes((arm * 7 + at) & 0xFF for at in range(256)) * (600 * row_bytes // 256 + 1)
