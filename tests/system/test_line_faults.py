"""A whole line struck by each kind of fault; `make soak` does so thousands of times, in every order."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.line_campaigns import workplace
from tests.line_faults import MESSAGE_FAULTS, PLANT_FAULTS, strike_often
from tests.line_workshop import PlantProcess, Workplace
from tilefab.control.ledger import ArmState

pytestmark = pytest.mark.xdist_group("line")

_MESSAGES = (
    *("plc mute", "plc late", "plc replay", "plc half_open"),
    *("printer_control garble", "printer_control reorder", "printer_control drop"),
    *("printer_data mute", "printer_data drop"),
)
_SEED = 5


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[tuple[PlantProcess, Workplace]]]:
    with workplace(tmp_path_factory.mktemp("faults"), rate=40.0, count=1) as here:
        yield [here]


def strike(line: list[tuple[PlantProcess, Workplace]], *names: str) -> None:
    plant, place = line[0]
    faults = PLANT_FAULTS | MESSAGE_FAULTS
    found, place = strike_often(
        plant, place.more(12), [(name, faults[name]) for name in names], seed=_SEED, more=8, longest_wait_s=0.3
    )
    line[0] = plant, place
    assert not found.wrong
    assert found.faults.total() == len(names)
    # Whatever befell it, a line brings most of its faces through.
    assert found.faces[ArmState.PASSED.value] > 0


@pytest.mark.parametrize("kind", PLANT_FAULTS)
def test_a_fault_of_plant_or_device_costs_no_face_unseen(line: list[tuple[PlantProcess, Workplace]], kind: str) -> None:
    strike(line, kind)


def test_faults_of_messages_cost_no_face(line: list[tuple[PlantProcess, Workplace]]) -> None:
    before = in_trouble(line)
    strike(line, *_MESSAGES)
    assert in_trouble(line) - before <= len(_MESSAGES)


def in_trouble(line: list[tuple[PlantProcess, Workplace]]) -> int:
    """Faces that no tile came through with."""
    _, place = line[0]
    journal = place.journal()
    try:
        return sum(arm.state in (ArmState.IN_DOUBT, ArmState.DIVERTED, ArmState.PARTIAL) for arm in journal.arms())
    finally:
        journal.close()
