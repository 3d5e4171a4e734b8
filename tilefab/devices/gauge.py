"""The gauge at the kiln's exit: colour of fired tiles, in lines of text."""

from __future__ import annotations

import asyncio
import math
import re
import zlib
from dataclasses import dataclass
from typing import Final

from tilefab.devices.endpoints import SerialEndpoint, parse_endpoint
from tilefab.devices.sequences import memory_of
from tilefab.devices.streams import SerialStream
from tilefab.devices.turns import Turns
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused

MOST_LINE: Final = 120
_DEADLINE_S: Final = 0.2
_LINE: Final = re.compile(rb"!([ -)+-~]+)\*([0-9a-fA-F]{8})\r?")
_WHOLE: Final = re.compile(r"[0-9]{1,10}")
_NUMBER: Final = re.compile(r"-?[0-9]{1,3}(\.[0-9]{1,6})?")
_FIELDS: Final = 6
_MOST_L, _MOST_AB = 100.0, 200.0


@dataclass(frozen=True)
class GaugeReading:
    """One reading.

    Attributes
    ----------
    readings
        So far, since the gauge's start.
    lab_d50
        L* from 0 to 100, a*, b*.
    tiles
        Tiles that left the kiln since the gauge's start.
    """

    readings: int
    lab_d50: tuple[float, float, float]
    tiles: int


def parse_reply(line: bytes, sequence: int) -> tuple[str, ...] | None:
    """Fields of a reply line to a request after its number; ``None`` if it is no sound line, or another's reply.

    Parameters
    ----------
    line
        Without its line feed.
    sequence
        Of the request.
    """
    found = _LINE.fullmatch(line) if len(line) < MOST_LINE else None
    if found is None or zlib.crc32(found[1]) != int(found[2], 16):
        return None
    first, *fields = found[1].decode("ascii").split(" ")
    if first != str(sequence) or not fields:
        return None
    return tuple(fields)


class GaugeSession:
    """A session with the gauge.

    Parameters
    ----------
    endpoint
        ``serial:///PATH?baud=N``.
    deadline_s
        For each request, in seconds.
    name
        Of the device, for messages.

    Raises
    ------
    DeviceError
        If the endpoint is no serial line.
    """

    def __init__(self, endpoint: str, *, deadline_s: float = _DEADLINE_S, name: str = "gauge") -> None:
        parsed = parse_endpoint(endpoint, device=name)
        if not isinstance(parsed, SerialEndpoint):
            raise DeviceError(f"{name}: {endpoint!r} must be a serial endpoint", device=name)
        self._stream = SerialStream(parsed, name)
        self.name = name
        self._memory = memory_of(endpoint)
        self._turns = Turns(deadline_s, name)

    @property
    def connected(self) -> bool:
        """Whether the port is open."""
        return self._stream.is_open

    async def connect(self) -> None:
        """Open the port; raises as `PrinterSession.connect` does."""
        async with self._turns.mine() as deadline:
            await self._stream.open(deadline)

    async def close(self) -> None:
        """Give the port up."""
        self._stream.close()
        await asyncio.sleep(0)

    async def measure(self) -> GaugeReading:
        """Take a reading.

        Raises
        ------
        DeviceTimeout
            If no sound line answered within the deadline.
        DeviceRefused
            If the gauge can't measure, with its code.
        DeviceProtocolError
            If the answer makes no sense.
        """
        async with self._turns.mine() as deadline:
            fields = await self._ask("M", deadline)
        return self._reading(fields)

    async def _ask(self, what: str, deadline: float) -> tuple[str, ...]:
        sequence = self._memory.next_sequence()
        self._stream.discard()
        self._stream.write(f"?{sequence} {what}\n".encode("ascii"))
        rest = b""
        while True:
            *lines, rest = (rest + await self._stream.read(deadline)).split(b"\n")
            rest = rest[-MOST_LINE:]
            for line in lines:
                # Noise may stand before a line; only what begins at its last mark can be one.
                fields = parse_reply(line[max(line.rfind(b"!"), 0) :], sequence)
                if fields is not None:
                    return fields

    def _reading(self, fields: tuple[str, ...]) -> GaugeReading:
        if fields[0] == "E":
            if len(fields) != 2 or not _WHOLE.fullmatch(fields[1]):
                raise self._wrong("an error without a code")
            code = int(fields[1])
            raise DeviceRefused(f"{self.name}: can't measure: error {code}", device=self.name, code=code)
        if (
            len(fields) != _FIELDS - 1
            or not all(_WHOLE.fullmatch(field) for field in (fields[0], fields[4]))
            or not all(_NUMBER.fullmatch(field) for field in fields[1:4])
        ):
            raise self._wrong("a reading that is none")
        lightness, a, b = (float(field) for field in fields[1:4])
        if not 0 <= lightness <= _MOST_L or math.hypot(a, b) > _MOST_AB:
            raise self._wrong("a colour that no tile has")
        return GaugeReading(int(fields[0]), (lightness, a, b), int(fields[4]))

    def _wrong(self, what: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"{self.name}: answered {what}: nothing of it was used", device=self.name)
