"""Sessions with devices that are read and commanded through a window of Modbus registers."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Final

from tilefab.devices.endpoints import ModbusRtuEndpoint, ModbusTcpEndpoint, parse_endpoint
from tilefab.devices.modbus import (
    WRITE_LENGTH,
    RtuLink,
    is_answer_to_write,
    open_link,
    read_length,
    read_request,
    write_read_request,
    write_request,
)
from tilefab.devices.registers import ContentError, RegisterMap, Value, Write
from tilefab.devices.sequences import memory_of
from tilefab.devices.turns import Turns
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

DEADLINE_S: Final = 0.2
_STALE_S: Final = 0.3
_ACK_PAUSE_S: Final = 0.005
"""Between two polls for an acknowledgement; controllers scan every 10 ms."""
_SEQ, _HALF, _ALL = 0, 0x8000, 0x10000


class RegisterSession:
    """One host's way to one device; one request at a time, others wait their turn within their own deadline.

    Parameters
    ----------
    registers
        The device's map.
    endpoint
        Where it is, as text.
    deadline_s
        For each poll, connection or write, in seconds.
    name
        Of the device, for messages.

    Raises
    ------
    DeviceError
        If the endpoint isn't one, or its line is too slow for the deadline.
    """

    def __init__(self, registers: RegisterMap, endpoint: str, *, deadline_s: float, name: str) -> None:
        parsed = parse_endpoint(endpoint, device=name)
        self._map, self._deadline_s, self.name = registers, deadline_s, name
        self._link = open_link(parsed, name, registers.window)
        assert isinstance(parsed, ModbusTcpEndpoint | ModbusRtuEndpoint)
        self._fc23 = parsed.fc23
        self._memory = memory_of(endpoint)
        self._turns = Turns(deadline_s, name)
        self._checked = False
        """Whether this device has shown that it sends a check sum; from then on it must."""
        self._commanded: int | None = None
        self._last_words: tuple[int, ...] | None = None
        if isinstance(self._link, RtuLink) and self._link.poll_s > deadline_s:
            raise DeviceError(
                f"{name}: a poll takes {self._link.poll_s:.2f} s on its line, not {deadline_s:g} s: give it more baud",
                device=name,
            )

    @property
    def connected(self) -> bool:
        """Whether there is a connection that can be trusted."""
        return self._link.stream.is_open

    async def connect(self) -> None:
        """Connect, within the deadline.

        Raises
        ------
        DeviceTimeout
            If the device isn't there.
        """
        async with self._turns.mine() as deadline:
            await self._link.open(deadline)

    async def close(self) -> None:
        """Disconnect."""
        self._link.stream.close()
        # The loop lets go of the socket in its next turn.
        await asyncio.sleep(0)

    async def _poll_values(self) -> tuple[dict[str, Value], tuple[int, ...]]:
        """Read the window within the deadline, by name and as words."""
        async with self._turns.mine() as deadline:
            return await self._read(deadline)

    async def _command(self, values: Mapping[str, float | Sequence[float]]) -> tuple[dict[str, Value], tuple[int, ...]]:
        """Write a command block, read it back, and wait until the device has acted on it."""
        try:
            self._map.encode_command({**values, self._map.command[0]: 0})
        except ValueError as error:
            raise DeviceRefused(f"{self.name}: {error}", device=self.name) from None
        async with self._turns.mine() as deadline:
            if self._last_words is None:
                await self._read(deadline)
            number = self._next_command()
            writes = self._map.encode_command({**values, self._map.command[0]: number})
            self._commanded = number
            for write in writes:
                await self._write(write, deadline)
            return await self._acknowledged(number, writes, deadline + self._deadline_s)

    async def _read(self, deadline: float) -> tuple[dict[str, Value], tuple[int, ...]]:
        registers, number = self._map, self._memory.next_sequence()
        length = read_length(registers.window)
        if self._fc23:
            request = write_read_request(_SEQ, (number,), 0, registers.window)
            answer = await self._link.ask(request, length, deadline)
        else:
            await self._write(Write(_SEQ, (number,)), deadline)
            answer = await self._link.ask(read_request(0, registers.window), length, deadline)
        words = tuple(answer.registers)
        if len(words) != registers.window or words[_SEQ] != number:
            self._link.distrust()
            raise self._wrong(f"an answer is to poll {words[_SEQ] if words else '?'}, not to {number}")
        found, should = registers.check_words(words)
        self._checked = self._checked or found == should
        if found != should and (found or self._checked):
            self._link.distrust()
            raise self._wrong("the sum of an answer is wrong")
        try:
            values = registers.decode(words)
        except ContentError as error:
            raise self._wrong(str(error)) from None
        self._check_alive(int(registers.raw("boot_id", words)[0]), int(registers.raw("scan_counter", words)[0]))
        self._last_words = words
        return values, words

    def _check_alive(self, boot_id: int, scan: int) -> None:
        if boot_id == 0:
            raise self._wrong("its boot_id is 0: it isn't ready")
        still_s = self._memory.still_for_s(boot_id, scan, asyncio.get_running_loop().time())
        if still_s > _STALE_S:
            raise self._wrong(f"its scan counter has stood still for {still_s:.1f} s: its program doesn't run")

    async def _write(self, write: Write, deadline: float) -> None:
        answer = await self._link.ask(write_request(write.address, write.words), WRITE_LENGTH, deadline)
        if not is_answer_to_write(answer, write.address, write.words):
            self._link.distrust()
            raise self._wrong(f"an answer isn't to the write at {write.address}")

    def _next_command(self) -> int:
        """Number of the next command: newer than any that the device acted on, or may still act on."""
        assert self._last_words is not None
        acted = int(self._map.raw("cmd_ack", self._last_words)[0])
        there = int(self._map.raw(self._map.command[0], self._last_words)[0])
        newest = acted
        if self._commanded is not None and (self._commanded - acted) % _ALL < _HALF:
            newest = self._commanded
        number = (newest + 1) % _ALL
        # 0 is what a device shows that was just started; and only a number that changes is acted on.
        while number in (0, there):
            number = (number + 1) % _ALL
        return number

    async def _acknowledged(
        self, number: int, writes: Sequence[Write], deadline: float
    ) -> tuple[dict[str, Value], tuple[int, ...]]:
        loop = asyncio.get_running_loop()
        while True:
            values, words = await self._read(deadline)
            for write in writes:
                if words[write.address : write.address + len(write.words)] != write.words:
                    raise self._wrong(f"registers from {write.address} on read back other than they were written")
            if values["cmd_ack"] == number:
                return values, words
            # A poll that is cut short would cost the connection, so the last begins early enough.
            if loop.time() + self._deadline_s / 4 > deadline:
                raise DeviceTimeout(f"{self.name}: didn't act on a command in time", device=self.name)
            await asyncio.sleep(_ACK_PAUSE_S)

    def _wrong(self, what: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"{self.name}: {what}: nothing of it was used", device=self.name)
