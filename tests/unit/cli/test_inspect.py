"""The inspector's link to the line's daemon, as the command makes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.pipeline.inspection.test_service import CAMERA, LINE
from tilefab.cli.inspect import DaemonLink
from tilefab.config.line import load_line
from tilefab.errors import ConfigError, DeviceTimeout
from tilefab.web.client import LineClient
from tilefab.web.token import make_token


@pytest.fixture
def line(tmp_path: Path) -> Path:
    path = tmp_path / "line.toml"
    path.write_text(LINE + CAMERA)
    (tmp_path / "state").mkdir()
    return path


def test_without_a_daemon_that_is_what_is_wrong(line: Path) -> None:
    link = DaemonLink(load_line(line))
    with pytest.raises(DeviceTimeout, match="no daemon runs"):
        link.warn("camera_silent", "no image")
    make_token(line.parent / "state" / "token")
    with pytest.raises(DeviceTimeout, match="no daemon runs"):
        link.correct(1, {}, "drift")


def test_a_token_that_isnt_one_is_told(line: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LineClient, "status", lambda _: None)
    with pytest.raises(ConfigError, match="there is no token"):
        DaemonLink(load_line(line)).warn("camera_silent", "no image")


def test_the_token_is_read_when_it_is_needed(line: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    used: list[tuple[str, tuple[object, ...]]] = []

    def correct(client: LineClient, *arguments: object) -> int:
        used.append((client._token, arguments))
        return 4

    monkeypatch.setattr(LineClient, "correct", correct)
    monkeypatch.setattr(LineClient, "warn", correct)
    link = DaemonLink(load_line(line), line.parent / "elsewhere")
    token = make_token(line.parent / "elsewhere")
    assert link.correct(3, {"mean": []}, "drift") == 4
    link.warn("camera_silent", "no image")
    assert used == [(token, (3, {"mean": []}, "drift")), (token, ("camera_silent", "no image"))]
