"""What of a fired tile its predicted face doesn't explain: the firing, the light and small shifts taken away.

A stone's own edges are a hundred times stronger than the defects to be found on them. So the prediction is first given
the firing's colours and the light's unevenness, by a smooth function of colour and place fitted to the tile as a
whole; then, block by block, as much shift and blur as fits best, to first order: the residual is regressed on the
prediction's slopes and curvature (B. D. Lucas, T. Kanade, "An Iterative Image Registration Technique with an
Application to Stereo Vision", IJCAI 1981, section 4, with curvature added). What is left is nearly the camera's noise,
on stone as on plain tile; its size is measured on the tile itself, where it is plain and where it is busy.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.defect_colour_kernels import (
    PLACE_TERMS,
    by_colour,
    colour_sums,
    colour_terms,
    distance_squared,
    mapped,
    place_terms,
)
from tilefab.inspection.defect_kernels import (
    binomial,
    block_means,
    block_sums,
    lab_of,
    less_blocks,
    light_of,
    means_of,
    moved_by,
    steepness,
)
from tilefab.inspection.defect_search_kernels import in_noise, local_contrast
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]

_FIT_MM, _FIT_SAMPLES, _FIT_ROUNDS = 0.4, 6_000, 4
_SAMPLES = 15_000
_MOST_INK, _LEAST_INK_SPREAD, _FAR = 0.998, 0.03, 60.0
_LEAST_SPREAD = 3.0
_RIDGE = 1e-5
_CUTOFF = 3.0
_BLOCK_MM = 3.2
_SHIFT_PRIOR_PX = 0.3
_BLOCK_SMOOTHING = 1.0
_LEAST_BLUR, _LEAST_SCALE = 0.05, 5e-4
_BACKGROUND_BLOCKS = 5
_COLOUR_CELLS, _CELL_SMOOTHING, _COLOUR_PRIOR_SHARE = (24, 8), 0.7, 3e-4
_BIN_QUANTILES = (0.0, 0.01, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 0.99, 0.997, 1.0)
_LEAST_TO_ESTIMATE, _LEAST_SIZE = 50, 0.2
_MAD = 1.4826
_CHI3_MEDIAN, _CHI3_97 = 1.5382, 2.9909
"""Median and 97 % of the length of a vector of three normal deviates (chi distribution)."""


@dataclass(frozen=True, eq=False)
class Residual:
    """A tile's unexplained rest.

    Attributes
    ----------
    values
        (rows, cols, 3) float32 CIELAB, fired less explained; 0 where the weight is.
    weight
        (rows, cols) float32: 1 where the tile is judged, 0 elsewhere.
    expected, fired
        (rows, cols, 3) float32: the prediction with this firing's colours, and the tile, both a little smoothed.
    fine
        (rows, cols, 3) float32: the values less their slow part, over some 16 mm.
    likes
        (rows, cols, 3) float32: what the noise depends on: how light the prediction is, how steep around each pixel
        (CIELAB units a pixel), and how little the rest of the tile says of what the firing does to such a colour or
        recipe (0 to 1).
    moved_px
        Mean shift that the blocks were given, (x, y): what registration left.
    """

    values: FloatImage
    weight: FloatImage
    expected: FloatImage
    fired: FloatImage
    fine: FloatImage
    likes: FloatImage
    moved_px: tuple[float, float]


def residual_over(
    predicted_lab: FloatImage, fired_lab: FloatImage, valid: Mask, px_per_mm: float, inks: FloatImage | None = None
) -> Residual:
    """The rest of a fired tile that its firing, the light and small shifts don't explain.

    Parameters
    ----------
    predicted_lab, fired_lab
        (rows, cols, 3) float32 CIELAB on the face grid.
    valid
        (rows, cols), True where the tile is to be judged; at least a hundredth of it.
    px_per_mm
        Resolution of the grid.
    inks
        (rows, cols, N) ink fractions that the face was printed with: what a firing does to colours alike depends on
        which inks make them.
    """
    laid = np.zeros((*valid.shape, 0), dtype=np.float32) if inks is None else inks
    expected = firing_applied(predicted_lab, fired_lab, valid, px_per_mm, laid)
    # Where nothing is known the prediction stands in, so that smoothing brings no strange colours from there.
    seen = binomial(light_of(np.where(valid[..., np.newaxis], fired_lab, expected)))
    sharp = binomial(light_of(expected))
    weight = valid.astype(np.float32)
    block = max(round(_BLOCK_MM * px_per_mm), 8)
    moves = _moves(sharp, seen, weight, block, every=4)
    blur = float(np.median(moves[..., 2]))
    if blur > _LEAST_BLUR:
        # The curvature tells how far the camera blurs; much of it must be done in earnest, not to first order.
        sharp = ndimage.gaussian_filter(sharp, (math.sqrt(2.0 * blur), math.sqrt(2.0 * blur), 0.0), truncate=3.0)
        moves = _moves(sharp, seen, weight, block)
    expected, fired = lab_of(moved_by(sharp, moves, block)), lab_of(seen)
    values = (fired - expected) * weight[..., np.newaxis]
    values, unknown = _less_colours_own(expected, values, weight)
    unknown = np.maximum(unknown, _unlike(laid if laid.shape[2] else predicted_lab, weight))
    light = np.ascontiguousarray(expected[..., 0])
    slope_y, slope_x = np.gradient(light)
    busy = np.sqrt(ndimage.uniform_filter(slope_x * slope_x + slope_y * slope_y, 5, mode="nearest"))
    return Residual(
        values,
        weight,
        expected,
        fired,
        less_blocks(values, weight, _slow_part(values, weight, block), block),
        np.stack([light, busy, unknown], axis=-1).astype(np.float32),
        (float(moves[..., 0].mean()), float(moves[..., 1].mean())),
    )


def _moves(sharp: FloatImage, seen: FloatImage, weight: FloatImage, block: int, every: int = 1) -> Float64Array:
    """Factors (block rows, block cols, 3) of slopes and curvature that explain most, judged by every so manieth row."""
    places = _sampled(weight)
    one = _at(sharp, places)
    rest = (_at(seen, places) - one) * steepness(one)
    scale = np.maximum(_MAD * np.median(np.abs(rest), axis=0), _LEAST_SCALE)
    sums = every * block_sums(sharp, seen, weight, scale, block, every)
    return _block_moves(sums)


def _sampled(weight: FloatImage) -> NDArray[np.int64]:
    """Flat indices of at most some ten thousand pixels that have a weight, evenly spread."""
    used = np.flatnonzero(weight)
    return used[:: max(len(used) // _SAMPLES, 1)]


def _at(image: FloatImage, places: NDArray[np.int64]) -> Float64Array:
    """Values (P, K) of an image (rows, cols, K) at flat indices."""
    return np.asarray(image.reshape(-1, image.shape[2])[places], dtype=np.float64)


def firing_applied(
    predicted_lab: FloatImage, fired_lab: FloatImage, valid: Mask, px_per_mm: float, inks: FloatImage
) -> FloatImage:
    """Predicted colours (rows, cols, 3) as this firing and this light show them.

    A smooth function of colour (second order, and third along the axis on which the stone varies most), of inks
    (second order) and of place (second order), fitted to means over small squares by iteratively reweighted least
    squares: what is far off counts less, so that defects don't pull, yet rare colours do.
    """
    rows, cols = valid.shape
    step = max(round(_FIT_MM * px_per_mm), 1)
    whole = ndimage.minimum_filter(valid, 3)
    high, wide = rows // step, cols // step
    used = means_of(whole.astype(np.float32)[..., np.newaxis], step)[..., 0] > 0.999
    places = place_terms(high, wide)[used]
    one, other, laid = (means_of(image, step)[used].astype(np.float64) for image in (predicted_lab, fired_lab, inks))
    thin = max(len(one) // _FIT_SAMPLES, 1)
    places, one, other, laid = places[::thin], one[::thin], other[::thin], laid[::thin]
    middle = one.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov(one.T) + 1e-9 * np.eye(3))
    # A stone that hardly varies along an axis says little about it: there the fit stays close to a plain shift.
    turn = (axes / np.maximum(np.sqrt(spread), _LEAST_SPREAD)).T[::-1].copy()
    # Powers of inks mustn't run away either, where there is more of one than almost anywhere on the tile.
    most_ink = np.quantile(laid, _MOST_INK, axis=0)
    colours = colour_terms(one, np.minimum(laid, most_ink), middle, turn)
    bright = (one[:, :1] + 16.0) / 100.0
    colour, place = np.zeros((colours.shape[1], 3)), np.zeros((2, PLACE_TERMS, 3))
    weights = np.ones(len(one))
    for _ in range(_FIT_ROUNDS):
        rest = np.empty_like(one)
        for channel in range(3):
            own = 0.0 if channel == 0 else one[:, channel : channel + 1] / 100.0
            design = np.concatenate([colours, bright * places, own * places], axis=1)
            weighted = design * weights[:, np.newaxis]
            normal = weighted.T @ design
            ridge = _RIDGE * weights.sum() * np.r_[0.0, np.ones(design.shape[1] - 1)]
            moved = other[:, channel] - one[:, channel]
            found = np.linalg.solve(normal + np.diag(ridge), weighted.T @ moved)
            colour[:, channel] = found[: colours.shape[1]]
            place[:, :, channel] = found[colours.shape[1] :].reshape(2, PLACE_TERMS)
            rest[:, channel] = moved - design @ found
        sizes = np.maximum(_MAD * np.median(np.abs(rest), axis=0), 0.02)
        weights = 1.0 / (1.0 + ((rest / sizes) ** 2).mean(axis=1) / _CUTOFF**2)
    return mapped(predicted_lab, inks, most_ink, middle, turn, colour, place)


def _block_moves(sums: Float64Array) -> Float64Array:
    """Factors (block rows, block cols, 3) of slopes and curvature from sums of blocks and their neighbours."""
    sums = np.stack(
        [ndimage.gaussian_filter(sums[..., k], _BLOCK_SMOOTHING, mode="nearest") for k in range(9)], axis=-1
    )
    normal = np.empty((*sums.shape[:2], 3, 3))
    for k, (i, j) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        normal[..., i, j] = normal[..., j, i] = sums[..., k]
    normal += np.eye(3) / _SHIFT_PRIOR_PX**2
    return np.ascontiguousarray(np.linalg.solve(normal, sums[..., 6:, np.newaxis])[..., 0])


def _less_colours_own(expected: FloatImage, values: FloatImage, weight: FloatImage) -> tuple[FloatImage, FloatImage]:
    """A residual less what colours alike have in common, and how little is known of that for each pixel's, 0 to 1.

    Firings bend colours more than the smooth function follows.
    """
    places = _sampled(weight)
    colours, rest = _at(expected, places), _at(values, places)
    _, directions = np.linalg.eigh(np.cov(colours.T))
    axes = np.zeros((2, 4))
    for k, (direction, cells) in enumerate(zip((directions[:, 2], directions[:, 1]), _COLOUR_CELLS, strict=True)):
        low, high = np.quantile(colours @ direction, [0.001, 0.999])
        per_unit = (cells - 1) / max(high - low, _LEAST_SPREAD)
        axes[k, :3], axes[k, 3] = per_unit * direction, -per_unit * low
    most = 4.0 * np.maximum(_MAD * np.median(np.abs(rest), axis=0), 0.05).astype(np.float64)
    sums = colour_sums(expected, values, weight, axes, most, _COLOUR_CELLS)
    smooth = np.stack(
        [ndimage.gaussian_filter(sums[..., k], _CELL_SMOOTHING, mode="constant") for k in range(4)], axis=-1
    )
    prior = _COLOUR_PRIOR_SHARE * sums[..., 3].sum()
    # Cells of few pixels are left nearly alone, for a defect could be all there is in one.
    counts = smooth[..., 3:] + prior
    found = by_colour(expected, axes, np.concatenate([smooth[..., :3], np.full_like(counts, prior)], axis=-1) / counts)
    values = (values - found[..., :3]) * weight[..., np.newaxis]
    return values, np.ascontiguousarray(found[..., 3])


def _slow_part(values: FloatImage, weight: FloatImage, block: int) -> Float64Array:
    """Means of blocks (block rows, block cols, 3) without what stands out, their surroundings' medians, smoothed."""
    usual = _at(values, _sampled(weight))
    most = 2.0 * np.maximum(_MAD * np.median(np.abs(usual), axis=0), 0.05).astype(np.float64)
    sums = block_means(values, weight, most, block)
    known = sums[..., 3] * 3.0 >= block * block
    if not known.any():
        return np.zeros((*known.shape, 3))
    means = sums[..., :3] / np.maximum(sums[..., 3:], 1.0)
    means = means[tuple(ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True))]
    slow = [ndimage.median_filter(means[..., c], _BACKGROUND_BLOCKS, mode="nearest") for c in range(3)]
    return np.stack([ndimage.gaussian_filter(plane, 1.0, mode="nearest") for plane in slow], axis=-1)


def _unlike(image: FloatImage, weight: FloatImage) -> FloatImage:
    """How unlike the tile's most recipes, or colours (rows, cols, K), each pixel's is, 0 to 1."""
    sample = _at(image, _sampled(weight))
    least = _LEAST_INK_SPREAD if sample.max() <= 1.0 else _LEAST_SPREAD
    spread = np.cov(sample.T).reshape(sample.shape[1], -1) + least**2 * np.eye(sample.shape[1])
    far = distance_squared(image, sample.mean(axis=0), np.linalg.inv(spread).astype(np.float64))
    return np.asarray(far / (far + np.float32(_FAR)), dtype=np.float32)


def contrast_of(
    values: FloatImage, weight: FloatImage, likes: FloatImage, inner: int, outer: int
) -> tuple[FloatImage, FloatImage, FloatImage, FloatImage]:
    """Local contrast of a residual, as it is and in units of its own noise.

    Parameters
    ----------
    values, weight, likes
        As in `Residual`, at any resolution.
    inner, outer
        Half sides of the squares between which the surroundings lie, pixels.

    Returns
    -------
    contrast, whitened, sigmas, seen
        (rows, cols, 3) CIELAB units; (rows, cols, 3) and (rows, cols) in units of noise, see `whitened_by_noise`;
        (rows, cols), 0 where nothing is known.
    """
    contrast, seen = local_contrast(values, weight, inner, outer)
    contrast = binomial(contrast)
    return contrast, *whitened_by_noise(contrast, seen, likes), seen


def whitened_by_noise(values: FloatImage, weight: FloatImage, likes: FloatImage) -> tuple[FloatImage, FloatImage]:
    """Values (rows, cols, 3) in units of the tile's own noise, and the lengths (rows, cols) of those.

    Channels are not correlated, and of unit variance, by robust estimates; where pixels have like values in ``likes``
    (rows, cols, K), they are held against each other.
    """
    places = _sampled(weight)
    sample, around = _at(values, places), _at(likes, places)
    white = _whitening(sample)
    lengths = np.sqrt(((sample @ white.T) ** 2).sum(axis=1))
    bins = len(_BIN_QUANTILES) - 1
    knots, sizes = np.tile(np.arange(bins, dtype=np.float64), (likes.shape[2], 1)), np.ones((likes.shape[2], bins))
    for k in range(likes.shape[2]):
        if len(lengths) < 10 * _LEAST_TO_ESTIMATE:
            break
        knots[k], sizes[k] = _noise_sizes(lengths, around[:, k])
        lengths = lengths / np.interp(around[:, k], knots[k], sizes[k])
    return in_noise(values, likes, white, knots, sizes)


def _whitening(sample: Float64Array) -> Float64Array:
    """(3, 3) matrix that gives values (P, 3) unit covariance, estimated without their outliers."""
    if len(sample) < _LEAST_TO_ESTIMATE:
        return np.eye(3)
    sizes = np.maximum(_MAD * np.median(np.abs(sample), axis=0), 1e-3)
    kept = sample[(np.abs(sample) < 3.0 * sizes).all(axis=1)]
    covariance = kept.T @ kept / max(len(kept), 1) + 1e-4 * np.eye(3)
    spread, axes = np.linalg.eigh(covariance)
    white = (axes / np.sqrt(spread)).T
    lengths = np.sqrt(((sample @ white.T) ** 2).sum(axis=1))
    return np.asarray(white * (_CHI3_MEDIAN / max(float(np.median(lengths)), 1e-6)), dtype=np.float64)


def _noise_sizes(lengths: Float64Array, like: Float64Array) -> tuple[Float64Array, Float64Array]:
    """How much larger whitened values are, where another has certain values: those (B,), and the factors (B,)."""
    order = np.argsort(like)
    knots, sizes = [], []
    for begin, end in itertools.pairwise(_BIN_QUANTILES):
        part = order[int(begin * len(order)) : int(end * len(order))]
        if len(part) >= _LEAST_TO_ESTIMATE:
            usual, high = np.quantile(lengths[part], [0.5, 0.97])
            # Heavy tails count as noise too: stone's edges have them.
            knots.append(float(np.median(like[part])))
            sizes.append(max(float(usual) / _CHI3_MEDIAN, float(high) / _CHI3_97, _LEAST_SIZE))
    missing = len(_BIN_QUANTILES) - 1 - len(knots)
    beyond = knots[-1] + 1.0 + np.arange(missing)
    # Values that many pixels share make bins of the same knot: a little apart, they stay in order.
    apart = np.maximum.accumulate(np.array(knots)) + 1e-9 * np.arange(len(knots))
    return np.concatenate([apart, beyond]), np.concatenate([sizes, np.full(missing, sizes[-1])])


def halved(image: FloatImage) -> FloatImage:
    """Means of two by two pixels of an image (rows, cols) or (rows, cols, 3); an odd last row or column is left out."""
    rows, cols = (side // 2 for side in image.shape[:2])
    even = image[: 2 * rows, : 2 * cols]
    total = even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]
    return np.ascontiguousarray(np.float32(0.25) * total)


def halved_values(values: FloatImage, weight: FloatImage) -> FloatImage:
    """Weighted means of two by two pixels of a residual (rows, cols, 3)."""
    mean = halved(values * weight[..., np.newaxis])
    return np.asarray(mean / np.maximum(halved(weight), np.float32(0.25))[..., np.newaxis], dtype=np.float32)
