"""Checksums: CRC-16 of Modbus RTU, and joining CRC-32s of parts without their bytes."""

from __future__ import annotations

from functools import lru_cache

_POLYNOMIAL = 0xEDB88320


def _table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
        table.append(value)
    return tuple(table)


_CRC16 = _table()


def crc16(data: bytes) -> int:
    """CRC-16 of Modbus RTU; it goes on the wire low byte first."""
    value = 0xFFFF
    for byte in data:
        value = value >> 8 ^ _CRC16[(value ^ byte) & 0xFF]
    return value


def _product(a: int, b: int) -> int:
    """Product of two polynomials modulo that of CRC-32, in its bit-reversed form."""
    bit, product = 1 << 31, 0
    while bit:
        if a & bit:
            product ^= b
        b = b >> 1 ^ _POLYNOMIAL if b & 1 else b >> 1
        bit >>= 1
    return product


@lru_cache(maxsize=256)
def _zeros(size: int) -> int:
    """Power 8·size of x modulo the polynomial: what `size` zero bytes do to a checksum."""
    power, square = 1 << 31, 1 << 23
    while size:
        if size & 1:
            power = _product(square, power)
        square = _product(square, square)
        size >>= 1
    return power


def crc32_joined(first: int, second: int, second_size: int) -> int:
    """CRC-32 of two runs of bytes one after another, from the CRC-32 of each and the second's length in bytes."""
    return _product(_zeros(second_size), first) ^ second
