"""The daemon's log: a line of JSON for each event, in a file that is kept small and on standard error."""

from __future__ import annotations

import json
import logging
import logging.handlers
import queue
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import TextIO

_FILE_BYTES = 4 << 20
_FILES_KEPT = 5
_LONGEST_LINE = 8192
_WAITING = 4096
_HIDDEN = "***"
_SECRET_KEY = re.compile(r"token|password|passwd|secret|authorization|cookie|credential", re.IGNORECASE)
_URL_PASSWORD = re.compile(r"(?<=://)([^/\s:@]*):[^/\s@]*(?=@)")
_BEARER = re.compile(r"(?i)\bbearer\s+\S+")


class LineLog:
    """Writes events; called as ``log(kind, **facts)``, from any thread.

    A thread of its own writes, so that a slow disk never holds up the line; what can't be written is lost, and how much
    was lost is told. Secrets never get into it: facts with such a name, passwords in URLs, bearer tokens, and whatever
    is named in ``secrets`` are replaced by asterisks.

    Parameters
    ----------
    path
        Of the file; older ones are ``path.1`` and so on. ``None``: no file.
    stream
        Also written to. ``None``: nowhere.
    secrets
        Texts that must never be seen.
    now
        Clock.

    Raises
    ------
    OSError
        If the file can't be opened.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        stream: TextIO | None = sys.stderr,
        secrets: Iterable[str] = (),
        now: Callable[[], datetime] = lambda: datetime.now(UTC),
    ) -> None:
        self._secrets = set(filter(None, secrets))
        self._now = now
        handlers: list[logging.Handler] = []
        if path is not None:
            handlers.append(
                _File(path, maxBytes=_FILE_BYTES, backupCount=_FILES_KEPT, encoding="utf-8", errors="backslashreplace")
            )
        if stream is not None:
            handlers.append(_Stream(stream))
        self._handlers = handlers
        self._lost = 0
        self._queue: queue.Queue[logging.LogRecord] = queue.Queue(_WAITING)
        self._listener = _Listener(self._queue, *handlers)
        self._listener.start()

    def __enter__(self) -> LineLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __call__(self, kind: str, **facts: object) -> None:
        """Write an event."""
        if self._lost:
            facts = {**facts, "lines_lost": self._lost}
        text = self._line(kind, facts)
        try:
            self._queue.put_nowait(logging.LogRecord("tilefab.line", logging.INFO, "", 0, text, None, None))
        except queue.Full:
            self._lost += 1
        else:
            self._lost = 0

    def hide(self, secret: str) -> None:
        """Never let a text be seen from now on."""
        if secret:
            self._secrets.add(secret)

    def close(self) -> None:
        """Write what waits, and end."""
        if self._handlers:
            self._listener.stop()
            for handler in self._handlers:
                handler.close()
            self._handlers = []

    def _line(self, kind: str, facts: Mapping[str, object]) -> str:
        shown = {"at": self._now().isoformat(timespec="milliseconds"), "kind": kind}
        text = json.dumps({**shown, **self._clean(facts)}, ensure_ascii=False, default=str)
        if len(text) > _LONGEST_LINE:
            cut = {name: str(value)[: _LONGEST_LINE // (2 * len(facts))] for name, value in self._clean(facts).items()}
            text = json.dumps({**shown, **cut, "cut": True}, ensure_ascii=False)
        return text

    def _clean(self, facts: Mapping[str, object]) -> dict[str, object]:
        return {str(name): self._hidden(str(name), value) for name, value in facts.items()}

    def _hidden(self, name: str, value: object) -> object:
        if _SECRET_KEY.search(name):
            return _HIDDEN
        if isinstance(value, Mapping):
            return self._clean(value)
        if isinstance(value, list | tuple | set | frozenset):
            return [self._hidden("", item) for item in value]
        if value is None or isinstance(value, bool | int | float):
            return value
        text = str(value)
        for secret in self._secrets:
            text = text.replace(secret, _HIDDEN)
        return _BEARER.sub(f"Bearer {_HIDDEN}", _URL_PASSWORD.sub(rf"\1:{_HIDDEN}", text))


class _Listener(logging.handlers.QueueListener):
    def enqueue_sentinel(self) -> None:
        """Wait for room, where the library fails on a full queue."""
        self.queue.put(self._sentinel)  # type: ignore[attr-defined]


class _File(logging.handlers.RotatingFileHandler):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """A full disk is no reason to stop: the same line goes to standard error."""


class _Stream(logging.StreamHandler[TextIO]):
    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - logging's name
        """Whoever read standard error is gone."""
