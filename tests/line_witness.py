"""A witness of a line at work: holds the journal against the plant's truth as both grow, and forgets what is settled.

`tests.line_workshop.judge` looks at a whole job at its end; this one can look on for as long as a line runs.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from tilefab.control.ledger import ArmState
from tilefab.io.journal import ArmRecord, Journal

PASSED = frozenset({"passed", "in_kiln", "fired", "broken"})
_OPEN = (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED)
_TOLD = frozenset({ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL, ArmState.IN_DOUBT})
_KEPT_ARMS = 2000
"""Settled arms that are still watched: a tile that carries one is decided long before so many others are armed."""
_LIMIT = 2000
_REGISTRATION_MM = 1.0
_MOST_WRONG = 100


class Plant(Protocol):
    """A plant that tells the truth; see `tests.line_workshop.PlantProcess`."""

    def do(self, what: str, **arguments: Any) -> dict[str, Any]:
        """Carry out a command of the control port."""


@dataclass
class _Flags:
    """A set of whole numbers from 0 on, a byte each."""

    bytes_: bytearray = field(default_factory=bytearray)

    def add(self, number: int) -> bool:
        """Add one; whether it was there."""
        if number >= len(self.bytes_):
            self.bytes_.extend(bytes(number + 1 - len(self.bytes_)))
        was = bool(self.bytes_[number])
        self.bytes_[number] = 1
        return was

    def missing(self, count: int) -> list[int]:
        """Those below ``count`` that aren't there."""
        return [number for number in range(count) if number >= len(self.bytes_) or not self.bytes_[number]]


@dataclass(frozen=True)
class Made:
    """A print as the plant saw it: on which tile, what became of that, and whether every row is there."""

    tile: int
    fate: str
    complete: bool
    face: int
    crc32: int


class Witness:
    """Looks on while a line works.

    Parameters
    ----------
    journal
        The line's journal, to look into.
    plant
        The plant.
    checksum
        CRC-32 that a face of a job (by name) must be printed with.
    check_every
        One of how many faces is rendered again to compare its pixels; 0 for none.

    Attributes
    ----------
    wrong
        Everything that must not be.
    faces
        Settled arms by state.
    """

    def __init__(
        self, journal: Journal, plant: Plant, checksum: Callable[[str, int], int], *, check_every: int = 0
    ) -> None:
        self._journal, self._plant, self._checksum, self._check_every = journal, plant, checksum, check_every
        self.wrong: list[str] = []
        self.faces: Counter[ArmState] = Counter()
        self.checksums = 0
        self._change = 0
        self._low = 1
        self._forgotten = 0
        self._settled: dict[int, ArmRecord] = {}
        self._made: dict[int, dict[int, Made]] = {}
        self._counted: set[int] = set()
        self._printed: dict[int, _Flags] = {}
        self._told: dict[int, _Flags] = {}
        self._finished: dict[int, int] = {}

    def look(self, *, finished: bool = False) -> None:
        """Hold what is new in the journal and in the truth against each other.

        Parameters
        ----------
        finished
            Whether every run is over, so that nothing may be open.
        """
        # What the journal claims happened before: so it is read first, and the truth must bear it out.
        runs = self._journal.runs(last=8)
        last = self._journal.last_arm()
        records = (
            {arm.arm_id: arm for arm in self._journal.arms(last=last - self._low + 1)} if last >= self._low else {}
        )
        changed = self._read_truth()
        names = {run.run_id: run.facts.name for run in runs}
        for arm_id, record in sorted(records.items()):
            if arm_id < self._low or arm_id in self._settled or record.state in _OPEN:
                continue
            self._settled[arm_id] = record
            self.faces[record.state] += 1
            changed.add(arm_id)
            self._check_pixels(record, names)
            if record.state in _TOLD:
                self._told.setdefault(record.run_id, _Flags()).add(record.face)
        for arm_id in sorted(changed):
            self._check(arm_id, self._settled.get(arm_id) or records.get(arm_id), last)
        while self._low <= last and self._low in self._settled:
            self._low += 1
        for run in runs:
            if run.finished_at is not None and self._finished.get(run.run_id) != run.facts.faces:
                self._finished[run.run_id] = run.facts.faces
                skipped = self._told.get(run.run_id, _Flags()).missing(run.facts.faces)
                if skipped:
                    self._say(f"run {run.run_id} is finished, but faces {skipped[:10]} were skipped silently")
        if finished:
            still = [f"{arm.arm_id} {arm.state}" for arm in records.values() if arm.state in _OPEN]
            if still:
                self._say(f"at the end there are arms still open: {still[:10]}")
        self._forget()

    def _read_truth(self) -> set[int]:
        """Take in the tiles that changed; arms that were printed on them."""
        changed: set[int] = set()
        while True:
            view = self._plant.do("truth", since=self._change, limit=_LIMIT)
            self._change = view["next"]
            for made in view["beside"]:
                self._say(f"arm {made['arm']} was printed beside all tiles")
            for tile in view["tiles"]:
                self._check_tile(tile)
                for made in tile["prints"]:
                    arm = int(made["arm"])
                    seen = Made(tile["id"], tile["fate"], made["complete"], made["face"], made["crc32"])
                    self._made.setdefault(arm, {})[tile["id"]] = seen
                    changed.add(arm)
            if len(view["tiles"]) < _LIMIT:
                return changed

    def _check_tile(self, tile: Mapping[str, Any]) -> None:
        prints = tile["prints"]
        if len(prints) > 1:
            self._say(f"tile {tile['id']} was printed {len(prints)} times")
        if tile["fate"] not in PASSED:
            return
        if not prints:
            self._say(f"tile {tile['id']} passed blank")
        for made in prints:
            if not made["complete"]:
                self._say(f"tile {tile['id']} passed with a part of a face")
            if made["centre_mm"] is not None and abs(made["centre_mm"]) > _REGISTRATION_MM:
                self._say(f"tile {tile['id']} passed with its face {made['centre_mm']} mm off")

    def _check(self, arm_id: int, record: ArmRecord | None, last: int) -> None:
        made = list(self._made.get(arm_id, {}).values())
        if record is None:
            # An arm above the last was put down after the journal was read: the next look finds it.
            if arm_id <= self._forgotten:
                self._say(f"arm {arm_id} was printed, or its tile moved on, long after it was settled")
            elif arm_id <= last:
                self._say(f"arm {arm_id} was printed, the journal has never heard of it")
            return
        self._check_doubled(record, made)
        if len(made) > 1:
            self._say(f"arm {arm_id} was printed on {len(made)} tiles")
        if any(one.face != record.face for one in made):
            self._say(f"arm {arm_id} was printed with another face than {record.face}")
        passed = [one for one in made if one.fate in PASSED]
        state = record.state
        if state is ArmState.PASSED and (len(passed) != 1 or not passed[0].complete):
            self._say(f"face {record.face} of run {record.run_id} is recorded as passed, the plant says {made}")
        if state in (ArmState.DIVERTED, ArmState.PARTIAL) and passed:
            self._say(f"face {record.face} of run {record.run_id} is recorded as {state}, but passed: {made}")
        if state is ArmState.UNPRINTED and made:
            self._say(f"face {record.face} of run {record.run_id} is recorded as unprinted, but was printed: {made}")

    def _check_doubled(self, record: ArmRecord, made: list[Made]) -> None:
        """No face is ever printed by two arms: nobody orders reprints."""
        if not made or record.arm_id in self._counted:
            return
        self._counted.add(record.arm_id)
        if self._printed.setdefault(record.run_id, _Flags()).add(record.face):
            self._say(f"face {record.face} of run {record.run_id} was printed again, by arm {record.arm_id}")

    def _check_pixels(self, record: ArmRecord, names: Mapping[int, str]) -> None:
        name = names.get(record.run_id)
        if (
            record.state is not ArmState.PASSED
            or not self._check_every
            or record.arm_id % self._check_every
            or not name
        ):
            return
        self.checksums += 1
        wanted = self._checksum(name, record.face)
        if any(made.crc32 != wanted for made in self._made.get(record.arm_id, {}).values()):
            self._say(f"face {record.face} of run {record.run_id} was printed with other pixels than its job gives")

    def _forget(self) -> None:
        self._forgotten = max(self._forgotten, self._low - 1 - _KEPT_ARMS)
        for known in (self._settled, self._made):
            for arm_id in [arm_id for arm_id in known if arm_id <= self._forgotten]:
                del known[arm_id]
        self._counted -= {arm_id for arm_id in self._counted if arm_id <= self._forgotten}

    def _say(self, what: str) -> None:
        if what not in self.wrong and len(self.wrong) < _MOST_WRONG:
            self.wrong.append(what)
