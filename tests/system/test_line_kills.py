"""Daemons of a whole line killed at every named step, and at any moment; `make soak` does so thousands of times."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.line_campaigns import ANY, KILLED, LAST, kill_often, workplace
from tests.line_workshop import PlantProcess, Workplace, judge, kill_at, wait_for
from tilefab.control.ledger import ArmState
from tilefab.pipeline.line.probe import STEPS

pytestmark = pytest.mark.xdist_group("line")


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PlantProcess, Workplace]]:
    with workplace(tmp_path_factory.mktemp("kills"), rate=30.0, count=40) as here:
        yield here


def test_a_daemon_killed_at_any_step_leaves_no_face_lost_doubled_or_skipped(
    line: tuple[PlantProcess, Workplace],
) -> None:
    plant, place = line
    # First one that leaves something to be settled.
    for step in ("intent.committed", *STEPS):
        if step != LAST:
            code = wait_for(place.fork(kill_at(step, 1)))
            assert code == KILLED, f"{step}: {code}"
    found = kill_often(plant, place, ANY, 3, seed=1)
    assert not found.wrong
    assert found.faces[ArmState.PASSED.value] + found.faces[ArmState.IN_DOUBT.value] > 30


def test_a_daemon_killed_as_its_job_ends_has_nothing_left_to_print(line: tuple[PlantProcess, Workplace]) -> None:
    plant, place = line
    found = kill_often(plant, place.more(5), LAST, 1, seed=1)
    assert found.kills == 1
    assert not found.wrong


def test_the_judge_sees_what_is_wrong(line: tuple[PlantProcess, Workplace]) -> None:
    plant, place = line
    more = place.more(300)
    assert any("is lost" in text for text in judge(plant, more).wrong)
