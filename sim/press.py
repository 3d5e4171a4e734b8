"""A ceramic press and its kiln: what colour ink fractions fire to.

Yule-Nielsen modified spectral Neugebauer: drops spread (dot gain), overlap at random (Demichel), every
overlap has the spectrum of its inks fired together, and light spreads between them (Yule-Nielsen). Firing
fades each ink by its own share, more where much ink lies, because the glaze dissolves pigment.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.inks import InkSet, Spectrum, ceramic_ink_set, lab_from_reflectance


@dataclass(frozen=True)
class KilnState:
    """How a firing differs from the normal one.

    Attributes
    ----------
    peak_offset_degc
        Peak temperature above the normal one, kelvin; hotter fades more.
    """

    peak_offset_degc: float = 0.0


@dataclass(frozen=True)
class CeramicPress:
    """A press with its inks and kiln.

    Attributes
    ----------
    ink_set
        Spectra of body and inks.
    dot_gain
        Growth of a half cover of each ink by spreading, ink fraction.
    yule_nielsen
        Yule-Nielsen factor, 1 upwards.
    crowding
        Share of its strength that an ink loses for every further full ink it is fired with.
    fade_per_kelvin
        Share of its strength that each ink loses for every kelvin above the normal peak.
    """

    ink_set: InkSet = field(default_factory=ceramic_ink_set)
    dot_gain: tuple[float, ...] = (0.13, 0.15, 0.12, 0.17)
    yule_nielsen: float = 2.0
    crowding: float = 0.09
    fade_per_kelvin: tuple[float, ...] = (0.0015, 0.006, 0.004, 0.002)

    def reflectance(self, ink_frac: NDArray[np.floating], kiln: KilnState | None = None) -> Spectrum:
        """Spectra (P, 36) after firing of recipes (P, N), ink fractions 0 to 1.

        Raises
        ------
        ValueError
            If the shape is not (P, N) or a fraction is outside 0 to 1.
        """
        inks = np.asarray(ink_frac, dtype=np.float64)
        count = len(self.ink_set.names)
        if inks.ndim != 2 or inks.shape[1] != count:
            raise ValueError(f"ink_frac must be (P, {count}), but its shape is {inks.shape}")
        if not ((inks >= 0.0) & (inks <= 1.0)).all():
            raise ValueError("ink_frac must be 0 to 1")
        offset = kiln.peak_offset_degc if kiln else 0.0
        strength = np.exp(-np.array(self.fade_per_kelvin) * offset)
        cover = inks + 4.0 * np.array(self.dot_gain) * inks * (1.0 - inks)
        cover = np.clip(cover, 0.0, 1.0)

        body, density = self.ink_set.body, self.ink_set.density
        total = np.zeros((len(inks), body.size))
        for overlap in range(1 << count):
            present = np.array([(overlap >> ink) & 1 for ink in range(count)], dtype=np.float64)
            share = np.prod(np.where(present > 0.0, cover, 1.0 - cover), axis=1)
            kept = 1.0 - self.crowding * max(present.sum() - 1.0, 0.0)
            absorbance = kept * ((present * strength) @ density)
            fired = self.ink_set.surface + (body - self.ink_set.surface) * 10.0**-absorbance
            total += share[:, np.newaxis] * fired ** (1.0 / self.yule_nielsen)
        return np.asarray(total**self.yule_nielsen, dtype=np.float64)

    def lab(self, ink_frac: NDArray[np.floating], kiln: KilnState | None = None) -> Spectrum:
        """Absolute Lab under D50, (P, 3), after firing of recipes (P, N); see `reflectance`."""
        return lab_from_reflectance(self.reflectance(ink_frac, kiln))


def measure(
    press: CeramicPress,
    ink_frac: NDArray[np.floating],
    generator: np.random.Generator,
    *,
    kiln: KilnState | None = None,
    ink_noise: float = 0.004,
    lab_noise: float = 0.12,
) -> Spectrum:
    """Lab (P, 3) as an instrument reads fired patches, with the press's and the instrument's scatter.

    Parameters
    ----------
    press
        The press.
    ink_frac
        (P, N) ink fractions, 0 to 1.
    generator
        Source of the scatter; the same generator state gives the same readings.
    kiln
        The firing; None is the normal one.
    ink_noise
        Standard deviation of each ink's amount, as a share of that amount.
    lab_noise
        Standard deviation of each reading of L*, a* and b*.
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    laid = np.clip(inks * (1.0 + ink_noise * generator.standard_normal(inks.shape)), 0.0, 1.0)
    return press.lab(laid, kiln) + lab_noise * generator.standard_normal((len(inks), 3))
