"""Random streams: published Philox answers, keys pinned, streams independent."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab import rng
from tilefab.sampling.activation import _philox_reference

U64 = st.integers(0, 2**64 - 1)

# Random123's kat_vectors, philox4x32 10: counter words 0..3, key words 0..1, output words 0..3.
KNOWN_ANSWERS = [
    ("00000000 00000000 00000000 00000000", "00000000 00000000", "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ("ffffffff ffffffff ffffffff ffffffff", "ffffffff ffffffff", "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    ("243f6a88 85a308d3 13198a2e 03707344", "a4093822 299f31d0", "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


def words(text: str) -> list[int]:
    return [int(word, 16) for word in text.split()]


@pytest.mark.parametrize(("counter", "key", "answer"), KNOWN_ANSWERS)
def test_philox_gives_the_published_answers(counter: str, key: str, answer: str) -> None:
    c, k = words(counter), words(key)
    low, high = rng.philox_4x32(
        np.uint64(k[0] | k[1] << 32), np.uint64(c[0] | c[1] << 32), np.uint64(c[2] | c[3] << 32)
    )
    low, high = int(low), int(high)
    assert [low & 0xFFFFFFFF, low >> 32, high & 0xFFFFFFFF, high >> 32] == words(answer)


@given(U64, U64, U64)
def test_philox_kernel_is_its_plain_twin(key: int, counter_0: int, counter_1: int) -> None:
    low, high = rng.philox_4x32(np.uint64(key), np.uint64(counter_0), np.uint64(counter_1))
    assert (int(low), int(high)) == _philox_reference(key, counter_0, counter_1)


@given(U64, U64)
def test_random_words_are_one_block_each(key: int, index: int) -> None:
    assert rng.random_words(np.uint64(key), index) == _philox_reference(key, index, 0)


def test_random_words_are_balanced_and_uncorrelated() -> None:
    key, n = rng.stream_key(1, "test"), 4096
    values = np.array([rng.random_words(key, k) for k in range(n)], dtype=np.uint64)
    bits = (values[..., None] >> np.arange(64, dtype=np.uint64) & np.uint64(1)).reshape(n, 128).astype(float)
    # 5.5 standard deviations: once in some 26 million for one of them, and the stream is fixed.
    assert np.abs(bits.mean(axis=0) - 0.5).max() < 5.5 * 0.5 / np.sqrt(n)
    correlation = np.corrcoef(bits.T) - np.eye(128)
    assert np.abs(correlation).max() < 5.5 / np.sqrt(n)
    successive = ((2 * bits[1:] - 1) * (2 * bits[:-1] - 1)).mean(axis=0)
    assert np.abs(successive).max() < 5.5 / np.sqrt(n)


@pytest.mark.parametrize(
    ("seed", "purpose", "key"),
    [
        (0, "activation", 0x8B0E0091A971EA2A),
        (1, "activation", 0x025446351680EC02),
        (2**63 - 1, "activation", 0xC701C13B26031582),
        (0, "slot", 0x3EF9B9BB7A0A17B2),
        (0, "phase", 0xC4ADFBE7B01EC75F),
        (0, "quilting", 0xDC48AC122AED2097),
        (7, "", 0x993AEA9664DAE823),
    ],
)
def test_stream_keys_are_pinned(seed: int, purpose: str, key: int) -> None:
    assert int(rng.stream_key(seed, purpose)) == key
    message = b"tilefab stream 1\x00" + str(seed).encode() + b"\x00" + purpose.encode()
    assert int(rng.stream_key(seed, purpose)) == int.from_bytes(
        hashlib.blake2b(message, digest_size=8).digest(), "little"
    )


def test_stream_keys_differ_by_seed_and_purpose() -> None:
    purposes = ("activation", "slot", "phase", "quilting", "pseudo-biclique", "1", "11", "")
    seeds = (*range(50), 111, 2**31, 2**32, 2**32 + 1, 2**63 - 1)
    keys = {int(rng.stream_key(seed, purpose)) for seed in seeds for purpose in purposes}
    assert len(keys) == len(seeds) * len(purposes)


@pytest.mark.parametrize("seed", [-1, 2**63, 2**64, -(2**63)])
def test_a_seed_out_of_range_is_refused(seed: int) -> None:
    with pytest.raises(ValueError, match="outside"):
        rng.stream_key(seed, "activation")
    with pytest.raises(ValueError, match=str(seed)):
        rng.generator(seed, "quilting")


def test_generators_are_keyed_and_pinned() -> None:
    raw = rng.generator(3, "quilting").bit_generator.random_raw(3).tolist()
    assert raw == [14597157469867971195, 4534486655628869445, 10188040700952382563]
    assert rng.generator(3, "quilting").bit_generator.random_raw(3).tolist() == raw
    assert rng.generator(3, "pseudo-biclique").bit_generator.random_raw(3).tolist() != raw
    assert rng.generator(4, "quilting").bit_generator.random_raw(3).tolist() != raw
