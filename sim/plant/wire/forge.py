"""Answers that are wrong: with bits flipped, or whole in form and wrong in content, their checksums made to fit."""

from __future__ import annotations

import random
from typing import Literal
from zlib import crc32

from sim.plant.checks import crc16
from sim.plant.wire.tfp import cobs, from_cobs

Form = Literal["tcp", "rtu", "tfp", "ascii", "tfd"]
_CHECKABLE = {"tcp": 9, "tfd": 4}
"""Bytes at the start of messages without a checksum that a host can check: TCP itself protects the rest."""


def garbled(form: Form, reply: bytes, chance: random.Random, *, anywhere: bool = False) -> bytes:
    """Flip one to three bits; where no checksum shows it, in what a host can check only, unless `anywhere`."""
    data = bytearray(reply)
    end = len(data) if anywhere else min(_CHECKABLE.get(form, len(data)), len(data))
    for bit in chance.sample(range(8 * end), chance.randrange(1, 4)):
        data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def with_wrong(form: Form, reply: bytes, kind: str, chance: random.Random) -> bytes:
    """Make one thing of an answer wrong and everything around it right.

    Parameters
    ----------
    kind
        `wrong_unit` (session, of the printer), `wrong_function` (type), `wrong_count` (length), or `old_tid` (an
        earlier sequence number).
    """
    if form == "tcp":
        return _tcp(bytearray(reply), kind)
    if form == "rtu":
        body = _modbus(bytearray(reply[:-2]), kind, 0)
        return body + crc16(body).to_bytes(2, "little")
    if form == "tfp":
        return _tfp(reply, kind)
    if form == "ascii":
        return _line(reply, kind)
    return garbled(form, reply, chance)


def _modbus(data: bytearray, kind: str, unit: int) -> bytes:
    if kind == "wrong_unit":
        data[unit] ^= 0x03
    elif kind == "wrong_function":
        data[unit + 1] = 4 if data[unit + 1] == 3 else 3
    elif kind == "wrong_count" and data[unit + 1] in (3, 23) and len(data) > unit + 5:
        data[unit + 2] -= 2
        del data[-2:]
    elif kind == "wrong_count":
        data[-1] ^= 0x01
    return bytes(data)


def _tcp(data: bytearray, kind: str) -> bytes:
    if kind == "old_tid":
        data[:2] = ((int.from_bytes(data[:2], "big") - 1) & 0xFFFF).to_bytes(2, "big")
        return bytes(data)
    wrong = bytearray(_modbus(data, kind, 6))
    wrong[4:6] = (len(wrong) - 6).to_bytes(2, "big")
    return bytes(wrong)


def _tfp(reply: bytes, kind: str) -> bytes:
    body = bytearray((from_cobs(reply[:-1]) or b"")[:-4])
    if kind == "wrong_unit":
        body[0] ^= 0x01
    elif kind == "old_tid":
        body[4:6] = ((int.from_bytes(body[4:6], "little") - 1) & 0xFFFF).to_bytes(2, "little")
    elif kind == "wrong_function":
        body[6] = 0x80 | (body[6] & 0x7F) % 8 + 1
    elif len(body) > 7:
        del body[-1:]
    else:
        body += b"\0"
    return cobs(bytes(body) + crc32(body).to_bytes(4, "little")) + b"\0"


def _line(reply: bytes, kind: str) -> bytes:
    words = reply.decode("ascii")[1:].partition("*")[0].split(" ")
    if kind == "old_tid":
        words[0] = str(max(0, int(words[0]) - 1))
    elif kind == "wrong_count":
        words.pop()
    else:
        words[1] = "Z"
    text = " ".join(words)
    return f"!{text}*{crc32(text.encode()):08x}\n".encode()
