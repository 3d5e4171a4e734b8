"""The inspector as a service beside the daemon: files read, log, store and camera around it, ended by a signal."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from types import FrameType

from threadpoolctl import threadpool_limits

from tilefab.config.line import LineFile, load_line
from tilefab.errors import ConfigError, OutputError
from tilefab.io.atomic import make_folder
from tilefab.io.icc import read_icc_profile
from tilefab.io.inspection_store import InspectionStore, pictures_folder
from tilefab.io.journal import Journal
from tilefab.pipeline.inspection.alarm_desk import AlarmDesk
from tilefab.pipeline.inspection.benches import Benches, RunBench
from tilefab.pipeline.inspection.correcting import control_settings
from tilefab.pipeline.inspection.expected import ExpectedTiles
from tilefab.pipeline.inspection.images import read_camera_image
from tilefab.pipeline.inspection.inspector import Inspector, InspectorSettings
from tilefab.pipeline.inspection.kept import KeptPictures
from tilefab.pipeline.inspection.line_journal import LineJournal
from tilefab.pipeline.inspection.loop import ColourLoop, LoopSettings
from tilefab.pipeline.inspection.messages import Daemon, Messages
from tilefab.pipeline.inspection.places import inspection_log_path, store_url
from tilefab.pipeline.inspection.watching import CameraFolder
from tilefab.pipeline.line.log import LineLog

_POLL_S = 0.5
_NICE = 5
"""Behind the line's daemon, which moves tiles."""


def serve_inspection(line_path: Path, daemon_of: Callable[[LineFile], Daemon]) -> None:
    """Inspect a line's tiles until a signal ends it.

    Parameters
    ----------
    line_path
        The line's file.
    daemon_of
        Gives who talks to the line's daemon; handed in, since this room doesn't know the web.

    Raises
    ------
    ConfigError
        If the line's file is wrong, or has no camera.
    ProfileError
        If the camera's profile can't be used.
    JournalError
        If the store can't be used, or another inspector works for this line.
    OutputError
        If the state directory can't be written to.
    """
    line_file = load_line(line_path)
    stopping = threading.Event()
    with ExitStack() as stack:
        log = _log(line_file)
        stack.enter_context(log)
        stack.enter_context(_ended_by(stopping))
        os.nice(_NICE)
        # More threads of linear algebra would mostly wait for each other: a tile takes three times as long with them.
        stack.enter_context(threadpool_limits(1))
        inspector = stack.enter_context(open_inspector(line_file, daemon_of(line_file), log))
        log("up", camera=line_file.camera_folder, store=store_url(line_file))
        try:
            while not stopping.is_set():
                if not inspector.round():
                    stopping.wait(_POLL_S)
        finally:
            log("down")


@contextmanager
def open_inspector(
    line_file: LineFile,
    daemon: Daemon,
    log: Callable[..., None],
    *,
    now: Callable[[], datetime] = lambda: datetime.now(UTC),
    monotonic: Callable[[], float] = time.monotonic,
) -> Iterator[Inspector]:
    """Put an inspector together, from what a line's file says.

    Parameters
    ----------
    line_file
        The line.
    daemon
        Who corrects, and passes on alarms.
    log
        Told of everything.
    now, monotonic
        The clock on the wall, and one that is never set.

    Raises
    ------
    ConfigError, ProfileError, JournalError
        See `serve_inspection`.
    """
    line = line_file.line
    folder = line_file.camera_folder
    if line.camera is None or folder is None:
        message = "the line has no camera: name the folder that images of fired tiles arrive in"
        raise ConfigError([line_file.problem("camera", "folder", message)])
    profile_path, px_per_mm = line_file.camera_profile, line.camera.px_per_mm
    profile = None if profile_path is None else read_icc_profile(profile_path).data
    asked = line.inspection
    with ExitStack() as stack:
        store = stack.enter_context(InspectionStore.open(store_url(line_file), line=line_file.name, now=now))
        messages = Messages()
        alarms = AlarmDesk(store, daemon, messages, log)
        expected = ExpectedTiles(timedelta(minutes=asked.window_min) / asked.clock_rate, asked.clock_rate)
        journal = LineJournal(lambda: Journal.look(line_file.journal_url, line=line_file.name), expected)
        stack.callback(journal.close)
        benches = Benches(lambda run: RunBench(run, line_file))
        settings = LoopSettings(
            control_settings(asked.correction_interval_min, asked.drift_per_hour), asked.correct, asked.clock_rate
        )
        yield Inspector(
            InspectorSettings(silent=timedelta(minutes=line.camera.silent_min) / asked.clock_rate),
            store=store,
            camera=CameraFolder(folder, store.done_images),
            read_image=partial(read_camera_image, profile=profile, px_per_mm=px_per_mm),
            journal=journal,
            benches=benches,
            loop=ColourLoop(settings, store, journal, benches, daemon, messages, alarms, log),
            alarms=alarms,
            messages=messages,
            pictures=KeptPictures(pictures_folder(line_file.state_directory)),
            log=log,
            now=now,
            monotonic=monotonic,
        )


def _log(line_file: LineFile) -> LineLog:
    make_folder(line_file.state_directory)
    path = inspection_log_path(line_file)
    try:
        return LineLog(path)
    except OSError as error:
        raise OutputError(f"{path}: can't be written: {error.strerror}", path=str(path)) from error


@contextmanager
def _ended_by(stopping: threading.Event) -> Iterator[None]:
    """Let signals end the work between two images, and no sooner."""

    def stop(_: int, __: FrameType | None) -> None:
        stopping.set()

    before = {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
