"""A whole line struck by each kind of fault; `make soak` does so thousands of times, in every order."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.line_campaigns import workplace
from tests.line_faults import MESSAGE_FAULTS, PLANT_FAULTS, strike_often
from tests.line_workshop import PlantProcess, Workplace

pytestmark = pytest.mark.xdist_group("line")

_MESSAGES = (
    *("plc mute", "plc late", "plc replay", "plc half_open"),
    *("printer_control garble", "printer_control reorder", "printer_control drop"),
    *("printer_data mute", "printer_data drop"),
)
_SEED = 5


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[tuple[PlantProcess, Workplace]]]:
    with workplace(tmp_path_factory.mktemp("faults"), rate=40.0, count=20) as here:
        yield [here]


def strike(line: list[tuple[PlantProcess, Workplace]], *names: str, finish: bool) -> None:
    plant, place = line[0]
    faults = PLANT_FAULTS | MESSAGE_FAULTS
    strikes = [(name, faults[name]) for name in names]
    found, place = strike_often(
        plant, place.more(12), strikes, seed=_SEED, longest_wait_s=0.3, check_pixels=2, finish=finish
    )
    line[0] = plant, place
    assert not found.wrong
    assert found.faults.total() == len(names)


@pytest.mark.parametrize("kind", PLANT_FAULTS)
def test_a_fault_of_plant_or_device_costs_no_face_unseen(line: list[tuple[PlantProcess, Workplace]], kind: str) -> None:
    strike(line, kind, finish=False)


def test_faults_of_messages_cost_no_face_unseen(line: list[tuple[PlantProcess, Workplace]]) -> None:
    strike(line, *_MESSAGES, finish=False)


def test_whatever_befell_it_a_line_comes_to_its_jobs_end(line: list[tuple[PlantProcess, Workplace]]) -> None:
    strike(line, finish=True)
