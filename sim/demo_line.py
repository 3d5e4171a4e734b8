"""The whole loop, live: ``python -m sim.demo_line`` (or ``make demo-line``).

A simulated line prints a job sixty times as fast as a real one. Once the first tiles have left the kiln, the kiln
starts to drift. The inspector recognises each fired tile by its pattern, measures it against its own face, and has the
colours of the tiles still to come corrected. In the end the manager's report is written. Everything runs as on a real
line: daemon, inspector and commands are processes of their own and know nothing of the simulation; only this script,
which plays the operator and the kiln's bad day, talks to both.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
JOB, LINE, PLANT = (ROOT / "jobs" / name for name in ("demo_line.toml", "demo_line_line.toml", "demo_plant.toml"))
OUT = ROOT / "out" / "demo_line"

HOTTER_ZONES, HOTTER_DEGC = (4, 5), 40.0
LONGER_AND_DRIER = {"soak": 6.0, "moisture": -1.0}
"""The kiln's bad day: both zones of the firing are too hot, tiles stay longer, and their bodies come drier."""

_DRIFT_AFTER_MIN = 50.0
_DRIFT_WITHIN_MIN = 10.0
_LOOK_S = 15.0
_UP_WITHIN_S = 120.0
_QUIET_S = 12.0
_MOST_WALL_S = 1200.0
_RECENT = 12
_BAR_DELTA_E, _BAR_LENGTH = 0.1, 50
_STANDING = ("holding", "faulted")
_MARK = "made by make demo-line"


@dataclass(frozen=True)
class Look:
    """What the line shows at a moment.

    Attributes
    ----------
    state
        Of the line.
    printed, inspected
        Tiles so far.
    delta_e
        Mean CIEDE2000 of the latest tiles from their own faces; ``None`` before there are any.
    corrections
        Made so far.
    """

    state: str
    printed: int
    inspected: int
    delta_e: float | None
    corrections: int


class Plant:
    """The simulated plant's control port."""

    def __init__(self, endpoint: str) -> None:
        host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
        self._socket = socket.create_connection((host, int(port)), timeout=30)
        self._lines = self._socket.makefile("r")

    def do(self, what: str, **arguments: Any) -> dict[str, Any]:
        """Carry out a command.

        Raises
        ------
        RuntimeError
            If the plant refuses it.
        """
        self._socket.sendall((json.dumps({"do": what, **arguments}) + "\n").encode())
        reply: dict[str, Any] = json.loads(self._lines.readline())
        if not reply.get("ok"):
            raise RuntimeError(f"the plant refused {what}: {reply.get('error')}")
        return reply

    @property
    def minutes(self) -> float:
        """Its clock."""
        return float(self.do("state")["time"]) / 60.0


@contextmanager
def running(name: str, *command: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of the line, its output in a file, ended with the block."""
    with (OUT / f"{name}.log").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def tilefab(*arguments: str) -> str:
    """What a command of tilefab prints.

    Raises
    ------
    RuntimeError
        If it fails.
    """
    done = subprocess.run([program("tilefab"), *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"tilefab {' '.join(arguments)} ended with {done.returncode}: {done.stderr.strip()}")
    return done.stdout


def program(name: str) -> str:
    """A program of this environment."""
    return str(Path(sys.executable).with_name(name))


def main() -> int:
    """Run it; 0 if the drift was caught."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-correction", action="store_true", help="let the inspector look on, to see the difference")
    arguments = parser.parse_args()
    fresh_folder()
    line = line_file(correct=not arguments.no_correction)
    say("Making the texture map of jobs/demo_line.toml ...")
    tilefab("map", "build", str(JOB))
    with ExitStack() as stack:
        stack.enter_context(running("plant", program("tilefab-sim"), str(PLANT)))
        plant = Plant(endpoints()["control"])
        stack.enter_context(running("daemon", program("tilefab"), "line", "run", str(JOB), str(line)))
        stack.enter_context(running("inspector", program("tilefab"), "line", "inspect", str(line)))
        wait_until_up(line)
        tilefab("line", "start", "--line", str(line))
        before, worst, last = watch(plant, line)
        say("Writing the report ...")
    tilefab("line", "report", str(line), "-o", str(OUT / "report.pdf"))
    return verdict(before, worst, last, corrected=not arguments.no_correction)


def fresh_folder() -> None:
    """Begin with an empty folder; one that something else made is left alone.

    Raises
    ------
    SystemExit
        If there is such a one.
    """
    mark = OUT / ".demo"
    if OUT.exists() and not mark.exists():
        raise SystemExit(f"{OUT} wasn't made by this demo: move it away")
    shutil.rmtree(OUT, ignore_errors=True)
    (OUT / "camera").mkdir(parents=True)
    mark.write_text(_MARK)


def line_file(*, correct: bool) -> Path:
    """The line's file; another one where corrections are left out."""
    if correct:
        return LINE
    path = OUT / "line_open.toml"
    text = LINE.read_text().replace("[inspection]", "[inspection]\ncorrect = false").replace("../out/demo_line/", "")
    path.write_text(text)
    return path


def endpoints() -> dict[str, str]:
    """Addresses of the plant, once it is up."""
    path = OUT / "plant" / "endpoints.json"
    deadline = time.monotonic() + _UP_WITHIN_S
    while time.monotonic() < deadline:
        if path.exists():
            found: dict[str, str] = json.loads(path.read_text())
            return found
        time.sleep(0.2)
    raise RuntimeError(f"the plant didn't start: see {OUT / 'plant.log'}")


def wait_until_up(line: Path) -> None:
    """Wait until the daemon answers."""
    deadline = time.monotonic() + _UP_WITHIN_S
    while time.monotonic() < deadline:
        try:
            tilefab("line", "status", "--json", "--line", str(line))
            return
        except RuntimeError:
            time.sleep(0.5)
    raise RuntimeError(f"the daemon didn't start: see {OUT / 'daemon.log'}")


def watch(plant: Plant, line: Path) -> tuple[float, float, float]:
    """Show the line until all tiles are through; mean differences before the drift, at its worst, and at the end."""
    say("")
    say("  plant    line      printed  inspected  corrections  mean ΔE00 of the latest tiles from their own faces")
    began, drifting, quiet = plant.minutes, False, 0.0
    before, worst, last = 0.0, 0.0, 0.0
    deadline = time.monotonic() + _MOST_WALL_S
    while time.monotonic() < deadline:
        look = look_at(line)
        minutes = plant.minutes - began
        bar = "" if look.delta_e is None else "#" * min(_BAR_LENGTH, round(look.delta_e / _BAR_DELTA_E))
        shown = "" if look.delta_e is None else f"{look.delta_e:5.2f}  {bar}"
        tiles = f"{look.printed:7d} {look.inspected:10d} {look.corrections:12d}"
        say(f"{minutes:4.0f} min   {look.state:<9} {tiles}  {shown}")
        if look.delta_e is not None:
            last = look.delta_e
            worst = max(worst, last) if drifting else worst
        if look.state in _STANDING:
            take_up(look.state, line)
        if not drifting and minutes >= _DRIFT_AFTER_MIN and look.delta_e is not None:
            before, drifting = look.delta_e, True
            spoil(plant)
            say(f"            the kiln begins to drift: firing zones {HOTTER_DEGC:+g} K, longer, drier")
        quiet = quiet + _LOOK_S if look.state == "stopped" and all_seen(plant) else 0.0
        if quiet >= _QUIET_S:
            return before, worst, last
        time.sleep(_LOOK_S)
    raise RuntimeError(f"the line didn't come to an end: see {OUT / 'daemon.log'} and {OUT / 'inspector.log'}")


def take_up(state: str, line: Path) -> None:
    """Do what an operator does with a line that holds: acknowledge, and go on.

    At sixty times its pace a busy computer can be too slow for the devices' time limits; a line holds then, and loses
    nothing.
    """
    say(f"            the line is {state}: acknowledged, going on")
    for order in ("ack", "resume" if state == "holding" else "start"):
        try:
            tilefab("line", order, "--line", str(line))
        except RuntimeError as refused:
            say(f"            {refused}")


def spoil(plant: Plant) -> None:
    """Let the kiln drift."""
    for zone in HOTTER_ZONES:
        plant.do("fault", device="kiln", kind="zone_drift", zone=zone, degc=HOTTER_DEGC, minutes=_DRIFT_WITHIN_MIN)
    plant.do("fault", device="kiln", kind="firing_drift", minutes=_DRIFT_WITHIN_MIN, **LONGER_AND_DRIER)


def look_at(line: Path) -> Look:
    """What commands tell of the line."""
    status = json.loads(tilefab("line", "status", "--json", "--line", str(line)))
    seen = json.loads(tilefab("line", "inspected", str(line), "--last", str(_RECENT), "--json"))
    return Look(
        state=str(status["state"]),
        printed=int(seen["printed"]),
        inspected=int(seen["inspected"]),
        delta_e=seen["delta_e_mean"],
        corrections=int(seen["corrections"]),
    )


def all_seen(plant: Plant) -> bool:
    """Whether nothing is in the kiln any more."""
    return int(plant.do("state")["kiln"]["tiles_inside"]) == 0


def verdict(before: float, worst: float, last: float, *, corrected: bool) -> int:
    """Say how it ended."""
    say("")
    course = f"{before:.2f} before the drift, {worst:.2f} at most, {last:.2f} at the end"
    say(f"Mean ΔE00 of tiles from their own faces: {course}.")
    say(f"Report: {OUT / 'report.pdf'} and report.json beside it.")
    caught = last < before + 0.5 * (worst - before) or not corrected
    if not caught:
        say("The drift was NOT caught.")
    return 0 if caught else 1


def say(text: str) -> None:
    """Tell the operator."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except RuntimeError as error:
        sys.exit(f"make demo-line: {error}")
