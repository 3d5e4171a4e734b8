"""Defects on tiles: in print data before firing, or on the fired tile. All of them tell where they are.

Print data are (rows, cols, N) uint8 or uint16, 0 = no ink, row 0 first: a failed nozzle leaves a line along a column.
Fired tiles are (rows, cols, 3) float32, linear sRGB. Everything is drawn from a Generator; images given stay as they
are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

PrintData = NDArray[np.unsignedinteger]
FiredTile = NDArray[np.float32]

BODY_RGB_LIN = (0.52, 0.40, 0.31)
"""Body under the glaze, where a tile is chipped: linear sRGB."""
_CURLS = 4
_MARGIN_MM = 3.0


@dataclass(frozen=True)
class SeededDefect:
    """What was done to a tile.

    Attributes
    ----------
    kind
        Its name, as inspection calls it.
    x_mm, y_mm
        Its middle, from the upper left corner.
    width_mm, height_mm
        Of the box around it.
    """

    kind: str
    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float


def nozzle_line(
    pixels: PrintData, ink: int, generator: np.random.Generator, *, px_per_mm: float, width_mm: float = 0.2
) -> tuple[PrintData, SeededDefect]:
    """An ink missing along some columns: failed nozzles."""
    rows, cols, _ = pixels.shape
    wide = max(round(width_mm * px_per_mm), 1)
    margin = round(_MARGIN_MM * px_per_mm)
    first = int(generator.integers(margin, cols - margin - wide))
    out = pixels.copy()
    out[:, first : first + wide, ink] = 0
    high_mm = rows / px_per_mm
    return out, SeededDefect("nozzle_line", (first + wide / 2) / px_per_mm, high_mm / 2, wide / px_per_mm, high_mm)


def missing_ink(pixels: PrintData, ink: int, *, px_per_mm: float) -> tuple[PrintData, SeededDefect]:
    """An ink that isn't there."""
    out = pixels.copy()
    out[..., ink] = 0
    return out, _everywhere("missing_ink", pixels.shape, px_per_mm)


def misregistered(
    pixels: PrintData, ink: int, shift_mm: tuple[float, float], *, px_per_mm: float
) -> tuple[PrintData, SeededDefect]:
    """An ink printed off its place by (x, y); where it leaves an edge bare, the edge's ink is repeated."""
    out = pixels.copy()
    plane = pixels[..., ink].astype(np.float32)
    moved = ndimage.shift(plane, (shift_mm[1] * px_per_mm, shift_mm[0] * px_per_mm), order=1, mode="nearest")
    out[..., ink] = np.rint(moved).astype(pixels.dtype)
    return out, _everywhere("misregistration", pixels.shape, px_per_mm)


def double_print(
    pixels: PrintData, shift_mm: tuple[float, float], share: float, *, px_per_mm: float
) -> tuple[PrintData, SeededDefect]:
    """The face printed a second time beside its place by (x, y), with a share (0 to 1) of the ink."""
    most = np.iinfo(pixels.dtype).max
    shift = (round(shift_mm[1] * px_per_mm), round(shift_mm[0] * px_per_mm), 0)
    again = ndimage.shift(pixels, shift, order=0, mode="nearest")
    out = np.minimum(pixels.astype(np.float32) + np.float32(share) * again, np.float32(most))
    return np.rint(out).astype(pixels.dtype), _everywhere("double_print", pixels.shape, px_per_mm)


def banding(
    pixels: PrintData,
    depth: float,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    pitch_mm: float = 12.0,
    ink: int | None = None,
) -> tuple[PrintData, SeededDefect]:
    """Bands across the printing direction: an ink, or all, swings by a share ``depth`` with a pitch along the rows."""
    rows = pixels.shape[0]
    phase = float(generator.uniform(0.0, 2.0 * math.pi))
    wave = 1.0 + depth * np.sin(2.0 * math.pi * np.arange(rows) / (pitch_mm * px_per_mm) + phase)
    inks = slice(None) if ink is None else slice(ink, ink + 1)
    most = np.iinfo(pixels.dtype).max
    out = pixels.copy()
    changed = np.minimum(pixels[..., inks] * wave[:, np.newaxis, np.newaxis], most)
    out[..., inks] = np.rint(changed).astype(pixels.dtype)
    return out, _everywhere("banding", pixels.shape, px_per_mm)


def spot(
    fired: FiredTile,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    diameter_mm: float = 0.5,
    factor: float = 0.5,
    kind: str = "spot",
) -> tuple[FiredTile, SeededDefect]:
    """A round spot whose light is that of the tile times a factor; with kind "pinhole", a small hole in the glaze."""
    x, y, place = _place(fired.shape, generator, px_per_mm, diameter_mm / 2.0)
    radius = diameter_mm * px_per_mm / 2.0
    rows, cols = np.ogrid[: fired.shape[0], : fired.shape[1]]
    away = np.hypot(cols + 0.5 - x, rows + 0.5 - y)
    inside = np.clip(radius - away + 0.5, 0.0, 1.0).astype(np.float32)[..., np.newaxis]
    out = fired * (1.0 + inside * np.float32(factor - 1.0))
    return np.clip(out, 0.0, 1.0), SeededDefect(kind, *place, diameter_mm, diameter_mm)


def pinhole(
    fired: FiredTile,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    diameter_mm: float = 0.3,
    factor: float = 0.35,
) -> tuple[FiredTile, SeededDefect]:
    """A small dark hole in the glaze."""
    return spot(fired, generator, px_per_mm=px_per_mm, diameter_mm=diameter_mm, factor=factor, kind="pinhole")


def crack(
    fired: FiredTile,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    length_mm: float = 10.0,
    width_mm: float = 0.2,
    factor: float = 0.5,
) -> tuple[FiredTile, SeededDefect]:
    """A thin dark crack that wanders, in any direction."""
    return _line(fired, generator, "crack", px_per_mm, length_mm, width_mm, factor, curl=0.35, jitter_mm=0.12)


def scratch(
    fired: FiredTile,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    length_mm: float = 25.0,
    width_mm: float = 0.3,
    factor: float = 1.6,
) -> tuple[FiredTile, SeededDefect]:
    """A nearly straight light scratch, in any direction: ink rubbed off."""
    return _line(fired, generator, "scratch", px_per_mm, length_mm, width_mm, factor, curl=0.05, jitter_mm=0.0)


def chip(
    fired: FiredTile, generator: np.random.Generator, *, px_per_mm: float, size_mm: float = 3.0, corner: bool = True
) -> tuple[FiredTile, SeededDefect]:
    """A piece of the glaze broken off a corner or an edge: the rough body shows."""
    rows, cols, _ = fired.shape
    wide_mm, high_mm = cols / px_per_mm, rows / px_per_mm
    side = int(generator.integers(4))
    if corner:
        x, y = ((0.0, 0.0), (wide_mm, 0.0), (wide_mm, high_mm), (0.0, high_mm))[side]
    else:
        along = float(generator.uniform(0.2, 0.8))
        x, y = (
            (along * wide_mm, 0.0),
            (wide_mm, along * high_mm),
            (along * wide_mm, high_mm),
            (0.0, along * high_mm),
        )[side]
    down, across = np.mgrid[:rows, :cols].astype(np.float32)
    over, below = (across + 0.5) / px_per_mm - x, (down + 0.5) / px_per_mm - y
    angle = np.arctan2(below, over)
    ragged = 1.0 + sum(
        np.float32(0.25 / k) * np.sin(k * 2 * angle + float(generator.uniform(0.0, 2.0 * math.pi)))
        for k in range(1, _CURLS)
    )
    reach = size_mm * ragged
    inside = np.clip((reach - np.hypot(over, below)) * px_per_mm + 0.5, 0.0, 1.0).astype(np.float32)[..., np.newaxis]
    rough = ndimage.gaussian_filter(generator.standard_normal((rows, cols)).astype(np.float32), 1.0)
    body = np.array(BODY_RGB_LIN, dtype=np.float32) * (1.0 + 0.2 * rough[..., np.newaxis])
    out = np.clip(fired + inside * (body - fired), 0.0, 1.0)
    there = np.argwhere(inside[..., 0] > 0.5)
    (top, left), (bottom, right) = there.min(axis=0), there.max(axis=0) + 1
    place = (float(left + right) / 2 / px_per_mm, float(top + bottom) / 2 / px_per_mm)
    return out, SeededDefect("chip", *place, float(right - left) / px_per_mm, float(bottom - top) / px_per_mm)


def _everywhere(kind: str, shape: tuple[int, ...], px_per_mm: float) -> SeededDefect:
    high, wide = shape[0] / px_per_mm, shape[1] / px_per_mm
    return SeededDefect(kind, wide / 2, high / 2, wide, high)


def _place(
    shape: tuple[int, ...], generator: np.random.Generator, px_per_mm: float, reach_mm: float
) -> tuple[float, float, tuple[float, float]]:
    """A random place at least so far inside: (x, y) in pixels, and in millimetres."""
    margin = (_MARGIN_MM + reach_mm) * px_per_mm
    if 2.0 * margin >= min(shape[:2]):
        raise ValueError(f"a tile of {shape[1]} by {shape[0]} px is too small for a defect of {2 * reach_mm:g} mm")
    x, y = (float(generator.uniform(margin, side - margin)) for side in (shape[1], shape[0]))
    return x, y, (x / px_per_mm, y / px_per_mm)


def _line(
    fired: FiredTile,
    generator: np.random.Generator,
    kind: str,
    px_per_mm: float,
    length_mm: float,
    width_mm: float,
    factor: float,
    *,
    curl: float,
    jitter_mm: float,
) -> tuple[FiredTile, SeededDefect]:
    """A thin line, ``curl`` radians bent over its length by smooth waves, its points off it by ``jitter_mm``."""
    x, y, _ = _place(fired.shape, generator, px_per_mm, length_mm / 2.0)
    steps = max(round(length_mm * px_per_mm * 4), 2)
    along = np.linspace(-0.5, 0.5, steps)
    heading = np.full(steps, float(generator.uniform(0.0, 2.0 * math.pi)))
    for k in range(1, _CURLS):
        size, phase = curl * float(generator.standard_normal()) / k, float(generator.uniform(0.0, 2.0 * math.pi))
        heading += size * np.sin(2.0 * math.pi * k * along + phase)
    step = length_mm * px_per_mm / steps
    points = np.stack([np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))], axis=1) * step
    if jitter_mm > 0.0:
        knots = max(round(length_mm / 0.8), 2)
        off = generator.normal(0.0, jitter_mm * px_per_mm, knots)
        side = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        points += side * np.interp(along, np.linspace(-0.5, 0.5, knots), off)[:, np.newaxis]
    points += np.array([x, y]) - points.mean(axis=0)
    radius = width_mm * px_per_mm / 2.0
    reach = math.ceil(radius) + 2
    low = np.maximum(np.floor(points.min(axis=0)).astype(np.int64) - reach, 0)
    high = np.minimum(np.ceil(points.max(axis=0)).astype(np.int64) + reach, [fired.shape[1], fired.shape[0]])
    # Distance from the line: from a mask four times as fine, so that the width is right to a quarter of a pixel.
    fine = 4
    mask = np.ones(((high[1] - low[1]) * fine, (high[0] - low[0]) * fine), dtype=bool)
    at = np.floor((points - low) * fine).astype(np.int64)
    mask[np.clip(at[:, 1], 0, mask.shape[0] - 1), np.clip(at[:, 0], 0, mask.shape[1] - 1)] = False
    inside = (ndimage.distance_transform_edt(mask) <= radius * fine).astype(np.float32)
    share = inside.reshape(high[1] - low[1], fine, high[0] - low[0], fine).mean(axis=(1, 3))[..., np.newaxis]
    out = fired.copy()
    part = out[low[1] : high[1], low[0] : high[0]]
    part *= 1.0 + share * np.float32(factor - 1.0)
    least, most = points.min(axis=0) / px_per_mm, points.max(axis=0) / px_per_mm
    middle, size = (least + most) / 2, most - least + width_mm
    return np.clip(out, 0.0, 1.0), SeededDefect(
        kind, float(middle[0]), float(middle[1]), float(size[0]), float(size[1])
    )
