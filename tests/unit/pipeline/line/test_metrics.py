import dataclasses

from prometheus_client.parser import text_string_to_metric_families

from tests.unit.pipeline.line.test_status import FULL
from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.pipeline.line.metrics import LineCounters, metrics_text
from tilefab.pipeline.line.timing import Latencies


def _samples(text: bytes) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    found = {}
    for family in text_string_to_metric_families(text.decode()):
        for sample in family.samples:
            labels = tuple(sorted((k, v) for k, v in sample.labels.items() if k != "line"))
            assert sample.labels["line"] == "line 1", sample.name
            key = (sample.name, labels)
            assert key not in found, f"{key} told twice"
            found[key] = sample.value
    return found


def _counters() -> LineCounters:
    times = Latencies()
    for ms in range(1, 1001):
        times.add(ms / 1000)
    return LineCounters(12, 3, 2, 5, 1.7e9, {"arming": times})


def test_every_figure_is_told_once() -> None:
    found = _samples(metrics_text(FULL, _counters()))
    expected = {
        ("tilefab_line_state", (("state", "holding"),)): 1.0,
        ("tilefab_line_state", (("state", "running"),)): 0.0,
        ("tilefab_line_alarms", ()): 1.0,
        ("tilefab_line_alarms_unacked", ()): 1.0,
        ("tilefab_line_alarms_raised_total", ()): 5.0,
        ("tilefab_line_arms", (("state", "passed"),)): 12.0,
        ("tilefab_line_arms", (("state", "partial"),)): 0.0,
        ("tilefab_line_faces_in_doubt", ()): 1.0,
        ("tilefab_line_tiles_passed_total", ()): 12.0,
        ("tilefab_line_tiles_diverted_total", ()): 3.0,
        ("tilefab_line_tiles_blank_total", ()): 2.0,
        ("tilefab_line_belt_running", ()): 1.0,
        ("tilefab_line_belt_speed_mm_per_second", ()): 2200.0,
        ("tilefab_line_ink_ratio", (("channel", "1"), ("ink", "Brown"))): 0.25,
        ("tilefab_line_kiln_celsius", (("zone", "2"),)): 781.0,
        ("tilefab_line_kiln_set_celsius", (("zone", "1"),)): 450.0,
        ("tilefab_line_device_up", (("device", "kiln"),)): 0.0,
        ("tilefab_line_device_errors_total", (("device", "plc"),)): 3.0,
        ("tilefab_line_device_silence_seconds", (("device", "plc"),)): 0.02,
        ("tilefab_line_arming_times_total", ()): 1000.0,
    }
    assert {key: found.get(key) for key in expected} == expected
    assert sum(name == "tilefab_line_state" for name, _ in found) == len(LineState)
    assert sum(name == "tilefab_line_arms" for name, _ in found) == len(ArmState)
    assert ("tilefab_line_device_silence_seconds", (("device", "kiln"),)) not in found
    middle = found["tilefab_line_arming_seconds", (("quantile", "0.5"),)]
    assert 0.5 <= middle <= 0.53
    assert found["tilefab_line_arming_seconds", (("quantile", "1"),)] == 1.0


def test_inks_without_names_are_told_by_channel() -> None:
    found = _samples(metrics_text(dataclasses.replace(FULL, ink_names=()), _counters()))
    assert found["tilefab_line_ink_ratio", (("channel", "0"), ("ink", ""))] == 0.5


def test_two_scrapes_leave_nothing_behind() -> None:
    assert metrics_text(FULL, _counters()) == metrics_text(FULL, _counters())
