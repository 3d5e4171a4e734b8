"""Oklab: a space in which colours of one hue lie straight, so that mapping along a line keeps the hue people see.

CIELAB turns blues towards purple when their chroma falls; gamut mapping therefore happens here. Values are of colours
relative to the unprinted tile.

References
----------
B. Ottosson, "A perceptual color space for image processing" (2020); Bradford adaptation by ICC.1:2010, Annex E.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import lab_from_xyz, xyz_from_lab

Float64Array = NDArray[np.float64]

_XYZ_D65_FROM_D50 = np.array(
    [[0.9555766, -0.0230393, 0.0631636], [-0.0282895, 1.0099416, 0.0210077], [0.0122982, -0.0204830, 1.3299098]]
)
_CONES_FROM_XYZ = np.array(
    [
        [0.8189330101, 0.3618667424, -0.1288597137],
        [0.0329845436, 0.9293118715, 0.0361456387],
        [0.0482003018, 0.2643662691, 0.6338517070],
    ]
)
_OKLAB_FROM_CONES = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
_TO_CONES = _CONES_FROM_XYZ @ _XYZ_D65_FROM_D50
_FROM_CONES = np.linalg.inv(_TO_CONES)
_FROM_OKLAB = np.linalg.inv(_OKLAB_FROM_CONES)


def oklab_from_lab(lab_d50: NDArray[np.floating]) -> Float64Array:
    """Oklab (..., 3) of CIELAB under D50 (..., 3): lightness 0 to 1, and two colour axes of up to about 0.3.

    >>> oklab_from_lab(np.array([100.0, 0.0, 0.0])).round(3).tolist()
    [1.0, 0.0, 0.0]
    """
    cones = xyz_from_lab(lab_d50) @ _TO_CONES.T
    return np.asarray(np.cbrt(cones) @ _OKLAB_FROM_CONES.T, dtype=np.float64)


def lab_from_oklab(oklab: NDArray[np.floating]) -> Float64Array:
    """The inverse of `oklab_from_lab`."""
    cones = (np.asarray(oklab, dtype=np.float64) @ _FROM_OKLAB.T) ** 3
    return lab_from_xyz(cones @ _FROM_CONES.T)
