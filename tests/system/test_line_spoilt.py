"""What was under the head when ink or a nozzle failed never passes, however the line is brought up again."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.line_workshop import (
    STOPPED,
    PlantProcess,
    Workplace,
    judge,
    plant_process,
    wait_for,
    write_job,
    write_line,
    write_slab,
)
from tilefab.control.ledger import ArmState

pytestmark = pytest.mark.xdist_group("line")


def _spoilt_tiles(plant: PlantProcess, key: str) -> list[dict[str, object]]:
    tiles = plant.do("truth")["tiles"]
    return [tile for tile in tiles if any(made[key] for made in tile["prints"])]


def _wait(seen: Callable[[], object]) -> None:
    deadline = time.monotonic() + 30
    while not seen():
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.parametrize("killed", [False, True])
def test_a_face_printed_with_a_failed_nozzle_is_scrapped(tmp_path: Path, killed: bool) -> None:
    write_slab(tmp_path)
    with plant_process(tmp_path, rate=2) as plant:
        place = Workplace.open(write_job(tmp_path, count=6), write_line(tmp_path, plant.endpoints, speed=300.0))
        begun = place.fork(lambda _step: None)
        _wait(lambda: plant.do("state")["printer"]["printing"])
        plant.fault("printer", "nozzle_out")
        _wait(lambda: not plant.do("state")["speed_mm_s"])
        if killed:
            os.kill(begun, signal.SIGKILL)
            assert wait_for(begun) == -signal.SIGKILL
            begun = place.fork(lambda _step: None)
        plant.fault("printer", "nozzle_ok")
        assert wait_for(begun) == STOPPED
        spoilt = _spoilt_tiles(plant, "nozzle_out")
        assert spoilt
        assert {tile["fate"] for tile in spoilt} <= {"diverted", "on_belt"}
        found = judge(plant, place)
        assert found.wrong == []
        assert found.faces[ArmState.DIVERTED] + found.faces[ArmState.PARTIAL] >= 1
