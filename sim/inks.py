"""Synthetic spectra of a ceramic ink set on a glazed body, and how an observer sees them.

No real press, pigment or tile was measured: absorption bands are placed where the literature on ceramic
pigments has them (cobalt aluminate near 545, 585 and 625 nm; iron brown falling from blue to red;
praseodymium-zircon yellow below 490 nm; a chrome-iron-cobalt black) and scaled until fired tiles look like
fired tiles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Spectrum = NDArray[np.float64]

WAVELENGTHS_NM: Spectrum = np.arange(380.0, 731.0, 10.0)
INK_NAMES = ("Blue", "Brown", "Yellow", "Black")
WHITE_XYZ_D50 = (0.9642, 1.0, 0.8249)


def _table(text: str) -> Spectrum:
    return np.array([float(word) for word in text.split()])


# CIE 1931 2 degree observer and CIE illuminant D50, 380 to 730 nm by 10 nm (CIE 15:2004, tables T.4 and T.1).
_OBSERVER_X = _table(
    """
    0.001368 0.004243 0.01431 0.04351 0.13438 0.2839 0.34828 0.3362 0.2908 0.19536 0.09564 0.03201
    0.0049 0.0093 0.06327 0.1655 0.2904 0.43345 0.5945 0.7621 0.9163 1.0263 1.0622 1.0026 0.85445 0.6424
    0.4479 0.2835 0.1649 0.0874 0.04677 0.0227 0.011359 0.00579 0.002899 0.00144
    """
)
_OBSERVER_Y = _table(
    """
    0.000039 0.00012 0.000396 0.00121 0.004 0.0116 0.023 0.038 0.06 0.09098 0.13902 0.20802 0.323 0.503
    0.71 0.862 0.954 0.99495 0.995 0.952 0.87 0.757 0.631 0.503 0.381 0.265 0.175 0.107 0.061 0.032
    0.017 0.00821 0.004102 0.002091 0.001047 0.00052
    """
)
_OBSERVER_Z = _table(
    """
    0.00645 0.02005 0.06785 0.2074 0.6456 1.3856 1.74706 1.77211 1.6692 1.28764 0.81295 0.46518 0.272
    0.1582 0.07825 0.04216 0.0203 0.00875 0.0039 0.0021 0.00165 0.0011 0.0008 0.00034 0.00019 0.00005
    0.00002 0 0 0 0 0 0 0 0 0
    """
)
_ILLUMINANT_D50 = _table(
    """
    24.488 29.871 49.308 56.513 60.034 57.818 74.825 87.247 90.612 91.368 95.109 91.963 95.724 96.613
    97.129 102.099 100.755 102.317 100 97.735 98.918 93.499 97.688 99.269 99.042 95.722 98.857 95.667
    98.19 103.003 99.133 87.381 91.604 92.889 76.854 86.511
    """
)


@dataclass(frozen=True)
class InkSet:
    """A body with its glaze and the inks fired into it.

    Attributes
    ----------
    names
        N ink names in channel order.
    body
        (36,) reflectance of the unprinted glazed tile, 0 to 1.
    density
        (N, 36) absorbance of each ink at full cover after a normal firing, log10 units.
    surface
        Light reflected at the glaze's surface, which no ink darkens, 0 to 1.
    """

    names: tuple[str, ...]
    body: Spectrum
    density: Spectrum
    surface: float


def _band(centre_nm: float, width_nm: float) -> Spectrum:
    return np.exp(-0.5 * ((WAVELENGTHS_NM - centre_nm) / width_nm) ** 2)


def _below(edge_nm: float, width_nm: float) -> Spectrum:
    return 1.0 / (1.0 + np.exp((WAVELENGTHS_NM - edge_nm) / width_nm))


def ceramic_ink_set() -> InkSet:
    """Cobalt blue, iron brown, praseodymium yellow and black on a glazed off-white body."""
    blue = 0.46 * _band(545.0, 26.0) + 0.56 * _band(588.0, 24.0) + 0.58 * _band(630.0, 26.0)
    blue = blue + 0.33 + 0.14 * _below(395.0, 12.0)
    brown = 0.36 + 0.56 * _below(574.0, 24.0) + 0.12 * _below(460.0, 32.0)
    yellow = 0.04 + 0.46 * _below(484.0, 12.0) + 0.06 * _below(440.0, 15.0)
    black = 1.42 + 0.05 * _band(600.0, 70.0) - 0.06 * _below(430.0, 20.0)
    body = 0.845 - 0.115 * _below(440.0, 32.0) - 0.02 * _below(560.0, 30.0)
    return InkSet(INK_NAMES, body, np.stack([blue, brown, yellow, black]), 0.019)


def xyz_from_reflectance(reflectance: Spectrum) -> Spectrum:
    """Tristimulus values under D50, (..., 3), Y = 1 for a perfect diffuser, of spectra (..., 36).

    The sums are scaled per channel so that the perfect diffuser is exactly the D50 white of ICC profiles.
    """
    observer = np.array([_OBSERVER_X, _OBSERVER_Y, _OBSERVER_Z]) * np.array(_ILLUMINANT_D50)
    xyz = (reflectance @ observer.T) / observer.sum(axis=1) * np.array(WHITE_XYZ_D50)
    return np.asarray(xyz, dtype=np.float64)


def lab_from_reflectance(reflectance: Spectrum) -> Spectrum:
    """CIELAB under D50, (..., 3), of spectra (..., 36) (CIE 15:2004, section 8.2.1)."""
    ratio = xyz_from_reflectance(reflectance) / np.array(WHITE_XYZ_D50)
    f = np.where(ratio > 216.0 / 24389.0, np.cbrt(ratio), (24389.0 / 27.0 * ratio + 16.0) / 116.0)
    return np.stack(
        [
            116.0 * f[..., 1] - 16.0,
            500.0 * (f[..., 0] - f[..., 1]),
            200.0 * (f[..., 1] - f[..., 2]),
        ],
        axis=-1,
    )
