"""Lines along columns and bands of rows: what shows when a tile's residual is averaged over its whole length.

Print data travel along rows, so a failed nozzle leaves a line along a column, all the tile long, and an uneven feed
leaves bands across. A column's mean over a thousand rows is thirty times less noisy than a pixel: lines too faint for
any other search are found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.types import FloatImage

Float64Array = NDArray[np.float64]

_MAD = 1.4826
_CHI3_MEDIAN = 1.5382
_LEAST_SIDE_PX, _BLUR_PX = 4, 2
_PARTS = 16
_LEAST_PART_PX = 20
_PART_SIGMAS = 2.5
_INK_LIKENESS, _INK_PARTS = 0.8, 3


@dataclass(frozen=True)
class ProfileSettings:
    """What counts as a line or a band.

    Attributes
    ----------
    line_widths_mm, band_widths_mm
        Widths that are tried.
    line_sigmas, band_sigmas
        How far the mean must stand out of those of the other columns, or rows, standard deviations.
    least_line_contrast, least_band_contrast
        Smallest mean contrast to the surroundings, CIELAB units.
    least_share
        Share of its length on which a line or a band must show; a line shows less where its ink isn't printed, and
        counts all the same if it shows where that is.
    """

    line_widths_mm: tuple[float, ...] = (0.1, 0.2, 0.35, 0.6)
    band_widths_mm: tuple[float, ...] = (0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
    line_sigmas: float = 8.0
    band_sigmas: float = 8.0
    least_line_contrast: float = 0.3
    least_band_contrast: float = 0.5
    least_share: float = 0.5


@dataclass(frozen=True)
class Stripe:
    """A line or a band, in pixels along its profile: from ``first`` on, ``width`` wide.

    ``contrast``: mean CIELAB difference to its surroundings; ``sigmas``: how far it stands out.
    """

    first: int
    width: int
    contrast: tuple[float, float, float]
    sigmas: float


def stripes_of(
    values: FloatImage,
    whitened: FloatImage,
    weight: FloatImage,
    share: FloatImage,
    widths_px: tuple[int, ...],
    sigmas: float,
    least_contrast: float,
    least_share: float,
    inks: FloatImage | None = None,
    *,
    rare: bool = True,
) -> tuple[Stripe, ...]:
    """Columns that differ from their neighbours all along; for bands, images are handed over transposed.

    Parameters
    ----------
    values, whitened
        (rows, cols, 3) residual in CIELAB units and in units of noise.
    weight
        (rows, cols), 0 where the tile isn't judged.
    share
        (rows, cols) the same times how much each pixel counts: outliers less.
    widths_px
        Widths to try.
    sigmas, least_contrast, least_share
        See `ProfileSettings`.
    inks
        (rows, cols, N) ink fractions, where it may be one ink's stripe.
    rare
        Whether stripes must also stand out of the other columns: single lines do, bands all over a tile don't.

    Returns
    -------
    tuple
        The strongest first; no two overlap.
    """
    rows = weight.shape[0]
    parts = max(min(_PARTS, rows // _LEAST_PART_PX), 1)
    edges = np.linspace(0, rows, parts + 1).astype(np.int64)
    noise = np.add.reduceat(whitened * share[..., np.newaxis], edges[:-1], axis=0).astype(np.float64)
    colour = (values * weight[..., np.newaxis]).sum(axis=0, dtype=np.float64)
    counts = np.add.reduceat(weight, edges[:-1], axis=0).astype(np.float64)
    found: list[Stripe] = []
    for width in widths_px:
        whole = _against_neighbours(noise.sum(axis=0), counts.sum(axis=0), width)
        pieces = np.stack([_against_neighbours(*part, width) for part in zip(noise, counts, strict=True)])
        strength = _in_error(whole, pieces)
        if rare:
            strength = np.minimum(strength, _among_others(whole))
        lab = _against_neighbours(colour, counts.sum(axis=0), width)
        size = np.sqrt((lab**2).sum(axis=1))
        peaks = (strength == ndimage.maximum_filter1d(strength, 2 * width + 1)) & (strength >= sigmas)
        for middle in np.flatnonzero(peaks & (size >= least_contrast)):
            first = int(middle) - width // 2
            shown = _parts_shown(pieces, whole[middle], int(middle))
            if _all_along(shown, least_share, inks, edges, first, width):
                one, two, three = (float(value) for value in lab[middle])
                found.append(Stripe(first, width, (one, two, three), float(strength[middle])))
    found.sort(key=lambda stripe: -stripe.sigmas)
    kept: list[Stripe] = []
    for stripe in found:
        if all(_apart(stripe, other) for other in kept):
            kept.append(stripe)
    return tuple(kept)


def _apart(one: Stripe, other: Stripe) -> bool:
    """Whether two stripes are further from each other than the neighbours they were held against."""
    gap = max(one.first, other.first) - min(one.first + one.width, other.first + other.width)
    return gap > 2 * max(one.width, other.width)


def _against_neighbours(sums: Float64Array, counts: Float64Array, width: int) -> Float64Array:
    """Means (cols, 3) over ``width`` columns less those over columns on both sides; 0 where not enough is known."""
    cols, side = len(counts), max(2 * width, _LEAST_SIDE_PX)
    before = np.zeros((cols + 1, 4))
    np.cumsum(np.concatenate([sums, counts[:, np.newaxis]], axis=1), axis=0, out=before[1:])
    first = np.arange(cols) - width // 2

    def over(begin: NDArray[np.int64], end: NDArray[np.int64]) -> Float64Array:
        return np.asarray(before[np.clip(end, 0, cols)] - before[np.clip(begin, 0, cols)])

    within = over(first, first + width)
    left, last = first - _BLUR_PX, first + width + _BLUR_PX
    around = over(left - side, left) + over(last, last + side)
    full = counts.max()
    known = (within[:, 3] > 0.5 * width * full) & (around[:, 3] > 0.5 * side * full)
    means = within[:, :3] / np.maximum(within[:, 3:], 1e-9) - around[:, :3] / np.maximum(around[:, 3:], 1e-9)
    return np.where(known[:, np.newaxis], means, 0.0)


def _in_error(means: Float64Array, pieces: Float64Array) -> Float64Array:
    """Lengths (cols,) of means in units of their error, which the scatter of their pieces (parts, cols, 3) tells."""
    known = np.any(pieces != 0.0, axis=(0, 2))
    if not known.any():
        return np.zeros(len(means))
    scatter = np.median(pieces[:, known].std(axis=0), axis=0) / math.sqrt(len(pieces))
    return np.asarray(np.sqrt(((means / np.maximum(scatter, 1e-9)) ** 2).sum(axis=1)), dtype=np.float64)


def _among_others(means: Float64Array) -> Float64Array:
    """Lengths (cols,) of means in units of their robust spread over all columns."""
    known = means[np.any(means != 0.0, axis=1)]
    if len(known) < 10:
        return np.zeros(len(means))
    sizes = np.maximum(_MAD * np.median(np.abs(known), axis=0), 1e-6)
    kept = known[(np.abs(known) < 4.0 * sizes).all(axis=1)] / sizes
    covariance = kept.T @ kept / max(len(kept), 1) + 0.05 * np.eye(3)
    spread, axes = np.linalg.eigh(covariance)
    white = (axes / np.sqrt(spread)).T / sizes
    usual = np.median(np.sqrt(((known @ white.T) ** 2).sum(axis=1))) / _CHI3_MEDIAN
    return np.asarray(np.sqrt(((means @ white.T) ** 2).sum(axis=1)) / max(float(usual), 1e-9), dtype=np.float64)


def _parts_shown(pieces: Float64Array, mean: Float64Array, middle: int) -> Float64Array:
    """How strongly each part (parts,) of a column shows what its mean (3,) is, in units of noise; NaN: not known."""
    along = pieces @ (mean / np.linalg.norm(mean))
    known = np.any(pieces != 0.0, axis=(0, 2))
    noise = max(float(np.median(along[:, known].std(axis=0))), 1e-9)
    return np.where(np.any(pieces[:, middle] != 0.0, axis=1), along[:, middle] / noise, np.nan)


def _all_along(
    shown: Float64Array,
    least_share: float,
    inks: FloatImage | None,
    edges: NDArray[np.int64],
    first: int,
    width: int,
) -> bool:
    """Whether a stripe shows all along, or wherever one of the inks is."""
    known = ~np.isnan(shown)
    clear = known & (np.nan_to_num(shown) > _PART_SIGMAS)
    if clear.sum() >= max(least_share * known.sum(), 1.0):
        return True
    if inks is None or clear.sum() < _INK_PARTS:
        return False
    there = inks[:, max(first, 0) : first + width].mean(axis=1, dtype=np.float64)
    there = np.add.reduceat(there, edges[:-1], axis=0)[known]
    strength = np.maximum(shown[known], 0.0)
    likeness = strength @ there / np.maximum(np.linalg.norm(strength) * np.linalg.norm(there, axis=0), 1e-12)
    # Not if the ink is everywhere: a scratch would do.
    uneven = there.min(axis=0) < 0.3 * there.max(axis=0)
    return bool((uneven & (likeness > _INK_LIKENESS)).any())
