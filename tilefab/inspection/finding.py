"""A tile on the belt: where its outline lies in an image, also if parts of it are broken off or hidden.

The belt is what the image's border shows most of. On a reduced copy all that differs from it is the tile; the outline
of that has four directions at right angles in which many points share a line: the sides. A side of which too little is
left is put where the tile's size says. Then each side is found in the image itself, to a fraction of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.inspection.records import ImageProblem
from tilefab.inspection.tile_outline import VEIN_CELLS, SizedBox, box_corners, tile_outline, within_corners
from tilefab.slab.surround import perceptual
from tilefab.types import FloatImage, Mask, SizeMm

Float64Array = NDArray[np.float64]

_LEAST_SIDE_PX = 48
_REDUCED_SIDE_PX = 340
_RING_CELLS = 3
_DARKEST, _CLIPPED = 0.012, 0.985
_MOST_CLIPPED = 0.5
_LEAST_TORN = 0.01
_LIVELY = 0.25
_MOST_ALIKE = 0.2
_LONG_RUN = 16
_LEAST_DIFFERENCE_DE, _MOST_DIFFERENCE_DE, _SCATTER_FACTOR = 4.0, 12.0, 4.0
_STRAIGHT_SHARE = 0.7
_EDGE_POINTS = 128
_EDGE_DEPTH_PX = 3.0
_TRIED_POINTS = 24
_NEAR_LINE_PX = 0.8
_MOST_SLOPE = 0.03
_SIDE_FOR_TURN = 0.4
_EDGE_REACH_CELLS = 3.0
_EDGE_STEP_PX = 0.5
_LEAST_EDGE_CONTRAST = 0.01
_LEAST_EDGE_POINTS = 8


@dataclass(frozen=True, eq=False)
class FoundTile:
    """A tile in an image.

    Attributes
    ----------
    corners_px
        (4, 2) float64: (x, y) of the outline's corners, pixel centres at +0.5, clockwise from the one that is the upper
        left as the tile lies in the image, turned by less than 45 degrees.
    mask
        bool (rows, cols): pixels that show the tile; what lies upon it counts as tile unless it looks like the belt.
    visible
        Share of the outline that is tile, 0 to 1.
    sides_seen
        Whether the upper, right, lower and left side were seen; the others are put where the tile's size says.
    across
        Whether the tile's width lies along the image's columns instead of its rows, as far as the outline tells; for a
        square always False.
    px_per_mm
        Resolution of the image at the tile: from sides that were seen, or as given.
    measured
        Whether it is from sides that were seen.
    """

    corners_px: Float64Array
    mask: Mask
    visible: float
    sides_seen: tuple[bool, bool, bool, bool]
    across: bool
    px_per_mm: float
    measured: bool

    def scaled(self, factor: float) -> Float64Array:
        """Corners if the tile were larger by a factor, the sides that were seen lying where they do.

        Of use where it isn't `measured`: then two sides that meet were seen.
        """
        upper, right, lower, left = self.sides_seen
        seen = ((left, upper), (upper, right), (right, lower), (lower, left))
        corner = self.corners_px[next((place for place, both in enumerate(seen) if all(both)), 0)]
        return np.asarray(corner + factor * (self.corners_px - corner), dtype=np.float64)


def find_tile(xyz: FloatImage, size_mm: SizeMm, *, px_per_mm: float | None = None) -> FoundTile | ImageProblem:
    """Find the one tile in an image, or say why the image is of no use.

    Parameters
    ----------
    xyz
        float32 (rows, cols, 3), linear XYZ D50, 1 = the perfect white.
    size_mm
        Size of the finished tile.
    px_per_mm
        Resolution of the image, if the camera is calibrated: then a tile of another size is told from a broken one.

    Raises
    ------
    ValueError
        If the image isn't (rows, cols, 3), or the size or the resolution isn't positive.
    """
    if xyz.ndim != 3 or xyz.shape[2] != 3:
        raise ValueError(f"an image must be (rows, cols, 3), not {xyz.shape}")
    if not (size_mm.width > 0 and size_mm.height > 0):
        raise ValueError(f"a tile of {size_mm.width:g} x {size_mm.height:g} mm: sizes must be more than 0")
    if px_per_mm is not None and not px_per_mm > 0:
        raise ValueError(f"px_per_mm {px_per_mm} must be more than 0")
    if min(xyz.shape[:2]) < _LEAST_SIDE_PX:
        return ImageProblem.NO_TILE
    light = np.ascontiguousarray(xyz[:, :, 1])
    bad = _exposure(light)
    if bad is not None:
        return bad
    cell = max(1, -(-max(light.shape) // _REDUCED_SIDE_PX))
    small = _reduced(xyz, cell)
    belt_lab, limit_de = _belt(small)
    if _torn(light, float(np.median(small[_ring(small.shape), 1]))):
        return ImageProblem.TORN
    lab = perceptual(small.astype(np.float64))
    differs = np.sqrt(((lab - belt_lab) ** 2).sum(axis=-1)) > limit_de
    scale = None if px_per_mm is None else px_per_mm / cell
    sized = tile_outline(differs, size_mm, scale)
    if isinstance(sized, ImageProblem):
        return sized
    if sized.cut is not None and _straight(light, box_corners(sized.cut[1]) * cell, sized.cut[0], cell):
        return ImageProblem.WRONG_SIZE
    corners, seen_px_per_mm = _refined(light, sized, size_mm, cell)
    mask, visible = _mask(light, differs, corners, cell)
    measured = any(sized.known[side] and sized.known[side + 2] for side in range(2))
    return FoundTile(corners, mask, visible, sized.known, sized.across, seen_px_per_mm, measured)


def _exposure(light: NDArray[np.float32]) -> ImageProblem | None:
    some = light[::4, ::4]
    if float(np.percentile(some, 99.0)) < _DARKEST:
        return ImageProblem.BLACK
    if float((some >= _CLIPPED).mean()) > _MOST_CLIPPED:
        return ImageProblem.BLOWN_OUT
    return None


def _reduced(xyz: FloatImage, cell: int) -> FloatImage:
    """Means of squares of ``cell`` pixels; what is left over at the far edges is dropped."""
    if cell == 1:
        return xyz
    rows, cols = xyz.shape[0] // cell, xyz.shape[1] // cell
    out = np.zeros((rows, cols, 3), dtype=np.float32)
    for row in range(cell):
        for col in range(cell):
            out += xyz[row : rows * cell : cell, col : cols * cell : cell]
    out *= np.float32(1.0 / (cell * cell))
    return out


def _ring(shape: tuple[int, ...]) -> Mask:
    out = np.ones(shape[:2], dtype=np.bool_)
    out[_RING_CELLS:-_RING_CELLS, _RING_CELLS:-_RING_CELLS] = False
    return out


def _belt(small: FloatImage) -> tuple[Float64Array, float]:
    """The belt's Lab, and how far from it a cell must be not to be belt."""
    lab = perceptual(small[_ring(small.shape)].astype(np.float64))
    middle = np.median(lab, axis=0)
    scatter = float(np.median(np.sqrt(((lab - middle) ** 2).sum(axis=-1))))
    limit = float(np.clip(_SCATTER_FACTOR * scatter, _LEAST_DIFFERENCE_DE, _MOST_DIFFERENCE_DE))
    return np.asarray(middle, dtype=np.float64), limit


def _torn(light: NDArray[np.float32], belt: float) -> bool:
    """Whether rows or columns are missing: all of one value that isn't the belt's, or the same as the one before.

    Only lines that cross something count: belt is even. Of a compressed or enlarged image neighbouring lines may be the
    same in eights, so there a long run is needed; single ones prove something only where pixels have grain.
    """
    reach = float(np.ptp(light[::4, ::4]))
    for plane in (light, light.T):
        contrast = np.ptp(plane, axis=1)
        even = (contrast == 0.0) & (np.abs(plane[:, 0] - belt) > 0.2 * belt + 0.004)
        lively = contrast[1:] > _LIVELY * reach
        repeated = lively & (plane[1:] == plane[:-1]).all(axis=1)
        others = lively & ~repeated
        grainy = others.any() and float((plane[1:][others] == plane[:-1][others]).mean()) < _MOST_ALIKE
        if even.mean() >= _LEAST_TORN or (grainy and repeated.mean() >= _LEAST_TORN):
            return True
        if _longest(repeated) >= max(_LONG_RUN, _LEAST_TORN * len(plane)):
            return True
    return False


def _longest(lines: Mask) -> int:
    """Length of the longest run of True."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], lines, [False]]).astype(np.int8)))
    return int((ends[1::2] - ends[::2]).max()) if len(ends) else 0


def _refined(light: NDArray[np.float32], sized: SizedBox, size_mm: SizeMm, cell: int) -> tuple[Float64Array, float]:
    """Corners where the sides meet, each seen side fitted to the points half way between belt and tile; px_per_mm."""
    corners = box_corners(sized.box) * cell
    rough = [(start, _unit(end - start)) for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    points = [
        _edge_points(light, start, end, cell) if known else (np.empty(0), np.empty(0))
        for start, end, known in zip(corners, np.roll(corners, -1, axis=0), sized.known, strict=True)
    ]
    fits = [_robust_line(down, offset, None) for down, offset in points]
    turns = [fit.slope for fit in fits if fit is not None and fit.share >= _SIDE_FOR_TURN]
    lines = []
    for (start, along), (down, offset), fit in zip(rough, points, fits, strict=True):
        if fit is None or fit.share < _SIDE_FOR_TURN:
            # Too short a piece says where a side lies, but hardly how it is turned: as the others are.
            fit = _robust_line(down, offset, float(np.median(turns)) if turns else 0.0)
        inward = np.array([-along[1], along[0]])
        turned = fit or _Fit(float(np.median(turns)) if turns else 0.0, 0.0, 0.0)
        lines.append((start + turned.height * inward, _unit(along + turned.slope * inward)))
    high, wide = (size_mm.width, size_mm.height) if sized.across else (size_mm.height, size_mm.width)
    middle = corners.mean(axis=0)
    measured = [
        (_away(lines[side], middle) + _away(lines[side + 2], middle)) / length
        for side, length in ((0, high), (1, wide))
        if sized.known[side] and sized.known[side + 2]
    ]
    px_per_mm = float(np.mean(measured)) if measured else sized.px_per_mm * cell
    for side, length in enumerate((high, wide, high, wide)):
        if not sized.known[side]:
            point, along = lines[(side + 2) % 4]
            inward = np.array([-along[1], along[0]])
            lines[side] = (point + length * px_per_mm * inward, -along)
    return np.array([_meet(lines[side - 1], lines[side]) for side in range(4)]), px_per_mm


def _straight(light: NDArray[np.float32], corners: Float64Array, side: int, cell: int) -> bool:
    """Whether a side is straight as only a tile's edge is."""
    down, offset = _edge_points(light, corners[side], corners[(side + 1) % 4], cell)
    fit = _robust_line(down, offset, None)
    return fit is not None and fit.share >= _STRAIGHT_SHARE * len(down) / _EDGE_POINTS


def _unit(vector: Float64Array) -> Float64Array:
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)


def _away(line: tuple[Float64Array, Float64Array], point: Float64Array) -> float:
    """How far a point lies inward of a side."""
    (x, y), (along_x, along_y) = line
    return float(along_x * (point[1] - y) - along_y * (point[0] - x))


def _edge_points(
    light: NDArray[np.float32], start: Float64Array, end: Float64Array, cell: int
) -> tuple[Float64Array, Float64Array]:
    """Points of a side: how far along it from its start, and how far inward of the rough one."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    inward = np.array([-along[1], along[0]])
    reach = _EDGE_REACH_CELLS * cell + 2.0
    across = np.arange(-reach, reach + _EDGE_DEPTH_PX + 1e-9, _EDGE_STEP_PX)
    down = (np.arange(_EDGE_POINTS) + 0.5) / _EDGE_POINTS * length
    places = start + down[:, np.newaxis, np.newaxis] * along + across[:, np.newaxis] * inward
    inside = ((places >= 0.0) & (places <= np.array(light.shape[::-1]))).all(axis=(1, 2))
    down, places = down[inside], places[inside]
    if len(down) < _LEAST_EDGE_POINTS:
        return np.empty(0), np.empty(0)
    level = ndimage.map_coordinates(
        light, [places[..., 1] - 0.5, places[..., 0] - 0.5], order=1, mode="nearest", prefilter=False
    )
    outer = level[:, : max(3, len(across) // 8)]
    belt = float(np.median(outer))
    lift = level - belt
    noise = 1.4826 * float(np.median(np.abs(outer - belt)))
    first = np.argmax(np.abs(lift) > max(_LEAST_EDGE_CONTRAST, 6.0 * noise), axis=1)
    # The stone's own light just inside, beyond the blur, is what the half is of: further in it may be another.
    deep = round(_EDGE_DEPTH_PX / _EDGE_STEP_PX)
    rows = np.arange(len(down))
    full = np.median([lift[rows, np.minimum(first + deep + k, len(across) - 1)] for k in (-1, 0, 1)], axis=0)
    # Some of a stone may be darker than the belt, or all of it.
    lift *= np.where(full < 0.0, -1.0, 1.0)[:, np.newaxis]
    full = np.abs(full)
    over = (lift >= 0.5 * full[:, np.newaxis]) & (np.arange(len(across)) >= first[:, np.newaxis] - deep)
    step = np.argmax(over, axis=1)
    good = (first > 0) & (step > 0) & (full > max(_LEAST_EDGE_CONTRAST, 0.4 * float(np.median(full))))
    rows, step, full = rows[good], step[good], full[good]
    before, after = lift[rows, step - 1], lift[rows, step]
    part = (0.5 * full - before) / np.maximum(after - before, 1e-9)
    offset = across[step - 1] + np.clip(part, 0.0, 1.0) * _EDGE_STEP_PX
    return down[good], np.asarray(offset, dtype=np.float64)


@dataclass(frozen=True)
class _Fit:
    """A side's line: slope and height over the rough one, and the share of the side that lies on it."""

    slope: float
    height: float
    share: float


def _robust_line(down: Float64Array, offset: Float64Array, slope: float | None) -> _Fit | None:
    """The line on which most points lie, then fitted to those; of a given slope, if there is one.

    All pairs of a thinned set are tried, so the result depends on no chance.
    """
    if len(down) < _LEAST_EDGE_POINTS:
        return None
    if slope is None:
        some = np.linspace(0, len(down) - 1, min(len(down), _TRIED_POINTS)).astype(np.int64)
        one, two = np.triu_indices(len(some), 1)
        run = down[some[two]] - down[some[one]]
        far = run > 0.2 * np.ptp(down)
        one, two, run = some[one[far]], some[two[far]], run[far]
        slopes = (offset[two] - offset[one]) / run
        level = np.abs(slopes) <= _MOST_SLOPE
        if not level.any():
            return None
        slopes = slopes[level]
        heights = offset[one[level]] - slopes * down[one[level]]
    else:
        slopes = np.full(len(down), slope)
        heights = offset - slope * down
    away = np.abs(offset - heights[:, np.newaxis] - slopes[:, np.newaxis] * down)
    best = int(np.argmin(np.minimum(away, _NEAR_LINE_PX).sum(axis=1)))
    fitted, height = float(slopes[best]), float(heights[best])
    keep = away[best] <= _NEAR_LINE_PX
    for _ in range(3):
        if keep.sum() < _LEAST_EDGE_POINTS:
            return None
        if slope is None:
            fitted, height = (float(value) for value in np.polyfit(down[keep], offset[keep], 1))
        else:
            height = float(np.mean(offset[keep] - fitted * down[keep]))
        residual = np.abs(offset - height - fitted * down)
        keep = residual <= float(np.clip(3.0 * 1.4826 * np.median(residual[keep]), 0.1, _NEAR_LINE_PX))
    return _Fit(fitted, height, float(keep.sum()) / _EDGE_POINTS)


def _meet(one: tuple[Float64Array, Float64Array], other: tuple[Float64Array, Float64Array]) -> Float64Array:
    """Where two lines cross."""
    steps = np.linalg.solve(np.column_stack([one[1], -other[1]]), other[0] - one[0])
    return np.asarray(one[0] + steps[0] * one[1], dtype=np.float64)


def _mask(light: NDArray[np.float32], differs: Mask, corners: Float64Array, cell: int) -> tuple[Mask, float]:
    """Pixels that show the tile, and their share of the outline."""
    inside = within_corners(corners / cell, differs.shape)
    clean = ndimage.binary_opening(differs & inside, np.ones((3, 3)))
    # Beyond the outline all counts as tile meanwhile, so that veins are closed up to it; a break is far wider.
    closed = ndimage.minimum_filter(
        ndimage.maximum_filter((clean | ~inside).astype(np.uint8), 2 * VEIN_CELLS + 1), 2 * VEIN_CELLS + 1
    )
    solid = ndimage.binary_fill_holes((closed > 0) & inside)
    visible = float(solid.sum() / max(1, inside.sum()))
    whole = np.repeat(np.repeat(np.asarray(solid, dtype=np.bool_), cell, axis=0), cell, axis=1)
    short = [(0, light.shape[axis] - whole.shape[axis]) for axis in range(2)]
    mask = np.pad(whole, short, mode="edge")
    return np.asarray(mask & (light < _CLIPPED), dtype=np.bool_), visible
