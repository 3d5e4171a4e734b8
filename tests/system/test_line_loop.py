"""The loop over real wires: tiles printed by the daemon, fired and photographed by the plant, recognised, reported."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tests.line_workshop import STOPPED, PlantProcess, Workplace, plant_process, wait_for, write_line
from tilefab.inspection.records import Grade
from tilefab.io.inspection_records import InspectionRecord
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import Journal
from tilefab.pipeline.inspection.places import store_url
from tilefab.pipeline.inspection.service import open_inspector

pytestmark = pytest.mark.xdist_group("line")

COMMAND = [sys.executable, "-c", "from tilefab.cli.main import main; main()"]
TILES = 14
JOB = """\
[job]
name = "Loop"
[slab]
scans = ["package:skimage/data/gravel.png"]
dpi = 60
target_lab = [60.0, 3.0, 11.0]
[texture]
crops = 64
seed = 5
[tile]
size_mm = [100, 80]
dpi = 60
count = 14
bleed_mm = 2
[colour]
press_profile = "demo_line.icc"
ink_limit_percent = 260
[output]
directory = "job"
[report]
pdf = false
"""
PLANT = """\
[clock]
rate = {rate}
[loader]
tile_width_mm = 100
[printer]
control = "pty:printer"
keep_prints = true
boot_seconds = 0.15
[kiln]
press = "ceramic4"
start_degc = 1180
cycle_minutes = 35
shuffle_minutes = 1
[camera]
folder = "camera"
px_per_mm = 3
scale = 0.003
"""
LINE = """\
[camera]
folder = "camera"
px_per_mm = 3
[inspection]
clock_rate = 20
window_min = 600
"""


class Daemon:
    """Takes what the inspector has to say to the line."""

    def __init__(self) -> None:
        self.warned: list[str] = []

    def correct(self, run_id: int, _: Any, reason: str) -> int:
        raise AssertionError(f"run {run_id} is over, and was to be corrected: {reason}")

    def warn(self, code: str, text: str) -> None:
        self.warned.append(f"{code}: {text}")


@dataclass
class Seen:
    """A job that was printed, fired and inspected."""

    plant: PlantProcess
    place: Workplace
    tiles: list[InspectionRecord]

    @property
    def folder(self) -> Path:
        return self.place.line.path.parent

    def command(self, *arguments: str) -> tuple[int, str, str]:
        done = subprocess.run([*COMMAND, *arguments], cwd=self.folder, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Seen]:
    folder = tmp_path_factory.mktemp("loop")
    (folder / "camera").mkdir()
    (folder / "job.toml").write_text(JOB)
    with plant_process(folder, rate=20.0, plant=PLANT) as plant:
        line = write_line(folder, plant.endpoints, speed=200.0, run_out_mm=4000.0, more=LINE)
        place = Workplace.open(folder / "job.toml", line)
        assert wait_for(place.fork(lambda _: None)) == STOPPED
        plant.do("rate", rate=1000)
        while plant.do("state")["kiln"]["tiles_inside"] or plant.do("state")["camera"]["pending"]:
            pass  # at a thousand times its pace the kiln is empty in seconds
        told: list[str] = []
        with open_inspector(place.line, Daemon(), lambda kind, **facts: told.append(f"{kind} {facts}")) as inspector:
            while len(list((folder / "camera").glob("*.png"))) > inspected(place):
                inspector.round()
        with InspectionStore.look(store_url(place.line), line=place.line.name) as store:
            yield Seen(plant, place, store.tiles())


def inspected(place: Workplace) -> int:
    with InspectionStore.look(store_url(place.line), line=place.line.name) as store:
        return len(store.tiles()) + len(store.skipped())


def photographed(plant: PlantProcess) -> dict[str, int]:
    """What is on the tile of each image, by the plant's own knowledge."""
    tiles = plant.do("truth", since=0, limit=1000)["tiles"]
    return {
        tile["photo"]["name"]: tile["prints"][0]["face"]
        for tile in tiles
        if tile.get("photo") and tile["photo"]["name"] and tile["prints"]
    }


def test_every_tile_is_recognised_as_what_was_printed_on_it(seen: Seen) -> None:
    truth = photographed(seen.plant)
    assert len(truth) >= TILES - 2  # a tile or so may break in the kiln, or be scrapped before it
    assert {tile.image: tile.face for tile in seen.tiles if tile.image in truth} == truth
    for tile in seen.tiles:
        if tile.face is not None:
            assert tile.colour is not None
            assert tile.colour.delta_e_mean < 1.0
            assert tile.grade is Grade.FIRST
            assert (tile.run_id, tile.correction) == (1, 0)


def test_prints_are_paired_with_their_arms(seen: Seen) -> None:
    with Journal.look(seen.place.line.journal_url, line=seen.place.line.name) as journal:
        arms = {arm.arm_id: arm.face for arm in journal.arms(1)}
    for tile in seen.tiles:
        if tile.face is not None and tile.arm_id is not None:
            assert arms[tile.arm_id] == tile.face
            assert tile.printed_at is not None
            assert tile.printed_at < tile.taken_at


def test_a_tile_is_traced_and_printed_again_as_the_printer_got_it(seen: Seen) -> None:
    tile = next(tile for tile in seen.tiles if tile.face is not None)
    image = str(seen.folder / "camera" / tile.image)
    code, out, err = seen.command("trace", image, "job.toml", "--line", "line.toml", "-o", "again.tif", "--json")
    assert code == 0, err
    traced = json.loads(out)
    assert traced["recognition"]["face"] == tile.face
    assert traced["arm_id"] == tile.arm_id
    assert traced["image"] == tile.image
    assert (seen.folder / "again.tif").is_file()
    code, out, err = seen.command("trace", image, "job.toml", "--line", "line.toml", "-o", "again.tif")
    assert code == 0, err
    assert "the same that the printer received" in out
    # A tile that isn't the job's.
    stranger = seen.folder / "stranger.png"
    picture = Image.open(image)
    width, height = picture.size
    picture.crop((width // 3, height // 3, width // 2, height // 2)).resize((300, 240)).save(stranger)
    code, out, err = seen.command("trace", str(stranger), "job.toml", "--line", "line.toml")
    assert code == 1, out + err


def test_the_report_tells_of_all_tiles(seen: Seen) -> None:
    code, out, err = seen.command("line", "report", "line.toml", "-o", "report.pdf")
    assert code == 0, err
    assert out.split() == ["report.pdf", "report.json"]
    assert (seen.folder / "report.pdf").read_bytes().startswith(b"%PDF")
    told = json.loads((seen.folder / "report.json").read_text())
    assert told["run"] == 1
    faces = {tile["face"] for tile in told["tiles"] if tile["grade"] == "first"}
    assert faces == {tile.face for tile in seen.tiles if tile.face is not None}
    code, out, err = seen.command("line", "inspected", "line.toml", "--json")
    assert code == 0, err
    assert json.loads(out)["inspected"] == len(faces)
    assert seen.command("line", "report", "line.toml", "--run", "9")[0] == 11
    assert seen.command("line", "report", "line.toml", "--shift", "2001-01-01T06:00")[0] == 11
    assert seen.command("line", "report", "line.toml", "--shift", "yesterday")[0] == 2
