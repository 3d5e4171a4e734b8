"""How alike faces are: signatures to compare thousands of faces with one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import Array

SIGNATURE_SIDE = 16


@dataclass(frozen=True)
class ClosestPair:
    """The two most similar of many faces.

    Attributes
    ----------
    first, second
        Their positions.
    value
        How similar or different they are; see the function that found them.
    """

    first: int
    second: int
    value: float


def signature(pixels: Array) -> NDArray[np.uint64]:
    """Downsampled hash of a face: 256 bits that change little when the face does.

    Parameters
    ----------
    pixels
        (rows, cols, channels), at least 16 x 16.

    Returns
    -------
    ndarray of uint64
        (4,). Each bit tells whether one of 16 x 16 blocks is brighter than the median block (channels added up).

    Raises
    ------
    ValueError
        If the face is too small.
    """
    rows, cols = pixels.shape[0], pixels.shape[1]
    if min(rows, cols) < SIGNATURE_SIDE:
        raise ValueError(f"a signature needs {SIGNATURE_SIDE} x {SIGNATURE_SIDE} pixels, not {rows} x {cols}")
    total = pixels.sum(axis=2, dtype=np.int64)
    row_edges = np.arange(SIGNATURE_SIDE) * rows // SIGNATURE_SIDE
    col_edges = np.arange(SIGNATURE_SIDE) * cols // SIGNATURE_SIDE
    sums = np.add.reduceat(np.add.reduceat(total, row_edges, axis=0), col_edges, axis=1)
    area = np.outer(np.diff(np.append(row_edges, rows)), np.diff(np.append(col_edges, cols)))
    means = sums / area
    bits = np.packbits((means > np.median(means)).ravel(), bitorder="little")
    return bits.view("<u8").astype(np.uint64)


def closest_signatures(signatures: NDArray[np.uint64]) -> ClosestPair:
    """Of many signatures, (faces, words), the two that differ in the fewest bits; ``value`` is that number."""
    first, second, distance = _closest_bits(np.ascontiguousarray(signatures))
    return ClosestPair(int(first), int(second), float(distance))


def most_shared(samples: NDArray[np.int32]) -> ClosestPair:
    """Of many faces sampled at the same places, the two that agree at the most of them.

    Parameters
    ----------
    samples
        (faces, places) int32: what each face shows at each place, as a number.

    Returns
    -------
    ClosestPair
        ``value`` is the share of places at which they agree, 0 to 1.
    """
    first, second, equal = _most_equal(np.ascontiguousarray(samples))
    return ClosestPair(int(first), int(second), float(equal) / samples.shape[1])


@kernel
def _closest_bits(signatures: NDArray[np.uint64]) -> tuple[int, int, int]:
    best_first, best_second, best = 0, 0, 1 << 30
    for i in range(len(signatures)):
        for j in range(i + 1, len(signatures)):
            distance = 0
            for k in range(signatures.shape[1]):
                word = signatures[i, k] ^ signatures[j, k]
                while word:
                    word &= word - np.uint64(1)
                    distance += 1
            if distance < best:
                best_first, best_second, best = i, j, distance
    return best_first, best_second, best


@kernel
def _most_equal(samples: NDArray[np.int32]) -> tuple[int, int, int]:
    best_first, best_second, best = 0, 0, -1
    for i in range(len(samples)):
        for j in range(i + 1, len(samples)):
            equal = 0
            for k in range(samples.shape[1]):
                equal += samples[i, k] == samples[j, k]
            if equal > best:
                best_first, best_second, best = i, j, equal
    return best_first, best_second, best
