"""A line at work for weeks of the plant's time, with everything that may befall it; `benchmarks/line_month.py` runs it.

The daemon, with an operator in its process (`tests.line_operator`), is forked and never started anew; the plant is a
`tilefab-sim` of its own. Faults come as `tests.line_fate` has them, and `tests.line_witness` looks on.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

from tests.line_fate import Fate
from tests.line_operator import STOPPED, Operator
from tests.line_witness import Witness
from tests.line_workshop import PlantProcess, plant_process, wait_for, wait_or_kill, write_job, write_slab
from tilefab.config import load_job
from tilefab.config.line import LineFile, load_line
from tilefab.io.journal import Journal
from tilefab.pipeline.line.jobs import line_job
from tilefab.pipeline.line.source import FaceSource, open_source
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Silent

HOUR_S = 3600.0
_PAGE = os.sysconf("SC_PAGE_SIZE")
_TURN_S = 0.02
_LOOK_EVERY_S = 1.0
_STUCK_S = 120.0
_FINISH_S = 300.0
_TELL_EVERY = 24
_CHECK_PIXELS_EVERY = 50
_WARM_DEGC = (28.0, 29.0)

PLANT = """\
keep_tiles = 2000
truth_file = "truth.jsonl"
[clock]
rate = {rate}
[loader]
jitter_mm = 5
length_jitter_mm = 0.2
seed = 3
[printer]
control = "pty:printer"
boot_seconds = 0.15
[plc]
boot_seconds = 0.15
[kiln]
shuffle_minutes = 5
break_rate = 0.01
start_degc = 28
boot_seconds = 0.15
[gauge]
pty = "pty:gauge"
boot_seconds = 0.15
"""

LINE = """\
[line]
name = "month"
state_directory = "state"
stream_strip_rows = 16
[plc]
endpoint = "{plc_tcp}"
[kiln]
endpoint = "{kiln}"
ramp_degc_min = 15
[gauge]
endpoint = "{gauge}"
[printer]
control = "{printer_control}"
data = "{printer_data}"
"""

RECIPE = """\
[recipes.{name}]
belt_speed_mm_s = {speed}
tile_gap_mm = {gap}
kiln_set_points_degc = {set_points}
cycle_min = {cycle}
"""


@dataclass(frozen=True)
class Sample:
    """Memory and descriptors of a process at a time of the plant's.

    Attributes
    ----------
    hour
        Since the start.
    resident
        Bytes, by process.
    descriptors
        By process.
    """

    hour: float
    resident: dict[str, int]
    descriptors: dict[str, int]


@dataclass
class Month:
    """What came of it.

    Attributes
    ----------
    hours
        Of the plant's time.
    wall_s
        Time it took.
    wrong
        Invariants that broke.
    samples
        Memory and descriptors.
    struck
        Faults set, by kind.
    messages_struck
        Messages that they struck.
    told
        The operator's last report.
    summary
        The plant's counts.
    faces
        Settled arms by state.
    checksums
        Faces that were rendered again and compared.
    """

    hours: float = 0.0
    wall_s: float = 0.0
    wrong: list[str] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    struck: dict[str, int] = field(default_factory=dict)
    messages_struck: int = 0
    told: dict[str, Any] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)
    faces: dict[str, int] = field(default_factory=dict)
    checksums: int = 0


@dataclass(frozen=True)
class Terms:
    """How a month is to be.

    Attributes
    ----------
    hours
        Of the plant's time.
    rate
        Plant seconds a wall second.
    lot
        Faces that a job grows by each time.
    fault_every_s
        Mean wall time between two faults.
    seed
        Of faults and operator.
    samples
        Most samples of memory; by default one an hour of the plant's.
    """

    hours: float
    rate: float = 1000.0
    lot: int = 120
    fault_every_s: float = 3.0
    seed: int = 1
    samples: int | None = None

    @property
    def speed_mm_s(self) -> float:
        """Speed of the belt: 6 m/s of wall time, so that the eye is 430 ms before the head, and that 330 ms before the
        diverter, on the wall's clock, which the daemon's deadlines are on."""
        return min(round(6000 / self.rate, 1), 3000.0)

    @property
    def sample_every_h(self) -> float:
        """Plant hours from one sample to the next."""
        return 1.0 if self.samples is None else self.hours / self.samples


def live(folder: Path, terms: Terms, told: Callable[[str], None] = lambda _: None) -> Month:
    """Run a line for as long as the terms have it.

    Parameters
    ----------
    folder
        Of job, line and plant.
    terms
        How it is to be.
    told
        Told of progress, in lines.
    """
    write_slab(folder)
    with plant_process(folder, rate=terms.rate, plant=PLANT) as plant:
        line, jobs = _write_files(folder, plant, terms)
        sources = {path.stem: _open(path, line) for path in jobs}
        line.state_directory.mkdir(exist_ok=True)
        daemon = Daemon(line, jobs, terms)
        try:
            with contextlib.closing(_look_into(line, daemon)) as journal, (folder / "faults.log").open("w") as log:
                return _look_on(plant, journal, sources, terms, daemon, log, told)
        finally:
            daemon.close()


def _look_into(line: LineFile, daemon: Daemon) -> Journal:
    """The journal, as soon as the line runs for the first time."""
    deadline = time.monotonic() + _STUCK_S
    while not daemon.read()["seen"].get("running"):
        if daemon.ended or time.monotonic() > deadline:
            raise RuntimeError(f"the line didn't start: {daemon.latest}")
        time.sleep(_TURN_S)
    return Journal.look(line.journal_url, line=line.name)


def _write_files(folder: Path, plant: PlantProcess, terms: Terms) -> tuple[LineFile, list[Path]]:
    """The line, and three jobs of different tiles, two of which need the kiln at another temperature than the third."""
    text = LINE.format(**plant.endpoints)
    jobs: list[Path] = []
    for name, length, gap, degc, cycle in (
        ("small", 64, 330.0, _WARM_DEGC[0], 40.0),
        ("middle", 90, 320.0, _WARM_DEGC[0], 45.0),
        ("large", 120, 300.0, _WARM_DEGC[1], 50.0),
    ):
        text += RECIPE.format(name=name, speed=terms.speed_mm_s, gap=gap, set_points=[degc] * 8, cycle=cycle)
        jobs.append(write_job(folder, name=name, length=length, count=terms.lot, recipe=name, seed=len(jobs) + 1))
    path = folder / "line.toml"
    path.write_text(text)
    return load_line(path), jobs


def _open(path: Path, line: LineFile) -> FaceSource:
    """Faces of a job; its maps are made now, so that the daemon finds them."""
    job = line_job(plan_job(load_job(path)), line)
    return open_source(job.plan, Silent(), line.line.line.stream_strip_rows)


class Daemon:
    """A forked daemon with its operator, and what he reports."""

    def __init__(self, line: LineFile, jobs: list[Path], terms: Terms) -> None:
        self._reports, report = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            code = 70
            try:
                os.close(self._reports)
                signal.signal(signal.SIGINT, signal.SIG_IGN)
                code = asyncio.run(Operator(line, jobs, terms.lot, report, terms.seed).work())
            except BaseException:
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        os.close(report)
        os.set_blocking(self._reports, False)
        self._rest = b""
        self._code: int | None = None
        self.latest: dict[str, Any] = {"state": "idle", "since_s": 0.0, "seen": {}, "wrong": []}

    def read(self) -> dict[str, Any]:
        """The newest report."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._reports, 1 << 16):
                *whole, self._rest = (self._rest + data).split(b"\n")
                if whole:
                    self.latest = json.loads(whole[-1])
        return self.latest

    @property
    def ended(self) -> bool:
        """Whether it ended by itself."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code is not None

    def finish(self) -> int:
        """Let it bring its jobs to an end; its exit code."""
        if not self.ended:
            os.kill(self.pid, signal.SIGUSR1)
            self._code = wait_or_kill(self.pid, _FINISH_S)
        assert self._code is not None
        return self._code

    def close(self) -> None:
        """End it, if it still runs."""
        if not self.ended:
            os.kill(self.pid, signal.SIGKILL)
            self._code = wait_for(self.pid)
        os.close(self._reports)


def _look_on(
    plant: PlantProcess,
    journal: Journal,
    sources: Mapping[str, FaceSource],
    terms: Terms,
    daemon: Daemon,
    log: TextIO,
    told: Callable[[str], None],
) -> Month:
    month, fate = Month(), Fate(plant, random.Random(terms.seed), terms.fault_every_s, log)
    witness = Witness(journal, plant, lambda name, face: sources[name].checksum(face), check_every=_CHECK_PIXELS_EVERY)
    processes = {"daemon": daemon.pid, "simulator": plant.pid, "witness": os.getpid()}
    began = next_look = time.monotonic()
    next_sample = 0.0
    while month.hours < terms.hours:
        time.sleep(_TURN_S)
        now = time.monotonic()
        month.hours = (now - began) * terms.rate / HOUR_S
        fate.pass_by(now)
        latest = daemon.read()
        if now >= next_look:
            next_look = now + _LOOK_EVERY_S
            witness.look()
        if daemon.ended:
            month.wrong.append("the daemon ended by itself")
            break
        if latest["since_s"] > _STUCK_S:
            month.wrong.append(f"the line is stuck: {latest}")
            break
        if month.hours >= next_sample:
            next_sample += terms.sample_every_h
            month.samples.append(_sample(month.hours, processes))
            if len(month.samples) % _TELL_EVERY == 1:
                told(_progress(month, fate, witness, latest))
    fate.rest()
    if not month.wrong:
        code = daemon.finish()
        witness.look(finished=True)
        if code != STOPPED:
            month.wrong.append(f"the daemon ended with {code} at the end: {daemon.read()}")
    month.wall_s = time.monotonic() - began
    month.told = daemon.read()
    month.wrong += [*witness.wrong, *fate.wrong, *month.told["wrong"]]
    month.struck = dict(fate.struck)
    month.faces = {state.value: many for state, many in witness.faces.items()}
    month.messages_struck = sum(plant.do("state")["faults_struck"].values())
    month.checksums = witness.checksums
    month.summary = plant.do("truth", summary=True)["summary"]
    return month


def _progress(month: Month, fate: Fate, witness: Witness, latest: Mapping[str, Any]) -> str:
    sample = month.samples[-1]
    memory = ", ".join(
        f"{name} {sample.resident[name] / 1e6:.1f} MB {sample.descriptors[name]} open" for name in sample.resident
    )
    faces = ", ".join(f"{many} {state.value}" for state, many in sorted(witness.faces.items()))
    wrong = len(witness.wrong) + len(fate.wrong) + len(latest["wrong"])
    return (
        f"hour {month.hours:6.1f}: {memory}; faults {sum(fate.struck.values())}; faces: {faces}; "
        f"line {latest['state']}; wrong {wrong}"
    )


def _sample(hour: float, processes: Mapping[str, int]) -> Sample:
    return Sample(
        hour,
        {name: int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE for name, pid in processes.items()},
        {name: len(list(Path(f"/proc/{pid}/fd").iterdir())) for name, pid in processes.items()},
    )
