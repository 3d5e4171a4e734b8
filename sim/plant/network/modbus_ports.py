"""Modbus over TCP and over a serial line, for the conveyor's and the kiln's controllers."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

from sim.plant.network.faults import Link, answer_through
from sim.plant.network.serial_port import SerialPort
from sim.plant.network.service import Service
from sim.plant.wire.modbus import MOST_RTU, MOST_TCP, answer, rtu_frame, rtu_length, rtu_request, tcp_answer
from sim.plant.wire.window import Window

_SILENCE_S = 0.03


class ModbusTcp(asyncio.Protocol):
    """One connection of a Modbus TCP host.

    Parameters
    ----------
    service
        The plant.
    device
        `plc` or `kiln`.
    window
        Its registers.
    peers
        All connections of the device; this one adds itself while it is open.
    """

    def __init__(self, service: Service, device: str, window: Window, peers: set[ModbusTcp]) -> None:
        self._service = service
        self._device = device
        self._names = (device, f"{device}_tcp")
        self._window = window
        self._peers = peers
        self._buffer = bytearray()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the connection, unless the device is off."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        loop = asyncio.get_running_loop()

        def send(data: bytes) -> None:
            if not transport.is_closing():
                transport.write(data)

        def later(delay_s: float, call: Callable[[], None]) -> None:
            loop.call_later(delay_s, call)

        self._link = Link(send, self.drop, later, "tcp")
        if self._service.up(self._device):
            self._peers.add(self)
        else:
            transport.abort()

    def connection_lost(self, _exc: Exception | None) -> None:
        """Forget the connection."""
        self._link.deaf = True
        self._peers.discard(self)

    def drop(self) -> None:
        """End the connection at once."""
        self._link.deaf = True
        self._transport.abort()

    def data_received(self, data: bytes) -> None:
        """Answer every whole frame; what isn't Modbus ends the connection."""
        self._buffer += data
        while len(self._buffer) >= 8 and not self._transport.is_closing():
            size = 6 + int.from_bytes(self._buffer[4:6], "big")
            if self._buffer[2:4] != b"\0\0" or not 8 <= size <= MOST_TCP:
                self._transport.abort()
                return
            if len(self._buffer) < size:
                return
            frame = bytes(self._buffer[:size])
            del self._buffer[:size]
            self._answer(frame)

    def _answer(self, frame: bytes) -> None:
        def act() -> bytes | None:
            with self._service.now():
                return tcp_answer(self._window, frame) if self._service.up(self._device) else None

        answer_through(self._service.strike(self._names, frame[7]), self._link, act)


class ModbusRtu:
    """A Modbus RTU slave on a serial line.

    Parameters
    ----------
    service
        The plant.
    window
        Registers of the conveyor's controller.
    path, baud
        The line; 8 bits, even parity, one stop bit.
    """

    def __init__(self, service: Service, window: Window, path: Path, baud: int) -> None:
        self._service = service
        self._window = window
        self._buffer = bytearray()
        self._loop = asyncio.get_running_loop()
        self._silence: asyncio.TimerHandle | None = None
        self.port = SerialPort(path, baud, 11, self._received)
        self._new_link()

    def _new_link(self) -> None:
        self._link = Link(self.port.send, self.hang_up, self.port.later, "rtu", revive=self.reset)

    def reset(self) -> None:
        """Forget everything that is on its way."""
        self._buffer.clear()
        self.port.reset()
        self._new_link()

    def hang_up(self) -> None:
        """Break the line, and offer a new one."""
        self._link.deaf = True
        self._buffer.clear()
        self.port.hang_up()
        self._new_link()

    def _received(self, data: bytes) -> None:
        self._buffer += data
        if self._silence is not None:
            self._silence.cancel()
        while self._buffer:
            size = rtu_length(self._buffer)
            if size is None or len(self._buffer) < size:
                break
            # No request that it knows, or nonsense: whatever it is ends with a silence.
            if size == 0 or size > MOST_RTU:
                break
            frame = bytes(self._buffer[:size])
            del self._buffer[:size]
            self._answer(frame)
        if self._buffer:
            self._silence = self._loop.call_later(_SILENCE_S, self._silent)

    def _silent(self) -> None:
        frame = bytes(self._buffer)
        self._buffer.clear()
        self._answer(frame)

    def _answer(self, frame: bytes) -> None:
        request = rtu_request(self._window.unit, frame)
        if request is None:
            return

        def act() -> bytes | None:
            with self._service.now():
                if not self._service.up("plc"):
                    return None
                return rtu_frame(self._window.unit, answer(self._window, request))

        answer_through(self._service.strike(("plc", "plc_rtu"), request[0]), self._link, act)

    def close(self) -> None:
        """Close the line."""
        if self._silence is not None:
            self._silence.cancel()
        self._link.deaf = True
        self.port.close()
