"""The lattice on which a near-regular texture repeats, if it does (Kaspar et al. 2015, section 3.3, Eq. 7 to 10).

The paper collects offsets between like SIFT features. Those find nothing where everything is alike, as on a
checkerboard; here the offsets are the peaks of the autocorrelation, after what varies slowly is removed. The rest is
the paper's: of all pairs of offsets the one is taken whose lattice has peaks on its points (precision) and whose
points catch the peaks (recall). Its generators are then fitted to all peaks at once, to fractions of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from tilefab.synthesis.edges import fill_holes
from tilefab.types import Mask

ACCEPTED = 0.6
"""Confidence from which a lattice is believed: regular textures reach .8, irregular ones stay below .5."""

_BETA = 0.1
_WORKING_SIDE_PX = 512
_LOCAL_SHARE = 1 / 16
_LEAST_OVERLAP = 0.2
_LEAST_GENERATOR_PX = 5.0
_LEAST_PEAK = 0.15
_MOST_PEAKS = 400
_MOST_GENERATORS = 40
_LEAST_SINE = 0.2
_ABOUT_EQUAL = 0.85
_TOLERANCE_SHARE = 0.06
_SETTLING_PX = 2
_STEPS_PER_PX = 256


@dataclass(frozen=True)
class Lattice:
    """A lattice of translations under which a texture stays as it is.

    Attributes
    ----------
    first, second
        Generators (rows, cols) in pixels, fractional, the shortest there are: ``first`` points down, and is nearer
        to the row axis than ``second``, which points right.
    confidence
        F of Eq. 7, 0 to 1.
    """

    first: tuple[float, float]
    second: tuple[float, float]
    confidence: float

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(2, 2): the generators as columns."""
        return np.array([self.first, self.second], dtype=np.float64).T

    @property
    def cell_px(self) -> tuple[float, float]:
        """Rows and columns of the rectangle around one cell."""
        return abs(self.first[0]) + abs(self.second[0]), abs(self.first[1]) + abs(self.second[1])

    def scaled(self, factor: float | tuple[float, float]) -> Lattice:
        """The lattice of the exemplar made ``factor`` times as large; two numbers: rows and columns apart."""
        down, across = factor if isinstance(factor, tuple) else (factor, factor)
        first = (self.first[0] * down, self.first[1] * across)
        return Lattice(first, (self.second[0] * down, self.second[1] * across), self.confidence)


def find_lattice(exemplar: NDArray[np.float32], valid: Mask) -> Lattice | None:
    """Find the lattice of an exemplar.

    Parameters
    ----------
    exemplar
        (rows, cols, channels) CIELAB, or other channels scaled alike; finite where ``valid``.
    valid
        (rows, cols), True where the exemplar may be used.

    Returns
    -------
    Lattice or None
        ``None`` if no lattice reaches a confidence of `ACCEPTED`, as for most stone. Fabric and the like whose pitch
        is below 5 px, or above half of the exemplar, isn't found.

    Raises
    ------
    ValueError
        If the shapes don't fit, nothing is valid or a valid pixel isn't finite.
    """
    factor = max(1, -(-max(valid.shape) // _WORKING_SIDE_PX))
    planes, kept = _reduced(fill_holes(exemplar, valid), valid, factor)
    likeness = autocorrelation(planes, kept)
    peaks, heights = _peaks(likeness)
    if len(peaks) < 2:
        return None
    peaks, trust = _settled(peaks, unlikeness(planes, kept))
    found: list[tuple[float, float, NDArray[np.float64]]] = []
    nearest = np.argsort((peaks**2).sum(axis=1), kind="stable")[:_MOST_GENERATORS]
    strongest = np.argsort(-heights, kind="stable")[:_MOST_GENERATORS]
    # A peak and its mirror image generate alike: those that point down, or right, are enough.
    chosen = [int(i) for i in dict.fromkeys([*nearest, *strongest]) if tuple(peaks[i]) > (0.0, 0.0)]
    tried: set[tuple[int, ...]] = set()
    for one, other in combinations(chosen, 2):
        matrix = _shortest(np.stack([peaks[one], peaks[other]], axis=1))
        key = tuple(np.rint(matrix).astype(int).ravel().tolist())
        if key in tried or not _is_proper(matrix):
            continue
        tried.add(key)
        confidence = _f_beta(matrix, likeness, peaks, heights)
        found.append((confidence, abs(float(np.linalg.det(matrix))), matrix))
    if not found:
        return None
    # Every third point of a lattice makes one too, and chance may favour it: the finest of about equals is meant.
    good_enough = _ABOUT_EQUAL * max(confidence for confidence, _, _ in found)
    _, _, matrix = min((entry for entry in found if entry[0] >= good_enough), key=lambda entry: (entry[1], -entry[0]))
    matrix = _fitted(matrix, peaks, heights**2 * trust)
    confidence = round(_f_beta(matrix, likeness, peaks, heights), 3)
    if confidence < ACCEPTED:
        return None
    first, second = (
        tuple((np.rint(column * factor * _STEPS_PER_PX) / _STEPS_PER_PX).tolist()) for column in _ordered(matrix).T
    )
    return Lattice((first[0], first[1]), (second[0], second[1]), confidence)


def autocorrelation(planes: NDArray[np.float64], valid: Mask) -> NDArray[np.float64]:
    """Likeness of a texture to itself, shifted: normalised over what both cover, slow variation removed.

    Parameters
    ----------
    planes
        (rows, cols, channels), finite.
    valid
        (rows, cols), True where it counts.

    Returns
    -------
    numpy.ndarray
        (2 reach + 1, 2 reach + 1), each its own reach, the shift 0 in the middle; -1 to 1, in steps of .0001, 0 where
        less than a fifth of the area overlaps.
    """
    weights = valid.astype(np.float64)
    sigma = max(valid.shape) * _LOCAL_SHARE
    cover = np.maximum(ndimage.gaussian_filter(weights, sigma, mode="constant"), 1e-9)
    size = tuple(fft.next_fast_len(2 * side, real=True) for side in valid.shape)
    spectra, squares = [], np.zeros(valid.shape)
    for channel in range(planes.shape[2]):
        slow = ndimage.gaussian_filter(planes[..., channel] * weights, sigma, mode="constant") / cover
        plane = (planes[..., channel] - slow) * weights
        squares += plane**2
        spectra.append(fft.rfft2(plane, size))
    ones, energies = fft.rfft2(weights, size), fft.rfft2(squares, size)
    area = np.rint(fft.irfft2(np.abs(ones) ** 2, size))
    product = fft.irfft2(np.sum([np.abs(spectrum) ** 2 for spectrum in spectra], axis=0), size)
    energy = np.maximum(fft.irfft2(energies * np.conj(ones), size) * fft.irfft2(ones * np.conj(energies), size), 0)
    known = (area > _LEAST_OVERLAP * weights.sum()) & (energy > 1e-6 * max(float(squares.sum()), 1.0) ** 2)
    likeness = np.where(known, product / np.sqrt(np.where(known, energy, 1.0)), 0.0)
    # Rounding must not decide what is regular: four decimals are the same everywhere.
    return _centred(np.asarray(np.round(likeness, 4), dtype=np.float64), valid.shape)


def unlikeness(planes: NDArray[np.float64], valid: Mask) -> NDArray[np.float64]:
    """Mean squared difference between a texture and itself, shifted, over what both cover.

    Nothing is removed before, nor normalised: its minima lie exactly at the periods, where those of the correlation
    are drawn aside by what happens to be at the rims.

    Parameters
    ----------
    planes, valid
        As for `autocorrelation`.

    Returns
    -------
    numpy.ndarray
        As for `autocorrelation`, >= 0, in the square of the planes' unit.
    """
    weights = valid.astype(np.float64)
    size = tuple(fft.next_fast_len(2 * side, real=True) for side in valid.shape)
    centred = (planes - planes[valid].mean(axis=0)) * weights[..., None]
    ones, squares = fft.rfft2(weights, size), fft.rfft2((centred**2).sum(axis=2), size)
    power = np.sum([np.abs(fft.rfft2(centred[..., k], size)) ** 2 for k in range(planes.shape[2])], axis=0)
    area = np.maximum(fft.irfft2(np.abs(ones) ** 2, size), 1.0)
    total = fft.irfft2(2 * np.real(squares * np.conj(ones)) - 2 * power, size)
    return _centred(np.maximum(total, 0.0) / area, valid.shape)


def _centred(values: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    reach = [int(side * (1 - _LEAST_OVERLAP)) for side in shape]
    rows, cols = (np.arange(-far, far + 1) % length for far, length in zip(reach, values.shape, strict=True))
    return np.asarray(values[np.ix_(rows, cols)])


def _reduced(planes: NDArray[np.float64], valid: Mask, factor: int) -> tuple[NDArray[np.float64], Mask]:
    rows, cols = (side // factor for side in valid.shape)
    blocks = planes[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor, planes.shape[2])
    kept = valid[: rows * factor, : cols * factor].reshape(rows, factor, cols, factor)
    whole = kept.all(axis=(1, 3))
    return blocks.mean(axis=(1, 3)), np.asarray(whole if whole.any() else kept.any(axis=(1, 3)))


def _peaks(likeness: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offsets (n, 2) of the summits of the autocorrelation, in whole pixels, and their heights (n,)."""
    middle = np.array(likeness.shape) // 2
    summits = (likeness >= _LEAST_PEAK) & (likeness == ndimage.maximum_filter(likeness, 5, mode="constant"))
    summits[[0, -1]] = False
    summits[:, [0, -1]] = False
    places = np.argwhere(summits)
    places = places[((places - middle) ** 2).sum(axis=1) >= _LEAST_GENERATOR_PX**2]
    heights = likeness[places[:, 0], places[:, 1]]
    order = np.argsort(-heights, kind="stable")[:_MOST_PEAKS]
    places, heights = places[order], heights[order]
    return (places - middle).astype(np.float64), heights


def _settled(
    peaks: NDArray[np.float64], differences: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Peaks moved to the least difference within 2 px, to fractions of a pixel, and how far each is to be trusted."""
    middle = np.array(differences.shape) // 2
    around = np.arange(-_SETTLING_PX, _SETTLING_PX + 1)
    limit = np.array(differences.shape) - 2
    places, trust = [], []
    for start in np.rint(peaks).astype(np.int64) + middle:
        rows, cols = (np.clip(start[axis] + around, 1, limit[axis]) for axis in (0, 1))
        window = np.round(differences[np.ix_(rows, cols)], 6)
        row, col = divmod(int(window.argmin()), len(around))
        places.append((rows[row], cols[col]))
        # Where the least lies at the window's rim there is none.
        on_rim = {row, col} & {0, len(around) - 1}
        overlap = np.prod(1 - (1 - _LEAST_OVERLAP) * np.abs(start - middle) / middle)
        trust.append(1e-6 if on_rim else float(overlap) ** 2)
    at = np.array(places)
    here = differences[at[:, 0], at[:, 1]]
    offsets = (at - middle).astype(np.float64)
    for axis, step in ((0, np.array([1, 0])), (1, np.array([0, 1]))):
        before, after = differences[tuple((at - step).T)], differences[tuple((at + step).T)]
        bend = before - 2 * here + after
        # The lowest point of the parabola through three, but never farther than where a parabola down to 0 would
        # have it: both arms of a minimum need not be alike.
        shift = np.where(bend > 1e-9, (before - after) / np.where(bend > 1e-9, 2 * bend, 1.0), 0.0)
        root, beside = np.sqrt(here), np.sqrt(np.minimum(before, after))
        most = root / np.maximum(root + beside, 1e-9)
        offsets[:, axis] += np.clip(shift, -most, most)
    return offsets, np.array(trust)


def _shortest(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The shortest generators of the same lattice (Lagrange and Gauss)."""
    one, other = matrix[:, 0].copy(), matrix[:, 1].copy()
    for _ in range(64):
        if one @ one > other @ other:
            one, other = other, one
        times = np.rint(one @ other / max(float(one @ one), 1e-12))
        if times == 0:
            break
        other = other - times * one
    return np.stack([one, other], axis=1)


def _ordered(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The generator nearest the row axis first, pointing down; the other pointing right."""
    one, other = matrix.T
    if abs(one[0]) * np.hypot(*other) < abs(other[0]) * np.hypot(*one) - 1e-6:
        one, other = other, one
    if one[0] < 0:
        one = -one
    return np.stack([one, other if other[1] >= 0 else -other], axis=1)


def _is_proper(matrix: NDArray[np.float64]) -> bool:
    lengths = np.hypot(*matrix)
    area = abs(float(np.linalg.det(matrix)))
    return bool(lengths.min() >= _LEAST_GENERATOR_PX) and area >= _LEAST_SINE * float(lengths.prod())


def _f_beta(
    matrix: NDArray[np.float64],
    likeness: NDArray[np.float64],
    peaks: NDArray[np.float64],
    heights: NDArray[np.float64],
) -> float:
    tolerance = _tolerance_px(matrix)
    reach = np.array(likeness.shape) // 2
    points = _points_within(matrix, reach - 1)
    points = points[(points != 0).any(axis=1)]
    if len(points) < 4:
        return 0.0
    # The paper smears each offset by a Gaussian; here a point counts as the best likeness near it.
    near = int(np.ceil(tolerance))
    at = np.rint(points).astype(np.int64) + reach
    around = np.arange(-near, near + 1)
    rows = np.clip(at[:, 0, None, None] + around[:, None], 0, likeness.shape[0] - 1)
    cols = np.clip(at[:, 1, None, None] + around, 0, likeness.shape[1] - 1)
    best = likeness[rows, cols].max(axis=(1, 2))
    # Shifts with too little overlap are unknown, not unlike.
    known = likeness[at[:, 0], at[:, 1]] != 0.0
    if np.count_nonzero(known) < 4:
        return 0.0
    precision = max(float(best[known].mean()), 0.0)
    off = peaks - (matrix @ np.rint(np.linalg.solve(matrix, peaks.T))).T
    caught = np.hypot(off[:, 0], off[:, 1]) <= 1.5 * tolerance
    recall = float(heights[caught].sum() / heights.sum())
    if precision == 0.0 or recall == 0.0:
        return 0.0
    return (1 + _BETA**2) * precision * recall / (_BETA**2 * precision + recall)


def _tolerance_px(matrix: NDArray[np.float64]) -> float:
    return float(np.clip(_TOLERANCE_SHARE * np.hypot(*matrix).min(), 1.0, 3.0))


def _points_within(matrix: NDArray[np.float64], reach: NDArray[np.int64]) -> NDArray[np.float64]:
    """All points of a lattice whose rows and columns are at most ``reach`` from 0, (n, 2)."""
    corners = np.array([[1, 1, -1, -1], [1, -1, 1, -1]]) * reach[:, None]
    far = np.ceil(np.abs(np.linalg.solve(matrix, corners)).max(axis=1)).astype(np.int64)
    times = np.stack(np.meshgrid(*(np.arange(-most, most + 1) for most in far), indexing="ij"), axis=-1).reshape(-1, 2)
    points = times @ matrix.T
    return np.asarray(points[(np.abs(points) <= reach).all(axis=1)])


def _fitted(
    matrix: NDArray[np.float64], peaks: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Generators that fit all peaks on the lattice best, first the near ones, then those farther out."""
    distances = np.hypot(peaks[:, 0], peaks[:, 1])
    tolerance = _tolerance_px(matrix)
    for share in (0.3, 0.45, 0.6, 0.8, 1.0, 1.0):
        within = distances <= max(share * distances.max(), 1.5 * float(np.hypot(*matrix).max()))
        times = np.rint(np.linalg.solve(matrix, peaks.T)).T
        off = peaks - times @ matrix.T
        used = within & (np.hypot(off[:, 0], off[:, 1]) <= 1.5 * tolerance) & (times != 0).any(axis=1)
        weighted = (times[used] * weights[used, None]).T
        normal = weighted @ times[used]
        if abs(float(np.linalg.det(normal))) <= 1e-9 * float(np.abs(normal).max()) ** 2:
            continue
        matrix = np.linalg.solve(normal, weighted @ peaks[used]).T
    return matrix
