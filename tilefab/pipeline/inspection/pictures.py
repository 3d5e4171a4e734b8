"""Pictures of tiles for people: small, in sRGB."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from tilefab.colour import srgb_from_xyz

RgbImage = NDArray[np.uint8]


def picture_of(xyz: NDArray[np.floating], most_px: int) -> RgbImage:
    """A picture of colours.

    Parameters
    ----------
    xyz
        (rows, cols, 3) XYZ under D50, Y = 1 for white.
    most_px
        Most pixels of the longer side; larger images are reduced in linear light by a whole number.

    Returns
    -------
    ndarray
        (rows, cols, 3) uint8 sRGB.
    """
    step = max(1, math.ceil(max(xyz.shape[:2]) / most_px))
    rows, cols = max(1, xyz.shape[0] // step), max(1, xyz.shape[1] // step)
    high, wide = min(step, xyz.shape[0]), min(step, xyz.shape[1])
    small = xyz[: rows * high, : cols * wide].reshape(rows, high, cols, wide, 3).mean(axis=(1, 3))
    shown: RgbImage = np.rint(255.0 * np.clip(srgb_from_xyz(small), 0.0, 1.0)).astype(np.uint8)
    return shown


def read_picture(path: Path) -> RgbImage | None:
    """A picture that was kept; ``None`` if it is gone, or no picture any more."""
    try:
        with Image.open(path) as image:
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, UnidentifiedImageError, ValueError):
        return None
