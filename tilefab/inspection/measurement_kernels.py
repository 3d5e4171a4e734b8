"""Sums over regions of a face, each kernel beside a plain twin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]
Cuts = NDArray[np.int64]


@kernel
def pair_sums(
    one: FloatImage, other: FloatImage, valid: Mask, row_cuts: Cuts, col_cuts: Cuts, out: Float64Array
) -> None:
    """First and second moments of two images over a grid of regions.

    Parameters
    ----------
    one, other
        (rows, cols, 3) float32.
    valid
        (rows, cols) bool: pixels that count.
    row_cuts, col_cuts
        (A + 1,), (B + 1,) int64, rising: where regions begin and end.
    out
        (A, B, 16) float64, written: number of pixels; then for the three channels each sums of one, of other, of
        their squares, and of their product.
    """
    for band in range(len(row_cuts) - 1):
        for part in range(len(col_cuts) - 1):
            sums = out[band, part]
            sums[:] = 0.0
            count = 0
            for row in range(row_cuts[band], row_cuts[band + 1]):
                for col in range(col_cuts[part], col_cuts[part + 1]):
                    if not valid[row, col]:
                        continue
                    count += 1
                    for channel in range(3):
                        a, b = np.float64(one[row, col, channel]), np.float64(other[row, col, channel])
                        sums[1 + channel] += a
                        sums[4 + channel] += b
                        sums[7 + channel] += a * a
                        sums[10 + channel] += b * b
                        sums[13 + channel] += a * b
            sums[0] = count


@kernel
def region_sums(values: FloatImage, valid: Mask, row_cuts: Cuts, col_cuts: Cuts, out: Float64Array) -> None:
    """Sums of an image's channels, (rows, cols, K) float32, over the valid pixels of regions, into (A, B, K)."""
    for band in range(len(row_cuts) - 1):
        for part in range(len(col_cuts) - 1):
            sums = out[band, part]
            sums[:] = 0.0
            for row in range(row_cuts[band], row_cuts[band + 1]):
                for col in range(col_cuts[part], col_cuts[part + 1]):
                    if valid[row, col]:
                        for channel in range(values.shape[2]):
                            sums[channel] += values[row, col, channel]


def pair_sums_plain(one: FloatImage, other: FloatImage, valid: Mask, row_cuts: Cuts, col_cuts: Cuts) -> Float64Array:
    """As `pair_sums`, in plain NumPy: (A, B, 16)."""
    a, b = one.astype(np.float64), other.astype(np.float64)
    count = np.ones((*valid.shape, 1))
    columns = np.concatenate([count, a, b, a * a, b * b, a * b], axis=2) * valid[:, :, np.newaxis]
    return np.add.reduceat(np.add.reduceat(columns, row_cuts[:-1], axis=0), col_cuts[:-1], axis=1)


def region_sums_plain(values: FloatImage, valid: Mask, row_cuts: Cuts, col_cuts: Cuts) -> Float64Array:
    """As `region_sums`, in plain NumPy: (A, B, K)."""
    columns = values.astype(np.float64) * valid[:, :, np.newaxis]
    return np.add.reduceat(np.add.reduceat(columns, row_cuts[:-1], axis=0), col_cuts[:-1], axis=1)
