"""Signatures of faces and the closest pairs among many."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tilefab.texture.likeness import SIGNATURE_SIDE, closest_signatures, most_shared, signature


def test_signature_bits_are_the_blocks_above_the_median():
    pixels = np.zeros((32, 48, 4), dtype=np.uint8)
    pixels[:16] = 9
    bits = np.unpackbits(signature(pixels).astype("<u8").view(np.uint8), bitorder="little")
    assert bits.reshape(SIGNATURE_SIDE, SIGNATURE_SIDE)[:8].all()
    assert not bits.reshape(SIGNATURE_SIDE, SIGNATURE_SIDE)[8:].any()


def test_signature_hardly_changes_with_noise_and_much_with_the_picture():
    random = np.random.default_rng(3)
    smooth = np.kron(random.integers(0, 200, (16, 16, 1)), np.ones((8, 8, 3), dtype=int)).astype(np.uint8)
    noisy = smooth + random.integers(0, 3, smooth.shape).astype(np.uint8)
    other = np.kron(random.integers(0, 200, (16, 16, 1)), np.ones((8, 8, 3), dtype=int)).astype(np.uint8)

    def distance(a, b):
        return sum(int(x).bit_count() for x in signature(a) ^ signature(b))

    assert distance(smooth, noisy) <= 12
    assert distance(smooth, other) >= 90


def test_sizes_that_no_block_divides_are_covered_whole():
    pixels = np.arange(17 * 19 * 1, dtype=np.int64).reshape(17, 19, 1)
    assert sum(int(word).bit_count() for word in signature(pixels)) == 128


def test_too_small_is_refused():
    with pytest.raises(ValueError, match="needs 16 x 16"):
        signature(np.zeros((15, 40, 4), dtype=np.uint8))


def test_closest_signatures_equals_brute_force():
    random = np.random.default_rng(5)
    signatures = random.integers(0, 2**63, (40, 4)).astype(np.uint64)
    signatures[31] = signatures[7] ^ np.uint64(0b1011)
    found = closest_signatures(signatures)
    assert (found.first, found.second, found.value) == (7, 31, 12.0)
    distances = [
        sum(int(x).bit_count() for x in signatures[i] ^ signatures[j]) for i, j in itertools.combinations(range(40), 2)
    ]
    assert min(distances) == found.value


def test_most_shared_equals_brute_force():
    samples = np.random.default_rng(6).integers(0, 50, (30, 64)).astype(np.int32)
    samples[20, :40] = samples[4, :40]
    found = most_shared(samples)
    best = max((samples[i] == samples[j]).mean() for i, j in itertools.combinations(range(30), 2))
    assert (found.first, found.second) == (4, 20)
    assert found.value == pytest.approx(best)
