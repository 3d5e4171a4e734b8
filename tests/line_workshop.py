"""A whole line for tests and benchmarks: a simulated plant as a process, daemons that can be killed, and a judge.

The plant is the real `tilefab-sim` on real sockets and ptys. Daemons are forked from a process that has everything
loaded, so that one can be killed and the next be at work within half a second.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from tilefab.colour.drift import no_drift
from tilefab.config import load_job
from tilefab.config.line import LineFile, load_line
from tilefab.control import line_machine as machine
from tilefab.control.ledger import ArmState
from tilefab.control.line_machine import LineState
from tilefab.errors import InterlockError
from tilefab.io.drift_file import DriftFile, drift_text, parse_drift
from tilefab.io.journal import ArmRecord, Journal
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.line.correction_maps import CorrectionMaps
from tilefab.pipeline.line.daemon import LineDaemon
from tilefab.pipeline.line.jobs import LineJob, line_job
from tilefab.pipeline.line.source import FaceSource, open_source
from tilefab.pipeline.plan import Plan, plan_job
from tilefab.pipeline.progress import Silent
from tilefab.sampling import TextureMap

JOB = """\
schema_version = 1
[job]
name = "{name}"
[slab]
scans = ["slab.tif"]
square = false
lighting = false
[texture]
crops = 64
seed = {seed}
[tile]
size_mm = [{width}, {length}]
dpi = {dpi}
count = {count}
bleed_mm = 1
[colour]
press_profile = "demo_ceramic.icc"
ink_limit_percent = 260
[output]
directory = "{name}"
[report]
pdf = false
[line]
recipe = "{recipe}"
"""

LINE = """\
[line]
name = "workshop"
state_directory = "state"
stream_strip_rows = 16
run_out_mm = {run_out}
[plc]
endpoint = "{plc}"
[printer]
control = "{printer_control}"
data = "{printer_data}"
{more}
[recipes.default]
belt_speed_mm_s = {speed}
tile_gap_mm = 40.0
"""

PLANT = """\
keep_tiles = 50000
[clock]
rate = {rate}
[printer]
control = "pty:printer"
verify = "sha256"
boot_seconds = 0.15
[plc]
rtu = "pty:plc"
boot_seconds = 0.15
[gauge]
pty = "pty:gauge"
"""


def write_slab(folder: Path) -> None:
    """A small made-up stone."""
    random = np.random.default_rng(1)
    coarse = random.integers(0, 256, (13, 15, 3)).repeat(8, axis=0).repeat(8, axis=1)
    pixels = np.clip(coarse + random.integers(-20, 21, (*coarse.shape[:2], 1)), 0, 255).astype(np.uint8)
    tifffile.imwrite(folder / "slab.tif", pixels, photometric="rgb", resolution=(60, 60), resolutionunit="INCH")


def write_job(folder: Path, *, name: str = "job", **changes: Any) -> Path:
    """Write a job file; see `JOB` for what may be changed."""
    facts = {"seed": 7, "width": 60, "length": 64, "dpi": 30, "count": 20, "recipe": "default"} | changes
    path = folder / f"{name}.toml"
    path.write_text(JOB.format(name=name, **facts))
    return path


def write_line(
    folder: Path,
    endpoints: Mapping[str, str],
    *,
    rtu: bool = False,
    speed: float = 200.0,
    run_out_mm: float = 0.0,
    more: str = "",
) -> Path:
    """Write the line's file for a plant; without a run-out the last tiles stay on the belt before the kiln."""
    path = folder / "line.toml"
    plc = endpoints["plc_rtu" if rtu else "plc_tcp"]
    names = {name: endpoints[name] for name in ("printer_control", "printer_data")}
    path.write_text(LINE.format(plc=plc, speed=speed, run_out=run_out_mm, more=more, **names))
    return path


class PlantProcess:
    """A running `tilefab-sim`, and its control port."""

    def __init__(self, folder: Path, *, rate: float = 60.0, plant: str = PLANT) -> None:
        file = folder / "plant.toml"
        file.write_text(plant.format(rate=rate))
        self.folder = folder
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from sim.plant.main import main; main()", str(file)],
            stdout=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the simulator didn't start")
        self.endpoints: dict[str, str] = json.loads(line)
        host, _, port = self.endpoints["control"].removeprefix("tcp://").rpartition(":")
        self._socket = socket.create_connection((host, int(port)))
        self._lines = self._socket.makefile("r")

    def do(self, what: str, **arguments: Any) -> dict[str, Any]:
        """Carry out a command of the control port."""
        self._socket.sendall((json.dumps({"do": what, **arguments}) + "\n").encode())
        reply: dict[str, Any] = json.loads(self._lines.readline())
        if "error" in reply:
            raise ValueError(reply["error"])
        return reply

    def fault(self, device: str, kind: str, **arguments: Any) -> None:
        """Set a fault."""
        self.do("fault", device=device, kind=kind, **arguments)

    def close(self) -> None:
        """End it."""
        self._lines.close()
        self._socket.close()
        self._process.terminate()
        self._process.communicate()

    @property
    def pid(self) -> int:
        """Its process."""
        return self._process.pid


@contextlib.contextmanager
def plant_process(folder: Path, **options: Any) -> Iterator[PlantProcess]:
    """Run a plant for as long as the block lasts."""
    plant = PlantProcess(folder, **options)
    try:
        yield plant
    finally:
        plant.close()


@dataclass
class Workplace:
    """A line with its job loaded, to fork daemons from.

    Attributes
    ----------
    line
        The line's file.
    job
        Its job.
    source
        The job's faces.
    maps
        Where maps of corrections come from; without any, eager operators don't correct.
    """

    line: LineFile
    job: LineJob
    source: FaceSource
    daemons: int = 0
    maps: CorrectionMaps | None = None

    @classmethod
    def open(cls, job_path: Path, line_path: Path) -> Workplace:
        """Load everything a daemon needs."""
        line = load_line(line_path)
        line.state_directory.mkdir(exist_ok=True)
        job = line_job(plan_job(load_job(job_path)), line)
        source = open_source(job.plan, Silent(), line.line.line.stream_strip_rows)
        source.checksum(0)
        return cls(line, job, source)

    def more(self, faces: int) -> Workplace:
        """The same line, with a job of so many more faces than its file has now."""
        path = self.job.plan.job_file.path
        before, count, after = re.split(r"(?<=\ncount = )(\d+)(?=\n)", path.read_text())
        path.write_text(f"{before}{int(count) + faces}{after}")
        return replace(self, job=line_job(plan_job(load_job(path)), self.line))

    def fork(
        self,
        probe: Callable[[str], None],
        *,
        log: Path | None = None,
        around: Callable[[Callable[[], int]], int] = lambda work: work(),
    ) -> int:
        """Start a daemon and an eager operator in a process of their own, within ``around``; gives its number."""
        self.daemons += 1
        pid = os.fork()
        if pid:
            return pid
        code = 70
        try:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            code = around(lambda: asyncio.run(eager_operator(self, probe, log)))
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(code)

    def journal(self) -> Journal:
        """The journal, to look into."""
        return Journal.look(self.line.journal_url, line=self.line.name)


class QuickMaps:
    """Maps of corrections that are made at once: the job's own, with each count of ink changed in a way of its own."""

    def __init__(self, own: TextureMap) -> None:
        self.own = own
        self.made: list[str] = []

    async def make(self, plan: Plan) -> None:
        await asyncio.sleep(0)
        self.made.append(plan.press_key)

    def load(self, plan: Plan, texture_hash: str) -> TextureMap:
        assert self.own.provenance["press_key"].endswith(f" {texture_hash}")
        mask = int(plan.press_key[:2], 16) | 1
        return self.own.with_base(self.own.base ^ self.own.base.dtype.type(mask), self.own.space, self.own.channels)

    def forget(self, plan: Plan) -> None:
        pass

    def tidy(self, plan: Plan, in_use: Collection[str], keep_s: float) -> None:
        pass


def made_up_drift(plan: Plan, number: int) -> dict[str, Any]:
    """A drift state of a job's press; each number has another."""
    state = no_drift(plan.press_profile.channels)
    state = replace(state, mean=state.mean + number / 4096)
    profile = plan.press_profile
    drift: dict[str, Any] = json.loads(drift_text(DriftFile(state, profile.ink_names, profile.sha256, number)))
    return drift


STOPPED, STUCK = 0, 3


async def eager_operator(place: Workplace, probe: Callable[[str], None], log: Path | None = None) -> int:
    """Run a daemon with an operator who starts, acknowledges and resumes at once; returns once the line is stopped."""

    def tell(kind: str, **facts: object) -> None:
        if log is not None:
            with log.open("a") as file:
                file.write(f"{time.monotonic():.3f} {os.getpid()} {kind} {facts}\n")

    daemon = LineDaemon(
        place.line,
        [place.job],
        probe=probe,
        log=tell,
        open_source=lambda _job, _rows: place.source,
        correction_maps=place.maps,
    )
    running = asyncio.create_task(daemon.run())
    beside = [asyncio.create_task(_correct_often(place, daemon))] if place.maps is not None else []
    code = STUCK
    deadline = time.monotonic() + 120
    while not running.done() and time.monotonic() < deadline:
        await asyncio.sleep(0.01)
        state = daemon.line.state
        if state in (LineState.STOPPED, LineState.HOLDING) and not daemon.jobs:
            code = STOPPED
            break
        # An emergency stop that was acknowledged before its button was out has to be acknowledged again.
        if (daemon.line.unacked or state is LineState.E_STOPPED) and state not in (
            LineState.RUNNING,
            LineState.DRAINING,
            LineState.ARMING,
        ):
            daemon.post(machine.OperatorAck(daemon.line.raised))
        for order in (machine.OperatorStart(), machine.OperatorResume()):
            if not machine.refusal(daemon.line, order):
                daemon.post(order)
    for task in beside:
        task.cancel()
    await asyncio.gather(*beside, return_exceptions=True)
    daemon.stopping.set()
    await running
    return code


async def _correct_often(place: Workplace, daemon: LineDaemon) -> None:
    """Correct the present run again and again, whatever the line is doing."""
    while True:
        await asyncio.sleep(0.06)
        if daemon.book is None:
            continue
        number = daemon.work.correction.number + 1 if daemon.work.correction is not None else 1
        with contextlib.suppress(InterlockError):
            await daemon.corrector.correct(
                daemon.book.run_id, made_up_drift(place.job.plan, number), f"attempt {number}"
            )


def kill_at(step: str, count: int) -> Callable[[str], None]:
    """A probe that kills its own process, beyond any cleaning up, when a step is reached for the n-th time."""
    left = [count]

    def probe(name: str) -> None:
        if name == step:
            left[0] -= 1
            if left[0] <= 0:
                os.kill(os.getpid(), signal.SIGKILL)

    return probe


def wait_for(pid: int) -> int:
    """Wait for a process; its exit code, or minus the signal that ended it."""
    _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status)


def wait_or_kill(pid: int, seconds: float) -> int:
    """Wait for a process, and kill it beyond any cleaning up if it still runs after some time; as `wait_for`."""
    handle = os.pidfd_open(pid)
    try:
        if not select.select([handle], [], [], seconds)[0]:
            os.kill(pid, signal.SIGKILL)
    finally:
        os.close(handle)
    return wait_for(pid)


@dataclass
class Judgement:
    """What the plant's truth says of the journal.

    Attributes
    ----------
    wrong
        Everything that must not be.
    faces
        Faces by what the journal has them last as.
    """

    wrong: list[str] = field(default_factory=list)
    faces: Counter[str] = field(default_factory=Counter)


def judge(
    plant: PlantProcess,
    place: Workplace,
    *,
    finished: bool = True,
    check_pixels: int = 0,
    others: Sequence[tuple[LineJob, FaceSource]] = (),
) -> Judgement:
    """Hold the journal against what the plant saw with its own eyes.

    No face may be lost (neither printed, nor to come, nor told of), doubled (any row of it on two tiles), silently
    skipped, passed in part, or recorded as passed when it didn't. ``check_pixels`` faces are compared with what the job
    renders. Where the line printed ``others``, too, they are judged with it.
    """
    found = Judgement()
    truth = plant.do("truth")
    _judge_plant(found, truth, one_job=not others)
    with contextlib.closing(place.journal()) as journal:
        arms = {arm.arm_id: arm for arm in journal.arms()}
        runs = {run.facts.job_hash: run.run_id for run in journal.runs()}
        latest = {run.run_id: run.correction for run in journal.runs()}
    prints: dict[tuple[int, int], list[tuple[dict[str, Any], dict[str, Any]]]] = {}
    for tile in truth["tiles"]:
        for made in tile["prints"]:
            arm = arms.get(made["arm"])
            if arm is None or arm.face != made["face"]:
                found.wrong.append(
                    f"face {made['face']} was printed as arm {made['arm']}, the journal never heard of it"
                )
                continue
            prints.setdefault((arm.run_id, arm.face), []).append((tile, made))
    last = {(arm.run_id, arm.face): arm for arm in arms.values()}
    _judge_corrections(found, list(arms.values()), latest)
    for job, source in ((place.job, place.source), *others):
        run_id = runs.get(job.plan.job_hash, -1)
        for face in range(job.plan.job.tile.count if finished else 0):
            _judge_end(found, f"face {face} of {job.plan.name}", last.get((run_id, face)))
        complete = [
            (face, one)
            for (run, face), made in sorted(prints.items(), key=lambda item: item[0])
            for _, one in made
            if run == run_id and one["complete"]
        ]
        for face, one in complete[:: max(1, len(complete) // check_pixels)] if check_pixels else []:
            correction = arms[one["arm"]].correction
            digest = hashlib.sha256()
            for strip in corrected_source(place, job, source, run_id, correction).strips(
                source.prepare(face), correction=correction
            ):
                digest.update(strip.pixels.data)
            if digest.hexdigest() != one["sha256"]:
                found.wrong.append(
                    f"face {face} of {job.plan.name} was printed with other pixels than correction {correction} gives"
                )
    for key, arm in last.items():
        _judge_face(found, f"face {arm.face} of run {arm.run_id}", arm, prints.get(key, []))
    return found


def corrected_source(place: Workplace, job: LineJob, source: FaceSource, run_id: int, correction: int) -> FaceSource:
    """A job's faces, with a correction of a run among them as the journal has it."""
    if correction and correction not in source.corrections:
        assert place.maps is not None
        with contextlib.closing(place.journal()) as journal:
            (record,) = journal.corrections(run_id, [correction])
        plan = corrected_plan(job.plan, *parse_drift(record.drift.encode(), f"correction {correction}"))
        assert plan.press_key == record.press_key
        source.put(correction, place.maps.load(plan, source.maps.texture.hash))
    return source


_PASSED = ("passed", "in_kiln", "fired", "broken")


def _judge_plant(found: Judgement, truth: dict[str, Any], *, one_job: bool) -> None:
    """What must not be whatever the journal says."""
    for tile in truth["tiles"]:
        if len(tile["prints"]) > 1:
            found.wrong.append(f"tile {tile['id']} was printed {len(tile['prints'])} times")
        if tile["fate"] not in _PASSED:
            continue
        if not tile["prints"]:
            found.wrong.append(f"tile {tile['id']} passed blank")
        if any(not made["complete"] for made in tile["prints"]):
            found.wrong.append(f"tile {tile['id']} passed with a part of a face")
        if any(abs(made["centre_mm"]) > 1.0 for made in tile["prints"] if made["centre_mm"] is not None):
            found.wrong.append(f"tile {tile['id']} passed with a face beside its place")
    summary = truth["summary"]
    # Jobs have faces of the same numbers, which the plant can't tell apart.
    for name in (
        *(("faces_twice",) if one_job else ()),
        "tiles_twice",
        "prints_beside",
        "passed_blank",
        "passed_spoilt",
    ):
        if summary[name]:
            found.wrong.append(f"{name}: {summary[name]} {summary['twice'][:5] if name == 'faces_twice' else ''}")


def _judge_corrections(found: Judgement, arms: Sequence[ArmRecord], latest: Mapping[int, int]) -> None:
    """Arms follow each other with the same correction or a later one, and with none that the journal doesn't have."""
    before: dict[int, int] = {}
    for arm in arms:
        if not before.get(arm.run_id, 0) <= arm.correction <= latest[arm.run_id]:
            found.wrong.append(
                f"arm {arm.arm_id} is of correction {arm.correction}, after {before.get(arm.run_id, 0)} and with "
                f"{latest[arm.run_id]} in the journal"
            )
        before[arm.run_id] = arm.correction


def _judge_end(found: Judgement, name: str, arm: ArmRecord | None) -> None:
    """What must not be of a face once its job has ended."""
    if arm is None:
        found.wrong.append(f"{name} is lost: the journal has never heard of it")
        return
    found.faces[arm.state.value] += 1
    if arm.state in (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED, ArmState.UNPRINTED):
        found.wrong.append(f"{name} is still {arm.state} at the end")


def _judge_face(found: Judgement, name: str, arm: ArmRecord, made: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    """What must not be of a face at any time."""
    passed = [one for tile, one in made if tile["fate"] in _PASSED]
    if len(made) > 1:
        found.wrong.append(f"{name} is doubled: it was printed on {len(made)} tiles")
    if arm.state is ArmState.PASSED and (len(passed) != 1 or not passed[0]["complete"]):
        found.wrong.append(f"{name} is recorded as passed, the plant passed {len(passed)} of it")
    if arm.state in (ArmState.DIVERTED, ArmState.PARTIAL) and passed:
        found.wrong.append(f"{name} is recorded as {arm.state}, but passed")
    if arm.state is ArmState.UNPRINTED and made:
        found.wrong.append(f"{name} is recorded as unprinted, but was printed")
