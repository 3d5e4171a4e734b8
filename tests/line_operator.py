"""An operator for a line that runs for a long time: patient, now and then at the button himself, never out of jobs.

He lives in the daemon's process, with the desk, the log and the API's views that the real service has.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from tilefab.config import load_job
from tilefab.config.line import LineFile
from tilefab.control import line_machine as machine
from tilefab.control.line_machine import LineState
from tilefab.errors import InterlockError
from tilefab.pipeline.line.daemon import LineDaemon, Log
from tilefab.pipeline.line.desk import Desk
from tilefab.pipeline.line.jobs import LineJob, line_job
from tilefab.pipeline.line.log import LineLog
from tilefab.pipeline.plan import plan_job

STOPPED = 0
_TURN_S = 0.05
_REPORT_S = 0.5
_PATIENCE_S = (0.2, 0.8)
_PAUSE_S = (0.5, 4.0)
_MOST_QUEUED = 3
_MEDDLES_EVERY_S = 40.0
_BY_ITSELF = ("draining", "running")
"""From here the line may begin the next job without being told."""


class Operator:
    """Runs a line's daemon until told that no further job shall be queued, and all are done.

    Parameters
    ----------
    line
        The line.
    jobs
        Job files that take turns; each time one more lot of its faces is ordered.
    lot
        Faces that a job grows by.
    report
        Descriptor that a JSON object is written to every half a second: what was seen so far.
    seed
        Of his moods.
    """

    def __init__(self, line: LineFile, jobs: Sequence[Path], lot: int, report: int, seed: int) -> None:
        self._line, self._jobs, self._lot, self._report = line, jobs, lot, report
        self._chance = random.Random(seed)
        self._ordered = dict.fromkeys(jobs, 0)
        self._next_job = 0
        self._told = False
        self._enough = False
        self._changed_s = time.monotonic()
        self.seen: Counter[str] = Counter()
        self.wrong: list[str] = []

    async def work(self) -> int:
        """Work; the process's exit code."""
        with LineLog(self._line.log_path, stream=None) as log:
            self._desk = desk = Desk(self._watched(log))
            self._daemon = daemon = LineDaemon(self._line, [], log=desk.log)
            desk.attend(daemon)
            asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, self._no_more_jobs)
            await daemon.keeper.open()
            running = asyncio.create_task(daemon.run())
            beside = [asyncio.create_task(work) for work in (desk.refresh(), self._tell(), self._order_jobs())]
            try:
                while not running.done() and not self._done:
                    await self._act()
                    await asyncio.sleep(_TURN_S)
                    for task in beside:
                        if task.done():
                            task.result()
                daemon.stopping.set()
                await running
            finally:
                for task in beside:
                    task.cancel()
                await asyncio.gather(*beside, return_exceptions=True)
            self._write_report()
        return STOPPED

    @property
    def _done(self) -> bool:
        return self._enough and not self._daemon.jobs and self._daemon.line.state is LineState.STOPPED

    def _no_more_jobs(self) -> None:
        self._enough = True

    def _watched(self, log: LineLog) -> Log:
        """Look at what the daemon tells on its way to the log."""

        def seen(kind: str, **facts: object) -> None:
            self._see(kind, facts)
            log(kind, **facts)

        return seen

    def _see(self, kind: str, facts: dict[str, object]) -> None:
        if kind == "state":
            state, before = str(facts["state"]), str(facts["before"])
            self.seen[state] += 1
            self._changed_s = time.monotonic()
            if state == "arming" and before not in _BY_ITSELF and not self._told:
                self.wrong.append(f"the line went from {before} to arming without being told")
            if state == "running" and before not in ("arming", "draining"):
                self.wrong.append(f"the line went from {before} to running")
            if state not in ("arming", "running"):
                self._told = False
        elif kind == "alarm":
            self.seen[f"alarm {facts['code']}"] += 1
            self._changed_s = time.monotonic()
        elif kind == "job":
            self.seen["jobs taken up"] += 1

    async def _act(self) -> None:
        """Acknowledge what is up and go on, after a while; meddle now and then."""
        daemon, chance = self._daemon, self._chance
        if daemon.line.state in machine.RESTING:
            if time.monotonic() - self._changed_s < chance.uniform(*_PATIENCE_S):
                return
            if daemon.line.unacked or daemon.line.state in (LineState.E_STOPPED, LineState.FAULTED):
                # Also what was acknowledged before: a stop that was acknowledged with its button still in stands on.
                await self._say("ack", up_to=daemon.line.raised)
            order = "resume" if daemon.line.state is LineState.HOLDING else "start"
            if (daemon.jobs or order == "resume") and not machine.refusal(
                daemon.line, machine.OperatorResume() if order == "resume" else machine.OperatorStart()
            ):
                self._told = True
                await self._say(order)
        elif daemon.line.state is LineState.RUNNING and chance.random() < _TURN_S / _MEDDLES_EVERY_S:
            await self._say(chance.choice(("hold", "stop")))

    async def _say(self, name: str, **arguments: object) -> None:
        self.seen[name] += 1
        with contextlib.suppress(InterlockError):
            await self._desk.command(name, arguments)

    async def _order_jobs(self) -> None:
        """Queue job after job: sometimes one behind another, sometimes only after a pause."""
        while not self._enough:
            if not self._daemon.jobs:
                await asyncio.sleep(self._chance.uniform(*_PAUSE_S) if self._next_job else 0.0)
                for _ in range(self._chance.randint(1, _MOST_QUEUED)):
                    self._daemon.jobs.append(await asyncio.to_thread(self._next))
            await asyncio.sleep(_TURN_S)

    def _next(self) -> LineJob:
        """The next job: the same run goes on with more faces, so that maps are made only once."""
        path = self._jobs[self._next_job % len(self._jobs)]
        self._next_job += 1
        before = self._ordered[path]
        self._ordered[path] = before + self._lot
        text = path.read_text()
        path.write_text(text.replace(f"count = {before or self._lot}\n", f"count = {before + self._lot}\n"))
        return line_job(plan_job(load_job(path)), self._line)

    async def _tell(self) -> None:
        while True:
            self._desk.metrics()
            self._write_report()
            await asyncio.sleep(_REPORT_S)

    def _write_report(self) -> None:
        line = self._daemon.line
        told = {
            "state": line.state.value,
            "reason": line.reason,
            "since_s": round(time.monotonic() - self._changed_s, 1),
            "alarms": [f"{alarm.code}: {alarm.text}" for alarm in line.alarms if not alarm.acked][-3:],
            "queue": len(self._daemon.jobs),
            "faces_to_go": self._daemon.book.faces_to_go if self._daemon.book is not None else 0,
            "kiln": str(self._daemon.kiln.status) if self._daemon.kiln is not None else "",
            "missing": sorted(line.missing),
            "question": str(line.asked),
            "blank": self._daemon.printer.blank_tiles,
            "arming_ms": [round(self._daemon.printer.arming_s.quantile_s(share) * 1000, 1) for share in (0.5, 0.999)],
            "seen": dict(self.seen),
            "wrong": self.wrong[:20],
        }
        os.write(self._report, (json.dumps(told) + "\n").encode())
