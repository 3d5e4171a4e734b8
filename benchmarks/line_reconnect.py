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
import sys
import time
from pathlib import Path

import numpy as np
from figures import Figures
from machine import machine_name
from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.unit.devices import peers
from tests.unit.devices.reconnects import KINDS, Times

LANES = 5
MOST_NOTICE_S, MOST_RECOVERY_S = 0.5, 1.5
PLAIN_OUTAGE_S = 7.0


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
