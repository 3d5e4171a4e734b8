"""Inner loops of laying a prediction on a fired tile: arrays in, arrays out; see `tilefab.inspection.defect_residual`.

Images are float32 (rows, cols, 3); pixels of no use have weight 0. The twins ``..._plain`` say the same in
NumPy, slowly; tests hold the kernels against them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.spaces import WHITE_XYZ_D50, lab_from_xyz, xyz_from_lab
from tilefab.jit import kernel
from tilefab.types import FloatImage

Float64Array = NDArray[np.float64]

_KNEE = 6.0 / 29.0
LEAST_LIGHT = 0.003
"""Below it, a change of light counts no more than there: noise alone would rule."""


@kernel
def light_of(lab: FloatImage) -> FloatImage:
    """Linear light (rows, cols, 3), XYZ over the white's, of CIELAB colours."""
    rows, cols = lab.shape[:2]
    out = np.empty_like(lab)
    for row in range(rows):
        for col in range(cols):
            middle = (lab[row, col, 0] + 16.0) / 116.0
            for c in range(3):
                f = middle
                if c == 0:
                    f += lab[row, col, 1] / 500.0
                elif c == 2:
                    f -= lab[row, col, 2] / 200.0
                out[row, col, c] = f * f * f if f > _KNEE else (f - 4.0 / 29.0) * 3.0 * _KNEE * _KNEE
    return out


def light_of_plain(lab: FloatImage) -> Float64Array:
    """Twin of `light_of`."""
    return np.asarray(xyz_from_lab(lab) / np.array(WHITE_XYZ_D50), dtype=np.float64)


@kernel
def lab_of(light: FloatImage) -> FloatImage:
    """CIELAB colours (rows, cols, 3) of linear light, XYZ over the white's; light below 0 follows the linear part."""
    rows, cols = light.shape[:2]
    out = np.empty_like(light)
    f = np.empty(3)
    for row in range(rows):
        for col in range(cols):
            for c in range(3):
                value = np.float64(light[row, col, c])
                if value > _KNEE**3:
                    f[c] = np.cbrt(value)
                else:
                    f[c] = value / (3.0 * _KNEE * _KNEE) + 4.0 / 29.0
            out[row, col, 0] = 116.0 * f[1] - 16.0
            out[row, col, 1] = 500.0 * (f[0] - f[1])
            out[row, col, 2] = 200.0 * (f[1] - f[2])
    return out


def lab_of_plain(light: FloatImage) -> Float64Array:
    """Twin of `lab_of`."""
    return lab_from_xyz(np.asarray(light, dtype=np.float64) * np.array(WHITE_XYZ_D50))


@kernel
def means_of(image: FloatImage, step: int) -> FloatImage:
    """Means (rows // step, cols // step, K) over squares of ``step`` pixels of an image (rows, cols, K)."""
    high, wide, channels = image.shape[0] // step, image.shape[1] // step, image.shape[2]
    out = np.zeros((high, wide, channels), dtype=np.float32)
    share = np.float32(1.0 / (step * step))
    for row in range(high * step):
        for col in range(wide * step):
            for c in range(channels):
                out[row // step, col // step, c] += share * image[row, col, c]
    return out


def means_of_plain(image: FloatImage, step: int) -> Float64Array:
    """Twin of `means_of`."""
    high, wide = image.shape[0] // step, image.shape[1] // step
    parts = np.asarray(image[: high * step, : wide * step], dtype=np.float64)
    return np.asarray(parts.reshape(high, step, wide, step, image.shape[2]).mean(axis=(1, 3)), dtype=np.float64)


@kernel
def binomial(image: FloatImage) -> FloatImage:
    """Smoothed by 1 2 1 in both directions; beyond the edges lie the edge's own pixels."""
    rows, cols, channels = image.shape
    across = np.empty_like(image)
    half, quarter = np.float32(0.5), np.float32(0.25)
    for row in range(rows):
        for col in range(cols):
            left, right = max(col - 1, 0), min(col + 1, cols - 1)
            for c in range(channels):
                across[row, col, c] = half * image[row, col, c] + quarter * (image[row, left, c] + image[row, right, c])
    out = np.empty_like(image)
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for col in range(cols):
            for c in range(channels):
                out[row, col, c] = half * across[row, col, c] + quarter * (
                    across[above, col, c] + across[below, col, c]
                )
    return out


def binomial_plain(image: FloatImage) -> Float64Array:
    """Twin of `binomial`."""
    weights = np.array([0.25, 0.5, 0.25])
    down = ndimage.correlate1d(np.asarray(image, dtype=np.float64), weights, axis=0, mode="nearest")
    return np.asarray(ndimage.correlate1d(down, weights, axis=1, mode="nearest"), dtype=np.float64)


@kernel
def block_sums(
    predicted: FloatImage, fired: FloatImage, weight: FloatImage, scale: Float64Array, block: int, every: int
) -> Float64Array:
    """Sums over blocks for fitting a residual by the prediction's slopes and its curvature.

    Parameters
    ----------
    predicted, fired
        (rows, cols, 3) linear light, see `light_of`: there a blurred image is the mean of sharp ones.
    weight
        (rows, cols).
    scale
        (3,) usual size of the residual of each channel, as lightness: light over three times its cube root squared.
        Residuals count up to four times that.
    block
        Side of a block, pixels.
    every
        Only every so manieth row counts.

    Returns
    -------
    ndarray
        (block rows, block cols, 9): x x, x y, x c, y y, y c, c c of the slopes x, y and the curvature c; then their
        products with the residual; all as lightness.
    """
    rows, cols = weight.shape
    out = np.zeros(((rows + block - 1) // block, (cols + block - 1) // block, 9))
    for row in range(1, rows - 1, every):
        i = row // block
        for col in range(1, cols - 1):
            share = weight[row, col]
            if share <= 0.0:
                continue
            j = col // block
            for c in range(3):
                here = predicted[row, col, c]
                left, right = predicted[row, col - 1, c], predicted[row, col + 1, c]
                up, down = predicted[row - 1, col, c], predicted[row + 1, col, c]
                x, y, curve = 0.5 * (right - left), 0.5 * (down - up), left + right + up + down - 4.0 * here
                root = np.cbrt(max(np.float64(here), LEAST_LIGHT))
                steep = 1.0 / (3.0 * root * root)
                most = 4.0 * scale[c]
                rest = min(max(steep * (fired[row, col, c] - here), -most), most)
                counts = share * steep / (scale[c] * scale[c])
                out[i, j, 0] += counts * steep * x * x
                out[i, j, 1] += counts * steep * x * y
                out[i, j, 2] += counts * steep * x * curve
                out[i, j, 3] += counts * steep * y * y
                out[i, j, 4] += counts * steep * y * curve
                out[i, j, 5] += counts * steep * curve * curve
                out[i, j, 6] += counts * x * rest
                out[i, j, 7] += counts * y * rest
                out[i, j, 8] += counts * curve * rest
    return out


def steepness(light: NDArray[np.floating]) -> Float64Array:
    """How much lightness changes with light, up to a factor of 116: the slope of the cube root."""
    return np.asarray(1.0 / (3.0 * np.cbrt(np.maximum(np.asarray(light, dtype=np.float64), LEAST_LIGHT)) ** 2))


def slopes_plain(predicted: FloatImage) -> Float64Array:
    """(3, rows, cols, 3): slopes along x and y, and curvature, 0 in the outermost pixels."""
    image = np.asarray(predicted, dtype=np.float64)
    out = np.zeros((3, *image.shape))
    inner = image[1:-1, 1:-1]
    left, right, up, down = image[1:-1, :-2], image[1:-1, 2:], image[:-2, 1:-1], image[2:, 1:-1]
    out[0, 1:-1, 1:-1] = 0.5 * (right - left)
    out[1, 1:-1, 1:-1] = 0.5 * (down - up)
    out[2, 1:-1, 1:-1] = left + right + up + down - 4.0 * inner
    return out


def block_sums_plain(
    predicted: FloatImage, fired: FloatImage, weight: FloatImage, scale: Float64Array, block: int, every: int
) -> Float64Array:
    """Twin of `block_sums`."""
    steep = steepness(predicted)
    slopes = steep * slopes_plain(predicted)
    rest = np.clip(steep * (np.asarray(fired, dtype=np.float64) - predicted), -4.0 * scale, 4.0 * scale)
    counts = np.asarray(weight, dtype=np.float64)[..., np.newaxis] / scale**2
    counts[np.arange(len(counts)) % every != 1 % every] = 0.0
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    products = [slopes[i] * slopes[j] for i, j in pairs] + [slope * rest for slope in slopes]
    values = np.stack([(counts * product).sum(axis=-1) for product in products], axis=-1)
    more = [(0, -side % block) for side in weight.shape]
    values = np.pad(values, [*more, (0, 0)])
    shape = (values.shape[0] // block, block, values.shape[1] // block, block, 9)
    return np.asarray(values.reshape(shape).sum(axis=(1, 3)), dtype=np.float64)


@kernel
def moved_by(predicted: FloatImage, moves: Float64Array, block: int) -> FloatImage:
    """Linear light, a little shifted and blurred, to first order; the outermost pixels stay.

    ``moves``: (block rows, block cols, 3), factors of the slopes x and y and of the curvature in the middle of each
    block; between the middles they go over linearly.
    """
    rows, cols = predicted.shape[:2]
    high, wide = moves.shape[:2]
    out = predicted.copy()
    factor = np.empty(3)
    for row in range(1, rows - 1):
        at = min(max((row + 0.5) / block - 0.5, 0.0), high - 1.0)
        i = int(at)
        below, down_share = min(i + 1, high - 1), at - i
        for col in range(1, cols - 1):
            across = min(max((col + 0.5) / block - 0.5, 0.0), wide - 1.0)
            j = int(across)
            after, right_share = min(j + 1, wide - 1), across - j
            for k in range(3):
                top = moves[i, j, k] * (1.0 - right_share) + moves[i, after, k] * right_share
                bottom = moves[below, j, k] * (1.0 - right_share) + moves[below, after, k] * right_share
                factor[k] = top * (1.0 - down_share) + bottom * down_share
            for c in range(3):
                here = predicted[row, col, c]
                left, right = predicted[row, col - 1, c], predicted[row, col + 1, c]
                up, down = predicted[row - 1, col, c], predicted[row + 1, col, c]
                slope = 0.5 * (factor[0] * (right - left) + factor[1] * (down - up))
                out[row, col, c] = here + slope + factor[2] * (left + right + up + down - 4.0 * here)
    return out


def moved_by_plain(predicted: FloatImage, moves: Float64Array, block: int) -> Float64Array:
    """Twin of `moved_by`."""
    places = np.meshgrid(*((np.arange(side) + 0.5) / block - 0.5 for side in predicted.shape[:2]), indexing="ij")
    factors = [ndimage.map_coordinates(moves[..., k], places, order=1, mode="nearest") for k in range(3)]
    slopes = slopes_plain(predicted)
    return np.asarray(
        predicted + sum(slope * factor[..., np.newaxis] for slope, factor in zip(slopes, factors, strict=True))
    )


@kernel
def block_means(values: FloatImage, weight: FloatImage, most: Float64Array, block: int) -> Float64Array:
    """Sums over blocks of a residual, each pixel's cut to ``most`` (3,), and of the weight.

    Returns
    -------
    ndarray
        (block rows, block cols, 4).
    """
    rows, cols = weight.shape
    out = np.zeros(((rows + block - 1) // block, (cols + block - 1) // block, 4))
    for row in range(rows):
        i = row // block
        for col in range(cols):
            share = weight[row, col]
            if share > 0.0:
                j = col // block
                for c in range(3):
                    out[i, j, c] += share * min(max(values[row, col, c], -most[c]), most[c])
                out[i, j, 3] += share
    return out


def block_means_plain(values: FloatImage, weight: FloatImage, most: Float64Array, block: int) -> Float64Array:
    """Twin of `block_means`."""
    cut = np.clip(np.asarray(values, dtype=np.float64), -most, most)
    counted = np.concatenate([cut, np.ones((*weight.shape, 1))], axis=-1) * weight[..., np.newaxis]
    counted = np.pad(counted, [*((0, -side % block) for side in weight.shape), (0, 0)])
    shape = (counted.shape[0] // block, block, counted.shape[1] // block, block, 4)
    return np.asarray(counted.reshape(shape).sum(axis=(1, 3)), dtype=np.float64)


@kernel
def less_blocks(values: FloatImage, weight: FloatImage, grid: Float64Array, block: int) -> FloatImage:
    """A residual less values (block rows, block cols, 3) in the middles of blocks, linear between; 0 without weight."""
    rows, cols = weight.shape
    high, wide = grid.shape[:2]
    out = np.zeros_like(values)
    for row in range(rows):
        at = min(max((row + 0.5) / block - 0.5, 0.0), high - 1.0)
        i = int(at)
        below, down = min(i + 1, high - 1), at - i
        for col in range(cols):
            if weight[row, col] <= 0.0:
                continue
            across = min(max((col + 0.5) / block - 0.5, 0.0), wide - 1.0)
            j = int(across)
            after, right = min(j + 1, wide - 1), across - j
            for c in range(3):
                top = grid[i, j, c] * (1.0 - right) + grid[i, after, c] * right
                bottom = grid[below, j, c] * (1.0 - right) + grid[below, after, c] * right
                out[row, col, c] = values[row, col, c] - top * (1.0 - down) - bottom * down
    return out


def less_blocks_plain(values: FloatImage, weight: FloatImage, grid: Float64Array, block: int) -> Float64Array:
    """Twin of `less_blocks`."""
    places = np.meshgrid(*((np.arange(side) + 0.5) / block - 0.5 for side in weight.shape), indexing="ij")
    slow = [ndimage.map_coordinates(grid[..., c], places, order=1, mode="nearest") for c in range(3)]
    return np.where(weight[..., np.newaxis] > 0.0, values - np.stack(slow, axis=-1), 0.0)
