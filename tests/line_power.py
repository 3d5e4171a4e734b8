"""Loss of power under a whole line: the daemon dies, and of what its journal hadn't synced anything may be missing.

Each cycle forks a daemon whose SQLite is listened to (`tests.power_loss.Recorder`), ends it beyond any cleaning up
just before one of its syncs or at any other moment, puts a disk image in the journal's place that such a moment may
leave, and cuts the plant's power too in some cycles. The next daemon goes on from that image; the plant's truth judges
at the end.
"""

from __future__ import annotations

import os
import pickle
import random
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.line_workshop import PlantProcess, Workplace, wait_or_kill
from tests.power_loss import WAYS, Event, Recorder

_LONGEST_S = 2.0
_FINISHED = 0


@dataclass
class Cycles:
    """What was gone through.

    Attributes
    ----------
    cases
        Losses of power.
    at_risk
        Those in which something wasn't synced.
    ways
        How often each kind of remains was tried.
    plant_cuts
        How often the whole plant lost its power, too.
    finished
        Whether the job was done before all cases were.
    """

    cases: int = 0
    at_risk: int = 0
    plant_cuts: int = 0
    ways: Counter[str] = field(default_factory=Counter)
    finished: bool = False


class _Log:
    """Events, written down at once by a process that may die at any moment; dies before its n-th sync."""

    def __init__(self, path: Path, die_at_sync: int) -> None:
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        self._left = die_at_sync

    def append(self, event: Event) -> None:
        """Put an event down."""
        if event.kind == "sync":
            self._left -= 1
            if self._left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
        os.write(self._descriptor, pickle.dumps(event))


def _events(path: Path) -> list[Event]:
    """What a process put down before it died."""
    found = []
    with path.open("rb") as file:
        while True:
            try:
                found.append(pickle.load(file))
            except (EOFError, pickle.UnpicklingError):
                return found


def lose_power(plant: PlantProcess, place: Workplace, cases: int, *, seed: int, log: Path | None = None) -> Cycles:
    """Let a line lose its power again and again, until a number of cases or its job are done."""
    chance = random.Random(seed)
    cycles = Cycles()
    folder = place.line.state_directory
    record = folder.parent / "events"
    while cycles.cases < cases:
        recorder = Recorder(folder)
        syncs = chance.choice((1, 2, 3, 5, 8, 13, 21, 34, 55, 89))
        code = wait_or_kill(_recorded(place, recorder, record, syncs, log), chance.uniform(0.2, _LONGEST_S))
        if code == _FINISHED:
            cycles.finished = True
            return cycles
        if code != -signal.SIGKILL:
            raise RuntimeError(f"a daemon ended with {code} by itself")
        disk = recorder.disk()
        for event in _events(record):
            disk.apply(event)
        way = chance.choice(WAYS)
        cycles.cases += 1
        cycles.at_risk += disk.unsynced() > 0
        cycles.ways[way] += 1
        left = disk.after_power_loss(way, chance)
        for path in folder.iterdir():
            path.unlink()
        for name, content in left.items():
            Path(name).write_bytes(content)
        if chance.random() < 0.3:
            cycles.plant_cuts += 1
            plant.do("power_cut", seconds=0.1)
    return cycles


def _recorded(place: Workplace, recorder: Recorder, record: Path, syncs: int, log: Path | None) -> int:
    """Fork a daemon whose journal is listened to."""

    def around(work: Callable[[], Any]) -> Any:
        recorder.events = _Log(record, syncs)  # type: ignore[assignment]
        with recorder.recording():
            return work()

    return place.fork(lambda _step: None, log=log, around=around)
