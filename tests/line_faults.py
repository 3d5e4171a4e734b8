"""Faults of every kind against a whole line, and hands that mend what doesn't mend itself."""

from __future__ import annotations

import os
import random
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.line_workshop import STOPPED, PlantProcess, Workplace, judge, wait_or_kill
from tilefab.control.ledger import ArmState

MESSAGE_KINDS = (
    *("mute", "late", "twice", "garble", "truncate", "noise", "reorder", "replay", "drop", "half_open"),
    *("wrong_unit", "wrong_function", "wrong_count", "old_tid"),
)
_END_S = 60.0
_TURN_S = 0.005
_TO_RUN_S = 10.0

Strike = Callable[[PlantProcess, random.Random], None]


def _plant(kind: str, ends: str = "", **options: object) -> Strike:
    """A fault of the plant, mended after a while by hand if it has an end."""

    def strike(plant: PlantProcess, chance: random.Random) -> None:
        plant.fault("plc", kind, **options)
        if ends:
            time.sleep(chance.uniform(0.02, 0.3))
            plant.fault("plc", ends)

    return strike


def _jam(plant: PlantProcess, chance: random.Random) -> None:
    """A jam in which a tile slips, and after which one may be taken off; not from under the head while that prints."""
    plant.fault("plc", "jam", slip_mm=chance.choice((0.0, 15.0, 30.0)))
    time.sleep(chance.uniform(0.05, 0.3))
    state = plant.do("state")
    still = state["speed_mm_s"] == 0 and not state["printer"]["printing"]
    plant.fault("plc", "jam_clear", remove=still and chance.random() < 0.5)


def _reboot(device: str, kind: str = "reboot") -> Strike:
    def strike(plant: PlantProcess, chance: random.Random) -> None:
        plant.fault(device, kind, seconds=chance.choice((0.12, 0.3, 0.8)))

    return strike


def _view(kind: str) -> Strike:
    def strike(plant: PlantProcess, chance: random.Random) -> None:
        plant.fault("plc", kind, seconds=chance.choice((0.1, 0.4, 0.9)))

    return strike


def _power_cut(plant: PlantProcess, chance: random.Random) -> None:
    plant.do("power_cut", seconds=chance.choice((0.15, 0.5, 1.0)))


def message(device: str, kind: str) -> Strike:
    """A fault of messages: of one, of some in a row, or of a share of them for a while."""

    def strike(plant: PlantProcess, chance: random.Random) -> None:
        much = chance.choice(
            ({"count": 1}, {"count": chance.randint(2, 12)}, {"probability": 0.3, "for_seconds": 0.6, "count": 1000})
        )
        more = {"acts": chance.choice(("now", "never"))} if kind in ("mute", "drop") else {}
        plant.fault(device, kind, seed=chance.randrange(1 << 30), **much, **more)

    return strike


PLANT_FAULTS: Mapping[str, Strike] = {
    "e_stop": _plant("e_stop", "e_stop_release"),
    "jam": _jam,
    "double_feed": _plant("double_feed"),
    "missing_tile at the loader": _plant("missing_tile", where="loader"),
    "missing_tile on the belt": _plant("missing_tile", where="belt"),
    "ink_out": _plant("ink_out", "ink_refill", ink=1),
    "nozzle_out": _plant("nozzle_out", "nozzle_ok"),
    "diverter_fault": _plant("diverter_fault", "diverter_ok"),
    "plc reboot": _reboot("plc"),
    "plc reboot_lost": _reboot("plc", "reboot_lost"),
    "printer reboot": _reboot("printer"),
    "printer reboot_lost": _reboot("printer", "reboot_lost"),
    "plc stale": _view("stale"),
    "plc word_order": _view("word_order"),
    "power_cut": _power_cut,
}

MESSAGE_FAULTS: Mapping[str, Strike] = {
    f"{device} {kind}": message(device, kind)
    for device in ("plc", "printer_control", "printer_data")
    for kind in MESSAGE_KINDS
    if (device, kind) not in {("printer_data", "wrong_unit"), ("printer_data", "wrong_function")}
}


@dataclass
class Struck:
    """What came of striking a line.

    Attributes
    ----------
    faults
        How often each kind was set.
    faces
        Faces of the job by what the journal has them as in the end.
    wrong
        What must not be.
    """

    faults: Counter[str] = field(default_factory=Counter)
    faces: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    @property
    def in_doubt(self) -> int:
        """Faces whose state nobody knows."""
        return self.faces[ArmState.IN_DOUBT.value]


class _Daemon:
    """A daemon with an operator in a process of its own; anew, with more faces, whenever it has finished."""

    def __init__(self, place: Workplace, more: int, log: Path | None) -> None:
        self.place, self._more, self._log = place, more, log
        self.pid = place.fork(lambda _: None, log=log)

    def see_to(self) -> str:
        """What is wrong with it; empty if it works."""
        done, status = os.waitpid(self.pid, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            if code != STOPPED:
                return f"the daemon ended with {code}"
            self.place = self.place.more(self._more)
            self.pid = self.place.fork(lambda _: None, log=self._log)
        return ""


def strike_often(
    plant: PlantProcess,
    place: Workplace,
    strikes: Sequence[tuple[str, Strike]],
    *,
    seed: int,
    more: int = 40,
    check_pixels: int = 4,
    longest_wait_s: float = 1.4,
    finish: bool = True,
    log: Path | None = None,
) -> tuple[Struck, Workplace]:
    """Strike a running line with one fault after the other, let it finish its job, and judge.

    Without ``finish`` the daemon is killed as soon as the line prints again. Returns what came of it, and the line with
    the job as it is then.
    """
    found, chance = Struck(), random.Random(seed)
    daemon = _Daemon(place, more, log)
    for name, strike in strikes:
        deadline = time.monotonic() + _TO_RUN_S
        wrong = ""
        while not wrong and plant.do("state")["speed_mm_s"] == 0:
            wrong = daemon.see_to()
            if time.monotonic() > deadline:
                wrong = f"before {name} the belt doesn't run"
            time.sleep(_TURN_S)
        if wrong:
            found.wrong.append(wrong)
            break
        # Anywhere between the first tile's feeding and a belt full of printed tiles.
        time.sleep(longest_wait_s * chance.random() ** 2)
        strike(plant, chance)
        found.faults[name] += 1
    _mend(plant)
    if finish:
        code = wait_or_kill(daemon.pid, _END_S)
        if code != STOPPED:
            found.wrong.append(f"the line can't finish its job: {code}")
    else:
        _see_it_print(plant, daemon, found)
    judged = judge(plant, daemon.place, check_pixels=check_pixels, finished=finish)
    found.wrong += judged.wrong
    found.faces = judged.faces
    return found, daemon.place


def _mend(plant: PlantProcess) -> None:
    plant.do("clear")
    for kind in ("e_stop_release", "jam_clear", "ink_refill", "nozzle_ok", "diverter_ok"):
        plant.fault("plc", kind)


def _see_it_print(plant: PlantProcess, daemon: _Daemon, found: Struck) -> None:
    """Wait for a face more, and kill the daemon."""
    deadline = time.monotonic() + _TO_RUN_S
    before = plant.do("truth", summary=True)["summary"]["prints"]
    wrong = ""
    while not wrong and plant.do("truth", summary=True)["summary"]["prints"] == before:
        wrong = daemon.see_to()
        if time.monotonic() > deadline:
            wrong = "nothing is printed any more"
        time.sleep(_TURN_S)
    if wrong:
        found.wrong.append(wrong)
    wait_or_kill(daemon.pid, 0.0)
