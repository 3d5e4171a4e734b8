"""How true a near-regular texture's lattice stays over an image: brickwork whose courses don't wander."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from tilefab.types import Array

Plane: TypeAlias = NDArray[np.float64]

REGULAR = 0.6
"""Likeness to itself, shifted, from which a texture has a lattice."""
_SMOOTH_SHARE = 1 / 8
_LEAST_OVERLAP = 0.2
_NEAR_BEST = 0.85
_LEAST_PERIOD_PX = 4
_LEAST_ANGLE_SINE = 0.35
_WINDOW_CELLS = 1.5
_LEAST_WINDOW_PX = 12
_MOST_SHIFTS = 48
_MOST_WINDOW_VALUES = 1200
_FIT_ROUNDS = 6
_INLIER_CELLS = 0.2
_BATCH = 256


@dataclass(frozen=True)
class LatticeError:
    """How far the nodes of an image's lattice are from the regular lattice that fits them best.

    Attributes
    ----------
    rms_px, p95_px, worst_px
        Root mean square, 95th percentile and greatest distance. A node that is off by more than half a cell counts as
        the distance to the next.
    generators_px
        (2, 2), the exemplar's lattice: rows are its shortest repetitions, (down, right).
    drift_px
        By how much the fitted lattice leaves the exemplar's over the whole image: its cells may be larger, or lean.
    nodes
        How many were looked at.
    """

    rms_px: float
    p95_px: float
    worst_px: float
    generators_px: Plane
    drift_px: float
    nodes: int


def lattice_generators(exemplar: Array) -> Plane | None:
    """The two shortest repetitions of a near-regular texture, to a fraction of a pixel.

    Parameters
    ----------
    exemplar
        (rows, cols) of one channel, at least 16 a side.

    Returns
    -------
    ndarray or None
        (2, 2) float64, rows are (down, right); None if no shift in two directions makes the texture like itself.

    Raises
    ------
    ValueError
        If the exemplar isn't two-dimensional or is too small.

    Notes
    -----
    Normalised cross-correlation over the part that both cover, of what an eighth of the side doesn't explain. All
    peaks near whole multiples then share in the fit.
    """
    if exemplar.ndim != 2 or min(exemplar.shape) < 16:
        raise ValueError(f"an exemplar for a lattice is (rows, cols) of 16 pixels a side or more, not {exemplar.shape}")
    likeness, centre = _self_likeness(exemplar.astype(np.float64))
    peaks = _peaks(likeness, centre)
    if not len(peaks):
        return None
    strength = np.array([likeness[tuple(np.rint(peak + centre).astype(int))] for peak in peaks])
    good = strength >= max(REGULAR, _NEAR_BEST * strength.max())
    shifts = sorted(peaks[good], key=lambda shift: (round(float(np.hypot(*shift)), 1), -shift[0], -shift[1]))
    if not shifts:
        return None
    first = shifts[0]
    for second in shifts[1:]:
        across = abs(first[0] * second[1] - first[1] * second[0])
        if across > _LEAST_ANGLE_SINE * np.hypot(*first) * np.hypot(*second):
            return _fitted(np.array([first, second]), peaks[strength >= REGULAR * strength.max()])
    return None


def lattice_error(exemplar: Array, image: Array, generators_px: Plane | None = None) -> LatticeError | None:
    """Measure how true the lattice of an image is.

    Parameters
    ----------
    exemplar, image
        (rows, cols) of one channel at one resolution.
    generators_px
        (2, 2) the exemplar's lattice, if it is known.

    Returns
    -------
    LatticeError or None
        None if the exemplar has no lattice, or the image is smaller than a cell and a half.

    Raises
    ------
    ValueError
        If an image isn't two-dimensional or is too small.

    Notes
    -----
    The exemplar's cells are laid on top of one another and averaged. All over the image, windows of one and a half
    cells, half a cell apart, are compared with that mean cell at every shift: the best one tells where the nearest
    node lies. A regular lattice is fitted to all nodes, in rounds that leave out those that are far off.
    """
    if image.ndim != 2:
        raise ValueError(f"an image for a lattice is (rows, cols), not {image.shape}")
    generators = lattice_generators(exemplar) if generators_px is None else np.asarray(generators_px, dtype=np.float64)
    if generators is None:
        return None
    size_px = [max(_LEAST_WINDOW_PX, math.ceil(_WINDOW_CELLS * extent)) for extent in np.abs(generators).max(axis=0)]
    starts = [
        np.arange(0, length - size + 1, max(1, size // 3)) for length, size in zip(image.shape, size_px, strict=True)
    ]
    if min(len(of_axis) for of_axis in starts) < 1:
        return None
    lengths = [min(_MOST_SHIFTS, max(4, math.ceil(float(np.hypot(*vector))))) for vector in generators]
    counts = (lengths[0], lengths[1])
    stride = max(1, math.ceil(math.sqrt(size_px[0] * size_px[1] / _MOST_WINDOW_VALUES)))
    inside = _grid(np.arange(0, size_px[0], stride), np.arange(0, size_px[1], stride))
    templates = _templates(exemplar.astype(np.float64), generators, counts, inside)
    smooth = ndimage.gaussian_filter(image.astype(np.float64), stride / 2) if stride > 1 else image.astype(np.float64)
    origins = _grid(starts[0], starts[1])
    phases = np.empty((len(origins), 2))
    for begin in range(0, len(origins), _BATCH):
        at = origins[begin : begin + _BATCH, None] + inside
        values = smooth[at[..., 0], at[..., 1]]
        scores = (values - values.mean(axis=1, keepdims=True)) @ templates.T
        phases[begin : begin + _BATCH] = [_best_shift(score.reshape(counts)) for score in scores]
    middles = origins + np.array(size_px) / 2
    nodes = (origins @ np.linalg.inv(generators) + phases) % 1.0
    residual, slope = _residuals(middles, nodes)
    distance = np.hypot(*(residual @ generators).T)
    return LatticeError(
        rms_px=float(np.sqrt(np.mean(distance**2))),
        p95_px=float(np.percentile(distance, 95)),
        worst_px=float(distance.max()),
        generators_px=generators,
        drift_px=float(np.hypot(*(np.array(image.shape) @ slope @ generators))),
        nodes=len(origins),
    )


def _grid(down: Array, right: Array) -> Array:
    """All pairs, (pairs, 2), in reading order."""
    return np.column_stack([np.repeat(down, len(right)), np.tile(right, len(down))])


def _self_likeness(plane: Plane) -> tuple[Plane, NDArray[np.int64]]:
    """Likeness at all shifts, (2 rows - 1, 2 cols - 1), and where in it no shift stands."""
    detail = plane - ndimage.gaussian_filter(plane, min(plane.shape) * _SMOOTH_SHARE, mode="nearest")
    detail -= detail.mean()
    size = tuple(fft.next_fast_len(2 * side, real=True) for side in plane.shape)
    values, squares, ones = (fft.rfft2(array, size) for array in (detail, detail**2, np.ones_like(detail)))
    products = fft.irfft2(np.abs(values) ** 2, size)
    here, there = (fft.irfft2(a * np.conj(b), size) for a, b in ((squares, ones), (ones, squares)))
    area = fft.irfft2(np.abs(ones) ** 2, size)
    scale = np.sqrt(np.maximum(here, 0) * np.maximum(there, 0))
    known = (area > _LEAST_OVERLAP * plane.size) & (scale > 1e-9 * float(here.max()))
    likeness = np.where(known, products / np.where(known, scale, 1.0), 0.0)
    rows, cols = plane.shape
    shifts = np.ix_(np.arange(1 - rows, rows) % size[0], np.arange(1 - cols, cols) % size[1])
    return likeness[shifts], np.array([rows - 1, cols - 1])


def _peaks(likeness: Plane, centre: NDArray[np.int64]) -> Plane:
    """Shifts of all local maxima but the one at no shift, one of each opposite pair, to a fraction of a pixel."""
    highest = (likeness == ndimage.maximum_filter(likeness, 5, mode="constant")) & (likeness > REGULAR / 2)
    found = []
    for row, col in np.argwhere(highest[1:-1, 1:-1]) + 1:
        down, right = row - centre[0], col - centre[1]
        if (down, right) <= (0, 0) or math.hypot(down, right) < _LEAST_PERIOD_PX:
            continue
        found.append(
            (
                down + _vertex(likeness[row - 1 : row + 2, col]),
                right + _vertex(likeness[row, col - 1 : col + 2]),
            )
        )
    return np.array(found).reshape(-1, 2)


def _vertex(three: Plane) -> float:
    """Where the parabola through three values has its top, from the middle one on."""
    bend = float(three[0] - 2 * three[1] + three[2])
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def _fitted(generators: Plane, peaks: Plane) -> Plane:
    """Generators that fit all peaks near whole multiples best."""
    for _ in range(3):
        coordinates = peaks @ np.linalg.inv(generators)
        whole = np.rint(coordinates)
        near = (np.abs(coordinates - whole).max(axis=1) < _INLIER_CELLS) & (np.abs(whole).max(axis=1) > 0)
        if np.linalg.matrix_rank(whole[near]) < 2:
            break
        generators = np.linalg.lstsq(whole[near], peaks[near], rcond=None)[0]
    return generators


def _templates(exemplar: Plane, generators: Plane, counts: tuple[int, int], inside: NDArray[np.int64]) -> Plane:
    """The mean cell as windows would show it whose first pixel stands at each of the shifts: (shifts, values), unit."""
    cell = _mean_cell(exemplar, generators, counts)
    steps = _grid(np.arange(counts[0]) / counts[0], np.arange(counts[1]) / counts[1])
    lattice = inside @ np.linalg.inv(generators)
    windows = np.empty((len(steps), len(inside)))
    for k, step in enumerate(steps):
        # The node stands ``step`` of a cell after the window's first pixel.
        at = ((lattice - step) % 1.0) * counts
        windows[k] = ndimage.map_coordinates(cell, at.T, order=1, mode="grid-wrap")
    windows -= windows.mean(axis=1, keepdims=True)
    norms: Plane = np.linalg.norm(windows, axis=1, keepdims=True)
    return np.asarray(windows / np.maximum(norms, 1e-9))


def _mean_cell(exemplar: Plane, generators: Plane, counts: tuple[int, int]) -> Plane:
    """All cells of the exemplar on top of one another, in lattice coordinates."""
    places = _grid(np.arange(exemplar.shape[0]), np.arange(exemplar.shape[1]))
    at = (places @ np.linalg.inv(generators) % 1.0) * counts
    low = np.floor(at).astype(np.int64)
    total, weight = np.zeros(counts), np.zeros(counts)
    for corner in itertools.product((0, 1), (0, 1)):
        share = np.prod(np.where(corner, at - low, 1 - (at - low)), axis=1)
        index = tuple((low + corner).T % np.array(counts)[:, None])
        np.add.at(total, index, share * exemplar.ravel())
        np.add.at(weight, index, share)
    return np.asarray(total / np.maximum(weight, 1e-9))


def _best_shift(score: Plane) -> Plane:
    """The shift with the highest score, 0 to 1 of each generator, between the steps by parabolas."""
    best = np.array(np.unravel_index(int(score.argmax()), score.shape))
    around = [score.take(range(best[0] - 1, best[0] + 2), axis=0, mode="wrap")[:, best[1]]]
    around.append(score[best[0]].take(range(best[1] - 1, best[1] + 2), mode="wrap"))
    return np.array([(best[k] + _vertex(around[k])) / score.shape[k] for k in (0, 1)])


def _residuals(middles: Plane, nodes: Plane) -> tuple[Plane, Plane]:
    """Distances of nodes to the fitted lattice in lattice coordinates, and by how much it changes for each pixel."""

    def wrapped(values: Plane) -> Plane:
        return values - np.rint(values)

    near = [int((np.abs(wrapped(nodes - node)).max(axis=1) < _INLIER_CELLS).sum()) for node in nodes]
    offset, slope = nodes[int(np.argmax(near))], np.zeros((2, 2))
    design = np.column_stack([middles - middles.mean(axis=0), np.ones(len(middles))])
    for _ in range(_FIT_ROUNDS):
        expected = design[:, :2] @ slope + offset
        residual = wrapped(nodes - expected)
        kept = np.abs(residual).max(axis=1) < _INLIER_CELLS
        if np.linalg.matrix_rank(design[kept]) < 3:
            break
        change = np.linalg.lstsq(design[kept], residual[kept], rcond=None)[0]
        slope, offset = slope + change[:2], offset + change[2]
    return wrapped(nodes - design[:, :2] @ slope - offset), slope
