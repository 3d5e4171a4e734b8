"""The conveyor's session: what a poll takes and refuses, and what a command writes, reads back and waits for."""

from __future__ import annotations

import asyncio

from tests.unit.devices import peers
from tilefab.devices import PlcCommand, PlcSession

COMMAND = PlcCommand(True, True, 500.0, 600.0, 650.0, 7, 0b101, 3)


def test_smoke():
    async def work():
        unit = peers.plc()
        unit.words[5] = 0b1000011
        unit.words[7:9] = (1, 2)
        async with peers.tcp_unit(unit) as endpoint:
            s = PlcSession(endpoint)
            await s.connect()
            print(await s.poll())
            print(await s.command(COMMAND))
            await s.close()
        unit = peers.plc(rtu=True)
        async with peers.serial_port(unit) as pair:
            s = PlcSession(f"modbus-rtu://{pair.path}?baud=19200")
            await s.connect()
            print(await s.poll())
            print(await s.command(COMMAND))
            await s.close()

    asyncio.run(work())
