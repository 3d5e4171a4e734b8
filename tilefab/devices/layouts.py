"""Layouts of messages, byte by byte: what code packs and unpacks, and what documents show."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

_FORMATS: Final = {"u8": "B", "u16": "H", "u32": "I", "u64": "Q"}


@dataclass(frozen=True)
class Field:
    """A number of a message.

    Attributes
    ----------
    name
        In code and documents.
    kind
        u8, u16, u32 or u64; little-endian.
    meaning
        For documents.
    count
        How many of them stand in a row.
    """

    name: str
    kind: str
    meaning: str = ""
    count: int = 1

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        return self.count * struct.calcsize("<" + _FORMATS[self.kind])


@dataclass(frozen=True)
class Layout:
    """Numbers one after the other, without gaps."""

    fields: tuple[Field, ...] = ()

    @cached_property
    def _struct(self) -> struct.Struct:
        return struct.Struct("<" + "".join(f"{field.count}{_FORMATS[field.kind]}" for field in self.fields))

    @property
    def size(self) -> int:
        """Bytes that it takes."""
        return self._struct.size

    def pack(self, values: Mapping[str, int]) -> bytes:
        """Bytes of a message without rows.

        Raises
        ------
        ValueError
            If a value doesn't fit in its field.
        """
        for field in self.fields:
            if not 0 <= values[field.name] < 256**field.size:
                raise ValueError(f"{field.name} must be from 0 to {256**field.size - 1}, not {values[field.name]}")
        return self._struct.pack(*(values[field.name] for field in self.fields))

    def unpack(self, data: bytes) -> dict[str, int]:
        """Values of a message; those of a row stand under its name with 0, 1, … behind it."""
        numbers = iter(self._struct.unpack(data))
        values = {}
        for field in self.fields:
            names = [field.name] if field.count == 1 else [f"{field.name}{i}" for i in range(field.count)]
            values.update({name: next(numbers) for name in names})
        return values


@dataclass(frozen=True)
class Message:
    """A request of the printer's control protocol, and its reply.

    Attributes
    ----------
    code, name
        Its type.
    meaning
        For documents.
    request, reply
        Payloads.
    items
        What the reply goes on with, ``count`` times.
    most
        Most of these.
    """

    code: int
    name: str
    meaning: str
    request: Layout = Layout()
    reply: Layout = Layout()
    items: Layout | None = None
    most: int = 0

    def unpack_reply(self, payload: bytes) -> tuple[dict[str, int], Sequence[dict[str, int]]]:
        """Values of a reply and of its items.

        Raises
        ------
        ValueError
            If the reply hasn't the length that it must have.
        """
        head = self.reply.size
        if len(payload) < head:
            raise ValueError(f"a reply to {self.name} has {len(payload)} bytes instead of {head} or more")
        values = self.reply.unpack(payload[:head])
        size, count = (0, 0) if self.items is None else (self.items.size, values["count"])
        if count > self.most or len(payload) != head + count * size:
            raise ValueError(f"a reply to {self.name} has {len(payload)} bytes, which doesn't fit {count} entries")
        if self.items is None:
            return values, ()
        return values, [self.items.unpack(payload[i : i + size]) for i in range(head, len(payload), size)]
