"""The images that patches are compared in: four channels of integers, at all scales.

Colour goes in as CIELAB, any other number of channels as its three principal ones; the fourth channel guides (Kaspar
et al. 2015, 3.1). Scales are 1.3 apart, the coarsest at least 35 pixels a side (section 3 there).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX
from tilefab.texture.matching import window_is_valid
from tilefab.types import FloatImage, Mask, SizePx

STEPS_PER_UNIT = 8
"""Steps to a unit of CIELAB: the sum over a patch of all that can differ stays below 2**31."""
SCALE = 1.3
COARSEST_PX = 35
_FARTHEST = 255.0
_FEATURE_PATCHES = 0.8
_ROUNDED = 1 << 16


@dataclass(frozen=True, eq=False)
class Scale:
    """The exemplar at one scale.

    Attributes
    ----------
    image
        (rows, cols, 4) int16, `STEPS_PER_UNIT` to a unit.
    valid
        (rows, cols), True where nothing of a hole is shown.
    allowed
        (rows, cols), True where a whole patch may begin.
    weights
        (rows, cols) uint8 as in the request, or ``None``.
    factor
        Sides over those of the finest scale.
    """

    image: NDArray[np.int16]
    valid: Mask
    allowed: Mask
    weights: NDArray[np.uint8] | None
    factor: float


def features(exemplar: FloatImage, guidance: NDArray[np.float32] | None, guidance_weight: float) -> NDArray[np.float64]:
    """The four channels to be compared.

    Parameters
    ----------
    exemplar
        (rows, cols, channels), holes filled.
    guidance
        (rows, cols) of lightness's range, or ``None``.
    guidance_weight
        Of its squared differences.

    Returns
    -------
    ndarray
        (rows, cols, 4) float64.
    """
    colours = exemplar.astype(np.float64)
    if colours.shape[2] > CHANNELS - 1:
        colours = _principal(colours)
    out = np.zeros((*colours.shape[:2], CHANNELS))
    out[..., : colours.shape[2]] = colours
    if guidance is not None:
        out[..., -1] = guidance.astype(np.float64) * math.sqrt(guidance_weight)
    return np.clip(out, -_FARTHEST / 2, _FARTHEST)


def scales(
    image: NDArray[np.float64], valid: Mask, weights: NDArray[np.uint8] | None, feature_px: int | None
) -> list[Scale]:
    """All scales of an exemplar, the finest first.

    Parameters
    ----------
    image
        (rows, cols, 4), holes filled.
    valid, weights
        As in the request.
    feature_px
        The coarsest scale is the first at which a patch is as large as it; ``None``: at which the shorter side is
        just over 35 pixels.

    Raises
    ------
    ValueError
        If no whole patch of valid pixels exists.
    """
    finest = _scale(image, valid, weights, 1.0)
    if not finest.allowed.any():
        raise ValueError(f"the exemplar has no usable square of {PATCH_PX} x {PATCH_PX} pixels")
    found = [finest]
    while True:
        factor = SCALE ** -len(found)
        if feature_px is not None and feature_px * SCALE * factor <= _FEATURE_PATCHES * PATCH_PX:
            return found
        least = COARSEST_PX if feature_px is None else 2 * PATCH_PX
        if min(image.shape[:2]) * factor < least:
            return found
        coarser = _scale(image, valid, weights, factor)
        if not coarser.allowed.any():
            return found
        found.append(coarser)


def scaled_size(size: SizePx, factor: float) -> SizePx:
    """A size at a scale, never smaller than two patches."""
    return SizePx(*(max(2 * PATCH_PX, round(side * factor)) for side in (size.rows, size.cols)))


def resized(image: NDArray[np.float64], size: SizePx) -> NDArray[np.float64]:
    """An image made smaller by Keys' cubic kernel, stretched so that nothing aliases.

    Parameters
    ----------
    image
        (rows, cols, channels).
    size
        Of the result, no larger than the image.

    Returns
    -------
    ndarray
        (size.rows, size.cols, channels) float64, in steps of 2**-16 of what went in: sums of such numbers are exact, so
        that every machine gets the same.
    """
    values = np.rint(image * _ROUNDED)
    for axis, length in ((0, size.rows), (1, size.cols)):
        places, weights = _taps(image.shape[axis], length)
        total = np.zeros((*values.shape[:axis], length, *values.shape[axis + 1 :]))
        shape = [1] * values.ndim
        shape[axis] = length
        for tap in range(places.shape[1]):
            total += np.take(values, places[:, tap], axis=axis) * weights[:, tap].reshape(shape)
        values = np.rint(total / _ROUNDED)
    return values / _ROUNDED


def _scale(image: NDArray[np.float64], valid: Mask, weights: NDArray[np.uint8] | None, factor: float) -> Scale:
    if factor < 1.0:
        size = SizePx(*(max(PATCH_PX, round(side * factor)) for side in valid.shape))
        image = resized(image, size)
        # Where the kernel reaches a hole, colours were made up.
        reaches = [_reach(length, count) for length, count in zip(valid.shape, (size.rows, size.cols), strict=True)]
        valid = _all_within(valid, *reaches)
        if weights is not None:
            weights = _greatest_within(weights, *reaches)
    steps = np.rint(image * STEPS_PER_UNIT).astype(np.int16)
    allowed = np.zeros(valid.shape, dtype=bool)
    whole = window_is_valid(valid, PATCH_PX, PATCH_PX)
    allowed[: whole.shape[0], : whole.shape[1]] = whole
    return Scale(steps, valid, allowed, weights, factor)


def _taps(length: int, count: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which pixels make up each of ``count``, mirrored at the ends, and their weights in 2**-16."""
    step = length / count
    width = max(step, 1.0)
    taps = 2 * math.ceil(2 * width) + 1
    centres = (np.arange(count) + 0.5) * step - 0.5
    places = np.floor(centres).astype(np.int64)[:, np.newaxis] + np.arange(taps) - taps // 2
    away = np.abs((places - centres[:, np.newaxis]) / width)
    near = (1.5 * away - 2.5) * away * away + 1
    far = ((-0.5 * away + 2.5) * away - 4) * away + 2
    weights = np.where(away < 1, near, np.where(away < 2, far, 0.0))
    weights = np.rint(weights / weights.sum(axis=1, keepdims=True) * _ROUNDED)
    weights[np.arange(count), np.abs(away).argmin(axis=1)] += _ROUNDED - weights.sum(axis=1)
    period = max(1, 2 * length)
    places %= period
    return np.where(places < length, places, period - 1 - places), weights


def _reach(length: int, count: int) -> list[tuple[int, int]]:
    # What one pixel of the coarser image stands for; the kernel's faint tails beyond it don't count.
    return [(i * length // count, max(i * length // count + 1, -(-(i + 1) * length // count))) for i in range(count)]


def _all_within(mask: Mask, rows: list[tuple[int, int]], cols: list[tuple[int, int]]) -> Mask:
    of_rows = np.stack([mask[first:last].all(axis=0) for first, last in rows])
    return np.stack([of_rows[:, first:last].all(axis=1) for first, last in cols], axis=1)


def _greatest_within(
    values: NDArray[np.uint8], rows: list[tuple[int, int]], cols: list[tuple[int, int]]
) -> NDArray[np.uint8]:
    of_rows = np.stack([values[first:last].max(axis=0) for first, last in rows])
    return np.stack([of_rows[:, first:last].max(axis=1) for first, last in cols], axis=1)


def _principal(colours: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = colours.reshape(-1, colours.shape[2])
    centred = flat - flat.mean(axis=0)
    _, directions = np.linalg.eigh(np.round(centred.T @ centred / len(flat), 6))
    chosen = directions[:, ::-1][:, : CHANNELS - 1]
    # An axis has no sign of its own: its largest part is taken as positive. Rounded, for the same bits everywhere.
    chosen = chosen * np.where(np.take_along_axis(chosen, np.abs(chosen).argmax(axis=0)[np.newaxis], 0) < 0, -1.0, 1.0)
    return np.asarray((centred @ np.round(chosen, 6)).reshape(*colours.shape[:2], CHANNELS - 1))
