"""The solid of colours that a press reaches: its volume, slices through it, and pictures of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull, QhullError

from tilefab.pipeline.profile_tables import CheckedTables, Float64Array, srgb8
from tilefab.report.profile_view import GamutView, PlaneView, SolidView

REACHED_DELTA_E = 1.0
"""CIE76 within which a colour that comes back through the relative tables counts as reached."""

LEVELS = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
HUE_PLANES = (0.0, 45.0, 90.0, 135.0)
HUES = 36
_PITCH = 2.0
_MARGIN = 6.0
_PLANE = 181
_NEAR_HUE = 15.0
_VIEWS = ((35.0, 22.0, "from the yellow-red side"), (215.0, 22.0, "from the blue-green side"))
_PICTURE_PX = 300
_DEPTH_STEPS = 160
_WHITE = np.uint8(255)


def gamut(tables: CheckedTables, printable: Float64Array, sample: Float64Array, sample_name: str) -> GamutView:
    """Everything on the gamut that the sheet shows.

    Parameters
    ----------
    tables
        The profile.
    printable
        Relative Lab (M, 3) of mixtures of its inks within its limits.
    sample
        Relative Lab (S, 3) of colours to show against it; may be empty.
    sample_name
        What they are.
    """
    hull = _hull_volume(printable)
    if not tables.backward:
        return GamutView(None, hull, (), (), (), sample, sample_name)
    low, high = _box(printable)
    reached, axes = _voxels(tables, low, high)
    return GamutView(
        volume=float(reached.sum()) * _PITCH**3,
        hull_volume=hull,
        levels=tuple((level, _level(tables, level, low, high)) for level in LEVELS),
        hue_planes=tuple(_hue_plane(tables, hue, printable, sample) for hue in HUE_PLANES),
        solids=tuple(_solid(reached, axes, *view) for view in _VIEWS),
        sample=sample,
        sample_name=sample_name,
    )


def cusps(tables: CheckedTables, printable: Float64Array, hues: int = HUES) -> Float64Array:
    """Colour of the largest chroma at each of ``hues`` even steps of hue from 0 on: relative Lab (hues, 3)."""
    lightness = np.arange(2.0, 100.0, 2.0)
    chroma = np.arange(0.0, np.hypot(printable[:, 1], printable[:, 2]).max() + 2.0, 1.0)
    angle = 2.0 * np.pi * np.arange(hues) / hues
    hue, level, c = np.meshgrid(angle, lightness, chroma, indexing="ij")
    lab = np.stack([level, c * np.cos(hue), c * np.sin(hue)], axis=-1)
    inside = _error(tables, lab) < REACHED_DELTA_E
    flat = np.where(inside, c, -1.0).reshape(hues, -1)
    best = flat.argmax(axis=1)
    found = lab.reshape(hues, -1, 3)[np.arange(hues), best]
    found[flat.max(axis=1) < 0.0] = (50.0, 0.0, 0.0)
    return found


def _error(tables: CheckedTables, lab: Float64Array) -> Float64Array:
    """CIE76 between colours (..., 3) and what is printed for them: (...)."""
    flat = lab.reshape(-1, 3)
    return np.asarray(np.linalg.norm(tables.printed(flat) - flat, axis=1), dtype=np.float64).reshape(lab.shape[:-1])


def _box(printable: Float64Array) -> tuple[Float64Array, Float64Array]:
    low = np.floor((printable.min(axis=0) - _MARGIN) / _PITCH) * _PITCH
    high = np.ceil((printable.max(axis=0) + _MARGIN) / _PITCH) * _PITCH
    return low, high


def _voxels(
    tables: CheckedTables, low: Float64Array, high: Float64Array
) -> tuple[NDArray[np.bool_], tuple[Float64Array, Float64Array, Float64Array]]:
    """Which cells of a box (L*, a*, b*) the press reaches at their centres, and those centres along each axis."""
    l_axis, a_axis, b_axis = (
        np.arange(begin + _PITCH / 2.0, end, _PITCH) for begin, end in zip(low, high, strict=True)
    )
    a, b = np.meshgrid(a_axis, b_axis, indexing="ij")
    reached = np.empty((len(l_axis), *a.shape), dtype=np.bool_)
    for place, level in enumerate(l_axis):
        lab = np.stack([np.full(a.shape, level), a, b], axis=-1)
        reached[place] = _error(tables, lab) < REACHED_DELTA_E
    return reached, (l_axis, a_axis, b_axis)


def _hull_volume(points: Float64Array) -> float:
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0


def _level(tables: CheckedTables, level: float, low: Float64Array, high: Float64Array) -> PlaneView:
    a_axis, b_axis = np.linspace(low[1], high[1], _PLANE), np.linspace(low[2], high[2], _PLANE)
    a, b = np.meshgrid(a_axis, b_axis)
    error = _error(tables, np.stack([np.full(a.shape, level), a, b], axis=-1))
    outline = contour(error, a_axis, b_axis, REACHED_DELTA_E)
    corners = ((float(low[1]), float(low[2])), (float(high[1]), float(high[2])))
    return PlaneView(f"L* {level:g}", *corners, None, outline, np.zeros((0, 2)))


def _hue_plane(tables: CheckedTables, hue: float, printable: Float64Array, sample: Float64Array) -> PlaneView:
    most = float(np.hypot(printable[:, 1], printable[:, 2]).max()) + _MARGIN
    across, upward = np.linspace(-most, most, _PLANE), np.linspace(0.0, 100.0, _PLANE)
    c, level = np.meshgrid(across, upward)
    turn = np.radians(hue)
    lab = np.stack([level, c * np.cos(turn), c * np.sin(turn)], axis=-1)
    error = _error(tables, lab)
    picture = np.where((error < REACHED_DELTA_E)[..., np.newaxis], srgb8(lab), _WHITE)[::-1]
    chroma = np.hypot(sample[:, 1], sample[:, 2])
    off = (np.degrees(np.arctan2(sample[:, 2], sample[:, 1])) - hue + 90.0) % 180.0 - 90.0
    near = np.abs(off) < _NEAR_HUE
    side = sample[:, 1] * np.cos(turn) + sample[:, 2] * np.sin(turn)
    points = np.stack([np.copysign(chroma, side), sample[:, 0]], axis=1)[near]
    title = f"hue {hue:g}° to the right, {hue + 180.0:g}° to the left"
    outline = contour(error, across, upward, REACHED_DELTA_E)
    return PlaneView(title, (-most, 0.0), (most, 100.0), np.ascontiguousarray(picture), outline, points)


def contour(values: Float64Array, across: Float64Array, upward: Float64Array, level: float) -> Float64Array:
    """Line pieces along which a field crosses a level: each cell of the grid is cut into two triangles.

    Parameters
    ----------
    values
        (U, A) values at the nodes.
    across, upward
        Coordinates (A,) and (U,) of the nodes.
    level
        Value to follow.

    Returns
    -------
    numpy.ndarray
        (S, 4): x0, y0, x1, y1 of each piece, in no order.
    """
    x, y = np.meshgrid(across, upward)
    nodes = np.stack([x, y, values - level], axis=-1)
    lower_left, lower_right = nodes[:-1, :-1].reshape(-1, 3), nodes[:-1, 1:].reshape(-1, 3)
    upper_left, upper_right = nodes[1:, :-1].reshape(-1, 3), nodes[1:, 1:].reshape(-1, 3)
    triangles = np.concatenate(
        [
            np.stack([lower_left, lower_right, upper_right], axis=1),
            np.stack([lower_left, upper_right, upper_left], axis=1),
        ]
    )
    inside = triangles[:, :, 2] < 0.0
    cut = triangles[inside.any(axis=1) & ~inside.all(axis=1)]
    inside = cut[:, :, 2] < 0.0
    # The corner that is alone on its side of the level is where both cut edges meet.
    alone = np.where(inside.sum(axis=1) == 1, inside.argmax(axis=1), (~inside).argmax(axis=1))
    rows = np.arange(len(cut))
    tip = cut[rows, alone]
    ends = []
    for turn in (1, 2):
        other = cut[rows, (alone + turn) % 3]
        share = tip[:, 2] / (tip[:, 2] - other[:, 2])
        ends.append(tip[:, :2] + share[:, np.newaxis] * (other[:, :2] - tip[:, :2]))
    return np.concatenate(ends, axis=1)


def _solid(
    reached: NDArray[np.bool_],
    axes: tuple[Float64Array, Float64Array, Float64Array],
    azimuth: float,
    height: float,
    title: str,
) -> SolidView:
    """The solid in parallel projection: the first place along each ray that is inside, lit from above and the left."""
    if not reached.any():
        return SolidView(title, None)
    solid = gaussian_filter(np.pad(reached, 2).astype(np.float32), 0.8)
    first = np.array([axis[0] for axis in axes]) - 2.0 * _PITCH
    turn, tilt = np.radians(azimuth), np.radians(height)
    to_eye = np.array([np.sin(tilt), np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn)])
    right = np.array([0.0, -np.sin(turn), np.cos(turn)])
    up = np.cross(to_eye, right)
    up *= np.sign(up[0])
    inside = np.argwhere(reached) * _PITCH + np.array([axis[0] for axis in axes])
    middle = (inside.min(axis=0) + inside.max(axis=0)) / 2.0
    reach = 0.54 * max(float(np.ptp(inside @ right)), float(np.ptp(inside @ up)))
    depth = float(np.linalg.norm(inside.max(axis=0) - inside.min(axis=0))) / 2.0 + _PITCH
    steps = np.linspace(-reach, reach, _PICTURE_PX)
    x, y = np.meshgrid(steps, steps[::-1])
    base = middle + x[..., np.newaxis] * right + y[..., np.newaxis] * up
    surface = np.full((*x.shape, 3), np.nan)
    before = np.zeros(x.shape)
    pending = np.ones(x.shape, dtype=np.bool_)
    distances = np.linspace(depth, -depth, _DEPTH_STEPS)
    for distance in distances:
        rows, cols = np.nonzero(pending)
        place = base[rows, cols] + distance * to_eye
        value = map_coordinates(solid, ((place - first) / _PITCH).T, order=1, mode="constant")
        hit = value >= 0.5
        back = (value[hit] - 0.5) / np.maximum(value[hit] - before[rows[hit], cols[hit]], 1e-6)
        stride = distances[0] - distances[1]
        surface[rows[hit], cols[hit]] = place[hit] + (back * stride)[:, np.newaxis] * to_eye
        before[rows, cols] = value
        pending[rows[hit], cols[hit]] = False
    shown = ~pending
    slopes = np.stack(np.gradient(gaussian_filter(np.pad(reached, 2).astype(np.float32), 1.6)), axis=0)
    at = ((surface[shown] - first) / _PITCH).T
    normal = -np.stack([map_coordinates(slope, at, order=1, mode="nearest") for slope in slopes], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    light = to_eye + 0.7 * up - 0.5 * right
    shade = 0.62 + 0.38 * np.clip(normal @ (light / np.linalg.norm(light)), 0.0, 1.0)
    picture = np.full((*x.shape, 3), _WHITE)
    colours = srgb8(np.clip(surface[shown], [0.0, -128.0, -128.0], [100.0, 127.0, 127.0]))
    picture[shown] = np.rint(colours * shade[:, np.newaxis]).astype(np.uint8)
    return SolidView(title, picture)
