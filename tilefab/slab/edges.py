"""The four edges of a slab, to a fraction of a pixel: coarse on cells, then on strips of the full scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tilefab.slab.surround import Surround
from tilefab.types import FloatImage, Mask

_SAMPLES = 240
_ALONG = (0.05, 0.95)
_MIN_CONTRAST_OVER_NOISE = 4.0
_STRAIGHT_FRAC = 0.0015
_MIN_INLIER_SHARE = 0.5

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Edges:
    """A slab's outline.

    Attributes
    ----------
    corners_px
        float64, (4, 2): (row, col) of the top left, top right, bottom right and bottom left corner, in
        pixels of the scan with pixel centres at +0.5.
    scatter_px
        Robust standard deviation of the edge samples about their line, the worst of the four sides.
    inlier_share
        Share of the samples that lie on their line, the worst of the four sides.
    """

    corners_px: Vector
    scatter_px: float
    inlier_share: float


def rough_corners(slab: Mask) -> Vector:
    """Corners of a turned rectangle (under 45 degrees) of True cells: its extremes along both diagonals."""
    row, col = np.nonzero(slab)
    ends = (
        ((row + col).argmin(), 0, 0),
        ((col - row).argmax(), 0, 1),
        ((row + col).argmax(), 1, 1),
        ((row - col).argmax(), 1, 0),
    )
    return np.array([(row[index] + dr, col[index] + dc) for index, dr, dc in ends], np.float64)


def find_edges(image: FloatImage, valid: Mask, surround: Surround) -> Edges | str:
    """Fit a line to each side of the slab, or say in words why that can't be relied on.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), linear XYZ D50.
    valid
        bool, (rows, cols).
    surround
        From `find_surround`.

    Returns
    -------
    Edges or str
    """
    cell_px = surround.cell_px
    corners = rough_corners(surround.slab)
    for reach_share in (0.06, 0.02):
        fitted = _refit(corners, reach_share, surround.slab)
        if isinstance(fitted, str):
            return fitted
        corners = fitted.corners_px
    corners = corners * cell_px
    edges: Edges | str = "the slab's edges are hard to see"
    for reach_px in (2.5 * cell_px + 4.0, cell_px + 6.0):
        edges = _refine(corners, reach_px, image, valid)
        if isinstance(edges, str):
            return edges
        corners = edges.corners_px
    return edges


def _refit(corners: Vector, reach_share: float, slab: Mask) -> Edges | str:
    """Lines through the first slab cells met when walking inward across each side."""
    lines = []
    for side in range(4):
        start, end, inward, length = _side(corners, side)
        reach = max(3.0, reach_share * length)
        steps = np.arange(-reach, reach, 0.5)
        along = np.linspace(*_ALONG, _SAMPLES)
        points = start + along[:, None] * (end - start)
        at = np.floor(points[:, None, :] + steps[None, :, None] * inward).astype(np.int64)
        inside = ((at >= 0) & (at < slab.shape)).all(axis=-1)
        at = np.clip(at, 0, np.array(slab.shape) - 1)
        hit = slab[at[..., 0], at[..., 1]] & inside
        found = hit.any(axis=1)
        if found.mean() < _MIN_INLIER_SHARE:
            return "the slab's outline has gaps"
        offsets = steps[hit.argmax(axis=1)]
        lines.append(_fit_line(along[found], offsets[found], len(along), length, floor_px=1.0))
    return _outline(corners, lines)


def _refine(corners: Vector, reach_px: float, image: FloatImage, valid: Mask) -> Edges | str:
    """Lines through the places where light is half way between bed and stone, on strips of the full scan."""
    lines = []
    for side in range(4):
        start, end, inward, length = _side(corners, side)
        along = np.linspace(*_ALONG, _SAMPLES)
        steps = np.arange(-reach_px, reach_px + 0.25, 0.5)
        tangent = (end - start) / length
        points = start + along[:, None] * (end - start)
        profiles = np.zeros((len(along), len(steps), 3))
        known = np.ones(profiles.shape[:2], np.bool_)
        shifts = (-1.5, -0.5, 0.5, 1.5)
        for shift in shifts:
            at = points[:, None, :] + steps[None, :, None] * inward + shift * tangent
            light, good = _bilinear(image, valid, at)
            profiles += light / len(shifts)
            known &= good
        offsets = np.array([_crossing(profiles[i], known[i], steps) for i in range(len(along))])
        found = np.isfinite(offsets)
        if found.mean() < _MIN_INLIER_SHARE:
            return "the stone is hardly to be told from the surround along an edge"
        lines.append(_fit_line(along[found], offsets[found], len(along), length, floor_px=0.3))
    return _outline(corners, lines)


def _side(corners: Vector, side: int) -> tuple[Vector, Vector, Vector, float]:
    """Start, end, inward unit normal and length of side 0 top, 1 right, 2 bottom, 3 left."""
    start, end = corners[side], corners[(side + 1) % 4]
    length = max(float(np.linalg.norm(end - start)), 1e-9)
    tangent = (end - start) / length
    return start, end, np.array([tangent[1], -tangent[0]]), length


def _crossing(profile: Vector, known: Mask, steps: Vector) -> float:
    """Where one profile passes from bed to stone, in pixels inward; NaN where that isn't clear."""
    quarter = len(steps) // 4
    outer, inner = known.copy(), known.copy()
    outer[quarter:] = False
    inner[:-quarter] = False
    if outer.sum() < 3 or inner.sum() < 3 or not known[quarter:].all():
        return float("nan")
    bed = np.median(profile[outer], axis=0)
    stone = np.median(profile[inner], axis=0)
    noise = float(np.sqrt(((profile[outer] - bed) ** 2).sum(axis=-1).mean()))
    place = float("nan")
    for _ in range(2):
        contrast = stone - bed
        strength = float(np.linalg.norm(contrast))
        if strength < max(_MIN_CONTRAST_OVER_NOISE * noise, 1e-4):
            return float("nan")
        level = (profile - bed) @ contrast / strength**2
        above = (level >= 0.5) & known
        firm = above[:-3] & above[1:-2] & above[2:-1] & above[3:]
        if not firm.any():
            return float("nan")
        first = int(firm.argmax())
        if first == 0:
            return float("nan")
        rise = level[first] - level[first - 1]
        place = float(steps[first] - (level[first] - 0.5) / rise * (steps[first] - steps[first - 1]))
        near = known & (steps > place + 1.5) & (steps < place + 5.0)
        if near.sum() < 3:
            return place
        stone = profile[near].mean(axis=0)
    return place


def _bilinear(image: FloatImage, valid: Mask, at: Vector) -> tuple[Vector, Mask]:
    """Light at (row, col), pixel centres at +0.5, and whether all four pixels are there and valid."""
    rows, cols = valid.shape
    place = at - 0.5
    base = np.floor(place).astype(np.int64)
    good: Mask = np.asarray(((base >= 0) & (base < (rows - 1, cols - 1))).all(axis=-1), np.bool_)
    base = np.clip(base, 0, (max(rows - 2, 0), max(cols - 2, 0)))
    frac = np.clip(place - base, 0.0, 1.0)
    light = np.zeros((*at.shape[:-1], 3))
    for dr in (0, 1):
        for dc in (0, 1):
            r, c = np.minimum(base[..., 0] + dr, rows - 1), np.minimum(base[..., 1] + dc, cols - 1)
            weight = np.abs(1 - dr - frac[..., 0]) * np.abs(1 - dc - frac[..., 1])
            light += weight[..., None] * image[r, c]
            good &= valid[r, c]
    return light, good


def _fit_line(
    along: Vector, offsets: Vector, asked: int, length: float, floor_px: float
) -> tuple[float, float, float, float]:
    """Offset at both ends of a side, scatter and inlier share: repeated medians, then Tukey's biweight.

    Repeated medians (Siegel 1982, "Robust regression using repeated medians", Biometrika 69(1)) stand up to
    nearly half of the samples being chips or dust.
    """
    slope, intercept = (float(value) for value in stats.siegelslopes(offsets, along))
    residual = offsets - (intercept + slope * along)
    scatter = max(1.4826 * float(np.median(np.abs(residual))), floor_px / 3.0)
    design = np.stack([np.ones_like(along), along], axis=-1)
    for _ in range(6):
        reach = 4.0 * max(scatter, floor_px / 3.0)
        weight = np.maximum(1.0 - (residual / reach) ** 2, 0.0)
        intercept, slope = np.linalg.lstsq(design * weight[:, None], offsets * weight, rcond=None)[0]
        residual = offsets - (intercept + slope * along)
        scatter = 1.4826 * float(np.median(np.abs(residual)))
    near = np.abs(residual) <= max(3.0 * floor_px, _STRAIGHT_FRAC * length, 4.0 * min(scatter, floor_px))
    quarters = np.bincount(np.minimum((along * 4).astype(int), 3), weights=near, minlength=4) / (asked / 4)
    covered = float(np.sort(quarters)[1])
    share = min(float(near.sum()) / asked, 1.0) if covered >= 0.3 else 0.0
    return float(intercept), float(intercept + slope), scatter, share


def _outline(corners: Vector, lines: list[tuple[float, float, float, float]]) -> Edges | str:
    """Corners where the four fitted lines meet, or why they make no slab."""
    ends = []
    for side, (at_start, at_end, _, _) in enumerate(lines):
        start, end, inward, _ = _side(corners, side)
        ends.append((start + at_start * inward, end + at_end * inward))
    share = min(line[3] for line in lines)
    if share < _MIN_INLIER_SHARE:
        return f"an edge is not straight (only {100 * share:.0f} % of its samples lie on a line)"
    out = np.empty((4, 2))
    for corner in range(4):
        (p, p_end), (q, q_end) = ends[corner - 1], ends[corner]
        d, e = p_end - p, q_end - q
        cross = d[0] * e[1] - d[1] * e[0]
        if abs(cross) < 1e-9:
            return "two neighbouring edges are parallel"
        t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / cross
        out[corner] = p + t * d
    return Edges(out, max(line[2] for line in lines), share)
