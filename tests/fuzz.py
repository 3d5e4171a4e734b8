"""Damage for files: what a cut transfer, a bad disk or a careless tool makes of them, and worse."""

from __future__ import annotations

import struct

import numpy as np

_TELLING = (0, 1, 2, 3, 0x7F, 0x80, 0xFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFF0, 0xFFFFFFFF)
_HEAD = 1024


def mutate(data: bytes, generator: np.random.Generator) -> bytes:
    """A damaged copy of a file, by 1 to 4 changes; most of them fall near its start, where counts and places stand.

    Parameters
    ----------
    data
        A whole file, 1 byte or longer.
    generator
        Decides what is damaged; the same state gives the same damage.

    Returns
    -------
    bytes
        As long as ``data``, or shorter, or longer by at most 256 bytes.
    """
    out = bytearray(data)
    for _ in range(int(generator.integers(1, 5))):
        _change(out, generator)
        if not out:
            break
    return bytes(out)


def _place(size: int, generator: np.random.Generator) -> int:
    reach = size if generator.random() < 0.3 else min(size, _HEAD)
    return int(generator.integers(reach))


def _change(out: bytearray, generator: np.random.Generator) -> None:
    at = _place(len(out), generator)
    kind = int(generator.integers(8))
    if kind == 0:  # one bit
        out[at] ^= 1 << int(generator.integers(8))
    elif kind == 1:  # one byte
        out[at] = int(generator.integers(256))
    elif kind in (2, 3):  # a number of 1, 2 or 4 bytes that stands on its own length
        width = int(generator.choice([1, 2, 4]))
        at -= at % width
        value = int(generator.choice(np.array(_TELLING, dtype=np.int64))) & ((1 << 8 * width) - 1)
        out[at : at + width] = value.to_bytes(width, "big")
    elif kind == 4:  # a number a little off, or moved
        at -= at % 4
        if at + 4 <= len(out):
            (value,) = struct.unpack_from(">I", out, at)
            step = int(generator.choice([-4, -1, 1, 4, 256, 4096]))
            struct.pack_into(">I", out, at, (value + step) & 0xFFFFFFFF)
    elif kind == 5:  # cut short
        del out[at:]
    elif kind == 6:  # a piece copied over another
        size = int(generator.integers(1, 65))
        source = _place(len(out), generator)
        piece = out[source : source + size]
        out[at : at + len(piece)] = piece
    else:  # a piece put in or taken out
        size = int(generator.integers(1, 17))
        if generator.random() < 0.5:
            out[at:at] = generator.bytes(size)
        else:
            del out[at : at + size]
