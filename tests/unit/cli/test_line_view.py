"""The status table: what must be seen is seen, at any width."""

import dataclasses
import io
from datetime import datetime, timedelta

import pytest
from rich.console import Console

from tests.unit.pipeline.line.test_status import FULL
from tilefab.cli.line_view import ago, status_view
from tilefab.pipeline.line.status import AlarmView, DoubtView, LineStatus

NOW = datetime.fromisoformat("2026-03-01T08:00:42+00:00")


def _shown(status: LineStatus, width: int = 120) -> str:
    console = Console(file=io.StringIO(), width=width, color_system=None, legacy_windows=False)
    console.print(status_view(status, NOW, width=width))
    return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]


@pytest.mark.parametrize("width", [60, 80, 110, 200])
def test_all_of_a_status_is_shown(width: int) -> None:
    text = _shown(FULL, width)
    for word in ("line 1", "HOLDING", "for 42 s", "Green", "12 of 1,000", "in doubt", "run 3:", "runs", "2200 mm/s"):
        assert word in text
    for word in ("198 a minute", "Blue", "50 %", "450", "781", "42 tiles", "plc", "3 errors", "not there yet", "Red"):
        assert word in text
    for word in ("correction", "3, 12 min", "fired", "darker"):
        assert word in text
    assert max(map(len, text.splitlines())) <= width


def test_each_alarm_says_what_to_do_and_whether_it_was_acknowledged() -> None:
    second = AlarmView(5, "ink_out", FULL.since, "the printer ran out of ink", "refill it", True)
    text = _shown(dataclasses.replace(FULL, alarms=(*FULL.alarms, second)))
    for word in ("jam", "clear it", "ink_out", "refill it", "acknowledged"):
        assert word in text
    assert text.count("acknowledged") == 1


def test_words_of_devices_are_never_taken_for_markup() -> None:
    status = dataclasses.replace(FULL, reason="[red]x[/red]", job="[bold]y", queue=("[/]",), ink_names=("[i]", "b"))
    text = _shown(status)
    for word in ("[red]x[/red]", "[bold]y", "[/]", "[i]"):
        assert word in text


def test_many_faces_in_doubt_are_counted() -> None:
    text = _shown(
        dataclasses.replace(FULL, in_doubt=300, faces_in_doubt=tuple(DoubtView(1, face) for face in range(20)))
    )
    assert "settle 300 faces" in text


def test_a_line_without_anything_is_shown() -> None:
    text = _shown(LineStatus(line="line 1", state="idle", since=NOW.isoformat(), version="0.1.0"))
    assert "IDLE" in text
    assert "nothing queued" in text
    assert "ink" not in text
    assert "kiln" not in text
    assert "correction" not in text
    text = _shown(LineStatus(line="line 1", state="idle", since=NOW.isoformat(), version="0.1.0", run_id=3))
    assert "correction  none" in text


def test_a_state_of_another_version_is_shown_as_it_is() -> None:
    assert "DREAMING" in _shown(dataclasses.replace(FULL, state="dreaming"))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(-5, "0 s"), (59.9, "59 s"), (60, "1 min 00 s"), (3599, "59 min 59 s"), (3600, "1 h 00 min"), (90_000, "1 d 1 h")],
)
def test_how_long_ago(seconds: float, text: str) -> None:
    assert ago((NOW - timedelta(seconds=seconds)).isoformat(), NOW) == text


def test_a_time_that_is_none_is_shown_as_it_is() -> None:
    assert ago("yesterday", NOW) == "yesterday"
    assert ago("2026-03-01T08:00:00", NOW) == "2026-03-01T08:00:00"
