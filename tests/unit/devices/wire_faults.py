"""Faults on the wire by the thousand, and whether a value was ever acted on that the device hadn't just sent."""

from __future__ import annotations

import asyncio
import contextlib
import random
import struct
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Literal

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException

from tests.unit.devices import peers
from tilefab.devices import ArmCommand, ArmStatus, PlcCommand, PlcSession, PlcStatus, PrinterSession
from tilefab.errors import DeviceError

KINDS = ("garbled", "truncated", "noisy", "late", "doubled", "reordered")
Wire = Literal["tcp", "rtu", "printer"]
_RATE = 0.6
_BAUD = 4_000_000
_COMMANDS = 0.15


@dataclass
class Tally:
    """What came of a run."""

    faults: Counter[str] = field(default_factory=Counter)
    calls: int = 0
    answered: int = 0
    wrong: int = 0


class Faults:
    """Puts faults on the answers of one device."""

    def __init__(self, tally: Tally, rng: random.Random, deadline_s: float) -> None:
        self._tally, self._rng, self._deadline_s = tally, rng, deadline_s
        self._older: list[bytes] = []

    def __call__(self, frame: bytes, send: peers.Send) -> None:
        rng = self._rng
        self._older = [*self._older[-3:], frame]
        if rng.random() >= _RATE:
            send(frame)
            return
        kind = rng.choice(KINDS)
        self._tally.faults[kind] += 1
        getattr(self, kind)(frame, send)

    def garbled(self, frame: bytes, send: peers.Send) -> None:
        data = bytearray(frame)
        for _ in range(self._rng.randint(1, 4)):
            data[self._rng.randrange(len(data))] ^= self._rng.randint(1, 255)
        send(bytes(data))

    def truncated(self, frame: bytes, send: peers.Send) -> None:
        send(frame[: self._rng.randrange(1, len(frame))])

    def noisy(self, frame: bytes, send: peers.Send) -> None:
        before, after = (self._rng.randbytes(self._rng.randint(0, 12)) for _ in range(2))
        send(before + frame + (after or b"\x01"))

    def late(self, frame: bytes, send: peers.Send) -> None:
        asyncio.get_running_loop().call_later(self._deadline_s * self._rng.uniform(0.8, 3), send, frame)

    def doubled(self, frame: bytes, send: peers.Send) -> None:
        send(frame)
        if self._rng.random() < 0.5:
            send(frame)
        else:
            asyncio.get_running_loop().call_later(self._deadline_s * self._rng.uniform(0, 1), send, frame)

    def reordered(self, frame: bytes, send: peers.Send) -> None:
        send(self._older[0])
        if self._rng.random() < 0.5:
            send(frame)


class Conveyor(peers.Unit):
    """A conveyor's controller whose every register is another at each answer."""

    def __init__(self, rng: random.Random, script: peers.Script, *, rtu: bool, sums: bool = True) -> None:
        super().__init__(window=64, unit=1, probe=(0x0102, 0x0304), rtu=rtu, script=script, sums=sums)
        self._rng = rng
        self.latest: list[int] = []

    def answer(self, pdu: bytes) -> bytes:
        ack = self.words[19]
        self.words[5:23] = struct.unpack(">18H", self._rng.randbytes(36))
        self.words[5] &= 0x1FF
        self.words[19] = ack
        answer = super().answer(pdu)
        if pdu[0] == 23:
            self.latest = self.shown()
        return answer


def status_of(words: list[int]) -> PlcStatus:
    """What a window says, read by hand."""
    flags = [bool(words[5] >> bit & 1) for bit in range(9)]
    position, tile, at, decided, passed = struct.unpack(">IIIIQ", struct.pack(">12H", *words[7:19]))
    return PlcStatus(
        words[2],
        words[1],
        *flags,
        words[6] / 10,
        position,
        tile,
        at,
        decided,
        passed,
        words[19],
        words[20],
        words[21] << 16 | words[22],
    )


def command_words(command: PlcCommand) -> list[int]:
    lengths = [round(10 * value) for value in (command.speed_mm_s, command.tile_length_mm, command.tile_pitch_mm)]
    return [
        command.run_belt + 2 * command.feed,
        *lengths,
        *divmod(command.release_base, 65536),
        *divmod(command.release_bits, 65536),
        command.ack_fault,
    ]


async def _conveyor_calls(unit: Conveyor, session: PlcSession, tally: Tally, rng: random.Random) -> None:
    tally.calls += 1
    try:
        if not session.connected:
            await session.connect()
        if rng.random() >= _COMMANDS:
            status = await session.poll()
            good = status == status_of(unit.latest)
        else:
            command = PlcCommand(
                rng.random() < 0.5,
                rng.random() < 0.5,
                rng.randint(0, 30000) / 10,
                rng.randint(500, 30000) / 10,
                rng.randint(600, 40000) / 10,
                rng.getrandbits(32),
                rng.getrandbits(32),
                rng.getrandbits(16),
            )
            status = await session.command(command)
            good = status == status_of(unit.latest) and unit.words[33:42] == command_words(command)
    except DeviceError:
        return
    tally.answered += 1
    tally.wrong += not good


class ArmingPrinter(peers.Printer):
    """A printer that tells something else each time, and counts how often it acted on an arm."""

    def __init__(self, rng: random.Random, script: peers.Script) -> None:
        super().__init__(script=script, on_request=self._answer)
        self._rng = rng
        self.encoder = 0
        self.arms: Counter[int] = Counter()

    def _answer(self, kind: int, payload: bytes) -> bytes | None:
        if kind == 2:
            self.encoder = self._rng.getrandbits(64)
            return struct.pack("<IHQIQQBI8HH", 7, 1, self.encoder, 1, 2, 3, 4, 5, *[500] * 8, 6)
        if kind == 4:
            arm_id = int.from_bytes(payload[:8], "little")
            self.arms[arm_id] += 1
            return struct.pack("<BQ", 0, arm_id)
        return None


async def _printer_calls(printer: ArmingPrinter, session: PrinterSession, tally: Tally, rng: random.Random) -> None:
    tally.calls += 1
    try:
        if not session.connected:
            await session.connect()
        if rng.random() >= _COMMANDS:
            good = (await session.status()).encoder_counts == printer.encoder
        else:
            arm_id = tally.calls
            reply = await session.arm(ArmCommand(arm_id, 1, 1, 1, 1, 1, 1, 1, 1))
            good = (
                printer.arms[arm_id] == 1 and reply.status is ArmStatus.ACCEPTED and reply.last_accepted_arm == arm_id
            )
    except DeviceError:
        return
    tally.answered += 1
    tally.wrong += not good


async def _ours(wire: Wire, tally: Tally, most: int, rng: random.Random, deadline_s: float, sums: bool) -> None:
    faults = Faults(tally, rng, deadline_s)
    session: PlcSession | PrinterSession
    async with contextlib.AsyncExitStack() as stack:
        if wire == "printer":
            printer = ArmingPrinter(rng, faults)
            pair = await stack.enter_async_context(peers.serial_port(printer))
            session = arming = PrinterSession(f"serial://{pair.path}?baud={_BAUD}", 1, deadline_s=deadline_s)
            call: Callable[[], Awaitable[None]] = partial(_printer_calls, printer, arming, tally, rng)
        else:
            unit = Conveyor(rng, faults, rtu=wire == "rtu", sums=sums)
            if wire == "rtu":
                pair = await stack.enter_async_context(peers.serial_port(unit))
                endpoint = f"modbus-rtu://{pair.path}?baud={_BAUD}"
            else:
                endpoint = await stack.enter_async_context(peers.tcp_unit(unit))
            session = polling = PlcSession(endpoint, deadline_s=deadline_s)
            call = partial(_conveyor_calls, unit, polling, tally, rng)
        while tally.faults.total() < most:
            await call()
        await session.close()
        if wire == "printer":
            tally.wrong += sum(count > 1 for count in printer.arms.values())


async def _plain(wire: Wire, tally: Tally, most: int, rng: random.Random, deadline_s: float, sums: bool) -> None:
    faults = Faults(tally, rng, deadline_s)
    unit = Conveyor(rng, faults, rtu=wire == "rtu", sums=sums)
    options = {"timeout": deadline_s, "retries": 0, "reconnect_delay": 0}
    async with contextlib.AsyncExitStack() as stack:
        client: AsyncModbusSerialClient | AsyncModbusTcpClient
        if wire == "rtu":
            pair = await stack.enter_async_context(peers.serial_port(unit))
            client = AsyncModbusSerialClient(pair.path, baudrate=_BAUD, **options)
        else:
            port = await stack.enter_async_context(peers.tcp_port(unit))
            client = AsyncModbusTcpClient("127.0.0.1", port=port.port, **options)
        seq = 0
        while tally.faults.total() < most:
            tally.calls += 1
            seq = seq % 65535 + 1
            with contextlib.suppress(ModbusException):
                if not client.connected:
                    await client.connect()
                answer = await client.readwrite_registers(read_count=64, address=0, values=[seq], device_id=1)
                if not answer.isError():
                    tally.answered += 1
                    tally.wrong += answer.registers != unit.latest
        client.close()


def run(
    wire: Wire,
    faults: int,
    *,
    seed: int,
    connections: int = 8,
    deadline_s: float = 0.02,
    plain: bool = False,
    sums: bool = True,
) -> Tally:
    """Poll and command devices until so many of their answers were spoilt.

    Parameters
    ----------
    plain
        With pymodbus' own client instead of our sessions.
    sums
        Whether the devices fill the check words of their windows.
    """
    tally = Tally()
    work = _plain if plain else _ours

    async def all_of_it() -> None:
        streams = [random.Random(f"{wire} {seed} {n}") for n in range(connections)]
        await asyncio.gather(*(work(wire, tally, faults, rng, deadline_s, sums) for rng in streams))

    asyncio.run(all_of_it())
    return tally
