import io
import json
import logging
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from tilefab.pipeline.line import log as log_module
from tilefab.pipeline.line.log import LineLog

NOW = datetime(2026, 3, 1, 8, 0, 0, 250_000, UTC)
SECRET = "s3cr3t-t0ken-that-nobody-may-see-0123"


def _lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_events_are_lines_of_json_in_the_file_and_on_the_stream(tmp_path: Path) -> None:
    stream = io.StringIO()
    with LineLog(tmp_path / "line.log", stream=stream, now=lambda: NOW) as log:
        log("state", state="running", before="arming")
        log("alarm", number=3, text="a\nb", path=Path("/x"))
    expected = [
        {"at": "2026-03-01T08:00:00.250+00:00", "kind": "state", "state": "running", "before": "arming"},
        {"at": "2026-03-01T08:00:00.250+00:00", "kind": "alarm", "number": 3, "text": "a\nb", "path": "/x"},
    ]
    assert _lines(stream.getvalue()) == expected
    assert _lines((tmp_path / "line.log").read_text(encoding="utf-8")) == expected


def test_secrets_never_get_into_it(tmp_path: Path) -> None:
    stream = io.StringIO()
    with LineLog(tmp_path / "line.log", stream=stream) as log:
        log.hide(SECRET)
        log("a", text=f"someone said {SECRET}", deep={"list": [SECRET, {"x": SECRET}]})
        log("b", token="abc-plain", Authorization="xyz-plain", nested={"password": "pqr-plain"})
        log("c", url="postgresql://user:hunter2@host/db", header="Bearer abc.def-ghi")
        log("d", error=ValueError(SECRET))
    for text in (stream.getvalue(), (tmp_path / "line.log").read_text(encoding="utf-8")):
        for secret in (SECRET, "abc-plain", "xyz-plain", "pqr-plain", "hunter2", "abc.def-ghi"):
            assert secret not in text
        assert "postgresql://user:***@host/db" in text


def test_the_file_is_kept_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_module, "_FILE_BYTES", 2000)
    monkeypatch.setattr(log_module, "_FILES_KEPT", 2)
    with LineLog(tmp_path / "line.log", stream=None) as log:
        for n in range(300):
            log("tick", n=n)
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["line.log", "line.log.1", "line.log.2"]
    assert all((tmp_path / name).stat().st_size <= 2000 for name in files)
    assert _lines((tmp_path / "line.log").read_text())[-1]["n"] == 299


def test_a_line_of_any_length_is_cut(tmp_path: Path) -> None:
    stream = io.StringIO()
    with LineLog(None, stream=stream) as log:
        log("long", text="x" * 1_000_000, more="y")
    (line,) = _lines(stream.getvalue())
    assert line["cut"] is True
    assert len(stream.getvalue()) < 10_000
    assert line["more"] == "y"


class _Stuck(io.StringIO):
    """A disk that answers when it likes."""

    def __init__(self) -> None:
        super().__init__()
        self.go = threading.Event()

    def write(self, text: str) -> int:
        self.go.wait(10)
        return super().write(text)


def test_a_stuck_disk_holds_nobody_up_and_what_was_lost_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_module, "_WAITING", 4)
    stream = _Stuck()
    log = LineLog(None, stream=stream)
    for n in range(50):
        log("tick", n=n)
    stream.go.set()
    log.close()
    lines = _lines(stream.getvalue())
    assert [line["n"] for line in lines] == list(range(len(lines)))
    assert 4 <= len(lines) <= 5
    with LineLog(None, stream=stream) as again:
        again._lost = 45
        again("after")
        again("later")
    assert _lines(stream.getvalue())[-2]["lines_lost"] == 45
    assert "lines_lost" not in _lines(stream.getvalue())[-1]


class _Full(io.StringIO):
    def write(self, _: str) -> int:
        raise OSError(28, "No space left on device")


def test_a_full_disk_stops_nobody(capsys: pytest.CaptureFixture[str]) -> None:
    with LineLog(None, stream=_Full()) as log:
        log("tick")
    assert capsys.readouterr().err == ""


def test_it_leaves_the_programs_logging_alone() -> None:
    before = list(logging.root.handlers)
    with LineLog(None, stream=io.StringIO()) as log:
        log("tick")
        assert logging.root.handlers == before
