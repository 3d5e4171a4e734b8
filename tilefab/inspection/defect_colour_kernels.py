"""Inner loops of what a firing does to colours: arrays in, arrays out; see `tilefab.inspection.defect_residual`.

Images are float32 (rows, cols, 3), in CIELAB; pixels of no use have weight 0. The twins ``..._plain`` say the same in
NumPy, slowly; tests hold the kernels against them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.jit import kernel
from tilefab.types import FloatImage

Float64Array = NDArray[np.float64]

COLOUR_TERMS = 11
"""Terms of a colour itself, see `mapped`."""

MOST_APART = 3.0
"""Colours further from the middle than so many standard deviations count as so far: powers mustn't run away."""

PLACE_TERMS = 5
"""x, y, x2, xy, y2 of a place, both axes from -1 to 1 over the tile."""


@kernel
def mapped(
    lab: FloatImage,
    inks: FloatImage,
    most_ink: Float64Array,
    middle: Float64Array,
    turn: Float64Array,
    colour: Float64Array,
    place: Float64Array,
) -> FloatImage:
    """Predicted colours as this firing and this light show them.

    Parameters
    ----------
    lab
        (rows, cols, 3) predicted.
    inks
        (rows, cols, N) ink fractions; N may be 0.
    most_ink
        (N,) what is more counts as this.
    middle, turn
        (3,) and (3, 3): coordinates u = turn @ (lab - middle) of a colour, cut to ``MOST_APART``.
    colour
        (11 + N + N (N + 1) / 2, 3): of 1, u, the six products of two of u, and the cube of the first; then of inks and
        of the products of two of them.
    place
        (2, 5, 3): of the place's terms, times (L* + 16) / 100, and times the channel's own a* or b* / 100.
    """
    rows, cols = lab.shape[:2]
    count = inks.shape[2]
    out = np.empty_like(lab)
    spot, terms, laid = np.empty(PLACE_TERMS), np.empty(colour.shape[0]), np.empty(count)
    for row in range(rows):
        y = (2.0 * row + 1.0) / rows - 1.0
        for col in range(cols):
            x = (2.0 * col + 1.0) / cols - 1.0
            d0, d1, d2 = lab[row, col, 0] - middle[0], lab[row, col, 1] - middle[1], lab[row, col, 2] - middle[2]
            u = min(max(turn[0, 0] * d0 + turn[0, 1] * d1 + turn[0, 2] * d2, -MOST_APART), MOST_APART)
            v = min(max(turn[1, 0] * d0 + turn[1, 1] * d1 + turn[1, 2] * d2, -MOST_APART), MOST_APART)
            w = min(max(turn[2, 0] * d0 + turn[2, 1] * d1 + turn[2, 2] * d2, -MOST_APART), MOST_APART)
            terms[0], terms[1], terms[2], terms[3] = 1.0, u, v, w
            terms[4], terms[5], terms[6], terms[7], terms[8], terms[9] = u * u, u * v, u * w, v * v, v * w, w * w
            terms[10] = u * u * u
            at = COLOUR_TERMS
            for k in range(count):
                laid[k] = min(np.float64(inks[row, col, k]), most_ink[k])
                terms[at] = laid[k]
                at += 1
            for k in range(count):
                for other in range(k, count):
                    terms[at] = laid[k] * laid[other]
                    at += 1
            spot[0], spot[1], spot[2], spot[3], spot[4] = x, y, x * x, x * y, y * y
            bright = 0.01 * (lab[row, col, 0] + 16.0)
            for c in range(3):
                value = 0.0
                for k in range(terms.size):
                    value += terms[k] * colour[k, c]
                own = 0.01 * lab[row, col, c] if c > 0 else 0.0
                for k in range(PLACE_TERMS):
                    value += spot[k] * (bright * place[0, k, c] + own * place[1, k, c])
                out[row, col, c] = lab[row, col, c] + value
    return out


def colour_terms(
    lab: NDArray[np.floating], inks: NDArray[np.floating], middle: Float64Array, turn: Float64Array
) -> Float64Array:
    """(..., terms) of colours (..., 3) and inks (..., N): see `mapped`."""
    apart = (np.asarray(lab, dtype=np.float64) - middle) @ turn.T
    u, v, w = np.moveaxis(np.clip(apart, -MOST_APART, MOST_APART), -1, 0)
    terms = [np.ones_like(u), u, v, w, u * u, u * v, u * w, v * v, v * w, w * w, u**3]
    laid = [np.asarray(inks[..., k], dtype=np.float64) for k in range(inks.shape[-1])]
    terms += laid
    terms += [one * other for k, one in enumerate(laid) for other in laid[k:]]
    return np.stack(terms, axis=-1)


def place_terms(rows: int, cols: int) -> Float64Array:
    """(rows, cols, 5) terms of places: see `mapped`."""
    y, x = np.meshgrid(
        (2.0 * np.arange(rows) + 1.0) / rows - 1.0, (2.0 * np.arange(cols) + 1.0) / cols - 1.0, indexing="ij"
    )
    return np.stack([x, y, x * x, x * y, y * y], axis=-1)


def mapped_plain(
    lab: FloatImage,
    inks: FloatImage,
    most_ink: Float64Array,
    middle: Float64Array,
    turn: Float64Array,
    colour: Float64Array,
    place: Float64Array,
) -> Float64Array:
    """Twin of `mapped`."""
    spots = place_terms(*lab.shape[:2])
    own = np.asarray(lab, dtype=np.float64) / 100.0
    own[..., 0] = 0.0
    bright = (np.asarray(lab[..., :1], dtype=np.float64) + 16.0) / 100.0
    moved = (
        colour_terms(lab, np.minimum(inks, most_ink), middle, turn) @ colour
        + bright * (spots @ place[0])
        + own * (spots @ place[1])
    )
    return np.asarray(lab + moved, dtype=np.float64)


@kernel
def distance_squared(image: FloatImage, middle: Float64Array, inverse: Float64Array) -> FloatImage:
    """(rows, cols) squared distance of values (rows, cols, K) from a middle (K,), by an inverse covariance (K, K)."""
    rows, cols, count = image.shape
    out = np.empty((rows, cols), dtype=np.float32)
    off = np.empty(count)
    for row in range(rows):
        for col in range(cols):
            for k in range(count):
                off[k] = image[row, col, k] - middle[k]
            total = 0.0
            for k in range(count):
                for other in range(count):
                    total += off[k] * inverse[k, other] * off[other]
            out[row, col] = total
    return out


def distance_squared_plain(image: FloatImage, middle: Float64Array, inverse: Float64Array) -> Float64Array:
    """Twin of `distance_squared`."""
    off = np.asarray(image, dtype=np.float64) - middle
    return np.asarray(np.einsum("rck,kl,rcl->rc", off, inverse, off), dtype=np.float64)


@kernel
def colour_sums(
    lab: FloatImage,
    values: FloatImage,
    weight: FloatImage,
    axes: Float64Array,
    most: Float64Array,
    shape: tuple[int, int],
) -> Float64Array:
    """Sums of a residual by the prediction's colour.

    Parameters
    ----------
    lab, values, weight
        (rows, cols, 3) prediction, (rows, cols, 3) residual, (rows, cols).
    axes
        (2, 4): cell coordinates of a colour are its products with the first three numbers of a row, plus the fourth;
        whole numbers are the middles of cells, and colours beyond the last cell count there.
    most
        (3,) the most that a pixel's residual counts.
    shape
        How many cells along either axis.

    Returns
    -------
    ndarray
        (cells, cells, 4): sums of the residual and of the weight.
    """
    rows, cols = weight.shape
    out = np.zeros((shape[0], shape[1], 4))
    for row in range(rows):
        for col in range(cols):
            share = weight[row, col]
            if share <= 0.0:
                continue
            i, j = 0, 0
            for k in range(2):
                at = axes[k, 3]
                for c in range(3):
                    at += axes[k, c] * lab[row, col, c]
                cell = int(min(max(np.floor(at + 0.5), 0.0), shape[k] - 1.0))
                if k == 0:
                    i = cell
                else:
                    j = cell
            for c in range(3):
                out[i, j, c] += share * min(max(values[row, col, c], -most[c]), most[c])
            out[i, j, 3] += share
    return out


def _cells_plain(lab: FloatImage, axes: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """(2, rows, cols) cell coordinates of colours, within the cells."""
    places = np.moveaxis(np.asarray(lab, dtype=np.float64) @ axes[:, :3].T + axes[:, 3], -1, 0)
    return np.clip(places, 0.0, np.array(shape, dtype=np.float64)[:, np.newaxis, np.newaxis] - 1.0)


def colour_sums_plain(
    lab: FloatImage,
    values: FloatImage,
    weight: FloatImage,
    axes: Float64Array,
    most: Float64Array,
    shape: tuple[int, int],
) -> Float64Array:
    """Twin of `colour_sums`."""
    i, j = np.floor(_cells_plain(lab, axes, shape) + 0.5).astype(np.int64)
    out = np.zeros((*shape, 4))
    counted = np.clip(np.asarray(values, dtype=np.float64), -most, most)
    np.add.at(out, (i, j), np.concatenate([counted, np.ones((*weight.shape, 1))], axis=-1) * weight[..., np.newaxis])
    return out


@kernel
def by_colour(lab: FloatImage, axes: Float64Array, table: Float64Array) -> FloatImage:
    """Values (rows, cols, K) of a table (cells, cells, K) at the colours of an image, linear between cells' middles.

    ``axes``: as `colour_sums` has them.
    """
    rows, cols = lab.shape[:2]
    high, wide, channels = table.shape
    out = np.empty((rows, cols, channels), dtype=np.float32)
    for row in range(rows):
        for col in range(cols):
            at, across = axes[0, 3], axes[1, 3]
            for c in range(3):
                at += axes[0, c] * lab[row, col, c]
                across += axes[1, c] * lab[row, col, c]
            at, across = min(max(at, 0.0), high - 1.0), min(max(across, 0.0), wide - 1.0)
            i, j = min(int(at), high - 2), min(int(across), wide - 2)
            down, right = at - i, across - j
            for c in range(channels):
                top = table[i, j, c] * (1.0 - right) + table[i, j + 1, c] * right
                bottom = table[i + 1, j, c] * (1.0 - right) + table[i + 1, j + 1, c] * right
                out[row, col, c] = top * (1.0 - down) + bottom * down
    return out


def by_colour_plain(lab: FloatImage, axes: Float64Array, table: Float64Array) -> Float64Array:
    """Twin of `by_colour`."""
    places = _cells_plain(lab, axes, (table.shape[0], table.shape[1]))
    values = [ndimage.map_coordinates(table[..., c], places, order=1, mode="nearest") for c in range(table.shape[2])]
    return np.stack(values, axis=-1)
