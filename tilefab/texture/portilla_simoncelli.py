"""How near two textures are in the joint statistics of their wavelet coefficients.

The statistics are those of Portilla and Simoncelli 2000, "A parametric texture model based on joint statistics of
complex wavelet coefficients", section 2, except that percentiles stand for the extremes, which a single pixel
decides. Two textures that agree in them look alike to people at a glance. They are blind to where things are, so a
verbatim copy and a fresh sample of the same texture both come near zero, and noise with the right spectrum doesn't.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tilefab.texture.spectrum import check_planes
from tilefab.types import Array

Plane: TypeAlias = NDArray[np.float64]
ComplexPlane: TypeAlias = NDArray[np.complex128]

MIN_SIDE_PX = 40
"""The smallest side that can be measured: two scales, without which nothing relates one scale to the next."""
MAX_SCALES = 4
ORIENTATIONS = 4
NEIGHBOURHOOD_PX = 7
"""The settings of the paper, section 2.3."""
_COARSEST_SIDE_PX = 20
"""No scale is measured of which the exemplar has fewer coefficients on a side: its statistics would be chance."""
_MARGIN_PX = 2
"""Coefficients left out along each border, at each scale: they see the mirrored image most."""
_TINY_CORRELATION = 0.05
"""Correlations below this are chance in images of a few hundred pixels: no difference is divided by less."""
_FAINT_BAND = 0.01
"""A band with less of the exemplar's contrast than this counts as if it had so much: nobody sees it."""
_LEAST_CONTRAST = 0.5
"""Standard deviation, in CIELAB units, by which flatter exemplars are divided: nobody sees less."""


@dataclass(frozen=True)
class _Statistics:
    """The statistics of one channel, by group; each entry of a group is one scale's, flattened.

    Attributes
    ----------
    marginal
        Mean, standard deviation, skewness, kurtosis, and the 1st and 99th percentile.
    low_pass_marginal
        Skewness and kurtosis of the low-pass image at each scale.
    autocorrelation
        Central autocovariance of the low-pass image at each scale.
    magnitude_mean
        Mean magnitude of each oriented band.
    magnitude_autocorrelation
        Central autocovariance of the magnitudes of each oriented band.
    magnitude_across
        Covariance of magnitudes across orientations at each scale, and with the next coarser scale.
    phase_across
        Covariance of each band's real part with the parts of the next coarser scale, its phase doubled.
    high_pass
        Variance of the high-pass residue.
    """

    marginal: tuple[Plane, ...]
    low_pass_marginal: tuple[Plane, ...]
    autocorrelation: tuple[Plane, ...]
    magnitude_mean: tuple[Plane, ...]
    magnitude_autocorrelation: tuple[Plane, ...]
    magnitude_across: tuple[Plane, ...]
    phase_across: tuple[Plane, ...]
    high_pass: tuple[Plane, ...]


_FAMILIES = (
    ("marginal", "low_pass_marginal", "high_pass"),
    ("autocorrelation",),
    ("magnitude_mean", "magnitude_autocorrelation", "magnitude_across"),
    ("phase_across",),
)
"""The paper's four kinds of constraint, section 2.2; each counts the same, however many numbers it has."""


@dataclass(frozen=True)
class _Bands:
    """What the pyramid gives, borders cropped: the standardised channel itself and the parts of it.

    ``oriented[scale][orientation]`` holds analytic coefficients, ``parents[scale]`` those of the next coarser scale
    at this scale's resolution, and ``low_pass[scale]`` what the scale's oriented bands are taken of; one entry more
    than scales, the last being the residue.
    """

    channel: Plane
    high_pass: Plane
    low_pass: tuple[Plane, ...]
    oriented: tuple[tuple[ComplexPlane, ...], ...]
    parents: tuple[tuple[ComplexPlane, ...], ...]


def scales_that_fit(side_px: int) -> int:
    """How many scales an image with this shorter side, `MIN_SIDE_PX` or more, is measured at: 2 to `MAX_SCALES`."""
    return min(MAX_SCALES, 1 + int(math.log2(side_px / _COARSEST_SIDE_PX)))


def portilla_simoncelli_distance(exemplar: Array, image: Array) -> float:
    """Relative distance between the Portilla-Simoncelli statistics of two images of one channel.

    Parameters
    ----------
    exemplar
        (rows, cols), the texture as it should be, at least 40 pixels a side, in CIELAB units; finite.
    image
        (rows, cols) of the same channel and resolution, at least 40 pixels a side, of any shape.

    Returns
    -------
    float
        >= 0 and 0 for the same image. Each group at each scale counts by the root of its summed squared differences
        over the root of the exemplar's summed squares; that is averaged over scales, over the groups of each of the
        paper's four kinds of statistic, then over the four. Two samples of one real texture lie at about 0.1 to 0.3,
        and 1 means differences as large as the statistics themselves.

    Raises
    ------
    ValueError
        If an image isn't two-dimensional, is too small or isn't finite.
    """
    check_planes(exemplar, image, MIN_SIDE_PX, "the Portilla-Simoncelli distance")
    side_px = min(*exemplar.shape, *image.shape)
    scales = scales_that_fit(side_px)
    centre = float(exemplar.mean())
    spread = max(float(exemplar.std()), _LEAST_CONTRAST)
    bands = _pyramid((exemplar - centre) / spread, scales)
    wanted = _statistics(_divided(bands, bands), side_px)
    found = _statistics(_divided(_pyramid((image - centre) / spread, scales), bands), side_px)
    families = []
    for family in _FAMILIES:
        groups = []
        for name in family:
            scales_of_both = zip(getattr(wanted, name), getattr(found, name), strict=True)
            groups.append(np.mean([_relative(a, b) for a, b in scales_of_both]))
        families.append(np.mean(groups))
    return float(np.mean(families))


def _relative(wanted: Plane, found: Plane) -> float:
    """One group at one scale: size of the difference over size of what is wanted, never divided by mere chance."""
    floor = wanted.size * _TINY_CORRELATION**2
    return float(np.sqrt(((found - wanted) ** 2).sum() / ((wanted**2).sum() + floor)))


def _divided(bands: _Bands, units: _Bands) -> _Bands:
    """Every part over the exemplar's root mean square of it, so that all covariances are near correlations."""
    return _Bands(
        channel=bands.channel,
        high_pass=bands.high_pass / _rms(units.high_pass),
        low_pass=tuple(plane / _rms(unit) for plane, unit in zip(bands.low_pass, units.low_pass, strict=True)),
        oriented=tuple(
            tuple(plane / _rms(unit) for plane, unit in zip(planes, of_scale, strict=True))
            for planes, of_scale in zip(bands.oriented, units.oriented, strict=True)
        ),
        parents=tuple(
            tuple(plane / _rms(unit) for plane, unit in zip(planes, of_scale, strict=True))
            for planes, of_scale in zip(bands.parents, units.parents, strict=True)
        ),
    )


def _rms(plane: Array) -> float:
    return max(float(np.sqrt(np.mean(np.abs(plane) ** 2))), _FAINT_BAND)


def _statistics(bands: _Bands, side_px: int) -> _Statistics:
    """All groups; lags reach no further than a quarter of what the smaller image, of this side, has at the scale."""
    reaches = [
        min(NEIGHBOURHOOD_PX // 2, ((side_px >> scale) - 2 * _MARGIN_PX) // 4) for scale in range(len(bands.low_pass))
    ]
    means, autos, across, phases = [], [], [], []
    for scale, oriented in enumerate(bands.oriented):
        magnitudes = [np.abs(band) for band in oriented]
        rows = np.array([magnitude.ravel() for magnitude in magnitudes])
        means.append(rows.mean(axis=1))
        autos.append(np.concatenate([_autocovariance(magnitude, reaches[scale]) for magnitude in magnitudes]))
        across.append(_covariance(rows, rows)[np.triu_indices(len(rows), 1)])
        if scale == len(bands.parents):
            continue
        parents = np.array([band.ravel() for band in bands.parents[scale]])
        parent_magnitudes = np.abs(parents)
        across.append(_covariance(rows, parent_magnitudes).ravel())
        # The phase of a coarse feature turns half as fast as that of a fine one at the same edge or line.
        doubled = parents * parents / np.maximum(parent_magnitudes, 1e-12)
        real = np.array([band.real.ravel() for band in oriented])
        phases.append(_covariance(real, np.concatenate([doubled.real, doubled.imag])).ravel())
    tails = np.percentile(bands.channel, [1, 99])
    return _Statistics(
        marginal=(np.array([bands.channel.mean(), bands.channel.std(), *_skew_and_kurtosis(bands.channel), *tails]),),
        low_pass_marginal=tuple(_skew_and_kurtosis(low) for low in bands.low_pass),
        autocorrelation=tuple(_autocovariance(low, reach) for low, reach in zip(bands.low_pass, reaches, strict=True)),
        magnitude_mean=tuple(means),
        magnitude_autocorrelation=tuple(autos),
        magnitude_across=tuple(across),
        phase_across=tuple(phases),
        high_pass=(np.array([np.mean(bands.high_pass**2)]),),
    )


def _covariance(first: Plane, second: Plane) -> Plane:
    """(variables, samples) against (variables, samples)."""
    centred = first - first.mean(axis=1, keepdims=True)
    return np.asarray(centred @ (second - second.mean(axis=1, keepdims=True)).T / first.shape[1])


def _skew_and_kurtosis(plane: Plane) -> Plane:
    """Skewness and kurtosis; those of a Gaussian, 0 and 3, where there is no contrast to speak of."""
    centred = plane - plane.mean()
    square = centred * centred
    variance = float(square.mean())
    if variance < _FAINT_BAND**2:
        return np.array([0.0, 3.0])
    return np.array([float((square * centred).mean()) / variance**1.5, float((square * square).mean()) / variance**2])


def _autocovariance(plane: Plane, reach: int) -> Plane:
    """Autocovariance at the lags of up to ``reach`` pixels, one of each opposite pair."""
    rows, cols = plane.shape
    centred = plane - plane.mean()
    values = []
    for down in range(reach + 1):
        for right in range(-reach if down else 0, reach + 1):
            left, lead = max(0, -right), max(0, right)
            here = centred[: rows - down, left : cols - lead]
            there = centred[down:, lead : cols - left]
            values.append(float(np.einsum("ij,ij->", here, there)) / here.size)
    return np.array(values)


def _pyramid(plane: Plane, scales: int) -> _Bands:
    """Steerable pyramid of an image that doesn't wrap around: mirrored outwards, borders cropped from every band.

    The filters are those of the paper's section 2.1 (Simoncelli and Freeman 1995), made in the frequency domain; the
    oriented ones keep half of the plane, so that their coefficients are analytic.
    """
    step = 2**scales
    before = 4 * step
    sizes = [step * fft.next_fast_len(-(-(length + 2 * before) // step)) for length in plane.shape]
    pads = [(before, size - length - before) for size, length in zip(sizes, plane.shape, strict=True)]
    spectrum = fft.fft2(np.pad(plane, pads, mode="symmetric"))

    def inside(band: Array, scale: int) -> Any:
        """The part of a band that lies within the image, at the scale's resolution."""
        start = (before >> scale) + _MARGIN_PX
        rows, cols = ((length >> scale) - 2 * _MARGIN_PX for length in plane.shape)
        return band[start : start + rows, start : start + cols]

    radius, _ = _polar(sizes[0], sizes[1])
    high_pass = inside(fft.ifft2(spectrum * _high(radius, 1.0)).real, 0)
    spectrum = spectrum * _low(radius, 1.0)
    lows, oriented, parents = [], [], []
    for scale in range(scales + 1):
        lows.append(inside(fft.ifft2(spectrum).real, scale))
        if scale == scales:
            break
        radius, angle = _polar(*spectrum.shape)
        fine = spectrum * _high(radius, 0.5)
        spectrum = spectrum * _low(radius, 0.5)
        # Half the radius: the parents' filters as the next round will make them, before it drops every other sample.
        coarse = spectrum * _high(radius, 0.25)
        turned = [_facing(angle, k * math.pi / ORIENTATIONS) for k in range(ORIENTATIONS)]
        oriented.append(tuple(inside(fft.ifft2(fine * fan), scale) for fan in turned))
        if scale + 1 < scales:
            parents.append(tuple(inside(fft.ifft2(coarse * fan), scale) for fan in turned))
        spectrum = _halved(spectrum)
    return _Bands(plane, high_pass, tuple(lows), tuple(oriented), tuple(parents))


def _polar(rows: int, cols: int) -> tuple[Plane, Plane]:
    """Radius, 1 at the Nyquist frequency, and angle of each entry of an unshifted spectrum."""
    down, right = 2 * fft.fftfreq(rows)[:, None], 2 * fft.fftfreq(cols)[None, :]
    return np.hypot(down, right), np.arctan2(down, right)


def _high(radius: Plane, edge: float) -> Plane:
    """Raised-cosine high pass, rising over the octave below ``edge``."""
    octaves = np.clip(np.log2(np.maximum(radius, 1e-9) / edge), -1, 0)
    return np.cos(math.pi / 2 * octaves)


def _low(radius: Plane, edge: float) -> Plane:
    """What `_high` leaves of the energy."""
    octaves = np.clip(np.log2(np.maximum(radius, 1e-9) / edge), -1, 0)
    return -np.sin(math.pi / 2 * octaves)


def _facing(angle: Plane, towards: float) -> Plane:
    """The fan of one orientation, cosine to the power of orientations less one, over half of the directions."""
    cosine = np.maximum(np.cos(angle - towards), 0)
    order = ORIENTATIONS - 1
    energy = 2.0 ** (2 * order) * math.factorial(order) ** 2 / (ORIENTATIONS * math.factorial(2 * order))
    return np.asarray(2 * math.sqrt(energy) * cosine**order)


def _halved(spectrum: ComplexPlane) -> ComplexPlane:
    """The spectrum of the image at half the resolution, where the spectrum holds nothing above a quarter."""
    rows, cols = spectrum.shape
    shifted = fft.fftshift(spectrum)[rows // 4 : rows // 4 + rows // 2, cols // 4 : cols // 4 + cols // 2]
    return np.asarray(fft.ifftshift(shifted) / 4, dtype=np.complex128)
