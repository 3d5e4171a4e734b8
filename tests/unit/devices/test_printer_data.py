"""The printer's data connection, against a scripted printer in a thread."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from tilefab.devices import PrinterDataLink
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

OK, BAD_CRC, UNKNOWN, OUT_OF_ORDER, NO_CREDIT = range(5)
ROW = 100
"""Bytes of a row."""


@dataclass
class DataPort:
    """A printer's data port: it keeps rows, and gives the credit that it has."""

    buffer: int = 1 << 30
    newest: int = 5
    answers: bool = True
    welcome: bool = True
    rows: dict[int, bytes] = field(default_factory=dict)
    known: set[int] = field(default_factory=lambda: {1, 2, 3})
    strips: list[tuple[int, int, int, int]] = field(default_factory=list)
    code_for: Callable[[int], int | None] = lambda _: None
    """Of a strip that begins at a row; None leaves it to the printer."""

    def __post_init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self._lock = threading.Lock()
        self._peers: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                peer = self._listener.accept()[0]
                self._peers.append(peer)
                thread = threading.Thread(target=self._serve, args=(peer,))
                self._threads.append(thread)
                thread.start()

    def _serve(self, peer: socket.socket) -> None:
        with contextlib.suppress(OSError), peer.makefile("rb") as file:
            hello = file.read(8)
            if len(hello) < 8:
                return
            magic, session = struct.unpack("<4sI", hello)
            assert magic == b"TFD1"
            if session < self.newest:
                peer.close()
                return
            if self.welcome:
                self.tell(peer, 0, OK)
            while head := file.read(28):
                magic, arm, row, rows, nbytes, crc = struct.unpack("<4sQIIII", head)
                assert magic == b"STRP"
                data = file.read(nbytes)
                with self._lock:
                    code = self._take(arm, row, rows, crc, data)
                if self.answers:
                    self.tell(peer, arm, code)

    def _take(self, arm: int, row: int, rows: int, crc: int, data: bytes) -> int:
        assert zlib.crc32(data) == crc
        self.strips.append((arm, row, rows, len(data)))
        if (code := self.code_for(row)) is not None:
            return code
        if arm not in self.known:
            return UNKNOWN
        if row != self.next_row(arm) or not rows:
            return OUT_OF_ORDER
        if len(data) > self.credit():
            return NO_CREDIT
        self.rows[arm] = self.rows.get(arm, b"") + data
        return OK

    def next_row(self, arm: int) -> int:
        return len(self.rows.get(arm, b"")) // ROW

    def credit(self) -> int:
        return self.buffer - sum(map(len, self.rows.values()))

    def tell(self, peer: socket.socket, arm: int, code: int) -> None:
        with contextlib.suppress(OSError):
            peer.sendall(b"STAT" + struct.pack("<QIIB", arm, self.next_row(arm), max(self.credit(), 0), code))

    def print_away(self, arm: int, told: int) -> None:
        """Make room, and tell of it as of an arm."""
        with self._lock:
            self.buffer += len(self.rows[arm])
        self.tell(self._peers[-1], told, OK)

    def send(self, data: bytes) -> None:
        self._peers[-1].sendall(data)

    def drop(self) -> None:
        """Drop all connections."""
        for peer in self._peers:
            with contextlib.suppress(OSError):
                peer.shutdown(socket.SHUT_RDWR)

    def stop(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in self._threads:
            thread.join()
        for peer in self._peers:
            peer.close()


@pytest.fixture
def port() -> Iterator[DataPort]:
    one = DataPort()
    yield one
    one.stop()


@contextlib.contextmanager
def opened(port: DataPort, session: int = 5, deadline_s: float = 2.0) -> Iterator[PrinterDataLink]:
    link = PrinterDataLink(port.endpoint, session, deadline_s=deadline_s)
    link.open(2.0)
    try:
        yield link
    finally:
        link.close()


def strip(rows: int, fill: int = 7) -> memoryview:
    return memoryview(bytes((fill,)) * (rows * ROW))


def test_strips_arrive_whole_and_in_order(port):
    with opened(port) as link:
        for arm in (1, 2):
            for row in range(0, 100, 10):
                link.send_strip(arm, row, 10, strip(10, row), timeout_s=2)
            assert link.next_row(arm) == 100
    assert port.rows[1] == port.rows[2] == b"".join(bytes(strip(10, row)) for row in range(0, 100, 10))


def test_big_strips_go_through_while_the_printer_tells_of_others(port):
    with opened(port, deadline_s=5) as link:
        for row in range(0, 5 * 40_000, 40_000):
            link.send_strip(1, row, 40_000, strip(40_000), timeout_s=10)
        assert link.next_row(1) == 200_000


def test_a_strip_of_any_shape_of_buffer(port):
    data = memoryview(bytearray(range(200))).cast("B", (2, 50, 2))
    with opened(port) as link:
        link.send_strip(1, 0, 2, data, timeout_s=2)
        assert link.next_row(1) == 2
    assert port.rows[1] == bytes(range(200))


def test_a_strip_waits_for_room_and_never_more_than_that_is_under_way(port):
    port.buffer = 25 * ROW
    with opened(port) as link:
        link.send_strip(1, 0, 10, strip(10), timeout_s=2)
        link.send_strip(1, 10, 10, strip(10), timeout_s=2)
        waiting = threading.Thread(target=link.send_strip, args=(1, 20, 10, strip(10)), kwargs={"timeout_s": 10})
        waiting.start()
        waiting.join(0.05)
        assert waiting.is_alive()
        assert port.next_row(1) == 20
        port.print_away(1, told=1)
        waiting.join(10)
        assert link.next_row(1) == 30
    assert all(rows or row == 0xFFFFFFFF for _, row, rows, _ in port.strips)


def test_no_room_for_too_long_is_an_error(port):
    port.buffer = 5 * ROW
    with opened(port) as link, pytest.raises(DeviceTimeout, match="no room"):
        link.send_strip(1, 0, 10, strip(10), timeout_s=0.05)


def test_while_a_strip_waits_the_printer_is_asked_whether_it_is_still_there(port):
    port.buffer = 5 * ROW
    with opened(port, deadline_s=0.1) as link:
        waiting = threading.Thread(target=send_and_fail, args=(link,))
        waiting.start()
        waiting.join(0.3)
        assert waiting.is_alive()
        assert len([1 for _, row, _, _ in port.strips if row == 0xFFFFFFFF]) >= 2
        port.answers = False
        waiting.join(10)
        assert not waiting.is_alive()


def send_and_fail(link: PrinterDataLink) -> None:
    with contextlib.suppress(DeviceError):
        link.send_strip(1, 0, 10, strip(10), timeout_s=60)


def test_a_strip_that_isnt_answered_is_noticed(port):
    with opened(port, deadline_s=0.1) as link:
        port.answers = False
        link.send_strip(1, 0, 10, strip(10), timeout_s=2)
        with pytest.raises(DeviceTimeout, match="isn't heard"):
            link.next_row(1)
        with pytest.raises(DeviceTimeout, match="not connected"):
            link.next_row(1)


def test_after_a_new_connection_the_printer_tells_where_to_go_on(port):
    with opened(port) as link:
        link.send_strip(2, 0, 10, strip(10), timeout_s=2)
        assert link.next_row(2) == 10
    with opened(port) as link:
        assert link.next_row(2) == 10
        link.send_strip(2, 10, 10, strip(10), timeout_s=2)
        assert link.next_row(2) == 20
        assert link.next_row(3) == 0


def test_an_arm_that_has_ended_is_a_refusal_and_others_go_on(port):
    with opened(port) as link:
        with pytest.raises(DeviceRefused, match="arm 9") as caught:
            link.next_row(9)
        assert caught.value.code == UNKNOWN
        link.send_strip(1, 0, 10, strip(10), timeout_s=2)
        assert link.next_row(1) == 10
        port.known.discard(1)
        for row in (10, 20):
            with contextlib.suppress(DeviceRefused):
                link.send_strip(1, row, 10, strip(10), timeout_s=2)
        with pytest.raises(DeviceRefused, match="arm 1"):
            link.next_row(1)
        with pytest.raises(DeviceRefused, match="arm 1"):
            link.send_strip(1, 30, 10, strip(10), timeout_s=2)
        link.send_strip(2, 0, 10, strip(10), timeout_s=2)
        assert link.next_row(2) == 10


@pytest.mark.parametrize("code", [BAD_CRC, OUT_OF_ORDER, NO_CREDIT, 5])
def test_a_strip_that_isnt_taken_is_an_error_that_ends_the_connection(port, code):
    port.code_for = lambda row: code if row == 10 else None
    with opened(port) as link:
        link.send_strip(1, 0, 10, strip(10), timeout_s=2)
        with pytest.raises(DeviceProtocolError, match=f"code {code}.* wants row 10"):
            both(link)
        with pytest.raises(DeviceTimeout, match="not connected"):
            link.next_row(1)


def both(link: PrinterDataLink) -> None:
    link.send_strip(1, 10, 10, strip(10), timeout_s=2)
    link.next_row(1)


def test_what_is_no_message_ends_the_connection(port):
    with opened(port) as link:
        link.next_row(1)
        port.send(b"STAR" + bytes(17))
        with pytest.raises(DeviceProtocolError, match="no message"):
            both(link)


def test_messages_may_come_in_pieces(port):
    with opened(port) as link:
        link.next_row(1)
        port.buffer = 0
        message = b"STAT" + struct.pack("<QIIB", 1, 0, 10 * ROW, OK)
        for place in range(len(message)):
            port.send(message[place : place + 1])
        port.code_for = lambda _: OK
        link.send_strip(1, 0, 10, strip(10), timeout_s=2)


def test_a_lost_connection_is_a_timeout(port):
    with opened(port) as link:
        link.next_row(1)
        port.drop()
        with pytest.raises(DeviceTimeout, match=r"lost|not connected"):
            both(link)


def test_a_newer_session_closes_at_once(port):
    link = PrinterDataLink(port.endpoint, 4)
    with pytest.raises(DeviceRefused, match="newer session"):
        link.open(2.0)
    with pytest.raises(DeviceTimeout, match="not connected"):
        link.next_row(1)
    link.close()


def test_a_printer_that_says_nothing(port):
    port.welcome = False
    link = PrinterDataLink(port.endpoint, 5)
    with pytest.raises(DeviceTimeout, match="didn't answer in time"):
        link.open(0.05)
    link.close()


def test_a_port_that_nobody_listens_on(port):
    port.stop()
    link = PrinterDataLink(port.endpoint, 5)
    with pytest.raises(DeviceTimeout, match="refused"):
        link.open(0.2)
    link.close()


def test_a_waiting_call_ends_when_another_thread_closes_the_link(port):
    port.buffer = 0
    ends: list[BaseException] = []

    def send() -> None:
        try:
            link.send_strip(1, 0, 10, strip(10), timeout_s=60)
        except DeviceTimeout as error:
            ends.append(error)

    with opened(port, deadline_s=60) as link:
        waiting = threading.Thread(target=send)
        waiting.start()
        waiting.join(0.05)
        assert waiting.is_alive()
        link.close()
        waiting.join(10)
        assert not waiting.is_alive()
        link.close()
    assert "closed" in str(ends[0])
    with pytest.raises(DeviceTimeout, match="was closed"):
        link.open(1.0)


def test_a_call_that_hands_bytes_to_a_deaf_printer_ends_when_the_link_is_closed():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = PrinterDataLink(f"tcp://127.0.0.1:{listener.getsockname()[1]}", 5, deadline_s=60)
        opening = threading.Thread(target=link.open, args=(5.0,))
        opening.start()
        with listener.accept()[0] as peer:
            peer.recv(8)
            peer.sendall(b"STAT" + struct.pack("<QIIB", 0, 0, 1 << 31, OK))
            opening.join(10)
            ends: list[BaseException] = []

            def send() -> None:
                try:
                    link.send_strip(1, 0, 1 << 20, strip(1 << 20), timeout_s=60)
                except DeviceTimeout as error:
                    ends.append(error)

            sending = threading.Thread(target=send)
            sending.start()
            sending.join(0.1)
            assert sending.is_alive()
            link.close()
            sending.join(10)
            assert len(ends) == 1


def test_what_is_remembered_of_arms_is_bounded(port):
    port.known = set(range(1000))
    with opened(port) as link:
        for arm in range(300):
            assert link.next_row(arm) == 0
        assert len(link._next_rows) <= 64
        assert link.next_row(0) == 0, "it asks anew"
