"""Face and image on one grid, as registration compares them: coarse or fine, their detail only, and what to trust."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.warping import scale_of, warp_to_face
from tilefab.types import Mask

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

MAD = 1.4826
"""Standard deviation of a Gaussian over its median absolute deviation."""

CORRELATED = 3.0
"""By how much the doubt of a mean's square is larger than pixels' number says, for neighbours are alike."""

LEAST_PIXELS = 200
"""Below so many pixels nothing is said."""

_WINDOW = 1.0 / 6.0
_FITTED_PIXELS, _TRUST_ROUNDS, _LEAST_SPREAD_L, _FAR_SPREADS = 6000, 8, 0.3, 4.0
_HALO, _LEAST_TRUSTED = 2, 0.3
_SHOWN_SHARE = 0.05
_CLIP = 5.0
_BLURRED_PX = 2


class ImageSizes:
    """L* and mask of an image, and means over squares of it as they are needed."""

    def __init__(self, fired_l: Float32Array, good: Mask) -> None:
        self._sizes = {1: np.stack([np.where(good, fired_l, 0.0), good], axis=-1).astype(np.float32)}

    def on_grid(self, matrix: Float64Array, shape: tuple[int, int]) -> tuple[Float32Array, Mask]:
        """L* on a grid, and where it is good; 0 elsewhere."""
        square = max(1, math.floor(scale_of(matrix, shape) + 0.5))
        if square not in self._sizes:
            planes = [reduced(np.ascontiguousarray(self._sizes[1][:, :, k]), square) for k in (0, 1)]
            self._sizes[square] = np.stack(planes, axis=-1)
        shrink = np.diag([1.0 / square, 1.0 / square, 1.0])
        warped, inside = warp_to_face(self._sizes[square], shrink @ matrix, shape)
        seen = inside & (warped[:, :, 1] > 0.99)
        return np.where(seen, warped[:, :, 0], np.float32(0.0)), seen


@dataclass(frozen=True, eq=False)
class Level:
    """Template and image on one level: detail only, with the image's mask."""

    factor: int
    template: Float32Array
    moved: Float32Array
    seen: Mask


def worn_px(mask: Mask) -> Mask:
    """The mask less what lies within ``_BLURRED_PX`` of its edges; the image's own border is no such edge."""
    worn = mask.copy()
    for _ in range(_BLURRED_PX):
        for axis in (0, 1):
            lines = np.moveaxis(worn, axis, 0)
            before = lines.copy()
            lines[1:] &= before[:-1]
            lines[:-1] &= before[1:]
    return worn


def reduced(values: Float32Array, factor: int) -> Float32Array:
    """Means of squares of ``factor`` pixels; what is left over at the far edges is dropped."""
    if factor == 1:
        return values
    rows, cols = values.shape[0] // factor, values.shape[1] // factor
    out = np.zeros((rows, cols), dtype=np.float32)
    for row in range(factor):
        for col in range(factor):
            out += values[row : rows * factor : factor, col : cols * factor : factor]
    out *= np.float32(1.0 / (factor * factor))
    return out


def _detail(values: Float32Array, weight: Float32Array, window: int) -> Float32Array:
    """Values less their weighted mean over a square window, a little smoothed; 0 where the weight is."""
    mean_weight = np.maximum(ndimage.uniform_filter(weight, window, mode="constant"), np.float32(1e-4))
    mean = ndimage.uniform_filter(values * weight, window, mode="constant") / mean_weight
    detail = (values - mean) * weight
    for axis in (0, 1):
        detail = ndimage.convolve1d(detail, np.array([0.25, 0.5, 0.25], dtype=np.float32), axis=axis, mode="nearest")
    return np.asarray(detail * weight, dtype=np.float32)


def level_of(
    predicted_l: Float32Array, image: ImageSizes, matrix: Float64Array, factor: int, trusted: Mask | None = None
) -> Level:
    """Both pictures on the face grid reduced by a factor, the image as the matrix has it; only what is trusted."""
    template = reduced(predicted_l, factor)
    to_image = matrix @ np.diag([float(factor), float(factor), 1.0])
    fired, seen = image.on_grid(to_image, (template.shape[0], template.shape[1]))
    if trusted is not None:
        rows, cols = (
            np.minimum((np.arange(length) + 0.5) * many / length, many - 1).astype(int)
            for length, many in zip(template.shape, trusted.shape, strict=True)
        )
        seen = seen & trusted[np.ix_(rows, cols)]
    weight = seen.astype(np.float32)
    window = 2 * max(3, round(0.5 * _WINDOW * max(template.shape))) + 1
    return Level(factor, _detail(template, weight, window), _detail(fired, weight, window), seen)


def trusted_px(predicted_l: Float32Array, image: ImageSizes, matrix: Float64Array, factor: int) -> Mask:
    """Where a small copy of the image may show the face: not where its L* is far off, as of what lies upon the tile.

    Fired L* follows the predicted one and a second-order surface, of drift and light. Beside edges anything between
    the two sides may be seen.
    """
    template = reduced(predicted_l, factor)
    rows, cols = template.shape
    fired, seen = image.on_grid(matrix @ np.diag([float(factor), float(factor), 1.0]), (rows, cols))
    if seen.sum() < LEAST_PIXELS:
        return seen
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    columns = np.stack([np.ones_like(x), template, x, y, x * x, x * y, y * y], axis=-1)
    some = np.flatnonzero(seen)[:: max(1, int(seen.sum()) // _FITTED_PIXELS)]
    lines, wanted = columns.reshape(-1, 7)[some], fired.reshape(-1)[some]
    weight = np.ones(len(some))
    for _ in range(_TRUST_ROUNDS):
        ridge = 1e-6 * weight.sum() * np.eye(7)
        solution = np.linalg.solve((lines.T * weight) @ lines + ridge, lines.T @ (weight * wanted))
        away = np.abs(wanted - lines @ solution)
        spread = max(MAD * float(np.median(away)), _LEAST_SPREAD_L)
        weight = 1.0 / (1.0 + (away / spread) ** 2) ** 2
    range_l = ndimage.maximum_filter(template, 5) - ndimage.minimum_filter(template, 5)
    away = np.abs(ndimage.uniform_filter(fired - columns @ solution, 3))
    other = seen & (away > _FAR_SPREADS * spread + range_l)
    trusted = ~ndimage.maximum_filter(other, 2 * _HALO + 1)
    return trusted if (trusted & seen).sum() >= _LEAST_TRUSTED * seen.sum() else np.ones_like(seen)


def shown_px(level: Level) -> Mask:
    """Where a level is seen and its image follows the template, or has nothing to follow: not on what lies upon it."""
    window = 2 * round(0.5 * _SHOWN_SHARE * max(level.template.shape)) + 1
    own = np.maximum(ndimage.uniform_filter(level.template**2, window, mode="constant"), 0.0)
    common = ndimage.uniform_filter(level.template * level.moved, window, mode="constant")
    gain = gain_of(level)
    spread = MAD * float(np.median(np.abs(level.moved - gain * level.template)[level.seen]))
    doubt = np.float32(spread * math.sqrt(CORRELATED) / window) * np.sqrt(own)
    other = level.seen & (common + 3.0 * doubt < 0.5 * gain * own)
    # A window half of which is covered still follows.
    shown = level.seen & ~ndimage.maximum_filter(other, window)
    return shown if shown.sum() >= _LEAST_TRUSTED * level.seen.sum() else level.seen


def gain_of(level: Level) -> float:
    """How strongly the image shows the template's detail to begin with."""
    one, other = level.template[level.seen], level.moved[level.seen]
    return float(np.clip((one * other).sum() / max(float((one * one).sum()), 1e-9), 0.3, 1.5))


def alike(level: Level) -> float:
    """Correlation of a level's detail, that of the image clipped where it is far from what is usual."""
    one, other = level.template[level.seen], level.moved[level.seen]
    if len(other) < LEAST_PIXELS:
        return 0.0
    most = np.float32(_CLIP * MAD * np.median(np.abs(other)))
    other = np.clip(other, -most, most)
    squares = float(one @ one) * float(other @ other)
    return float(one @ other) / math.sqrt(squares) if squares > 0 else 0.0
