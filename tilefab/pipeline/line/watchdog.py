"""Tells systemd that the daemon is up, and that its loops go round: ``sd_notify`` without its library."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from types import TracebackType

_US_PER_S = 1e6
_FEEDS_A_LIMIT = 4
"""How often the watchdog is fed within its limit."""


class Watchdog:
    """systemd's watchdog, fed by the progress of every loop that must not stand still.

    Without systemd it does nothing.

    Parameters
    ----------
    needed
        Names of the loops. It is fed only once each of them has gone round since it was fed last.
    environ
        Where systemd says how it is reached.
    now_s
        A monotonic clock, seconds.
    """

    def __init__(
        self,
        needed: Iterable[str],
        *,
        environ: Mapping[str, str] | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        environ = os.environ if environ is None else environ
        self._needed = frozenset(needed)
        self._behind = set(self._needed)
        self._now_s = now_s
        self._period_s = _period_s(environ)
        self._fed_s = now_s()
        self._socket: socket.socket | None = None
        address = environ.get("NOTIFY_SOCKET", "")
        if address.startswith(("/", "@")):
            self._address = "\0" + address[1:] if address[0] == "@" else address
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    def __enter__(self) -> Watchdog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def ready(self, text: str = "") -> None:
        """Say that the daemon is up."""
        self._send("READY=1", text)

    def tell(self, text: str) -> None:
        """Say in a line what the daemon is doing, for ``systemctl status``."""
        self._send("", text)

    def stopping(self, text: str = "") -> None:
        """Say that the daemon is about to end."""
        self._send("STOPPING=1", text)

    def went_round(self, name: str) -> None:
        """Say that a loop went round; feeds the watchdog when all have and it is time.

        Raises
        ------
        ValueError
            If it isn't one of those that are needed.
        """
        if name not in self._needed:
            raise ValueError(f"the watchdog knows no loop {name!r}")
        self._behind.discard(name)
        if self._behind or self._period_s is None or self._now_s() - self._fed_s < self._period_s:
            return
        self._fed_s = self._now_s()
        self._behind = set(self._needed)
        self._send("WATCHDOG=1", "")

    def close(self) -> None:
        """Say nothing any more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, state: str, text: str) -> None:
        if self._socket is None:
            return
        status = "STATUS=" + " ".join(text.split()) if text else ""
        # systemd that is gone or doesn't read must not hold up a line.
        with suppress(OSError):
            self._socket.sendto("\n".join(filter(None, (state, status))).encode(), self._address)


def _period_s(environ: Mapping[str, str]) -> float | None:
    """Time from one feeding to the next; ``None`` if no watchdog watches this process."""
    limit, process = environ.get("WATCHDOG_USEC", ""), environ.get("WATCHDOG_PID", str(os.getpid()))
    if process != str(os.getpid()) or not limit.isascii() or not limit.isdigit() or int(limit) == 0:
        return None
    return int(limit) / _US_PER_S / _FEEDS_A_LIMIT
