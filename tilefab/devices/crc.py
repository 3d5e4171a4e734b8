"""CRC-32 of two pieces of data end to end, from the CRC-32 of each: without reading either again."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

_POLYNOMIAL: Final = 0xEDB88320
"""Of CRC-32 as of zlib, bit 31 the lowest power."""
_ONE: Final = 1 << 31
_EIGHT: Final = 1 << 23
"""x to the 8th: one byte."""


def joined_crc32(first: int, second: int, second_bytes: int) -> int:
    """CRC-32 of data that begins with one piece and goes on with another.

    A CRC is a remainder of polynomials over two elements: what comes first is worth its own times x to the number of
    bits that follow.

    Parameters
    ----------
    first, second
        CRC-32 of each piece.
    second_bytes
        Length of the second.

    >>> import zlib
    >>> joined_crc32(zlib.crc32(b"till"), zlib.crc32(b"fab"), 3) == zlib.crc32(b"tillfab")
    True
    """
    return _product(_shift(second_bytes), first) ^ second


@lru_cache(maxsize=64)
def _shift(many_bytes: int) -> int:
    """Power of x that n bytes are worth, modulo the polynomial; strips have few different lengths."""
    power, square = _ONE, _EIGHT
    while many_bytes:
        if many_bytes & 1:
            power = _product(square, power)
        square = _product(square, square)
        many_bytes >>= 1
    return power


def _product(left: int, right: int) -> int:
    """Product of two polynomials, modulo the polynomial."""
    product = 0
    for bit in range(31, -1, -1):
        if left >> bit & 1:
            product ^= right
        right = right >> 1 ^ (_POLYNOMIAL if right & 1 else 0)
    return product
