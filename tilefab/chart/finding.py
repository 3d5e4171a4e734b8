"""Finding a chart's tiles in a scan: dark squares, those of them that are marks, and how each tile lies.

Squares are looked for in a small copy of the scan, under several thresholds; what a square's modules say decides
whether it is a mark. The marks' edges are then found in the scan itself, to a fraction of a pixel: each edge as the
straight line through the points where its profile passes half way between dark and light. Ink that bleeds moves all
four edges of a mark by the same amount, and leaves its middle where it was.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from tilefab.chart.layout import ChartLayout
from tilefab.chart.marks import MODULES, Mark, read_mark
from tilefab.errors import ProfileError

Float64Array = NDArray[np.float64]

_SEARCH_PX = 1500
_LEAST_SIDE_PX = 14
_LARGEST_SHARE = 0.25
_WINDOW_SHARES = (0.03, 0.1)
_DARKER = 0.1
_SQUARE_FILL = 0.8
_SIDE_RATIO = 1.6
_LEAST_CONTRAST = 0.08
_LEAST_MARKS = 3
_EDGE_POINTS = 48
_EDGE_STEPS, _MOST_EDGE_STEPS = 41, 801
_EDGE_REACH = 0.85
_MOST_RESIDUAL_MODULES = 0.35


@dataclass(frozen=True, eq=False)
class TilePose:
    """How a chart's tile lies in a scan.

    Attributes
    ----------
    tile
        Which tile, from 0.
    homography
        (3, 3) float64: (x, y, 1) in pixels of the print to the same in pixels of the scan, up to a factor.
    marks
        How many of its four marks were found.
    residual_px
        Root mean square distance of the marks' corners from where the homography puts them, in pixels of the scan.
    scale
        Pixels of the scan for a pixel of the print, at the tile's middle.
    turn_degrees
        How far the tile is turned clockwise in the scan, -180 to 180.
    """

    tile: int
    homography: Float64Array = field(repr=False)
    marks: int
    residual_px: float
    scale: float
    turn_degrees: float

    def to_scan(self, points_xy: Float64Array) -> Float64Array:
        """Points of the print, (..., 2) x and y in pixels, in the scan."""
        return project(self.homography, points_xy)


def project(homography: Float64Array, points_xy: Float64Array) -> Float64Array:
    """Points (..., 2) through a homography (3, 3)."""
    moved = points_xy @ homography[:, :2].T + homography[:, 2]
    return np.asarray(moved[..., :2] / moved[..., 2:], dtype=np.float64)


def fit_homography(source_xy: Float64Array, target_xy: Float64Array) -> Float64Array:
    """Homography (3, 3) that takes source points (P, 2) nearest to target points (P, 2), P >= 4.

    References
    ----------
    R. Hartley, A. Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, algorithm 4.2.
    """

    def normal(points: Float64Array) -> Float64Array:
        middle = points.mean(axis=0)
        scale = np.sqrt(2.0) / max(float(np.linalg.norm(points - middle, axis=1).mean()), 1e-12)
        return np.array([[scale, 0, -scale * middle[0]], [0, scale, -scale * middle[1]], [0, 0, 1]])

    from_source, from_target = normal(source_xy), normal(target_xy)
    a, b = project(from_source, source_xy), project(from_target, target_xy)
    one, none = np.ones(len(a)), np.zeros((len(a), 3))
    place = np.column_stack([a, one])
    rows_x = np.hstack([place, none, -b[:, :1] * place])
    rows_y = np.hstack([none, place, -b[:, 1:] * place])
    solution = np.linalg.svd(np.vstack([rows_x, rows_y]))[2][-1].reshape(3, 3)
    out = np.linalg.inv(from_target) @ solution @ from_source
    return np.asarray(out / out[2, 2], dtype=np.float64)


def find_tiles(grey: NDArray[np.float32], layout: ChartLayout, name: str = "the scan") -> tuple[TilePose, ...]:
    """All tiles of a chart in a scan, turned however they are.

    Parameters
    ----------
    grey
        (rows, cols) float32 brightness, 0 to 1, any tone curve.
    layout
        The chart.
    name
        What to call the scan in messages.

    Returns
    -------
    tuple of TilePose
        By tile; one or more.

    Raises
    ------
    ProfileError
        If no tile has three marks to be found, they are another chart's, or they don't fit together.
    """
    low, high = (float(v) for v in np.percentile(grey[:: max(1, len(grey) // 500)], (1, 99)))
    found: dict[tuple[int, int], dict[int, Float64Array]] = {}
    step = max(1, -(-max(grey.shape) // _SEARCH_PX))
    while high > low:
        small = _smaller(grey, step)
        for mark, quad in _marks_in(small, high - low):
            found.setdefault((mark.chart, mark.tile), {}).setdefault(mark.corner, quad * step)
        if step == 1 or any(len(corners) == 4 for corners in found.values()):
            break
        step = -(-step // 2)
    whole = {key: corners for key, corners in found.items() if len(corners) >= _LEAST_MARKS}
    if not whole:
        most = max((len(corners) for corners in found.values()), default=0)
        raise ProfileError(
            f"{name}: {most} of a tile's 4 corner marks are found, and 3 are needed: scan the whole tile, sharp and "
            "straight from above, with its corners in sight",
            path=name,
        )
    poses = [_pose(grey, layout, key[1], corners, name) for key, corners in whole.items() if key[0] == layout.chart]
    if not poses:
        raise ProfileError(f"{name}: shows a tile of another chart: give the list that its chart came with", path=name)
    return tuple(sorted(poses, key=lambda pose: pose.tile))


def _smaller(grey: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Means of squares of ``step`` pixels; what is left over at the far edges is dropped."""
    if step == 1:
        return grey
    rows, cols = grey.shape[0] // step, grey.shape[1] // step
    out = np.zeros((rows, cols), dtype=np.float32)
    for row in range(step):
        for col in range(step):
            out += grey[row : rows * step : step, col : cols * step : step]
    out *= np.float32(1.0 / (step * step))
    return out


def _marks_in(grey: NDArray[np.float32], contrast: float) -> list[tuple[Mark, Float64Array]]:
    """Marks of an image with their corners, (4, 2) x and y, the mark's own top left first and then clockwise."""
    side = max(grey.shape)
    light = np.float32(np.percentile(grey, 90))
    masks = [grey < light - np.float32(0.5 * contrast)]
    for share in _WINDOW_SHARES:
        mean = ndimage.uniform_filter(grey, max(3, round(share * side)), mode="nearest")
        masks.append(grey < mean - np.float32(_DARKER * contrast))
    out: list[tuple[Mark, Float64Array]] = []
    taken: set[Mark] = set()
    for mask in masks:
        labels, _ = ndimage.label(mask, structure=np.ones((3, 3), dtype=int))
        for number, box in enumerate(ndimage.find_objects(labels), start=1):
            rows, cols = box[0].stop - box[0].start, box[1].stop - box[1].start
            if min(rows, cols) < _LEAST_SIDE_PX or max(rows, cols) > min(_LARGEST_SHARE * side, 2 * min(rows, cols)):
                continue
            quad = _quad(labels[box] == number)
            if quad is None:
                continue
            quad = quad + np.array([box[1].start, box[0].start])
            said = _decode(grey, quad, contrast)
            if said is not None and said[0] not in taken:
                taken.add(said[0])
                out.append((said[0], np.roll(quad, -said[1], axis=0)))
    return out


def _quad(mask: NDArray[np.bool_]) -> Float64Array | None:
    """Corners of a square that a shape fills nearly, (4, 2) x and y, clockwise; None if it is no square."""
    rows = np.flatnonzero(mask.any(axis=1))
    first = mask[rows].argmax(axis=1)
    last = mask.shape[1] - mask[rows, ::-1].argmax(axis=1)
    points = np.concatenate([np.column_stack([cols, rows + edge]) for cols in (first, last) for edge in (0, 1)]).astype(
        np.float64
    )
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    edge = points[hull.vertices]
    apart = np.linalg.norm(edge[:, np.newaxis] - edge[np.newaxis], axis=2)
    one, other = np.unravel_index(int(np.argmax(apart)), apart.shape)
    along = edge[other] - edge[one]
    side = (along[0] * (edge[:, 1] - edge[one, 1]) - along[1] * (edge[:, 0] - edge[one, 0])) / max(apart.max(), 1e-9)
    corners = np.array([edge[one], edge[int(np.argmin(side))], edge[other], edge[int(np.argmax(side))]])
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    x, y = corners.T
    area = 0.5 * float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    if lengths.min() <= 0 or lengths.max() > _SIDE_RATIO * lengths.min() or abs(area) < _SQUARE_FILL * hull.volume:
        return None
    return corners if area > 0 else corners[::-1].copy()


def _decode(grey: NDArray[np.float32], quad: Float64Array, contrast: float) -> tuple[Mark, int] | None:
    """What the modules within a square say, as `read_mark` does; the square's surround must be light."""
    square = np.array([[0, 0], [MODULES, 0], [MODULES, MODULES], [0, MODULES]], dtype=np.float64)
    centres = np.arange(-1, MODULES + 1) + 0.5
    offsets = np.array([-0.2, 0.0, 0.2])
    x, y = np.meshgrid((centres[:, np.newaxis] + offsets).ravel(), (centres[:, np.newaxis] + offsets).ravel())
    level = _at(grey, project(fit_homography(square, quad), np.stack([x, y], axis=-1)))
    level = level.reshape(MODULES + 2, 3, MODULES + 2, 3).mean(axis=(1, 3))
    ring = np.zeros(level.shape, dtype=bool)
    ring[1:-1, 1:-1] = True
    ring[2:-2, 2:-2] = False
    outside = np.ones(level.shape, dtype=bool)
    outside[1:-1, 1:-1] = False
    dark, light = float(np.median(level[ring])), float(np.median(level[outside]))
    if light - dark < _LEAST_CONTRAST * contrast:
        return None
    return read_mark(level[1:-1, 1:-1] < (dark + light) / 2.0)


def _at(grey: NDArray[np.float32], points_xy: Float64Array) -> Float64Array:
    """Brightness between pixels, their centres at +0.5; beyond the image, that of its edge."""
    places = [points_xy[..., 1] - 0.5, points_xy[..., 0] - 0.5]
    return np.asarray(ndimage.map_coordinates(grey, places, order=1, mode="nearest"), dtype=np.float64)


def _pose(
    grey: NDArray[np.float32], layout: ChartLayout, tile: int, corners: dict[int, Float64Array], name: str
) -> TilePose:
    if tile >= layout.tiles:
        raise ProfileError(f"{name}: shows tile {tile + 1}, but the chart has {layout.tiles}", path=name)
    printed, seen = [], []
    side = layout.mark_px
    for corner, quad in sorted(corners.items()):
        top, left = layout.mark_corner(corner)
        printed.append(np.array([[left, top], [left + side, top], [left + side, top + side], [left, top + side]]))
        seen.append(_refine(grey, _refine(grey, quad)))
    source, target = np.concatenate(printed).astype(np.float64), np.concatenate(seen)
    homography = fit_homography(source, target)
    # Ink bleeds, and a scan's tone curve moves the half-way point: all marks look larger or smaller than printed.
    looks = project(np.asarray(np.linalg.inv(homography), dtype=np.float64), target).reshape(-1, 4, 2)
    sides = np.linalg.norm(looks - np.roll(looks, 1, axis=1), axis=2)
    grown = (float(np.median(sides)) - side) / 2.0
    source += grown * np.tile([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], (len(corners), 1))
    homography = fit_homography(source, target)
    residual = float(np.sqrt(((project(homography, source) - target) ** 2).sum(axis=1).mean()))
    middle = np.array([layout.tile.cols / 2.0, layout.tile.rows / 2.0])
    ends = project(homography, middle + np.array([[-side, 0.0], [side, 0.0]]))
    along = ends[1] - ends[0]
    scale = float(np.linalg.norm(along)) / (2.0 * side)
    if not residual <= _MOST_RESIDUAL_MODULES * layout.module_px * scale:
        raise ProfileError(
            f"{name}: the marks of tile {tile + 1} don't lie as they were printed (off by {residual:.1f} pixels): scan "
            "it flat, or give the list that its chart came with",
            path=name,
        )
    return TilePose(tile, homography, len(corners), residual, scale, float(np.degrees(np.arctan2(along[1], along[0]))))


def _refine(grey: NDArray[np.float32], quad: Float64Array) -> Float64Array:
    """Corners of a mark where straight lines through its edges meet; (4, 2) in, (4, 2) out."""
    lines = []
    for place in range(4):
        start, end = quad[place], quad[(place + 1) % 4]
        length = float(np.linalg.norm(end - start))
        along = (end - start) / length
        outward = np.array([along[1], -along[0]])  # the corners run clockwise, with y down
        reach = _EDGE_REACH * length / MODULES
        # Steps of half a pixel, or an edge that is sharper would be put anywhere between two of them.
        across = np.linspace(-reach, reach, int(np.clip(4.0 * reach, _EDGE_STEPS, _MOST_EDGE_STEPS)))
        down = np.linspace(0.08, 0.92, _EDGE_POINTS) * length
        points = start + down[:, np.newaxis, np.newaxis] * along + across[:, np.newaxis] * outward
        level = _at(grey, points)
        quarter = len(across) // 4
        dark, light = float(np.median(level[:, :quarter])), float(np.median(level[:, -quarter:]))
        above = level >= (dark + light) / 2.0
        first = np.argmax(above, axis=1)
        good = above.any(axis=1) & (first > 0) & (light > dark)
        if good.sum() < _EDGE_POINTS // 3:
            return quad
        row, col = np.flatnonzero(good), first[good]
        before, after = level[row, col - 1], level[row, col]
        part = ((dark + light) / 2.0 - before) / np.maximum(after - before, 1e-12)
        offset = across[col - 1] + part * (across[1] - across[0])
        lines.append(_line(start, along, outward, down[good], offset))
    return np.array([_meet(lines[place - 1], lines[place]) for place in range(4)])


def _line(
    start: Float64Array, along: Float64Array, outward: Float64Array, down: Float64Array, offset: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Point and direction of the line through an edge's points, the worst of them left out."""
    keep = np.ones(len(down), dtype=bool)
    slope = level = 0.0
    for _ in range(4):
        slope, level = (float(value) for value in np.polyfit(down[keep], offset[keep], 1))
        away = np.abs(offset - level - slope * down)
        keep = away <= max(3.0 * 1.4826 * float(np.median(away)), 1e-6)
    return start + level * outward, along + slope * outward


def _meet(one: tuple[Float64Array, Float64Array], other: tuple[Float64Array, Float64Array]) -> Float64Array:
    """Where two lines cross."""
    steps = np.linalg.solve(np.column_stack([one[1], -other[1]]), other[0] - one[0])
    return np.asarray(one[0] + steps[0] * one[1], dtype=np.float64)
