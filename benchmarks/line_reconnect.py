"""How soon a dead device is noticed, and how soon it is used again once it is back.

Usage: python benchmarks/line_reconnect.py [--count N] [--seed SEED]

Scripted devices on loopback sockets and ptys die and come back at random moments: their connections are reset and their
port is closed; or nothing is heard of them any more, on connections that stay open; the same on an RTU line and on the
printer's. Sessions are polled every 50 ms and connected anew after the pauses of `Backoff`. The plain client of
pymodbus is timed once for comparison.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import random
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.unit.devices import peers
from tilefab.devices import Backoff, PlcSession, PrinterSession
from tilefab.errors import DeviceError

LANES = 5
PERIOD_S = 0.05
MOST_NOTICE_S, MOST_RECOVERY_S = 0.5, 1.5
PLAIN_OUTAGE_S = 7.0
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


def mute(_frame: bytes, _send: peers.Send) -> None:
    """Answer nothing."""


async def closed(count: int, rng: random.Random, times: Times) -> None:
    """Connections are reset, the port is closed."""
    async with peers.tcp_port(peers.plc()) as port:
        session = PlcSession(f"modbus-tcp://127.0.0.1:{port.port}")
        await Lane(session, session.poll, port.stop, port.start, rng).run(count, times)


def silence(device: peers.Unit | peers.Printer) -> tuple[Callable[[], Awaitable[None]], Callable[[], Awaitable[None]]]:
    """Ways to make a device mute, and to let it answer again."""

    async def die() -> None:
        device.script = mute

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


async def plain_notice() -> float:
    """Seconds until a call of the plain client ends whose peer dies as it is asked."""
    ports: list[peers.TcpPort] = []

    def die(_frame: bytes, _send: peers.Send) -> None:
        for transport in ports[0].transports:
            transport.abort()

    async with peers.tcp_port(peers.plc(script=die)) as port:
        ports.append(port)
        client = AsyncModbusTcpClient("127.0.0.1", port=port.port, reconnect_delay=0)
        await client.connect()
        begin = time.perf_counter()
        with contextlib.suppress(ModbusException):
            await client.read_holding_registers(0, count=1, device_id=1)
        client.close()
        return time.perf_counter() - begin


async def plain_recovery() -> float:
    """Seconds until the plain client is connected again after an outage."""
    async with peers.tcp_port(peers.plc()) as port:
        client = AsyncModbusTcpClient("127.0.0.1", port=port.port)
        await client.connect()
        await port.stop()
        await asyncio.sleep(PLAIN_OUTAGE_S)
        await port.start()
        begin = time.perf_counter()
        while not client.connected:
            await asyncio.sleep(0.01)
        client.close()
        return time.perf_counter() - begin


async def all_of_it(count: int, seed: int) -> tuple[dict[str, Times], float, float]:
    """Run all lanes and the plain client side by side."""
    times = {name: Times() for name in KINDS}
    lanes = [(name, lane) for name in KINDS for lane in range(LANES)]
    shares = [count // len(lanes) + (i < count % len(lanes)) for i in range(len(lanes))]
    work = [
        KINDS[name](share, random.Random(f"{name} {lane} {seed}"), times[name])
        for (name, lane), share in zip(lanes, shares, strict=True)
    ]
    notice, recovery, *_ = await asyncio.gather(plain_notice(), plain_recovery(), *work)
    return times, notice, recovery


def main() -> int:
    """Run; the exit code tells whether what was to reach was reached."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in ("pymodbus.logging", "asyncio"):
        logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    begin = time.perf_counter()
    times, plain_noticed, plain_recovered = asyncio.run(all_of_it(options.count, options.seed))
    figures = Figures()
    print(machine_name())
    done = sum(len(one.recovery) for one in times.values())
    for title, pick, most in (
        ("Seconds until a dead device is noticed: median / p99 / most", lambda one: one.notice, MOST_NOTICE_S),
        ("Seconds until it is used again once it is back", lambda one: one.recovery, MOST_RECOVERY_S),
    ):
        figures.title(title)
        every = [value for one in times.values() for value in pick(one)]
        rows = [(f"{name}, {len(pick(one))}", pick(one)) for name, one in times.items() if pick(one)]
        for name, values in rows:
            figures.row(name, [float(np.median(values)), float(np.percentile(values, 99)), max(values)])
        figures.row(f"all, {len(every)}", [float(np.percentile(every, 99)), max(every)], [most, most], "(p99, most)")
    figures.title("Plain client of pymodbus")
    figures.note("until a call ends whose peer died", f"{plain_noticed:.1f}")
    figures.note(f"until it is connected again after {PLAIN_OUTAGE_S:g} s", f"{plain_recovered:.1f}")
    print(f"\n{done} reconnects in {time.perf_counter() - begin:.0f} s")
    return 0 if figures.reached == figures.judged else 1


if __name__ == "__main__":
    sys.exit(main())
