"""The printer's data link "TFD 1": strips in, credit out."""

from __future__ import annotations

import struct
from dataclasses import dataclass

_HELLO = struct.Struct("<4sI")
_STRIP = struct.Struct("<4sQIIII")
_STAT = struct.Struct("<4sQIIB")
HELLO_BYTES = _HELLO.size
STRIP_BYTES = _STRIP.size


@dataclass(frozen=True)
class StripHead:
    """What comes before a strip's bytes."""

    arm_id: int
    row: int
    rows: int
    size: int
    crc32: int


def parse_hello(data: bytes) -> int | None:
    """Session of a host's hello; None if it is none."""
    magic, session = _HELLO.unpack(data)
    return int(session) if magic == b"TFD1" else None


def parse_strip(data: bytes) -> StripHead | None:
    """What stands before a strip; None if it is none."""
    magic, *values = _STRIP.unpack(data)
    return StripHead(*values) if magic == b"STRP" else None


def stat(arm_id: int, next_row: int, credit: int, code: int) -> bytes:
    """The printer's message: where to go on, and how many bytes it can take now."""
    return _STAT.pack(b"STAT", arm_id, next_row, min(credit, 0xFFFFFFFF), code)
