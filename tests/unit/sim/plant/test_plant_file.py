"""Plant files: what they may say, and what is told of what is wrong."""

from __future__ import annotations

import pytest

from sim.plant.config import parse_plant, read_plant

SEEN = {"kiln": {"press": "ceramic4"}, "printer": {"keep_prints": True}}


def test_an_empty_file_is_a_plant():
    plant = parse_plant({})
    assert (plant.clock.rate, plant.belt.counts_per_mm, plant.printer.verify) == (1, 20, "crc32")


def test_paths_start_at_the_file_s_folder(tmp_path):
    file = tmp_path / "plant.toml"
    file.write_text(
        'truth_file = "truth.jsonl"\nendpoints_file = "/elsewhere/endpoints.json"\n'
        '[camera]\nfolder = "../seen"\n[kiln]\npress = "ceramic4"\nzones_degc = [1, 2, 3, 4, 5, 6, 7, 8.5]\n'
        '[printer]\ncontrol = "pty:printer"\nkeep_prints = true\n'
        '[plc]\nrtu = "pty:/dev/shm/plc"\nbaud = 9600\n[clock]\nrate = 60\n'
    )
    plant = read_plant(file)
    assert plant.truth_file == str(tmp_path / "truth.jsonl")
    assert plant.endpoints_file == "/elsewhere/endpoints.json"
    assert plant.printer.control == f"pty:{tmp_path / 'printer'}"
    assert plant.plc.rtu == "pty:/dev/shm/plc"
    assert (plant.gauge.pty, plant.plc.baud, plant.clock.rate) == ("", 9600, 60)
    assert plant.camera.folder == str(tmp_path / "../seen")
    assert plant.kiln.zones_degc == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.5)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"clock": {"rate": 0.5}}, "rate 0.5 is not 1 to 1000"),
        ({"clock": {"rate": 1001}}, "rate 1001.0 is not 1 to 1000"),
        ({"clock": {"rate": "fast"}}, "clock.rate must be of type float, not str"),
        ({"clock": {"rate": True}}, "clock.rate must be of type float, not bool"),
        ({"clock": 3}, "clock is no table"),
        ({"belts": {}}, "the file has no 'belts'"),
        ({"belt": {"speed": 3}}, "belt has no 'speed'"),
        ({"belt": {"decel_mm_s2": 0}}, "belt.decel_mm_s2 must be above 0"),
        ({"belt": {"eye_to_head_mm": -1}}, "belt.eye_to_head_mm must not be below 0"),
        ({"loader": {"tiles": 1.5}}, "loader.tiles must be of type int"),
        ({"printer": {"inks": 9}}, "1 to 8 inks"),
        ({"printer": {"verify": "md5"}}, "'md5' is not crc32, sha256 or none"),
        ({"printer": {"buffer_bytes": 1 << 32}}, "below 4 GiB"),
        ({"kiln": {"cycle_minutes": 80}}, "outside least_minutes to most_minutes"),
        ({"kiln": {"zones_degc": [1000.0] * 7}}, "7 temperatures for 8 zones"),
        ({"kiln": {"zones_degc": [1000.0] * 7 + ["hot"]}}, r"kiln.zones_degc\[7\] must be of type float"),
        ({"kiln": {"zones_degc": 1000.0}}, "kiln.zones_degc must be of type tuple, not float"),
        ({"kiln": {"press": "ceramic5"}}, "'ceramic5' is unknown"),
        ({"kiln": {"press": "ceramic6"}}, "'ceramic6' has 6 inks, printer.inks says 4"),
        ({"camera": {"folder": "seen"}}, "needs kiln.press, and printer.keep_prints = true"),
        ({"camera": {"every": 0}}, "camera.every must be above 0"),
        (SEEN | {"camera": {"folder": "seen", "format": "bmp"}}, "'bmp' is not png or tiff"),
        (SEEN | {"camera": {"folder": "seen", "late_rate": 1.5}}, "late_rate are shares, 0 to 1"),
        (SEEN | {"camera": {"folder": "seen", "scale": 0.5}}, "shares below 0.5"),
    ],
)
def test_what_is_wrong_is_told(content, says):
    with pytest.raises(ValueError, match=says):
        parse_plant(content)
