"""A Kalman filter for a state that wanders, measured by evidence that knows some of its directions only.

The estimate is of the state x (Q values) and of one more, the excess: a press that answers corrections by (1 - excess)
times what its model says shows, after a correction u, the state x + excess u. Both are learnt together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Float64Array = NDArray[np.float64]

_LEAST_INFORMATION = 0.005
"""Directions in which a tile says less than this share of what is known beforehand are left aside."""

_MOST_DIRECTIONS = 24


@dataclass(frozen=True, eq=False)
class Estimate:
    """Mean (Q + 1,) and covariance (Q + 1, Q + 1) of the state and, last, of the excess."""

    mean: Float64Array = field(repr=False)
    covariance: Float64Array = field(repr=False)


@dataclass(frozen=True, eq=False)
class Reading:
    """Evidence as independent readings of unit noise: ``value`` (K,) is ``lean`` (K, Q) times the state, and noise."""

    value: Float64Array = field(repr=False)
    lean: Float64Array = field(repr=False)


@dataclass(frozen=True, eq=False)
class Surprise:
    """A reading against an estimate.

    Attributes
    ----------
    squared
        Squared innovation over its covariance, of K degrees of freedom.
    standard
        The same, made about standard normal (E. B. Wilson, M. M. Hilferty, "The distribution of chi-square", PNAS 17
        (1931)).
    log_likelihood
        Of the reading, less a constant.
    score
        (Q + 1,) slope of the log likelihood for the estimate's mean.
    weight
        (Q + 1, Q + 1) its covariance.
    """

    squared: float
    standard: float
    log_likelihood: float
    score: Float64Array = field(repr=False)
    weight: Float64Array = field(repr=False)


def reading_of(information: Float64Array, vector: Float64Array, at: Float64Array, root: Float64Array) -> Reading:
    """Evidence in the directions in which it says something.

    Parameters
    ----------
    information, vector, at
        (Q, Q), (Q,) and (Q,), as of `tilefab.control.drift_events.TileMeasured`.
    root
        (Q, Q) Cholesky factor of the covariance of a fresh state, by which directions are compared.
    """
    sizes, turned = np.linalg.eigh(root.T @ information @ root)
    kept = np.flatnonzero(sizes > _LEAST_INFORMATION)[-_MOST_DIRECTIONS:]
    length = np.sqrt(sizes[kept])
    directions = turned[:, kept]
    lean = np.linalg.solve(root.T, directions * length).T
    value = lean @ at + (directions.T @ (root.T @ vector)) / length
    return Reading(value, lean)


def aged_estimate(
    estimate: Estimate, prior: Float64Array, share: float, scale: float, excess_variance: float
) -> Estimate:
    """An estimate some time later: what is not measured is forgotten, so that it can neither grow nor be held for ever.

    Parameters
    ----------
    estimate
        As it was.
    prior
        (Q, Q) covariance of a fresh state: what nothing is known of goes back to zero, known that well.
    share
        Share of ``prior`` that the state has moved by in that time, 0 upwards.
    scale
        How much faster than usual it moves.
    excess_variance
        What the excess has moved by.
    """
    kept = math.exp(-0.5 * share)
    mean = estimate.mean.copy()
    mean[:-1] *= kept
    covariance = estimate.covariance.copy()
    covariance[:-1] *= kept
    covariance[:, :-1] *= kept
    covariance[:-1, :-1] += scale * (1.0 - kept * kept) * prior
    covariance[-1, -1] += excess_variance
    return Estimate(mean, covariance)


def judge(
    estimate: Estimate, reading: Reading, applied: Float64Array, noise: float, moved: Float64Array | None
) -> tuple[Surprise, Estimate]:
    """Compare a reading with an estimate, and learn from it.

    Parameters
    ----------
    estimate
        What is known.
    reading
        Of a tile.
    applied
        (Q,) the correction that it was printed with.
    noise
        Variance of the reading's noise.
    moved
        (Q, Q) covariance by which the state has moved since the tile was fired; None: it hasn't.

    Returns
    -------
    tuple
        How surprising the reading is, and the estimate that has learnt from it. A reading that says nothing surprises
        and teaches nothing.
    """
    count = len(reading.value)
    if not count:
        size = len(estimate.mean)
        return Surprise(0.0, 0.0, 0.0, np.zeros(size), np.zeros((size, size))), estimate
    lean = np.column_stack([reading.lean, reading.lean @ applied])
    innovation = reading.value - lean @ estimate.mean
    spread = lean @ estimate.covariance
    total = spread @ lean.T
    total[np.diag_indices(count)] += noise
    if moved is not None:
        total += reading.lean @ moved @ reading.lean.T
    factor = cho_factor(total, lower=True)
    pulled = cho_solve(factor, np.column_stack([innovation, lean]))
    squared = float(innovation @ pulled[:, 0])
    width = 2.0 / (9.0 * count)
    surprise = Surprise(
        squared,
        ((squared / count) ** (1.0 / 3.0) - (1.0 - width)) / math.sqrt(width),
        -0.5 * squared - float(np.log(np.diag(factor[0])).sum()),
        lean.T @ pulled[:, 0],
        lean.T @ pulled[:, 1:],
    )
    mean = estimate.mean + spread.T @ pulled[:, 0]
    covariance = estimate.covariance - spread.T @ cho_solve(factor, spread)
    return surprise, Estimate(mean, 0.5 * (covariance + covariance.T))
