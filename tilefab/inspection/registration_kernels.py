"""The loops of registration: resampling an image onto the face grid, and sums for a least-squares step.

Each has a plain twin here that gives the same numbers slowly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import FloatImage, Mask

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

PARAMETERS = 10
"""Six of an affine map, two of perspective, gain and offset."""


@kernel
def resample(image: FloatImage, matrix: Float64Array, taps: int, out: FloatImage, inside: Mask) -> None:
    """An image as seen from a grid.

    With one tap values are interpolated by Keys' cubic (R. G. Keys, "Cubic convolution interpolation for digital image
    processing", IEEE Trans. ASSP 29 (1981), equation 15); with more, each grid pixel is the mean of taps x taps
    bilinear values spread evenly over it. Beyond the image's border its border pixels go on.

    Parameters
    ----------
    image
        (R, C, K) float32.
    matrix
        (3, 3): from (x, y, 1) of the grid to the image, pixel centres at + 0.5 in both.
    taps
        1 upwards.
    out, inside
        (rows, cols, K) float32 and (rows, cols) bool, written: values, and whether the pixel's middle lies in the
        image; 0 where it doesn't.
    """
    high, wide, channels = image.shape
    rows, cols = inside.shape
    across, down = np.empty(4), np.empty(4)
    xx, xy, x1 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    yx, yy, y1 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    wx, wy, w1 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    for row in range(rows):
        for col in range(cols):
            x, y = col + 0.5, row + 0.5
            far = wx * x + wy * y + w1
            inside[row, col] = False
            for channel in range(channels):
                out[row, col, channel] = 0.0
            if not far > 1e-9:
                continue
            near = 1.0 / far
            u = (xx * x + xy * y + x1) * near
            v = (yx * x + yy * y + y1) * near
            if not (u >= 0.0 and u <= wide and v >= 0.0 and v <= high):
                continue
            inside[row, col] = True
            if taps == 1:
                u -= 0.5
                v -= 0.5
                # Both are - 0.5 or more, so cutting off the fraction after adding 1 rounds down.
                left, top = int(u + 1.0) - 1, int(v + 1.0) - 1
                t = u - left
                a0, a1 = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
                a2, a3 = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
                t = v - top
                d0, d1 = ((-0.5 * t + 1.0) * t - 0.5) * t, (1.5 * t - 2.5) * t * t + 1.0
                d2, d3 = ((-1.5 * t + 2.0) * t + 0.5) * t, (0.5 * t - 0.5) * t * t
                if left >= 1 and top >= 1 and left + 2 < wide and top + 2 < high:
                    for channel in range(channels):
                        total = 0.0
                        line = a0 * image[top - 1, left - 1, channel] + a1 * image[top - 1, left, channel]
                        line += a2 * image[top - 1, left + 1, channel] + a3 * image[top - 1, left + 2, channel]
                        total += d0 * line
                        line = a0 * image[top, left - 1, channel] + a1 * image[top, left, channel]
                        line += a2 * image[top, left + 1, channel] + a3 * image[top, left + 2, channel]
                        total += d1 * line
                        line = a0 * image[top + 1, left - 1, channel] + a1 * image[top + 1, left, channel]
                        line += a2 * image[top + 1, left + 1, channel] + a3 * image[top + 1, left + 2, channel]
                        total += d2 * line
                        line = a0 * image[top + 2, left - 1, channel] + a1 * image[top + 2, left, channel]
                        line += a2 * image[top + 2, left + 1, channel] + a3 * image[top + 2, left + 2, channel]
                        total += d3 * line
                        out[row, col, channel] = total
                    continue
                across[0], across[1], across[2], across[3] = a0, a1, a2, a3
                down[0], down[1], down[2], down[3] = d0, d1, d2, d3
                for channel in range(channels):
                    total = 0.0
                    for i in range(4):
                        place = min(max(top - 1 + i, 0), high - 1)
                        line = 0.0
                        for j in range(4):
                            line += across[j] * image[place, min(max(left - 1 + j, 0), wide - 1), channel]
                        total += down[i] * line
                    out[row, col, channel] = total
                continue
            share = 1.0 / (taps * taps)
            for i in range(taps):
                y = row + (i + 0.5) / taps
                for j in range(taps):
                    x = col + (j + 0.5) / taps
                    far = wx * x + wy * y + w1
                    u = (xx * x + xy * y + x1) / far - 0.5
                    v = (yx * x + yy * y + y1) / far - 0.5
                    u = min(max(u, 0.0), wide - 1.0)
                    v = min(max(v, 0.0), high - 1.0)
                    left, top = int(u), int(v)
                    right, under = min(left + 1, wide - 1), min(top + 1, high - 1)
                    du, dv = u - left, v - top
                    for channel in range(channels):
                        above = (1.0 - du) * image[top, left, channel] + du * image[top, right, channel]
                        below = (1.0 - du) * image[under, left, channel] + du * image[under, right, channel]
                        out[row, col, channel] += share * ((1.0 - dv) * above + dv * below)


@kernel
def step_sums(
    template: Float32Array,
    slope_x: Float32Array,
    slope_y: Float32Array,
    moved: Float32Array,
    seen: Mask,
    matrix: Float64Array,
    photometric: Float64Array,
    cut: float,
    blurred: float,
    normal: Float64Array,
    gradient: Float64Array,
) -> tuple[float, float]:
    """Weighted normal equations of one inverse compositional step.

    A pixel's residual is what the moved image shows there less gain times template less offset; its weight is Tukey's
    biweight. Unknowns are, in coordinates of -1 to 1 along the longer side: affine (xx, xy, x, yx, yy, y), perspective
    (x, y), change of gain, change of offset.

    Parameters
    ----------
    template, slope_x, slope_y
        (rows, cols) float32: the template and its slopes a pixel.
    moved, seen
        (rows, cols) float32 and bool: the image on the same grid, and where it is good.
    matrix
        (3, 3): from the template's (x, y, 1) to the moved image's.
    photometric
        (2,): gain and offset.
    cut, blurred
        Residual from which a pixel of an even place has no weight; and how many pixels' slope more may be one at an
        edge, root of sum of squares: edges that the camera blurs are no outliers.
    normal, gradient
        (10, 10) and (10,) float64, written; only the upper triangle of ``normal`` is.

    Returns
    -------
    weight, squares
        Sum of weights, and of weights times squared residuals.
    """
    rows, cols = template.shape
    half = 0.5 * max(rows, cols)
    normal[:] = 0.0
    gradient[:] = 0.0
    line = np.empty(10)
    gain, offset = photometric[0], photometric[1]
    weights = squares = 0.0
    for row in range(rows):
        y = row + 0.5
        for col in range(cols):
            x = col + 0.5
            far = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
            u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / far - 0.5
            v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / far - 0.5
            if not (u >= 0.0 and v >= 0.0 and u < cols - 1.0 and v < rows - 1.0):
                continue
            left, top = int(u), int(v)
            if not (seen[top, left] and seen[top, left + 1] and seen[top + 1, left] and seen[top + 1, left + 1]):
                continue
            du, dv = u - left, v - top
            value = (1.0 - dv) * ((1.0 - du) * moved[top, left] + du * moved[top, left + 1])
            value += dv * ((1.0 - du) * moved[top + 1, left] + du * moved[top + 1, left + 1])
            residual = value - gain * template[row, col] - offset
            along, across = gain * slope_x[row, col], gain * slope_y[row, col]
            ratio = residual * residual / (cut * cut + blurred * blurred * (along * along + across * across))
            if not ratio < 1.0:
                continue
            weight = (1.0 - ratio) ** 2
            xn, yn = (x - 0.5 * cols) / half, (y - 0.5 * rows) / half
            along, across = half * along, half * across
            outward = -(along * xn + across * yn)
            line[0], line[1], line[2] = along * xn, along * yn, along
            line[3], line[4], line[5] = across * xn, across * yn, across
            line[6], line[7] = outward * xn, outward * yn
            line[8], line[9] = template[row, col], 1.0
            weights += weight
            squares += weight * residual * residual
            for i in range(10):
                part = weight * line[i]
                gradient[i] += part * residual
                for j in range(i, 10):
                    normal[i, j] += part * line[j]
    return weights, squares


def resample_plain(
    image: FloatImage, matrix: Float64Array, taps: int, shape: tuple[int, int]
) -> tuple[FloatImage, Mask]:
    """As `resample`, in plain NumPy."""
    high, wide = image.shape[:2]
    rows, cols = shape

    def seen_at(x: Float64Array, y: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        place = np.stack([x, y, np.ones_like(x)], axis=-1) @ matrix.T
        far = place[..., 2]
        safe = np.where(far > 1e-9, far, 1.0)
        return place[..., 0] / safe, place[..., 1] / safe, far

    y, x = np.meshgrid(np.arange(rows) + 0.5, np.arange(cols) + 0.5, indexing="ij")
    u, v, far = seen_at(x, y)
    inside = (far > 1e-9) & (u >= 0.0) & (u <= wide) & (v >= 0.0) & (v <= high)
    total = np.zeros((rows, cols, image.shape[2]))
    if taps == 1:
        left, top = np.floor(u - 0.5), np.floor(v - 0.5)
        for i in range(-1, 3):
            for j in range(-1, 3):
                weight = _keys(v - 0.5 - top - i) * _keys(u - 0.5 - left - j)
                row, col = np.clip(top + i, 0, high - 1).astype(int), np.clip(left + j, 0, wide - 1).astype(int)
                total += weight[..., np.newaxis] * image[row, col]
    else:
        for i in range(taps):
            for j in range(taps):
                u, v, _ = seen_at(x - 0.5 + (j + 0.5) / taps, y - 0.5 + (i + 0.5) / taps)
                u, v = np.clip(u - 0.5, 0.0, wide - 1.0), np.clip(v - 0.5, 0.0, high - 1.0)
                left, top = np.floor(u).astype(int), np.floor(v).astype(int)
                right, under = np.minimum(left + 1, wide - 1), np.minimum(top + 1, high - 1)
                du, dv = (u - left)[..., np.newaxis], (v - top)[..., np.newaxis]
                above = (1.0 - du) * image[top, left] + du * image[top, right]
                below = (1.0 - du) * image[under, left] + du * image[under, right]
                total += ((1.0 - dv) * above + dv * below) / taps**2
    total[~inside] = 0.0
    return total.astype(np.float32), inside


def _keys(distance: Float64Array) -> Float64Array:
    """Keys' cubic with a = -1/2."""
    d = np.abs(distance)
    near, far = (1.5 * d - 2.5) * d * d + 1.0, ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
    return np.where(d <= 1.0, near, np.where(d < 2.0, far, 0.0))


def step_sums_plain(
    template: Float32Array,
    slope_x: Float32Array,
    slope_y: Float32Array,
    moved: Float32Array,
    seen: Mask,
    matrix: Float64Array,
    photometric: Float64Array,
    cut: float,
    blurred: float,
) -> tuple[Float64Array, Float64Array, float, float]:
    """As `step_sums`, in plain NumPy: the whole normal matrix, the gradient, and the two sums."""
    rows, cols = template.shape
    half = 0.5 * max(rows, cols)
    y, x = np.meshgrid(np.arange(rows) + 0.5, np.arange(cols) + 0.5, indexing="ij")
    place = np.stack([x, y, np.ones_like(x)], axis=-1) @ matrix.T
    u, v = place[..., 0] / place[..., 2] - 0.5, place[..., 1] / place[..., 2] - 0.5
    good = (u >= 0.0) & (v >= 0.0) & (u < cols - 1.0) & (v < rows - 1.0)
    left, top = np.where(good, u, 0.0).astype(int), np.where(good, v, 0.0).astype(int)
    good &= seen[top, left] & seen[top, left + 1] & seen[top + 1, left] & seen[top + 1, left + 1]
    du, dv = u - left, v - top
    value = (1.0 - dv) * ((1.0 - du) * moved[top, left] + du * moved[top, left + 1])
    value += dv * ((1.0 - du) * moved[top + 1, left] + du * moved[top + 1, left + 1])
    gain, offset = photometric
    residual = value - gain * template - offset
    ratio = residual**2 / (cut**2 + (blurred * gain) ** 2 * (slope_x**2 + slope_y**2))
    weight = np.where(good & (ratio < 1.0), (1.0 - ratio) ** 2, 0.0)
    xn, yn = (x - 0.5 * cols) / half, (y - 0.5 * rows) / half
    along, across = gain * half * slope_x, gain * half * slope_y
    outward = -(along * xn + across * yn)
    lines = [along * xn, along * yn, along, across * xn, across * yn, across, outward * xn, outward * yn]
    jacobian = np.stack([*lines, template, np.ones_like(x)], axis=-1)[weight > 0]
    residual, weight = residual[weight > 0], weight[weight > 0]
    normal = (jacobian * weight[:, np.newaxis]).T @ jacobian
    return normal, jacobian.T @ (weight * residual), float(weight.sum()), float((weight * residual**2).sum())
