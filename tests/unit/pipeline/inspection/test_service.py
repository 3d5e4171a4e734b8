"""The inspector as a service: what it needs, how it ends, and that there is only one of it."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from tilefab.config.line import LineFile, load_line
from tilefab.errors import ConfigError, JournalError
from tilefab.io.inspection_store import InspectionStore
from tilefab.pipeline.inspection import service
from tilefab.pipeline.inspection.inspector import Inspector
from tilefab.pipeline.inspection.places import inspection_log_path, store_url
from tilefab.pipeline.inspection.service import open_inspector, serve_inspection

LINE = """\
schema_version = 1
[line]
name = "line 1"
state_directory = "state"
[plc]
endpoint = "modbus-tcp://127.0.0.1:1502?unit=1"
[printer]
control = "serial:///tmp/none?baud=921600"
data = "tcp://127.0.0.1:19100"
[recipes.default]
belt_speed_mm_s = 100
tile_gap_mm = 200
"""
CAMERA = """\
[camera]
folder = "camera"
px_per_mm = 4
[inspection]
clock_rate = 60
"""


class Nobody:
    """No daemon."""

    def correct(self, *_: object) -> int:
        raise AssertionError("nothing is to be corrected")

    def warn(self, *_: object) -> None:
        """Is told that there is no journal."""


def silent(kind: str, **facts: object) -> None:
    """A log that nobody reads."""


def nobody(_: LineFile) -> Nobody:
    return Nobody()


@pytest.fixture
def line(tmp_path: Path) -> Path:
    path = tmp_path / "line.toml"
    path.write_text(LINE + CAMERA)
    (tmp_path / "camera").mkdir()
    return path


def test_a_line_without_a_camera_cant_be_inspected(tmp_path: Path) -> None:
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    with pytest.raises(ConfigError, match=r"camera\.folder: the line has no camera"):
        serve_inspection(path, nobody)


def test_inspections_are_kept_beside_the_journal(line: Path) -> None:
    assert store_url(load_line(line)) == f"sqlite:///{line.parent}/state/inspection.db"
    line.write_text(LINE + CAMERA + '[journal]\nurl = "postgresql://plant/tiles"\n')
    assert store_url(load_line(line)) == "postgresql://plant/tiles"


def test_a_signal_ends_it_between_two_rounds(line: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds: list[int] = []
    nice: list[int] = []
    real = Inspector.round

    def round_(inspector: Inspector) -> int:
        rounds.append(real(inspector))
        if len(rounds) == 3:
            signal.raise_signal(signal.SIGTERM)
        return 1

    monkeypatch.setattr(Inspector, "round", round_)
    monkeypatch.setattr(os, "nice", nice.append)
    before = signal.getsignal(signal.SIGTERM)
    serve_inspection(line, nobody)
    assert rounds == [0, 0, 0]
    assert nice == [service._NICE]
    assert signal.getsignal(signal.SIGTERM) is before
    file = load_line(line)
    events = [json.loads(text)["kind"] for text in inspection_log_path(file).read_text().splitlines()]
    assert (events[0], events[-1]) == ("up", "down")
    assert InspectionStore.exists(store_url(file), "line 1")


def test_there_is_one_inspector_of_a_line(line: Path) -> None:
    file = load_line(line)
    file.state_directory.mkdir()
    with open_inspector(file, Nobody(), silent) as inspector:
        assert inspector.round() == 0
        with pytest.raises(JournalError, match="another inspector"):
            serve_inspection(line, nobody)
    with open_inspector(file, Nobody(), silent):
        pass
