"""Keyed counter-based random streams: integers only, the same on every machine, in any order.

A stream is named by (format version, job seed, purpose) and hashed with BLAKE2b to a 64-bit key; Philox-4x32-10
(Salmon, Moraes, Dror and Shaw 2011, "Parallel random numbers: as easy as 1, 2, 3") turns that key and a counter
into random words. Any word of any stream can be had directly, so what is printed never depends on the order in
which it was asked for. This replaces Eq. 5.1 of the first seed, whose cosines differ between platforms.
"""

from __future__ import annotations

import hashlib

import numpy as np

from tilefab.jit import kernel

STREAM_VERSION = 1
SEED_LIMIT = 1 << 63

_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_LOW_32 = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)


def stream_key(seed: int, purpose: str) -> np.uint64:
    """Key of the random stream for one purpose of one job seed.

    Parameters
    ----------
    seed
        Job seed, 0 <= seed < 2**63.
    purpose
        What the stream decides, for example ``"activation"``; streams of two purposes are independent.

    Returns
    -------
    numpy.uint64

    Raises
    ------
    ValueError
        If the seed is out of range.
    """
    if not 0 <= seed < SEED_LIMIT:
        raise ValueError(f"seed {seed} is outside 0 .. 2**63 - 1")
    message = f"tilefab stream {STREAM_VERSION}\0{seed}\0{purpose}".encode()
    return np.uint64(int.from_bytes(hashlib.blake2b(message, digest_size=8).digest(), "little"))


@kernel
def philox_4x32(key: np.uint64, counter_0: np.uint64, counter_1: np.uint64) -> tuple[np.uint64, np.uint64]:
    """One Philox-4x32-10 block: 128 random bits for a 64-bit key and a 128-bit counter.

    Parameters
    ----------
    key
        64-bit key; its low word is Philox's k0.
    counter_0, counter_1
        Low and high half of the counter; the low word of ``counter_0`` is Philox's c0.

    Returns
    -------
    tuple of numpy.uint64
        Output words 0 and 1, then 2 and 3, the lower word in the low half.
    """
    c0 = counter_0 & _LOW_32
    c1 = counter_0 >> _32
    c2 = counter_1 & _LOW_32
    c3 = counter_1 >> _32
    k0 = key & _LOW_32
    k1 = key >> _32
    for _ in range(10):
        product_0 = _MULTIPLIER_0 * c0
        product_1 = _MULTIPLIER_1 * c2
        c0 = (product_1 >> _32) ^ c1 ^ k0
        c1 = product_1 & _LOW_32
        c2 = (product_0 >> _32) ^ c3 ^ k1
        c3 = product_0 & _LOW_32
        k0 = (k0 + _WEYL_0) & _LOW_32
        k1 = (k1 + _WEYL_1) & _LOW_32
    return c0 | (c1 << _32), c2 | (c3 << _32)


def random_words(key: np.uint64, index: int) -> tuple[int, int]:
    """Two independent 64-bit words at one index of a stream (0 <= index < 2**64), as Python integers."""
    low, high = philox_4x32(key, np.uint64(index), np.uint64(0))
    return int(low), int(high)


def generator(seed: int, purpose: str) -> np.random.Generator:
    """Sequential numpy generator for offline choices (preparing a texture map), keyed like every stream."""
    return np.random.Generator(np.random.Philox(key=int(stream_key(seed, purpose))))
