"""A fired tile under the camera: turned, shifted, unevenly lit, noisy, perhaps covered or broken, on a dark belt.

It takes colours, not inks, so that whatever is done to a fired tile (defects, another firing) is done before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sim.scanner import fired_rgb, srgb_bytes

__all__ = ["PhotoConditions", "PhotoOfTile", "fired_rgb", "photo_conditions", "photo_of"]

FloatImage = NDArray[np.float32]
Matrix = NDArray[np.float64]

_MOST_SHIFT = 0.06
_MOST_GAIN = 0.1
_LEAST_NOISE, _MOST_NOISE = 0.002, 0.008
_LEAST_BLUR_PX, _MOST_BLUR_PX = 0.3, 0.9
_RAGGED_SHARE = 0.03
_RAGGED_WAVES = 5
_QUANTILE_GRID = 96


@dataclass(frozen=True)
class PhotoConditions:
    """How a tile lies, how it is lit and what befell it.

    Attributes
    ----------
    quarter_turns
        Turns by 90 degrees, clockwise as seen in the image.
    rotation_deg
        Turn on top of them, clockwise, degrees.
    shift_mm
        How far the tile's middle lies off the image's, (x, y).
    scale
        Size of the tile in the image over what `px_per_mm` says.
    light
        How much brighter the best lit side is than the middle, share; its direction is drawn.
    gain_rgb
        Factors of the camera's channels: brightness and colour cast.
    blur_px
        Standard deviation of the camera's blur, image pixels.
    noise
        Standard deviation of each pixel's linear light where it is white, less where it is dark.
    backing
        Linear light of the belt, 0 to 1.
    perspective
        How much larger the nearest corner of the image appears than its middle, share; its direction is drawn.
    occluded
        What something covers: x, y, width and height as shares of the tile, from the face's upper left corner.
    broken
        Share of the tile's area that is broken off along a ragged line; where is drawn.
    """

    quarter_turns: int = 0
    rotation_deg: float = 0.0
    shift_mm: tuple[float, float] = (0.0, 0.0)
    scale: float = 1.0
    light: float = 0.0
    gain_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)
    blur_px: float = 0.5
    noise: float = 0.004
    backing: float = 0.03
    perspective: float = 0.0
    occluded: tuple[float, float, float, float] | None = None
    broken: float = 0.0

    def __post_init__(self) -> None:
        if not self.scale > 0.0:
            raise ValueError(f"scale {self.scale} must be more than 0")
        if not 0.0 <= self.broken < 1.0:
            raise ValueError(f"broken {self.broken} must be 0 or more and less than 1")
        if not 0.0 <= self.perspective < 0.5:
            raise ValueError(f"perspective {self.perspective} must be 0 or more and less than 0.5")


@dataclass(frozen=True, eq=False)
class PhotoOfTile:
    """A photograph and the truth about it.

    Attributes
    ----------
    image
        uint8 sRGB (rows, cols, 3).
    matrix
        (3, 3) float64: takes (x, y, 1) in pixels of the tile given to (x, y, 1) in pixels of the image up to a factor,
        pixel centres at +0.5.
    """

    image: NDArray[np.uint8]
    matrix: Matrix


def photo_conditions(
    generator: np.random.Generator,
    *,
    rotation_deg: float = 4.0,
    shift: float = _MOST_SHIFT,
    scale: float = 0.02,
    light: float = 0.15,
    gain: float = _MOST_GAIN,
    occluded: float = 0.0,
    broken: float = 0.0,
    size_mm: tuple[float, float] = (150.0, 150.0),
) -> PhotoConditions:
    """Random conditions, each within the limit given.

    Parameters
    ----------
    generator
        Source of all draws.
    rotation_deg, scale, light, gain, broken
        Largest absolute values; see `PhotoConditions`. Gains are drawn for brightness and for the cast, half each.
    shift
        Largest shift, share of the tile's shorter side.
    occluded
        Largest share of the tile's area that is covered.
    size_mm
        Width and height of the tile.
    """
    most_mm = shift * min(size_mm)
    covered = None
    if occluded > 0.0:
        area = float(generator.uniform(0.0, occluded))
        narrow = float(generator.uniform(math.sqrt(area), 1.0)) if area > 0.0 else 1.0
        wide, high = (narrow, area / narrow) if generator.random() < 0.5 else (area / narrow, narrow)
        covered = (float(generator.uniform(0.0, 1.0 - wide)), float(generator.uniform(0.0, 1.0 - high)), wide, high)
    brighter = generator.uniform(-0.5, 0.5) * gain
    red, green, blue = (float(1.0 + brighter + cast) for cast in generator.uniform(-0.5, 0.5, 3) * gain)
    return PhotoConditions(
        quarter_turns=int(generator.integers(4)),
        rotation_deg=float(generator.uniform(-rotation_deg, rotation_deg)),
        shift_mm=(float(generator.uniform(-most_mm, most_mm)), float(generator.uniform(-most_mm, most_mm))),
        scale=float(1.0 + generator.uniform(-scale, scale)),
        light=float(generator.uniform(0.0, light)),
        gain_rgb=(red, green, blue),
        blur_px=float(generator.uniform(_LEAST_BLUR_PX, _MOST_BLUR_PX)),
        noise=float(generator.uniform(_LEAST_NOISE, _MOST_NOISE)),
        occluded=covered,
        broken=float(generator.uniform(0.0, broken)),
    )


def photo_of(
    tile_rgb_lin: FloatImage,
    tile_px_per_mm: float,
    conditions: PhotoConditions,
    generator: np.random.Generator,
    *,
    px_per_mm: float,
    margin_mm: float = 8.0,
) -> PhotoOfTile:
    """Photograph of a fired tile.

    The image is as large as the turned tile and a margin; a tile shifted by more than the margin is cut off.

    Parameters
    ----------
    tile_rgb_lin
        float32 (rows, cols, 3), linear sRGB of the tile without bleed.
    tile_px_per_mm
        Its pixels a millimetre.
    conditions
        How it lies and is lit.
    generator
        Source of the noise, of the light's direction, and of where it is broken.
    px_per_mm
        Image pixels a millimetre.
    margin_mm
        Belt seen around the tile.

    Raises
    ------
    ValueError
        If the tile isn't (rows, cols, 3), or a resolution isn't positive.
    """
    if tile_rgb_lin.ndim != 3 or tile_rgb_lin.shape[2] != 3:
        raise ValueError(f"a tile must be (rows, cols, 3), not {tile_rgb_lin.shape}")
    if not (tile_px_per_mm > 0.0 and px_per_mm > 0.0):
        raise ValueError(f"pixels a millimetre must be more than 0, not {tile_px_per_mm} and {px_per_mm}")
    tile = np.ascontiguousarray(tile_rgb_lin, dtype=np.float32)
    step = conditions.scale * px_per_mm / tile_px_per_mm
    matrix, shape = _placed(tile.shape, conditions, generator, step, px_per_mm, margin_mm)
    x, y = _tile_places(matrix, shape)
    seen = np.full((*shape, 3), np.float32(conditions.backing))
    there = _coverage(x, y, tile.shape, step) * _whole(x, y, tile.shape, conditions.broken, generator, step)
    seen += there[:, :, np.newaxis] * (_resampled(tile, x, y, step) - seen)
    if conditions.occluded is not None:
        left, top, wide, high = conditions.occluded
        rows, cols = tile.shape[:2]
        hidden = _coverage(x - left * cols, y - top * rows, (high * rows, wide * cols), step)
        colour = np.float32(generator.uniform(0.02, 0.6)) * generator.uniform(0.8, 1.0, 3).astype(np.float32)
        seen += hidden[:, :, np.newaxis] * (colour - seen)
    light = _light(shape, conditions.light, generator)
    for channel, gain in enumerate(conditions.gain_rgb):
        plane = ndimage.gaussian_filter(seen[:, :, channel], conditions.blur_px) * light * np.float32(gain)
        scatter = np.float32(conditions.noise) * generator.standard_normal(shape, dtype=np.float32)
        seen[:, :, channel] = plane + scatter * np.sqrt(np.clip(plane, 0.0, 1.0) + np.float32(0.02))
    return PhotoOfTile(srgb_bytes(seen), matrix)


def _placed(
    shape: tuple[int, ...],
    conditions: PhotoConditions,
    generator: np.random.Generator,
    step: float,
    px_per_mm: float,
    margin_mm: float,
) -> tuple[Matrix, tuple[int, int]]:
    """Matrix from tile to image pixels, and the image's (rows, cols)."""
    rows, cols = shape[:2]
    angle = math.radians(90.0 * conditions.quarter_turns + conditions.rotation_deg)
    cos, sin = math.cos(angle), math.sin(angle)
    wide = step * (abs(cos) * cols + abs(sin) * rows) + 2.0 * margin_mm * px_per_mm
    high = step * (abs(sin) * cols + abs(cos) * rows) + 2.0 * margin_mm * px_per_mm
    out = (math.ceil(high), math.ceil(wide))
    turned = step * np.array([[cos, -sin], [sin, cos]])  # clockwise, for y points down
    lies = np.eye(3)
    lies[:2, :2] = turned
    lies[:2, 2] = np.array(conditions.shift_mm) * px_per_mm - turned @ np.array([cols / 2.0, rows / 2.0])
    tilt = np.eye(3)
    towards = float(generator.uniform(0.0, 2.0 * math.pi))
    reach = conditions.perspective / (0.5 * math.hypot(*out))
    tilt[2, :2] = -reach * math.cos(towards), -reach * math.sin(towards)
    middle = np.eye(3)
    middle[:2, 2] = out[1] / 2.0, out[0] / 2.0
    matrix = middle @ tilt @ lies
    return np.asarray(matrix / matrix[2, 2], dtype=np.float64), out


def _tile_places(matrix: Matrix, shape: tuple[int, int]) -> tuple[FloatImage, FloatImage]:
    """Places x and y on the tile, in its pixels, of every image pixel's centre."""
    back = np.linalg.inv(matrix)
    x = np.arange(shape[1], dtype=np.float64) + 0.5
    y = np.arange(shape[0], dtype=np.float64)[:, np.newaxis] + 0.5
    over, down, depth = (row[0] * x + row[1] * y + row[2] for row in back)
    return (over / depth).astype(np.float32), (down / depth).astype(np.float32)


def _coverage(x: FloatImage, y: FloatImage, shape: tuple[float, ...], step: float) -> FloatImage:
    """Share of each image pixel that a rectangle (rows, cols) at the origin covers, nearly."""
    inside = np.minimum(np.minimum(x, np.float32(shape[1]) - x), np.minimum(y, np.float32(shape[0]) - y))
    return np.asarray(np.clip(np.float32(step) * inside + np.float32(0.5), 0.0, 1.0), dtype=np.float32)


def _whole(
    x: FloatImage, y: FloatImage, shape: tuple[int, ...], broken: float, generator: np.random.Generator, step: float
) -> FloatImage:
    """Share of each image pixel where the tile isn't broken off."""
    if broken <= 0.0:
        return np.ones_like(x)
    rows, cols = shape[:2]
    towards = float(generator.uniform(0.0, 2.0 * math.pi))
    size = min(rows, cols)
    waves = 2.0 * math.pi * np.arange(1, _RAGGED_WAVES + 1) / size
    phases = generator.uniform(0.0, 2.0 * math.pi, _RAGGED_WAVES)
    heights = _RAGGED_SHARE * size * generator.standard_normal(_RAGGED_WAVES) / np.arange(1, _RAGGED_WAVES + 1)

    def depth(over: FloatImage, down: FloatImage) -> FloatImage:
        along = np.float32(-math.sin(towards)) * over + np.float32(math.cos(towards)) * down
        out = np.float32(math.cos(towards)) * over + np.float32(math.sin(towards)) * down
        for wave, phase, height in zip(waves, phases, heights, strict=True):
            out += np.float32(height) * np.sin(np.float32(wave) * along + np.float32(phase))
        return out

    grid = (np.arange(_QUANTILE_GRID, dtype=np.float32) + np.float32(0.5)) / np.float32(_QUANTILE_GRID)
    limit = np.float32(np.quantile(depth(cols * grid, rows * grid[:, np.newaxis]), 1.0 - broken))
    return np.asarray(np.clip(np.float32(step) * (limit - depth(x, y)) + np.float32(0.5), 0.0, 1.0), dtype=np.float32)


def _resampled(tile: FloatImage, x: FloatImage, y: FloatImage, step: float) -> FloatImage:
    """The tile's colours at places on it; an image pixel gathers the light of all tile pixels under it."""
    bins = max(1, int(1.0 / step))
    if bins > 1:
        rows, cols = -(-tile.shape[0] // bins), -(-tile.shape[1] // bins)
        more = ((0, rows * bins - tile.shape[0]), (0, cols * bins - tile.shape[1]), (0, 0))
        tile = np.pad(tile, more, mode="edge").reshape(rows, bins, cols, bins, 3).mean(axis=(1, 3))
    spread = math.sqrt(max(0.0, 1.0 / (step * bins) ** 2 - 1.0))
    places = np.stack([y / np.float32(bins) - np.float32(0.5), x / np.float32(bins) - np.float32(0.5)])
    out = np.empty((*x.shape, 3), dtype=np.float32)
    for channel in range(3):
        plane = np.ascontiguousarray(tile[:, :, channel])
        if spread > 0.0:
            plane = ndimage.gaussian_filter(plane, 0.4 * spread, mode="nearest")
        ndimage.map_coordinates(plane, places, output=out[:, :, channel], order=1, mode="nearest", prefilter=False)
    return out


def _light(shape: tuple[int, int], light: float, generator: np.random.Generator) -> FloatImage:
    """Unevenness of the light over an image, 1 in the middle."""
    down = np.linspace(-1.0, 1.0, shape[0], dtype=np.float32)[:, np.newaxis]
    across = np.linspace(-1.0, 1.0, shape[1], dtype=np.float32)[np.newaxis, :]
    towards = float(generator.uniform(0.0, 2.0 * math.pi))
    slope = np.float32(math.cos(towards)) * across + np.float32(math.sin(towards)) * down
    fall = np.float32(0.25) * (across * across + down * down)
    return np.asarray(np.float32(1.0) + np.float32(light) * (slope - fall), dtype=np.float32)
