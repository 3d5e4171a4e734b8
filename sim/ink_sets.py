"""Synthetic ink sets of the spectral press: four, six and eight ceramic inks, and an offset-like four.

No real press, pigment or tile was measured. Absorption bands lie where the literature on ceramic pigments and
process inks has them; amounts are scaled until solids look like fired tiles, or like offset on coated paper:

- blue, cobalt aluminate: three joined bands of tetrahedral Co(II) near 545, 588 and 630 nm, red open above 680 nm;
- brown, zinc-iron-chrome spinel: charge transfer of Fe(III), strong in the blue and falling slowly to the red;
- yellow, praseodymium in zircon: sharp Pr(IV) edge near 480 nm, almost clear above 520 nm;
- black, iron-chrome-cobalt-nickel spinel: strong everywhere, a little stronger at cobalt's 600 nm;
- pink, chrome in tin sphene: a broad band near 520 nm with a shoulder in the blue;
- beige, zircon-iron coral in a thin ink: a weak edge near 540 nm, and much scattering by zircon;
- green, cobalt-chrome spinel: Cr(III) near 430 and 620 nm, a window near 530 nm;
- orange, cadmium-free rutile of chrome and antimony: an edge near 520 nm, smoother than the yellow's;
- cyan, magenta, yellow and black of offset: phthalocyanine near 620 and 680 nm, rubine near 530 and 565 nm, a
  diarylide edge near 490 nm, carbon.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sim.inks import WAVELENGTHS_NM, Spectrum

PRESS_NAMES = ("ceramic4", "offset4", "ceramic6", "ceramic8")


@dataclass(frozen=True)
class Ink:
    """One ink: what it absorbs, how its drops spread, and what firing does to it.

    Attributes
    ----------
    name
        Its name on the machine.
    absorbance
        (36,) absorbance at full cover after a normal firing, log10 units, before light bounces inside the glaze.
    scatter
        Kubelka-Munk scattering of a full cover, of the layer's thickness.
    gain
        Growth of a half cover by spreading, ink fraction.
    skew
        Shifts the growth to highlights (positive) or shadows (negative).
    s_share
        Share of an S-shaped curve in the cover: small drops sink in, large ones merge. 0 to 1.
    onset
        Further growth by the first drops, which spread widest on the bare glaze, ink fraction.
    saturation
        How much the pigment's effect flattens with its amount; 0 for not at all.
    fade_per_kelvin, fade_per_min
        Share of its strength lost for every kelvin of peak and every minute of soak above normal.
    shift_nm_per_kelvin
        How far its bands move for every kelvin of peak above normal.
    moisture_gain
        Growth of `gain`, as a share of it, for every percent point of moisture in the body above normal.
    oxygen_shift
        Share of its absorption that turns brownish for every percent point of oxygen below normal.
    """

    name: str
    absorbance: Spectrum = field(repr=False)
    scatter: float
    gain: float
    skew: float
    s_share: float
    onset: float
    saturation: float
    fade_per_kelvin: float = 0.0
    fade_per_min: float = 0.0
    shift_nm_per_kelvin: float = 0.0
    moisture_gain: float = 0.0
    oxygen_shift: float = 0.0


@dataclass(frozen=True)
class PressInks:
    """The inks of a press with what they are printed on and how they act together.

    Attributes
    ----------
    inks
        The inks, in channel order.
    body
        (36,) measured reflectance of the unprinted surface, 0 to 1.
    surface
        Light that the surface reflects towards the instrument, 0 to 1.
    internal
        Light that the surface sends back into the layer, 0 to 1 (Saunderson 1942).
    yule_nielsen
        Yule-Nielsen factor, 1 upwards.
    merging
        How far a half cover is a thin even layer (1) instead of separate dots (0).
    crowding
        Mean share of its strength that an ink loses to a full cover of another.
    choking
        Share of its dot gain that an ink loses to a full cover of another.
    roughness
        Standard deviation of what single and paired covers do besides all this, share of light.
    seed
        Key of the fixed random choices: which inks crowd which, and the roughness.
    """

    inks: tuple[Ink, ...]
    body: Spectrum = field(repr=False)
    surface: float
    internal: float
    yule_nielsen: float
    merging: float
    crowding: float
    choking: float
    roughness: float
    seed: int

    @property
    def names(self) -> tuple[str, ...]:
        """Ink names in channel order."""
        return tuple(ink.name for ink in self.inks)


def band(centre_nm: float, width_nm: float) -> Spectrum:
    """A Gaussian absorption band, (36,), height 1."""
    return np.exp(-0.5 * ((WAVELENGTHS_NM - centre_nm) / width_nm) ** 2)


def edge(below_nm: float, width_nm: float) -> Spectrum:
    """Absorption of everything below a wavelength, (36,), 1 far below and 0 far above."""
    return 1.0 / (1.0 + np.exp((WAVELENGTHS_NM - below_nm) / width_nm))


def _ceramic_inks() -> dict[str, Ink]:
    one: NDArray[np.float64] = np.ones_like(WAVELENGTHS_NM)
    blue = 0.34 * band(545, 26) + 0.42 * band(588, 24) + 0.44 * band(630, 26) + 0.22 * one + 0.1 * edge(395, 12)
    brown = 0.24 * one + 0.40 * edge(574, 24) + 0.10 * edge(460, 32)
    yellow = 0.03 * one + 0.42 * edge(484, 12) + 0.06 * edge(440, 15)
    black = 1.62 * one + 0.09 * band(600, 70) - 0.07 * edge(430, 20)
    pink = 0.06 * one + 0.34 * band(522, 38) + 0.14 * band(420, 36)
    beige = 0.05 * one + 0.17 * edge(540, 34) + 0.05 * edge(430, 25)
    green = 0.14 * one + 0.42 * band(432, 34) + 0.38 * band(622, 44)
    orange = 0.05 * one + 0.40 * edge(524, 18) + 0.13 * edge(600, 12)
    inks = (
        Ink("Blue", blue, 0.020, 0.13, 0.25, 0.10, 0.03, 0.5, 0.0016, 0.0012, 0.10, 0.05, 0.004),
        Ink("Brown", brown, 0.030, 0.15, -0.15, 0.30, 0.02, 0.7, 0.0060, 0.0080, 0.35, 0.07, 0.012),
        Ink("Yellow", yellow, 0.040, 0.11, 0.10, 0.45, 0.04, 0.6, 0.0045, 0.0030, -0.20, 0.06, 0.006),
        Ink("Black", black, 0.020, 0.17, 0.30, 0.15, 0.03, 0.4, 0.0020, 0.0030, 0.00, 0.09, 0.003),
        Ink("Pink", pink, 0.030, 0.12, -0.10, 0.40, 0.02, 0.8, 0.0100, 0.0060, -0.45, 0.05, 0.015),
        Ink("Beige", beige, 0.060, 0.14, 0.20, 0.20, 0.04, 0.5, 0.0030, 0.0050, 0.15, 0.08, 0.010),
        Ink("Green", green, 0.030, 0.12, 0.00, 0.35, 0.03, 0.6, 0.0025, 0.0015, 0.25, 0.04, 0.008),
        Ink("Orange", orange, 0.030, 0.13, -0.20, 0.25, 0.02, 0.7, 0.0070, 0.0045, -0.30, 0.06, 0.007),
    )
    return {ink.name: ink for ink in inks}


def _offset_inks() -> tuple[Ink, ...]:
    one: NDArray[np.float64] = np.ones_like(WAVELENGTHS_NM)
    cyan = 0.88 * band(622, 38) + 0.76 * band(688, 46) + 0.24 * band(568, 28) + 0.09 * edge(410, 12)
    magenta = 0.78 * band(532, 32) + 0.84 * band(566, 18) + 0.38 * band(495, 34) + 0.34 * band(430, 40)
    yellow = 1.00 * edge(492, 10) - 0.12 * edge(410, 12)
    black = 1.62 * one + 0.06 * edge(500, 60)
    return (
        Ink("Cyan", cyan + 0.03, 0.010, 0.17, 0.10, 0.45, 0.07, 0.3, 0.002, 0.002, 0.05, 0.02),
        Ink("Magenta", magenta + 0.02, 0.010, 0.16, 0.20, 0.55, 0.06, 0.3, 0.004, 0.003, -0.10, 0.02),
        Ink("Yellow", yellow + 0.008, 0.008, 0.15, -0.10, 0.60, 0.08, 0.3, 0.005, 0.004, -0.10, 0.02),
        Ink("Black", black, 0.012, 0.19, 0.25, 0.40, 0.07, 0.3, 0.001, 0.001, 0.0, 0.03),
    )


def press_inks(name: str) -> PressInks:
    """Inks and body of a press by its name, one of `PRESS_NAMES`.

    Raises
    ------
    ValueError
        If there is no press of that name.
    """
    if name == "offset4":
        paper = 0.865 - 0.02 * edge(460, 20) - 0.18 * edge(398, 8)
        return PressInks(_offset_inks(), paper, 0.006, 0.45, 1.8, 0.8, 0.10, 0.25, 0.085, 39)
    chosen = {
        "ceramic4": ("Blue", "Brown", "Yellow", "Black"),
        "ceramic6": ("Blue", "Brown", "Yellow", "Black", "Pink", "Beige"),
        "ceramic8": ("Blue", "Brown", "Yellow", "Black", "Pink", "Beige", "Green", "Orange"),
    }
    if name not in chosen:
        raise ValueError(f"press {name!r} is unknown: choose one of {', '.join(PRESS_NAMES)}")
    inks = _ceramic_inks()
    body = 0.845 - 0.115 * edge(440, 32) - 0.02 * edge(560, 30)
    return PressInks(tuple(inks[ink] for ink in chosen[name]), body, 0.010, 0.40, 2.0, 0.7, 0.07, 0.25, 0.05, 26)
