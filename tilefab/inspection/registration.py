"""Laying a fired tile's image exactly over the face that it should show.

First blocks of a small copy vote by phase correlation for a common shift, and say each how the tile is turned and
scaled; then a homography is refined from coarse to fine by Gauss-Newton steps, with a gain and an offset, on detail
that is freed of slow light. Weights are robust, so what is covered, broken off, or fired wrongly doesn't pull.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.chart.finding import fit_homography, project
from tilefab.inspection.registration_kernels import PARAMETERS, step_sums
from tilefab.inspection.registration_levels import (
    CORRELATED,
    LEAST_PIXELS,
    MAD,
    ImageSizes,
    Level,
    alike,
    gain_of,
    level_of,
    shown_px,
    trusted_px,
    worn_px,
)
from tilefab.inspection.registration_shifts import block_shifts
from tilefab.inspection.warping import check_matrix, scale_of, warp_mask_to_face, warp_to_face
from tilefab.types import Mask

__all__ = ["Registration", "register", "start_matrix", "warp_mask_to_face", "warp_to_face"]

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_FINEST_PX, _COARSEST_PX, _VOTING_PX = 640, 80, 256
_LEAST_SIDE_PX = 16
_REACH = 0.06
_SETTLED_VOTE_PX = 0.3
_BLOCK_APART_PX = (5.0, 3.0, 2.0)
_STEPS = 12
_SETTLED_PX = 0.004
_MOST_STEP_PX = 3.0
_BIWEIGHT = 4.685
_EDGE_BLUR_PX = 1.5
_MOST_DOUBT_PX = (0.15, 0.4)
_LEAST_LIKENESS = 0.1
_ALIKE_DOUBT = 0.02
_GRID = np.stack(np.meshgrid(np.linspace(0.1, 0.9, 5), np.linspace(0.1, 0.9, 5)), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Registration:
    """How a tile's face lies in its image.

    Attributes
    ----------
    matrix
        (3, 3) float64: from (x, y, 1) in pixels of the face grid to pixels of the image, last value 1.
    likeness
        Correlation of detail, -1 to 1, over what is seen, at the resolution of image or grid, whichever is coarser, and
        with at most 640 pixels along the longer side. Slow light doesn't touch it; noise makes it less than 1.
    converged
        Whether the steps came to rest where image and face are alike, and no less so than at the start; if not, the
        matrix is the start's.
    rms_step_px
        Root mean square of the last step over the face, pixels of the face grid.
    """

    matrix: Float64Array = field(repr=False)
    likeness: float
    converged: bool
    rms_step_px: float


def start_matrix(corners_px: NDArray[np.floating], shape: tuple[int, int]) -> Float64Array:
    """Homography (3, 3) from a face grid to an image, from where the face's corners lie.

    Parameters
    ----------
    corners_px
        (4, 2) image places (x, y) of the face's upper left, upper right, lower right and lower left corner.
    shape
        (rows, cols) of the face grid.

    Raises
    ------
    ValueError
        If the corners aren't (4, 2), or three of them lie on a line.

    Examples
    --------
    >>> matrix = start_matrix(np.array([[10.0, 5.0], [30.0, 5.0], [30.0, 45.0], [10.0, 45.0]]), (400, 200))
    >>> (matrix.round(9) + 0.0).tolist()
    [[0.1, 0.0, 10.0], [0.0, 0.1, 5.0], [0.0, 0.0, 1.0]]
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise ValueError(f"corners must be 4 finite places (x, y), but are {corners.tolist()}")
    sides = np.roll(corners, -1, axis=0) - corners
    areas = sides[:, 0] * np.roll(sides, -1, axis=0)[:, 1] - sides[:, 1] * np.roll(sides, -1, axis=0)[:, 0]
    if not (np.abs(areas) > 1e-6 * np.abs(sides).max() ** 2).all():
        raise ValueError(f"corners {corners.tolist()} must span an area, no three on a line")
    rows, cols = shape
    face = np.array([[0.0, 0.0], [cols, 0.0], [cols, rows], [0.0, rows]])
    return fit_homography(face, corners)


def register(
    predicted_l: Float32Array, fired_l: Float32Array, start: Float64Array, *, valid: Mask | None = None
) -> Registration:
    """Find where exactly a face lies in an image of its fired tile.

    Parameters
    ----------
    predicted_l
        (rows, cols) float32: L* that the face should have, 0 to 100.
    fired_l
        (R, C) float32: L* of the image; drifted, unevenly lit, noisy.
    start
        (3, 3): about where, from (x, y, 1) of the face grid to the image; off by at most 6 % of the longer side, and
        2 degrees.
    valid
        (R, C) bool: where the image shows the tile; ``None``: everywhere.

    Returns
    -------
    Registration
        Good to about a tenth of a pixel, of the image or the grid, whichever is coarser; a face too plain to be
        found so exactly keeps a simpler motion (no perspective, then a shift only), and one with nothing to hold on
        to stays where it was.

    Raises
    ------
    ValueError
        If arrays aren't float32 of two axes, are smaller than 16 pixels, hold NaN, the mask has another shape than
        the image, or start isn't a homography.

    References
    ----------
    S. Baker, I. Matthews, "Lucas-Kanade 20 years on: a unifying framework", International Journal of Computer Vision 56
    (2004), section 3.2 (inverse compositional steps); gain and offset as G. D. Evangelidis, E. Z. Psarakis,
    "Parametric image alignment using enhanced correlation coefficient maximization", IEEE Trans. PAMI 30 (2008) argue.
    """
    for name, values in (("predicted_l", predicted_l), ("fired_l", fired_l)):
        if values.ndim != 2 or values.dtype != np.float32 or min(values.shape) < _LEAST_SIDE_PX:
            raise ValueError(
                f"{name} must be float32 (rows, cols), {_LEAST_SIDE_PX} or more, not {values.dtype} {values.shape}"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds values that are no numbers")
    check_matrix(start)
    good = np.ones(fired_l.shape, dtype=np.bool_) if valid is None else valid
    if good.shape != fired_l.shape:
        raise ValueError(f"the mask's shape {good.shape} isn't that of the image {fired_l.shape}")
    # Where tile borders on something else, the camera's blur mixes the two.
    good = worn_px(good)
    image = ImageSizes(fired_l, good)
    matrix = began = np.asarray(start / start[2, 2], dtype=np.float64)

    longer = max(predicted_l.shape)
    finest = max(1, -(-longer // _FINEST_PX), math.floor(1.0 / max(scale_of(matrix, predicted_l.shape), 1e-6) + 0.5))
    finest = max(1, min(finest, min(predicted_l.shape) // _LEAST_SIDE_PX))
    voting = max(finest, round(longer / _VOTING_PX))
    began_alike = alike(level_of(predicted_l, image, matrix, voting)) - _ALIKE_DOUBT
    matrix = _voted(predicted_l, image, matrix, voting)
    trusted = trusted_px(predicted_l, image, matrix, voting)

    factors = [finest]
    while longer / (2 * factors[-1]) >= _COARSEST_PX and min(predicted_l.shape) // (2 * factors[-1]) >= _LEAST_SIDE_PX:
        factors.append(2 * factors[-1])
    step, rested = math.inf, False
    for factor in reversed(factors):
        level = level_of(predicted_l, image, matrix, factor, trusted)
        matrix, step, rested = _refined(level, matrix)
    likeness = alike(level)
    if rested:
        matrix, step, rested = _refined(level_of(predicted_l, image, matrix, finest, shown_px(level)), matrix)
    if not rested or alike(level_of(predicted_l, image, matrix, voting)) < began_alike:
        return Registration(began, alike(level_of(predicted_l, image, began, finest)), False, step)
    return Registration(matrix, likeness, likeness >= _LEAST_LIKENESS, step)


def _voted(predicted_l: Float32Array, image: ImageSizes, matrix: Float64Array, factor: int) -> Float64Array:
    """The matrix moved, turned and stretched as blocks say by phase correlation."""
    for apart in _BLOCK_APART_PX:
        level = level_of(predicted_l, image, matrix, factor)
        rows, cols = level.template.shape
        block = min(rows, cols, max(_LEAST_SIDE_PX, 2 * round(max(rows, cols) / 6)))
        said = block_shifts(
            level.template,
            level.moved,
            level.seen.astype(np.float32),
            block=block,
            reach=min(_REACH * max(rows, cols), 0.5 * block),
            apart=apart,
        )
        if not said.agreed:
            break
        motion = _motion_of_blocks(said.at, said.shift, said.weight, said.common)
        matrix = _composed(matrix, motion, factor)
        if np.sqrt((_moved(motion, (rows, cols)) ** 2).sum(axis=1).mean()) < _SETTLED_VOTE_PX:
            break
    return matrix


def _motion_of_blocks(
    at: Float64Array, shift: Float64Array, weight: Float64Array, common: tuple[float, float]
) -> Float64Array:
    """Affine map (3, 3) that the blocks' shifts follow, those that don't left out; a shift if too few answer."""
    motion = np.eye(3)
    motion[:2, 2] = common
    columns = np.column_stack([at, np.ones(len(at))])
    if len(at) < 6 or np.linalg.matrix_rank(columns - columns.mean(axis=0) * [1, 1, 0], tol=1.0) < 3:
        return motion
    kept = weight.copy()
    for _ in range(5):
        root = np.sqrt(kept)[:, np.newaxis]
        solution = np.linalg.lstsq(columns * root, shift * root, rcond=None)[0]
        away = np.hypot(*(shift - columns @ solution).T)
        kept = weight / (1.0 + (away / 0.5) ** 2) ** 2
    if (away < 1.0).sum() < 5:
        return motion
    motion[:2] = np.eye(3)[:2] + solution.T
    return motion


def _composed(matrix: Float64Array, motion: Float64Array, factor: int) -> Float64Array:
    """The matrix with a motion, of a level's pixels, done before it."""
    grow = np.diag([float(factor), float(factor), 1.0])
    out = matrix @ grow @ motion @ np.linalg.inv(grow)
    return np.asarray(out / out[2, 2], dtype=np.float64)


def _moved(motion: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """How far a motion moves a grid of places over the face, (P, 2) pixels."""
    places = _GRID * [shape[1], shape[0]]
    return project(motion, places) - places


def _refined(level: Level, matrix: Float64Array) -> tuple[Float64Array, float, bool]:
    """The matrix after Gauss-Newton steps on a level, the last step in grid pixels, and whether it came to rest."""
    shape = (level.template.shape[0], level.template.shape[1])
    slope_y, slope_x = (np.asarray(slope, dtype=np.float32) for slope in np.gradient(level.template))
    normal, gradient = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    motion = np.eye(3)
    difference = (level.moved - level.template)[level.seen]
    if len(difference) < LEAST_PIXELS:
        return matrix, math.inf, False
    photometric = np.array([gain_of(level), 0.0])
    spread = MAD * float(np.median(np.abs(difference)))
    half = 0.5 * max(shape)
    to_unit = np.array([[1 / half, 0, -0.5 * shape[1] / half], [0, 1 / half, -0.5 * shape[0] / half], [0, 0, 1]])
    size = math.inf
    for _ in range(_STEPS):
        cut = max(_BIWEIGHT * spread, 1e-3)
        weights, squares = step_sums(
            level.template,
            slope_x,
            slope_y,
            level.moved,
            level.seen,
            motion,
            photometric,
            cut,
            _EDGE_BLUR_PX,
            normal,
            gradient,
        )
        if weights < LEAST_PIXELS:
            return matrix, math.inf, False
        variance = max(squares / weights, 1e-8)
        step = _solved(np.triu(normal) + np.triu(normal, 1).T, gradient, variance, half)
        if step is None:
            return matrix, math.inf, False
        delta = np.array([[1 + step[0], step[1], step[2]], [step[3], 1 + step[4], step[5]], [step[6], step[7], 1.0]])
        # The step says how the template would have to move; the image's place moves the other way.
        change = np.linalg.inv(to_unit) @ np.linalg.inv(delta) @ to_unit
        size = float(np.sqrt((_moved(change, shape) ** 2).sum(axis=1).mean()))
        if not size < _MOST_STEP_PX:
            change, size = np.eye(3), math.inf
        motion = motion @ change
        motion /= motion[2, 2]
        photometric = np.array([max(photometric[0] + step[8], 0.05), photometric[1] + step[9]])
        # Biweights of 4.685 spreads see 0.87 of a Gaussian's variance.
        spread = min(spread, 1.15 * math.sqrt(variance)) if math.isfinite(size) else spread
        if size < _SETTLED_PX or not math.isfinite(size):
            break
    return _composed(matrix, motion, level.factor), size * level.factor, size < 10.0 * _SETTLED_PX


def _solved(normal: Float64Array, gradient: Float64Array, variance: float, half: float) -> Float64Array | None:
    """The step (10,) of the richest motion that the face's detail determines; None if not even a shift.

    A motion is determined if noise leaves the corners, or with perspective a smaller share of a pixel, in so little
    doubt. Neighbouring pixels' residuals are alike, so doubt is larger than their number says.
    """
    corners = np.array([[x, y] for x in (-1.0, 1.0) for y in (-1.0, 1.0)])
    motions = (([0, 1, 2, 3, 4, 5, 6, 7], _MOST_DOUBT_PX[0]), ([0, 1, 2, 3, 4, 5], _MOST_DOUBT_PX[1]), ([2, 5], 1.0))
    for places, most in motions:
        taken = [*places, 8, 9]
        part = normal[np.ix_(taken, taken)]
        scale = np.sqrt(np.maximum(np.diag(part), 1e-30))
        scaled = part / np.outer(scale, scale)
        if not np.linalg.eigvalsh(scaled)[0] > 1e-9:
            continue
        inverse = np.linalg.inv(scaled) / np.outer(scale, scale)
        doubt = 0.0
        for x, y in corners:
            lines = np.zeros((2, PARAMETERS))
            lines[0, [0, 1, 2, 6, 7]] = x, y, 1.0, -x * x, -x * y
            lines[1, [3, 4, 5, 6, 7]] = x, y, 1.0, -x * y, -y * y
            doubt += float(np.trace(lines[:, taken] @ inverse @ lines[:, taken].T))
        if half * math.sqrt(CORRELATED * variance * doubt / len(corners)) <= most:
            step = np.zeros(PARAMETERS)
            step[taken] = inverse @ gradient[taken]
            return step
    return None
