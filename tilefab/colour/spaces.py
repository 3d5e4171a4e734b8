"""CIE colour spaces under D50, the ICC connection space, and the CIEDE2000 colour difference.

XYZ is scaled so that the reference white has Y = 1. Lab means CIELAB relative to `WHITE_XYZ_D50` everywhere.
Computation is float64; float32 goes in and out where images are meant.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float64Array = NDArray[np.float64]

WHITE_XYZ_D50 = (0.9642, 1.0, 0.8249)
"""White of the ICC profile connection space (ICC.1:2001-04, Annex A), Y = 1."""

_EPSILON = (6.0 / 29.0) ** 3
_SLOPE = (29.0 / 6.0) ** 2 / 3.0

# From the sRGB primaries (IEC 61966-2-1) and white D65 (x 0.3127, y 0.3290), adapted to the ICC D50 by
# Bradford.
XYZ_D50_FROM_RGB_LIN = np.array(
    [
        [0.4360412516, 0.3851129108, 0.1430458376],
        [0.2224845402, 0.7169050786, 0.0606103812],
        [0.0139201875, 0.0970672387, 0.7139125738],
    ]
)
RGB_LIN_FROM_XYZ_D50 = np.array(
    [
        [3.1341863642, -1.6172089590, -0.4906940640],
        [-0.9787485042, 1.9161300968, 0.0334333992],
        [0.0719639278, -0.2289938735, 1.4057537329],
    ]
)


def _triples(values: ArrayLike, name: str) -> Float64Array:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name} must have 3 values on its last axis, but its shape is {array.shape}")
    return array


def lab_from_xyz(xyz_d50: ArrayLike) -> Float64Array:
    """CIELAB of tristimulus values under D50.

    Parameters
    ----------
    xyz_d50
        (..., 3), Y = 1 for the reference white. Values below zero follow the linear part of the curve.

    Returns
    -------
    numpy.ndarray
        (..., 3) float64: L* 0 to 100 for reflecting colours, a*, b*.

    Raises
    ------
    ValueError
        If the last axis does not have 3 values.

    References
    ----------
    CIE 15:2004, section 8.2.1.

    Examples
    --------
    >>> lab_from_xyz([0.9642, 1.0, 0.8249]).round(6).tolist()
    [100.0, 0.0, 0.0]
    """
    ratio = _triples(xyz_d50, "xyz_d50") / np.array(WHITE_XYZ_D50)
    f = np.where(ratio > _EPSILON, np.cbrt(np.maximum(ratio, 0.0)), ratio * _SLOPE + 4.0 / 29.0)
    lightness = 116.0 * f[..., 1] - 16.0
    return np.stack([lightness, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], axis=-1)


def xyz_from_lab(lab_d50: ArrayLike) -> Float64Array:
    """Tristimulus values under D50 of CIELAB colours: the inverse of `lab_from_xyz`.

    Parameters
    ----------
    lab_d50
        (..., 3): L*, a*, b*.

    Returns
    -------
    numpy.ndarray
        (..., 3) float64, Y = 1 for the reference white. Lab outside the world of real colours may give values
        below zero.

    Raises
    ------
    ValueError
        If the last axis does not have 3 values.

    References
    ----------
    CIE 15:2004, section 8.2.1, solved for XYZ.

    Examples
    --------
    >>> xyz_from_lab([100.0, 0.0, 0.0]).round(6).tolist()
    [0.9642, 1.0, 0.8249]
    """
    lab = _triples(lab_d50, "lab_d50")
    fy = (lab[..., 0] + 16.0) / 116.0
    f = np.stack([fy + lab[..., 1] / 500.0, fy, fy - lab[..., 2] / 200.0], axis=-1)
    ratio = np.where(f > 6.0 / 29.0, f**3, (f - 4.0 / 29.0) / _SLOPE)
    return np.asarray(ratio * np.array(WHITE_XYZ_D50), dtype=np.float64)


def relative_lab(lab_d50: ArrayLike, white_lab: ArrayLike) -> Float64Array:
    """Lab against a white of its own, (..., 3), of absolute Lab (..., 3): XYZ scaled as ICC profiles do."""
    return lab_from_xyz(xyz_from_lab(lab_d50) / xyz_from_lab(white_lab) * np.array(WHITE_XYZ_D50))


def absolute_lab(lab_relative: ArrayLike, white_lab: ArrayLike) -> Float64Array:
    """The inverse of `relative_lab`."""
    return lab_from_xyz(xyz_from_lab(lab_relative) * xyz_from_lab(white_lab) / np.array(WHITE_XYZ_D50))


def rgb_lin_from_srgb(srgb: ArrayLike) -> Float64Array:
    """Linear light of sRGB values 0 to 1 (IEC 61966-2-1), any shape, float64."""
    encoded = np.asarray(srgb, dtype=np.float64)
    toe = encoded / 12.92
    return np.where(encoded <= 0.04045, toe, ((np.maximum(encoded, 0.04045) + 0.055) / 1.055) ** 2.4)


def srgb_from_rgb_lin(rgb_lin: ArrayLike) -> Float64Array:
    """The inverse of `rgb_lin_from_srgb`."""
    linear = np.asarray(rgb_lin, dtype=np.float64)
    high = 1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, high)


def srgb_from_xyz(xyz_d50: ArrayLike) -> NDArray[np.float32]:
    """Colours for a screen preview: sRGB of tristimulus values under D50, clipped to what a screen shows.

    Parameters
    ----------
    xyz_d50
        (..., 3), Y = 1 for the reference white.

    Returns
    -------
    numpy.ndarray
        (..., 3) float32, 0 to 1, sRGB curve applied; the D50 white becomes (1, 1, 1) by Bradford adaptation.

    Raises
    ------
    ValueError
        If the last axis does not have 3 values.

    References
    ----------
    IEC 61966-2-1:1999; Bradford matrix from ICC.1:2010, Annex E.

    Examples
    --------
    >>> srgb_from_xyz([0.9642, 1.0, 0.8249]).tolist()
    [1.0, 1.0, 1.0]
    """
    rgb_lin = np.clip(_triples(xyz_d50, "xyz_d50") @ RGB_LIN_FROM_XYZ_D50.T, 0.0, 1.0)
    return np.asarray(srgb_from_rgb_lin(rgb_lin).round(7).clip(0.0, 1.0), dtype=np.float32)


def delta_e_2000(lab1: ArrayLike, lab2: ArrayLike) -> Any:
    """CIEDE2000 colour difference with all weights 1.

    Parameters
    ----------
    lab1, lab2
        (..., 3) CIELAB colours that broadcast against each other.

    Returns
    -------
    numpy.ndarray or numpy.float64
        (...) float64, 0 upwards.

    Raises
    ------
    ValueError
        If a last axis does not have 3 values.

    References
    ----------
    G. Sharma, W. Wu, E. N. Dalal, "The CIEDE2000 color-difference formula: implementation notes,
    supplementary test data, and mathematical observations", Color Research and Application 30 (2005),
    equations 2 to 22.

    Examples
    --------
    >>> round(float(delta_e_2000([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485])), 4)
    2.0425
    """
    first, second = _triples(lab1, "lab1"), _triples(lab2, "lab2")
    l1, a1, b1 = first[..., 0], first[..., 1], first[..., 2]
    l2, a2, b2 = second[..., 0], second[..., 1], second[..., 2]

    c_mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2.0
    c_mean_7 = c_mean**7
    g = 0.5 * (1.0 - np.sqrt(c_mean_7 / (c_mean_7 + 25.0**7)))
    a1_prime, a2_prime = (1.0 + g) * a1, (1.0 + g) * a2
    c1, c2 = np.hypot(a1_prime, b1), np.hypot(a2_prime, b2)
    h1 = np.degrees(np.arctan2(b1, a1_prime)) % 360.0
    h2 = np.degrees(np.arctan2(b2, a2_prime)) % 360.0

    has_hue = c1 * c2 > 0.0
    turn = h2 - h1
    turn = np.where(turn > 180.0, turn - 360.0, np.where(turn < -180.0, turn + 360.0, turn))
    turn = np.where(has_hue, turn, 0.0)
    delta_l, delta_c = l2 - l1, c2 - c1
    delta_h = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(turn) / 2.0)

    l_bar, c_bar, h_sum = (l1 + l2) / 2.0, (c1 + c2) / 2.0, h1 + h2
    far = np.abs(h1 - h2) > 180.0
    h_bar = np.where(far, np.where(h_sum < 360.0, h_sum + 360.0, h_sum - 360.0), h_sum) / 2.0
    h_bar = np.where(has_hue, h_bar, h_sum)
    t = (
        1.0
        - 0.17 * np.cos(np.radians(h_bar - 30.0))
        + 0.24 * np.cos(np.radians(2.0 * h_bar))
        + 0.32 * np.cos(np.radians(3.0 * h_bar + 6.0))
        - 0.20 * np.cos(np.radians(4.0 * h_bar - 63.0))
    )
    c_bar_7 = c_bar**7
    rotation = -2.0 * np.sqrt(c_bar_7 / (c_bar_7 + 25.0**7))
    rotation = rotation * np.sin(np.radians(60.0 * np.exp(-(((h_bar - 275.0) / 25.0) ** 2))))
    s_l = 1.0 + 0.015 * (l_bar - 50.0) ** 2 / np.sqrt(20.0 + (l_bar - 50.0) ** 2)
    term_l = delta_l / s_l
    term_c = delta_c / (1.0 + 0.045 * c_bar)
    term_h = delta_h / (1.0 + 0.015 * c_bar * t)
    squared = term_l**2 + term_c**2 + term_h**2 + rotation * term_c * term_h
    return np.sqrt(np.maximum(squared, 0.0))
