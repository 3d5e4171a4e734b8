"""Progress bars for anything that takes over a second, on standard error, so that output stays clean."""

from __future__ import annotations

import sys
import threading
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

NOTE_STYLE = "yellow"


class Bars:
    """Shows the stages of a job as bars; implements `tilefab.pipeline.progress.Progress`.

    Without a terminal each stage is a line when it begins and one when it ends, so that a log stays readable.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self._console = Console(file=sys.stderr, quiet=quiet, highlight=False)
        self._bars = Progress(
            TextColumn("{task.description:<22}"),
            BarColumn(bar_width=32),
            TextColumn("{task.percentage:>4.0f} %"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._ended: set[str] = set()
        self._lock = threading.Lock()

    def __enter__(self) -> Bars:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bars.stop()

    def stage(self, name: str, share: float) -> None:
        """Move a stage's bar."""
        with self._lock:
            if name not in self._tasks:
                self._tasks[name] = self._bars.add_task(name, total=1.0)
                if self._bars.disable:
                    self._console.print(f"{name} ...")
            self._bars.update(self._tasks[name], completed=share)
            if share >= 1.0 and name not in self._ended:
                self._ended.add(name)
                if self._bars.disable:
                    self._console.print(f"{name}: done")

    def note(self, message: str) -> None:
        """Print a note above the bars."""
        self._console.print(f"note: {message}", style=NOTE_STYLE, markup=False, soft_wrap=True)
