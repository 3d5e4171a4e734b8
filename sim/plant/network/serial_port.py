"""A pseudo terminal that takes and gives bytes no faster than its baud rate lets a real line."""

from __future__ import annotations

import asyncio
import contextlib
import os
import tty
from collections.abc import Callable
from pathlib import Path

_CHUNK = 4096
_SLICE_S = 0.002


class SerialPort:
    """One end of a serial line.

    Parameters
    ----------
    path
        Where the other end's name is to be found: a symbolic link, made anew.
    baud
        Bits a second.
    bits
        Bits of a byte on the line, start, parity and stop included: 10 for 8N1, 11 for 8E1.
    on_bytes
        Called with bytes once the line's pace has let them through.
    """

    def __init__(self, path: Path, baud: int, bits: int, on_bytes: Callable[[bytes], None]) -> None:
        self.path = path
        self._byte_s = bits / baud
        self._on_bytes = on_bytes
        self._loop = asyncio.get_running_loop()
        self._in_free = self._out_free = 0.0
        self._out = bytearray()
        self._pumping: asyncio.TimerHandle | None = None
        self._late: set[asyncio.TimerHandle] = set()
        self._open()

    def _open(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        link = self.path.with_name(f".{self.path.name}.new")
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(self._slave))
        link.replace(self.path)
        self._loop.add_reader(self._master, self._readable)

    def _readable(self) -> None:
        try:
            data = os.read(self._master, _CHUNK)
        except (BlockingIOError, InterruptedError):
            return
        now = self._loop.time()
        self._in_free = max(now, self._in_free) + len(data) * self._byte_s
        self.later(self._in_free - now, lambda: self._on_bytes(data))

    def later(self, delay_s: float, call: Callable[[], None]) -> None:
        """Call something after a while, unless the port is closed before."""

        def due() -> None:
            self._late.discard(handle)
            call()

        handle = self._loop.call_later(delay_s, due)
        self._late.add(handle)

    def send(self, data: bytes) -> None:
        """Send bytes, one after another at the line's pace."""
        if not self._out:
            self._out_free = max(self._out_free, self._loop.time())
        self._out += data
        if self._pumping is None:
            self._pump()

    def _pump(self) -> None:
        self._pumping = None
        until = self._loop.time() + _SLICE_S
        ready = min(len(self._out), max(0, int((until - self._out_free) / self._byte_s)))
        if ready:
            self._out_free += ready * self._byte_s
            data = bytes(self._out[:ready])
            del self._out[:ready]
            # Nobody reads at the other end: a real line loses the bytes as well.
            self.later(max(0.0, self._out_free - self._loop.time()), lambda: self._write(data))
        if self._out:
            self._pumping = self._loop.call_later(max(_SLICE_S, self._byte_s), self._pump)

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)

    def hang_up(self) -> None:
        """Close the line and open a new one in its place: whoever had it open gets an error."""
        self.reset()
        old = self._master, self._slave
        self._loop.remove_reader(self._master)
        # The name leads to a line at any time.
        self._open()
        for end in old:
            os.close(end)

    def reset(self) -> None:
        """Forget everything that is on its way, as a device without power does."""
        for handle in self._late:
            handle.cancel()
        self._late.clear()
        if self._pumping is not None:
            self._pumping.cancel()
            self._pumping = None
        self._out.clear()

    def close(self) -> None:
        """Close the line and take its name away."""
        self.path.unlink(missing_ok=True)
        self.reset()
        self._loop.remove_reader(self._master)
        os.close(self._slave)
        os.close(self._master)
