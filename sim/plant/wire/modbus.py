"""Modbus: what the device does with a request, and the frames of TCP and RTU around it."""

from __future__ import annotations

import struct

from sim.plant.checks import crc16
from sim.plant.wire.window import RefusedError, Window

_READ, _WRITE_ONE, _WRITE_MANY, _READ_WRITE = 3, 6, 16, 23
MOST_TCP = 260
MOST_RTU = 256
_NO_UNIT = 11


def answer(window: Window, request: bytes) -> bytes:
    """Carry out a request.

    Parameters
    ----------
    request
        Function code and data, without unit or checksum.

    Returns
    -------
    bytes
        The answer's function code and data; an exception where the request was refused.
    """
    function = request[0]
    try:
        return bytes([function]) + _done(window, function, request[1:])
    except RefusedError as refused:
        return bytes([function | 0x80, refused.code])


def _done(window: Window, function: int, data: bytes) -> bytes:
    if function not in (_READ, _WRITE_ONE, _WRITE_MANY, _READ_WRITE):
        raise RefusedError(1)
    least = {_WRITE_MANY: 5, _READ_WRITE: 9}.get(function)
    if len(data) < least if least else len(data) != 4:
        raise RefusedError(3)
    first, second = struct.unpack_from(">HH", data)
    if function == _READ:
        return _block(window.read(first, second))
    if function == _WRITE_ONE:
        window.write(first, [second])
        return data[:4]
    if function == _WRITE_MANY:
        window.write(first, _values(data[4:], second))
        return data[:4]
    address, count = struct.unpack_from(">HH", data, 4)
    values = _values(data[8:], count)
    window.read(first, second)
    window.write(address, values)
    return _block(window.read(first, second))


def _values(data: bytes, count: int) -> list[int]:
    if data[0] != 2 * count or len(data) != 1 + data[0]:
        raise RefusedError(3)
    return list(struct.unpack_from(f">{count}H", data, 1))


def _block(values: list[int]) -> bytes:
    return struct.pack(f">B{len(values)}H", 2 * len(values), *values)


def rtu_length(data: bytes | bytearray) -> int | None:
    """Length of the request that a run of bytes begins with; None while it can't be told, 0 if it is no request."""
    if len(data) < 2:
        return None
    function = data[1]
    if function in (_READ, _WRITE_ONE):
        return 8
    at = {_WRITE_MANY: 6, _READ_WRITE: 10}.get(function)
    if at is None:
        return 0
    return None if len(data) <= at else at + 3 + data[at]


def rtu_frame(unit: int, body: bytes) -> bytes:
    """Put unit and checksum around an answer."""
    frame = bytes([unit]) + body
    return frame + crc16(frame).to_bytes(2, "little")


def rtu_request(unit: int, frame: bytes) -> bytes | None:
    """Function code and data of a frame; None for what a device on this line is silent about: damage, other units."""
    if len(frame) < 4 or crc16(frame[:-2]) != int.from_bytes(frame[-2:], "little") or frame[0] != unit:
        return None
    return frame[1:-2]


def tcp_frame(tid: int, unit: int, body: bytes) -> bytes:
    """Put the header of Modbus TCP before an answer."""
    return struct.pack(">HHHB", tid, 0, len(body) + 1, unit) + body


def tcp_answer(window: Window, frame: bytes) -> bytes:
    """Answer a frame; another unit is no unit behind this gateway."""
    tid, _, _, unit = struct.unpack_from(">HHHB", frame)
    body = frame[7:]
    if unit != window.unit:
        return tcp_frame(tid, unit, bytes([body[0] | 0x80, _NO_UNIT]))
    return tcp_frame(tid, unit, answer(window, body))
