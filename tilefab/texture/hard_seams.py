"""Seams that can be seen: lines along which pieces meet whose colours have nothing to do with one another.

A seam's cost tells how far two pieces disagree, pixel by pixel. It doesn't tell whether anybody sees that: among grit,
steps of all sizes and signs are what the texture is made of. What is seen is a step of one sign that goes on for a
while, and isn't one of those that the texture has itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.types import Array, Mask

Plane: TypeAlias = NDArray[np.float64]

MAX_HARD_SHARE = 0.0025
"""Largest share of an image near hard seams that passes: see `hard_seams`."""
_SIGMA_PX = 2.0
_EDGE_PERCENTILE = 95
_EDGE_SHARE = 0.5
_LEAST_COHERENCE = 2.5
_LEAST_EXTENT_PX = 12
_LEAST_EDGE_DE76 = 2.0


@dataclass(frozen=True)
class HardSeams:
    """The hard seams of an image.

    Attributes
    ----------
    share
        Share of the image that lies within some two pixels of one, 0 to 1.
    count
        How many there are.
    longest_px
        The longest: diagonal of the box around it.
    where
        (rows, cols), True near a hard seam.
    """

    share: float
    count: int
    longest_px: float
    where: Mask


def hard_seams(
    source: NDArray[np.int32], exemplar: Array, image: Array | None = None, known: Mask | None = None
) -> HardSeams:
    """Find the hard seams of an image that was put together from an exemplar.

    Parameters
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    exemplar
        (exemplar rows, exemplar cols, channels) CIELAB, or other channels scaled like it; at least 8 a side.
    image
        (rows, cols, channels), if it isn't exactly what the map makes of the exemplar.
    known
        (rows, cols), True where the map holds; steps next to other pixels aren't judged. By default everywhere.

    Returns
    -------
    HardSeams
        ``share`` is .005 to .07 of mosaics of six textures, of pieces some thirty pixels large laid edge to edge, at
        random or where they match best; .0007 or less of quilts with minimum cuts and of patchworks of grains. Of
        published results found again without a map, quilting has up to .0046 and the others 0.

    Raises
    ------
    ValueError
        If a shape is wrong or the map points outside the exemplar.

    Notes
    -----
    Between neighbours p and q, cut from pieces A and B, the exemplar expects the step ``(A(q) - A(p) + B(q) - B(p)) /
    2``. What the image has beyond that, with its sign, is summed by a Gaussian of two pixels as if it were a gradient:
    steps of one sign along a line add up, those of grit cancel, and so do the two sides of a piece that is no larger
    than grit. A seam is hard where the sum is over half of the texture's own strong edges, the 95th percentile of the
    same sum over the exemplar's gradient, along at least twelve pixels; and over what steps as large would come to by
    chance, were their signs random (its square 2.5 times that; of a straight seam it is 7 times).
    """
    if exemplar.ndim != 3 or min(exemplar.shape[:2]) < 2 * int(2 * _SIGMA_PX):
        raise ValueError(f"an exemplar is (rows, cols, channels) of 8 pixels a side or more, not {exemplar.shape}")
    if source.ndim != 2 or source.size == 0:
        raise ValueError(f"a source map is (rows, cols) and not empty, not {source.shape}")
    shape = (exemplar.shape[0], exemplar.shape[1])
    if int(source.min()) < 0 or int(source.max()) >= shape[0] * shape[1]:
        raise ValueError(f"the source map points outside an exemplar of {shape}")
    values = exemplar.astype(np.float64)
    shown = values.reshape(-1, values.shape[2])[source] if image is None else image.astype(np.float64)
    if shown.shape != (*source.shape, values.shape[2]):
        raise ValueError(f"image {shown.shape} and source map {source.shape} differ in shape, or channels in number")
    holds = np.ones(source.shape, dtype=bool) if known is None else known
    steps = [_unexplained(source, values, shown, holds, axis) for axis in (0, 1)]
    strength = _summed(steps)
    own = _summed([_padded(np.diff(values, axis=axis), axis) for axis in (0, 1)])
    border = int(2 * _SIGMA_PX)
    inner = own[border:-border, border:-border] if min(own.shape) > 2 * border else own
    strong = max(float(np.percentile(inner, _EDGE_PERCENTILE)), _LEAST_EDGE_DE76)
    return _lines((strength > _EDGE_SHARE * strong) & (strength**2 > _LEAST_COHERENCE * _by_chance(steps)))


def _by_chance(steps: list[Plane]) -> Plane:
    """Square of what `_summed` would come to on average if each step were as large, but of random sign."""
    # The squares of a Gaussian's weights are those of one narrower by the root of two, here with `_summed`'s scale.
    squares = np.sum([(of_axis**2).sum(axis=2) for of_axis in steps], axis=0)
    return np.asarray(ndimage.gaussian_filter(squares, _SIGMA_PX / math.sqrt(2), mode="constant") / 2)


def _lines(over: Mask) -> HardSeams:
    """Of what is over the limit, the pieces that are long enough."""
    labels, count = ndimage.label(over, np.ones((3, 3)))
    boxes = ndimage.find_objects(labels)
    extents = np.array([math.hypot(*(side.stop - side.start for side in box)) for box in boxes])
    kept = np.zeros(count + 1, dtype=bool)
    kept[1:] = extents >= _LEAST_EXTENT_PX
    where = np.asarray(kept[labels], dtype=bool)
    return HardSeams(
        share=float(where.mean()),
        count=int(np.count_nonzero(kept)),
        longest_px=float(extents[kept[1:]].max(initial=0.0)),
        where=where,
    )


def _unexplained(source: NDArray[np.int32], exemplar: Plane, image: Plane, known: Mask, axis: int) -> Plane:
    """Steps to the next pixel along an axis that the exemplar doesn't expect, (rows, cols, channels)."""
    rows, cols, channels = exemplar.shape
    before = tuple(slice(None, -1) if k == axis else slice(None) for k in (0, 1))
    after = tuple(slice(1, None) if k == axis else slice(None) for k in (0, 1))
    down, right = (1, 0) if axis == 0 else (0, 1)
    row, col = source[before] // cols + down, source[before] % cols + right
    ahead = (row < rows) & (col < cols)
    of_first = exemplar[np.minimum(row, rows - 1), np.minimum(col, cols - 1)]
    of_first -= exemplar.reshape(-1, channels)[source[before]]
    row, col = source[after] // cols - down, source[after] % cols - right
    behind = (row >= 0) & (col >= 0)
    of_second = exemplar.reshape(-1, channels)[source[after]] - exemplar[np.maximum(row, 0), np.maximum(col, 0)]
    # Where a piece ends with the exemplar, the other alone tells what to expect.
    sides = np.maximum(ahead.astype(np.int64) + behind, 1)[..., None]
    expected = (of_first * ahead[..., None] + of_second * behind[..., None]) / sides
    steps = image[after] - image[before] - expected
    steps[~(ahead | behind) | ~(known[before] & known[after])] = 0
    return _padded(steps, axis)


def _padded(steps: Plane, axis: int) -> Plane:
    """The steps with a last line of none, so that there is one at every pixel."""
    return np.pad(steps, [(0, 1) if k == axis else (0, 0) for k in range(3)])


def _summed(steps: list[Plane]) -> Plane:
    """Size of the steps of one sign around each pixel: a straight line of steps s has s on the line, (rows, cols)."""
    scale = math.sqrt(2 * math.pi) * _SIGMA_PX
    total = np.zeros(steps[0].shape[:2])
    for of_axis in steps:
        for channel in np.moveaxis(of_axis, 2, 0):
            total += (scale * ndimage.gaussian_filter(channel, _SIGMA_PX, mode="constant")) ** 2
    return np.sqrt(total)
