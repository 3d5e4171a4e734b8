"""Resampling kernels: Keys' cubic, held within the range of the pixels it is made of.

The cubic is the interpolating one of Keys (1981), "Cubic convolution interpolation for digital image
processing", IEEE TASSP 29(6), with a = -1/2. Its negative lobes would ring at hard edges; every result is
therefore clamped to the smallest and largest pixel of its own support, so nothing is brighter or darker
than the stone around it.

Each compiled kernel has a plain twin (``..._plain``) that does the same in a slow and obvious way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import FloatImage, Mask


@kernel
def keys_cubic(distance: float) -> float:
    """Weight of Keys' cubic (a = -1/2) at a distance in pixels; zero from 2 on."""
    x = abs(distance)
    if x < 1.0:
        return (1.5 * x - 2.5) * x * x + 1.0
    if x < 2.0:
        return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0
    return 0.0


def cubic_taps(
    in_px: int, out_px: int, scale: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Weights of a one-dimensional resampling by ``scale``, widened against aliasing when reducing.

    Output pixel i has its centre at (i + 0.5) / scale of the input. Taps that would lie outside the input are
    left out and the others made to sum to one.

    Parameters
    ----------
    in_px, out_px
        Lengths in pixels, >= 1.
    scale
        Output pixels per input pixel, > 0.

    Returns
    -------
    first, count
        int64, (out_px,): the first input pixel and the number of taps of each output pixel.
    weights
        float64, (out_px, most taps); rows are padded with zeros.
    """
    width = max(1.0, 1.0 / scale)
    centres = (np.arange(out_px) + 0.5) / scale - 0.5
    lowest = np.floor(centres - 2.0 * width).astype(np.int64) + 1
    most = math.ceil(4.0 * width) + 1
    positions = lowest[:, None] + np.arange(most)[None, :]
    x = np.abs(positions - centres[:, None]) / width
    inner = (1.5 * x - 2.5) * x * x + 1.0
    outer = ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0
    weights = np.where(x < 1.0, inner, np.where(x < 2.0, outer, 0.0))
    weights[(positions < 0) | (positions >= in_px)] = 0.0
    weights[np.abs(weights) < 1e-9] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    used = weights != 0.0
    start = used.argmax(axis=1)
    count = most - used[:, ::-1].argmax(axis=1) - start
    columns = start[:, None] + np.arange(most)[None, :]
    shifted = np.take_along_axis(weights, np.minimum(columns, most - 1), axis=1)
    shifted[np.arange(most)[None, :] >= count[:, None]] = 0.0
    return lowest + start, count, np.ascontiguousarray(shifted[:, : int(count.max())])


@kernel
def resample_columns(
    image: FloatImage,
    valid: Mask,
    first: NDArray[np.int64],
    count: NDArray[np.int64],
    weights: NDArray[np.float64],
    out: FloatImage,
    out_valid: Mask,
) -> None:
    """Resample every row of ``image`` along its columns into ``out``.

    Parameters
    ----------
    image, valid
        (rows, in_cols, 3) float32 and (rows, in_cols) bool.
    first, count, weights
        From `cubic_taps`.
    out, out_valid
        (rows, out_cols, 3) float32 and (rows, out_cols) bool, written. An output pixel is valid where every
        tap of non-zero weight is.
    """
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            good = True
            for tap in range(count[col]):
                if weights[col, tap] != 0.0 and not valid[row, first[col] + tap]:
                    good = False
            out_valid[row, col] = good
            for channel in range(3):
                total = 0.0
                low = math.inf
                high = -math.inf
                for tap in range(count[col]):
                    value = float(image[row, first[col] + tap, channel])
                    if weights[col, tap] != 0.0:
                        total += weights[col, tap] * value
                        low = min(low, value)
                        high = max(high, value)
                out[row, col, channel] = min(max(total, low), high)


@kernel
def resample_rows(
    image: FloatImage,
    valid: Mask,
    first: NDArray[np.int64],
    count: NDArray[np.int64],
    weights: NDArray[np.float64],
    out: FloatImage,
    out_valid: Mask,
) -> None:
    """Resample every column of ``image`` along its rows into ``out``; otherwise as `resample_columns`."""
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            good = True
            for tap in range(count[row]):
                if weights[row, tap] != 0.0 and not valid[first[row] + tap, col]:
                    good = False
            out_valid[row, col] = good
            for channel in range(3):
                total = 0.0
                low = math.inf
                high = -math.inf
                for tap in range(count[row]):
                    value = float(image[first[row] + tap, col, channel])
                    if weights[row, tap] != 0.0:
                        total += weights[row, tap] * value
                        low = min(low, value)
                        high = max(high, value)
                out[row, col, channel] = min(max(total, low), high)


def resample_columns_plain(
    image: FloatImage,
    valid: Mask,
    first: NDArray[np.int64],
    count: NDArray[np.int64],
    weights: NDArray[np.float64],
) -> tuple[FloatImage, Mask]:
    """Plain twin of `resample_columns`, which returns what the kernel writes."""
    out = np.empty((image.shape[0], len(first), 3), np.float32)
    out_valid = np.empty(out.shape[:2], np.bool_)
    for col in range(len(first)):
        taps = np.flatnonzero(weights[col, : count[col]])
        pixels = image[:, first[col] + taps].astype(np.float64)
        total = (pixels * weights[col, taps][None, :, None]).sum(axis=1)
        out[:, col] = np.clip(total, pixels.min(axis=1), pixels.max(axis=1))
        out_valid[:, col] = valid[:, first[col] + taps].all(axis=1)
    return out, out_valid


@kernel
def warp_rows(
    image: FloatImage,
    valid: Mask,
    matrix: NDArray[np.float64],
    first_row: int,
    first_col: int,
    out: FloatImage,
    out_valid: Mask,
) -> None:
    """Fill a band of an upright image from a projectively distorted one, bicubic.

    Parameters
    ----------
    image, valid
        Source, (rows, cols, 3) float32 and (rows, cols) bool.
    matrix
        float64, (3, 3): takes homogeneous (row, col, 1) of the output to (row, col, 1) of the source, both
        with pixel centres at +0.5.
    first_row, first_col
        Where the band's first pixel lies in the output plane.
    out, out_valid
        Written. Valid where the centre falls inside the source and every pixel of the support is valid; the
        border of the source is repeated outward for supports that hang over it.
    """
    rows = image.shape[0]
    cols = image.shape[1]
    row_weights = np.empty(4)
    col_weights = np.empty(4)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            y = first_row + i + 0.5
            x = first_col + j + 0.5
            w = matrix[2, 0] * y + matrix[2, 1] * x + matrix[2, 2]
            row = (matrix[0, 0] * y + matrix[0, 1] * x + matrix[0, 2]) / w
            col = (matrix[1, 0] * y + matrix[1, 1] * x + matrix[1, 2]) / w
            good = 0.0 <= row < rows and 0.0 <= col < cols
            row = min(max(row, 0.0), float(rows)) - 0.5
            col = min(max(col, 0.0), float(cols)) - 0.5
            row_0 = math.floor(row)
            col_0 = math.floor(col)
            for tap in range(4):
                row_weights[tap] = keys_cubic(row - (row_0 - 1 + tap))
                col_weights[tap] = keys_cubic(col - (col_0 - 1 + tap))
            for channel in range(3):
                total = 0.0
                low = math.inf
                high = -math.inf
                for a in range(4):
                    r = min(max(row_0 - 1 + a, 0), rows - 1)
                    for b in range(4):
                        weight = row_weights[a] * col_weights[b]
                        if weight != 0.0:
                            c = min(max(col_0 - 1 + b, 0), cols - 1)
                            value = float(image[r, c, channel])
                            total += weight * value
                            low = min(low, value)
                            high = max(high, value)
                            if channel == 0 and not valid[r, c]:
                                good = False
                out[i, j, channel] = min(max(total, low), high)
            out_valid[i, j] = good


@kernel
def warp_weights(
    weights: NDArray[np.uint8],
    matrix: NDArray[np.float64],
    first_row: int,
    first_col: int,
    out: NDArray[np.uint8],
) -> None:
    """Fill a band of upright weights from distorted ones, bilinear, to the nearest whole number.

    Parameters
    ----------
    weights
        Source, (rows, cols) uint8; nothing weighs outside of it.
    matrix, first_row, first_col
        As for `warp_rows`.
    out
        Written.
    """
    rows = weights.shape[0]
    cols = weights.shape[1]
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            y = first_row + i + 0.5
            x = first_col + j + 0.5
            w = matrix[2, 0] * y + matrix[2, 1] * x + matrix[2, 2]
            row = (matrix[0, 0] * y + matrix[0, 1] * x + matrix[0, 2]) / w - 0.5
            col = (matrix[1, 0] * y + matrix[1, 1] * x + matrix[1, 2]) / w - 0.5
            row_0 = math.floor(row)
            col_0 = math.floor(col)
            total = 0.0
            for a in range(2):
                for b in range(2):
                    r = row_0 + a
                    c = col_0 + b
                    if 0 <= r < rows and 0 <= c < cols:
                        total += abs(1 - a - (row - row_0)) * abs(1 - b - (col - col_0)) * weights[r, c]
            out[i, j] = np.uint8(math.floor(total + 0.5))


def warp_weights_plain(
    weights: NDArray[np.uint8], matrix: NDArray[np.float64], rows: int, cols: int
) -> NDArray[np.uint8]:
    """Plain twin of `warp_weights` for a whole output that starts at (0, 0)."""
    padded = np.pad(weights.astype(np.float64), 2)
    y, x = np.meshgrid(np.arange(rows) + 0.5, np.arange(cols) + 0.5, indexing="ij")
    mapped = np.tensordot(matrix, np.stack([y, x, np.ones_like(y)]), axes=1)
    row = np.clip(mapped[0] / mapped[2] + 1.5, 0, padded.shape[0] - 2)
    col = np.clip(mapped[1] / mapped[2] + 1.5, 0, padded.shape[1] - 2)
    r, c = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    top = padded[r, c] * (1 - (col - c)) + padded[r, c + 1] * (col - c)
    below = padded[r + 1, c] * (1 - (col - c)) + padded[r + 1, c + 1] * (col - c)
    return np.asarray(np.floor(top * (1 - (row - r)) + below * (row - r) + 0.5), dtype=np.uint8)


def warp_plain(
    image: FloatImage, valid: Mask, matrix: NDArray[np.float64], rows: int, cols: int
) -> tuple[FloatImage, Mask]:
    """Plain twin of `warp_rows` for a whole output that starts at (0, 0)."""
    y, x = np.meshgrid(np.arange(rows) + 0.5, np.arange(cols) + 0.5, indexing="ij")
    mapped = np.tensordot(matrix, np.stack([y, x, np.ones_like(y)]), axes=1)
    row, col = mapped[0] / mapped[2], mapped[1] / mapped[2]
    good = (row >= 0) & (row < image.shape[0]) & (col >= 0) & (col < image.shape[1])
    row = np.clip(row, 0, image.shape[0]) - 0.5
    col = np.clip(col, 0, image.shape[1]) - 0.5
    cubic = np.vectorize(keys_cubic, otypes=[np.float64])
    pixels, weights = [], []
    for a in range(-1, 3):
        for b in range(-1, 3):
            at_row, at_col = np.floor(row) + a, np.floor(col) + b
            weight = cubic(row - at_row) * cubic(col - at_col)
            r = np.clip(at_row, 0, image.shape[0] - 1).astype(np.int64)
            c = np.clip(at_col, 0, image.shape[1] - 1).astype(np.int64)
            good &= valid[r, c] | (weight == 0.0)
            pixels.append(image[r, c].astype(np.float64))
            weights.append(np.broadcast_to(weight[..., None], (rows, cols, 3)))
    values, factors = np.stack(pixels), np.stack(weights)
    low = np.where(factors != 0.0, values, np.inf).min(axis=0)
    high = np.where(factors != 0.0, values, -np.inf).max(axis=0)
    out = np.clip((values * factors).sum(axis=0), low, high).astype(np.float32)
    return out, good
