"""Pictures for people: reduced without darkening."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import rgb_lin_from_srgb, srgb_from_rgb_lin

_STRIP_ROWS = 256


def reduce_srgb(rgb: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Reduce an sRGB picture by a whole number, averaging light, not numbers.

    Parameters
    ----------
    rgb
        (rows, cols, 3) uint8.
    factor
        >= 1. Rows and columns that don't fill a block are left out; at least one pixel is left.

    Returns
    -------
    ndarray of uint8
        (rows // factor, cols // factor, 3).
    """
    factor = min(factor, rgb.shape[0], rgb.shape[1])
    if factor == 1:
        return rgb
    rows, cols = rgb.shape[0] // factor, rgb.shape[1] // factor
    light_of = rgb_lin_from_srgb(np.arange(256) / 255).astype(np.float32)
    out = np.empty((rows, cols, 3), dtype=np.uint8)
    for top in range(0, rows, _STRIP_ROWS):
        strip = rgb[top * factor : min(top + _STRIP_ROWS, rows) * factor, : cols * factor]
        light = light_of[strip].reshape(strip.shape[0] // factor, factor, cols, factor, 3).mean(axis=(1, 3))
        out[top : top + len(light)] = np.rint(srgb_from_rgb_lin(light) * 255)
    return out
