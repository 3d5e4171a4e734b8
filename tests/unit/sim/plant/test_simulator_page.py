"""The page about the simulator names everything that can be set, and the example plant is one."""

from __future__ import annotations

import dataclasses
import inspect
import re
import tomllib
from pathlib import Path

from sim.plant.config import PlantConfig, read_plant
from sim.plant.network.faults import MESSAGE_KINDS
from sim.plant.network.service import Service
from sim.plant.physics.camera import FAULTS as CAMERA_FAULTS
from sim.plant.physics.firing import QUANTITIES, FiringDrift
from sim.plant.physics.flaws import Flaw
from sim.plant.physics.plant import Plant
from sim.plant.physics.tiles import Print, Tile
from tests.unit.sim.plant.test_camera import Watched

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
    assert set(CAMERA_FAULTS) | set(QUANTITIES) | {"strength"} <= NAMED


def test_everything_in_the_truth_is_named():
    bench = Plant(PlantConfig())
    assert set(bench.truth.summary()) - {"tiles"} <= NAMED
    assert set(Tile(1, 0.0, 0.0).view()) - {"change"} <= NAMED
    assert set(re.findall(r'"([a-z_0-9]+)":', inspect.getsource(Print.view))) - {"at"} <= NAMED
    assert set(Flaw("nozzle").view()) <= NAMED
    drift = FiringDrift(4, 0.0, 1)
    assert {"fired"} | set(drift.fired(0, drift.laid(0), 0.0, 0.0).view()) <= NAMED
    assert {"photo"} | set(Watched().see(1)[0]) <= NAMED


def test_the_example_is_a_plant():
    plant = read_plant(ROOT / "jobs/plant.toml")
    assert plant.printer.control
    assert plant.plc.rtu
    assert plant.gauge.pty


def test_the_plant_of_the_demonstration_is_the_one_that_its_line_names():
    plant = read_plant(ROOT / "jobs/demo_plant.toml")
    line = tomllib.loads((ROOT / "jobs/demo_line_line.toml").read_text())
    job = tomllib.loads((ROOT / "jobs/demo_line.toml").read_text())
    assert line["plc"]["endpoint"] == f"modbus-tcp://{plant.plc.tcp}?unit=1"
    assert line["kiln"]["endpoint"] == f"modbus-tcp://{plant.kiln.tcp}?unit=2"
    assert line["printer"]["data"] == f"tcp://{plant.printer.data}"
    assert line["printer"]["control"].partition("?")[0] == plant.printer.control.replace("pty:", "serial://")
    assert line["gauge"]["endpoint"].partition("?")[0] == plant.gauge.pty.replace("pty:", "serial://")
    assert ROOT / "jobs" / line["camera"]["folder"] == Path(plant.camera.folder)
    assert line["camera"]["px_per_mm"] == plant.camera.px_per_mm
    assert line["inspection"]["clock_rate"] == plant.clock.rate
    recipe = line["recipes"][job["line"]["recipe"]]
    assert tuple(recipe["kiln_set_points_degc"]) == plant.kiln.zones_degc
    assert recipe["cycle_min"] == plant.kiln.cycle_minutes
    length = job["tile"]["size_mm"][1]
    assert (length + recipe["tile_gap_mm"]) / recipe["belt_speed_mm_s"] == 20.0
