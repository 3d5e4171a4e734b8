"""The printer's data connection: strips of faces over TCP, sent from a thread of its own."""

from __future__ import annotations

import select
import socket
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Final

from tilefab.devices import printer_messages as messages
from tilefab.devices.endpoints import TcpEndpoint, parse_endpoint
from tilefab.devices.printer_messages import StripCode
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

_DEADLINE_S: Final = 0.5
_STAT_SIZE: Final = len(messages.STAT_MAGIC) + messages.STAT.size
_READ_SIZE: Final = 4096
_NO_ROW: Final = 0xFFFFFFFF
"""A row at which no strip can begin."""
_ARMS_KEPT: Final = 64
"""Arms of which a printer still knows something."""


@dataclass(frozen=True)
class _Sent:
    """A strip that the printer hasn't answered yet."""

    arm_id: int
    end_row: int
    nbytes: int


class PrinterDataLink:
    """A connection for strips. One thread sends; any other may close it, which makes a waiting call raise.

    `send_strip` returns once its bytes are handed over. That an earlier strip wasn't taken comes out at the next call;
    `next_row` waits until the printer has answered every strip of the arm, so it also tells whether a face has arrived
    whole. A printer that is asked something must be heard within the deadline; where it is only waited for, it is asked
    at half of it. After any error but `DeviceRefused` the connection is closed.

    Parameters
    ----------
    endpoint
        ``tcp://HOST:PORT``.
    session
        That of the control session.
    deadline_s
        For how long the printer may not be heard, in seconds, while it has something to answer.
    name
        Of the device, for messages.

    Raises
    ------
    DeviceError
        If the endpoint is no TCP port.
    """

    def __init__(
        self, endpoint: str, session: int, *, deadline_s: float = _DEADLINE_S, name: str = "printer data"
    ) -> None:
        parsed = parse_endpoint(endpoint, device=name)
        if not isinstance(parsed, TcpEndpoint):
            raise DeviceError(f"{name}: {endpoint!r} must be a tcp endpoint", device=name)
        self._endpoint, self._session, self._deadline_s, self.name = parsed, session, deadline_s, name
        self._guard = threading.Lock()
        self._in_call = threading.Lock()
        self._socket: socket.socket | None = None
        self._closing = False
        self._received = b""
        self._heard_s = 0.0
        self._credit = 0
        self._sent: deque[_Sent] = deque()
        self._asked: int | None = None
        self._next_rows: dict[int, int] = {}
        self._refused: dict[int, int] = {}

    def open(self, timeout_s: float) -> None:
        """Connect, introduce the session and wait for the printer's first message; a link is opened once.

        Parameters
        ----------
        timeout_s
            For all of it.

        Raises
        ------
        DeviceTimeout
            If the printer isn't there.
        DeviceRefused
            If it knows a newer session.
        """
        deadline = time.monotonic() + timeout_s
        host, port = self._endpoint.host, self._endpoint.port
        try:
            connection = socket.create_connection((host, port), timeout=timeout_s)
        except OSError as error:
            raise self._timeout(f"{host}:{port}: {error.strerror or 'no answer'}") from None
        if connection.getsockname() == connection.getpeername():
            # A port of this machine that nobody listens on can be connected to itself.
            connection.close()
            raise self._timeout(f"{host}:{port}: nobody listens there")
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._guard:
            refuse = self._closing or self._socket is not None
            if not refuse:
                self._socket = connection
        if refuse:
            connection.close()
            raise self._timeout("was closed, or is open already")
        try:
            with self._call() as peer:
                self._introduce(peer, deadline)
        except DeviceRefused:
            self.close()
            raise

    def _introduce(self, peer: socket.socket, deadline: float) -> None:
        self._heard_s = time.monotonic()
        self._transmit(peer, messages.DATA_HELLO_MAGIC + messages.DATA_HELLO.pack({"session": self._session}))
        while not self._take_messages(peer, newer_session=True):
            self._wait(peer, select.POLLIN, deadline, "didn't answer in time")

    def send_strip(self, arm_id: int, row: int, rows: int, data: memoryview, *, timeout_s: float) -> int:
        """Send a strip once there is room for it; its CRC-32.

        Parameters
        ----------
        arm_id
            An accepted arm.
        row, rows
            First row, and how many; strips of an arm come in order, without gaps.
        data
            Bytes of the rows, in one piece. They may be reused afterwards.
        timeout_s
            For how long to wait for room.

        Raises
        ------
        DeviceRefused
            If the printer knows no such arm, or the arm has ended.
        DeviceTimeout
            If there was no room in time, the printer isn't heard any more, or the link was closed.
        DeviceProtocolError
            If a strip wasn't taken, or what the printer sends makes no sense.
        """
        crc = zlib.crc32(data)
        fields = {"arm_id": arm_id, "row": row, "rows": rows, "nbytes": data.nbytes, "crc32": crc}
        head = messages.STRIP_MAGIC + messages.STRIP.pack(fields)
        deadline = time.monotonic() + timeout_s
        with self._call() as peer:
            self._take_messages(peer)
            self._check_refused(arm_id)
            self._heard_s = time.monotonic()
            while self._credit - sum(sent.nbytes for sent in self._sent) < data.nbytes:
                self._listen(peer, arm_id, deadline)
                self._check_refused(arm_id)
            self._sent.append(_Sent(arm_id, row + rows, data.nbytes))
            self._transmit(peer, head, data)
        return crc

    def next_row(self, arm_id: int) -> int:
        """Row of an arm that the printer wants next, once it has answered all strips of it.

        Raises
        ------
        DeviceRefused
            If the printer knows no such arm, or the arm has ended. All else as `send_strip`.
        """
        with self._call() as peer:
            self._take_messages(peer)
            self._heard_s = time.monotonic()
            if arm_id not in self._next_rows and arm_id not in self._refused:
                self._ask(peer, arm_id)
            while arm_id == self._asked or any(sent.arm_id == arm_id for sent in self._sent):
                self._listen(peer, arm_id, float("inf"))
            self._check_refused(arm_id)
            return self._next_rows[arm_id]

    def close(self) -> None:
        """Disconnect; a call that waits raises. Any thread may do this, and twice."""
        with self._guard:
            self._closing = True
            connection = self._socket
        if connection is None:
            return
        with suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)
        # The number of the socket must not go to another one while a call still uses it.
        with self._in_call:
            connection.close()

    @contextmanager
    def _call(self) -> Iterator[socket.socket]:
        with self._in_call:
            with self._guard:
                peer = self._socket
                if peer is None or self._closing:
                    raise self._timeout("not connected")
            try:
                yield peer
            except DeviceRefused:
                raise
            except BaseException:
                with self._guard:
                    self._closing = True
                peer.close()
                raise

    def _listen(self, peer: socket.socket, arm_id: int, deadline: float) -> None:
        """Wait for messages; ask for one where none needs to come."""
        half = self._heard_s + self._deadline_s / 2
        if self._asked is None and time.monotonic() >= half:
            self._ask(peer, arm_id)
        until = half if self._asked is None else self._heard_s + self._deadline_s
        if deadline <= until:
            self._wait(peer, select.POLLIN, deadline, "has had no room for a strip for too long")
        elif self._asked is None:
            self._ready(peer, select.POLLIN, until)
        else:
            self._wait(peer, select.POLLIN, until, "isn't heard any more")
        self._take_messages(peer)

    def _ask(self, peer: socket.socket, arm_id: int) -> None:
        """Send a strip of no rows that can't be next: the printer doesn't take it, and tells which row would be."""
        self._asked = arm_id
        fields = {"arm_id": arm_id, "row": _NO_ROW, "rows": 0, "nbytes": 0, "crc32": 0}
        self._transmit(peer, messages.STRIP_MAGIC + messages.STRIP.pack(fields))

    def _transmit(self, peer: socket.socket, *parts: bytes | memoryview) -> None:
        rest = [memoryview(part).cast("B") for part in parts]
        while rest:
            try:
                sent = peer.sendmsg(rest)
            except BlockingIOError:
                self._wait(
                    peer, select.POLLIN | select.POLLOUT, self._heard_s + self._deadline_s, "takes no more bytes"
                )
                self._take_messages(peer)
                continue
            except OSError:
                raise self._lost() from None
            self._heard_s = time.monotonic()
            while rest and sent >= rest[0].nbytes:
                sent -= rest.pop(0).nbytes
            if rest:
                rest[0] = rest[0][sent:]

    def _take_messages(self, peer: socket.socket, *, newer_session: bool = False) -> bool:
        """Take what the printer has sent; whether there was a whole message."""
        while True:
            try:
                data = peer.recv(_READ_SIZE)
            except BlockingIOError:
                break
            except OSError:
                raise self._lost() from None
            if not data:
                if newer_session and not self._closing and not self._received:
                    raise DeviceRefused(
                        f"{self.name}: closed the connection at once: another daemon has a newer session",
                        device=self.name,
                    )
                raise self._lost()
            self._received += data
        found = False
        while len(self._received) >= _STAT_SIZE:
            message, self._received = self._received[:_STAT_SIZE], self._received[_STAT_SIZE:]
            if not message.startswith(messages.STAT_MAGIC):
                raise self._wrong("sent what is no message")
            self._take(messages.STAT.unpack(message[len(messages.STAT_MAGIC) :]))
            found = True
        if found:
            self._heard_s = time.monotonic()
        return found

    def _take(self, stat: dict[str, int]) -> None:
        arm_id, code = stat["arm_id"], stat["code"]
        self._credit = stat["credit"]
        asked = arm_id == self._asked
        if code == StripCode.UNKNOWN_ARM:
            self._keep(self._refused, arm_id, StripCode.UNKNOWN_ARM)
            self._sent = deque(sent for sent in self._sent if sent.arm_id != arm_id)
            self._asked = None if asked else self._asked
            return
        if code not in (StripCode.OK, StripCode.OUT_OF_ORDER) or (code == StripCode.OUT_OF_ORDER and not asked):
            raise self._wrong(f"didn't take a strip of arm {arm_id} (code {code}): it wants row {stat['next_row']}")
        if code == StripCode.OUT_OF_ORDER:
            self._asked = None
        self._keep(self._next_rows, arm_id, stat["next_row"])
        self._sent = deque(sent for sent in self._sent if sent.arm_id != arm_id or sent.end_row > stat["next_row"])

    def _keep(self, table: dict[int, int], arm_id: int, value: int) -> None:
        table.pop(arm_id, None)
        table[arm_id] = value
        while len(table) > _ARMS_KEPT:
            del table[next(iter(table))]

    def _check_refused(self, arm_id: int) -> None:
        if arm_id in self._refused:
            code = self._refused[arm_id]
            raise DeviceRefused(
                f"{self.name}: takes no rows of arm {arm_id}: it has ended, or isn't known", device=self.name, code=code
            )

    def _wait(self, peer: socket.socket, events: int, deadline: float, problem: str) -> None:
        if not self._ready(peer, events, deadline):
            raise self._timeout(problem)

    def _ready(self, peer: socket.socket, events: int, until: float) -> bool:
        poll = select.poll()
        poll.register(peer, events)
        left_s = until - time.monotonic()
        ready = left_s > 0 and bool(poll.poll(left_s * 1000))
        with self._guard:
            if self._closing:
                raise self._timeout("was closed")
        return ready

    def _lost(self) -> DeviceTimeout:
        return self._timeout("the connection was lost")

    def _timeout(self, what: str) -> DeviceTimeout:
        return DeviceTimeout(f"{self.name}: {what}: check its power and its cable", device=self.name)

    def _wrong(self, what: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"{self.name}: {what}: send again from there on", device=self.name)
