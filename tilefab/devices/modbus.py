"""Modbus requests with pymodbus' frames and messages, but one at a time, never repeated, every answer checked.

pymodbus' own client takes what it must not: on a serial line a late answer to an earlier request, even one to another
function; over TCP an answer with transaction 0. It repeats writes, waits for seconds, and loses an answer behind noise.
So only its framers and message classes are used, on frames whose length, unit, function and sums were checked before.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Final

from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)
from serial import PARITY_EVEN

from tilefab.devices.endpoints import Endpoint, ModbusRtuEndpoint, ModbusTcpEndpoint
from tilefab.devices.streams import ByteStream, SerialStream, TcpStream
from tilefab.errors import DeviceError, DeviceProtocolError, DeviceRefused, DeviceTimeout

_DECODER: Final = DecodePDU(is_server=False)
_BITS_PER_CHAR: Final = 11
"""A start bit, eight data bits, even parity, a stop bit."""
_SILENT_CHARS: Final = 3.5
_SHORTEST_SILENCE_S: Final = 0.00175
"""Above 19200 baud the silence between frames no longer shrinks."""
_EXCEPTION_PDU: Final = 2
_MBAP: Final = 7
_READS: Final = (3, 23)
_WRITES: Final = (6, 16)
WRITE_LENGTH: Final = 5
"""Bytes of the message that answers a write: function, address, count or value."""
_POLL_CHARS: Final = 13
"""Of a request that writes one register and reads others."""
_MOST_KEPT: Final = 512
"""Bytes in which the beginning of an answer is looked for; none is longer."""
_EXCEPTIONS: Final = {
    1: "it doesn't know this function",
    2: "there is no such register, or it can't be written",
    3: "a value is outside its limits",
    4: "it failed inside",
    6: "it is busy",
}


class _Answers:
    """What links have in common: an answer's message is checked before it is decoded."""

    def __init__(self, device: str, unit: int) -> None:
        self._device, self._unit = device, unit

    def _decoded(self, request: ModbusPDU, pdu: bytes, pdu_length: int) -> ModbusPDU:
        if pdu[0] == request.function_code | 0x80 and len(pdu) == _EXCEPTION_PDU:
            code = pdu[1]
            reason = _EXCEPTIONS.get(code, "it gave no reason that Modbus has")
            raise DeviceRefused(
                f"{self._device}: refused Modbus function {request.function_code} with exception {code}: {reason}",
                device=self._device,
                code=code,
            )
        if pdu[0] != request.function_code:
            raise self._wrong(f"function {pdu[0]} answered function {request.function_code}")
        if len(pdu) != pdu_length:
            raise self._wrong(f"an answer has {len(pdu)} bytes instead of {pdu_length}")
        answer = _DECODER.decode(pdu)
        if answer is None:
            raise self._wrong("an answer can't be decoded")
        return answer

    def _wrong(self, what: str) -> DeviceProtocolError:
        return DeviceProtocolError(f"{self._device}: {what}: nothing of it was used", device=self._device)


class TcpLink(_Answers):
    """Modbus TCP. Whatever goes wrong ends the connection: a stream that was out of step once can't be trusted.

    Parameters
    ----------
    endpoint
        Where to.
    device
        Name of the device, for messages.
    """

    def __init__(self, endpoint: ModbusTcpEndpoint, device: str) -> None:
        super().__init__(device, endpoint.unit)
        self.stream: ByteStream = TcpStream(endpoint, device)
        self._framer = FramerSocket(_DECODER)
        self._transaction = 0

    async def ask(self, request: ModbusPDU, pdu_length: int, deadline: float) -> ModbusPDU:
        """Send a request and wait for its answer.

        Parameters
        ----------
        request
            What to ask.
        pdu_length
            Bytes that the message of an answer must have.
        deadline
            In the loop's time.

        Raises
        ------
        DeviceTimeout, DeviceProtocolError
            The connection is closed then.
        DeviceRefused
            If the unit answered with an exception.
        """
        try:
            if self.stream.discard():
                raise self._wrong("it sent bytes that nobody had asked for")
            self._transaction = self._transaction % 0xFFFF + 1
            request.dev_id, request.transaction_id = self._unit, self._transaction
            self.stream.write(self._framer.buildFrame(request))
            pdu = await self._frame(request.function_code, pdu_length, deadline)
            return self._decoded(request, pdu, pdu_length)
        except DeviceRefused:
            raise
        except BaseException:
            self.stream.close()
            raise

    async def open(self, deadline: float) -> None:
        """Connect; see `TcpStream.open`."""
        await self.stream.open(deadline)

    def distrust(self) -> None:
        """End the connection: what was received isn't the answer to what was asked."""
        self.stream.close()

    async def _frame(self, function: int, pdu_length: int, deadline: float) -> bytes:
        data = b""
        while True:
            data += await self.stream.read(deadline)
            if len(data) <= _MBAP:
                continue
            transaction, protocol, length = (int.from_bytes(data[i : i + 2], "big") for i in (0, 2, 4))
            if protocol != 0 or data[6] != self._unit:
                raise self._wrong("an answer's header isn't that of this unit")
            if transaction != self._transaction:
                raise self._wrong(f"an answer is to request {transaction}, not to {self._transaction}")
            wanted = _EXCEPTION_PDU if data[7] == function | 0x80 else pdu_length
            if length != 1 + wanted:
                raise self._wrong(f"an answer announces {length} bytes instead of {1 + wanted}")
            if len(data) > _MBAP + wanted:
                raise self._wrong("more bytes came than belong to an answer")
            if len(data) == _MBAP + wanted:
                _, _, _, pdu = self._framer.decode(data)
                return pdu


class RtuLink(_Answers):
    """Modbus RTU, 8E1. After a failure the line is left alone until no late answer can be under way any more.

    Parameters
    ----------
    endpoint
        Which serial port.
    device
        Name of the device, for messages.
    longest_pdu
        Bytes of the longest message that this unit is ever asked for.
    """

    def __init__(self, endpoint: ModbusRtuEndpoint, device: str, longest_pdu: int) -> None:
        super().__init__(device, endpoint.unit)
        self.stream: ByteStream = SerialStream(endpoint, device, PARITY_EVEN)
        self._framer = FramerRTU(_DECODER)
        self._char_s = _BITS_PER_CHAR / endpoint.baud
        self._gap_s = max(_SILENT_CHARS * self._char_s, _SHORTEST_SILENCE_S)
        self._late_s = self._gap_s + (longest_pdu + 3) * self._char_s
        self.poll_s = self._gap_s + _POLL_CHARS * self._char_s + self._late_s
        """How long the longest exchange takes on the line, in seconds."""
        self._in_step = False
        """Whether the last exchange ended with its answer and nothing has come since."""
        self._failed_s = float("-inf")

    async def ask(self, request: ModbusPDU, pdu_length: int, deadline: float) -> ModbusPDU:
        """Send a request and wait for its answer.

        Parameters
        ----------
        request
            What to ask.
        pdu_length
            Bytes that the message of an answer must have.
        deadline
            In the loop's time. Nothing is sent if the answer couldn't be here by then.

        Raises
        ------
        DeviceTimeout, DeviceProtocolError
            The line is quarantined then.
        DeviceRefused
            If the unit answered with an exception.
        """
        request.dev_id = self._unit
        frame = self._framer.buildFrame(request)
        await self._silence((len(frame) + pdu_length + 3) * self._char_s, deadline)
        self._in_step = False
        try:
            self.stream.write(frame)
            pdu = await self._frame(deadline)
            self._in_step = True
            return self._decoded(request, pdu, pdu_length)
        except DeviceRefused:
            raise
        except BaseException:
            self.distrust()
            raise

    async def open(self, deadline: float) -> None:
        """Open the port, and wait until the line is silent: whoever used it before may still be answered."""
        await self.stream.open(deadline)
        self.distrust()
        try:
            await self._silence(0, deadline)
        except BaseException:
            self.stream.close()
            raise

    def distrust(self) -> None:
        """Quarantine the line: what was received isn't the answer to what was asked."""
        self._in_step = False
        self._failed_s = asyncio.get_running_loop().time()

    async def _silence(self, exchange_s: float, deadline: float) -> None:
        """Wait until the line has been silent for long enough, dropping what comes."""
        loop = asyncio.get_running_loop()
        while True:
            if self.stream.discard():
                self._in_step = False
            if not self.stream.is_open:
                # Writing tells why.
                return
            since = self.stream.last_byte_s if self._in_step else max(self.stream.last_byte_s, self._failed_s)
            free_s = since + (self._gap_s if self._in_step else self._late_s)
            if max(free_s, loop.time()) + exchange_s > deadline:
                await asyncio.sleep(max(min(free_s, deadline) - loop.time(), 0))
                raise DeviceTimeout(
                    f"{self._device}: no time is left for an answer on its line: it must fall silent first",
                    device=self._device,
                )
            if free_s <= loop.time():
                return
            await asyncio.sleep(free_s - loop.time())

    async def _frame(self, deadline: float) -> bytes:
        """Message of the first sound frame in what comes, whatever noise surrounds it."""
        data = b""
        while True:
            data = data[-_MOST_KEPT:] + await self.stream.read(deadline)
            for start in range(len(data) - _EXCEPTION_PDU - 2):
                end = start + 1 + _pdu_length(data[start + 1 :])
                if data[start] != self._unit or end == start + 1 or len(data) < end + 2:
                    continue
                if FramerRTU.check_CRC(data[start:end], int.from_bytes(data[end : end + 2], "big")):
                    return data[start + 1 : end]


def _pdu_length(pdu: bytes) -> int:
    """Bytes of an answer's message that begins like this; 0 if it answers nothing that is ever asked."""
    function = pdu[0]
    if function & 0x80:
        return _EXCEPTION_PDU
    if function in _WRITES:
        return WRITE_LENGTH
    return 2 + pdu[1] if function in _READS else 0


def open_link(endpoint: Endpoint, device: str, window: int) -> TcpLink | RtuLink:
    """Make the link to a Modbus unit, not yet connected.

    Parameters
    ----------
    endpoint
        Where it is.
    device
        Name of the device, for messages.
    window
        Most registers that are read at once.

    Raises
    ------
    DeviceError
        If the endpoint is no Modbus unit's.
    """
    if isinstance(endpoint, ModbusTcpEndpoint):
        return TcpLink(endpoint, device)
    if isinstance(endpoint, ModbusRtuEndpoint):
        return RtuLink(endpoint, device, read_length(window))
    raise DeviceError(f"{device}: needs a modbus-tcp or modbus-rtu endpoint", device=device)


def read_length(count: int) -> int:
    """Bytes of the message that answers a read of registers: function, byte count, words."""
    return 2 + 2 * count


def read_request(address: int, count: int) -> ModbusPDU:
    """Read registers (function 3)."""
    return ReadHoldingRegistersRequest(address=address, count=count)


def write_read_request(write_address: int, words: Sequence[int], read_address: int, count: int) -> ModbusPDU:
    """Write registers, then read others, in one (function 23)."""
    return ReadWriteMultipleRegistersRequest(
        read_address=read_address, read_count=count, write_address=write_address, write_registers=list(words)
    )


def write_request(address: int, words: Sequence[int]) -> ModbusPDU:
    """Write one register (function 6) or several (function 16)."""
    if len(words) == 1:
        return WriteSingleRegisterRequest(address=address, registers=list(words))
    return WriteMultipleRegistersRequest(address=address, count=len(words), registers=list(words))


def is_answer_to_write(answer: ModbusPDU, address: int, words: Sequence[int]) -> bool:
    """Whether an answer tells of the same address and count, or value."""
    if len(words) == 1:
        return answer.address == address and list(answer.registers) == list(words)
    return answer.address == address and answer.count == len(words)
