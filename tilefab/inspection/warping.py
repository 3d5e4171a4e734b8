"""An image resampled onto the face grid of its tile."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilefab.chart.finding import project
from tilefab.inspection.registration_kernels import resample
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]


def warp_to_face(image: FloatImage, matrix: Float64Array, shape: tuple[int, int]) -> tuple[FloatImage, Mask]:
    """An image resampled onto the face grid.

    By Keys' cubic where the image is coarser than the grid or up to 1.5 times as fine, else by means over each grid
    pixel, so that nothing the image shows is skipped.

    Parameters
    ----------
    image
        (R, C, K) float32.
    matrix
        (3, 3): from (x, y, 1) in pixels of the face grid to pixels of the image.
    shape
        (rows, cols) of the face grid.

    Returns
    -------
    warped, inside
        (rows, cols, K) float32, and (rows, cols) bool: whether the pixel's middle lies in the image; 0 where it
        doesn't.

    Raises
    ------
    ValueError
        If the image isn't float32 of three axes, or the matrix isn't a homography.
    """
    if image.ndim != 3 or image.dtype != np.float32 or min(image.shape) < 1:
        raise ValueError(f"the image must be float32 (rows, cols, channels), not {image.dtype} {image.shape}")
    check_matrix(matrix)
    taps = max(1, math.floor(scale_of(matrix, shape) + 0.5))
    warped = np.empty((*shape, image.shape[2]), dtype=np.float32)
    inside = np.empty(shape, dtype=np.bool_)
    resample(np.ascontiguousarray(image), np.ascontiguousarray(matrix, dtype=np.float64), taps, warped, inside)
    return warped, inside


def warp_mask_to_face(mask: Mask, matrix: Float64Array, shape: tuple[int, int]) -> Mask:
    """A mask of the image on the face grid: True where only good pixels go into the value that `warp_to_face` gives."""
    warped, inside = warp_to_face(mask.astype(np.float32)[:, :, np.newaxis], matrix, shape)
    return np.asarray(inside & (np.abs(warped[:, :, 0] - 1.0) < 1e-3), dtype=np.bool_)


def check_matrix(matrix: Float64Array) -> None:
    """Raise ValueError unless it is a homography."""
    if (
        matrix.shape != (3, 3)
        or not np.isfinite(matrix).all()
        or not min(abs(np.linalg.det(matrix)), abs(matrix[2, 2])) > 1e-12
    ):
        raise ValueError(f"no homography: {np.asarray(matrix).tolist()}")


def scale_of(matrix: Float64Array, shape: tuple[int, int]) -> float:
    """Pixels of the image for one of the grid, at its middle."""
    x, y = 0.5 * shape[1], 0.5 * shape[0]
    across, down, middle = project(matrix, np.array([[x + 0.5, y], [x, y + 0.5], [x, y]]))
    one, other = 2.0 * (across - middle), 2.0 * (down - middle)
    return float(math.sqrt(abs(one[0] * other[1] - one[1] * other[0])))
