"""Damaged profiles through every reader: an error that explains, or a sound table."""

import struct
import tracemalloc

import numpy as np

from tests.fuzz import mutate
from tests.icc_samples import exercise, fuzz_seeds

MUTATIONS = 500
MOST_BYTES = 64 << 20


def damage_and_read(count: int, seed: int = 1) -> int:
    """Read ``count`` damaged profiles; the number of tables that came out sound.

    Every other one gets a size in its header that agrees with its length: the damage behind it would stay unseen.
    """
    generator = np.random.default_rng(seed)
    seeds = fuzz_seeds()
    sound = 0
    for index in range(count):
        data = mutate(seeds[index % len(seeds)], generator)
        if index // len(seeds) % 2 and len(data) > 4:
            data = struct.pack(">I", len(data)) + data[4:]
        sound += exercise(data)
    return sound


def test_whole_profiles_are_sound() -> None:
    assert [exercise(data) for data in fuzz_seeds()] == [13, 13, 13, 2, 2, 8, 8, 4, 6, 6]


def test_damaged_profiles_are_refused_or_read() -> None:
    tracemalloc.start()
    try:
        sound = damage_and_read(MUTATIONS)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert sound > MUTATIONS // 2
    assert peak < MOST_BYTES
