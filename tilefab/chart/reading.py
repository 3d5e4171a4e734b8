"""Colours of a chart's patches from a scan of its tiles.

Only the inner part of each patch is read, in 5 x 5 blocks. A block's mean, in linear light, evens out the dots of the
print; blocks that stand apart from the patch's median are a scratch, a pinhole or dust, and are left out. The light's
fall-off is what the bare gaps between the patches say it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.chart.finding import TilePose, find_tiles
from tilefab.chart.layout import ChartLayout
from tilefab.colour.spaces import lab_from_xyz
from tilefab.errors import ProfileError
from tilefab.types import Array

Float64Array = NDArray[np.float64]
ToXyz = Callable[[Array], Array]
"""Pixels (rows, cols, channels) as the scan has them to XYZ under D50, (rows, cols, 3), Y = 1 for white."""

_INNER = 0.6
_BLOCKS = 5
_MOST_SAMPLES = 8
_LEAST_INNER_PX = 5.0
_PATCHES_AT_ONCE = 256
_APART = 4.0
_CHI_MEDIAN = 1.538  # median of the distance of a normal point of three dimensions
_LIKE_PATCHES = 25
_DEFECT_BLOCKS = 2
_DEFECT_DELTA_E, _DEFECT_NOISE = 2.0, 7.0
_UNEVEN, _UNEVEN_DELTA_E = 4.0, 2.0
_LEAST_GAP_PX = 3.0
_LEAST_NODES = 16
_CUBIC_NODES = 80


@dataclass(frozen=True, eq=False)
class TileReading:
    """What was read of one tile.

    Attributes
    ----------
    pose
        Which tile it is and how it lay.
    patches
        (n,) int64 numbers of its patches, from 0.
    xyz_d50
        (n, 3) float64 colours, Y = 1 for white.
    spread_delta_e
        (n,) root mean square CIE76 difference of a patch's blocks from its colour.
    left_out
        (n,) share of each patch that was left out, 0 to 1.
    defect
        (n,) True where a patch has a defect, or is more uneven than the others.
    lighting_percent
        Range of the light over the tile, in percent of its mean, that was taken out; None where it was left as it is.
    """

    pose: TilePose
    patches: NDArray[np.int64] = field(repr=False)
    xyz_d50: Float64Array = field(repr=False)
    spread_delta_e: Float64Array = field(repr=False)
    left_out: Float64Array = field(repr=False)
    defect: NDArray[np.bool_] = field(repr=False)
    lighting_percent: float | None


def grey_of(pixels: Array) -> NDArray[np.float32]:
    """Brightness of a scan, (rows, cols) float32, the largest value that its type can have as 1."""
    full = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind == "u" else 1.0
    flat = pixels[..., np.newaxis] if pixels.ndim == 2 else pixels
    out = np.zeros(flat.shape[:2], dtype=np.float32)
    for channel in range(flat.shape[2]):
        out += flat[..., channel]
    out *= np.float32(1.0 / (full * flat.shape[2]))
    return out


def read_tiles(
    pixels: Array, layout: ChartLayout, to_xyz: ToXyz, *, even_light: bool = True, name: str = "the scan"
) -> tuple[TileReading, ...]:
    """Read every tile of a chart that a scan shows.

    Parameters
    ----------
    pixels
        (rows, cols, channels) scan: RGB or grey as it stands in its file, or XYZ. Light must be large numbers.
    layout
        The chart.
    to_xyz
        What the scan's values mean. It is only asked about the pixels that are read.
    even_light
        Whether to take out the light's fall-off.
    name
        What to call the scan in messages.

    Returns
    -------
    tuple of TileReading
        By tile; one or more.

    Raises
    ------
    ProfileError
        If no tile is found, one is cut off, or the scan is too coarse.
    """
    grey = grey_of(pixels)
    poses = find_tiles(grey, layout, name)
    del grey
    return tuple(_read_tile(pixels, layout, pose, to_xyz, even_light, name) for pose in poses)


def _read_tile(
    pixels: Array, layout: ChartLayout, pose: TilePose, to_xyz: ToXyz, even_light: bool, name: str
) -> TileReading:
    inner_px = _INNER * layout.patch_px * pose.scale
    if inner_px < _LEAST_INNER_PX:
        dpi = layout.dpi * pose.scale
        raise ProfileError(
            f"{name}: a patch has {layout.patch_px * pose.scale:.1f} pixels only: scan at "
            f"{np.ceil(dpi * _LEAST_INNER_PX / inner_px / 10) * 10:.0f} dpi or more",
            path=name,
        )
    patches = layout.on_tile(pose.tile)
    samples = int(np.clip(round(inner_px / _BLOCKS), 1, _MOST_SAMPLES))
    side = samples * _BLOCKS
    across = layout.patch_px * (0.5 + _INNER * ((np.arange(side) + 0.5) / side - 0.5))
    inside = np.stack(np.meshgrid(across, across), axis=-1).reshape(-1, 2)
    corners = np.array([layout.cell_corner(int(row), int(col))[::-1] for _, row, col in layout.places[patches]])
    blocks = np.empty((len(patches), _BLOCKS * _BLOCKS, 3))
    for start in range(0, len(patches), _PATCHES_AT_ONCE):
        part = corners[start : start + _PATCHES_AT_ONCE, np.newaxis] + inside
        xyz = np.asarray(to_xyz(_pick(pixels, pose.to_scan(part), name)), dtype=np.float64)
        shape = (len(part), _BLOCKS, samples, _BLOCKS, samples, 3)
        blocks[start : start + len(part)] = xyz.reshape(shape).mean(axis=(2, 4)).reshape(len(part), -1, 3)
    lighting = None
    if even_light and layout.gap_px * pose.scale >= _LEAST_GAP_PX:
        light = _light(pixels, layout, pose, to_xyz, corners + layout.patch_px / 2.0, name)
        if light is not None:
            blocks /= light[:, np.newaxis]
            lighting = 100.0 * float(light[:, 1].max() - light[:, 1].min())
    return TileReading(pose, patches, *_average(blocks), lighting)


def _pick(pixels: Array, points_xy: Float64Array, name: str) -> Array:
    """Pixels that points lie in, (..., channels)."""
    col, row = (np.floor(points_xy[..., axis]).astype(np.int64) for axis in (0, 1))
    if row.min() < 0 or col.min() < 0 or row.max() >= pixels.shape[0] or col.max() >= pixels.shape[1]:
        raise ProfileError(
            f"{name}: the tile is cut off: some patches lie beyond the scan's edge; scan it whole", path=name
        )
    return np.asarray(pixels[row, col])


def _average(
    blocks: Float64Array,
) -> tuple[Float64Array, Float64Array, Float64Array, NDArray[np.bool_]]:
    """Colour, spread, share left out and whether there is a defect, of patches (n, blocks, 3) in XYZ."""
    lab = lab_from_xyz(blocks)
    away = np.linalg.norm(lab - np.median(lab, axis=1, keepdims=True), axis=2)
    noise = np.median(away, axis=1) / _CHI_MEDIAN
    # The same light scatters a dark patch's colour more: each is compared with patches about as dark as it is.
    by_lightness = np.argsort(np.median(lab[..., 0], axis=1), kind="stable")
    typical = np.empty(len(noise))
    typical[by_lightness] = ndimage.median_filter(noise[by_lightness], min(_LIKE_PATCHES, len(noise)), mode="nearest")
    apart = away > (_APART * np.maximum(noise, typical) + 1e-6)[:, np.newaxis]
    kept = ~apart
    xyz = (blocks * kept[..., np.newaxis]).sum(axis=1) / kept.sum(axis=1)[:, np.newaxis]
    difference = np.linalg.norm(lab - lab_from_xyz(xyz)[:, np.newaxis], axis=2)
    worst = np.where(apart, difference, 0.0).max(axis=1)
    defect = (apart.sum(axis=1) >= _DEFECT_BLOCKS) & (worst > np.maximum(_DEFECT_DELTA_E, _DEFECT_NOISE * typical))
    defect |= (noise > _UNEVEN * typical) & (noise > _UNEVEN_DELTA_E)
    return xyz, np.sqrt((difference**2).mean(axis=1)), apart.mean(axis=1), defect


def _light(
    pixels: Array, layout: ChartLayout, pose: TilePose, to_xyz: ToXyz, centres_xy: Float64Array, name: str
) -> Float64Array | None:
    """Light at the patches' centres, (n, 3), 1 on average, from the bare crossings between them; None if too few."""
    free = np.zeros((layout.grid.rows, layout.grid.cols), dtype=bool)
    free[tuple(layout.cells().T)] = True
    row, col = np.nonzero(free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:])
    if len(row) < _LEAST_NODES:
        return None
    top, left = layout.origin
    pitch = layout.patch_px + layout.gap_px
    nodes = np.column_stack([left + (col + 1) * pitch, top + (row + 1) * pitch]) - layout.gap_px / 2.0
    around = layout.gap_px * np.array([-0.2, 0.0, 0.2])
    points = nodes[:, np.newaxis] + np.stack(np.meshgrid(around, around), axis=-1).reshape(-1, 2)
    bare = np.median(np.asarray(to_xyz(_pick(pixels, pose.to_scan(points), name)), dtype=np.float64), axis=1)
    half = np.array([layout.tile.cols, layout.tile.rows]) / 2.0
    order = 3 if len(nodes) >= _CUBIC_NODES else 2
    terms, wanted = _terms(nodes / half - 1.0, order), _terms(centres_xy / half - 1.0, order)
    out = np.empty((len(centres_xy), 3))
    for channel in range(3):
        level = np.log(np.maximum(bare[:, channel], 1e-4))
        keep = np.ones(len(level), dtype=bool)
        fit: Float64Array = np.zeros(terms.shape[1])
        for _ in range(6):
            fit = np.asarray(np.linalg.lstsq(terms[keep], level[keep], rcond=None)[0], dtype=np.float64)
            away = np.abs(level - terms @ fit)
            keep = away <= max(3.0 * 1.4826 * float(np.median(away)), 1e-6)
        light = np.exp(wanted @ fit)
        out[:, channel] = light / light.mean()
    return out


def _terms(places: Float64Array, order: int) -> Float64Array:
    """Terms of a polynomial of two places, (n, 2) of -1 to 1."""
    x, y = places.T
    return np.column_stack([x**i * y**j for i in range(order + 1) for j in range(order + 1 - i)])
