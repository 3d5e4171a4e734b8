"""Byte streams to devices, over TCP and serial ports, for one asker at a time; every wait has a deadline.

A stream never reconnects, repeats or reorders anything by itself. Deadlines are times of the running loop's clock.
"""

from __future__ import annotations

import asyncio
import os
import termios
from contextlib import suppress
from pathlib import Path
from typing import NoReturn, Protocol

import serial

from tilefab.devices.endpoints import ModbusRtuEndpoint, ModbusTcpEndpoint, SerialEndpoint, TcpEndpoint
from tilefab.errors import DeviceRefused, DeviceTimeout

_MOST_WAITING = 1 << 16
"""Bytes kept for a reader; a device that sends more unasked is not talking to us."""
_READ_SIZE = 4096
_PTY_MAJORS = range(136, 144)


class ByteStream(Protocol):
    """What sessions need of a connection."""

    @property
    def last_byte_s(self) -> float:
        """When the last byte arrived."""

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent, as far as is known."""

    async def open(self, deadline: float) -> None:
        """Connect."""

    def write(self, data: bytes) -> None:
        """Send bytes at once."""

    async def read(self, deadline: float) -> bytes:
        """Wait for bytes and take all that are there."""

    def discard(self) -> bool:
        """Drop what has arrived; whether there was anything."""

    def close(self) -> None:
        """Disconnect at once."""


class Inbox:
    """Bytes that have arrived, and the one reader who may wait for them.

    Parameters
    ----------
    device
        Name of the device, for messages.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self.last_byte_s = float("-inf")
        self._bytes = bytearray()
        self._gone: str | None = "not connected"
        self._waiter: asyncio.Future[None] | None = None

    @property
    def is_open(self) -> bool:
        """Whether the connection stands, as far as is known."""
        return self._gone is None

    def begin(self) -> None:
        """Start empty, with a new connection."""
        self._bytes.clear()
        self._gone = None

    def feed(self, data: bytes) -> None:
        """Take bytes that arrived."""
        self.last_byte_s = asyncio.get_running_loop().time()
        if len(self._bytes) + len(data) > _MOST_WAITING:
            self.fail("sent far more than it was asked for")
            return
        self._bytes += data
        self._notify()

    def fail(self, reason: str) -> None:
        """Tell that nothing more will arrive."""
        if self._gone is None:
            self._gone = reason
            self._bytes.clear()
        self._notify()

    def gone(self) -> DeviceTimeout:
        """Error of a connection that is no longer there."""
        return DeviceTimeout(f"{self.device}: {self._gone}: check its power and its cable", device=self.device)

    async def take(self, deadline: float) -> bytes:
        """Wait for bytes and take all that are there.

        Raises
        ------
        DeviceTimeout
            If none came until the deadline, or the connection is gone.
        """
        if not self._bytes:
            await self._wait(deadline)
        if self._bytes:
            data = bytes(self._bytes)
            self._bytes.clear()
            return data
        if self._gone is not None:
            raise self.gone()
        raise DeviceTimeout(f"{self.device}: didn't answer in time: check its power and its cable", device=self.device)

    def discard(self) -> bool:
        """Drop what has arrived; whether there was anything."""
        had = bool(self._bytes)
        self._bytes.clear()
        return had

    async def _wait(self, deadline: float) -> None:
        if self._gone is not None:
            return
        loop = asyncio.get_running_loop()
        waiter = self._waiter = loop.create_future()
        timer = loop.call_at(deadline, self._notify)
        try:
            await waiter
        finally:
            timer.cancel()
            self._waiter = None

    def _notify(self) -> None:
        if self._waiter is not None and not self._waiter.done():
            self._waiter.set_result(None)


class _Connection(asyncio.Protocol):
    """One TCP connection; what a former one still has to tell can't reach the next."""

    def __init__(self, inbox: Inbox) -> None:
        self.inbox = inbox
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self.inbox.begin()

    def data_received(self, data: bytes) -> None:
        self.inbox.feed(data)

    def eof_received(self) -> bool:
        # A device that has stopped sending can't answer.
        self.inbox.fail("closed the connection")
        return False

    def connection_lost(self, exc: Exception | None) -> None:
        self.inbox.fail(f"the connection was lost ({exc})" if exc else "closed the connection")


def _is_own(transport: asyncio.Transport | None) -> bool:
    """Whether a connection leads back to itself, as can happen on a port of this machine that nobody listens on."""
    if transport is None or transport.get_extra_info("sockname") != transport.get_extra_info("peername"):
        return False
    transport.abort()
    return True


class TcpStream:
    """A TCP connection.

    Parameters
    ----------
    endpoint
        Where to.
    device
        Name of the device, for messages.
    """

    def __init__(self, endpoint: ModbusTcpEndpoint | TcpEndpoint, device: str) -> None:
        self._endpoint, self._device = endpoint, device
        self._connection = _Connection(Inbox(device))

    @property
    def last_byte_s(self) -> float:
        """When the last byte arrived."""
        return self._connection.inbox.last_byte_s

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent, as far as is known."""
        return self._connection.inbox.is_open

    async def open(self, deadline: float) -> None:
        """Connect; closes an earlier connection.

        Raises
        ------
        DeviceTimeout
            If nobody takes the connection until the deadline.
        """
        self.close()
        host, port, device = self._endpoint.host, self._endpoint.port, self._device
        connection = _Connection(Inbox(device))
        try:
            async with asyncio.timeout_at(deadline):
                await asyncio.get_running_loop().create_connection(lambda: connection, host, port)
        except TimeoutError:
            reason = "didn't take the connection in time"
        except OSError as error:
            reason = os.strerror(error.errno) if error.errno else str(error)
        else:
            if not _is_own(connection.transport):
                self._connection = connection
                return
            reason = "nobody listens there"
        raise DeviceTimeout(
            f"{device}: {host}:{port}: {reason}: check its power, its cable and its address", device=device
        )

    def write(self, data: bytes) -> None:
        """Send bytes at once.

        Raises
        ------
        DeviceTimeout
            If the connection is gone.
        """
        connection = self._connection
        if connection.transport is None or not connection.inbox.is_open:
            raise connection.inbox.gone()
        connection.transport.write(data)

    async def read(self, deadline: float) -> bytes:
        """Wait for bytes and take all that are there; see `Inbox.take`."""
        return await self._connection.inbox.take(deadline)

    def discard(self) -> bool:
        """Drop what has arrived; whether there was anything."""
        return self._connection.inbox.discard()

    def close(self) -> None:
        """Disconnect at once, without waiting for bytes under way."""
        self._connection.inbox.fail("not connected")
        if self._connection.transport is not None:
            self._connection.transport.abort()


def _is_pty(path: str) -> bool:
    """Whether a port is a Linux pseudo-terminal: these have no parity, and setting one fails every other time."""
    return os.major(Path(path).stat().st_rdev) in _PTY_MAJORS


class SerialStream:
    """A serial port, for this process alone.

    Parameters
    ----------
    endpoint
        Which port.
    device
        Name of the device, for messages.
    parity
        One of pyserial's.
    """

    def __init__(
        self, endpoint: ModbusRtuEndpoint | SerialEndpoint, device: str, parity: str = serial.PARITY_NONE
    ) -> None:
        self._endpoint, self._parity, self._inbox = endpoint, parity, Inbox(device)
        self._port: serial.Serial | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def last_byte_s(self) -> float:
        """When the last byte arrived."""
        return self._inbox.last_byte_s

    @property
    def is_open(self) -> bool:
        """Whether bytes can be sent, as far as is known."""
        return self._inbox.is_open

    async def open(self, deadline: float) -> None:  # noqa: ARG002 - opening a port doesn't wait for the device
        """Open the port; closes it first if it is open.

        Raises
        ------
        DeviceTimeout
            If there is no such port.
        DeviceRefused
            If another program uses it, or it can't work at this speed.
        """
        self.close()
        device, path = self._inbox.device, self._endpoint.path
        try:
            parity = serial.PARITY_NONE if _is_pty(path) else self._parity
            self._port = serial.Serial(path, self._endpoint.baud, parity=parity, timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            self._raise_no_port(error, device, path)
        self._loop = asyncio.get_running_loop()
        self._inbox.begin()
        self._loop.add_reader(self._port.fileno(), self._readable)

    def _raise_no_port(self, error: Exception, device: str, path: str) -> NoReturn:
        code = getattr(error, "errno", None)
        if code in (11, 16):
            raise DeviceRefused(f"{device}: {path} is in use by another program: end that first", device=device)
        if isinstance(error, ValueError):
            raise DeviceRefused(f"{device}: {path}: {error}: check the speed of the line", device=device)
        reason = os.strerror(code) if code else str(error)
        raise DeviceTimeout(f"{device}: {path}: {reason}: check its cable and its name", device=device)

    def _readable(self) -> None:
        assert self._port is not None
        try:
            data = os.read(self._port.fileno(), _READ_SIZE)
        except (BlockingIOError, InterruptedError):
            return
        except OSError as error:
            self._lose(f"its serial port is gone ({error.strerror})")
            return
        if data:
            self._inbox.feed(data)
        else:
            self._lose("its serial port is gone")

    def _lose(self, reason: str) -> None:
        self._inbox.fail(reason)
        self._release()

    def write(self, data: bytes) -> None:
        """Send bytes at once; what a device doesn't take is dropped, not kept for later.

        Raises
        ------
        DeviceTimeout
            If the port is gone, or its device has stopped taking bytes.
        """
        port = self._port
        if port is None or not self._inbox.is_open:
            raise self._inbox.gone()
        try:
            sent = os.write(port.fileno(), data)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._lose(f"its serial port is gone ({error.strerror})")
            raise self._inbox.gone() from None
        if sent < len(data):
            termios.tcflush(port.fileno(), termios.TCOFLUSH)
            device = self._inbox.device
            raise DeviceTimeout(f"{device}: has stopped taking bytes: check its power and its cable", device=device)

    async def read(self, deadline: float) -> bytes:
        """Wait for bytes and take all that are there; see `Inbox.take`."""
        return await self._inbox.take(deadline)

    def discard(self) -> bool:
        """Drop what has arrived; whether there was anything."""
        return self._inbox.discard()

    def close(self) -> None:
        """Give the port up at once, without waiting for bytes under way."""
        self._inbox.fail("not connected")
        self._release()

    def _release(self) -> None:
        port, self._port = self._port, None
        if port is None:
            return
        if self._loop is not None and not self._loop.is_closed():
            self._loop.remove_reader(port.fileno())
        # A port that still holds bytes for a dead device would make closing it wait for them.
        with suppress(OSError, termios.error):
            termios.tcflush(port.fileno(), termios.TCIOFLUSH)
        port.close()
