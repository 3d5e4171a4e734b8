"""How far veins run before they break: ridges found, followed, and their lengths compared with the exemplar's.

A vein is a curve along which the lightness, or a*, or b*, is a ridge or a valley. Ridges of each channel and polarity
are followed apart, so that a dark vein and the light edge beside it don't merge.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.jit import kernel

SIGMAS_PX = (1.5, 2.0, 3.0, 4.0)
"""Scales at which ridges are sought by default: veins some 3 to 10 px wide."""

_CURVE_COSINE = math.cos(math.radians(50.0))
_GAP_COSINE = math.cos(math.radians(30.0))


@dataclass(frozen=True)
class VeinThresholds:
    """What counts as a vein.

    Attributes
    ----------
    low, high
        Ridge strength, CIELAB units per px**0.5: a curve has a point of at least ``high`` and goes on as long as
        points are at least ``low``. Infinite if the exemplar has no ridges.
    sigmas_px
        Scales at which ridges are sought.
    """

    low: float
    high: float
    sigmas_px: tuple[float, ...] = SIGMAS_PX


@dataclass(frozen=True)
class VeinContinuity:
    """Lengths of a wall's veins, divided by those of the exemplar's.

    Attributes
    ----------
    median_ratio, p90_ratio
        Of the length-weighted quantiles: half (a tenth) of all vein pixels lie on curves at least so long. 1.0 = veins
        run on as far as in the exemplar.
    plain_median_ratio, plain_p90_ratio
        Of quantiles that count every curve once. Fragments of a few pixels, of which there are most, rule these.
    density_ratio
        Total length of veins per area. Far from 1.0, the other ratios say little: a wall blurred until only its
        strongest veins are left has long ones.
    exemplar_median_px
        The exemplar's length-weighted median.
    """

    median_ratio: float
    p90_ratio: float
    plain_median_ratio: float
    plain_p90_ratio: float
    density_ratio: float
    exemplar_median_px: float


def vein_thresholds(
    exemplar_lab: NDArray[np.floating],
    sigmas_px: tuple[float, ...] = SIGMAS_PX,
    low_share: float = 0.10,
    high_share: float = 0.02,
) -> VeinThresholds:
    """What counts as a vein, by the strongest ridges of the exemplar.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB.
    sigmas_px
        Scales at which ridges are sought, each > 0.
    low_share, high_share
        Ridge points at least as strong as ``low`` (``high``) make up this share of the exemplar's pixels, over 0
        to 1. If it hasn't as many, all count.

    Returns
    -------
    VeinThresholds
        To be used for the exemplar and for walls made of it.

    Raises
    ------
    ValueError
        If the shape, a scale or a share is wrong.
    """
    if not 0.0 < high_share <= low_share <= 1.0:
        raise ValueError(f"shares of ridge points {low_share} and {high_share} are not 1 >= low >= high > 0")
    crests = [strength[strength > 0] for strength, _, _ in _ridges(exemplar_lab, sigmas_px)]
    strengths = np.sort(np.concatenate(crests))[::-1]
    # Rounding leaves ridges of 1e-15 on a flat picture; a hundredth of a unit is no vein.
    strengths = strengths[strengths > 0.01]
    if strengths.size == 0:
        return VeinThresholds(math.inf, math.inf, sigmas_px)
    n_pixels = exemplar_lab.shape[0] * exemplar_lab.shape[1]
    low, high = (
        float(strengths[min(round(share * n_pixels), strengths.size - 1)]) for share in (low_share, high_share)
    )
    return VeinThresholds(low, high, sigmas_px)


def vein_lengths(lab: NDArray[np.floating], thresholds: VeinThresholds) -> NDArray[np.float64]:
    """Lengths of all veins of a picture.

    Parameters
    ----------
    lab
        (rows, cols, 3) CIELAB.
    thresholds
        From the exemplar.

    Returns
    -------
    ndarray of float64
        (curves,), in pixels, longest first: the steps between the ridge points of each curve, 1 or sqrt(2) each.

    Raises
    ------
    ValueError
        If the shape or a scale is wrong.

    Notes
    -----
    Ridge strength is the difference of the magnitudes of the Hessian's eigenvalues, so that spots don't count, over
    Gaussian scales normalised for ridges (Lindeberg 1998, "Edge detection and ridge detection with automatic scale
    selection", section 5: gamma = 3/4). Points that are maximal across the ridge are followed from the strongest on
    (after Steger 1998, "An unbiased detector of curvilinear structures", on linking), across gaps of one point, until
    the ridge fades, turns sharply or meets a curve already followed. Two sigmas of the largest scale along the border
    are left out.
    """
    lengths = []
    for strength, row_step, col_step in _ridges(lab, thresholds.sigmas_px):
        seeds = np.flatnonzero(strength >= thresholds.high)
        seeds = seeds[np.argsort(-strength.ravel()[seeds], kind="stable")]
        lengths.append(_follow(strength, row_step, col_step, seeds, thresholds.low, _CURVE_COSINE, _GAP_COSINE))
    found = np.concatenate(lengths)
    return np.sort(found[found > 0])[::-1]


def vein_continuity(
    exemplar_lab: NDArray[np.floating],
    wall_lab: NDArray[np.floating],
    thresholds: VeinThresholds | None = None,
) -> VeinContinuity:
    """Whether the veins of a wall run on as far as those of the exemplar.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB.
    wall_lab
        (wall rows, wall cols, 3) CIELAB, no smaller than the exemplar.
    thresholds
        What counts as a vein; `vein_thresholds` of the exemplar if None.

    Returns
    -------
    VeinContinuity
        All ratios are 1.0 if the exemplar has no veins.

    Raises
    ------
    ValueError
        If the wall is smaller than the exemplar, or a shape is wrong.

    Notes
    -----
    The exemplar's border cuts veins short. So the wall is measured in as many windows of the exemplar's size as fit
    side by side, spread evenly over it, which cut its veins in the same way.
    """
    rows, cols = exemplar_lab.shape[:2]
    if wall_lab.shape[0] < rows or wall_lab.shape[1] < cols:
        raise ValueError(f"a wall of {wall_lab.shape[:2]} is smaller than its exemplar of {(rows, cols)}")
    limits = vein_thresholds(exemplar_lab) if thresholds is None else thresholds
    of_exemplar = vein_lengths(exemplar_lab, limits)
    if of_exemplar.size == 0:
        return VeinContinuity(1.0, 1.0, 1.0, 1.0, 1.0, 0.0)
    windows = [
        vein_lengths(wall_lab[r : r + rows, c : c + cols], limits)
        for r in _starts(wall_lab.shape[0], rows)
        for c in _starts(wall_lab.shape[1], cols)
    ]
    of_wall = np.concatenate(windows)
    median, p90, plain_median, plain_p90 = (
        quantile(of_wall, share) / quantile(of_exemplar, share)
        for quantile in (_weighted_quantile, _plain_quantile)
        for share in (0.5, 0.9)
    )
    return VeinContinuity(
        median_ratio=median,
        p90_ratio=p90,
        plain_median_ratio=plain_median,
        plain_p90_ratio=plain_p90,
        density_ratio=float(of_wall.sum() / len(windows) / of_exemplar.sum()),
        exemplar_median_px=_weighted_quantile(of_exemplar, 0.5),
    )


def _starts(wall_px: int, window_px: int) -> list[int]:
    """Where windows begin that are spread evenly over a side of the wall without overlap."""
    count = wall_px // window_px
    return [round(k * (wall_px - window_px) / (count - 1)) for k in range(count)] if count > 1 else [0]


def _weighted_quantile(lengths: NDArray[np.float64], share: float) -> float:
    """The length up to which curves hold ``share`` of the total length; 0.0 of no curves."""
    if lengths.size == 0:
        return 0.0
    ascending = np.sort(lengths)
    total = np.cumsum(ascending)
    return float(ascending[min(int(np.searchsorted(total, share * total[-1])), lengths.size - 1)])


def _plain_quantile(lengths: NDArray[np.float64], share: float) -> float:
    return float(np.quantile(lengths, share)) if lengths.size else 0.0


def _ridges(
    lab: NDArray[np.floating], sigmas_px: tuple[float, ...]
) -> list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]]:
    """Ridge points of each channel and polarity: strength, 0.0 elsewhere, and the unit step across the ridge."""
    if lab.ndim != 3 or lab.shape[2] != 3:
        raise ValueError(f"a picture in CIELAB is (rows, cols, 3), not {lab.shape}")
    if not sigmas_px or min(sigmas_px) <= 0:
        raise ValueError(f"the scales of ridges {sigmas_px} are not all positive")
    margin = math.ceil(2 * max(sigmas_px))
    ridges = []
    for channel in range(3):
        values = np.ascontiguousarray(lab[..., channel], dtype=np.float64)
        strongest = np.zeros((2, *values.shape))
        angle = np.zeros((2, *values.shape))
        for sigma in sigmas_px:
            h_rr, h_rc, h_cc = (
                sigma**1.5 * ndimage.gaussian_filter(values, sigma, order=order, mode="nearest")
                for order in ((2, 0), (1, 1), (0, 2))
            )
            middle, spread = (h_rr + h_cc) / 2, np.hypot((h_rr - h_cc) / 2, h_rc)
            # Of the eigenvalues middle + spread and middle - spread, the first is the larger one in magnitude, that
            # across the ridge, where the middle is positive: in valleys. The magnitudes differ by 2 min(|middle|,
            # spread).
            strength = 2 * np.minimum(np.abs(middle), spread)
            across = np.arctan2(2 * h_rc, h_rr - h_cc) / 2
            for polarity, here in enumerate((middle > 0, middle < 0)):
                stronger = here & (strength > strongest[polarity])
                strongest[polarity][stronger] = strength[stronger]
                angle[polarity][stronger] = across[stronger] + polarity * math.pi / 2
        for polarity in range(2):
            row_step, col_step = np.cos(angle[polarity]), np.sin(angle[polarity])
            ridges.append((_crests(strongest[polarity], row_step, col_step, margin), row_step, col_step))
    return ridges


@kernel
def _crests(
    strength: NDArray[np.float64], row_step: NDArray[np.float64], col_step: NDArray[np.float64], margin: int
) -> NDArray[np.float64]:
    """Strength where it is maximal across the ridge, between bilinear neighbours one pixel away; 0.0 elsewhere."""
    rows, cols = strength.shape
    crest = np.zeros((rows, cols))
    for r in range(max(margin, 2), rows - max(margin, 2)):
        for c in range(max(margin, 2), cols - max(margin, 2)):
            here = strength[r, c]
            if here <= 0.0:
                continue
            highest = True
            for sign in (-1.0, 1.0):
                y, x = r + sign * row_step[r, c], c + sign * col_step[r, c]
                i, j = int(np.floor(y)), int(np.floor(x))
                v, u = y - i, x - j
                there = (1 - v) * ((1 - u) * strength[i, j] + u * strength[i, j + 1]) + v * (
                    (1 - u) * strength[i + 1, j] + u * strength[i + 1, j + 1]
                )
                # Of two equal ones, the first is the crest.
                highest = highest and (here >= there if sign > 0 else here > there)
            if highest:
                crest[r, c] = here
    return crest


@kernel
def _follow(
    strength: NDArray[np.float64],
    row_step: NDArray[np.float64],
    col_step: NDArray[np.float64],
    seeds: NDArray[np.int64],
    low: float,
    curve_cosine: float,
    gap_cosine: float,
) -> NDArray[np.float64]:
    """Length of the curve followed from each seed; 0.0 if an earlier curve has been there.

    A step leads to the neighbour ahead whose place and direction agree best with the direction so far; if there is
    none, to a point two pixels away.
    """
    rows, cols = strength.shape
    used = np.zeros((rows, cols), dtype=np.bool_)
    lengths = np.zeros(len(seeds))
    for n in range(len(seeds)):
        r0, c0 = seeds[n] // cols, seeds[n] % cols
        if used[r0, c0]:
            continue
        used[r0, c0] = True
        for sign in (-1.0, 1.0):
            r, c = r0, c0
            # Along the ridge is square to across it.
            dr, dc = sign * col_step[r, c], -sign * row_step[r, c]
            while True:
                # Of a crest two pixels wide, the second is not another curve.
                side_r, side_c = int(np.rint(row_step[r, c])), int(np.rint(col_step[r, c]))
                for y, x in ((r + side_r, c + side_c), (r - side_r, c - side_c)):
                    if abs(dr * col_step[y, x] - dc * row_step[y, x]) >= curve_cosine:
                        used[y, x] = True
                next_r, next_c, best = -1, -1, 0.0
                for reach in (1, 2):
                    for i in range(-reach, reach + 1):
                        for j in range(-reach, reach + 1):
                            if max(abs(i), abs(j)) != reach:
                                continue
                            y, x = r + i, c + j
                            if y < 1 or x < 1 or y >= rows - 1 or x >= cols - 1 or strength[y, x] < low:
                                continue
                            ahead = (i * dr + j * dc) / np.sqrt(i * i + j * j)
                            along = abs(dr * col_step[y, x] - dc * row_step[y, x])
                            if ahead < (curve_cosine if reach == 1 else gap_cosine) or along < curve_cosine:
                                continue
                            if ahead + along > best:
                                next_r, next_c, best = y, x, ahead + along
                    if next_r >= 0:
                        break
                if next_r < 0 or used[next_r, next_c]:
                    break
                lengths[n] += np.sqrt(float((next_r - r) ** 2 + (next_c - c) ** 2))
                used[(r + next_r) // 2, (c + next_c) // 2] = True
                r, c = next_r, next_c
                used[r, c] = True
                forward = 1.0 if dr * col_step[r, c] - dc * row_step[r, c] > 0 else -1.0
                dr, dc = forward * col_step[r, c], -forward * row_step[r, c]
    return lengths
