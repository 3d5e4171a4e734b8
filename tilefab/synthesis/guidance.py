"""The guidance channel: how far each pixel is from the nearest edge (Kaspar et al. 2015, section 3.1).

Patches compared by colour alone don't see a crack or a joint that is wider than they are. A channel that holds the
distance to it does: edge response, Otsu's threshold, signed Euclidean distance, scaled like lightness.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.synthesis.edges import edge_response, fill_holes
from tilefab.types import Mask

STRONG_WEIGHT, SAFE_WEIGHT = 3.0, 1.0
"""Weights of the channel beside one colour channel: what the paper calls high, and its conservative setting."""

LEAST_STEP_DE76 = 2.0
"""Edges weaker than this, as `edges.edge_response` counts, are none: no eye would follow them."""

_STEPS_PER_UNIT = 16
_OTSU_BINS = 256
_LEAST_RANGE_PX = 8.0
_FARTHEST_SHARE = 1 / 8
_VICINITY_SHARE = 0.01
_COLOUR_BINS = 32
_LEAST_COLOUR_RANGE = 16.0
_COUNTS_AS_SEEN = 0.02
_PEAK_RISE = 1.25


@dataclass(frozen=True)
class Guidance:
    """A guidance channel.

    Attributes
    ----------
    channel
        (rows, cols) float32, in the range of the exemplar's first channel (lightness): the lower, the deeper inside
        an edge; the higher, the farther from any. In steps of 1/16. Constant if there are no edges.
    weight
        3.0 if the colours on both sides of edges are alike, else 1.0: relative to one colour channel.
    edges
        (rows, cols), True on edges.
    """

    channel: NDArray[np.float32]
    weight: float
    edges: Mask


def guidance_channel(
    exemplar_lab: NDArray[np.float32], valid: Mask, response: NDArray[np.float32] | None = None
) -> Guidance:
    """Make the guidance channel of an exemplar.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, channels) CIELAB (D50), or other channels scaled alike; finite where ``valid``.
    valid
        (rows, cols), True where the exemplar may be used. No edge is seen in holes, nor along their rims.
    response
        (rows, cols) strength of edges >= 0 by another detector; ``None``: `edges.edge_response`.

    Raises
    ------
    ValueError
        If the shapes don't fit, nothing is valid or a valid pixel isn't finite.

    Notes
    -----
    Two things differ from the paper. Distances beyond an eighth of the shorter side count as that, else one empty
    corner would set the scale; and a pixel of distance is never worth more than an eighth of the range of lightness,
    else edges as dense as in noise would drown the colours.
    """
    filled = fill_holes(exemplar_lab, valid)
    strength = edge_response(exemplar_lab, valid) if response is None else response
    if strength.shape != valid.shape:
        raise ValueError(f"response {strength.shape} isn't of the exemplar's shape {valid.shape}")
    edges = np.zeros(valid.shape, dtype=bool)
    seen = strength[valid]
    if float(seen.max()) >= LEAST_STEP_DE76:
        edges = (strength > otsu_threshold(seen)) & valid
    lightness = filled[..., 0]
    low, high = float(lightness[valid].min()), float(lightness[valid].max())
    if not edges.any() or edges[valid].all():
        return Guidance(_in_steps(np.full(valid.shape, (low + high) / 2)), SAFE_WEIGHT, np.zeros_like(edges))
    distance = signed_distance_px(edges, max(2.0, min(valid.shape) * _FARTHEST_SHARE))
    nearest, farthest = float(distance.min()), float(distance.max())
    per_px = (high - low) / max(farthest - nearest, _LEAST_RANGE_PX)
    # What is left of the range is shared between both ends.
    channel = (low + high) / 2 + (distance - (nearest + farthest) / 2) * per_px
    weight = STRONG_WEIGHT if _colours_are_alike(filled, valid, distance) else SAFE_WEIGHT
    return Guidance(_in_steps(channel), weight, edges)


def signed_distance_px(edges: Mask, farthest_px: float) -> NDArray[np.float64]:
    """Distance to the nearest edge pixel; on edges, less than 0: the distance to the nearest that is none.

    At most ``farthest_px`` either way. ``edges`` must hold both kinds.
    """
    outside = ndimage.distance_transform_edt(~edges)
    inside = ndimage.distance_transform_edt(edges)
    return np.asarray(np.clip(outside - inside, -farthest_px, farthest_px), dtype=np.float64)


def otsu_threshold(values: NDArray[np.float32]) -> float:
    """The threshold that parts values best into two classes (Otsu 1979); values above it are the upper class.

    Parameters
    ----------
    values
        Any shape, finite, not empty.

    Returns
    -------
    float
        The border of two of 256 bins between the least and the largest value; of equal thresholds the lowest.
        The value itself if all are alike.
    """
    low, high = float(values.min()), float(values.max())
    if high <= low:
        return low
    counts, borders = np.histogram(values, bins=_OTSU_BINS, range=(low, high))
    # Whole numbers throughout: which threshold wins must not hang on rounding.
    below = [0]
    weighted = [0]
    for index, count in enumerate(counts.tolist()):
        below.append(below[-1] + count)
        weighted.append(weighted[-1] + count * index)
    total, whole = below[-1], weighted[-1]
    best, numerator, denominator = 1, -1, 1
    for index in range(1, _OTSU_BINS):
        lower, upper = below[index], total - below[index]
        if lower and upper:
            between = (whole * lower - weighted[index] * total) ** 2
            if between * denominator > numerator * lower * upper:
                best, numerator, denominator = index, between, lower * upper
    return float(borders[best])


def _in_steps(channel: NDArray[np.float64]) -> NDArray[np.float32]:
    return (np.rint(channel * _STEPS_PER_UNIT) / _STEPS_PER_UNIT).astype(np.float32)


def _colours_are_alike(filled: NDArray[np.float64], valid: Mask, distance_px: NDArray[np.float64]) -> bool:
    """The paper's test: beside edges, no density map of two channels has several peaks or is half filled."""
    vicinity = max(1.0, _VICINITY_SHARE * valid.shape[1])
    near = valid & (distance_px > 0) & (distance_px <= vicinity)
    if not near.any():
        return False
    count = min(3, filled.shape[2])
    planes = [filled[..., channel] for channel in range(count)]
    spans = []
    for plane in planes:
        low, high = float(plane[valid].min()), float(plane[valid].max())
        widen = max(0.0, _LEAST_COLOUR_RANGE - (high - low)) / 2
        spans.append((low - widen, high + widen))
    # A single channel is compared with itself: the map is a diagonal, whose peaks are those of the channel.
    pairs = list(combinations(range(count), 2)) or [(0, 0)]
    for first, second in pairs:
        colours = [
            (planes[axis][near] - spans[axis][0]) / (spans[axis][1] - spans[axis][0]) for axis in (first, second)
        ]
        bins = [np.clip((colour * _COLOUR_BINS).astype(np.int64), 0, _COLOUR_BINS - 1) for colour in colours]
        density = np.zeros((_COLOUR_BINS, _COLOUR_BINS))
        np.add.at(density, (bins[0], bins[1]), 1.0)
        density = np.round(ndimage.gaussian_filter(density, 1.0, mode="constant"), 6)
        density /= density.max()
        if np.count_nonzero(density > _COUNTS_AS_SEEN) * 2 >= density.size or _has_several_peaks(density):
            return False
    return True


def _has_several_peaks(density: NDArray[np.float64]) -> bool:
    """Whether two summits of a map of maximum 1 are parted by a dip to less than their height / 1.25."""
    for level in np.arange(0.1, 0.8, 0.05):
        labels, count = ndimage.label(density > level)
        if count > 1:
            tops = ndimage.maximum(density, labels, np.arange(1, count + 1))
            if np.count_nonzero(np.asarray(tops) >= _PEAK_RISE * level) > 1:
                return True
    return False
