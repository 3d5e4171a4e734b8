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
from scipy import ndimage

from tilefab.chart.finding import fit_homography, project
from tilefab.inspection.registration_kernels import PARAMETERS, resample, step_sums
from tilefab.inspection.registration_shifts import block_shifts
from tilefab.types import FloatImage, Mask

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

_FINEST_PX, _COARSEST_PX, _VOTING_PX = 640, 80, 256
_LEAST_SIDE_PX = 16
_REACH = 0.06
_VOTES = 3
_SETTLED_VOTE_PX = 0.3
_BLOCK_APART_PX = (5.0, 3.0, 2.0)
_WINDOW = 1.0 / 6.0
_STEPS = 12
_SETTLED_PX = 0.004
_MOST_STEP_PX = 3.0
_BIWEIGHT = 4.685
_MAD = 1.4826
_EDGE_BLUR_PX = 1.5
_LEAST_PIXELS = 200
_MOST_DOUBT_PX = (0.15, 0.4)
_CORRELATED = 3.0
_LEAST_LIKENESS = 0.1
_ALIKE_DOUBT = 0.02
_FITTED_PIXELS, _TRUST_ROUNDS, _LEAST_SPREAD_L, _FAR_SPREADS = 6000, 8, 0.3, 4.0
_HALO, _LEAST_TRUSTED = 2, 0.3
_CLIP = 5.0
_BLURRED_PX = 2
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


class _Image:
    """L* and mask of an image, and means over squares of it as they are needed."""

    def __init__(self, fired_l: Float32Array, good: Mask) -> None:
        self._sizes = {1: np.stack([np.where(good, fired_l, 0.0), good], axis=-1).astype(np.float32)}

    def on_grid(self, matrix: Float64Array, shape: tuple[int, int]) -> tuple[Float32Array, Mask]:
        """L* on a grid, and where it is good; 0 elsewhere."""
        square = max(1, math.floor(_scale(matrix, shape) + 0.5))
        if square not in self._sizes:
            planes = [_reduced(np.ascontiguousarray(self._sizes[1][:, :, k]), square) for k in (0, 1)]
            self._sizes[square] = np.stack(planes, axis=-1)
        shrink = np.diag([1.0 / square, 1.0 / square, 1.0])
        warped, inside = warp_to_face(self._sizes[square], shrink @ matrix, shape)
        seen = inside & (warped[:, :, 1] > 0.99)
        return np.where(seen, warped[:, :, 0], np.float32(0.0)), seen


@dataclass(frozen=True, eq=False)
class _Level:
    """Template and image on one level: detail only, with the image's mask."""

    factor: int
    template: Float32Array
    moved: Float32Array
    seen: Mask


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
    >>> start_matrix(np.array([[10.0, 5.0], [30.0, 5.0], [30.0, 45.0], [10.0, 45.0]]), (400, 200)).round(9).tolist()
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


def warp_to_face(image: FloatImage, matrix: Float64Array, shape: tuple[int, int]) -> tuple[FloatImage, Mask]:
    """An image resampled onto the face grid.

    By Keys' cubic where the image is coarser than the grid or up to 1.5 times as fine, else by means over each grid
    pixel, so that nothing the image shows is skipped.

    Parameters
    ----------
    image
        (R, C, K) float32.
    matrix
        (3, 3): from (x, y, 1) in pixels of the face grid to pixels of the image.
    shape
        (rows, cols) of the face grid.

    Returns
    -------
    warped, inside
        (rows, cols, K) float32, and (rows, cols) bool: whether the pixel's middle lies in the image; 0 where it
        doesn't.

    Raises
    ------
    ValueError
        If the image isn't float32 of three axes, or the matrix isn't a homography.
    """
    if image.ndim != 3 or image.dtype != np.float32 or min(image.shape) < 1:
        raise ValueError(f"the image must be float32 (rows, cols, channels), not {image.dtype} {image.shape}")
    _check_matrix(matrix)
    taps = max(1, math.floor(_scale(matrix, shape) + 0.5))
    warped = np.empty((*shape, image.shape[2]), dtype=np.float32)
    inside = np.empty(shape, dtype=np.bool_)
    resample(np.ascontiguousarray(image), np.ascontiguousarray(matrix, dtype=np.float64), taps, warped, inside)
    return warped, inside


def warp_mask_to_face(mask: Mask, matrix: Float64Array, shape: tuple[int, int]) -> Mask:
    """A mask of the image on the face grid: True where only good pixels go into the value that `warp_to_face` gives."""
    warped, inside = warp_to_face(mask.astype(np.float32)[:, :, np.newaxis], matrix, shape)
    return np.asarray(inside & (np.abs(warped[:, :, 0] - 1.0) < 1e-3), dtype=np.bool_)


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
    _check_matrix(start)
    good = np.ones(fired_l.shape, dtype=np.bool_) if valid is None else valid
    if good.shape != fired_l.shape:
        raise ValueError(f"the mask's shape {good.shape} isn't that of the image {fired_l.shape}")
    # Where tile borders on something else, the camera's blur mixes the two.
    good = _worn(good)
    image = _Image(fired_l, good)
    matrix = began = np.asarray(start / start[2, 2], dtype=np.float64)

    longer = max(predicted_l.shape)
    finest = max(1, -(-longer // _FINEST_PX), math.floor(1.0 / max(_scale(matrix, predicted_l.shape), 1e-6) + 0.5))
    finest = max(1, min(finest, min(predicted_l.shape) // _LEAST_SIDE_PX))
    voting = max(finest, round(longer / _VOTING_PX))
    alike = _alike(_level(predicted_l, image, matrix, voting)) - _ALIKE_DOUBT
    matrix = _voted(predicted_l, image, matrix, voting)
    trusted = _trusted(predicted_l, image, matrix, voting)

    factors = [finest]
    while longer / (2 * factors[-1]) >= _COARSEST_PX and min(predicted_l.shape) // (2 * factors[-1]) >= _LEAST_SIDE_PX:
        factors.append(2 * factors[-1])
    step, rested = math.inf, False
    for factor in [*reversed(factors), finest]:
        level = _level(predicted_l, image, matrix, factor, trusted)
        matrix, step, rested = _refined(level, matrix)
    likeness = _alike(level)
    if not rested or _alike(_level(predicted_l, image, matrix, voting)) < alike:
        return Registration(began, _alike(_level(predicted_l, image, began, finest)), False, step)
    return Registration(matrix, likeness, likeness >= _LEAST_LIKENESS, step)


def _check_matrix(matrix: Float64Array) -> None:
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not abs(np.linalg.det(matrix)) > 1e-12:
        raise ValueError(f"no homography: {np.asarray(matrix).tolist()}")


def _scale(matrix: Float64Array, shape: tuple[int, int]) -> float:
    """Pixels of the image for one of the grid, at its middle."""
    x, y = 0.5 * shape[1], 0.5 * shape[0]
    across, down, middle = project(matrix, np.array([[x + 0.5, y], [x, y + 0.5], [x, y]]))
    one, other = 2.0 * (across - middle), 2.0 * (down - middle)
    return float(math.sqrt(abs(one[0] * other[1] - one[1] * other[0])))


def _worn(mask: Mask) -> Mask:
    """The mask less what lies within ``_BLURRED_PX`` of its edges; the image's own border is no such edge."""
    worn = mask.copy()
    for _ in range(_BLURRED_PX):
        for axis in (0, 1):
            lines = np.moveaxis(worn, axis, 0)
            before = lines.copy()
            lines[1:] &= before[:-1]
            lines[:-1] &= before[1:]
    return worn


def _reduced(values: Float32Array, factor: int) -> Float32Array:
    """Means of squares of ``factor`` pixels; what is left over at the far edges is dropped."""
    if factor == 1:
        return values
    rows, cols = values.shape[0] // factor, values.shape[1] // factor
    out = np.zeros((rows, cols), dtype=np.float32)
    for row in range(factor):
        for col in range(factor):
            out += values[row : rows * factor : factor, col : cols * factor : factor]
    out *= np.float32(1.0 / (factor * factor))
    return out


def _detail(values: Float32Array, weight: Float32Array, window: int) -> Float32Array:
    """Values less their weighted mean over a square window, a little smoothed; 0 where the weight is."""
    mean_weight = np.maximum(ndimage.uniform_filter(weight, window, mode="constant"), np.float32(1e-4))
    mean = ndimage.uniform_filter(values * weight, window, mode="constant") / mean_weight
    detail = (values - mean) * weight
    for axis in (0, 1):
        detail = ndimage.convolve1d(detail, np.array([0.25, 0.5, 0.25], dtype=np.float32), axis=axis, mode="nearest")
    return np.asarray(detail * weight, dtype=np.float32)


def _level(
    predicted_l: Float32Array, image: _Image, matrix: Float64Array, factor: int, trusted: Mask | None = None
) -> _Level:
    """Both pictures on the face grid reduced by a factor, the image as the matrix has it; only what is trusted."""
    template = _reduced(predicted_l, factor)
    to_image = matrix @ np.diag([float(factor), float(factor), 1.0])
    fired, seen = image.on_grid(to_image, (template.shape[0], template.shape[1]))
    if trusted is not None:
        rows, cols = (
            np.minimum((np.arange(length) + 0.5) * many / length, many - 1).astype(int)
            for length, many in zip(template.shape, trusted.shape, strict=True)
        )
        seen = seen & trusted[np.ix_(rows, cols)]
    weight = seen.astype(np.float32)
    window = 2 * max(3, round(0.5 * _WINDOW * max(template.shape))) + 1
    return _Level(factor, _detail(template, weight, window), _detail(fired, weight, window), seen)


def _trusted(predicted_l: Float32Array, image: _Image, matrix: Float64Array, factor: int) -> Mask:
    """Where a small copy of the image may show the face: not where its L* is far off, as of what lies upon the tile.

    Fired L* follows the predicted one and a second-order surface, of drift and light. Beside edges anything between
    the two sides may be seen.
    """
    template = _reduced(predicted_l, factor)
    rows, cols = template.shape
    fired, seen = image.on_grid(matrix @ np.diag([float(factor), float(factor), 1.0]), (rows, cols))
    if seen.sum() < _LEAST_PIXELS:
        return seen
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    columns = np.stack([np.ones_like(x), template, x, y, x * x, x * y, y * y], axis=-1)
    some = np.flatnonzero(seen)[:: max(1, int(seen.sum()) // _FITTED_PIXELS)]
    lines, wanted = columns.reshape(-1, 7)[some], fired.reshape(-1)[some]
    weight = np.ones(len(some))
    for _ in range(_TRUST_ROUNDS):
        ridge = 1e-6 * weight.sum() * np.eye(7)
        solution = np.linalg.solve((lines.T * weight) @ lines + ridge, lines.T @ (weight * wanted))
        away = np.abs(wanted - lines @ solution)
        spread = max(_MAD * float(np.median(away)), _LEAST_SPREAD_L)
        weight = 1.0 / (1.0 + (away / spread) ** 2) ** 2
    range_l = ndimage.maximum_filter(template, 5) - ndimage.minimum_filter(template, 5)
    away = np.abs(ndimage.uniform_filter(fired - columns @ solution, 3))
    other = seen & (away > _FAR_SPREADS * spread + range_l)
    trusted = ~ndimage.maximum_filter(other, 2 * _HALO + 1)
    return trusted if (trusted & seen).sum() >= _LEAST_TRUSTED * seen.sum() else np.ones_like(seen)


def _voted(predicted_l: Float32Array, image: _Image, matrix: Float64Array, factor: int) -> Float64Array:
    """The matrix moved, turned and stretched as blocks say by phase correlation."""
    for apart in _BLOCK_APART_PX:
        level = _level(predicted_l, image, matrix, factor)
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


def _refined(level: _Level, matrix: Float64Array) -> tuple[Float64Array, float, bool]:
    """The matrix after Gauss-Newton steps on a level, the last step in grid pixels, and whether it came to rest."""
    shape = (level.template.shape[0], level.template.shape[1])
    slope_y, slope_x = (np.asarray(slope, dtype=np.float32) for slope in np.gradient(level.template))
    normal, gradient = np.empty((PARAMETERS, PARAMETERS)), np.empty(PARAMETERS)
    motion = np.eye(3)
    difference = (level.moved - level.template)[level.seen]
    if len(difference) < _LEAST_PIXELS:
        return matrix, math.inf, False
    photometric = np.array([_gain(level), 0.0])
    spread = _MAD * float(np.median(np.abs(difference)))
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
        if weights < _LEAST_PIXELS:
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


def _gain(level: _Level) -> float:
    """How strongly the image shows the template's detail to begin with."""
    one, other = level.template[level.seen], level.moved[level.seen]
    return float(np.clip((one * other).sum() / max(float((one * one).sum()), 1e-9), 0.3, 1.5))


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
        if half * math.sqrt(_CORRELATED * variance * doubt / len(corners)) <= most:
            step = np.zeros(PARAMETERS)
            step[taken] = inverse @ gradient[taken]
            return step
    return None


def _alike(level: _Level) -> float:
    """Correlation of a level's detail, that of the image clipped where it is far from what is usual."""
    one, other = level.template[level.seen], level.moved[level.seen]
    if len(other) < _LEAST_PIXELS:
        return 0.0
    most = np.float32(_CLIP * _MAD * np.median(np.abs(other)))
    other = np.clip(other, -most, most)
    squares = float(one @ one) * float(other @ other)
    return float(one @ other) / math.sqrt(squares) if squares > 0 else 0.0
