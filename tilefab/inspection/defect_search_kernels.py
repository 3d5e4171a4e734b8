"""Inner loops of the search for defects in a tile's residual: arrays in, arrays out; see `tilefab.inspection.defects`.

Images are float32; pixels of no use have weight 0. The twins ``..._plain`` say the same in NumPy, slowly; tests hold
the kernels against them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.jit import kernel
from tilefab.types import FloatImage

Float64Array = NDArray[np.float64]


@kernel
def in_noise(
    values: FloatImage, likes: FloatImage, white: Float64Array, knots: Float64Array, sizes: Float64Array
) -> tuple[FloatImage, FloatImage]:
    """Values in units of a noise that depends on other images.

    Parameters
    ----------
    values
        (rows, cols, 3).
    likes
        (rows, cols, K) what the noise depends on.
    white
        (3, 3) matrix that values are multiplied with.
    knots, sizes
        (K, B) increasing values of each of ``likes``, and by how much noise there is larger: linear in between.

    Returns
    -------
    whitened, length
        (rows, cols, 3), and the lengths (rows, cols) of those vectors.
    """
    rows, cols, count = likes.shape
    bins = knots.shape[1]
    out, length = np.empty_like(values), np.empty((rows, cols), dtype=np.float32)
    for row in range(rows):
        for col in range(cols):
            size = 1.0
            for k in range(count):
                like = likes[row, col, k]
                b = 0
                while b < bins and knots[k, b] < like:
                    b += 1
                if b == 0:
                    size *= sizes[k, 0]
                elif b == bins:
                    size *= sizes[k, bins - 1]
                else:
                    share = (like - knots[k, b - 1]) / (knots[k, b] - knots[k, b - 1])
                    size *= sizes[k, b - 1] + share * (sizes[k, b] - sizes[k, b - 1])
            power = 0.0
            for c in range(3):
                value = 0.0
                for d in range(3):
                    value += white[c, d] * values[row, col, d]
                value /= size
                out[row, col, c] = value
                power += value * value
            length[row, col] = np.sqrt(power)
    return out, length


def in_noise_plain(
    values: FloatImage, likes: FloatImage, white: Float64Array, knots: Float64Array, sizes: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Twin of `in_noise`."""
    out = np.asarray(values, dtype=np.float64) @ white.T
    for k in range(likes.shape[2]):
        out = out / np.interp(likes[..., k], knots[k], sizes[k])[..., np.newaxis]
    return out, np.sqrt((out**2).sum(axis=-1))


@kernel
def local_contrast(residual: FloatImage, weight: FloatImage, inner: int, outer: int) -> tuple[FloatImage, FloatImage]:
    """A residual less its mean over the ring between two squares around each pixel.

    Parameters
    ----------
    residual
        (rows, cols, 3).
    weight
        (rows, cols).
    inner, outer
        Half sides of the squares, pixels: the ring is what the outer has and the inner hasn't.

    Returns
    -------
    contrast, seen
        (rows, cols, 3), 0 where nothing is known; and (rows, cols), the weight where the ring has at least a third of
        its pixels, else 0.
    """
    rows, cols = weight.shape
    ring = np.empty((4, rows, cols), dtype=np.float32)
    plane = np.empty((rows, cols), dtype=np.float32)
    # Running sums down the columns, then along the row: a pixel costs the same however large the squares are.
    tall_outer, tall_inner = np.empty(cols), np.empty(cols)
    before_outer, before_inner = np.zeros(cols + 1), np.zeros(cols + 1)
    for c in range(4):
        for row in range(rows):
            for col in range(cols):
                value = np.float32(1.0) if c == 3 else residual[row, col, c]
                plane[row, col] = weight[row, col] * value
        tall_outer[:], tall_inner[:] = 0.0, 0.0
        for row in range(-outer, rows):
            if row + outer < rows:
                for col in range(cols):
                    tall_outer[col] += plane[row + outer, col]
            if row - outer - 1 >= 0:
                for col in range(cols):
                    tall_outer[col] -= plane[row - outer - 1, col]
            if 0 <= row + inner < rows:
                for col in range(cols):
                    tall_inner[col] += plane[row + inner, col]
            if row - inner - 1 >= 0:
                for col in range(cols):
                    tall_inner[col] -= plane[row - inner - 1, col]
            if row >= 0:
                for col in range(cols):
                    before_outer[col + 1] = before_outer[col] + tall_outer[col]
                    before_inner[col + 1] = before_inner[col] + tall_inner[col]
                for col in range(cols):
                    far = before_outer[min(col + outer + 1, cols)] - before_outer[max(col - outer, 0)]
                    near = before_inner[min(col + inner + 1, cols)] - before_inner[max(col - inner, 0)]
                    ring[c, row, col] = far - near
    out, seen = np.zeros_like(residual), np.zeros_like(weight)
    least = ((2 * outer + 1) ** 2 - (2 * inner + 1) ** 2) / 3.0
    for row in range(rows):
        for col in range(cols):
            if weight[row, col] > 0.0 and ring[3, row, col] >= least:
                seen[row, col] = weight[row, col]
                for c in range(3):
                    out[row, col, c] = residual[row, col, c] - ring[c, row, col] / ring[3, row, col]
    return out, seen


def local_contrast_plain(
    residual: FloatImage, weight: FloatImage, inner: int, outer: int
) -> tuple[Float64Array, Float64Array]:
    """Twin of `local_contrast`."""
    share = np.asarray(weight, dtype=np.float64)
    values = np.concatenate([share[..., np.newaxis] * residual, share[..., np.newaxis]], axis=-1)

    def over(half: int) -> Float64Array:
        ones = np.ones(2 * half + 1)
        down = ndimage.correlate1d(values, ones, axis=0, mode="constant")
        return np.asarray(ndimage.correlate1d(down, ones, axis=1, mode="constant"), dtype=np.float64)

    ring = over(outer) - over(inner)
    least = ((2 * outer + 1) ** 2 - (2 * inner + 1) ** 2) / 3.0
    seen = np.where((share > 0.0) & (ring[..., 3] >= least - 1e-9), share, 0.0)
    mean = ring[..., :3] / np.maximum(ring[..., 3:], 1e-9)
    return np.where(seen[..., np.newaxis] > 0.0, residual - mean, 0.0), seen


@kernel
def line_strengths(
    whitened: FloatImage,
    weight: FloatImage,
    at_row: NDArray[np.int64],
    at_col: NDArray[np.int64],
    reach: int,
    ways: int,
) -> tuple[FloatImage, NDArray[np.int64]]:
    """How strong a straight line through each of some pixels is, in its best direction.

    Parameters
    ----------
    whitened
        (rows, cols, 3) contrast, every channel of about unit variance and not correlated with the others.
    weight
        (rows, cols), 0 where nothing is known.
    at_row, at_col
        (P,) pixels.
    reach
        Pixels of the line on either side of its middle.
    ways
        How many directions over the half circle.

    Returns
    -------
    strength, way
        (P,) length of the mean vector times the root of the number of pixels, largest over directions, and which
        direction that is; 0 where less than half of a line is seen.
    """
    rows, cols = weight.shape
    strength, way = np.zeros(at_row.size, dtype=np.float32), np.zeros(at_row.size, dtype=np.int64)
    steps_x, steps_y = np.empty((ways, 2 * reach + 1), np.int64), np.empty((ways, 2 * reach + 1), np.int64)
    for k in range(ways):
        angle = np.pi * k / ways
        for t in range(-reach, reach + 1):
            steps_x[k, t + reach] = int(np.floor(t * np.cos(angle) + 0.5))
            steps_y[k, t + reach] = int(np.floor(t * np.sin(angle) + 0.5))
    for p in range(at_row.size):
        best, best_way = 0.0, 0
        for k in range(ways):
            one, two, three, count = 0.0, 0.0, 0.0, 0
            for t in range(2 * reach + 1):
                row, col = at_row[p] + steps_y[k, t], at_col[p] + steps_x[k, t]
                if 0 <= row < rows and 0 <= col < cols and weight[row, col] > 0.0:
                    one += whitened[row, col, 0]
                    two += whitened[row, col, 1]
                    three += whitened[row, col, 2]
                    count += 1
            if count > reach:
                power = (one * one + two * two + three * three) / count
                if power > best:
                    best, best_way = power, k
        strength[p], way[p] = np.sqrt(best), best_way
    return strength, way


def line_strengths_plain(
    whitened: FloatImage,
    weight: FloatImage,
    at_row: NDArray[np.int64],
    at_col: NDArray[np.int64],
    reach: int,
    ways: int,
) -> tuple[Float64Array, NDArray[np.int64]]:
    """Twin of `line_strengths`."""
    rows, cols = weight.shape
    along = np.arange(-reach, reach + 1)
    powers = np.zeros((ways, at_row.size))
    for k in range(ways):
        angle = np.pi * k / ways
        row = at_row[:, np.newaxis] + np.floor(along * np.sin(angle) + 0.5).astype(np.int64)
        col = at_col[:, np.newaxis] + np.floor(along * np.cos(angle) + 0.5).astype(np.int64)
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        row, col = np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)
        used = inside & (weight[row, col] > 0.0)
        total = np.where(used[..., np.newaxis], whitened[row, col].astype(np.float64), 0.0).sum(axis=1)
        count = used.sum(axis=1)
        powers[k] = np.where(count > reach, (total**2).sum(axis=1) / np.maximum(count, 1), 0.0)
    return np.sqrt(powers.max(axis=0)), np.argmax(powers, axis=0)
