"""The instrument: readings of fired patches with scatter, and the colour difference between readings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sim.inks import Spectrum

if TYPE_CHECKING:
    from sim.kiln import Firing
    from sim.spectral_press import SpectralPress


def delta_e_2000(lab: NDArray[np.floating], other: NDArray[np.floating]) -> Spectrum:
    """CIEDE2000 (...,) between Lab arrays (..., 3), unit parametric factors (ISO/CIE 11664-6:2014)."""
    one, two = np.asarray(lab, dtype=np.float64), np.asarray(other, dtype=np.float64)
    chroma_mean = (np.hypot(one[..., 1], one[..., 2]) + np.hypot(two[..., 1], two[..., 2])) / 2.0
    stretch = 1.5 - 0.5 * np.sqrt(chroma_mean**7 / (chroma_mean**7 + 25.0**7))
    a_1, a_2 = stretch * one[..., 1], stretch * two[..., 1]
    c_1, c_2 = np.hypot(a_1, one[..., 2]), np.hypot(a_2, two[..., 2])
    h_1, h_2 = np.degrees(np.arctan2(one[..., 2], a_1)), np.degrees(np.arctan2(two[..., 2], a_2))

    grey = c_1 * c_2 == 0.0
    turn = np.where(grey, 0.0, (h_2 - h_1 + 180.0) % 360.0 - 180.0)
    # A difference of exactly half a turn counts as positive where the second angle is the larger one.
    turn = np.where((turn == -180.0) & (h_2 % 360.0 > h_1 % 360.0), 180.0, turn)
    hue = np.where(grey, h_1 % 360.0 * (c_1 > 0.0) + h_2 % 360.0 * (c_2 > 0.0), (h_1 + turn / 2.0) % 360.0)
    light, chroma = (one[..., 0] + two[..., 0]) / 2.0, (c_1 + c_2) / 2.0
    angle = np.radians(hue)
    weight = (
        1.0
        - 0.17 * np.cos(angle - np.radians(30.0))
        + 0.24 * np.cos(2.0 * angle)
        + 0.32 * np.cos(3.0 * angle + np.radians(6.0))
        - 0.20 * np.cos(4.0 * angle - np.radians(63.0))
    )
    s_light = 1.0 + 0.015 * (light - 50.0) ** 2 / np.sqrt(20.0 + (light - 50.0) ** 2)
    twist = np.radians(60.0 * np.exp(-(((hue - 275.0) / 25.0) ** 2)))
    rotation = -2.0 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7)) * np.sin(twist)
    d_light = (two[..., 0] - one[..., 0]) / s_light
    d_chroma = (c_2 - c_1) / (1.0 + 0.045 * chroma)
    d_hue = 2.0 * np.sqrt(c_1 * c_2) * np.sin(np.radians(turn / 2.0)) / (1.0 + 0.015 * chroma * weight)
    return np.asarray(np.sqrt(d_light**2 + d_chroma**2 + d_hue**2 + rotation * d_chroma * d_hue))


def _laid(ink_frac: NDArray[np.floating], generator: np.random.Generator, ink_noise: float) -> Spectrum:
    inks = np.asarray(ink_frac, dtype=np.float64)
    return np.clip(inks * (1.0 + ink_noise * generator.standard_normal(inks.shape)), 0.0, 1.0)


def measure(
    press: SpectralPress,
    ink_frac: NDArray[np.floating],
    generator: np.random.Generator,
    *,
    firing: Firing | None = None,
    ink_noise: float = 0.0,
    lab_noise: float = 0.3,
) -> Spectrum:
    """Absolute Lab under D50, (P, 3), as an instrument reads fired patches.

    Parameters
    ----------
    press
        The press.
    ink_frac
        (P, N) ink fractions, 0 to 1.
    generator
        Source of the scatter; the same generator state gives the same readings.
    firing
        The firing; None is the normal one.
    ink_noise
        Standard deviation of each ink's amount, as a share of that amount.
    lab_noise
        Standard deviation of each reading of L*, a* and b*.
    """
    lab = press.lab(_laid(ink_frac, generator, ink_noise), firing)
    return lab + lab_noise * generator.standard_normal(lab.shape)


def measure_spectra(
    press: SpectralPress,
    ink_frac: NDArray[np.floating],
    generator: np.random.Generator,
    *,
    firing: Firing | None = None,
    ink_noise: float = 0.0,
    level_noise: float = 0.004,
    reading_noise: float = 0.0005,
) -> Spectrum:
    """Reflectance (P, 36), 380 to 730 nm by 10 nm, as an instrument reads fired patches.

    Parameters
    ----------
    press, ink_frac, generator, firing, ink_noise
        As for `measure`.
    level_noise
        Standard deviation of a whole reading's level, as a share: how the instrument sits on the patch.
    reading_noise
        Standard deviation of every wavelength's reading, reflectance.

    Returns
    -------
    ndarray
        Reflectance, not below 0.
    """
    spectra = press.reflectance(_laid(ink_frac, generator, ink_noise), firing)
    spectra = spectra * (1.0 + level_noise * generator.standard_normal((len(spectra), 1)))
    return np.maximum(spectra + reading_noise * generator.standard_normal(spectra.shape), 0.0)
