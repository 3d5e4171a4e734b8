"""A skewed scan squared: the slab's four edges found, made upright, and its border trimmed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.slab.bands import over_bands
from tilefab.slab.checks import check_pair
from tilefab.slab.edges import Edges, find_edges
from tilefab.slab.kernels import warp_rows
from tilefab.slab.surround import Surround, find_surround
from tilefab.types import FloatImage, Mask, SizePx

_MAX_CORNER_DEVIATION_DEG = 8.0
_MAX_SIDE_RATIO = 1.1
_UPRIGHT_PX = 0.25
_MAX_CHIPPED_FRAC = 0.03
_BAND_ROWS = 256


@dataclass(frozen=True)
class SquaringOptions:
    """Limits of squaring.

    Attributes
    ----------
    trim_px
        Taken off each side afterwards, >= 0.
    max_angle_deg
        A slab lying more askew than this is not believed.
    min_area_frac
        A slab smaller than this share of the scan is not believed.
    """

    trim_px: int = 0
    max_angle_deg: float = 15.0
    min_area_frac: float = 0.4


@dataclass(frozen=True)
class SquaringRecord:
    """What squaring did.

    Attributes
    ----------
    squared
        Whether a slab was found and made upright; otherwise the scan was only trimmed.
    corners_px
        (row, col) of the top left, top right, bottom right and bottom left corner in the scan, pixel
        centres at +0.5; None if not found.
    angle_deg
        How far the slab lay askew, positive when its right end lay lower.
    edge_scatter_px
        Robust standard deviation of the edges about straight lines, the worst of the four; 0 if not found.
    chipped_frac
        Share of the squared slab that was masked because the surround shows there, 0 to 1.
    trim_px
        Taken off each side.
    size_before, size_after
        Sizes in pixels.
    summary
        One sentence for the report.
    matrix
        Takes homogeneous (row, col, 1) of the squared slab before trimming to (row, col, 1) of the scan, both with
        pixel centres at +0.5; None if not squared.
    """

    squared: bool
    corners_px: tuple[tuple[float, float], ...] | None
    angle_deg: float
    edge_scatter_px: float
    chipped_frac: float
    trim_px: int
    size_before: SizePx
    size_after: SizePx
    summary: str
    matrix: tuple[tuple[float, ...], ...] | None = None


def square_slab(
    image: FloatImage, valid: Mask, options: SquaringOptions | None = None, threads: int = 1
) -> tuple[FloatImage, Mask, SquaringRecord]:
    """Find a slab on the scanner's bed, make it an upright rectangle of its own size, and trim its sides.

    The bed must be uniform (dark or pale, vignetted or noisy) and visible on all four sides. Whenever the
    finding is doubtful, the scan is trimmed and otherwise left alone: a stone cut along a vein costs more
    than a border left standing. The rectangle is as wide as the mean of the slab's top and bottom edge and
    as high as the mean of the other two, rounded to whole pixels. Pixels are interpolated by a clamped
    cubic; if every corner lies within a quarter of a pixel of a whole pixel position of an upright
    rectangle, they are copied. Surround that shows through chips of the edges becomes invalid.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), linear XYZ D50.
    valid
        bool, (rows, cols).
    options
        Trim and limits.
    threads
        Never changes the result.

    Returns
    -------
    image, valid
        New arrays, or those given where nothing was done.
    record

    Raises
    ------
    ValueError
        If image or mask break the conventions, the trim is negative or would leave nothing.
    """
    check_pair(image, valid)
    options = SquaringOptions() if options is None else options
    if options.trim_px < 0:
        raise ValueError(f"trim of {options.trim_px} px is negative")
    surround = find_surround(image, valid, threads)
    if isinstance(surround, str):
        return _trimmed_only(image, valid, options, surround)
    edges = find_edges(image, valid, surround)
    if isinstance(edges, str):
        return _trimmed_only(image, valid, options, edges)
    doubt = _doubt(edges.corners_px, valid.shape, options)
    if doubt is not None:
        return _trimmed_only(image, valid, options, doubt)
    return _squared(image, valid, options, surround, edges, threads)


def _trimmed_only(
    image: FloatImage, valid: Mask, options: SquaringOptions, reason: str
) -> tuple[FloatImage, Mask, SquaringRecord]:
    before = SizePx(*valid.shape)
    after = _after_trim(before, options.trim_px)
    inner = np.s_[options.trim_px : options.trim_px + after.rows, options.trim_px : options.trim_px + after.cols]
    done = f"trimmed by {options.trim_px} px, not squared" if options.trim_px else "nothing"
    record = SquaringRecord(
        squared=False,
        corners_px=None,
        angle_deg=0.0,
        edge_scatter_px=0.0,
        chipped_frac=0.0,
        trim_px=options.trim_px,
        size_before=before,
        size_after=after,
        summary=f"{done}, because {reason}",
    )
    # Where nothing was trimmed these are the arrays themselves.
    return np.ascontiguousarray(image[inner]), np.ascontiguousarray(valid[inner]), record


def _squared(
    image: FloatImage, valid: Mask, options: SquaringOptions, surround: Surround, edges: Edges, threads: int
) -> tuple[FloatImage, Mask, SquaringRecord]:
    corners = edges.corners_px
    top, right, bottom, left = (float(np.linalg.norm(corners[(side + 1) % 4] - corners[side])) for side in range(4))
    whole = SizePx(rows=math.floor((left + right) / 2 + 0.5), cols=math.floor((top + bottom) / 2 + 0.5))
    rectangle = np.array([(0, 0), (0, whole.cols), (whole.rows, whole.cols), (whole.rows, 0)], np.float64)
    origin = np.round((corners - rectangle).mean(axis=0))
    upright = bool(np.abs(corners - rectangle - origin).max() <= _UPRIGHT_PX)
    matrix = homography(rectangle, rectangle + origin if upright else corners)
    after = _after_trim(whole, options.trim_px)
    masked, chipped = _without_chips(valid, surround, corners)
    out = np.empty((after.rows, after.cols, 3), np.float32)
    out_valid = np.empty((after.rows, after.cols), np.bool_)
    trim = options.trim_px
    over_bands(
        lambda band: warp_rows(image, masked, matrix, trim + band.start, trim, out[band], out_valid[band]),
        after.rows,
        _BAND_ROWS,
        threads,
    )
    if not out_valid.any():
        return _trimmed_only(image, valid, options, "no valid pixel lies on what looks like the slab")
    tangent = corners[1] - corners[0] + corners[2] - corners[3]
    angle = math.degrees(math.atan2(tangent[0], tangent[1]))
    how = "cut out where it lay" if upright else f"turned upright by {abs(angle):.2f} degrees"
    summary = (
        f"slab found and {how}, edges straight to {edges.scatter_px:.1f} px, trimmed by "
        f"{options.trim_px} px: {after.cols} x {after.rows} px of {valid.shape[1]} x {valid.shape[0]} remain"
    )
    if chipped > 0.0:
        summary += f", {100 * chipped:.2f} % masked at chipped edges"
    record = SquaringRecord(
        squared=True,
        corners_px=tuple((float(row), float(col)) for row, col in corners),
        angle_deg=angle,
        edge_scatter_px=edges.scatter_px,
        chipped_frac=chipped,
        trim_px=options.trim_px,
        size_before=SizePx(*valid.shape),
        size_after=after,
        summary=summary,
        matrix=tuple(tuple(float(value) for value in row) for row in matrix),
    )
    return out, out_valid, record


def homography(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Projective transform, float64 (3, 3), that takes four (row, col) points to four others."""
    rows: list[list[float]] = []
    for (y, x), (v, u) in zip(source, target, strict=True):
        rows.append([y, x, 1, 0, 0, 0, -v * y, -v * x])
        rows.append([0, 0, 0, y, x, 1, -u * y, -u * x])
    solved = np.linalg.solve(np.array(rows, np.float64), target.reshape(8))
    return np.append(solved, 1.0).reshape(3, 3)


def _after_trim(size: SizePx, trim_px: int) -> SizePx:
    after = SizePx(size.rows - 2 * trim_px, size.cols - 2 * trim_px)
    if after.rows < 1 or after.cols < 1:
        raise ValueError(f"a trim of {trim_px} px leaves nothing of {size.cols} x {size.rows} px")
    return after


def _doubt(corners: NDArray[np.float64], shape: tuple[int, ...], options: SquaringOptions) -> str | None:
    """Why a quadrilateral is not to be believed a slab; None if it is."""
    sides = np.roll(corners, -1, axis=0) - corners
    turns = sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0] - sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1]
    if (turns <= 0.0).any():
        return "the outline found is not convex"
    row, col = corners[:, 0], corners[:, 1]
    area = 0.5 * abs(float(col @ np.roll(row, -1) - row @ np.roll(col, -1)))
    if area < options.min_area_frac * shape[0] * shape[1]:
        share = 100 * area / (shape[0] * shape[1])
        return f"the outline found covers only {share:.0f} % of the scan"
    if (corners < -0.5).any() or (corners > np.array(shape) + 0.5).any():
        return "a corner of the slab lies outside the scan"
    lengths = np.linalg.norm(sides, axis=1)
    directions = np.degrees(np.arctan2(sides[:, 0], sides[:, 1])) - np.array([0.0, 90.0, 180.0, 270.0])
    askew = (directions + 180.0) % 360.0 - 180.0
    if np.abs(askew).max() > options.max_angle_deg:
        return f"the outline found lies {np.abs(askew).max():.0f} degrees askew"
    corner_angles = np.abs(askew - np.roll(askew, 1))
    if corner_angles.max() > _MAX_CORNER_DEVIATION_DEG:
        return f"a corner of the outline found is {corner_angles.max():.0f} degrees off a right angle"
    ratios = lengths[:2] / lengths[2:]
    if max(ratios.max(), (1 / ratios).max()) > _MAX_SIDE_RATIO:
        return "opposite sides of the outline found differ by more than a tenth"
    return None


def _without_chips(valid: Mask, surround: Surround, corners: NDArray[np.float64]) -> tuple[Mask, float]:
    """The mask less the cells inside the outline where the surround shows, and their share of the slab.

    Where more than a few per cent of the slab look like the surround, it is rather the stone that resembles
    it, and nothing is masked.
    """
    cell_px = surround.cell_px
    rows, cols = surround.bed.shape
    y, x = np.meshgrid((np.arange(rows) + 0.5) * cell_px, (np.arange(cols) + 0.5) * cell_px, indexing="ij")
    depth = np.full(surround.bed.shape, np.inf)
    for side in range(4):
        start, end = corners[side], corners[(side + 1) % 4]
        tangent = (end - start) / np.linalg.norm(end - start)
        depth = np.minimum(depth, (y - start[0]) * tangent[1] - (x - start[1]) * tangent[0])
    inside = depth > 0.0
    deep = surround.bed & (depth > 2.0 * cell_px)
    chips = ndimage.binary_dilation(deep, np.ones((7, 7))) & inside
    share = float(chips.sum() / max(int(inside.sum()), 1))
    if share == 0.0 or share > _MAX_CHIPPED_FRAC:
        return valid, 0.0
    masked = valid.copy()
    for row, col in zip(*np.nonzero(chips), strict=True):
        masked[row * cell_px : (row + 1) * cell_px, col * cell_px : (col + 1) * cell_px] = False
    return masked, share
