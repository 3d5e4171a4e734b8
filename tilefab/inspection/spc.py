"""Control charts: mean and range, EWMA, CUSUM, capability.

Closed-loop measurements are autocorrelated, and every chart here takes values for independent. So where a loop is
closed it is the controller's innovations that are charted, not the colours themselves (J. F. MacGregor, "On-line
statistical process control", Chemical Engineering Progress 84 (1988)). What runs of points tell is in `run_rules`.

Charts that follow a stream are frozen settings; their state is a value that goes in and out of `update`, so that it can
be stored with the tile that made it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

Float64Array = NDArray[np.float64]

SIGMA_LIMIT = 3.0
"""Limits of mean and range charts, in standard deviations (Shewhart)."""

_MOST_GROUPED = 100


@dataclass(frozen=True)
class ChartConstants:
    """Constants of mean and range charts for normal values in groups of ``n``.

    Attributes
    ----------
    n
        Values in a group, 2 to 100.
    d2, d3
        Mean and standard deviation of the range of n standard normal values.
    a2
        Limits of the mean: times the mean range, either way.
    d_low, d_high
        Limits of the range: times the mean range (D3 and D4).
    """

    n: int
    d2: float
    d3: float
    a2: float
    d_low: float
    d_high: float


@functools.cache
def chart_constants(n: int) -> ChartConstants:
    """Constants for groups of ``n`` values, from the distribution of the range itself.

    Raises
    ------
    ValueError
        If n is not from 2 to 100.

    References
    ----------
    L. H. C. Tippett, "On the extreme individuals and the range of samples taken from a normal population", Biometrika
    17 (1925); the names of the constants and rounded tables in D. C. Montgomery, "Introduction to Statistical Quality
    Control", appendix VI, and in ISO 7870-2:2013.

    Examples
    --------
    >>> five = chart_constants(5)
    >>> round(five.d2, 3), round(five.d3, 3), round(five.a2, 3), five.d_low, round(five.d_high, 3)
    (2.326, 0.864, 0.577, 0.0, 2.114)
    """
    if not 2 <= n <= _MOST_GROUPED:
        raise ValueError(f"groups of {n} values have no constants here; take 2 to {_MOST_GROUPED}")
    # P(range <= w) = n * integral of phi(x) (Phi(x + w) - Phi(x))^(n - 1); its moments are integrals of the tail.
    nodes, weights = np.polynomial.legendre.leggauss(120)
    longest = 16.0
    w, w_weights = 0.5 * longest * (nodes + 1.0), 0.5 * longest * weights
    x = np.linspace(-9.0, 9.0, 721)
    density = np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi) * (x[1] - x[0])
    below = n * ((ndtr(x[np.newaxis] + w[:, np.newaxis]) - ndtr(x)[np.newaxis]) ** (n - 1) @ density)
    d2 = float(w_weights @ (1.0 - below))
    d3 = math.sqrt(float(w_weights @ (2.0 * w * (1.0 - below))) - d2 * d2)
    return ChartConstants(
        n=n,
        d2=d2,
        d3=d3,
        a2=SIGMA_LIMIT / (d2 * math.sqrt(n)),
        d_low=max(0.0, 1.0 - SIGMA_LIMIT * d3 / d2),
        d_high=1.0 + SIGMA_LIMIT * d3 / d2,
    )


@dataclass(frozen=True)
class MeanRangeLimits:
    """Centre lines and control limits of a mean (x-bar) and range (R) chart.

    ``sigma`` is the standard deviation of single values inside groups, by the mean range.
    """

    n: int
    groups: int
    mean: float
    mean_low: float
    mean_high: float
    range_mean: float
    range_low: float
    range_high: float
    sigma: float


def mean_range_limits(groups: ArrayLike) -> MeanRangeLimits:
    """Limits of a mean and range chart from groups of values.

    Parameters
    ----------
    groups
        (G, n) finite values, one group a row: values close in time. n 2 to 100.

    Raises
    ------
    ValueError
        If there is no group, or values are not finite.
    """
    table = np.asarray(groups, dtype=np.float64)
    if table.ndim != 2 or len(table) == 0 or not np.isfinite(table).all():
        raise ValueError(f"groups of shape {table.shape} must be (G, n) finite values, with at least one group")
    constants = chart_constants(table.shape[1])
    mean = float(table.mean())
    range_mean = float(np.ptp(table, axis=1).mean())
    return MeanRangeLimits(
        n=constants.n,
        groups=len(table),
        mean=mean,
        mean_low=mean - constants.a2 * range_mean,
        mean_high=mean + constants.a2 * range_mean,
        range_mean=range_mean,
        range_low=constants.d_low * range_mean,
        range_high=constants.d_high * range_mean,
        sigma=range_mean / constants.d2,
    )


@dataclass(frozen=True)
class Capability:
    """How well a process fits its tolerance.

    Attributes
    ----------
    count, mean
        Of the values.
    sigma_within
        By moving ranges of neighbours: what the process could hold if its mean stood still.
    sigma_overall
        Of all values about their mean.
    cpk
        Distance from the mean to the nearer limit over 3 ``sigma_within``; infinite if nothing varies within limits.
    ppk
        The same with ``sigma_overall``: what the customer got.
    """

    count: int
    mean: float
    sigma_within: float
    sigma_overall: float
    cpk: float
    ppk: float


def cpk(values: ArrayLike, lower: float | None, upper: float | None) -> Capability:
    """Capability of a process from its values in order of time.

    Parameters
    ----------
    values
        (N,) finite values, N at least 2, in order.
    lower, upper
        The tolerance's limits; None where there is none on that side, but not on both.

    Raises
    ------
    ValueError
        If there are too few values or no limits, or the limits are the wrong way round.

    References
    ----------
    ISO 22514-2:2017 (indices); D. C. Montgomery, "Introduction to Statistical Quality Control", chapters 6 (moving
    ranges) and 8. Values of a closed loop are autocorrelated: neighbours are more alike than chance has it, and Cpk
    by moving ranges then promises too much. Ppk does not.

    Examples
    --------
    >>> found = cpk([9.0, 10.0, 11.0, 10.0], 7.0, None)
    >>> round(found.sigma_within, 4), round(found.cpk, 4)
    (0.8862, 1.1284)
    """
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or x.size < 2 or not np.isfinite(x).all():
        raise ValueError(f"values of shape {x.shape} must be at least 2 finite values in a row")
    if lower is None and upper is None:
        raise ValueError("capability needs a lower or an upper limit")
    if lower is not None and upper is not None and not lower < upper:
        raise ValueError(f"lower limit {lower} must be below upper limit {upper}")
    mean = float(x.mean())
    within = float(np.abs(np.diff(x)).mean()) / chart_constants(2).d2
    overall = float(x.std(ddof=1))
    room = min(math.inf if lower is None else mean - lower, math.inf if upper is None else upper - mean)
    return Capability(x.size, mean, within, overall, _index(room, within), _index(room, overall))


def _index(room: float, sigma: float) -> float:
    if sigma > 0.0:
        return room / (3.0 * sigma)
    return math.copysign(math.inf, room) if room else 0.0


@dataclass(frozen=True)
class EwmaChart:
    """Exponentially weighted moving average of standardised values, with its steady limits.

    Attributes
    ----------
    weight
        Of the newest value, above 0, at most 1.
    limit
        In standard deviations of the average, above 0.

    References
    ----------
    S. W. Roberts, Technometrics 1 (1959); J. M. Lucas and M. S. Saccucci, "Exponentially weighted moving average
    control schemes", Technometrics 32 (1990): weight 0.2 with limit 2.962 runs 500 values on average when nothing is
    wrong.
    """

    weight: float = 0.2
    limit: float = 2.962

    def __post_init__(self) -> None:
        if not 0.0 < self.weight <= 1.0 or not self.limit > 0.0:
            raise ValueError(f"weight {self.weight} must be above 0 and at most 1, limit {self.limit} above 0")

    @property
    def bound(self) -> float:
        """The control limit, either way, in standard deviations of single values."""
        return self.limit * math.sqrt(self.weight / (2.0 - self.weight))

    def update(self, average: float, value: float) -> tuple[float, int]:
        """Return the new average (begin with 0.0), and -1 or 1 if it is beyond the lower or upper limit, else 0."""
        _check_finite(value)
        new = average + self.weight * (value - average)
        return new, _side(new, self.bound)


@dataclass(frozen=True)
class CusumState:
    """Both sums of a CUSUM chart: how far values ran above and below, 0 upwards."""

    high: float = 0.0
    low: float = 0.0


@dataclass(frozen=True)
class CusumChart:
    """Two-sided tabular CUSUM of standardised values.

    Attributes
    ----------
    slack
        k: what each value may be off before it counts, 0 upwards; half the shift to be found.
    limit
        h: the sum that is a signal, above 0.

    References
    ----------
    E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954); D. C. Montgomery, "Introduction to Statistical
    Quality Control", chapter 9: k = 0.5, h = 5 runs 465 values on average when nothing is wrong.
    """

    slack: float = 0.5
    limit: float = 5.0

    def __post_init__(self) -> None:
        if not (self.slack >= 0.0 and self.limit > 0.0):
            raise ValueError(f"slack {self.slack} must be 0 or more and limit {self.limit} above 0")

    def update(self, state: CusumState, value: float) -> tuple[CusumState, int]:
        """Return the new sums, and -1 or 1 if the lower or upper one is beyond the limit, else 0."""
        _check_finite(value)
        high = max(0.0, state.high + value - self.slack)
        low = max(0.0, state.low - value - self.slack)
        signal = 1 if high > self.limit else -1 if low > self.limit else 0
        return CusumState(high, low), signal


@dataclass(frozen=True)
class ShewhartChart:
    """Single standardised values against limits in standard deviations.

    References
    ----------
    W. A. Shewhart, "Economic Control of Quality of Manufactured Product" (1931). At 3, one value in 370.4 is beyond
    by chance.
    """

    limit: float = SIGMA_LIMIT

    def __post_init__(self) -> None:
        if not self.limit > 0.0:
            raise ValueError(f"limit {self.limit} must be above 0")

    def update(self, value: float) -> int:
        """-1 or 1 if the value is beyond the lower or upper limit, else 0."""
        _check_finite(value)
        return _side(value, self.limit)


def _side(value: float, bound: float) -> int:
    return 1 if value > bound else -1 if value < -bound else 0


def _check_finite(value: float) -> None:
    if not math.isfinite(value):
        raise ValueError(f"value {value} can't be charted; leave out what is not a finite number")
