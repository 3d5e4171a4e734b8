"""Plant files: what they may say, and what is told of what is wrong."""

from __future__ import annotations

import pytest

from sim.plant.config import parse_plant, read_plant


def test_an_empty_file_is_a_plant():
    plant = parse_plant({})
    assert (plant.clock.rate, plant.belt.counts_per_mm, plant.printer.verify) == (1, 20, "crc32")


def test_paths_start_at_the_file_s_folder(tmp_path):
    file = tmp_path / "plant.toml"
    file.write_text(
        'truth_file = "truth.jsonl"\nendpoints_file = "/elsewhere/endpoints.json"\n'
        '[printer]\ncontrol = "pty:printer"\n[plc]\nrtu = "pty:/dev/shm/plc"\nbaud = 9600\n[clock]\nrate = 60\n'
    )
    plant = read_plant(file)
    assert plant.truth_file == str(tmp_path / "truth.jsonl")
    assert plant.endpoints_file == "/elsewhere/endpoints.json"
    assert plant.printer.control == f"pty:{tmp_path / 'printer'}"
    assert plant.plc.rtu == "pty:/dev/shm/plc"
    assert (plant.gauge.pty, plant.plc.baud, plant.clock.rate) == ("", 9600, 60)


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
    ],
)
def test_what_is_wrong_is_told(content, says):
    with pytest.raises(ValueError, match=says):
        parse_plant(content)
