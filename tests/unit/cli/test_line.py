"""``tilefab line`` against a made-up daemon, and against none."""

import asyncio
import json
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.unit.pipeline.line.test_status import FULL
from tests.unit.web.line_at_work import LINE, Control, at_work, line_file
from tilefab.cli import line as line_module
from tilefab.cli.main import main
from tilefab.colour.drift import no_drift
from tilefab.config import LineFile
from tilefab.io.drift_file import DriftFile, drift_text, write_drift_file
from tilefab.pipeline.line.status import LineStatus
from tilefab.web.token import make_token

Tilefab = Callable[..., tuple[int, str, str]]


@pytest.fixture
def tilefab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Tilefab:
    """Runs a command in a folder with a line's file; exit code, output, messages."""
    line_file(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("TILEFAB_LINE", raising=False)
    monkeypatch.delenv("TILEFAB_LINE_TOKEN_FILE", raising=False)

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["tilefab", "line", *arguments])
        code = 0
        try:
            main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0
        told = capsys.readouterr()
        return code, told.out, told.err

    return run


class Daemon:
    """A made-up daemon in a thread of its own."""

    def __init__(self, folder: Path) -> None:
        self.control = Control()
        self.file: LineFile = line_file(folder)
        self._loop = asyncio.new_event_loop()
        self._up = threading.Event()
        self._down = asyncio.Event()
        self._thread = threading.Thread(target=self._run, args=(folder,))

    def _run(self, folder: Path) -> None:
        async def serve() -> None:
            async with at_work(folder, self.control):
                self._up.set()
                await self._down.wait()

        self._loop.run_until_complete(serve())
        self._loop.close()

    def __enter__(self) -> "Daemon":
        self._thread.start()
        assert self._up.wait(10)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._down.set)
        self._thread.join()


@pytest.fixture
def daemon(tilefab: Tilefab, tmp_path: Path) -> Iterator[Daemon]:
    with Daemon(tmp_path) as running:
        yield running


ORDERS: list[tuple[tuple[str, ...], str, dict[str, object]]] = [
    (("start",), "start", {}),
    (("hold",), "hold", {}),
    (("resume",), "resume", {}),
    (("stop",), "stop", {}),
    (("reprint", "7"), "reprint", {"face": 7}),
    (("settle", "7", "unprinted"), "settle", {"face": 7, "state": "unprinted"}),
]


@pytest.mark.parametrize(("words", "name", "arguments"), ORDERS)
def test_orders_reach_the_daemon(
    tilefab: Tilefab, daemon: Daemon, words: tuple[str, ...], name: str, arguments: dict[str, object]
) -> None:
    assert tilefab(*words) == (0, f"{name} done\n", "")
    assert daemon.control.orders == [(name, arguments)]


@pytest.mark.parametrize("words", [("start",), ("ack",), ("status",), ("status", "--json"), ("settle", "7", "passed")])
def test_without_a_daemon_a_line_says_so(tilefab: Tilefab, words: tuple[str, ...]) -> None:
    code, out, err = tilefab(*words)
    assert (code, out) == (10, "")
    assert err.startswith("error: no daemon runs on this line")
    assert err.count("\n") == 1


def test_what_is_refused_ends_with_the_daemons_code(tilefab: Tilefab, daemon: Daemon) -> None:
    daemon.control.refuse = "the line is running already"
    assert tilefab("start") == (10, "", "error: the line is running already\n")


def test_an_acknowledgement_covers_what_was_up_and_shows_it(tilefab: Tilefab, daemon: Daemon) -> None:
    code, out, _ = tilefab("ack")
    assert code == 0
    assert out == "4 jam: tiles are jammed\nack done\n"
    assert tilefab("ack", "--up-to", "3")[1] == "ack done\n"
    assert tilefab("ack", "--up-to", "999")[0] == 0
    assert daemon.control.orders == [("ack", {"up_to": 4}), ("ack", {"up_to": 3}), ("ack", {"up_to": 4})]


def test_a_job_is_queued_by_its_whole_path_once_its_file_is_in_order(
    tilefab: Tilefab, daemon: Daemon, tmp_path: Path
) -> None:
    (tmp_path / "bad.toml").write_text("[slab]\n")
    code, _, err = tilefab("queue", "bad.toml")
    assert code == 3
    assert "bad.toml" in err
    assert daemon.control.orders == []
    (tmp_path / "good.toml").write_text(
        '[slab]\nscans = ["a.tif"]\n[tile]\nsize_mm = [20, 20]\ndpi = 60\n[colour]\npress_profile = "p.icc"\n'
        '[output]\ndirectory = "out"\n'
    )
    assert tilefab("queue", "good.toml")[0] == 0
    assert daemon.control.orders == [("queue", {"job": str(tmp_path / "good.toml")})]


def test_a_correction_reaches_the_daemon_with_its_reason(tilefab: Tilefab, daemon: Daemon, tmp_path: Path) -> None:
    drift = DriftFile(no_drift(1), ("Black",), "ab" * 32, 12)
    write_drift_file(tmp_path / "state.json", drift)
    code, out, _ = tilefab("correct", "state.json", "--reason", "fired darker")
    assert code == 0
    assert out.startswith("correction 1 of run 7 is in use")
    ((run_id, given, reason),) = daemon.control.corrected
    assert (run_id, reason) == (7, "fired darker")
    assert given == json.loads(drift_text(drift))
    assert tilefab("correct", "state.json")[0] == 2, "a reason is wanted"
    (tmp_path / "bad.json").write_text("{}")
    code, _, err = tilefab("correct", "bad.json", "--reason", "x")
    assert (code, len(daemon.control.corrected)) == (5, 1)
    assert "bad.json" in err
    daemon.control.refuse = "too soon"
    assert tilefab("correct", "state.json", "--reason", "again") == (10, "", "error: too soon\n")


def test_the_token_is_the_lines_own_or_another_that_is_named(tilefab: Tilefab, daemon: Daemon, tmp_path: Path) -> None:
    make_token(tmp_path / "wrong")
    assert tilefab("start", "--token-file", "wrong") == (10, "", "error: this isn't the line's token\n")
    daemon.file.token_path.chmod(0o644)
    code, _, err = tilefab("start")
    assert code == 3
    assert "others may read" in err
    assert daemon.control.orders == []
    assert tilefab("status")[0] == 0, "looking needs none"


def test_the_file_is_named_by_option_or_environment(
    tilefab: Tilefab, daemon: Daemon, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert tilefab("start")[0] == 3
    assert tilefab("start", "--line", "../line.toml")[0] == 0
    monkeypatch.setenv("TILEFAB_LINE", str(tmp_path / "line.toml"))
    assert tilefab("start")[0] == 0


def test_a_status_is_a_table_or_json(tilefab: Tilefab, daemon: Daemon) -> None:
    code, out, _ = tilefab("status")
    assert code == 0
    for word in ("HOLDING", "tiles are jammed", "clear it", "Green", "Blue", "Brown", "1,234", "Red"):
        assert word in out
    code, out, _ = tilefab("status", "--json")
    assert code == 0
    assert LineStatus.from_json(json.loads(out)) == FULL


def test_watching_goes_on_until_it_is_interrupted(
    tilefab: Tilefab, daemon: Daemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[float] = []

    def sleep(seconds: float) -> None:
        seen.append(seconds)
        if len(seen) == 2:
            daemon.control.defect = "out of order for a moment"
        if len(seen) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(line_module.time, "sleep", sleep)
    code, out, err = tilefab("status", "--watch")
    assert (code, err) == (0, "")
    assert "a defect of tilefab" in out
    daemon.control.defect = ""
    seen[:] = [0.0]
    monkeypatch.setattr(line_module.time, "sleep", lambda s: seen.append(s) if len(seen) < 3 else _interrupt())
    code, out, _ = tilefab("status", "--watch", "--json")
    assert code == 0
    assert [json.loads(line)["line"] for line in out.splitlines()] == ["line 1"] * 3


def _interrupt() -> None:
    raise KeyboardInterrupt


def test_a_lines_file_is_checked(tilefab: Tilefab, tmp_path: Path) -> None:
    code, out, _ = tilefab("check")
    assert code == 0
    assert "in order" in out
    code, out, _ = tilefab("check", "line.toml", "--json")
    assert json.loads(out)["paths"]["socket"] == str(tmp_path / "s" / "line.sock")
    line_file(tmp_path, LINE.replace("unit=1", "unit=900").replace("baud=921600", "speed=3"))
    code, _, err = tilefab("check")
    assert code == 3
    lines = err.splitlines()
    assert len(lines) == 2
    assert "line.toml:5: plc.endpoint" in lines[0]
    assert "line.toml:7: printer.control" in lines[1]
    code, out, _ = tilefab("check", "--json")
    assert code == 3
    told: dict[str, Any] = json.loads(out)
    assert [problem["line"] for problem in told["problems"]] == [5, 7]


@pytest.mark.parametrize(
    "words",
    [
        ("reprint", "-1"),
        ("reprint", str(1 << 40)),
        ("settle", "1", "printed"),
        ("settle", "1"),
        ("run",),
        ("ack", "--up-to", "-1"),
    ],
)
def test_wrong_usage_is_told_before_anything_is_asked(tilefab: Tilefab, words: tuple[str, ...]) -> None:
    assert tilefab(*words)[0] == 2
