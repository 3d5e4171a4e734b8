"""The solid of colours that a press reaches: its volume, slices through it, and pictures of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.pipeline.profile_solid import EDGE, Solid
from tilefab.pipeline.profile_tables import CheckedTables, Float64Array, srgb8
from tilefab.report.profile_view import GamutView, PlaneView, SolidView

REACHED_DELTA_E = 1.0
"""CIE76 within which a colour that comes back through the relative tables counts as reached."""

LEVELS = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
HUE_PLANES = (0.0, 45.0, 90.0, 135.0)
HUES = 36
_MARGIN = 6.0
_PLANE = 181
_NEAR_HUE = 15.0
_VIEWS = ((35.0, 22.0, "from the yellow-red side"), (215.0, 22.0, "from the blue-green side"))
_PICTURE_PX = 300
_RAY_STEP = 1.0
_FAINT = 0.1
_WHITE = np.uint8(255)


def gamut(tables: CheckedTables, solid: Solid, sample: Float64Array, sample_name: str) -> GamutView:
    """Everything on the gamut that the sheet shows.

    Parameters
    ----------
    tables
        The profile.
    solid
        Colours that its inks can mix.
    sample
        Relative Lab (S, 3) of colours to show against it; may be empty.
    sample_name
        What they are.
    """
    inside = solid.cells()
    reached = _reached(tables, inside) if tables.backward and len(inside) else None
    return GamutView(
        volume=solid.volume,
        hull_volume=solid.hull_volume,
        share_reached=None if reached is None else float(reached.mean()),
        levels=tuple((level, _level(solid, level, inside)) for level in LEVELS),
        hue_planes=tuple(_hue_plane(tables, solid, hue, inside, sample) for hue in HUE_PLANES),
        solids=tuple(_picture(solid, inside, *view) for view in _VIEWS),
        sample=sample,
        sample_name=sample_name,
    )


def cusps(solid: Solid, hues: int = HUES) -> Float64Array:
    """Colour of the largest chroma at each of ``hues`` even steps of hue from 0 on: relative Lab (hues, 3)."""
    inside = solid.cells()
    most = float(np.hypot(inside[:, 1], inside[:, 2]).max()) + solid.pitch if len(inside) else solid.pitch
    turn = 2.0 * np.pi * np.arange(hues) / hues
    hue, level, c = np.meshgrid(turn, np.arange(2.0, 100.0, 2.0), np.arange(0.0, most, 1.0), indexing="ij")
    lab = np.stack([level, c * np.cos(hue), c * np.sin(hue)], axis=-1)
    flat = np.where(solid.at(lab) >= EDGE, c, -1.0).reshape(hues, -1)
    found = lab.reshape(hues, -1, 3)[np.arange(hues), flat.argmax(axis=1)]
    found[flat.max(axis=1) < 0.0] = (50.0, 0.0, 0.0)
    return np.asarray(found, dtype=np.float64)


def _reached(tables: CheckedTables, lab: Float64Array) -> NDArray[np.bool_]:
    """Whether colours (..., 3) come back through the relative tables within 1 (CIE76): (...)."""
    flat = lab.reshape(-1, 3)
    off = np.linalg.norm(tables.printed(flat) - flat, axis=1)
    return np.asarray(off < REACHED_DELTA_E, dtype=np.bool_).reshape(lab.shape[:-1])


def _level(solid: Solid, level: float, inside: Float64Array) -> PlaneView:
    if not len(inside):
        return PlaneView(f"L* {level:g}", (-1.0, -1.0), (1.0, 1.0), None, np.zeros((0, 4)), np.zeros((0, 2)))
    low, high = inside.min(axis=0) - _MARGIN, inside.max(axis=0) + _MARGIN
    a_axis, b_axis = np.linspace(low[1], high[1], _PLANE), np.linspace(low[2], high[2], _PLANE)
    a, b = np.meshgrid(a_axis, b_axis)
    field = solid.at(np.stack([np.full(a.shape, level), a, b], axis=-1))
    corners = ((float(low[1]), float(low[2])), (float(high[1]), float(high[2])))
    return PlaneView(f"L* {level:g}", *corners, None, contour(-field, a_axis, b_axis, -EDGE), np.zeros((0, 2)))


def _hue_plane(
    tables: CheckedTables, solid: Solid, hue: float, inside: Float64Array, sample: Float64Array
) -> PlaneView:
    most = float(np.hypot(inside[:, 1], inside[:, 2]).max()) + _MARGIN if len(inside) else 10.0
    across, upward = np.linspace(-most, most, _PLANE), np.linspace(0.0, 100.0, _PLANE)
    c, level = np.meshgrid(across, upward)
    turn = np.radians(hue)
    lab = np.stack([level, c * np.cos(turn), c * np.sin(turn)], axis=-1)
    field = solid.at(lab)
    picture: NDArray[np.uint8] | None = None
    if tables.backward:
        shown = _reached(tables, lab) & (field > _FAINT)
        picture = np.ascontiguousarray(np.where(shown[..., np.newaxis], srgb8(lab), _WHITE)[::-1])
    chroma = np.hypot(sample[:, 1], sample[:, 2])
    off = (np.degrees(np.arctan2(sample[:, 2], sample[:, 1])) - hue + 90.0) % 180.0 - 90.0
    near = np.abs(off) < _NEAR_HUE
    side = sample[:, 1] * np.cos(turn) + sample[:, 2] * np.sin(turn)
    points = np.stack([np.copysign(chroma, side), sample[:, 0]], axis=1)[near]
    title = f"hue {hue:g}° to the right, {hue + 180.0:g}° to the left"
    return PlaneView(title, (-most, 0.0), (most, 100.0), picture, contour(-field, across, upward, -EDGE), points)


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


def _picture(solid: Solid, inside: Float64Array, azimuth: float, height: float, title: str) -> SolidView:
    """The solid in parallel projection: the first place along each ray that is inside, lit from above and the left."""
    if not len(inside):
        return SolidView(title, None)
    turn, tilt = np.radians(azimuth), np.radians(height)
    to_eye = np.array([np.sin(tilt), np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn)])
    right = np.array([0.0, -np.sin(turn), np.cos(turn)])
    up = np.array([np.cos(tilt), -np.sin(tilt) * np.cos(turn), -np.sin(tilt) * np.sin(turn)])
    middle = (inside.min(axis=0) + inside.max(axis=0)) / 2.0
    wide, high = inside @ right, inside @ up
    middle = middle + right * ((wide.min() + wide.max()) / 2.0 - middle @ right)
    middle = middle + up * ((high.min() + high.max()) / 2.0 - middle @ up)
    reach = 0.5 * max(float(np.ptp(wide)), float(np.ptp(high))) + 1.5 * solid.pitch
    depth = float(np.linalg.norm(np.ptp(inside, axis=0))) + solid.pitch
    steps = np.linspace(-reach, reach, _PICTURE_PX)
    x, y = np.meshgrid(steps, steps[::-1])
    base = middle + x[..., np.newaxis] * right + y[..., np.newaxis] * up
    surface = np.zeros((*x.shape, 3))
    before = np.zeros(x.shape)
    pending = np.ones(x.shape, dtype=np.bool_)
    for distance in np.arange(depth, -depth, -_RAY_STEP):
        rows, cols = np.nonzero(pending)
        place = base[rows, cols] + distance * to_eye
        value = solid.at(place)
        hit = value >= EDGE
        rise = np.maximum(value[hit] - before[rows[hit], cols[hit]], 1e-6)
        back = np.clip((value[hit] - EDGE) / rise, 0.0, 1.0) * _RAY_STEP
        surface[rows[hit], cols[hit]] = place[hit] + back[:, np.newaxis] * to_eye
        before[rows, cols] = value
        pending[rows[hit], cols[hit]] = False
    shown = ~pending
    light = to_eye + 0.7 * up - 0.5 * right
    shade = 0.62 + 0.38 * np.clip(solid.normals(surface[shown]) @ (light / np.linalg.norm(light)), 0.0, 1.0)
    picture = np.full((*x.shape, 3), _WHITE)
    colours = srgb8(np.clip(surface[shown], [0.0, -128.0, -128.0], [100.0, 127.0, 127.0]))
    picture[shown] = np.rint(colours * shade[:, np.newaxis]).astype(np.uint8)
    return SolidView(title, picture)
