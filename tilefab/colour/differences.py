"""Colour differences besides CIEDE2000, for tolerances that customers and older standards state in them.

CIE94 and CMC(l:c) weigh a difference by the lightness, chroma and hue of one of the two colours, the standard. So they
are not symmetric: which colour is the standard must be agreed. `tilefab.colour.spaces.delta_e_2000` is symmetric, and
is what tilefab itself reports.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Float64Array = NDArray[np.float64]

_CMC_DARK = 16.0
_CMC_BLUE_DEG = (164.0, 345.0)


def _pairs(one: ArrayLike, other: ArrayLike, names: tuple[str, str]) -> tuple[Float64Array, Float64Array]:
    arrays = []
    for values, name in zip((one, other), names, strict=True):
        array = np.asarray(values, dtype=np.float64)
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ValueError(f"{name} must have 3 values on its last axis, but its shape is {array.shape}")
        arrays.append(array)
    return arrays[0], arrays[1]


def _squared_terms(first: Float64Array, second: Float64Array) -> tuple[Any, Any, Any, Any]:
    """Squared differences of lightness, chroma and hue, and the first colour's chroma.

    What of a* and b* is no difference of chroma is one of hue: 2 (C1 C2 - a1 a2 - b1 b2), without cancelling.
    """
    c1, c2 = np.hypot(first[..., 1], first[..., 2]), np.hypot(second[..., 1], second[..., 2])
    hue = 2.0 * (c1 * c2 - first[..., 1] * second[..., 1] - first[..., 2] * second[..., 2])
    return (second[..., 0] - first[..., 0]) ** 2, (c2 - c1) ** 2, np.maximum(hue, 0.0), c1


def delta_e_76(lab1: ArrayLike, lab2: ArrayLike) -> Any:
    """CIE 1976 colour difference: the plain distance in CIELAB.

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
    CIE 15:2004, section 8.2.1.

    Examples
    --------
    >>> float(delta_e_76([50.0, 3.0, 0.0], [50.0, 0.0, 4.0]))
    5.0
    """
    first, second = _pairs(lab1, lab2, ("lab1", "lab2"))
    return np.sqrt(((second - first) ** 2).sum(axis=-1))


def delta_e_94(lab1: ArrayLike, lab2: ArrayLike, *, textiles: bool = False) -> Any:
    """CIE94 colour difference of a sample from a standard; not symmetric.

    Parameters
    ----------
    lab1
        (..., 3) CIELAB colours of the standard: its chroma weighs the difference.
    lab2
        (..., 3) CIELAB colours of the sample; both broadcast against each other.
    textiles
        With the weights for textiles (k_L 2, K1 0.048, K2 0.014) instead of those for graphic arts (1, 0.045, 0.015).

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
    CIE 116-1995, "Industrial colour-difference evaluation"; the weights for textiles are those in use with it, as
    B. Lindbloom gives them (brucelindbloom.com, "Delta E (CIE 1994)").

    Examples
    --------
    >>> standard, sample = [50.0, 60.0, 0.0], [50.0, 63.7, 0.0]
    >>> round(float(delta_e_94(standard, sample)), 6), round(float(delta_e_94(sample, standard)), 6)
    (1.0, 0.956938)
    """
    first, second = _pairs(lab1, lab2, ("lab1", "lab2"))
    lightness, chroma, hue, c1 = _squared_terms(first, second)
    k_l, k_1, k_2 = (2.0, 0.048, 0.014) if textiles else (1.0, 0.045, 0.015)
    return np.sqrt(lightness / k_l**2 + chroma / (1.0 + k_1 * c1) ** 2 + hue / (1.0 + k_2 * c1) ** 2)


def delta_e_cmc(standard: ArrayLike, sample: ArrayLike, *, lightness: float = 2.0, chroma: float = 1.0) -> Any:
    """CMC(l:c) colour difference of a sample from a standard; not symmetric.

    Parameters
    ----------
    standard
        (..., 3) CIELAB colours of the standard: its lightness, chroma and hue weigh the difference.
    sample
        (..., 3) CIELAB colours of the sample; both broadcast against each other.
    lightness, chroma
        l and c, above 0. 2:1 judges whether a match is acceptable, 1:1 whether it is seen.

    Returns
    -------
    numpy.ndarray or numpy.float64
        (...) float64, 0 upwards; it jumps a little where the standard's hue passes 164 or 345 degrees, as the
        formula does.

    Raises
    ------
    ValueError
        If a last axis does not have 3 values, or l or c are not above 0.

    References
    ----------
    F. J. J. Clarke, R. McDonald, B. Rigg, "Modification to the JPC79 colour-difference formula", Journal of the
    Society of Dyers and Colourists 100 (1984); BS 6923:1988; ISO 105-J03:2009.

    Examples
    --------
    >>> round(float(delta_e_cmc([50.0, 30.0, 40.0], [50.0, 0.0, 0.0])), 4)
    19.4894
    """
    if not (lightness > 0.0 and chroma > 0.0):
        raise ValueError(f"lightness {lightness} and chroma {chroma} must be above 0")
    first, second = _pairs(standard, sample, ("standard", "sample"))
    squared_l, squared_c, squared_h, c1 = _squared_terms(first, second)
    l1 = first[..., 0]
    h1 = np.degrees(np.arctan2(first[..., 2], first[..., 1])) % 360.0
    bluish = (h1 >= _CMC_BLUE_DEG[0]) & (h1 <= _CMC_BLUE_DEG[1])
    t = np.where(
        bluish,
        0.56 + np.abs(0.2 * np.cos(np.radians(h1 + 168.0))),
        0.36 + np.abs(0.4 * np.cos(np.radians(h1 + 35.0))),
    )
    f = c1**2 / np.sqrt(c1**4 + 1900.0)
    bright = np.maximum(l1, _CMC_DARK)
    s_l = np.where(l1 < _CMC_DARK, 0.511, 0.040975 * bright / (1.0 + 0.01765 * bright))
    s_c = 0.0638 * c1 / (1.0 + 0.0131 * c1) + 0.638
    s_h = s_c * (f * t + 1.0 - f)
    return np.sqrt(squared_l / (lightness * s_l) ** 2 + squared_c / (chroma * s_c) ** 2 + squared_h / s_h**2)
