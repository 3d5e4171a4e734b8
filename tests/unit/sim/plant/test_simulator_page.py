"""The page about the simulator names everything that can be set, and the example plant is one."""

from __future__ import annotations

import dataclasses
import inspect
import re
from pathlib import Path

from sim.plant.config import PlantConfig, read_plant
from sim.plant.network.faults import MESSAGE_KINDS
from sim.plant.network.service import Service
from sim.plant.physics.plant import Plant
from sim.plant.physics.tiles import Print, Tile

ROOT = Path(__file__).parents[4]
PAGE = (ROOT / "docs/simulator.md").read_text()
NAMED = set(re.findall(r"`([a-z_0-9]+)`", PAGE))


def test_every_value_of_a_plant_file_is_named():
    plant = PlantConfig()
    for entry in dataclasses.fields(plant):
        value = getattr(plant, entry.name)
        if dataclasses.is_dataclass(value):
            assert f"`[{entry.name}]`" in PAGE
            assert {inner.name for inner in dataclasses.fields(value)} <= NAMED
        else:
            assert entry.name in NAMED


def test_every_fault_is_named():
    kinds = set(re.findall(r'"([a-z_]+)"', inspect.getsource(Service._plant_fault).partition("match kind")[2]))
    assert len(kinds) > 20
    options = {"slip_mm", "remove", "count", "where", "loader", "zone", "degc", "minutes", "ink"}
    assert (kinds | MESSAGE_KINDS | options) - {"loader"} <= NAMED


def test_everything_in_the_truth_is_named():
    bench = Plant(PlantConfig())
    assert set(bench.truth.summary()) - {"tiles"} <= NAMED
    assert set(Tile(1, 0.0, 0.0).view()) - {"change"} <= NAMED
    assert set(re.findall(r'"([a-z_0-9]+)":', inspect.getsource(Print.view))) - {"at"} <= NAMED


def test_the_example_is_a_plant():
    plant = read_plant(ROOT / "jobs/plant.toml")
    assert plant.printer.control
    assert plant.plc.rtu
    assert plant.gauge.pty
