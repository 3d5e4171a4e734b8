"""How much the faces of a job differ in looks, as a number; and the one standard that applies to plain tile.

The appearance classes V0 to V4 of ANSI A137.1 are given by people who look at laid tiles. `variation` measures CIELAB
and says which of those classes it would look like: an aid for choosing, not the standard's own measure, which has none.

ISO 10545-16:2010 measures small differences between plain tiles with CMC, and excludes tile that varies by design. So
`plain_cmc` is only for faces that `is_plain`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilefab.colour.differences import delta_e_cmc
from tilefab.colour.spaces import delta_e_2000

Float64Array = NDArray[np.float64]

AID = "The V class is what the measured variation looks like: an aid, not the measure of ANSI A137.1, which has none."
"""What must stand beside every V class that is shown."""

PLAIN_DELTA_E = 0.7
"""A face is plain if 95 % of its blocks are within this CIEDE2000 of its mean: about what the eye sees side by side."""

_MOST_PAIRS = 2000
_LONG = 8
_PLAIN_BLOCKS = 32

# CIEDE2000 at which the look goes up by one class. Between means: what one sees of two tiles side by side (1), at a
# glance (2.5), and takes for different colours (6). Between patterns: eighths of tiles laid on one another.
_BETWEEN_STEPS = (0.0, 0.4, 1.0, 2.5, 6.0)
_PATTERN_STEPS = (0.0, 0.5, 1.5, 6.0, 20.0)


@dataclass(frozen=True)
class Variation:
    """How much faces differ.

    Attributes
    ----------
    look
        "V0" to "V4": see `AID`.
    index
        0 upwards; its whole part is the look's number: the larger of what ``between_delta_e`` and ``pattern_delta_e``
        come to.
    between_delta_e
        Mean CIEDE2000 between the mean colours of two faces.
    pattern_delta_e
        Mean CIEDE2000 between the same eighths of two faces that were brought to one mean colour.
    within_delta_e
        Mean CIEDE2000 of a face's eighths from its own mean.
    faces
        How many were measured.
    """

    look: str
    index: float
    between_delta_e: float
    pattern_delta_e: float
    within_delta_e: float
    faces: int


def coarse_blocks(lab: NDArray[np.floating], blocks: int = _LONG) -> Float64Array:
    """Means of a face over blocks, about square, ``blocks`` along its longer side.

    Parameters
    ----------
    lab
        (rows, cols, 3) CIELAB of a face, at least one pixel a block.

    Returns
    -------
    numpy.ndarray
        (down, across, 3) float64.

    Raises
    ------
    ValueError
        If the face has another shape, or fewer pixels than blocks.
    """
    if lab.ndim != 3 or lab.shape[2] != 3:
        raise ValueError(f"a face of shape {lab.shape} must be (rows, cols, 3) CIELAB")
    rows, cols = lab.shape[:2]
    down = max(1, round(blocks * rows / max(rows, cols)))
    across = max(1, round(blocks * cols / max(rows, cols)))
    if rows < down or cols < across:
        raise ValueError(f"a face of {rows} x {cols} pixels is too small for {down} x {across} blocks")
    row_edges, col_edges = (
        np.linspace(0, size, count + 1).astype(int) for size, count in ((rows, down), (cols, across))
    )
    sums = np.add.reduceat(np.add.reduceat(lab.astype(np.float64), row_edges[:-1], axis=0), col_edges[:-1], axis=1)
    areas = np.diff(row_edges)[:, np.newaxis] * np.diff(col_edges)[np.newaxis]
    return np.asarray(sums / areas[..., np.newaxis], dtype=np.float64)


def variation(faces: Sequence[NDArray[np.floating]]) -> Variation:
    """Measure how much faces differ.

    Parameters
    ----------
    faces
        At least two (rows, cols, 3) CIELAB faces of one size, predicted or fired, at any resolution.

    Raises
    ------
    ValueError
        If there are fewer than two faces, or they differ in shape.
    """
    if len(faces) < 2:
        raise ValueError(f"{len(faces)} face can't differ from another; measure at least 2")
    if len({face.shape for face in faces}) > 1:
        raise ValueError("faces differ in shape; measure them at one resolution")
    blocks = np.stack([coarse_blocks(face).reshape(-1, 3) for face in faces])
    means = blocks.mean(axis=1)
    first, second = _pairs(len(faces))
    levelled = blocks - means[:, np.newaxis] + means.mean(axis=0)
    between = float(delta_e_2000(means[first], means[second]).mean())
    pattern = float(delta_e_2000(levelled[first], levelled[second]).mean())
    within = float(delta_e_2000(blocks, means[:, np.newaxis]).mean())
    index = max(_steps(between, _BETWEEN_STEPS), _steps(pattern, _PATTERN_STEPS))
    return Variation(f"V{min(int(index), 4)}", index, between, pattern, within, len(faces))


def _pairs(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All pairs of faces, or an even choice of them if they are many."""
    first, second = np.triu_indices(count, 1)
    step = max(1, -(-first.size // _MOST_PAIRS))
    return first[::step].astype(np.int64), second[::step].astype(np.int64)


def _steps(value: float, steps: tuple[float, ...]) -> float:
    """Where a value lies on the steps: 0 at the first, 1 at the second; beyond the last it goes on at the last pace."""
    last = len(steps) - 1
    if value > steps[-1]:
        return last + (value - steps[-1]) / (steps[-1] - steps[-2])
    return float(np.interp(value, steps, range(last + 1)))


def is_plain(lab: NDArray[np.floating]) -> bool:
    """Whether a face is of one colour: 95 % of its blocks (32 along it) are within `PLAIN_DELTA_E` of their mean.

    Parameters
    ----------
    lab
        (rows, cols, 3) CIELAB, the predicted face: what was meant, not what the kiln made of it.
    """
    blocks = coarse_blocks(lab, max(1, min(_PLAIN_BLOCKS, *lab.shape[:2]))).reshape(-1, 3)
    away = delta_e_2000(blocks, blocks.mean(axis=0))
    return bool(np.percentile(away, 95) <= PLAIN_DELTA_E)


def plain_cmc(predicted_lab: ArrayLike, fired_lab: ArrayLike, *, lightness: float = 2.0) -> float:
    """Mean CMC(l:1) difference of plain tiles from their standard, the measure that ISO 10545-16:2010 takes.

    Parameters
    ----------
    predicted_lab, fired_lab
        (T, 3) mean colour of each tile as it should be, which is its standard, and as it came out. Only of faces that
        `is_plain` says are: that standard does not apply to others.
    lightness
        l, as the parties agreed; so is the commercial factor that the result is held against.

    Raises
    ------
    ValueError
        If there is no tile.
    """
    standard = np.asarray(predicted_lab, dtype=np.float64).reshape(-1, 3)
    if not len(standard):
        raise ValueError("no tile was measured, so there is no difference from a standard")
    sample = np.asarray(fired_lab, dtype=np.float64).reshape(-1, 3)
    return float(delta_e_cmc(standard, sample, lightness=lightness).mean())
