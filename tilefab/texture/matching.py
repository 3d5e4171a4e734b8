"""Finding where one image resembles a part of another, exactly and in integers.

Colours are compared in CIELAB, quantised to half units, so that sums of squares are integers: a sum computed by FFT
and rounded is then the true sum, whatever the machine or the FFT library, and so is the place that is chosen by it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tilefab.jit import kernel
from tilefab.types import Mask

LAB_STEPS_PER_UNIT = 2
"""Matching counts CIELAB in half units: a squared difference of 4 is a squared CIE76 difference of 1."""


def matching_image(lab_d50: NDArray[np.floating]) -> NDArray[np.int16]:
    """CIELAB in half units as integers, (rows, cols, 3), the form in which images are matched."""
    steps: NDArray[np.int16] = np.rint(np.asarray(lab_d50, dtype=np.float64) * LAB_STEPS_PER_UNIT).astype(np.int16)
    return steps


def reduced(image: NDArray[np.int16], factor: int) -> NDArray[np.int16]:
    """Mean over ``factor`` x ``factor`` blocks, rounded half up; incomplete blocks at the far edges are dropped."""
    if factor == 1:
        return image
    rows, cols = image.shape[0] // factor, image.shape[1] // factor
    blocks = image[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor, image.shape[2])
    total = blocks.sum(axis=(1, 3), dtype=np.int64)
    mean: NDArray[np.int16] = ((2 * total + factor * factor) // (2 * factor * factor)).astype(np.int16)
    return mean


def reduced_mask(mask: Mask, factor: int) -> Mask:
    """True where a whole ``factor`` x ``factor`` block is True; incomplete blocks at the far edges are dropped."""
    if factor == 1:
        return mask
    rows, cols = mask.shape[0] // factor, mask.shape[1] // factor
    blocks = mask[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor)
    return np.asarray(blocks.all(axis=(1, 3)))


def window_sums(values: NDArray[np.int64], rows: int, cols: int) -> NDArray[np.int64]:
    """Sum over every window of ``rows`` x ``cols``, by the place of its top left corner.

    Returns
    -------
    ndarray of int64
        (image rows - rows + 1, image cols - cols + 1); empty if the window is larger than the image.
    """
    height, width = values.shape[0], values.shape[1]
    if rows > height or cols > width:
        return np.zeros((max(height - rows + 1, 0), max(width - cols + 1, 0)), dtype=np.int64)
    total = np.zeros((height + 1, width + 1), dtype=np.int64)
    np.cumsum(np.cumsum(values, axis=0), axis=1, out=total[1:, 1:])
    return total[rows:, cols:] - total[:-rows, cols:] - total[rows:, :-cols] + total[:-rows, :-cols]


def window_is_valid(valid: Mask, rows: int, cols: int) -> Mask:
    """Where a window of ``rows`` x ``cols`` may have its top left corner so that all of it is valid.

    Returns
    -------
    ndarray of bool
        As for `window_sums`.
    """
    if rows > valid.shape[0] or cols > valid.shape[1]:
        return window_sums(np.zeros(valid.shape, dtype=np.int64), rows, cols) > 0
    return np.asarray(window_sums((~valid).astype(np.int64), rows, cols) == 0)


@kernel
def largest_square(mask: Mask) -> int:
    """Side of the largest square that is True throughout, row by row from the sides of those that end above.

    Twin: `largest_square_plain`.
    """
    cols = mask.shape[1]
    ending = np.zeros(cols + 1, np.int64)  # by the column after their last
    best = 0
    for row in range(mask.shape[0]):
        above_left = 0
        for col in range(cols):
            above = ending[col + 1]
            if mask[row, col]:
                side = min(above, above_left, ending[col]) + 1
                ending[col + 1] = side
                best = max(best, side)
            else:
                ending[col + 1] = 0
            above_left = above
    return best


def largest_square_plain(mask: Mask) -> int:
    """Plain twin of `largest_square`, by bisection."""
    low, high = 0, min(mask.shape)
    while low < high:
        middle = (low + high + 1) // 2
        if window_is_valid(mask, middle, middle).any():
            low = middle
        else:
            high = middle - 1
    return low


class TemplateSearch:
    """Sum of squared differences of a masked template against every window of one image.

    Parameters
    ----------
    image
        (rows, cols, 3) int16 from `matching_image`.

    Notes
    -----
    The image's transforms are made once and serve all searches (Kwatra et al. 2003, section 3.3: sums of squared
    differences by FFT).
    """

    def __init__(self, image: NDArray[np.int16]) -> None:
        self.shape = image.shape[:2]
        self._fft_shape = tuple(fft.next_fast_len(n, real=True) for n in self.shape)
        values = image.astype(np.float64)
        self._image = fft.rfft2(values, self._fft_shape, axes=(0, 1))
        self._square = fft.rfft2((values**2).sum(axis=2), self._fft_shape)

    def squared_differences(self, template: NDArray[np.int16], mask: Mask | NDArray[np.uint8]) -> NDArray[np.int64]:
        """Exact sum of squared differences over the mask, for every place of the template in the image.

        Parameters
        ----------
        template
            (rows, cols, 3) int16; what stands outside the mask doesn't matter.
        mask
            (rows, cols), True where the template counts; or small integers: how much it counts.

        Returns
        -------
        ndarray of int64
            (image rows - rows + 1, image cols - cols + 1).
        """
        rows, cols = mask.shape
        weight = mask.astype(np.float64)
        values = template.astype(np.float64) * weight[..., None]
        spectrum = self._square * np.conj(fft.rfft2(weight, self._fft_shape))
        correlated = self._image * np.conj(fft.rfft2(values, self._fft_shape, axes=(0, 1)))
        spectrum -= 2.0 * correlated.sum(axis=2)
        sums = fft.irfft2(spectrum, self._fft_shape)
        sums = sums[: self.shape[0] - rows + 1, : self.shape[1] - cols + 1]
        squares = template.astype(np.float64) ** 2 * weight[..., None]
        exact: NDArray[np.int64] = np.rint(sums).astype(np.int64) + int(squares.sum())
        return exact


def overlap_differences(
    image: NDArray[np.int16], image_mask: Mask, template: NDArray[np.int16], template_mask: Mask
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sum of squared differences where two masked images overlap, for every place of the smaller in the larger.

    Parameters
    ----------
    image
        (rows, cols, channels) int16.
    image_mask
        (rows, cols), True where it counts.
    template
        (template rows, template cols, channels) int16, no larger.
    template_mask
        (template rows, template cols), True where it counts.

    Returns
    -------
    sums
        (rows - template rows + 1, cols - template cols + 1) int64: over the pixels where both count; exact.
    counts
        Likewise: how many these are.

    Raises
    ------
    ValueError
        If the template is larger than the image.

    Notes
    -----
    Kwatra et al. 2003, section 3.3, entire patch matching; with both masks for what isn't laid yet and may not be.
    """
    rows, cols = (n - m + 1 for n, m in zip(image_mask.shape, template_mask.shape, strict=True))
    if rows < 1 or cols < 1:
        raise ValueError(f"a template {template_mask.shape} doesn't fit into an image {image_mask.shape}")
    shape = tuple(fft.next_fast_len(n, real=True) for n in image_mask.shape)
    inside = image_mask.astype(np.float64)
    weight = template_mask.astype(np.float64)
    values = image.astype(np.float64) * inside[..., None]
    others = template.astype(np.float64) * weight[..., None]
    transform, other_transform = fft.rfft2(inside, shape), np.conj(fft.rfft2(weight, shape))
    spectrum = fft.rfft2((values**2).sum(axis=2), shape) * other_transform
    spectrum += transform * np.conj(fft.rfft2((others**2).sum(axis=2), shape))
    for k in range(image.shape[2]):
        spectrum -= 2.0 * fft.rfft2(values[..., k], shape) * np.conj(fft.rfft2(others[..., k], shape))
    sums, counts = (
        np.rint(fft.irfft2(product, shape)[:rows, :cols]).astype(np.int64)
        for product in (spectrum, transform * other_transform)
    )
    return sums, counts


@kernel
def refine_place(
    image: NDArray[np.int16],
    template: NDArray[np.int16],
    mask: Mask,
    allowed: Mask,
    row: int,
    col: int,
    reach_px: int,
) -> tuple[int, int, int]:
    """Best place of a masked template within ``reach_px`` of (row, col), by exact sum of squared differences.

    Returns
    -------
    tuple of int
        Row and column of the best allowed place, the first in reading order on a tie, and its sum; (-1, -1, -1) if
        no place within reach is allowed.
    """
    best_row, best_col, best = -1, -1, np.int64(-1)
    for r in range(max(0, row - reach_px), min(allowed.shape[0], row + reach_px + 1)):
        for c in range(max(0, col - reach_px), min(allowed.shape[1], col + reach_px + 1)):
            if not allowed[r, c]:
                continue
            total = np.int64(0)
            for i in range(mask.shape[0]):
                for j in range(mask.shape[1]):
                    if mask[i, j]:
                        for k in range(image.shape[2]):
                            d = np.int64(image[r + i, c + j, k]) - np.int64(template[i, j, k])
                            total += d * d
                if 0 <= best <= total:
                    break
            if best < 0 or total < best:
                best_row, best_col, best = r, c, total
    return best_row, best_col, int(best)
