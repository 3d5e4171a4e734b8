"""Hosts for the simulated plant's wires, as plain as can be: blocking, raw bytes, a deadline on everything."""

from __future__ import annotations

import json
import os
import select
import socket
import struct
import termios
import time
import tty
from collections.abc import Callable
from typing import Any
from zlib import crc32

from sim.plant.checks import crc16
from sim.plant.wire import tfp

PATIENCE_S = 20.0
SILENCE_S = 0.15


def wait_until(condition: Callable[[], Any], what: str = "") -> Any:
    """Ask again and again until something is so."""
    deadline = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < deadline, f"in vain: {what}"
        time.sleep(0.005)
    return found


def address(endpoint: str) -> tuple[str, int]:
    host, _, port = endpoint.partition("://")[2].partition("?")[0].rpartition(":")
    return host, int(port)


def serial_path(endpoint: str) -> str:
    return endpoint.partition("://")[2].partition("?")[0]


class _Host:
    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        raise NotImplementedError


class TcpHost(_Host):
    """A TCP connection."""

    def __init__(self, endpoint: str) -> None:
        self.socket = socket.create_connection(address(endpoint), timeout=PATIENCE_S)

    def read(self, size: int) -> bytes:
        """Read so many bytes; fewer if the peer ends the connection."""
        data = b""
        try:
            while len(data) < size and (more := self.socket.recv(size - len(data))):
                data += more
        except ConnectionResetError:
            pass
        return data

    def ended(self) -> bool:
        """Whether the peer ends the connection, now or soon."""
        try:
            return self.socket.recv(1) == b""
        except ConnectionResetError:
            return True

    def silent(self) -> bool:
        """Whether nothing comes for a while."""
        return not select.select([self.socket], [], [], SILENCE_S)[0]

    def close(self) -> None:
        self.socket.close()


class ModbusHost(TcpHost):
    """A Modbus TCP host."""

    def __init__(self, endpoint: str) -> None:
        super().__init__(endpoint)
        self.unit = int(endpoint.rpartition("=")[2])
        self.tid = 0
        self.seq = 0

    def send(self, body: bytes) -> None:
        self.tid += 1
        self.socket.sendall(struct.pack(">HHHB", self.tid, 0, len(body) + 1, self.unit) + body)

    def frame(self) -> tuple[int, int, bytes]:
        """The next answer: its number, its unit and its body."""
        head = self.read(7)
        assert len(head) == 7, "the connection is over"
        tid, protocol, size, unit = struct.unpack(">HHHB", head)
        assert protocol == 0
        return tid, unit, self.read(size - 1)

    def ask(self, body: bytes) -> bytes:
        self.send(body)
        tid, unit, reply = self.frame()
        assert (tid, unit) == (self.tid, self.unit)
        return reply

    def poll_body(self, count: int = 64) -> bytes:
        self.seq = (self.seq + 1) & 0xFFFF
        return struct.pack(">BHHHHBH", 23, 0, count, 0, 1, 2, self.seq)

    def poll(self, count: int = 64) -> list[int]:
        reply = self.ask(self.poll_body(count))
        assert reply[:2] == bytes([23, 2 * count]), reply.hex()
        words = list(struct.unpack(f">{count}H", reply[2:]))
        assert words[0] == self.seq
        return words

    def write(self, address: int, *values: int) -> bytes:
        return self.ask(struct.pack(f">BHHB{len(values)}H", 16, address, len(values), 2 * len(values), *values))

    def command(self, seq: int, *, run: int = 3, speed: int = 5000, bits: int = 0xFFFFFFFF, ack: int = 0) -> None:
        """Send the conveyor a command block, tiles of 600 mm, a pitch of 700 mm, releases from 1 on."""
        reply = self.write(32, seq, run, speed, 6000, 7000, 0, 1, bits >> 16, bits & 0xFFFF, ack)
        assert reply[0] == 16, reply.hex()


class SerialHost(_Host):
    """A serial line."""

    def __init__(self, endpoint: str) -> None:
        self.path = serial_path(endpoint)
        self.file = os.open(self.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.file)
        termios.tcflush(self.file, termios.TCIFLUSH)

    def send(self, data: bytes) -> None:
        assert os.write(self.file, data) == len(data)

    def read_some(self, seconds: float) -> bytes:
        """Whatever comes next, at most after some time; nothing if the line is broken."""
        if not select.select([self.file], [], [], seconds)[0]:
            return b""
        try:
            return os.read(self.file, 4096)
        except OSError:
            return b""

    def read_until(self, done: Callable[[bytes], bool]) -> bytes:
        data = b""
        deadline = time.monotonic() + PATIENCE_S
        while not done(data):
            assert time.monotonic() < deadline, data.hex()
            data += self.read_some(0.05)
        return data

    def silent(self) -> bool:
        """Whether nothing comes for a while."""
        return self.read_some(SILENCE_S) == b""

    def broken(self) -> bool:
        """Whether the line has been hung up."""
        try:
            return os.read(self.file, 1) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        os.close(self.file)


class RtuHost(SerialHost):
    """A Modbus RTU host."""

    def send_body(self, body: bytes, unit: int = 1) -> None:
        frame = bytes([unit]) + body
        self.send(frame + crc16(frame).to_bytes(2, "little"))

    def frame(self, size: int) -> bytes:
        """An answer of so many bytes, checked and stripped of its unit and checksum."""
        data = self.read_until(lambda data: len(data) >= size + 3)
        assert len(data) == size + 3
        assert crc16(data[:-2]).to_bytes(2, "little") == data[-2:]
        return data[1:-2]

    def ask(self, body: bytes, size: int) -> bytes:
        self.send_body(body)
        return self.frame(size)


class PrinterHost(SerialHost):
    """A host of the printer's control line."""

    def __init__(self, endpoint: str, session: int = 1) -> None:
        super().__init__(endpoint)
        self.session = session
        self.seq = 0

    def request(self, kind: int, payload: bytes = b"") -> None:
        self.seq += 1
        self.send(tfp.frame(self.session, self.seq, kind, payload))

    def messages(self, count: int = 1) -> list[tfp.Message | None]:
        data = self.read_until(lambda data: data.count(b"\0") >= count)
        return [tfp.parse(part) for part in data.split(b"\0")[:-1]]

    def ask(self, kind: int, payload: bytes = b"") -> bytes:
        self.request(kind, payload)
        (reply,) = self.messages()
        assert reply is not None
        assert (reply.session, reply.seq, reply.kind) == (self.session, self.seq, kind | 0x80), reply
        return reply.payload

    def open(self) -> None:
        self.ask(1, b"\x01")
        counter = self.ask(2)[-2:]
        assert self.ask(8, counter) == b"\0"

    def detections(self, from_seq: int) -> list[tuple[int, int, int]]:
        payload = self.ask(3, from_seq.to_bytes(4, "little"))
        return [struct.unpack_from("<IQI", payload, 1 + 16 * at) for at in range(payload[0])]

    def arm(self, arm: int, seq: int, start: int, *, rows: int = 600, cols: int = 10) -> int:
        """Arm a face of 1 mm rows; the printer's answer."""
        return self.ask(4, struct.pack("<QQIQIIIBB", arm, arm + 100, seq, start, rows, cols, 20000, 4, 8))[0]

    def outcome(self, arm: int) -> tuple[int, ...]:
        payload = self.ask(6, arm.to_bytes(8, "little"))
        assert payload[0]
        return struct.unpack_from("<QQIBIII", payload, 1)


class DataHost(TcpHost):
    """A host of the printer's data link."""

    def __init__(self, endpoint: str, session: int = 1) -> None:
        super().__init__(endpoint)
        self.socket.sendall(b"TFD1" + session.to_bytes(4, "little"))

    def stat(self) -> tuple[int, int, int, int]:
        """The printer's next message: arm, next row, credit, code."""
        data = self.read(21)
        assert data[:4] == b"STAT", data.hex()
        return struct.unpack("<QIIB", data[4:])

    def strip(self, arm: int, row: int, data: bytes, *, row_bytes: int = 40, check: int | None = None) -> None:
        rows = len(data) // row_bytes
        check = crc32(data) if check is None else check
        self.socket.sendall(struct.pack("<4sQIIII", b"STRP", arm, row, rows, len(data), check) + data)


class ControlHost(TcpHost):
    """A host of the control port."""

    def do(self, name: str, **arguments: Any) -> dict[str, Any]:
        return self.say(json.dumps({"do": name, **arguments}).encode())

    def say(self, line: bytes) -> dict[str, Any]:
        self.socket.sendall(line + b"\n")
        data = b""
        while not data.endswith(b"\n"):
            more = self.read(1)
            assert more
            data += more
        reply: dict[str, Any] = json.loads(data)
        return reply
