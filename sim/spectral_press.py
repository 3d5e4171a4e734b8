"""A spectral press: cellular Yule-Nielsen Neugebauer over nodes that a layer of glaze and pigment makes.

Drops spread (dot gain, each ink its own curve). Covers at random overlaps are interpolated between nodes with
every ink at 0, a half or 1, in the Yule-Nielsen power of reflectance. A node's spectrum comes from other physics
than Neugebauer's: inks crowd one another and saturate, their absorption and scattering make a Kubelka-Munk layer
over the body, and light bounces inside the surface (Saunderson). So no model of the interpolation's own kind, with
solids only, fits this press. Firing changes the layer: inks fade and move their bands, the glaze yellows.
"""

from __future__ import annotations

import itertools
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sim.ink_sets import PressInks, edge, press_inks
from sim.inks import WAVELENGTHS_NM, Spectrum, lab_from_reflectance
from sim.kiln import Firing
from tilefab.rng import generator

_LEVELS = (0.0, 0.5, 1.0)
_CELL_ROUNDING = 0.05
_ONSET_FRAC = 0.06
_RAMP_ROUGHNESS = 0.15
_CHUNK = 2000
_TINT_PER_KELVIN = 0.0004
_CROWDING_PER_KELVIN = 0.01
_BANDS = WAVELENGTHS_NM.size
_NORMAL = Firing()


class SpectralPress:
    """A press by its name: ``ceramic4``, ``offset4``, ``ceramic6`` or ``ceramic8``.

    Raises
    ------
    ValueError
        If there is no press of that name.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.inks = press_inks(name)

    @property
    def ink_names(self) -> tuple[str, ...]:
        """Ink names in channel order."""
        return self.inks.names

    def cover(self, ink_frac: NDArray[np.floating], firing: Firing | None = None) -> Spectrum:
        """Covers (P, N), 0 to 1, that ink fractions (P, N) spread to."""
        laid = np.asarray(ink_frac, dtype=np.float64)
        moisture = (firing or _NORMAL).moisture_offset_percent
        inks = self.inks.inks
        gain = np.array([ink.gain * np.exp(ink.moisture_gain * moisture) for ink in inks])
        skew, s_share = np.array([ink.skew for ink in inks]), np.array([ink.s_share for ink in inks])
        onset = np.array([ink.onset for ink in inks])
        others = laid.sum(axis=1, keepdims=True) - laid
        grown = gain / (1.0 + self.inks.choking * others) * 4.0 * laid * (1.0 - laid)
        spread = laid + grown * (1.0 + skew * (1.0 - 2.0 * laid))
        spread += onset * laid * (1.0 - laid) / (laid + _ONSET_FRAC)
        merged = laid * laid * (3.0 - 2.0 * laid)
        return np.asarray(np.clip((1.0 - s_share) * spread + s_share * merged, 0.0, 1.0), dtype=np.float64)

    def reflectance(self, ink_frac: NDArray[np.floating], firing: Firing | None = None) -> Spectrum:
        """Spectra (P, 36), 380 to 730 nm by 10 nm, after firing of recipes (P, N), ink fractions 0 to 1.

        Raises
        ------
        ValueError
            If the shape is not (P, N), a fraction is outside 0 to 1, or the firing names another number of inks.
        """
        laid = np.asarray(ink_frac, dtype=np.float64)
        count = len(self.ink_names)
        if laid.ndim != 2 or laid.shape[1] != count:
            raise ValueError(f"ink_frac must be (P, {count}), but its shape is {laid.shape}")
        if not ((laid >= 0.0) & (laid <= 1.0)).all():
            raise ValueError("ink_frac must be 0 to 1")
        nodes = _node_powers(self.name, firing or _NORMAL)
        first = count // 2
        table = nodes.reshape(3**first, -1)
        out = np.empty((len(laid), _BANDS))
        for start in range(0, len(laid), _CHUNK):
            weights = _cell_weights(self.cover(laid[start : start + _CHUNK], firing))
            partly = (_products(weights[:, :first]) @ table).reshape(len(weights), -1, _BANDS)
            rest = _products(weights[:, first:])
            out[start : start + _CHUNK] = (rest[:, np.newaxis, :] @ partly)[:, 0, :]
        return np.asarray(out**self.inks.yule_nielsen)

    def lab(self, ink_frac: NDArray[np.floating], firing: Firing | None = None) -> Spectrum:
        """Absolute Lab under D50, (P, 3), after firing of recipes (P, N); see `reflectance`."""
        return lab_from_reflectance(self.reflectance(ink_frac, firing))


def _cell_weights(cover: Spectrum) -> Spectrum:
    """Weights (P, N, 3) of the levels 0, a half and 1: linear in cells whose inner corner is rounded off."""
    rounding = _CELL_ROUNDING**2
    middle = np.sqrt(1.0 + rounding) - np.sqrt((2.0 * cover - 1.0) ** 2 + rounding)
    return np.stack([1.0 - cover - middle / 2.0, middle, cover - middle / 2.0], axis=-1)


def _products(weights: Spectrum) -> Spectrum:
    """Weights (P, 3**M) of nodes, products of the levels' weights (P, M, 3); the last ink runs fastest."""
    out = weights[:, 0]
    for ink in range(1, weights.shape[1]):
        out = (out[:, :, np.newaxis] * weights[:, ink, np.newaxis, :]).reshape(len(weights), -1)
    return out


def _moved(absorbance: Spectrum, shift_nm: float) -> Spectrum:
    """A spectrum moved towards longer wavelengths, to the second order, so that it is smooth in the shift."""
    slope = np.gradient(absorbance, WAVELENGTHS_NM)
    moved = absorbance - shift_nm * slope + 0.5 * shift_nm**2 * np.gradient(slope, WAVELENGTHS_NM)
    return np.maximum(moved, 0.0)


def _fired_absorbance(inks: PressInks, firing: Firing) -> Spectrum:
    """Absorbances (N, 36), log10, of full covers after a firing."""
    offsets = firing.ink_offset_frac or (0.0,) * len(inks.inks)
    if len(offsets) != len(inks.inks):
        raise ValueError(f"ink_offset_frac has {len(offsets)} values for {len(inks.inks)} inks")
    brownish = 0.5 * edge(580.0, 30.0) + 0.5
    out = []
    for ink, offset in zip(inks.inks, offsets, strict=True):
        fade = ink.fade_per_kelvin * firing.peak_offset_degc + ink.fade_per_min * firing.soak_offset_min
        moved = _moved(ink.absorbance, ink.shift_nm_per_kelvin * firing.peak_offset_degc)
        turned = -ink.oxygen_shift * firing.oxygen_offset_percent
        mixed = np.maximum(moved + turned * (moved.mean() / brownish.mean() * brownish - moved), 0.0)
        out.append(mixed * np.exp(offset - fade))
    return np.stack(out)


def _layer(background: Spectrum, absorption: Spectrum, scattering: Spectrum) -> Spectrum:
    """Reflectance of a Kubelka-Munk layer of thickness 1 over a background (Kubelka 1948, eq. 19)."""
    root = np.sqrt(absorption * (absorption + 2.0 * scattering))
    safe = np.maximum(root, 1e-6)
    coth = np.where(root > 1e-6, safe / np.tanh(safe), 1.0)
    both = absorption + scattering
    return (scattering - background * (both - coth)) / (both - background * scattering + coth)


def _roughness(inks: PressInks) -> Spectrum:
    """Fixed smooth deviations (3, ..., 3, 36) of nodes, from single inks and pairs of them; none without ink."""
    count = len(inks.inks)
    source = generator(inks.seed, "node roughness")
    phase = np.linspace(0.0, np.pi, _BANDS)
    shapes = np.stack([np.ones(_BANDS), np.cos(phase), np.cos(2.0 * phase)])
    shapes /= np.sqrt(np.array([1.0, 2.0, 3.0]))[:, np.newaxis]
    out = np.zeros((3,) * count + (_BANDS,))
    for one, two in itertools.combinations(range(count), 2):
        free = np.zeros((3, 3, _BANDS))
        free[1:, 1:] = source.standard_normal((2, 2, 3)) @ shapes
        place = [1] * count + [_BANDS]
        place[one], place[two] = 3, 3
        out += free.reshape(place)
    for one in range(count):
        middle = np.zeros((3, _BANDS))
        middle[1] = _RAMP_ROUGHNESS * source.standard_normal(3) @ shapes
        place = [1] * count + [_BANDS]
        place[one] = 3
        out += middle.reshape(place)
    # As much in a mixture of many inks as in one of four: an ink set has N (N - 1) / 2 pairs, four inks have 6.
    return np.asarray(inks.roughness * np.sqrt(12.0 / (count * (count - 1))) * out)


@lru_cache(maxsize=8)
def _node_powers(name: str, firing: Firing) -> Spectrum:
    """Reflectance to the power 1/n of all nodes, (3, ..., 3, 36), with every ink at 0, a half and 1."""
    inks = press_inks(name)
    count = len(inks.inks)
    levels = np.array(list(itertools.product(_LEVELS, repeat=count)))

    # Inks crowd each other by shares of their own, the more so the hotter the glaze.
    shares = generator(inks.seed, "crowding").uniform(0.3, 1.7, (count, count)) * (1.0 - np.eye(count))
    hot = np.exp(_CROWDING_PER_KELVIN * firing.peak_offset_degc)
    saturation = np.array([ink.saturation for ink in inks.inks])
    load = (1.0 - np.exp(-saturation * levels)) / (1.0 - np.exp(-saturation))
    load = load / (1.0 + inks.crowding * hot * levels @ shares.T)

    tint = firing.glaze_tint + _TINT_PER_KELVIN * firing.peak_offset_degc
    body = inks.body * 10.0 ** (-tint * (0.25 + edge(520.0, 40.0)))
    inner = body - inks.surface
    inner = inner / ((1.0 - inks.surface) * (1.0 - inks.internal) + inks.internal * inner)
    absorption = 0.5 * np.log(10.0) * (load @ _fired_absorbance(inks, firing))
    scattering = (load @ np.array([ink.scatter for ink in inks.inks]))[:, np.newaxis]
    layer = _layer(inner, absorption, np.broadcast_to(scattering, absorption.shape))
    seen = inks.surface + (1.0 - inks.surface) * (1.0 - inks.internal) * layer / (1.0 - inks.internal * layer)
    even = (seen ** (1.0 / inks.yule_nielsen)).reshape((3,) * count + (_BANDS,))

    # A half cover of separate dots is the mean of its neighbours; of merged drops it is an even thin layer.
    dots = even
    for axis in range(count):
        low, high = dots.take([0], axis=axis), dots.take([2], axis=axis)
        dots = np.concatenate([low, 0.5 * (low + high), high], axis=axis)
    nodes = (1.0 - inks.merging) * dots + inks.merging * even
    return np.asarray(nodes * np.exp(_roughness(inks)))
