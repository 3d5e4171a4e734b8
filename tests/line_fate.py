"""What befalls a line over a month: faults of every kind at random moments, and hands that mend what has to be mended.

Everything here is set through the simulator's control port; docs/simulator.md tells of each kind.
"""

from __future__ import annotations

import heapq
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count
from typing import Any, TextIO

from tests.line_workshop import PlantProcess

MESSAGES = (
    *("mute", "late", "twice", "garble", "truncate", "noise", "reorder", "replay", "drop", "half_open"),
    *("wrong_unit", "wrong_function", "wrong_count", "old_tid"),
)
WIRES = ("plc", "kiln", "printer", "printer_data", "gauge")
REBOOTS = (
    *(("plc", "reboot"), ("kiln", "reboot"), ("printer", "reboot"), ("gauge", "reboot")),
    *(("printer", "reboot_lost"), ("kiln", "reboot_lost")),
)
VIEWS = (("plc", "stale"), ("kiln", "stale"), ("plc", "word_order"), ("kiln", "word_order"))
PLANT = (
    *("e_stop", "jam", "double_feed", "missing_tile", "ink_out", "nozzle_out", "diverter_fault"),
    *("zone_drift", "burner_fault", "kiln_block"),
)
_MENDED_BY = {
    "ink_out": "ink_refill",
    "nozzle_out": "nozzle_ok",
    "diverter_fault": "diverter_ok",
    "burner_fault": "burner_ok",
    "kiln_block": "kiln_unblock",
}
_LIES_MM = 0.5
"""A stopped belt moves by no more than this."""


@dataclass
class Fate:
    """Sets faults, and mends them.

    Attributes
    ----------
    plant
        The plant.
    chance
        Decides everything.
    every_s
        Mean wall time between two faults.
    log
        Where all that is done is written to, a line each.
    struck
        Faults set so far, by kind.
    wrong
        What the line did although an emergency stop was pressed.
    """

    plant: PlantProcess
    chance: random.Random
    every_s: float
    log: TextIO
    struck: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._order = count()
        self._mends: list[tuple[float, int, Callable[[], None]]] = []
        self._next: float | None = None
        self._standing: set[str] = set()

    def pass_by(self, now: float) -> None:
        """Do what is due at a wall time."""
        while self._mends and self._mends[0][0] <= now:
            heapq.heappop(self._mends)[2]()
        if self._next is None:
            self._next = now + self.chance.expovariate(1 / self.every_s)
        elif now >= self._next:
            self._next = now + self.chance.expovariate(1 / self.every_s)
            self._strike(now)
            if self.chance.random() < 0.15:
                self._strike(now)

    def rest(self) -> None:
        """Mend everything, and let nothing more happen."""
        while self._mends:
            heapq.heappop(self._mends)[2]()
        self._do("clear")

    def _strike(self, now: float) -> None:
        kind = self.chance.choices(("message", "view", "reboot", "power", "plant"), (55, 8, 8, 1, 28))[0]
        if kind == "message":
            self._message()
        elif kind == "view":
            device, what = self.chance.choice(VIEWS)
            self._set(device, what, seconds=self.chance.uniform(0.05, 1.5))
        elif kind == "reboot":
            # Set-points climb in wall time: a kiln that forgot them holds the line up for hours of the plant's.
            device, what = self.chance.choices(REBOOTS, (3, 3, 3, 3, 2, 0.5))[0]
            self._set(device, what, seconds=self.chance.uniform(0.1, 1.0))
        elif kind == "power":
            self.struck["power_cut"] += 1
            self._do("power_cut", seconds=self.chance.uniform(0.1, 1.0))
        else:
            self._plant(self.chance.choice(PLANT), now)

    def _message(self) -> None:
        chance = self.chance
        kind = chance.choice(MESSAGES)
        options: dict[str, Any] = {"seed": chance.randrange(1 << 31)}
        if kind in ("late", "reorder", "half_open"):
            options["seconds"] = chance.uniform(0.02, 0.5)
        if kind in ("mute", "drop"):
            options["acts"] = chance.choice(("now", "never"))
        if kind == "late":
            options["acts"] = chance.choice(("now", "late"))
        if chance.random() < 0.6:
            options |= {"count": chance.randint(1, 4), "for_seconds": 5.0}
        else:
            options |= {"probability": chance.uniform(0.02, 0.5), "for_seconds": chance.uniform(0.2, 2.0)}
        self._set(chance.choice(WIRES), kind, **options)

    def _plant(self, kind: str, now: float) -> None:
        """A fault of the plant, unless the same one stands."""
        if kind in self._standing:
            return
        chance, mend_at = self.chance, now + self.chance.uniform(0.2, 2.5)
        if kind == "e_stop":
            self._set("plc", kind)
            before = self._at_rest()
            self._later(mend_at, kind, lambda: self._let_go(before))
        elif kind == "jam":
            self._set("plc", kind, slip_mm=chance.choice((0.0, 0.0, 25.0)))
            remove = chance.random() < 0.3
            self._later(mend_at, kind, lambda: self._fault("plc", "jam_clear", remove=remove))
        elif kind == "double_feed":
            self._set("plc", kind)
        elif kind == "missing_tile":
            self._set("plc", kind, where=chance.choice(("loader", "belt")), count=chance.randint(1, 2))
        elif kind == "zone_drift":
            zone = chance.randrange(8)
            self._set("kiln", kind, zone=zone, degc=chance.choice((-20.0, 20.0)), minutes=10.0)
            mend = {"zone": zone, "degc": 0.0, "minutes": 1.0}
            self._later(mend_at, kind, lambda: self._fault("kiln", "zone_drift", **mend))
        else:
            self._set("plc", kind)
            self._later(mend_at, kind, lambda: self._fault("plc", _MENDED_BY[kind]))

    def _set(self, device: str, kind: str, **options: Any) -> None:
        self.struck[kind] += 1
        self._fault(device, kind, **options)

    def _fault(self, device: str, kind: str, **options: Any) -> None:
        self._do("fault", device=device, kind=kind, **options)

    def _do(self, what: str, **options: Any) -> None:
        self.log.write(f"{datetime.now(UTC).isoformat(timespec='milliseconds')} {what} {options}\n")
        self.log.flush()
        self.plant.do(what, **options)

    def _later(self, at: float, kind: str, mend: Callable[[], None]) -> None:
        self._standing.add(kind)

        def mended() -> None:
            self._standing.discard(kind)
            mend()

        heapq.heappush(self._mends, (at, next(self._order), mended))

    def _at_rest(self) -> tuple[float, int]:
        """Travel of the belt and prints so far, of a plant whose stop button was pressed a moment ago."""
        prints = self.plant.do("truth", summary=True)["summary"]["prints"]
        return float(self.plant.do("state")["travel_mm"]), int(prints)

    def _let_go(self, before: tuple[float, int]) -> None:
        travel, prints = self._at_rest()
        if travel - before[0] > _LIES_MM or prints != before[1]:
            self.wrong.append(
                f"with the emergency stop pressed, the belt moved by {travel - before[0]:.1f} mm and "
                f"{prints - before[1]} prints were made"
            )
        self._fault("plc", "e_stop_release")
