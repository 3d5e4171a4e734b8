"""Average run lengths: how many values a control chart lets pass, on average, until it signals.

Two ways that share nothing: simulation with keyed random streams, and the integral equation that the average run
length obeys, solved by Gauss-Legendre quadrature. All values are independent and normal with standard deviation 1;
``shift`` is the mean that the chart takes for 0.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tilefab.inspection.run_length_kernels import CUSUM, EWMA, SHEWHART, fill_run_lengths
from tilefab.inspection.spc import CusumChart, EwmaChart, ShewhartChart
from tilefab.rng import stream_key

Float64Array = NDArray[np.float64]
Chart = ShewhartChart | EwmaChart | CusumChart

MOST_VALUES = 10_000_000
"""A simulated run is cut here."""

_NODES = 80


@dataclass(frozen=True)
class SimulatedRuns:
    """What a simulation found: runs, their mean length, and the standard error of that mean."""

    runs: int
    mean: float
    standard_error: float


def simulate_run_lengths(
    chart: Chart, runs: int, *, shift: float = 0.0, seed: int = 0, first: int = 0
) -> SimulatedRuns:
    """Let a chart run until it signals, many times.

    Parameters
    ----------
    chart
        Which chart; it starts at rest.
    runs
        How many runs, at least 2.
    shift
        True mean of the values.
    seed, first
        Of the random streams, and the number of the first run: runs ``first`` to ``first`` + ``runs`` - 1 of a seed are
        the same however they are divided up.

    Raises
    ------
    ValueError
        If there are fewer than 2 runs.
    """
    if runs < 2:
        raise ValueError(f"{runs} runs have no standard error; make at least 2")
    lengths = np.empty(runs, dtype=np.int64)
    kind, pace, bound = _settings(chart)
    fill_run_lengths(stream_key(seed, "run lengths"), first, kind, pace, bound, shift, MOST_VALUES, lengths)
    return SimulatedRuns(runs, float(lengths.mean()), float(lengths.std(ddof=1)) / math.sqrt(runs))


def _settings(chart: Chart) -> tuple[int, float, float]:
    if isinstance(chart, EwmaChart):
        return EWMA, chart.weight, chart.bound
    if isinstance(chart, CusumChart):
        return CUSUM, chart.slack, chart.limit
    return SHEWHART, 0.0, chart.limit


def average_run_length(chart: Chart, shift: float = 0.0) -> float:
    """Average run length of a chart that starts at rest, by its equation."""
    if isinstance(chart, EwmaChart):
        return arl_ewma(chart, shift)
    if isinstance(chart, CusumChart):
        return arl_cusum(chart, shift)
    return 1.0 / float(ndtr(-chart.limit - shift) + ndtr(shift - chart.limit))


def arl_ewma(chart: EwmaChart, shift: float = 0.0) -> float:
    """Average run length of an EWMA chart with steady limits.

    References
    ----------
    S. V. Crowder, "A simple method for studying run-length distributions of exponentially weighted moving average
    charts", Technometrics 29 (1987), equation 2.
    """
    bound, weight = chart.bound, chart.weight
    nodes, weights = _quadrature(-bound, bound)
    densities = _normal((nodes - (1.0 - weight) * nodes[:, np.newaxis]) / weight - shift) / weight
    lengths = np.linalg.solve(np.eye(_NODES) - densities * weights, np.ones(_NODES))
    return float(1.0 + (_normal(nodes / weight - shift) / weight * weights) @ lengths)


def arl_cusum(chart: CusumChart, shift: float = 0.0) -> float:
    """Average run length of a two-sided CUSUM chart.

    The rates of both sides add up (K. W. Kemp, "The average run length of the cumulative sum chart when a V-mask is
    used", Journal of the Royal Statistical Society B 23 (1961)).
    """
    return 1.0 / (1.0 / _arl_one_sided(chart, shift) + 1.0 / _arl_one_sided(chart, -shift))


def _arl_one_sided(chart: CusumChart, shift: float) -> float:
    """Page's equation (Biometrika 41 (1954)) for the upper sum: it is at 0 with a probability, elsewhere by density."""
    nodes, weights = _quadrature(0.0, chart.limit)
    starts = np.append(nodes, 0.0)
    drift = chart.slack - shift
    matrix = np.empty((_NODES + 1, _NODES + 1))
    matrix[:, :-1] = _normal(nodes + drift - starts[:, np.newaxis]) * weights
    matrix[:, -1] = ndtr(drift - starts)
    lengths = np.linalg.solve(np.eye(_NODES + 1) - matrix, np.ones(_NODES + 1))
    return float(lengths[-1])


def _quadrature(low: float, high: float) -> tuple[Float64Array, Float64Array]:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    half = 0.5 * (high - low)
    return low + half * (nodes + 1.0), half * weights


def _normal(x: Float64Array) -> Float64Array:
    return np.asarray(np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi), dtype=np.float64)
