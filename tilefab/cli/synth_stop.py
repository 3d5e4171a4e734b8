"""Ctrl-C for work that can end early: asked once it ends with what it has, asked twice it ends at once."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import NoReturn, TypeVar

Result = TypeVar("Result")

_HEARD_WITHIN_S = 0.2


class StoppedEarly(SystemExit):
    """The command was interrupted, has written what it had, and has said so."""


class Stop:
    """Whether an interrupt has come.

    Parameters
    ----------
    on_first
        Called when the first comes.
    """

    def __init__(self, on_first: Callable[[], None]) -> None:
        self._on_first = on_first
        self._asked = threading.Event()

    def __call__(self) -> bool:
        """Whether work should end with what it has."""
        return self._asked.is_set()

    def ask(self) -> None:
        """Ask work to end.

        Raises
        ------
        KeyboardInterrupt
            If it was asked before.
        """
        if self._asked.is_set():
            raise KeyboardInterrupt
        self._asked.set()
        self._on_first()


def leave_at_once(code: int) -> NoReturn:
    """End the process without waiting for work that was left behind.

    Python's own way out kills a thread that comes back from C++ meanwhile, and that aborts the process with a signal
    instead of its exit code.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def run_stoppable(work: Callable[[], Result], stop: Stop) -> Result:
    """Work in a thread of its own, so that an interrupt is heard at once, also while a kernel runs.

    The first interrupt asks ``stop``; the second raises `KeyboardInterrupt` here and leaves the work behind: the
    process is expected to end.
    """
    outcome: list[Result] = []
    failure: list[BaseException] = []

    def run() -> None:
        try:
            outcome.append(work())
        except BaseException as error:
            failure.append(error)

    def heard(_number: int, _frame: FrameType | None) -> None:
        stop.ask()

    # Only the main thread may change what a signal does; others can't be interrupted anyway.
    mine = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, heard) if mine else None
    try:
        worker = threading.Thread(target=run, name="work", daemon=True)
        worker.start()
        # Not for as long as it takes: a signal that comes just before this thread begins to wait doesn't wake it.
        while worker.is_alive():
            worker.join(_HEARD_WITHIN_S)
    finally:
        if mine:
            signal.signal(signal.SIGINT, before)
    if failure:
        raise failure[0]
    return outcome[0]
