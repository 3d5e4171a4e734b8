from __future__ import annotations

import zlib

from hypothesis import given
from hypothesis import strategies as st

from tilefab.devices.crc import joined_crc32


@given(st.binary(max_size=400), st.binary(max_size=400))
def test_joined_is_that_of_the_whole(first: bytes, second: bytes) -> None:
    assert joined_crc32(zlib.crc32(first), zlib.crc32(second), len(second)) == zlib.crc32(first + second)


def test_long_pieces() -> None:
    whole = bytes(range(256)) * 40_000
    for cut in (0, 1, 7_777_777, len(whole) - 1, len(whole)):
        first, second = whole[:cut], whole[cut:]
        assert joined_crc32(zlib.crc32(first), zlib.crc32(second), len(second)) == zlib.crc32(whole)
