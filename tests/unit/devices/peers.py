"""Scripted devices on loopback sockets and ptys, with codecs of their own: nothing here is the product's."""

from __future__ import annotations

import asyncio
import contextlib
import os
import struct
import tty
import zlib
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from typing import Protocol

Send = Callable[[bytes], None]
Script = Callable[[bytes, Send], None]
"""What a device does with an answer instead of sending it."""


def from_table(kind: int, payload: bytes) -> bytes | None:
    return None


def plainly(frame: bytes, send: Send) -> None:
    send(frame)


def mute(frame: bytes, send: Send) -> None:
    pass


def crc16(data: bytes) -> bytes:
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
    return struct.pack("<H", value)


class Device(Protocol):
    """Takes bytes from a wire, and sends its answers."""

    def connected(self) -> None: ...

    def receive(self, data: bytes, send: Send) -> None: ...


@dataclass
class Unit:
    """A Modbus unit: registers in plain memory, a scan counter, and commands that are acted on at once."""

    window: int
    unit: int
    probe: tuple[int, int]
    rtu: bool = False
    sums: bool = True
    acts: bool = True
    counts: bool = True
    fc23: bool = True
    script: Script = plainly
    words: list[int] = field(default_factory=list)
    requests: list[bytes] = field(default_factory=list)
    connections: int = 0
    ack: int = 19
    refuse: int = 0
    """An exception that answers every request."""

    def __post_init__(self) -> None:
        self.words = [0] * self.window
        self.words[2] = int.from_bytes(os.urandom(2), "big") | 1
        self.words[3:5] = self.probe
        self._rest = b""

    def connected(self) -> None:
        self._rest = b""
        self.connections += 1

    def receive(self, data: bytes, send: Send) -> None:
        self._rest += data
        while (taken := self._whole()) is not None:
            head, pdu, self._rest = taken
            self.requests.append(pdu)
            answer = self.answer(pdu)
            if self.rtu:
                frame = head + answer
                self.script(frame + crc16(frame), send)
            else:
                self.script(head[:4] + struct.pack(">HB", len(answer) + 1, head[6]) + answer, send)

    def _whole(self) -> tuple[bytes, bytes, bytes] | None:
        rest = self._rest
        if not self.rtu:
            end = 6 + int.from_bytes(rest[4:6], "big")
            return (rest[:7], rest[7:end], rest[end:]) if 7 < end <= len(rest) else None
        if len(rest) < 8:
            return None
        function = rest[1]
        end = {3: 8, 6: 8, 16: 9 + rest[6]}.get(function, 0)
        if function == 23:
            end = 13 + rest[10] if len(rest) > 10 else 1 << 30
        if len(rest) < end:
            return None
        assert rest[end - 2 : end] == crc16(rest[: end - 2]), "a host sends sound frames"
        return rest[:1], rest[1 : end - 2], rest[end:]

    def answer(self, pdu: bytes) -> bytes:
        if self.counts:
            self.words[1] = (self.words[1] + 1) % 65536
        function = pdu[0]
        if self.refuse or (function == 23 and not self.fc23):
            return bytes((function | 0x80, self.refuse or 1))
        address, count = struct.unpack_from(">HH", pdu, 1)
        if function == 6:
            self.write(address, (count,))
            return pdu
        if function == 16:
            self.write(address, struct.unpack_from(f">{count}H", pdu, 6))
            return pdu[:5]
        if function == 23:
            to, more = struct.unpack_from(">HH", pdu, 5)
            self.write(to, struct.unpack_from(f">{more}H", pdu, 10))
        return bytes((function, 2 * count)) + struct.pack(f">{count}H", *self.shown()[address : address + count])

    def write(self, address: int, words: tuple[int, ...]) -> None:
        self.words[address : address + len(words)] = words
        if self.acts and address <= 32 < address + len(words):
            self.words[self.ack] = self.words[32]

    def shown(self) -> list[int]:
        if not self.sums:
            return self.words
        body = self.words[:-2]
        return [*body, *struct.unpack(">HH", struct.pack(">I", zlib.crc32(struct.pack(f">{len(body)}H", *body))))]


def plc(**options: object) -> Unit:
    return Unit(window=64, unit=1, probe=(0x0102, 0x0304), **options)  # type: ignore[arg-type]


def kiln(**options: object) -> Unit:
    unit = Unit(window=80, unit=2, probe=struct.unpack(">HH", struct.pack(">f", 1234.5)), ack=26, **options)  # type: ignore[arg-type]
    unit.words[8] = 8
    return unit


def stuffed(body: bytes) -> bytes:
    """COBS, written the other way round than the product's: a zero becomes the distance to the next."""
    out, place = bytearray(1), 0
    for byte in body:
        if byte:
            out.append(byte)
        if not byte or len(out) - place == 255:
            out[place] = len(out) - place
            place = len(out)
            out.append(0)
    out[place] = len(out) - place
    return bytes(out)


def unstuffed(data: bytes) -> bytes:
    out = bytearray()
    while data:
        length = data[0]
        out += data[1:length]
        data = data[length:]
        if data and length < 255:
            out.append(0)
    return bytes(out)


def tfp_frame(session: int, seq: int, kind: int, payload: bytes) -> bytes:
    body = struct.pack("<IHB", session, seq, kind) + payload
    return stuffed(body + struct.pack("<I", zlib.crc32(body))) + b"\0"


HELLO_REPLY = struct.pack("<BIBBIIIBI", 1, 77, 4, 2, 20000, 9000, 100, 8, 1 << 20)


@dataclass
class Printer:
    """A printer's control: answers from a table of payloads by type, keeps to sessions, and knows duplicates."""

    replies: dict[int, bytes] = field(default_factory=lambda: {1: HELLO_REPLY})
    script: Script = plainly
    requests: list[tuple[int, int, int, bytes]] = field(default_factory=list)
    acted: list[tuple[int, bytes]] = field(default_factory=list)
    session: int = 0
    on_request: Callable[[int, bytes], bytes | None] = from_table

    def __post_init__(self) -> None:
        self._rest = b""
        self._last: tuple[tuple[int, int, int], bytes] | None = None

    def connected(self) -> None:
        pass

    def receive(self, data: bytes, send: Send) -> None:
        *frames, self._rest = (self._rest + data).split(b"\0")
        for frame in frames:
            body = unstuffed(frame)
            if len(body) < 11 or zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
                continue
            session, seq, kind = struct.unpack_from("<IHB", body)
            payload = body[7:-4]
            self.requests.append((session, seq, kind, payload))
            key = (session, seq, kind)
            if self._last is not None and self._last[0] == key:
                self.script(self._last[1], send)
                continue
            if session < self.session:
                reply = tfp_frame(session, seq, 0xFF, b"\3")
            else:
                self.session = session
                self.acted.append((kind, payload))
                answer = self.on_request(kind, payload)
                answer = self.replies.get(kind) if answer is None else answer
                reply = tfp_frame(session, seq, kind | 0x80, answer) if answer is not None else b""
                if answer is None:
                    reply = tfp_frame(session, seq, 0xFF, b"\1")
            self._last = key, reply
            self.script(reply, send)


@dataclass
class Gauge:
    """A gauge that answers with a text."""

    text: str = "5 61.25 -0.5 12 40"
    script: Script = plainly
    requests: list[bytes] = field(default_factory=list)

    def connected(self) -> None:
        pass

    def receive(self, data: bytes, send: Send) -> None:
        for line in data.splitlines():
            self.requests.append(line)
            self.script(gauge_line(line[1:].split(b" ")[0].decode(), self.text), send)


def gauge_line(sequence: str, text: str) -> bytes:
    body = f"{sequence} {text}".encode()
    return b"!%s*%08x\n" % (body, zlib.crc32(body))


class _Server(asyncio.Protocol):
    def __init__(self, device: Device, open_ones: list[asyncio.Transport]) -> None:
        self._device, self._open = device, open_ones

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._open.append(transport)
        self._device.connected()

    def data_received(self, data: bytes) -> None:
        self._device.receive(data, self._send)

    def _send(self, data: bytes) -> None:
        if not self._transport.is_closing():
            self._transport.write(data)


@dataclass
class TcpPort:
    """A TCP port with a device behind it."""

    device: Device
    port: int = 0
    transports: list[asyncio.Transport] = field(default_factory=list)
    server: asyncio.Server | None = None

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self.server = await loop.create_server(lambda: _Server(self.device, self.transports), "127.0.0.1", self.port)
        self.port = self.server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        """Drop all connections, and take no new ones."""
        assert self.server is not None
        self.server.close()
        for transport in self.transports:
            transport.abort()
        self.transports.clear()
        await asyncio.sleep(0)


@contextlib.asynccontextmanager
async def tcp_port(device: Device) -> AsyncIterator[TcpPort]:
    port = TcpPort(device)
    await port.start()
    try:
        yield port
    finally:
        await port.stop()


@contextlib.asynccontextmanager
async def tcp_unit(unit: Unit) -> AsyncIterator[str]:
    async with tcp_port(unit) as port:
        yield f"modbus-tcp://127.0.0.1:{port.port}?unit={unit.unit}"


@dataclass
class Pty:
    """A pty: the host's end by name, the device's by number."""

    path: str
    master: int
    slave: int

    def send(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self.master, data)


@contextlib.contextmanager
def pty_pair() -> Iterator[Pty]:
    master, slave = os.openpty()
    tty.setraw(master)
    os.set_blocking(master, False)
    try:
        yield Pty(os.ttyname(slave), master, slave)
    finally:
        for fd in (master, slave):
            with contextlib.suppress(OSError):
                os.close(fd)


@contextlib.asynccontextmanager
async def serial_port(device: Device) -> AsyncIterator[Pty]:
    loop = asyncio.get_running_loop()
    with pty_pair() as pair:

        def readable() -> None:
            with contextlib.suppress(OSError):
                device.receive(os.read(pair.master, 4096), pair.send)

        device.connected()
        loop.add_reader(pair.master, readable)
        try:
            yield pair
        finally:
            loop.remove_reader(pair.master)


def vanish(pair: Pty) -> None:
    """Pull the cable: both ends of the pty that the device holds are gone."""
    asyncio.get_running_loop().remove_reader(pair.master)
    os.close(pair.slave)
    os.close(pair.master)
