"""Kernel that keeps print data within a total ink limit. Its plain twin is in the tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel


@kernel
def keep_limit(counts: NDArray[Any], max_total: int, black: int, sums: NDArray[np.int64]) -> tuple[np.int64, int]:
    """Reduce (M, N) counts, in place, to ``max_total`` a pixel, and add each ink to its place in ``sums``.

    Where there is more, black (a channel, or -1 for none) is kept as far as it goes, and the others share the rest in
    proportion, each rounded to the nearest; where rounding alone passes the limit, the inks that were rounded up
    furthest go down by one, the lowest channel first among equals.

    Returns the largest total of a pixel, and how many pixels were above the limit.
    """
    pixels, inks = counts.shape
    shares = np.empty(inks, np.float64)
    largest = np.int64(0)
    above = 0
    for pixel in range(pixels):
        total = np.int64(0)
        for ink in range(inks):
            total += np.int64(counts[pixel, ink])
        if total > max_total:
            above += 1
            kept = np.int64(0)
            if black >= 0:
                kept = min(np.int64(counts[pixel, black]), np.int64(max_total))
                total -= np.int64(counts[pixel, black])
                counts[pixel, black] = kept
            scale = 0.0
            if total > 0:
                scale = np.float64(max_total - kept) / np.float64(total)
            total = kept
            for ink in range(inks):
                if ink != black:
                    shares[ink] = np.float64(counts[pixel, ink]) * scale
                    rounded = np.int64(np.floor(shares[ink] + 0.5))
                    counts[pixel, ink] = rounded
                    total += rounded
            while total > max_total:
                worst = -1
                furthest = 0.0
                for ink in range(inks):
                    if ink != black and counts[pixel, ink] > 0:
                        distance = np.float64(counts[pixel, ink]) - shares[ink]
                        if worst < 0 or distance > furthest:
                            worst = ink
                            furthest = distance
                counts[pixel, worst] -= 1
                total -= 1
        for ink in range(inks):
            sums[ink] += np.int64(counts[pixel, ink])
        if total > largest:
            largest = total
    return largest, above
