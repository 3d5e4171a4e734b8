"""The printer's data link: a thread of its own that takes strips as fast as memory lets it."""

from __future__ import annotations

import contextlib
import hashlib
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import Any
from zlib import crc32

from sim.plant.network.faults import Link, answer_through
from sim.plant.network.service import Service
from sim.plant.physics.faces import StripAnswer
from sim.plant.wire import tfd

_CHUNK = 1 << 18
_SOCKET_BYTES = 4 << 20
_BUSY_S, _IDLE_S = 0.004, 0.05
_CREDIT_STEPS, _TELL_S = 16, 0.02
_MOST_KEPT = 64 << 20


class _EndedError(Exception):
    """The connection is over."""


class DataLink:
    """Listens for the host's data; a newer connection ends an older one.

    Parameters
    ----------
    service
        The plant.
    host, port
        Where to listen; port 0 for any.
    """

    def __init__(self, service: Service, host: str, port: int) -> None:
        self._service = service
        self._listener = socket.create_server((host, port))
        self.port = int(self._listener.getsockname()[1])
        self._lock = threading.Lock()
        self._current: _Connection | None = None
        self._threads: set[threading.Thread] = set()
        self._closing = False
        service.on_drop("printer", self.drop)
        self._accepting = threading.Thread(target=self._accept, name="sim-data-accept", daemon=True)
        self._accepting.start()

    def _accept(self) -> None:
        while True:
            try:
                peer, _ = self._listener.accept()
            except OSError:
                return
            with self._lock:
                if self._closing or not self._service.up("printer"):
                    peer.close()
                    continue
                if self._current is not None:
                    self._current.end()
                self._threads = {thread for thread in self._threads if thread.is_alive()}
                self._current = _Connection(self._service, peer)
                thread = threading.Thread(target=self._current.serve, name="sim-data", daemon=True)
                self._threads.add(thread)
                thread.start()

    def drop(self) -> None:
        """End the connection at once."""
        with self._lock:
            if self._current is not None:
                self._current.end()

    def close(self) -> None:
        """Stop listening, end the connection and wait for the threads."""
        with self._lock:
            self._closing = True
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in (self._accepting, *self._threads):
            thread.join(timeout=5)


class _Connection:
    def __init__(self, service: Service, peer: socket.socket) -> None:
        self._service = service
        self._peer = peer
        self._verify = service.config.printer.verify
        self._keep = service.config.printer.keep_prints
        self._chunk = memoryview(bytearray(_CHUNK))
        self._arm = 0
        self._credit = -1
        self._told = 0.0
        self._session = 0
        self._due: list[tuple[float, Callable[[], None]]] = []
        self._link = Link(self._send, self.end, self._later, "tfd")
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _SOCKET_BYTES)

    def end(self) -> None:
        """End the connection, from any thread; the serving thread closes the socket."""
        self._link.deaf = True
        with contextlib.suppress(OSError):
            self._peer.shutdown(socket.SHUT_RDWR)

    def serve(self) -> None:
        """Take what comes until the connection is over."""
        with self._peer, contextlib.suppress(_EndedError, OSError):
            session = tfd.parse_hello(bytes(self._read(tfd.HELLO_BYTES)))
            if session is None:
                return
            self._session = session
            self._report(StripAnswer.TAKEN)
            while True:
                self._wait()
                self._strip()

    def _strip(self) -> None:
        head = tfd.parse_strip(bytes(self._read(tfd.STRIP_BYTES)))
        if head is None:
            raise _EndedError
        digest: Any = None
        if self._verify == "sha256":
            with self._service.now() as plant:
                armed = plant.head.armed(head.arm_id)
                fits = armed is not None and head.row == armed.rows_received
                digest = armed.digest.copy() if armed is not None and fits and armed.digest else hashlib.sha256()
        # Whoever announces a larger strip than any face has isn't trusted with the memory.
        data = bytearray() if self._keep and head.size <= _MOST_KEPT else None
        checksum = 0
        left = head.size
        while left:
            view = self._chunk[: min(left, _CHUNK)]
            got = self._peer.recv_into(view)
            if not got:
                raise _EndedError
            left -= got
            if self._verify != "none":
                checksum = crc32(view[:got], checksum)
            if digest is not None:
                digest.update(view[:got])
            if data is not None:
                data += view[:got]
        good = self._verify == "none" or checksum == head.crc32
        self._arm = head.arm_id
        with self._service.now() as plant:
            if not plant.head.taking(self._session):
                raise _EndedError
            checked = head.crc32 if good else None
            code = plant.head.take(head.arm_id, head.row, head.rows, head.size, checked, digest, data)
        self._report(code)

    def _wait(self) -> None:
        """Wait for the next strip; tell of new credit meanwhile, and send what was held back."""
        poll = select.poll()
        poll.register(self._peer, select.POLLIN)
        while True:
            now = time.monotonic()
            for entry in [entry for entry in self._due if entry[0] <= now]:
                self._due.remove(entry)
                entry[1]()
            with self._service.now() as plant:
                busy = plant.head.printing or bool(self._due)
                if not plant.head.taking(self._session):
                    raise _EndedError
            # A deaf connection reads nothing, and ends with its peer all the same.
            poll.modify(self._peer, select.POLLRDHUP if self._link.deaf else select.POLLIN)
            if poll.poll((_BUSY_S if busy else _IDLE_S) * 1000):
                if self._link.deaf:
                    raise _EndedError
                return
            with self._service.now() as plant:
                credit = plant.head.credit
            most = self._service.config.printer.buffer_bytes
            gain = credit - self._credit
            if gain >= most // _CREDIT_STEPS or (gain > 0 and now >= self._told + _TELL_S):
                self._report(StripAnswer.TAKEN)

    def _report(self, code: StripAnswer) -> None:
        with self._service.now() as plant:
            if not plant.head.taking(self._session):
                raise _EndedError
            armed = plant.head.memory.arms.get(self._arm)
            self._credit = plant.head.credit
            self._told = time.monotonic()
            message = tfd.stat(self._arm, armed.rows_received if armed else 0, self._credit, code)
            plan = self._service.strike(("printer_data",), 0)
        answer_through(plan, self._link, lambda: message)

    def _send(self, data: bytes) -> None:
        self._peer.sendall(data)

    def _later(self, delay_s: float, call: Callable[[], None]) -> None:
        self._due.append((time.monotonic() + delay_s, call))

    def _read(self, size: int) -> memoryview:
        view = memoryview(bytearray(size))
        got = 0
        while got < size:
            step = self._peer.recv_into(view[got:])
            if not step:
                raise _EndedError
            got += step
        return view
