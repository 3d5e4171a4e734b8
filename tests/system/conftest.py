"""A workshop for whole jobs: a small made-up stone, job files with changes, and the command line in two ways."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from tilefab.cli.main import main

COMMAND = [sys.executable, "-c", "from tilefab.cli.main import main; main()"]

JOB = """\
schema_version = 1
[job]
name = "Workshop"
[slab]
scans = ["slab.tif"]
square = false
lighting = false
[texture]
crops = 64
seed = 7
[tile]
size_mm = [20, 24]
dpi = 60
count = 8
bleed_mm = 1
[colour]
press_profile = "demo_ceramic.icc"
ink_limit_percent = 260
[output]
directory = "out"
[report]
pdf = false
"""


TILE = ("crops = 64", 'design = "tile"\nmap_size_mm = [40, 44]\npatches = 40\nactive_per_cell = 9')
"""Change of the job that makes it one of a repeatable tile."""


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """What it printed, as JSON."""
        return json.loads(self.out)

    @property
    def errors(self) -> list[str]:
        """Its error lines, without their prefix."""
        return [line.removeprefix("error: ") for line in self.err.splitlines() if line.startswith("error: ")]


@dataclass(frozen=True)
class Workshop:
    """A folder with a scan and job files."""

    folder: Path

    def job(self, *changes: tuple[str, str], name: str = "job.toml") -> Path:
        """Write a job file: `JOB` with some of its text replaced."""
        text = JOB
        for old, new in changes:
            assert text.count(old) == 1, (old, text.count(old))
            text = text.replace(old, new)
        path = self.folder / name
        path.write_text(text)
        return path

    @property
    def out(self) -> Path:
        """Folder of the run."""
        return self.folder / "out"

    def cli(self, *arguments: object) -> Done:
        """Run a command in this process, exactly as the entry point does."""
        out, err = io.StringIO(), io.StringIO()
        argv, hook, sys.argv = sys.argv, sys.excepthook, ["tilefab", *map(str, arguments)]
        code: Any = 0
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                main()
        except SystemExit as end:
            code = end.code
        finally:
            sys.argv, sys.excepthook = argv, hook
        return Done(int(code or 0), out.getvalue(), err.getvalue())

    def start(self, *arguments: object, **options: Any) -> subprocess.Popen[str]:
        """Start a command as a process of its own."""
        return subprocess.Popen(
            [*COMMAND, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
            **options,
        )

    def process(self, *arguments: object, **options: Any) -> Done:
        """Run a command as a process of its own."""
        with self.start(*arguments, **options) as process:
            out, err = process.communicate(timeout=300)
        return Done(process.returncode, out, err)

    def lines(self, out: Path | None = None) -> list[dict[str, Any]]:
        """Lines of the manifest."""
        text = ((out or self.out) / "manifest.jsonl").read_text()
        assert text.endswith("\n")
        return [json.loads(line) for line in text.splitlines()]

    def hashes(self, out: Path | None = None) -> dict[int, str]:
        """Hash of each recorded face, after a look whether its file holds just these pixels."""
        found = {}
        for line in self.lines(out):
            pixels = tifffile.imread((out or self.out) / line["file"])
            assert pixels.shape == (line["rows"], line["cols"], line["channels"])
            assert str(pixels.dtype) == line["dtype"]
            assert hashlib.sha256(pixels.tobytes()).hexdigest() == line["sha256"]
            assert line["face"] not in found
            found[line["face"]] = line["sha256"]
        return found


def snapshot(folder: Path) -> dict[str, tuple[int, int, str]]:
    """Every file below a folder: inode, time of change and hash of its contents."""
    return {
        path.relative_to(folder).as_posix(): (
            path.stat().st_ino,
            path.stat().st_mtime_ns,
            hashlib.sha256(path.read_bytes()).hexdigest(),
        )
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def stone(rows: int, cols: int, seed: int = 1) -> NDArray[np.uint8]:
    """Made-up stone, from nearly black to nearly white, some of it colourful; (rows, cols, 3) sRGB."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (-(-rows // 8) + 1, -(-cols // 8) + 1, 3)).repeat(8, axis=0).repeat(8, axis=1)
    fine = random.integers(-20, 21, (rows, cols, 1))
    return np.clip(coarse[3 : rows + 3, 5 : cols + 5] + fine, 0, 255).astype(np.uint8)


def write_scan(path: Path, pixels: NDArray[Any], **options: Any) -> None:
    """Write a TIFF of 60 dpi."""
    settings = {"photometric": "rgb", "resolution": (60, 60), "resolutionunit": "INCH"} | options
    tifffile.imwrite(path, pixels, **settings)


def make_workshop(folder: Path) -> Workshop:
    folder.mkdir(parents=True, exist_ok=True)
    write_scan(folder / "slab.tif", stone(100, 110))
    workshop = Workshop(folder)
    workshop.job()
    return workshop


@pytest.fixture
def workshop(tmp_path: Path) -> Workshop:
    return make_workshop(tmp_path / "work")


@pytest.fixture(scope="session")
def finished_once(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    """A finished run with a report; only to be looked at."""
    workshop = make_workshop(tmp_path_factory.mktemp("finished") / "work")
    job = workshop.job(("pdf = false", 'pdf = "report.pdf"'))
    done = workshop.process("run", job, "--json")
    assert done.code == 0, done.err
    (workshop.folder / "result.json").write_text(done.out)
    return workshop


@pytest.fixture
def finished(finished_once: Workshop, tmp_path: Path) -> Workshop:
    """A copy of the finished run, times kept."""
    shutil.copytree(finished_once.folder, tmp_path / "work", copy_function=shutil.copy2)
    return Workshop(tmp_path / "work")


@pytest.fixture(scope="session")
def tile_design() -> tuple[str, str]:
    """Change of a job that makes it one of a repeatable tile with patches."""
    return TILE


@pytest.fixture(scope="session")
def new_workshop() -> Any:
    """Make a workshop in a folder."""
    return make_workshop


@pytest.fixture(scope="session")
def snap() -> Any:
    return snapshot


@pytest.fixture(scope="session")
def scanner() -> Any:
    """Write a scan: path, pixels, options of tifffile."""
    return write_scan


@pytest.fixture(scope="session")
def made_stone() -> Any:
    return stone
