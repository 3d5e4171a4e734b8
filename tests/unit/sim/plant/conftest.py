from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.plant.inprocess import RunningPlant, plant_in, running_plant_here


@pytest.fixture
def running(tmp_path: Path) -> Iterator[RunningPlant]:
    """A plant that runs at ten times the wall's pace."""
    with running_plant_here(plant_in(tmp_path, clock={"rate": 10.0})) as plant:
        yield plant
