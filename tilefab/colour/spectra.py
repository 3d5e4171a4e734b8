"""Reflectance spectra into tristimulus values: CIE 1931 2 degree observer, CIE illuminant D50 or A.

A spectrum is taken to the tables' 5 nm by a cubic through its bands, held at its first and last band beyond them, and
summed. Instruments report bands that are already corrected for their own width, so nothing is corrected here.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from tilefab.colour.spaces import WHITE_XYZ_D50

Float64Array = NDArray[np.float64]

SHORTEST_NM, LONGEST_NM, STEP_NM = 380.0, 780.0, 5.0
"""Range and step of the tables."""

MUST_REACH_NM = (430.0, 680.0)
"""A spectrum that does not reach these is no colour: beyond, what is held constant weighs next to nothing."""

MOST_STEP_NM = 20.0
"""Widest step between bands."""


def _table(text: str) -> Float64Array:
    return np.array([float(word) for word in text.split()])


# CIE 15:2004, tables T.4 (observer) and T.1 (illuminant), 380 to 780 nm by 5 nm.
_OBSERVER_X = _table(
    """
    0.001368 0.002236 0.004243 0.00765 0.01431 0.02319 0.04351 0.07763 0.13438 0.21477 0.2839 0.3285 0.34828
    0.34806 0.3362 0.3187 0.2908 0.2511 0.19536 0.1421 0.09564 0.05795 0.03201 0.0147 0.0049 0.0024 0.0093
    0.0291 0.06327 0.1096 0.1655 0.22575 0.2904 0.3597 0.43345 0.51205 0.5945 0.6784 0.7621 0.8425 0.9163
    0.9786 1.0263 1.0567 1.0622 1.0456 1.0026 0.9384 0.85445 0.7514 0.6424 0.5419 0.4479 0.3608 0.2835 0.2187
    0.1649 0.1212 0.0874 0.0636 0.04677 0.0329 0.0227 0.01584 0.011359 0.008111 0.00579 0.004109 0.002899
    0.002049 0.00144 0.001 0.00069 0.000476 0.000332 0.000235 0.000166 0.000117 0.000083 0.000059 0.000042
    """
)
_OBSERVER_Y = _table(
    """
    0.000039 0.000064 0.00012 0.000217 0.000396 0.00064 0.00121 0.00218 0.004 0.0073 0.0116 0.01684 0.023
    0.0298 0.038 0.048 0.06 0.0739 0.09098 0.1126 0.13902 0.1693 0.20802 0.2586 0.323 0.4073 0.503 0.6082 0.71
    0.7932 0.862 0.91485 0.954 0.9803 0.99495 1 0.995 0.9786 0.952 0.9154 0.87 0.8163 0.757 0.6949 0.631
    0.5668 0.503 0.4412 0.381 0.321 0.265 0.217 0.175 0.1382 0.107 0.0816 0.061 0.04458 0.032 0.0232 0.017
    0.01192 0.00821 0.005723 0.004102 0.002929 0.002091 0.001484 0.001047 0.00074 0.00052 0.000361 0.000249
    0.000172 0.00012 0.000085 0.00006 0.000042 0.00003 0.000021 0.000015
    """
)
_OBSERVER_Z = _table(
    """
    0.00645 0.01055 0.02005 0.03621 0.06785 0.1102 0.2074 0.3713 0.6456 1.03905 1.3856 1.62296 1.74706 1.7826
    1.77211 1.7441 1.6692 1.5281 1.28764 1.0419 0.81295 0.6162 0.46518 0.3533 0.272 0.2123 0.1582 0.1117
    0.07825 0.05725 0.04216 0.02984 0.0203 0.0134 0.00875 0.00575 0.0039 0.00275 0.0021 0.0018 0.00165 0.0014
    0.0011 0.001 0.0008 0.0006 0.00034 0.00024 0.00019 0.0001 0.00005 0.00003 0.00002 0.00001 0 0 0 0 0 0 0 0
    0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0
    """
)
_ILLUMINANT_D50 = _table(
    """
    24.488 27.179 29.871 39.589 49.308 52.91 56.513 58.273 60.034 58.926 57.818 66.321 74.825 81.036 87.247
    88.93 90.612 90.99 91.368 93.238 95.109 93.536 91.963 93.843 95.724 96.169 96.613 96.871 97.129 99.614
    102.099 101.427 100.755 101.536 102.317 101.159 100 98.868 97.735 98.327 98.918 96.208 93.499 95.593
    97.688 98.478 99.269 99.155 99.042 97.382 95.722 97.29 98.857 97.262 95.667 96.929 98.19 100.597 103.003
    101.068 99.133 93.257 87.381 89.492 91.604 92.246 92.889 84.872 76.854 81.683 86.511 89.546 92.58 85.405
    78.23 67.961 57.692 70.307 82.923 80.599 78.274
    """
)
_TABLE_NM = np.arange(SHORTEST_NM, LONGEST_NM + STEP_NM / 2.0, STEP_NM)

# CIE 15:2004, section 3.1: a black body at 2856 K by today's constants, 2848 K by those it was defined with.
_ILLUMINANT_A = (
    100.0 * (560.0 / _TABLE_NM) ** 5 * np.expm1(1.435e7 / (2848.0 * 560.0)) / np.expm1(1.435e7 / (2848.0 * _TABLE_NM))
)

Illuminant = Literal["D50", "A"]
"""Light that a spectrum is seen under: daylight, or an incandescent lamp."""

_ILLUMINANTS = {"D50": _ILLUMINANT_D50, "A": _ILLUMINANT_A}


def spectral_weights(wavelengths_nm: ArrayLike, illuminant: Illuminant = "D50") -> Float64Array:
    """Weights that make XYZ of a reflectance: ``xyz = reflectance @ weights``.

    Parameters
    ----------
    wavelengths_nm
        (B,) centres of the bands in nm, increasing, at most 20 nm apart, from 430 or shorter to 680 or longer.
    illuminant
        The light.

    Returns
    -------
    numpy.ndarray
        (B, 3) float64. Each column sums to the D50 white of the ICC connection space, so that a perfect reflector is
        exactly that white and a grey is exactly neutral; the tables' own white differs from it by 0.03 % in Z. Under A
        too, so that `lab_from_xyz` makes of it CIELAB under A, whose ratios are to the light's own white.

    Raises
    ------
    ValueError
        If the bands are not as asked for.

    References
    ----------
    CIE 15:2004, sections 7.1 and 7.2; CIE 167:2005 on taking measured bands to the tables' step.

    Examples
    --------
    >>> spectral_weights(range(380, 731, 10)).sum(axis=0).round(6).tolist()
    [0.9642, 1.0, 0.8249]
    """
    bands = np.asarray(wavelengths_nm, dtype=np.float64)
    if bands.ndim != 1 or len(bands) < 2 or not np.isfinite(bands).all() or (np.diff(bands) <= 0.0).any():
        raise ValueError("wavelengths must be a list of increasing numbers")
    if bands[0] > MUST_REACH_NM[0] or bands[-1] < MUST_REACH_NM[1]:
        raise ValueError(
            f"bands from {bands[0]:g} to {bands[-1]:g} nm don't reach {MUST_REACH_NM[0]:g} to {MUST_REACH_NM[1]:g} nm"
        )
    if np.diff(bands).max() > MOST_STEP_NM + 1e-9:
        raise ValueError(f"bands are up to {np.diff(bands).max():g} nm apart, but at most {MOST_STEP_NM:g} nm will do")
    # A cubic is linear in its values: the splines through unit spectra, at the tables' wavelengths, are the weights.
    to_table = CubicSpline(bands, np.eye(len(bands)), bc_type="natural")(np.clip(_TABLE_NM, bands[0], bands[-1]))
    seen = np.stack([_OBSERVER_X, _OBSERVER_Y, _OBSERVER_Z], axis=1) * _ILLUMINANTS[illuminant][:, np.newaxis]
    weights = np.asarray(to_table, dtype=np.float64).T @ seen
    return np.asarray(weights * (np.array(WHITE_XYZ_D50) / weights.sum(axis=0)), dtype=np.float64)


def xyz_from_reflectance(
    reflectance: ArrayLike, wavelengths_nm: ArrayLike, illuminant: Illuminant = "D50"
) -> Float64Array:
    """Tristimulus values, 2 degree observer, of reflectance spectra.

    Parameters
    ----------
    reflectance
        (..., B), 1 = perfect reflector.
    wavelengths_nm, illuminant
        See `spectral_weights`.

    Returns
    -------
    numpy.ndarray
        (..., 3) float64, Y = 1 for the perfect reflector.

    Raises
    ------
    ValueError
        If shapes disagree or the bands are not as asked for.
    """
    values = np.asarray(reflectance, dtype=np.float64)
    weights = spectral_weights(wavelengths_nm, illuminant)
    if values.ndim == 0 or values.shape[-1] != len(weights):
        raise ValueError(
            f"reflectance must have {len(weights)} bands on its last axis, but its shape is {values.shape}"
        )
    return np.asarray(values @ weights, dtype=np.float64)
