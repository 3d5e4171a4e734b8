"""Uneven lighting found and removed without eating the stone's own large-scale pattern.

Lighting is a smooth gain common to all channels. A gain moves every tonal quantile of a block of pixels by
the same step in log light, and leaves untouched the block's chromaticity and the distances between its
quantiles. The stone's pattern (a pale area, a denser veining) hardly ever does that: it changes colour or
contrast along with lightness. So the median map is first freed of all that these untouched measures
explain, and only then is a polynomial of degree 2 fitted to it. This carries on the demand that all
quantiles agree on a coefficient, but does not lose the lighting where the pattern pulls the quantiles
apart.

What remains is compared with the higher degrees of the same map: lighting hardly reaches them, the stone
does, and its strength there, carried on to the low degrees, tells what the stone alone could have done.
Coefficients that do not stand out of that are dropped, the others shrunk by as much as is in doubt. What
several scans of one scanner have in common stands out the better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from tilefab.slab.bands import over_bands
from tilefab.slab.checks import check_pair
from tilefab.types import FloatImage, Mask

Vector = NDArray[np.float64]

_QUANTILES = (0.1, 0.25, 0.5, 0.75, 0.9)
_BLOCK_COUNTS = (24, 12)
_MIN_BLOCK_PX = 4
_MAX_SAMPLES = 4096
_MIN_BLOCK_SHARE = 0.75
_DARKEST_Y = 1e-4
_FIT_DEGREE = 7
_LIGHTING_DEGREES = np.array([1, 1, 2, 2, 2])
_RIDGE = 0.003
_STAND_OUT = 3.5
_NOISE_FLOOR = 1e-3
_SLOPE_LIMITS = (0.75, 2.0)
_MAX_SIZE_RATIO = 1.1
_BAND_ROWS = 256


@dataclass(frozen=True)
class LightingModel:
    """Lighting common to one or several scans: log gain = sum of coefficient times basis function.

    The basis is products of Legendre polynomials of root mean square 1 in x and y, which run from -1 at the
    left or top to +1 at the right or bottom of the image: x, y, P2(x), x y, P2(y).

    Attributes
    ----------
    coefficients
        What is to be removed; all zero for no lighting.
    measured
        The same before doubtful parts were taken away.
    doubt
        What the stone's own pattern could have made of each, as a standard deviation.
    scans
        Number of scans it was estimated from.
    reason
        In words, why the coefficients are zero; empty if they are not.
    """

    coefficients: tuple[float, ...]
    measured: tuple[float, ...]
    doubt: tuple[float, ...]
    scans: int
    reason: str


@dataclass(frozen=True)
class LightingRecord:
    """What removing the lighting did.

    Attributes
    ----------
    removed
        Whether anything was changed.
    coefficients
        Those of the model.
    unevenness_frac
        Brightest by darkest lighting, less one: 0.2 means that it varied by 20 %.
    mean_y
        Mean luminance of the valid pixels, before as after.
    scans
        Number of scans that the model was estimated from.
    summary
        One sentence for the report.
    """

    removed: bool
    coefficients: tuple[float, ...]
    unevenness_frac: float
    mean_y: float
    scans: int
    summary: str


def estimate_lighting(images: Sequence[FloatImage], valids: Sequence[Mask]) -> LightingModel:
    """Estimate the lighting common to one or several scans of one scanner.

    Parameters
    ----------
    images
        One or more float32 images (rows, cols, 3), linear XYZ D50. Several must show the same field of the
        scanner, at sizes within a tenth of each other; positions are compared relative to the image.
    valids
        Their masks. Surround and dirt must be masked, or they count as stone.

    Returns
    -------
    LightingModel

    Raises
    ------
    ValueError
        If the counts differ or are zero, an image breaks the conventions, or the sizes differ too much.
    """
    if len(images) != len(valids) or not images:
        raise ValueError(f"{len(images)} images with {len(valids)} masks: wanted as many, at least one")
    for image, valid in zip(images, valids, strict=True):
        check_pair(image, valid)
    shapes = np.array([valid.shape for valid in valids])
    if (shapes.max(axis=0) > _MAX_SIZE_RATIO * shapes.min(axis=0)).any():
        raise ValueError("scans of one lighting must have nearly the same size")
    fits = [_fit_scan(image, valid) for image, valid in zip(images, valids, strict=True)]
    usable = [fit for fit in fits if fit is not None]
    if not usable:
        return _no_lighting("the scan is too small or too much of it is masked to tell lighting from stone")
    coefficients = np.array([fit[0] for fit in usable])
    doubts = np.array([fit[1] for fit in usable])
    weights = doubts**-2 / (doubts**-2).sum(axis=0)
    measured = (weights * coefficients).sum(axis=0)
    doubt = np.sqrt((weights**2 * doubts**2).sum(axis=0))
    if len(usable) >= 2:
        # Scans that disagree don't share one lighting: the more they differ, the less is believed.
        if len(usable) == 2:
            # Two slabs sawn from one block are often mirror images or copies: two say no more than one.
            doubt = np.maximum(doubt, doubts.min(axis=0))
        doubt = np.maximum(doubt, _scatter_between(coefficients, weights, measured))
    kept = measured * np.maximum(1.0 - (_STAND_OUT * doubt / np.maximum(np.abs(measured), 1e-12)) ** 2, 0.0)
    reason = "" if kept.any() else "no lighting stands out from the stone's own pattern"
    return LightingModel(_floats(kept), _floats(measured), _floats(doubt), len(usable), reason)


def remove_lighting(
    image: FloatImage, valid: Mask, model: LightingModel, out: FloatImage | None = None, threads: int = 1
) -> tuple[FloatImage, Mask, LightingRecord]:
    """Divide the lighting out of an image; the mean luminance of its valid pixels stays as it was.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), linear XYZ D50.
    valid
        bool, (rows, cols).
    model
        From `estimate_lighting`, of this scan or of scans of the same field.
    out
        Written to and returned, of the image's shape and type; may be the image itself. By default a new array.
    threads
        Never changes the result.

    Returns
    -------
    image, valid
        The image given where there is no lighting to remove; the mask as given.
    record

    Raises
    ------
    ValueError
        If image or mask break the conventions.
    """
    check_pair(image, valid)
    rows = valid.shape[0]

    def light(of: FloatImage, band: slice) -> float:
        return float(of[band][valid[band], 1].sum(dtype=np.float64))

    before = sum(over_bands(lambda band: light(image, band), rows, _BAND_ROWS, threads))
    mean_y = before / float(valid.sum())
    if not any(model.coefficients):
        summary = f"nothing, because {model.reason or 'the model holds no lighting'}"
        record = LightingRecord(False, model.coefficients, 0.0, mean_y, model.scans, summary)
        return image, valid, record
    result = np.empty_like(image) if out is None else out

    def one_band(band: slice) -> tuple[float, float, float]:
        log_gain = lighting_log_gain(model, valid.shape, band)
        np.multiply(image[band], np.exp(-log_gain)[..., None], out=result[band], casting="same_kind")
        return float(log_gain.min()), float(log_gain.max()), light(result, band)

    lowest, highest, lights = zip(*over_bands(one_band, rows, _BAND_ROWS, threads), strict=True)
    after = sum(lights)
    if after > 0.0 and before > 0.0:
        factor = np.float32(before / after)
        over_bands(lambda band: np.multiply(result[band], factor, out=result[band]), rows, _BAND_ROWS, threads)
    unevenness = float(np.expm1(max(highest) - min(lowest)))
    evidence = "this scan" if model.scans == 1 else f"{model.scans} scans"
    summary = f"lighting that varied by {100 * unevenness:.0f} % removed, as judged from {evidence}"
    record = LightingRecord(True, model.coefficients, unevenness, mean_y, model.scans, summary)
    return result, valid, record


def lighting_log_gain(model: LightingModel, shape: tuple[int, ...], rows: slice) -> Vector:
    """Natural logarithm of the gain, float64, for some rows of an image of (rows, cols) ``shape``."""
    y = (np.arange(shape[0])[rows] + 0.5) / shape[0] * 2.0 - 1.0
    x = (np.arange(shape[1]) + 0.5) / shape[1] * 2.0 - 1.0
    a, b, c, d, e = model.coefficients
    along_x = a * _legendre(x, 1) + c * _legendre(x, 2)
    along_y = b * _legendre(y, 1) + e * _legendre(y, 2)
    return np.asarray(along_y[:, None] + along_x[None, :] + d * np.outer(_legendre(y, 1), _legendre(x, 1)))


def _fit_scan(image: FloatImage, valid: Mask) -> tuple[Vector, Vector] | None:
    """Coefficients of one scan and the doubt about each; None if it can't be judged."""
    count = next((n for n in _BLOCK_COUNTS if min(valid.shape) >= n * _MIN_BLOCK_PX), None)
    if count is None:
        return None
    tone, unmoved = _block_maps(image, valid, count)
    known = np.isfinite(tone)
    if known.mean() < _MIN_BLOCK_SHARE:
        return None
    basis, degrees = _basis(count)
    basis, tone, unmoved = basis[known.ravel()], tone[known], unmoved[known]
    low = basis[:, degrees <= 2]
    tone_rest = tone - low @ np.linalg.lstsq(low, tone, rcond=None)[0]
    unmoved_rest = unmoved - low @ np.linalg.lstsq(low, unmoved, rcond=None)[0]
    normal = unmoved_rest.T @ unmoved_rest + len(tone) * _RIDGE**2 * np.eye(unmoved.shape[1])
    explained = unmoved @ np.linalg.solve(normal, unmoved_rest.T @ tone_rest)
    fitted = _robust_fit(basis, tone - explained)
    odd, even = _carried_on(fitted, degrees, 1), _carried_on(fitted, degrees, 2)
    return fitted[1:6], np.where(_LIGHTING_DEGREES == 1, odd, even)


def _carried_on(fitted: Vector, degrees: NDArray[np.int64], degree: int) -> float:
    """Strength of the stone at one degree, by a power law through the next degrees of the same parity.

    Of the same parity, because lighting that falls off about a centre has even degrees only; what it leaves at
    degree 4 must not hide a tilt.
    """
    higher = (degrees > 2) & (degrees % 2 == degree % 2)
    nearest = degrees == degree + 2
    strength = np.maximum(np.abs(fitted), 1e-9)
    near = float(np.sqrt((strength[nearest] ** 2).mean()))
    far = float(np.sqrt((strength[higher & ~nearest] ** 2).mean()))
    mean_degree = float(degrees[higher & ~nearest].mean())
    slope = np.clip(np.log(near / far) / np.log(mean_degree / (degree + 2)), *_SLOPE_LIMITS)
    scaled = strength[higher] * (degrees[higher] / degree) ** slope
    return max(float(np.sqrt((scaled**2).mean())), _NOISE_FLOOR)


def _block_maps(image: FloatImage, valid: Mask, count: int) -> tuple[Vector, Vector]:
    """Median log luminance of count x count blocks (NaN: too few valid), and the measures no gain moves."""
    rows, cols = valid.shape
    tone = np.full((count, count), np.nan)
    unmoved = np.zeros((count, count, 6))
    step = max(1, int(np.sqrt(rows / count * cols / count / _MAX_SAMPLES)))
    for i in range(count):
        band = slice(i * rows // count, (i + 1) * rows // count, step)
        for j in range(count):
            block = np.s_[band, j * cols // count : (j + 1) * cols // count : step]
            good = valid[block]
            if 2 * good.sum() < good.size:
                continue
            pixels = np.maximum(image[block][good].astype(np.float64), _DARKEST_Y)
            levels = np.log(np.quantile(pixels[:, 1], _QUANTILES))
            x, y, z = np.log(pixels.mean(axis=0))
            tone[i, j] = levels[2]
            unmoved[i, j] = (x - y, z - y, *np.diff(levels))
    return tone, unmoved


def _basis(count: int) -> tuple[Vector, NDArray[np.int64]]:
    """Legendre products up to the fit's degree at block centres, (blocks, functions), and their degrees."""
    t = (np.arange(count) + 0.5) / count * 2.0 - 1.0
    functions, degrees = [], []
    for degree in range(_FIT_DEGREE + 1):
        for in_y in range(degree + 1):
            functions.append(np.outer(_legendre(t, in_y), _legendre(t, degree - in_y)).ravel())
            degrees.append(degree)
    return np.stack(functions, axis=1), np.array(degrees)


def _legendre(t: Vector, degree: int) -> Vector:
    return np.asarray(np.sqrt(2.0 * degree + 1.0) * legendre.legval(t, [0.0] * degree + [1.0]))


def _robust_fit(basis: Vector, values: Vector) -> Vector:
    """Least squares, then Tukey's biweight by iteration."""
    fitted = np.asarray(np.linalg.lstsq(basis, values, rcond=None)[0])
    for _ in range(8):
        residual = values - basis @ fitted
        reach = 4.685 * max(1.4826 * float(np.median(np.abs(residual))), 1e-6)
        weight = np.maximum(1.0 - (residual / reach) ** 2, 0.0)
        fitted = np.asarray(np.linalg.lstsq(basis * weight[:, None], values * weight, rcond=None)[0])
    return fitted


def _scatter_between(coefficients: Vector, weights: Vector, measured: Vector) -> Vector:
    """Standard error of the mean over scans, pooled over the coefficients of one degree."""
    scans = len(coefficients)
    squares = (weights * (coefficients - measured) ** 2).sum(axis=0) / (scans - 1)
    pooled = [squares[degree == _LIGHTING_DEGREES].mean() for degree in _LIGHTING_DEGREES]
    return np.sqrt(np.array(pooled, np.float64))


def _no_lighting(reason: str) -> LightingModel:
    nothing = (0.0,) * len(_LIGHTING_DEGREES)
    return LightingModel(nothing, nothing, nothing, 1, reason)


def _floats(values: Vector) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
