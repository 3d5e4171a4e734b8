"""Declarative maps of Modbus registers: what stands where, and how values become words and back."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

Value = int | float | tuple[int, ...] | tuple[float, ...]


class Kind(Enum):
    """How a value lies in registers; the value is its format for `struct`, in big-endian bytes."""

    U16 = "H"
    U32 = "I"
    U64 = "Q"
    F32 = "f"

    @property
    def words(self) -> int:
        """Registers that one value takes."""
        return struct.calcsize(">" + self.value) // 2


@dataclass(frozen=True)
class Register:
    """One value, or a row of equal values, of a map.

    Attributes
    ----------
    address
        Of its first register.
    name
        Of the value; in code and documents.
    kind
        How it lies in registers.
    meaning
        For documents.
    writable
        Whether a host may write it.
    unit
        Of the value, as people read it; empty if it has none.
    per_unit
        Counts of the register to one unit: 10 if it counts tenths.
    low, high
        What may be written, in counts of the register; ``None`` stands for all that it can hold.
    bits
        Names of its bits from bit 0 on, if it is a set of flags; the others are always 0.
    constant
        What it always reads; ``None`` for a value that changes.
    count
        How many such values stand in a row.
    """

    address: int
    name: str
    kind: Kind
    meaning: str
    writable: bool = False
    unit: str = ""
    per_unit: int = 1
    low: float | None = None
    high: float | None = None
    bits: tuple[str, ...] = ()
    constant: int | float | None = None
    count: int = 1

    @property
    def words(self) -> int:
        """Registers that it takes."""
        return self.kind.words * self.count

    def to_counts(self, value: float) -> int | float:
        """Counts that stand for a value of its unit.

        Raises
        ------
        ValueError
            If the value is outside the limits, or no number.
        """
        counts: int | float = value * self.per_unit
        if math.isfinite(counts) and self.kind is not Kind.F32:
            counts = round(counts)
        low = 0 if self.low is None else self.low
        high = 256 ** (2 * self.kind.words) - 1 if self.high is None else self.high
        if not low <= counts <= high:
            unit = f" {self.unit}" if self.unit else ""
            raise ValueError(
                f"{self.name} must be from {low / self.per_unit:g} to {high / self.per_unit:g}{unit}, not {value:g}"
            )
        return counts


@dataclass(frozen=True)
class Write:
    """Words for registers from an address on."""

    address: int
    words: tuple[int, ...]


class ContentError(ValueError):
    """What a window of registers holds can't be the device's."""


@dataclass(frozen=True)
class RegisterMap:
    """The registers of a device: one window without gaps, read in one request.

    Attributes
    ----------
    device
        What it is, for documents and messages.
    unit
        Its usual Modbus unit.
    window
        Registers 0 .. window - 1 are read at once.
    registers
        All that have a meaning, by address; the others read 0 and can't be written.
    command
        Names of the first and the last register of the block that is written as one command.
    check_address
        First of the last two registers of the window: CRC-32 of all before, or 0 from a device that makes none.
    word_order
        Whether the high or the low word of a value comes first.
    """

    device: str
    unit: int
    window: int
    registers: tuple[Register, ...]
    command: tuple[str, str]
    check_address: int
    word_order: Literal["high", "low"] = "high"

    def __getitem__(self, name: str) -> Register:
        """Find the register of this name."""
        for register in self.registers:
            if register.name == name:
                return register
        raise KeyError(name)

    def raw(self, name: str, words: Sequence[int]) -> tuple[int | float, ...]:
        """Counts that a register of a window holds."""
        register = self[name]
        return self._unpack(register, words[register.address : register.address + register.words])

    def decode(self, words: Sequence[int]) -> dict[str, Value]:
        """Values of a whole window in their units, by name; flags stand under the names of their bits, as 0 or 1.

        Raises
        ------
        ContentError
            If the window holds what the device never shows: another constant, a flag or register that isn't in use,
            a number that is none.
        """
        unused = set(range(self.window))
        values: dict[str, Value] = {}
        for register in self.registers:
            place = range(register.address, register.address + register.words)
            unused.difference_update(place)
            counts = self._unpack(register, words[place.start : place.stop])
            if register.constant is not None and counts[0] != register.constant:
                raise ContentError(self._constant_problem(register, words[place.start : place.stop]))
            if not all(math.isfinite(count) for count in counts):
                raise ContentError(f"{register.name} in register {register.address} holds no number")
            if register.bits:
                flags = int(counts[0])
                if flags >> len(register.bits):
                    raise ContentError(f"{register.name} in register {register.address} has bits that mean nothing")
                values.update({name: flags >> bit & 1 for bit, name in enumerate(register.bits)})
                continue
            scaled = counts if register.per_unit == 1 else tuple(count / register.per_unit for count in counts)
            values[register.name] = scaled if register.count > 1 else scaled[0]
        wrong = [address for address in sorted(unused) if words[address]]
        if wrong:
            raise ContentError(f"register {wrong[0]}, which is not in use, reads {words[wrong[0]]}")
        return values

    def check_words(self, words: Sequence[int]) -> tuple[int, int]:
        """Sum that a window carries, and what it should be."""
        body = struct.pack(f">{self.check_address}H", *words[: self.check_address])
        found = words[self.check_address] << 16 | words[self.check_address + 1]
        return found, zlib.crc32(body) or 0xFFFFFFFF

    def encode_command(self, values: Mapping[str, float | Sequence[float]]) -> tuple[Write, ...]:
        """Writes that make up a command, from values in their units, in the order in which they are to be sent.

        Registers without a gap between them go in one write. The one with the sequence number comes last, so that a
        device acts on all or on nothing.

        Raises
        ------
        ValueError
            If a value is outside its limits.
        """
        first, last = self[self.command[0]].address, self[self.command[1]].address
        runs: list[Write] = []
        for register in self.registers:
            if not first <= register.address <= last:
                continue
            given = values[register.name]
            row = tuple(given) if isinstance(given, Sequence) else (given,)
            if len(row) != register.count:
                raise ValueError(f"{register.name} must be {register.count} values, not {len(row)}")
            words = self._pack(register, [register.to_counts(value) for value in row])
            if runs and runs[-1].address + len(runs[-1].words) == register.address:
                runs[-1] = Write(runs[-1].address, runs[-1].words + words)
            else:
                runs.append(Write(register.address, words))
        return tuple(reversed(runs))

    def _pack(self, register: Register, counts: Sequence[int | float]) -> tuple[int, ...]:
        words: list[int] = []
        for count in counts:
            one = struct.unpack(f">{register.kind.words}H", struct.pack(">" + register.kind.value, count))
            words.extend(one if self.word_order == "high" else reversed(one))
        return tuple(words)

    def _unpack(self, register: Register, words: Sequence[int]) -> tuple[int | float, ...]:
        size = register.kind.words
        ordered = list(words)
        if self.word_order == "low":
            ordered = [word for i in range(0, len(words), size) for word in reversed(words[i : i + size])]
        data = struct.pack(f">{len(ordered)}H", *ordered)
        return struct.unpack(f">{register.count}{register.kind.value}", data)

    def _constant_problem(self, register: Register, words: Sequence[int]) -> str:
        swapped = self._unpack(register, list(reversed(words)))[0]
        if swapped == register.constant:
            return (
                f"{register.name} shows that the words of long values come in the other order: set the device up to "
                f"send the {self.word_order} word first"
            )
        return f"{register.name} in register {register.address} doesn't read {register.constant}"
