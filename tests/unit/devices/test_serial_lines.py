"""Serial lines: quarantine after a failure on RTU, ports that vanish, are taken, or don't take bytes."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable
from itertools import pairwise

import pytest
import serial

from tests.unit.devices import peers
from tests.unit.devices.wire_faults import status_of
from tilefab.devices import GaugeSession, PlcSession, PrinterSession
from tilefab.devices.endpoints import SerialEndpoint
from tilefab.devices.streams import SerialStream
from tilefab.errors import DeviceError, DeviceRefused, DeviceTimeout

BAUD = 38400
LATE_S = 133 * 11 / BAUD
"""Time of the longest answer on the line."""


class Stamped(peers.Unit):
    """A unit that knows when each request came."""

    def __init__(self) -> None:
        super().__init__(window=64, unit=1, probe=(0x0102, 0x0304), rtu=True)
        self.came_s: list[float] = []

    def receive(self, data: bytes, send: peers.Send) -> None:
        self.came_s.append(asyncio.get_running_loop().time())
        super().receive(data, send)


def on_a_line(
    work: Callable[[PlcSession, Stamped, peers.Pty], Awaitable[None]], deadline_s: float = 0.2, baud: int = BAUD
) -> None:
    async def run() -> None:
        unit = Stamped()
        async with peers.serial_port(unit) as pair:
            session = PlcSession(f"modbus-rtu://{pair.path}?baud={baud}", deadline_s=deadline_s)
            await session.connect()
            try:
                await work(session, unit, pair)
            finally:
                await session.close()

    asyncio.run(run())


async def bytes_came(session: PlcSession) -> None:
    """Wait until something has come that nobody has read."""
    async with asyncio.timeout(5):
        while not session._link.stream._inbox._bytes:  # type: ignore[attr-defined]
            await asyncio.sleep(0.001)


def test_after_a_timeout_nothing_is_sent_until_no_late_answer_can_come():
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        loop = asyncio.get_running_loop()
        late: list[bytes] = []
        unit.script = lambda frame, _: late.append(frame)
        with pytest.raises(DeviceTimeout):
            await session.poll()
        failed_s = loop.time()
        unit.script = peers.plainly
        # The late answer comes in two parts while the line is in quarantine.
        loop.call_later(0.25 * LATE_S, pair.send, late[0][:60])
        loop.call_later(0.75 * LATE_S, pair.send, late[0][60:])
        unit.words[7] = 5
        status = await session.poll()
        assert status == status_of(unit.words)
        assert unit.came_s[-1] - failed_s >= 1.75 * LATE_S

    on_a_line(work, deadline_s=0.4)


def test_a_line_just_opened_is_left_silent_first():
    async def run() -> None:
        unit = Stamped()
        async with peers.serial_port(unit) as pair:
            loop = asyncio.get_running_loop()
            session = PlcSession(f"modbus-rtu://{pair.path}?baud={BAUD}")
            begin_s = loop.time()
            await session.connect()
            await session.poll()
            assert unit.came_s[0] - begin_s >= LATE_S
            await session.close()

    asyncio.run(run())


def test_a_request_that_couldnt_be_answered_in_time_isnt_sent():
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        async def babble() -> None:
            while True:
                pair.send(b"\x55" * 10)
                await asyncio.sleep(0.01)

        await session.poll()
        babbling = asyncio.create_task(babble())
        await bytes_came(session)
        for _ in range(2):
            with pytest.raises(DeviceTimeout, match="must fall silent"):
                await session.poll()
        assert len(unit.requests) == 1
        babbling.cancel()
        await asyncio.wait([babbling])
        async with asyncio.timeout(5):
            while len(unit.requests) == 1:
                with contextlib.suppress(DeviceTimeout):
                    await session.poll()

    on_a_line(work, baud=9600)


def test_a_doubled_answer_costs_silence_but_no_poll():
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        loop = asyncio.get_running_loop()

        def twice(frame: bytes, send: peers.Send) -> None:
            send(frame)
            loop.call_later(0.002, send, frame)

        unit.script = twice
        for _ in range(3):
            unit.words[7] += 1
            assert await session.poll() == status_of(unit.words)
            await bytes_came(session)
        assert min(b - a for a, b in pairwise(unit.came_s)) >= LATE_S

    on_a_line(work)


@pytest.mark.parametrize("noise", [b"\x00", b"\xff" * 30, b"\x01\x17\x80", b"\x01\x97", b"\x01\x10\x00"], ids=bytes.hex)
def test_noise_on_both_sides_of_an_answer_is_skipped(noise):
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        unit.script = lambda frame, send: send(noise + frame + noise)
        for _ in range(3):
            assert await session.poll() == status_of(unit.words)

    on_a_line(work)


def test_a_garbled_answer_is_no_answer():
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        unit.script = lambda frame, send: send(frame[:40] + bytes((frame[40] ^ 1,)) + frame[41:])
        with pytest.raises(DeviceTimeout):
            await session.poll()

    on_a_line(work, deadline_s=0.06)


def test_an_answer_of_another_unit_is_no_answer():
    async def work(session: PlcSession, unit: Stamped, pair: peers.Pty) -> None:
        def from_unit_2(frame: bytes, send: peers.Send) -> None:
            body = b"\2" + frame[1:-2]
            send(body + peers.crc16(body))

        unit.script = from_unit_2
        with pytest.raises(DeviceTimeout):
            await session.poll()

    on_a_line(work, deadline_s=0.06)


SESSIONS = {
    "plc": (lambda path: PlcSession(f"modbus-rtu://{path}?baud=921600"), lambda session: session.poll()),
    "printer": (lambda path: PrinterSession(f"serial://{path}?baud=921600", 1), lambda session: session.status()),
    "gauge": (lambda path: GaugeSession(f"serial://{path}?baud=9600"), lambda session: session.measure()),
}


@pytest.mark.parametrize("kind", SESSIONS)
def test_a_port_that_vanishes_is_a_device_error_and_closes_the_session(kind):
    make, ask = SESSIONS[kind]

    async def run() -> None:
        async with peers.serial_port(peers.plc(rtu=True, script=peers.mute)) as pair:
            session = make(pair.path)
            await session.connect()
            assert session.connected
            peers.vanish(pair)
            async with asyncio.timeout(5):
                with pytest.raises(DeviceTimeout, match="is gone"):
                    await ask(session)
            assert not session.connected
            await session.close()

    asyncio.run(run())


@pytest.mark.parametrize("kind", SESSIONS)
def test_a_port_that_isnt_there(kind, tmp_path):
    make, ask = SESSIONS[kind]

    async def run() -> None:
        session = make(tmp_path / "none")
        with pytest.raises(DeviceTimeout, match="No such file"):
            await session.connect()
        with pytest.raises(DeviceError, match="not connected"):
            await ask(session)

    asyncio.run(run())


def test_what_is_no_serial_port(tmp_path):
    file = tmp_path / "file"
    file.write_bytes(b"")

    async def run() -> None:
        session = PrinterSession(f"serial://{file}", 1)
        with pytest.raises(DeviceTimeout, match="Inappropriate ioctl"):
            await session.connect()

    asyncio.run(run())


def test_a_port_belongs_to_one_program():
    async def run() -> None:
        with peers.pty_pair() as pair:
            with serial.Serial(pair.path, exclusive=True):
                session = PrinterSession(f"serial://{pair.path}", 1)
                with pytest.raises(DeviceRefused, match="in use by another program"):
                    await session.connect()
            await session.connect()
            with pytest.raises(serial.SerialException, match="exclusively"):
                serial.Serial(pair.path, exclusive=True)
            await session.close()
            serial.Serial(pair.path, exclusive=True).close()

    asyncio.run(run())


def test_a_session_on_a_pty_can_be_opened_again_and_again():
    async def run() -> None:
        async with peers.serial_port(peers.plc(rtu=True)) as pair:
            session = PlcSession(f"modbus-rtu://{pair.path}?baud=921600")
            for _ in range(4):
                await session.connect()
                await session.poll()
            await session.close()

    asyncio.run(run())


def test_a_device_that_takes_no_more_bytes_is_told_of():
    async def run() -> None:
        with peers.pty_pair() as pair:
            stream = SerialStream(SerialEndpoint(pair.path, 9600), "printer")
            await stream.open(0)

            def fill() -> None:
                for _ in range(10_000):
                    stream.write(b"x" * 100)

            with pytest.raises(DeviceTimeout, match="stopped taking bytes"):
                fill()
            with contextlib.suppress(BlockingIOError):
                while os.read(pair.master, 1 << 16):
                    pass
            stream.write(b"again")
            async with asyncio.timeout(5):
                while True:
                    with contextlib.suppress(BlockingIOError):
                        assert os.read(pair.master, 100) == b"again"
                        break
                    await asyncio.sleep(0.001)
            stream.close()

    asyncio.run(run())


def test_a_device_that_floods_the_line_is_given_up():
    async def run() -> None:
        with peers.pty_pair() as pair:
            stream = SerialStream(SerialEndpoint(pair.path, 9600), "printer")
            await stream.open(0)
            async with asyncio.timeout(10):
                while stream.is_open:
                    pair.send(b"x" * 4000)
                    await asyncio.sleep(0)
            with pytest.raises(DeviceTimeout, match="far more than it was asked for"):
                await stream.read(asyncio.get_running_loop().time() + 1)
            stream.close()

    asyncio.run(run())
