"""Loss of power under a whole line; `benchmarks/line_power_cuts.py` goes through hundreds of cases."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.line_power import lose_power
from tests.line_workshop import (
    STOPPED,
    Workplace,
    judge,
    plant_process,
    wait_or_kill,
    write_job,
    write_line,
    write_slab,
)
from tests.power_loss import Recorder, Unreachable


@pytest.mark.xdist_group("line")
def test_no_face_is_lost_or_doubled_by_losses_of_power(tmp_path: Path) -> None:
    try:
        with Recorder(tmp_path).recording():
            pass
    except Unreachable as reason:
        pytest.skip(f"this interpreter's SQLite can't be listened to: {reason}")
    write_slab(tmp_path)
    with plant_process(tmp_path, rate=20) as plant:
        place = Workplace.open(write_job(tmp_path, count=400), write_line(tmp_path, plant.endpoints))
        cycles = lose_power(plant, place, 12, seed=3)
        assert cycles.cases == 12
        assert cycles.at_risk > 3
        assert wait_or_kill(place.fork(lambda _step: None), 60.0) == STOPPED
        found = judge(plant, place, check_pixels=10)
        assert found.wrong == []
        assert sum(found.faces.values()) == 400
