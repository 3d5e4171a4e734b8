"""Kernel that adds up the inks of print data. Its plain twin is in the tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel


@kernel
def add_up_inks(counts: NDArray[Any], max_total: int, sums: NDArray[np.int64]) -> tuple[np.int64, int]:
    """Add each ink of (M, N) counts to its place in ``sums``.

    Returns the largest total of a pixel, and how many pixels have more than ``max_total``.
    """
    pixels, inks = counts.shape
    largest = np.int64(0)
    above = 0
    for pixel in range(pixels):
        total = np.int64(0)
        for ink in range(inks):
            count = np.int64(counts[pixel, ink])
            sums[ink] += count
            total += count
        if total > max_total:
            above += 1
        if total > largest:
            largest = total
    return largest, above
