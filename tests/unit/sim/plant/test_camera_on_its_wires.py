"""A tile that is printed over the wires is photographed with exactly those pixels, and faults are set on the wire."""

from __future__ import annotations

from contextlib import ExitStack
from zlib import crc32

import imagecodecs
import numpy as np
import pytest

from sim.fired_tile import LaidPrint, fired_tile
from sim.kiln import Firing
from sim.plant.config import parse_plant
from sim.plant.inprocess import plant_in, running_plant_here
from sim.plant.network.service import CommandError
from sim.scanner import srgb_bytes
from sim.spectral_press import SpectralPress
from tests.unit.sim.plant.hosts import DataHost, ModbusHost, PrinterHost, wait_until
from tests.unit.sim.plant.test_photographer import order

pytestmark = pytest.mark.xdist_group("line")

ROWS, COLS = 124, 104
PIXELS = np.kron(np.random.default_rng(2).integers(0, 150, (31, 26, 4)), np.ones((4, 4, 1))).astype(np.uint8)


def plant_with_camera(folder, **camera):
    quiet = {"noise": 0.0, "blur_px": 0.0, "light": 0.0, "rotation_deg": 0.0, "shift_mm": 0.0, "quarter_turns": False}
    return plant_in(
        folder,
        clock={"rate": 20.0},
        loader={"tiles": 1, "tile_width_mm": 100.0},
        printer={"keep_prints": True},
        kiln={"least_minutes": 1.0, "cycle_minutes": 1.0, "press": "ceramic4", "start_degc": 1180.0},
        camera={"folder": str(folder / "seen")} | quiet | camera,
    )


def print_a_tile(running):
    """A tile of 120 mm, printed with a bleed of 2 mm in rows of 1 mm."""
    ends, data = running.endpoints, PIXELS.tobytes()
    with ModbusHost(ends["plc_tcp"]) as plc, PrinterHost(ends["printer_control"]) as printer:
        printer.open()
        with DataHost(ends["printer_data"]) as link:
            link.stat()
            plc.poll()
            words = (1, 3, 5000, 1200, 2000, 0, 1, 0xFFFF, 0xFFFF, 0)
            assert plc.write(32, *words)[0] == 16

            def alive():
                plc.poll()
                printer.ask(2)
                return True

            (seen, *_) = wait_until(lambda: alive() and printer.detections(1))
            start = seen[1] + (2600 - 2) * 20
            assert printer.arm(1, 1, start, rows=ROWS, cols=COLS) == 0
            for row in range(0, ROWS, 31):
                link.strip(1, row, data[row * COLS * 4 : (row + 31) * COLS * 4], row_bytes=COLS * 4)
                link.stat()
            wait_until(lambda: alive() and printer.outcome(1)[3] == 2, "printed")
            assert printer.outcome(1)[-1] == crc32(data)
            wait_until(lambda: alive() and running.summary()["in_kiln"], "in the kiln")


def test_a_printed_tile_is_photographed_as_it_was_printed_and_fired(tmp_path):
    with running_plant_here(plant_with_camera(tmp_path)) as running:
        running.fault("kiln", "firing_drift", peak=25, ink=1, strength=0.2, minutes=0)
        print_a_tile(running)
        wait_until(lambda: running.state()["camera"]["written"], "an image")
        (tile,) = running.truth()["tiles"]
        state = running.state()["camera"]
    assert state == {
        **{"seen": 1, "taken": 1, "missed": 0, "faults": {}, "pending": 0, "written": 1, "lost": 0, "kept_bytes": 0}
    }
    image = imagecodecs.png_decode((tmp_path / "seen" / tile["photo"]["name"]).read_bytes())
    assert tile["fired"]["peak_offset_degc"] == pytest.approx(25.0, abs=1e-3)
    firing = Firing(25.0, ink_offset_frac=(0.0, 0.2, 0.0, 0.0))
    prints = [LaidPrint(PIXELS, 1.0, -2.0)]
    expected = srgb_bytes(fired_tile(prints, (100.0, 120.0), SpectralPress("ceramic4"), firing, px_per_mm=4.0))
    seen = image[32:-32, 32:-32].astype(int)
    assert seen.shape == expected.shape
    assert np.abs(seen - expected)[1:-1, 1:-1].max() <= 2


def test_faults_of_camera_and_firing_are_set_by_command(tmp_path):
    with running_plant_here(plant_with_camera(tmp_path)) as running:
        running.fault("printer", "nozzle_out", ink=2, at_mm=-7.5, width_mm=0.4, noticed=False)
        running.fault("printer", "banding", strength=0.2, period_mm=10)
        running.fault("printer", "double_print", strength=0.3, shift_mm=4, count=2)
        running.fault("camera", "camera_torn", count=3)
        running.fault("camera", "camera_dirty")
        running.fault("camera", "camera_clock", seconds=-30)
        assert running.state()["camera"]["faults"] == {"camera_torn": 3, "camera_dirty": -1}
        assert not running.state()["printer"]["nozzle_out"]
        with running.physics() as plant:
            assert plant.camera is not None
            assert plant.camera.clock_off_s == -30
            flaws = [flaw.view() for flaw in plant.head.flaws]
        assert [(flaw["kind"], flaw["ink"], flaw["at_mm"], flaw["width_mm"]) for flaw in flaws] == [
            ("nozzle", 2, -7.5, 0.4),
            ("banding", 0, 0.0, 0.0),
        ]
        running.fault("printer", "nozzle_ok")
        running.fault("printer", "banding_ok")
        running.fault("camera", "camera_ok")
        assert running.state()["camera"]["faults"] == {}
        with running.physics() as plant:
            assert plant.head.flaws == []
        for wrong, says in (({"ink": 4}, "no ink 4"), ({}, "nothing drifts"), ({"peak": "hot"}, "could not convert")):
            with pytest.raises(CommandError, match=says):
                running.fault("kiln", "firing_drift", **wrong)


def test_without_a_camera_there_is_none_to_fail():
    with running_plant_here(parse_plant({})) as running:
        assert "camera" not in running.state()
        with pytest.raises(CommandError, match=r"no camera: the plant file has no camera\.folder"):
            running.fault("camera", "camera_black")
        with pytest.raises(CommandError, match="no colours are fired here"):
            running.fault("kiln", "firing_drift", oxygen=1)


def test_an_image_that_can_not_be_made_is_told_when_the_plant_ends(tmp_path):
    with ExitStack() as ending:
        plant = ending.enter_context(running_plant_here(plant_with_camera(tmp_path)))
        with plant.physics() as physics:
            assert physics.camera is not None
            physics.camera.on_photo(order(name="no/such/folder.png"))
        wait_until(lambda: plant.state()["camera"]["lost"])
        with pytest.raises(RuntimeError, match="could not be made"):
            ending.close()
