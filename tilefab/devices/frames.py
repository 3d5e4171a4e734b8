"""Frames of the printer's control protocol TFP 1: consistent overhead byte stuffing, and a sum."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Final

_HEAD: Final = struct.Struct("<IHB")
_SUM: Final = struct.Struct("<I")
_RUN: Final = 254
MOST_BODY: Final = 250
_MOST_WIRE: Final = MOST_BODY + 2


@dataclass(frozen=True)
class Frame:
    """A frame's contents.

    Attributes
    ----------
    session
        Of the host, 32 bits.
    seq
        Of the request, 16 bits; a reply has that of its request.
    type
        Of the message.
    payload
        What the type says.
    """

    session: int
    seq: int
    type: int
    payload: bytes


def cobs_encode(data: bytes) -> bytes:
    """Bytes without a zero that stand for ``data``."""
    out = bytearray()
    for run in data.split(b"\0"):
        rest = run
        while len(rest) >= _RUN:
            out += b"\xff" + rest[:_RUN]
            rest = rest[_RUN:]
        out += bytes((len(rest) + 1,)) + rest
    return bytes(out)


def cobs_decode(data: bytes) -> bytes:
    """What ``data`` stands for.

    Raises
    ------
    ValueError
        If nothing has such a code.
    """
    out = bytearray()
    place = 0
    while place < len(data):
        length = data[place]
        end = place + length
        if length == 0 or end > len(data) or 0 in data[place + 1 : end]:
            raise ValueError("no such code")
        out += data[place + 1 : end]
        place = end
        if length != _RUN + 1 and place < len(data):
            out.append(0)
    return bytes(out)


def encode_frame(frame: Frame) -> bytes:
    """Bytes of a frame on the wire, with the zero that ends it."""
    body = _HEAD.pack(frame.session, frame.seq, frame.type) + frame.payload
    body += _SUM.pack(zlib.crc32(body))
    if len(body) > MOST_BODY:
        raise ValueError(f"a frame's body must be at most {MOST_BODY} bytes")
    return cobs_encode(body) + b"\0"


def decode_frame(data: bytes) -> Frame | None:
    """The frame that stands between two zeros of the wire; ``None`` if it is none."""
    if not _HEAD.size + _SUM.size < len(data) <= _MOST_WIRE:
        return None
    try:
        body = cobs_decode(data)
    except ValueError:
        return None
    content, check = body[: -_SUM.size], body[-_SUM.size :]
    if len(content) < _HEAD.size or _SUM.pack(zlib.crc32(content)) != check:
        return None
    session, seq, kind = _HEAD.unpack_from(content)
    return Frame(session, seq, kind, content[_HEAD.size :])


class FrameReader:
    """Finds frames in what a serial line brings; noise between them is dropped."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Sound frames that are complete now."""
        *whole, self._rest = (self._rest + data).split(b"\0")
        if len(self._rest) > _MOST_WIRE:
            # Too long for a frame. It is kept too long, so that its end isn't taken for one.
            self._rest = self._rest[: _MOST_WIRE + 1]
        return [frame for frame in map(decode_frame, whole) if frame is not None]

    def clear(self) -> None:
        """Forget what was begun."""
        self._rest = b""
