import dataclasses
import json

import pytest

from tilefab.pipeline.line.status import AlarmView, CorrectionView, DeviceView, DoubtView, FaceView, LineStatus

FULL = LineStatus(
    line="line 1",
    state="holding",
    since="2026-03-01T08:00:00+00:00",
    version="0.1.0",
    reason="tiles are jammed",
    job="Green",
    run_id=7,
    faces_wanted=1000,
    counts={"passed": 12, "in_doubt": 1},
    in_doubt=1,
    faces_in_doubt=(DoubtView(3, 11),),
    correction=CorrectionView(3, "2026-03-01T07:48:00+00:00", "fired darker", "ab" * 32),
    belt_running=True,
    belt_speed_mm_s=2200.0,
    faces_per_minute=198.5,
    armed_ahead=3,
    ink_names=("Blue", "Brown"),
    ink_frac=(0.5, 0.25),
    kiln_degc=(450.5, 781.0),
    kiln_set_degc=(450.0, 780.0),
    kiln_tiles=42,
    devices={"plc": DeviceView(True, 0.02, 3), "kiln": DeviceView(False, None, 9)},
    alarms=(AlarmView(4, "jam", "2026-03-01T08:00:00+00:00", "tiles are jammed", "clear it", False),),
    last_alarm=4,
    last_faces=(FaceView(11, 99, "passed", "2026-03-01T07:59:00+00:00", 1234, "why", 2),),
    queue=("Red",),
)


def test_a_status_survives_the_way_through_json() -> None:
    assert all(getattr(FULL, field.name) for field in dataclasses.fields(LineStatus)), "the test leaves nothing out"
    assert LineStatus.from_json(json.loads(json.dumps(FULL.to_json()))) == FULL


def test_what_a_newer_daemon_adds_is_left_out() -> None:
    told = FULL.to_json()
    told["humidity"] = 0.5
    told["devices"]["plc"]["firmware"] = "2.1"
    assert LineStatus.from_json(told) == FULL


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("alarms", "none"),
        ("alarms", [3]),
        ("alarms", [{"code": "jam"}]),
        ("devices", []),
        ("queue", 3),
        ("line", None),
        ("correction", 3),
    ],
)
def test_what_isnt_a_status_is_refused(key: str, value: object) -> None:
    told = FULL.to_json()
    if value is None:
        del told[key]
    else:
        told[key] = value
    with pytest.raises(ValueError):
        LineStatus.from_json(told)


def test_a_line_without_a_correction_says_so() -> None:
    told = FULL.to_json()
    told["correction"] = None
    assert LineStatus.from_json(told).correction is None


def test_no_object_is_no_status() -> None:
    with pytest.raises(ValueError, match="LineStatus"):
        LineStatus.from_json([1])
