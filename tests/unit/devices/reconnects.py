"""Devices that die and come back, and hosts that notice both."""

from __future__ import annotations

import asyncio
import random
import struct
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

from tests.unit.devices import peers
from tilefab.devices import Backoff, PlcSession, PrinterSession
from tilefab.errors import DeviceError

PERIOD_S = 0.05
STATUS_REPLY = struct.pack("<IHQIQQBI8HH", 7, 1, 0, 1, 2, 3, 4, 5, *[500] * 8, 6)


@dataclass
class Times:
    """Seconds from death to the first error, and from the return to the first answer."""

    notice: list[float] = field(default_factory=list)
    recovery: list[float] = field(default_factory=list)


class Lane:
    """One device, one host that polls it, and what befalls the device."""

    def __init__(
        self,
        session: PlcSession | PrinterSession,
        ask: Callable[[], Awaitable[object]],
        die: Callable[[], Awaitable[None]],
        come_back: Callable[[], Awaitable[None]],
        rng: random.Random,
    ) -> None:
        self._session, self._ask, self._die, self._come_back, self._rng = session, ask, die, come_back, rng
        self._failed, self._answered = asyncio.Event(), asyncio.Event()

    async def _poll(self) -> None:
        backoff = Backoff()
        while True:
            pause = PERIOD_S
            try:
                if not self._session.connected:
                    await self._session.connect()
                await self._ask()
            except DeviceError:
                self._failed.set()
                if not self._session.connected:
                    pause = backoff.next_s()
            else:
                backoff.reset()
                self._answered.set()
            await asyncio.sleep(pause)

    async def run(self, count: int, times: Times) -> None:
        """Die and come back so many times."""
        polling = asyncio.create_task(self._poll())
        await self._answered.wait()
        for _ in range(count):
            await asyncio.sleep(self._rng.uniform(0.05, 0.3))
            await self._die()
            self._failed.clear()
            begin = time.perf_counter()
            await self._failed.wait()
            times.notice.append(time.perf_counter() - begin)
            await asyncio.sleep(self._rng.uniform(0, 1.2))
            await self._come_back()
            self._answered.clear()
            begin = time.perf_counter()
            await self._answered.wait()
            times.recovery.append(time.perf_counter() - begin)
        polling.cancel()
        await asyncio.wait([polling])
        await self._session.close()


async def closed(count: int, rng: random.Random, times: Times) -> None:
    """Connections are reset, the port is closed."""
    async with peers.tcp_port(peers.plc()) as port:
        session = PlcSession(f"modbus-tcp://127.0.0.1:{port.port}")
        await Lane(session, session.poll, port.stop, port.start, rng).run(count, times)


def silence(device: peers.Unit | peers.Printer) -> tuple[Callable[[], Awaitable[None]], Callable[[], Awaitable[None]]]:
    """Ways to make a device mute, and to let it answer again."""

    async def die() -> None:
        device.script = peers.mute

    async def come_back() -> None:
        device.script = peers.plainly

    return die, come_back


async def half_open(count: int, rng: random.Random, times: Times) -> None:
    """Connections stay open and new ones are taken, but nothing is answered."""
    unit = peers.plc()
    async with peers.tcp_unit(unit) as endpoint:
        session = PlcSession(endpoint)
        await Lane(session, session.poll, *silence(unit), rng).run(count, times)


async def rtu(count: int, rng: random.Random, times: Times) -> None:
    """A serial line on which nothing answers."""
    unit = peers.plc(rtu=True)
    async with peers.serial_port(unit) as pair:
        session = PlcSession(f"modbus-rtu://{pair.path}?baud=19200")
        await Lane(session, session.poll, *silence(unit), rng).run(count, times)


async def printer(count: int, rng: random.Random, times: Times) -> None:
    """The printer's line, on which nothing answers."""
    device = peers.Printer({2: STATUS_REPLY})
    async with peers.serial_port(device) as pair:
        session = PrinterSession(f"serial://{pair.path}?baud=921600", 1)
        await Lane(session, session.status, *silence(device), rng).run(count, times)


KINDS = {
    "Modbus TCP, reset and closed": closed,
    "Modbus TCP, half open": half_open,
    "Modbus RTU, 19200 baud, mute": rtu,
    "printer, mute": printer,
}
