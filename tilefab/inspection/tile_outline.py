"""A tile's outline on a coarse mask of all that isn't belt: a turned rectangle, also where sides of it are missing."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.records import ImageProblem
from tilefab.types import Mask, SizeMm

MOST_SIZE_ERROR = 0.04
"""A tile that differs by more than this share from its size is another tile."""

VEIN_CELLS = 5
"""Up to twice as wide, what looks like the belt may be a vein of the stone."""

Float64Array = NDArray[np.float64]

_LEAST_PIECE = 0.004
_LEAST_TILE = 0.04
_SECOND_TILE = 0.08
_LEAST_SIDE_SEEN = 0.1
_LEAST_SIDE_CELLS = 8
_WHOLE_SIDE = 0.6
_SIZE_SCATTER = 0.008
_COARSE_STEP_DEG, _FINE_STEP_DEG = 1.5, 0.25
_COARSE_BIN, _FINE_BIN = 4.0, 1.5
_TRIED_ANGLES = 3


@dataclass(frozen=True)
class TurnedBox:
    """A rectangle turned by an angle: lines at distances along two axes, in cells.

    ``low`` and ``high`` are of the axes across (x) and down (y) in the turned frame; ``seen`` are shares of sides that
    lie on their lines: left, upper, right, lower.
    """

    angle_rad: float
    low: tuple[float, float]
    high: tuple[float, float]
    seen: tuple[float, float, float, float]


@dataclass(frozen=True)
class SizedBox:
    """A box whose unseen sides are where the size puts them; see `TurnedBox` and `FoundTile`.

    ``cut`` is a side, counted from the upper one clockwise, that was seen too near to its opposite for the tile's size:
    a break, or if it is straight, the edge of another tile.
    """

    box: TurnedBox
    known: tuple[bool, bool, bool, bool]
    across: bool
    px_per_mm: float
    cut: tuple[int, TurnedBox] | None


def tile_outline(differs: Mask, size_mm: SizeMm, scale: float | None) -> SizedBox | ImageProblem:
    """The tile's rectangle on cells, from all that differs from the belt.

    Parameters
    ----------
    differs
        bool (rows, cols): cells that aren't belt.
    size_mm
        Size of the finished tile.
    scale
        Cells a millimetre, if known.
    """
    clean = ndimage.binary_opening(differs, np.ones((3, 3)))
    # Veins of the belt's own colour may run through the stone: what lies close by hangs together.
    near = ndimage.uniform_filter(clean.astype(np.float32), 2 * VEIN_CELLS + 1, mode="constant") > 1e-6
    labels, count = ndimage.label(near)
    labels *= clean
    areas = np.bincount(labels.ravel(), minlength=count + 1)
    areas[0] = 0
    if count == 0 or areas.max() < _LEAST_TILE * differs.size:
        return ImageProblem.NO_TILE
    large = np.flatnonzero(areas >= _LEAST_PIECE * differs.size)
    problem = ImageProblem.NO_TILE
    # A dark thing across a tile leaves pieces of it: all pieces together are tried before the largest alone.
    for parts in [large] if len(large) == 1 else [large, np.array([areas.argmax()])]:
        piece = np.isin(labels, parts)
        box = _box(piece)
        sized = ImageProblem.NO_TILE if box is None else _sized(box, size_mm, scale)
        if isinstance(sized, ImageProblem):
            problem = sized
            continue
        if len(parts) > 1 and scale is None and not all(sized.known):
            continue
        inside = within_corners(box_corners(sized.box), differs.shape, 2.0)
        within = np.bincount(labels[inside], minlength=count + 1)
        outside = areas - within
        if outside.max() >= _SECOND_TILE * inside.sum():
            problem = ImageProblem.TWO_TILES
            continue
        return sized
    if problem is ImageProblem.WRONG_SIZE and _two(areas):
        return ImageProblem.TWO_TILES
    return problem


def _two(areas: NDArray[np.int64]) -> bool:
    """Whether there are two pieces of like size."""
    first, second = np.sort(areas)[::-1][:2]
    return bool(second >= 0.5 * first)


def _box(piece: Mask) -> TurnedBox | None:
    """The turned rectangle that most points of a shape's outline lie on."""
    x, y = _outline_points(piece)
    if len(x) < 4 * _LEAST_SIDE_CELLS:
        return None
    # A ragged break can look straighter than a side from afar, but not from near.
    coarse = np.radians(np.arange(-45.0, 45.0, _COARSE_STEP_DEG))
    scores = _scores(x, y, coarse, _COARSE_BIN)
    around = np.maximum(np.roll(scores, 1), np.roll(scores, -1))
    peaks = np.flatnonzero(scores >= around)
    best = peaks[np.argsort(-scores[peaks], kind="stable")[:_TRIED_ANGLES]]
    fine = np.radians(np.arange(-_COARSE_STEP_DEG, _COARSE_STEP_DEG + 1e-9, _FINE_STEP_DEG))
    tried = (coarse[best][:, np.newaxis] + fine).ravel()
    fitted = _scores(x, y, tried, _FINE_BIN).reshape(len(best), -1)
    angles = tried.reshape(len(best), -1)[np.arange(len(best)), fitted.argmax(axis=1)]
    boxes = [box for box in (_box_at(x, y, float(angle)) for angle in angles) if box is not None]
    # Four sides, each seen in part, tell more than one long straight break.
    return max(boxes, key=lambda box: sum(min(share, 1.0) for share in box.seen), default=None)


def _box_at(x: Float64Array, y: Float64Array, angle: float) -> TurnedBox | None:
    """The box at an angle that an outline's points gather on; None if it has no size."""
    angle = (angle + math.pi / 4) % (math.pi / 2) - math.pi / 4
    low, high, seen = [], [], []
    for along in _turned(x, y, angle):
        counts, places = _peaks(along, _FINE_BIN)
        near = [np.abs(along - place) <= _FINE_BIN for place in places]
        places = [float(np.median(along[one])) if one.any() else place for one, place in zip(near, places, strict=True)]
        low.append(places[0])
        high.append(places[1])
        seen.append(counts)
    wide, tall = high[0] - low[0], high[1] - low[1]
    if min(wide, tall) < _LEAST_SIDE_CELLS:
        return None
    shares = (seen[0][0] / tall, seen[1][0] / wide, seen[0][1] / tall, seen[1][1] / wide)
    return TurnedBox(angle, (low[0], low[1]), (high[0], high[1]), shares)


def _scores(x: Float64Array, y: Float64Array, angles: Float64Array, width: float) -> Float64Array:
    """For each angle, how well an outline's points gather on four lines."""
    counts = np.array([[_peaks(along, width)[0] for along in _turned(x, y, float(angle))] for angle in angles])
    return np.asarray((counts**2).sum(axis=(1, 2)), dtype=np.float64)


def _turned(x: Float64Array, y: Float64Array, angle: float) -> tuple[Float64Array, Float64Array]:
    """Places of points along two axes turned by an angle."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x + sin * y, cos * y - sin * x


def _peaks(along: Float64Array, width: float) -> tuple[Float64Array, list[float]]:
    """Where most points lie in the lower and in the upper half of an axis: how many, (2,), and where."""
    start = float(along.min()) - 0.5 * width
    counts = np.bincount(((along - start) / width).astype(np.int64), minlength=3).astype(np.float64)
    # A line may run along the limit between two bins.
    counts[:-1] += counts[1:]
    half = max(1, len(counts) // 2)
    low, high = int(np.argmax(counts[:half])), half + int(np.argmax(counts[half:]))
    return counts[[low, high]], [start + (low + 1.0) * width, start + (high + 1.0) * width]


def _outline_points(piece: Mask) -> tuple[Float64Array, Float64Array]:
    """First and last cell of each row and each column, as points on the cells' outer edges."""
    rows, cols = np.flatnonzero(piece.any(axis=1)), np.flatnonzero(piece.any(axis=0))
    left, right = piece[rows].argmax(axis=1), piece.shape[1] - piece[rows, ::-1].argmax(axis=1)
    upper, lower = piece[:, cols].argmax(axis=0), piece.shape[0] - piece[::-1, cols].argmax(axis=0)
    x = np.concatenate([left, right, cols + 0.5, cols + 0.5])
    y = np.concatenate([rows + 0.5, rows + 0.5, upper, lower])
    # What is cut off by the image's border has no side there.
    within = (x > 0) & (y > 0) & (x < piece.shape[1]) & (y < piece.shape[0])
    return x[within].astype(np.float64), y[within].astype(np.float64)


def _sized(box: TurnedBox, size_mm: SizeMm, scale: float | None) -> SizedBox | ImageProblem:
    """The box with sides that weren't seen put where the size says; ``scale`` in cells per millimetre."""
    results = [_sized_as(box, size_mm, scale, across) for across in (False, True)]
    if size_mm.width == size_mm.height:
        results = results[:1]
    fitting = [(error, sized) for error, sized in results if sized is not None]
    if not fitting:
        seen = sum(share >= _WHOLE_SIDE for share in box.seen)
        return ImageProblem.WRONG_SIZE if seen >= 3 else ImageProblem.NO_TILE
    return min(fitting, key=lambda pair: pair[0])[1]


def _sized_as(box: TurnedBox, size_mm: SizeMm, scale: float | None, across: bool) -> tuple[float, SizedBox | None]:
    """Fit of a box to the tile lying one way: its error, and the sized box; None if it can't be."""
    wanted = (size_mm.height, size_mm.width) if across else (size_mm.width, size_mm.height)
    known = [share >= _LEAST_SIDE_SEEN for share in box.seen]
    extent = [box.high[axis] - box.low[axis] for axis in range(2)]
    scales = [extent[axis] / wanted[axis] if known[axis] and known[axis + 2] else 0.0 for axis in range(2)]
    cut = None
    for axis in range(2):
        if scales[axis] == 0.0:
            continue
        # A side that is too near, and of which little is seen, is no side but where the tile is broken.
        most = scales[1 - axis] if scales[1 - axis] > 0.0 else scale if scale is not None else 0.0
        slack = _SIZE_SCATTER if scales[1 - axis] > 0.0 else MOST_SIZE_ERROR
        weaker = axis if box.seen[axis] < box.seen[axis + 2] else axis + 2
        short = scales[axis] < (1.0 - MOST_SIZE_ERROR) * most
        if short or (scales[axis] < (1.0 - slack) * most and box.seen[weaker] < _WHOLE_SIDE):
            known[weaker] = False
            scales[axis] = 0.0
            if short and box.seen[weaker] >= _WHOLE_SIDE:
                cut = ((weaker + 3) % 4, box)
    good = [value for value in scales if value > 0.0]
    if not good and scale is None:
        return math.inf, None
    own = float(np.mean(good)) if good or scale is None else scale
    if scale is not None and abs(own / scale - 1.0) > MOST_SIZE_ERROR:
        return math.inf, None
    low, high, error = list(box.low), list(box.high), 0.0
    for axis in range(2):
        length = own * wanted[axis]
        if known[axis] and known[axis + 2]:
            if abs(scales[axis] / own - 1.0) > MOST_SIZE_ERROR / 2.0:
                return math.inf, None
        elif known[axis]:
            high[axis] = low[axis] + length
        elif known[axis + 2]:
            low[axis] = high[axis] - length
        else:
            return math.inf, None
        if extent[axis] > (1.0 + MOST_SIZE_ERROR) * length + 2.0:
            return math.inf, None
        error += abs(1.0 - extent[axis] / length)
    four = (bool(known[1]), bool(known[2]), bool(known[3]), bool(known[0]))
    return error, SizedBox(
        TurnedBox(box.angle_rad, (low[0], low[1]), (high[0], high[1]), box.seen), four, across, own, cut
    )


def box_corners(box: TurnedBox) -> Float64Array:
    """Corners (4, 2) of a box, clockwise from its upper left one."""
    cos, sin = math.cos(box.angle_rad), math.sin(box.angle_rad)
    along = np.array(
        [(box.low[0], box.low[1]), (box.high[0], box.low[1]), (box.high[0], box.high[1]), (box.low[0], box.high[1])]
    )
    return np.stack([cos * along[:, 0] - sin * along[:, 1], sin * along[:, 0] + cos * along[:, 1]], axis=-1)


def within_corners(corners: Float64Array, shape: tuple[int, ...], more: float = 0.0) -> Mask:
    """Cells or pixels whose middle lies within a clockwise quadrilateral, or up to ``more`` outside."""
    x = np.arange(shape[1], dtype=np.float32) + np.float32(0.5)
    y = (np.arange(shape[0], dtype=np.float32) + np.float32(0.5))[:, np.newaxis]
    out = np.ones(shape[:2], dtype=np.bool_)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-9)
        level = float(along[1] * start[0] - along[0] * start[1]) + more
        out &= np.float32(along[0]) * y - np.float32(along[1]) * x + np.float32(level) >= 0.0
    return out
