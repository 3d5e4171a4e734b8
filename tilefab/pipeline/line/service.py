"""The daemon as a service: files read, maps made, log, API and watchdog around it, ended by a signal."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Sequence
from contextlib import AbstractAsyncContextManager, suppress
from pathlib import Path

from tilefab.config import load_job
from tilefab.config.line import LineFile, load_line
from tilefab.errors import OutputError
from tilefab.io.atomic import make_folder
from tilefab.pipeline.line.daemon import LineDaemon
from tilefab.pipeline.line.desk import Desk
from tilefab.pipeline.line.jobs import LineJob, line_job, open_job
from tilefab.pipeline.line.log import LineLog
from tilefab.pipeline.line.orders import LineControl
from tilefab.pipeline.line.source import FaceSource, open_source
from tilefab.pipeline.line.watchdog import Watchdog
from tilefab.pipeline.plan import plan_job
from tilefab.pipeline.progress import Progress

_LOOPS = ("plc", "printer", "watch")
_ROUND_S = 0.25

OpenApi = Callable[[LineControl, LineFile, LineLog], AbstractAsyncContextManager[None]]
"""Serves a line's API for as long as the block lasts."""


def serve_line(jobs: Sequence[Path], line_path: Path, progress: Progress, *, open_api: OpenApi) -> None:
    """Run a line's daemon until a signal ends it.

    Parameters
    ----------
    jobs
        Job files, printed in this order.
    line_path
        The line's file.
    progress
        Told of the maps being made, before the line is touched.
    open_api
        Serves the API; handed in, since this room doesn't know the web.

    Raises
    ------
    ConfigError, ImageError, ProfileError, SynthesisError, OutputError
        If a file is wrong, or maps can't be made.
    JournalError
        If the journal can't be used, or another daemon runs this line.
    """
    line_file = load_line(line_path)
    planned = [line_job(plan_job(load_job(path)), line_file) for path in jobs]
    rows = line_file.line.line.stream_strip_rows
    # All maps are made now: once the line runs, a busy processor would hold it up.
    sources = {job.plan.job_hash: open_source(job.plan, progress, rows) for job in planned}
    make_folder(line_file.state_directory)
    try:
        log = LineLog(line_file.log_path)
    except OSError as error:
        raise OutputError(f"{line_file.log_path}: can't be written: {error.strerror}", path=str(line_path)) from error

    def opened(job: LineJob, strip_rows: int) -> FaceSource:
        return sources.pop(job.plan.job_hash, None) or open_job(job, strip_rows)

    with log:
        asyncio.run(_serve(line_file, planned, opened, log, open_api))


async def _serve(
    line_file: LineFile,
    jobs: Sequence[LineJob],
    open_source_of: Callable[[LineJob, int], FaceSource],
    log: LineLog,
    open_api: OpenApi,
) -> None:
    desk = Desk(log)
    daemon = LineDaemon(line_file, jobs, log=desk.log, open_source=open_source_of)
    desk.attend(daemon)
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, daemon.stopping.set)
    await daemon.keeper.open()
    with Watchdog(_LOOPS) as watchdog:
        async with open_api(desk, line_file, log):
            beside = [
                asyncio.create_task(desk.refresh()),
                asyncio.create_task(_watch_over(daemon, watchdog)),
            ]
            log("up", jobs=[job.plan.name for job in jobs])
            watchdog.ready("waiting for an operator")
            try:
                await daemon.run()
            finally:
                watchdog.stopping("leaving the line at rest")
                for task in beside:
                    task.cancel()
                await asyncio.gather(*beside, return_exceptions=True)
                await desk.close()
                log("down")


async def _watch_over(daemon: LineDaemon, watchdog: Watchdog) -> None:
    """Feed systemd's watchdog for as long as every loop goes round."""
    before: dict[str, int] = {}
    told = ""
    while True:
        await asyncio.sleep(_ROUND_S)
        rounds = daemon.rounds
        for name in _LOOPS:
            if rounds[name] != before.get(name):
                watchdog.went_round(name)
        before = rounds
        state = daemon.line.state.value
        if state != told:
            told = state
            with suppress(ValueError):
                watchdog.tell(f"{state} {daemon.line.reason}".strip())
