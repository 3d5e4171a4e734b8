"""``tilefab synth`` and ``tilefab texture apply`` on the command line."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from PIL import Image
from typer.testing import CliRunner, Result

from tilefab.cli import main, synth
from tilefab.cli.progress import Bars
from tilefab.cli.synth_stop import Stop, StoppedEarly, run_stoppable
from tilefab.errors import ImageError, TilefabError
from tilefab.io.layers import read_layer
from tilefab.io.source_map_file import load_source_map
from tilefab.synthesis import METHODS

SIZE = ["--rows", "32", "--cols", "40"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with an exemplar and its heights."""
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(0)
    coarse = random.integers(0, 256, size=(8, 9, 3))
    Image.fromarray(np.kron(coarse, np.ones((3, 3, 1))).astype(np.uint8)).save("in.png")
    Image.fromarray(random.integers(0, 65536, size=(24, 27)).astype(np.uint16)).save("height.png")
    return tmp_path


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main.app, ["synth", *arguments])


def apply(*arguments: str) -> Result:
    return CliRunner().invoke(main.app, ["texture", "apply", *arguments])


def test_it_grows_and_tells(folder: Path) -> None:
    result = call("in.png", "-o", "out.png", *SIZE, "--seed", "7", "--map", "m.npz", "--method", "quilting")
    assert result.exit_code == 0, result.output
    for words in ("40 x 32 pixels", "quilting, seed 7", "of it is shown", "CIE76", "m.npz"):
        assert words in result.stdout
    assert "repeats" not in result.stdout
    assert "Growing the texture: done" in result.stderr


def test_brackets_in_names_are_shown(folder: Path) -> None:
    result = call("in.png", "-o", "[red]out.png", *SIZE, "--method", "quilting")
    assert result.exit_code == 0, result.output
    assert "[red]out.png" in result.stdout


def test_it_tells_programs(folder: Path) -> None:
    options = ["--layer", "height.png=a=b.png", "--map", "m.npz", "--preview", "p.jpg", "--toroidal", "--fast"]
    result = call("in.png", "-o", "out.tif", *SIZE, *options, "--threads", "1", "--json", "--method", "quilting")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert (report["output"], report["map"], report["layers"]) == ("out.tif", "m.npz", ["a=b.png"])
    assert (report["rows"], report["cols"], report["seed"], report["toroidal"]) == (32, 40, 0, True)
    assert (report["method"], report["complete"], report["notes"]) == ("quilting", True, [])
    source = load_source_map(Path("m.npz")).source
    assert_array_equal(read_layer(Path("out.tif")).pixels, read_layer(Path("in.png")).pixels.reshape(-1, 3)[source])
    assert_array_equal(read_layer(Path("a=b.png")).pixels, read_layer(Path("height.png")).pixels.reshape(-1, 1)[source])
    with Image.open("p.jpg") as picture:
        assert picture.size == (40, 32)
    applied = apply("m.npz", "height.png", "-o", "later.png", "--json")
    assert applied.exit_code == 0, applied.output
    assert json.loads(applied.stdout) == {
        "output": "later.png",
        "rows": 32,
        "cols": 40,
        "channels": 1,
        "kind": "uint16",
        "notes": [],
    }
    assert Path("later.png").read_bytes() == Path("a=b.png").read_bytes()
    told = apply("m.npz", "in.png", "-o", "later.tif")
    assert told.stdout.strip() == "later.tif: 40 x 32 pixels, 3 channels of uint8"


def test_the_seed_alone_decides(folder: Path) -> None:
    for name, seed, threads in (("a", "1", "1"), ("b", "1", "2"), ("c", "2", "1")):
        assert call("in.png", "-o", f"{name}.png", *SIZE, "--seed", seed, "--threads", threads).exit_code == 0
    a, b, c = (Path(f"{name}.png").read_bytes() for name in "abc")
    assert a == b
    assert a != c


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rows", "0", "--cols", "40"], "greater than or equal to 1"),
        (["--rows", "40", "--cols", "32769"], "less than or equal to 32768"),
        ([*SIZE, "--seed", "-1"], "--seed"),
        ([*SIZE, "--seed", str(2**63)], "--seed"),
        ([*SIZE, "--feature-px", "0"], "--feature-px"),
        ([*SIZE, "--layer", "height.png"], "write --layer IN=OUT"),
        ([*SIZE, "--layer", "=out.png"], "write --layer IN=OUT"),
        ([*SIZE, "--method", "magic"], "there is no method 'magic'; choose one of"),
        (["--rows", "32"], "--cols"),
    ],
)
def test_wrong_usage_is_explained(folder: Path, arguments: list[str], words: str) -> None:
    result = call("in.png", "-o", "out.png", *arguments)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.replace("│", " ").split())
    assert not Path("out.png").exists()


def test_methods_are_listed(folder: Path) -> None:
    result = call("in.png", "-o", "out.png", *SIZE, "--method", "")
    for name in METHODS:
        assert name in " ".join(result.stderr.replace("│", " ").split())


def test_what_cannot_be_read_is_explained(folder: Path) -> None:
    Path("bad.png").write_bytes(b"nothing")
    for name, words in (("none.png", "there is no such file"), ("bad.png", "not an image"), (".", "is a folder")):
        result = call(name, "-o", "out.png", *SIZE)
        assert isinstance(result.exception, ImageError)
        assert words in result.exception.message
        assert len(result.exception.message.splitlines()) == 1


def test_interrupted_it_writes_what_there_is_and_says_so(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method = METHODS["quilting"]

    def interrupted(request: Any, watch: Any) -> Any:
        asked: list[Any] = []

        def watching(step: Any) -> bool:
            if not asked:
                asked.append(step)
                os.kill(os.getpid(), signal.SIGINT)
                heard.wait(10)
            return bool(watch(step))

        return method(request, watching)

    heard = threading.Event()
    note = Bars.note

    def keep(self: Any, message: str) -> None:
        note(self, message)
        heard.set()

    monkeypatch.setattr(Bars, "note", keep)
    monkeypatch.setattr("tilefab.pipeline.growing.METHODS", {"quilting": interrupted})
    before = signal.getsignal(signal.SIGINT)
    result = call("in.png", "-o", "out.png", *SIZE, "--method", "quilting", "--map", "m.npz", "--json")
    assert result.exit_code == 130
    assert synth.STOPPING in " ".join(result.stderr.split())
    report = json.loads(result.stdout)
    assert not report["complete"]
    assert any("Stopped before" in note for note in report["notes"])
    source = load_source_map(Path("m.npz")).source
    assert_array_equal(read_layer(Path("out.png")).pixels, read_layer(Path("in.png")).pixels.reshape(-1, 3)[source])
    assert signal.getsignal(signal.SIGINT) is before


def test_interrupted_twice_the_process_ends_there_and_then(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[int] = []

    def left(work: Any, stop: Any) -> Any:
        raise KeyboardInterrupt

    def end(code: int) -> None:
        ended.append(code)
        raise StoppedEarly(code)

    monkeypatch.setattr(synth, "run_stoppable", left)
    monkeypatch.setattr(os, "_exit", end)
    result = call("in.png", "-o", "out.png", *SIZE, "--method", "quilting")
    assert ended == [130]
    assert "not everything was written" in result.stderr


def test_the_entry_point_adds_nothing_to_that(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def end() -> None:
        raise StoppedEarly(130)

    monkeypatch.setattr(main, "app", end)
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == ""


def test_asked_twice_it_ends_at_once() -> None:
    told: list[None] = []
    released = threading.Event()
    stop = Stop(lambda: told.append(None))

    def work() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        while not stop():
            time.sleep(0.001)
        os.kill(os.getpid(), signal.SIGINT)
        # A kernel that takes long: nobody waits for it.
        released.wait(30)

    with pytest.raises(KeyboardInterrupt):
        run_stoppable(work, stop)
    assert len(told) == 1
    released.set()


def test_a_signal_that_wakes_nobody_is_heard() -> None:
    stop = Stop(lambda: None)

    def work() -> bool:
        # Raised in this thread, it doesn't wake the one that waits, as one that comes just before the waiting.
        signal.raise_signal(signal.SIGINT)
        for _ in range(10_000):
            if stop():
                return True
            time.sleep(0.001)
        return False

    assert run_stoppable(work, stop)


def test_work_gives_its_result_and_its_errors() -> None:
    stop = Stop(lambda: None)
    assert run_stoppable(lambda: 42, stop) == 42
    assert not stop()

    def fail() -> None:
        raise TilefabError("as it happens")

    with pytest.raises(TilefabError, match="as it happens"):
        run_stoppable(fail, stop)


def test_in_a_thread_signals_are_left_alone() -> None:
    before = signal.getsignal(signal.SIGINT)
    results: list[int] = []
    thread = threading.Thread(target=lambda: results.append(run_stoppable(lambda: 1, Stop(lambda: None))))
    thread.start()
    thread.join()
    assert results == [1]
    assert signal.getsignal(signal.SIGINT) is before
