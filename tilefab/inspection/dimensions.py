"""Size and shape of a tile from its outline in an image, in the terms of ISO 10545-2:2018.

The standard puts studs and gauges against a tile's sides 5 mm from its corners, and in the middle of a side for its
straightness. Here these places are read from the outline: points where brightness passes half way between belt and
tile, each a fraction of a pixel exact, and short lines through those near each place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.records import TileDimensions
from tilefab.types import FloatImage, Mask, SizeMm

Float64Array = NDArray[np.float64]

STUD_MM = 5.0
"""How far from the corners the standard measures."""

_REACH_MM, _LEAST_REACH_PX = 2.5, 5.0
_STEP_PX = 0.25
_NEAR_STEPS, _FAR_STEPS = np.arange(6, 11), np.arange(11, 17)
# The whole line to the edge would be 1.45 of the difference; half of it makes less noise of a lively stone.
_TO_EDGE = 0.7
_LEVEL_SHARE = 0.35
_PROFILES_MM, _LEAST_PROFILES, _BELT_PROFILES = 3.0, 5, 41
_CONTRAST_SPREADS, _LEAST_CONTRAST, _SURE_CONTRAST = 8.0, 0.003, 0.02
_WINDOW_MM, _LEAST_WINDOW_POINTS = 3.0, 10
_LEAST_SIDE_POINTS = 0.75
_LEAST_NEAR_POINTS = 0.5
_MOST_ROUGH_PX = 1.0
_ROUNDS = 6
_MAD = 1.4826
_LEAST_SIDE_MM = 4.0 * STUD_MM


@dataclass(frozen=True, eq=False)
class _Side:
    """Edge points of a side, in image pixels.

    Attributes
    ----------
    start, along, outward
        (2,): a corner, and unit vectors along the side, clockwise round the tile, and away from the tile.
    length
        Between the corners.
    place, offset
        (P,): how far along, and how far outwards of the straight line between the corners, each good point lies; one is
        looked for at every pixel.
    """

    start: Float64Array
    along: Float64Array
    outward: Float64Array
    length: float
    place: Float64Array
    offset: Float64Array

    def at(self, place: float, window_px: float) -> Float64Array | None:
        """The outline's point (2,) at a place along the side; None if it's hidden or broken there."""
        near = np.abs(self.place - place) <= window_px
        if near.sum() < max(_LEAST_WINDOW_POINTS, _LEAST_NEAR_POINTS * 2.0 * window_px):
            return None
        fit = _line(self.place[near] - place, self.offset[near])
        return None if fit is None else self.start + place * self.along + fit * self.outward


def measure_dimensions(
    xyz: FloatImage, corners_px: NDArray[np.floating], mask: Mask, size_mm: SizeMm, px_per_mm: float | None
) -> TileDimensions | None:
    """Dimensions of a tile that lies flat, seen straight from above.

    Parameters
    ----------
    xyz
        (R, C, 3) float32: XYZ of the image, linear light.
    corners_px
        (4, 2): outline's corners (x, y), those of the face's upper left, upper right, lower right and lower left
        corner; good to some millimetre.
    mask
        (R, C) bool: pixels that show the tile.
    size_mm
        Work size.
    px_per_mm
        The camera's calibration; ``None``: sizes are relative to the work size, of which the mean of both is right.

    Returns
    -------
    TileDimensions or None
        None if a side is hidden or broken where it has to be measured, doesn't stand out from the belt, or is
        shorter than 20 mm.

    Raises
    ------
    ValueError
        If shapes don't fit, or a resolution or size isn't more than 0.

    References
    ----------
    ISO 10545-2:2018, clauses on length and width, straightness of sides, and rectangularity.
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if xyz.ndim != 3 or xyz.shape[2] != 3 or xyz.dtype != np.float32 or mask.shape != xyz.shape[:2]:
        raise ValueError(
            f"xyz must be float32 (rows, cols, 3) with its mask, not {xyz.dtype} {xyz.shape}, {mask.shape}"
        )
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise ValueError(f"corners must be 4 finite places (x, y), but are {corners.tolist()}")
    if not (min(size_mm.width, size_mm.height) > 0.0 and (px_per_mm is None or px_per_mm > 0.0)):
        raise ValueError(f"size {size_mm} and {px_per_mm} pixels a millimetre must be more than 0")
    if min(size_mm.width, size_mm.height) < _LEAST_SIDE_MM:
        return None
    lengths = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    work = np.array([size_mm.width, size_mm.height, size_mm.width, size_mm.height])
    rough_px_per_mm = px_per_mm or float((lengths / work).mean())
    # Half way between belt and tile means an edge where it is only in linear light.
    light = np.ascontiguousarray(xyz[:, :, 1])
    sides = [_side(light, mask, corners[k], corners[(k + 1) % 4], rough_px_per_mm) for k in range(4)]
    found = [side for side in sides if side is not None]
    if len(found) < 4:
        return None
    return _dimensions(found, _squared_corners(found), size_mm, rough_px_per_mm, px_per_mm)


def _side(light: NDArray[np.float32], mask: Mask, start: Float64Array, end: Float64Array, scale: float) -> _Side | None:
    """Edge points along the line between two corners; None if too few."""
    length = float(np.hypot(*(end - start)))
    if length < 4.0 * STUD_MM * scale:
        return None
    along = (end - start) / length
    outward = np.array([along[1], -along[0]])
    reach = max(_REACH_MM * scale, _LEAST_REACH_PX)
    across = np.arange(-reach, reach + _STEP_PX / 2, _STEP_PX)
    down = np.arange(1.0, length, 1.0)
    points = start + down[:, np.newaxis, np.newaxis] * along + across[:, np.newaxis] * outward
    coordinates = [points[..., 1] - 0.5, points[..., 0] - 0.5]
    # Beyond the image's border its border goes on: belt, if any is seen there.
    level = ndimage.map_coordinates(light, coordinates, order=1, mode="nearest")
    tile = ndimage.map_coordinates(mask.astype(np.float32), coordinates, order=1, mode="nearest")
    outer = max(2, round(_LEVEL_SHARE * len(across) / 2))
    with_belt = (tile[:, -outer:] < 0.5).all(axis=1) & (tile[:, :outer] > 0.5).all(axis=1)
    if with_belt.mean() < _LEAST_SIDE_POINTS:
        return None
    # Single profiles meet whatever stone there is; the mean of many knows the edge better.
    profiles = max(_LEAST_PROFILES, round(_PROFILES_MM * scale))
    down, level = down[with_belt], ndimage.uniform_filter1d(level[with_belt], profiles, axis=0, mode="nearest")
    belt = ndimage.uniform_filter1d(level[:, -outer:].mean(axis=1), _BELT_PROFILES, mode="nearest")
    level -= belt[:, np.newaxis]
    # What is seen of an even belt is that dark stone begins there; of a rough one it isn't.
    rises = float(np.clip(_CONTRAST_SPREADS * level[:, -outer:].std(), _LEAST_CONTRAST, _SURE_CONTRAST))
    # The tile's brightness at its edge, not further in, where the stone may be another one.
    inner = _inside_level(level, rises)
    part = level / np.where(inner > rises, inner, np.nan)[:, np.newaxis]
    below = part < 0.5
    # The last place, going outwards, that is still tile.
    last = part.shape[1] - 1 - np.argmax(~below[:, ::-1], axis=1)
    good = np.isfinite(part).all(axis=1) & ~below.all(axis=1) & (last < part.shape[1] - 1)
    if good.sum() < _LEAST_SIDE_POINTS * math.floor(length):
        return None
    row, col = np.flatnonzero(good), last[good]
    before, after = part[row, col], part[row, col + 1]
    offset = across[col] + (before - 0.5) / (before - after) * _STEP_PX
    return _Side(start, along, outward, length, down[good], offset)


def _inside_level(level: Float64Array, rises: float) -> Float64Array:
    """How much brighter than the belt (P,) the tile is at its edge, from profiles (P, S) of that.

    It is what two places further in say, which the camera's blur doesn't reach, for the stone may change from there to
    the edge.
    """
    # From the belt inwards, what rises first is the tile, however dark; half of what it rises to is its edge.
    risen = level.shape[1] - 1 - np.argmax((level >= rises)[:, ::-1], axis=1)
    rough = np.take_along_axis(level, np.clip(risen[:, np.newaxis] - _FAR_STEPS, 0, None), axis=1).mean(axis=1)
    last = level.shape[1] - 1 - np.argmax((level >= 0.5 * rough[:, np.newaxis])[:, ::-1], axis=1)
    near, far = (
        np.take_along_axis(level, np.clip(last[:, np.newaxis] - steps, 0, level.shape[1] - 1), axis=1).mean(axis=1)
        for steps in (_NEAR_STEPS, _FAR_STEPS)
    )
    return np.asarray(near + _TO_EDGE * (near - far), dtype=np.float64)


def _line(place: Float64Array, offset: Float64Array) -> float | None:
    """Value at 0 of the robust straight line through points; None if they scatter too much to be an edge."""
    kept = np.ones(len(place), dtype=bool)
    value = slope = 0.0
    for _ in range(_ROUNDS):
        slope, value = (float(number) for number in np.polyfit(place[kept], offset[kept], 1))
        away = np.abs(offset - value - slope * place)
        most = max(3.0 * _MAD * float(np.median(away)), 0.02)
        kept = away <= most
        if kept.sum() < _LEAST_WINDOW_POINTS:
            return None
    return value if _MAD * float(np.median(away)) <= _MOST_ROUGH_PX else None


def _squared_corners(sides: list[_Side]) -> Float64Array:
    """Corners (4, 2) where robust lines along neighbouring sides meet; corner k begins side k."""
    lines = []
    for side in sides:
        kept = np.ones(len(side.place), dtype=bool)
        slope = value = 0.0
        for _ in range(_ROUNDS):
            slope, value = (float(number) for number in np.polyfit(side.place[kept], side.offset[kept], 1))
            away = np.abs(side.offset - value - slope * side.place)
            kept = away <= max(3.0 * _MAD * float(np.median(away)), 0.02)
        lines.append((side.start + value * side.outward, side.along + slope * side.outward))
    out = np.empty((4, 2))
    for place in range(4):
        (one, one_way), (other, other_way) = lines[place - 1], lines[place]
        steps = np.linalg.solve(np.column_stack([one_way, -other_way]), other - one)
        out[place] = one + steps[0] * one_way
    return out


def _dimensions(
    sides: list[_Side], corners: Float64Array, size_mm: SizeMm, rough: float, px_per_mm: float | None
) -> TileDimensions | None:
    """What the standard wants, from the outline near its places."""
    stud, window = STUD_MM * rough, _WINDOW_MM * rough
    studs = np.empty((4, 2, 2))
    middles = np.empty((4, 2))
    for place, side in enumerate(sides):
        ends = [float((corners[k] - side.start) @ side.along) for k in (place, (place + 1) % 4)]
        one = side.at(ends[0] + stud, window)
        other = side.at(ends[1] - stud, window)
        middle = side.at((ends[0] + ends[1]) / 2.0, window)
        if one is None or other is None or middle is None:
            return None
        studs[place], middles[place] = (one, other), middle
    work = np.array([size_mm.width, size_mm.height, size_mm.width, size_mm.height])
    # A side is as long as the tile is across, 5 mm inside of it: from the one neighbour's stud to the other's.
    lengths = np.array([np.hypot(*(studs[(k + 1) % 4, 0] - studs[(k - 1) % 4, 1])) for k in range(4)])
    scale = px_per_mm or float((lengths / work).mean())
    sides_mm = lengths / scale
    width, height = (sides_mm[0] + sides_mm[2]) / 2.0, (sides_mm[1] + sides_mm[3]) / 2.0
    size = [100.0 * (width / size_mm.width - 1.0), 100.0 * (height / size_mm.height - 1.0)]
    bows, angles = np.empty(4), np.empty((4, 2))
    for place in range(4):
        first, second = studs[place]
        way = (second - first) / np.hypot(*(second - first))
        outward = np.array([way[1], -way[0]])
        bows[place] = (middles[place] - first) @ outward / scale
        # Held against this side, the neighbours' far studs are off the right angle through their near ones.
        before, after = studs[(place - 1) % 4], studs[(place + 1) % 4]
        angles[place, 0] = (before[0] - before[1]) @ -way / scale
        angles[place, 1] = (after[1] - after[0]) @ way / scale
    bow = int(np.argmax(np.abs(bows)))
    tilt = np.unravel_index(int(np.argmax(np.abs(angles))), angles.shape)
    neighbour = (int(tilt[0]) + (1 if tilt[1] else -1)) % 4
    return TileDimensions(
        sides_mm=(float(sides_mm[0]), float(sides_mm[1]), float(sides_mm[2]), float(sides_mm[3])),
        width_mm=float(width),
        height_mm=float(height),
        size_deviation_percent=float(max(size, key=abs)),
        straightness_mm=float(bows[bow]),
        straightness_percent=float(100.0 * bows[bow] / work[bow]),
        rectangularity_mm=float(angles[tilt]),
        rectangularity_percent=float(100.0 * angles[tilt] / work[neighbour]),
        scale_known=px_per_mm is not None,
    )
