"""Checksums, against zlib and published values."""

from __future__ import annotations

from zlib import crc32

from hypothesis import given
from hypothesis import strategies as st

from sim.plant.checks import crc16, crc32_joined


@given(st.binary(max_size=300), st.binary(max_size=5000))
def test_joined_checksums_are_those_of_the_joined_bytes(first, second):
    assert crc32_joined(crc32(first), crc32(second), len(second)) == crc32(first + second)


def test_checksums_of_long_parts_join():
    part, whole = bytes(range(256)) * 9000, 0
    for _ in range(3):
        whole = crc32_joined(whole, crc32(part), len(part))
    assert whole == crc32(part * 3)


def test_crc16_has_its_published_value():
    assert crc16(b"123456789") == 0x4B37
    assert crc16(bytes.fromhex("01030000000a")) == 0xCDC5
