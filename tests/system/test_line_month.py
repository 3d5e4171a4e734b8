"""Two hours of a line in the time of `benchmarks/line_month.py`, and whether its witness would see what must not be."""

from __future__ import annotations

import io
import random
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from tests.line_fate import Fate
from tests.line_month import Terms, live
from tests.line_witness import Witness
from tilefab.control.ledger import ArmState
from tilefab.io.journal import ArmRecord
from tilefab.io.journal_records import RunFacts, RunRecord

NOW = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.mark.xdist_group("line")
def test_two_hours_with_faults(tmp_path: Path) -> None:
    month = live(tmp_path, Terms(hours=2.0, lot=40, fault_every_s=0.7, samples=10))
    assert month.wrong == []
    assert month.hours >= 2.0
    assert month.faces["passed"] > 10
    assert sum(month.struck.values()) > 3
    assert len(month.samples) >= 10
    assert month.summary["prints"] >= month.faces["passed"]


def arm(arm_id: int, state: ArmState, *, face: int = 0, run: int = 1) -> ArmRecord:
    facts = dict.fromkeys(ArmRecord.__dataclass_fields__, None) | {
        **{"arm_id": arm_id, "run_id": run, "face": face, "attempt": 1, "state": state, "reason": ""},
        **{"intended_at": NOW, "changed_at": NOW},
    }
    return ArmRecord(**facts)  # type: ignore[arg-type]


def run(faces: int, *, finished: bool) -> RunRecord:
    return RunRecord(1, RunFacts("0", "job", "job.toml", faces, 1, "0"), NOW, NOW if finished else None)


def made(arm_id: int, face: int = 0, **changes: Any) -> dict[str, Any]:
    return {"arm": arm_id, "face": face, "complete": True, "crc32": 7, "centre_mm": 0.0} | changes


class Journal:
    """A journal whose content is made up."""

    def __init__(self) -> None:
        self.known: dict[int, ArmRecord] = {}
        self.run = run(10, finished=False)

    def put(self, *arms: ArmRecord) -> None:
        self.known |= {one.arm_id: one for one in arms}

    def runs(self, *, last: int) -> list[RunRecord]:
        return [self.run][:last]

    def last_arm(self) -> int:
        return max(self.known, default=0)

    def arms(self, *, last: int) -> list[ArmRecord]:
        return [self.known[arm_id] for arm_id in sorted(self.known)[-last:]]


class Plant:
    """A plant whose truth is made up."""

    def __init__(self) -> None:
        self.tiles: dict[int, dict[str, Any]] = {}
        self.beside: list[dict[str, Any]] = []
        self.changes: list[int] = []
        self.prints = 0
        self.travel_mm = 0.0

    def put(self, tile_id: int, fate: str, *prints: dict[str, Any]) -> None:
        self.tiles[tile_id] = {"id": tile_id, "fate": fate, "prints": list(prints)}
        self.changes.append(tile_id)

    def do(self, what: str, **arguments: Any) -> dict[str, Any]:
        if what == "state":
            return {"travel_mm": self.travel_mm}
        if what != "truth":
            return {}
        if arguments.get("summary"):
            return {"summary": {"prints": self.prints}}
        changed = dict.fromkeys(self.changes[arguments["since"] :])
        beside, self.beside = self.beside, []
        return {"tiles": [self.tiles[tile] for tile in changed], "beside": beside, "next": len(self.changes)}


@pytest.fixture
def scene() -> tuple[Journal, Plant, Witness]:
    journal, plant = Journal(), Plant()
    return journal, plant, Witness(journal, plant, lambda _name, face: 7 + face, check_every=1)  # type: ignore[arg-type]


Scene = tuple[Journal, Plant, Witness]


def test_a_line_that_does_well_is_told_nothing_of(scene: Scene) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, ArmState.ARMED), arm(2, ArmState.UNPRINTED, face=1))
    plant.put(1, "on_belt", made(1))
    witness.look()
    journal.put(arm(1, ArmState.PASSED), arm(3, ArmState.PARTIAL, face=1))
    plant.put(1, "passed", made(1))
    plant.put(3, "diverted", made(3, 1, complete=False))
    plant.put(4, "diverted")
    witness.look()
    plant.put(1, "fired", made(1))
    journal.run = run(2, finished=True)
    witness.look(finished=True)
    assert witness.wrong == []
    assert witness.checksums == 1
    assert witness.faces == {ArmState.PASSED: 1, ArmState.UNPRINTED: 1, ArmState.PARTIAL: 1}


@pytest.mark.parametrize(
    ("state", "fate", "prints", "says"),
    [
        (ArmState.PASSED, "diverted", [made(1)], "recorded as passed"),
        (ArmState.PASSED, "on_belt", [], "recorded as passed"),
        (ArmState.PASSED, "passed", [made(1, complete=False)], "recorded as passed"),
        (ArmState.PASSED, "passed", [made(1, crc32=8)], "other pixels"),
        (ArmState.PASSED, "passed", [made(1, 5)], "another face"),
        (ArmState.DIVERTED, "passed", [made(1)], "recorded as diverted, but passed"),
        (ArmState.PARTIAL, "fired", [made(1)], "recorded as partial, but passed"),
        (ArmState.UNPRINTED, "diverted", [made(1)], "unprinted, but was printed"),
        (ArmState.IN_DOUBT, "passed", [], "passed blank"),
        (ArmState.PASSED, "passed", [made(1, centre_mm=2.0)], "2.0 mm off"),
        (ArmState.IN_DOUBT, "diverted", [made(1), made(1)], "printed 2 times"),
        (ArmState.ARMED, "on_belt", [], "still open"),
    ],
)
def test_what_must_not_be_is_told(
    scene: Scene, state: ArmState, fate: str, prints: list[dict[str, Any]], says: str
) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, state))
    plant.put(1, fate, *prints)
    witness.look(finished=True)
    assert says in "; ".join(witness.wrong)


def test_a_face_on_two_tiles_by_one_arm_or_two_is_told(scene: Scene) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, ArmState.IN_DOUBT))
    plant.put(1, "diverted", made(1))
    witness.look()
    journal.put(arm(2, ArmState.DIVERTED), arm(3, ArmState.DIVERTED, face=1))
    plant.put(2, "diverted", made(2))
    plant.put(3, "diverted", made(3, 1))
    plant.put(4, "diverted", made(3, 1))
    witness.look()
    assert witness.wrong == ["face 0 of run 1 was printed again, by arm 2", "arm 3 was printed on 2 tiles"]


def test_a_tile_that_passes_after_its_face_was_given_up_is_told(scene: Scene) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, ArmState.PARTIAL))
    plant.put(1, "on_belt", made(1))
    witness.look()
    assert witness.wrong == []
    plant.put(1, "passed", made(1))
    witness.look()
    assert "recorded as partial, but passed" in witness.wrong[0]


def test_a_print_that_the_journal_never_heard_of_is_told_once_it_must_have(scene: Scene) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, ArmState.UNPRINTED))
    plant.put(1, "on_belt", made(2))
    witness.look()
    assert witness.wrong == []
    journal.put(arm(3, ArmState.UNPRINTED))
    plant.put(1, "diverted", made(2))
    plant.beside.append(made(3))
    witness.look()
    assert witness.wrong == [
        "arm 3 was printed beside all tiles",
        "arm 2 was printed, the journal has never heard of it",
    ]


def test_a_finished_run_with_a_face_that_nobody_told_of_is_told(scene: Scene) -> None:
    journal, plant, witness = scene
    journal.put(arm(1, ArmState.PASSED), arm(2, ArmState.UNPRINTED, face=1))
    plant.put(1, "passed", made(1))
    journal.run = run(3, finished=True)
    witness.look()
    assert witness.wrong == ["run 1 is finished, but faces [1, 2] were skipped silently"]


def test_what_is_settled_is_forgotten_but_not_that_it_was_printed(scene: Scene) -> None:
    journal, plant, witness = scene
    for arm_id in range(1, 2101):
        journal.put(arm(arm_id, ArmState.DIVERTED, face=arm_id - 1))
        plant.put(arm_id, "diverted", made(arm_id, arm_id - 1))
    witness.look()
    assert len(witness._settled) == len(witness._made) == 2000
    journal.put(arm(2101, ArmState.DIVERTED, face=0))
    plant.put(2101, "diverted", made(2101, 0))
    witness.look()
    assert witness.wrong == ["face 0 of run 1 was printed again, by arm 2101"]


@pytest.mark.parametrize(("moved_mm", "prints"), [(30.0, 0), (0.0, 1), (0.0, 0)])
def test_a_line_that_goes_on_with_its_emergency_stop_pressed_is_told_of(moved_mm: float, prints: int) -> None:
    plant = Plant()
    fate = Fate(plant, random.Random(1), 1e9, io.StringIO())  # type: ignore[arg-type]
    fate._plant("e_stop", 0.0)
    plant.travel_mm += moved_mm
    plant.prints += prints
    fate.rest()
    assert bool(fate.wrong) is bool(moved_mm or prints)
    assert fate.struck["e_stop"] == 1
