"""The kiln's session."""

from __future__ import annotations

import asyncio
import struct

import pytest

from tests.unit.devices import peers
from tilefab.devices import KilnCommand, KilnSession, KilnStatus
from tilefab.errors import DeviceProtocolError, DeviceRefused

COMMAND = KilnCommand(tuple(1000.25 + i for i in range(8)), 7.5, 61.2)


def floats(*values: float) -> list[int]:
    return list(struct.unpack(f">{2 * len(values)}H", struct.pack(f">{len(values)}f", *values)))


def test_a_poll_reads_everything():
    unit = peers.kiln()
    unit.words[5:8] = 0b01001, 321, 505
    unit.words[10:26] = floats(*(900.5 + i for i in range(8)))
    unit.words[34:52] = floats(*(950.25 + i for i in range(8)), 12.5)

    async def run() -> KilnStatus:
        async with peers.tcp_unit(unit) as endpoint:
            session = KilnSession(endpoint)
            await session.connect()
            status = await session.poll()
            await session.close()
            return status

    assert asyncio.run(run()) == KilnStatus(
        boot_id=unit.words[2],
        heating=True,
        burner_fault=False,
        over_temp=False,
        at_set_point=True,
        blocked=False,
        tiles_inside=321,
        cycle_time_min=50.5,
        temperatures_degc=tuple(900.5 + i for i in range(8)),
        set_points_degc=tuple(950.25 + i for i in range(8)),
        ramp_limit_degc_min=12.5,
    )
    assert [pdu[:7] for pdu in unit.requests] == [struct.pack(">BHHH", 23, 0, 80, 0)]


def test_a_command_writes_what_is_wanted_before_its_number_and_never_a_register_between():
    unit = peers.kiln()

    async def run() -> KilnStatus:
        async with peers.tcp_unit(unit) as endpoint:
            session = KilnSession(endpoint)
            await session.connect()
            status = await session.command(COMMAND)
            await session.close()
            return status

    status = asyncio.run(run())
    assert status.set_points_degc == COMMAND.set_points_degc
    assert unit.words[34:52] == floats(*COMMAND.set_points_degc, 7.5)
    assert (unit.words[52], unit.words[33], unit.words[26]) == (612, 0, unit.words[32])
    writes = [struct.unpack(">BHH", pdu[:5]) for pdu in unit.requests if pdu[0] != 23]
    assert writes == [(16, 34, 19), (6, 32, unit.words[32])]


@pytest.mark.parametrize(
    "command",
    [
        KilnCommand((1000.0,) * 7, 5.0, 50.0),
        KilnCommand((1250.5,) + (1000.0,) * 7, 5.0, 50.0),
        KilnCommand((float("nan"),) * 8, 5.0, 50.0),
        KilnCommand((1000.0,) * 8, 15.1, 50.0),
        KilnCommand((1000.0,) * 8, 0.05, 50.0),
        KilnCommand((1000.0,) * 8, 5.0, 34.9),
    ],
)
def test_a_command_outside_the_limits_is_never_sent(command):
    unit = peers.kiln()

    async def run() -> None:
        async with peers.tcp_unit(unit) as endpoint:
            session = KilnSession(endpoint)
            await session.connect()
            with pytest.raises(DeviceRefused, match="must be"):
                await session.command(command)
            await session.close()

    asyncio.run(run())
    assert unit.requests == []


def test_floats_whose_words_are_swapped_are_refused():
    unit = peers.kiln()
    unit.words[3], unit.words[4] = unit.words[4], unit.words[3]

    async def run() -> None:
        async with peers.tcp_unit(unit) as endpoint:
            session = KilnSession(endpoint)
            await session.connect()
            with pytest.raises(DeviceProtocolError, match="other order"):
                await session.poll()
            await session.close()

    asyncio.run(run())
