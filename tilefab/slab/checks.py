"""What every step of this room demands of the arrays it is given."""

from __future__ import annotations

import numpy as np

from tilefab.types import FloatImage, Mask


def check_pair(image: FloatImage, valid: Mask) -> None:
    """Refuse an image and mask that do not fit the conventions of the core.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), C-contiguous, at least one pixel.
    valid
        bool, (rows, cols), True = good, at least one True.

    Raises
    ------
    ValueError
        If shape, dtype or memory order is another, or no pixel is valid.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ValueError(f"image has shape {image.shape}, wanted (rows, cols, 3) with at least one pixel")
    if image.dtype != np.float32:
        raise ValueError(f"image is {image.dtype}, wanted float32")
    if not image.flags.c_contiguous:
        raise ValueError("image is not C-contiguous")
    if valid.shape != image.shape[:2]:
        raise ValueError(f"mask has shape {valid.shape}, but the image has {image.shape[:2]}")
    if valid.dtype != np.bool_:
        raise ValueError(f"mask is {valid.dtype}, wanted bool")
    if not valid.any():
        raise ValueError("no pixel is valid")
