"""The eight rules of Nelson: patterns of points on a control chart that chance seldom makes.

References
----------
L. S. Nelson, "The Shewhart control chart: tests for special causes", Journal of Quality Technology 16 (1984), 237-239.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

IntArray = NDArray[np.int64]

RULES: tuple[str, ...] = (
    "a point beyond 3 sigma",
    "9 points in a row on one side of the centre",
    "6 points in a row, each higher or each lower than the last",
    "14 points in a row, up and down in turns",
    "2 of 3 points in a row beyond 2 sigma on one side",
    "4 of 5 points in a row beyond 1 sigma on one side",
    "15 points in a row within 1 sigma of the centre",
    "8 points in a row beyond 1 sigma, on whichever side",
)
"""What each rule finds, for people; rule 1 comes first."""

LONGEST = 15
"""Points that the longest rule looks at."""


def nelson_rules(values: ArrayLike, centre: float, sigma: float) -> tuple[IntArray, ...]:
    """Find the points at which each of the eight rules is fulfilled.

    Parameters
    ----------
    values
        (N,) finite values in order.
    centre, sigma
        The centre line, and the standard deviation of single values, above 0.

    Returns
    -------
    tuple of numpy.ndarray
        Eight arrays of rising int64 indices: the last point of each pattern. For rules 5 and 6 that point is itself one
        of those beyond. A pattern that goes on is found at each further point.

    Raises
    ------
    ValueError
        If a value is not finite, or sigma is not above 0.

    Examples
    --------
    >>> [rule.tolist() for rule in nelson_rules([0.0, 0.5, 3.2, -0.1], 0.0, 1.0)]
    [[2], [], [], [], [], [], [], []]
    """
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or not np.isfinite(x).all():
        raise ValueError(f"values of shape {x.shape} must be finite values in a row")
    if not (math.isfinite(sigma) and sigma > 0.0 and math.isfinite(centre)):
        raise ValueError(f"centre {centre} must be finite and sigma {sigma} above 0")
    z = (x - centre) / sigma
    side, size, step = np.sign(z), np.abs(z), np.sign(np.diff(x))
    turn = np.concatenate((np.zeros(min(1, x.size)), step))
    found = (
        size > 3.0,
        _runs(side > 0.0, 9) | _runs(side < 0.0, 9),
        _runs(turn > 0.0, 5) | _runs(turn < 0.0, 5),
        _alternating(turn, 13),
        _most(side, size > 2.0, 2, 3),
        _most(side, size > 1.0, 4, 5),
        _runs(size < 1.0, 15),
        _runs(size > 1.0, 8),
    )
    return tuple(np.flatnonzero(points).astype(np.int64) for points in found)


def _window_sum(marks: NDArray[np.bool_], length: int) -> IntArray:
    """For each point, how many of the ``length`` points that end there are marked."""
    total = np.concatenate((np.zeros(1, np.int64), np.cumsum(marks, dtype=np.int64)))
    ends = np.arange(1, marks.size + 1)
    return np.asarray(total[ends] - total[np.maximum(ends - length, 0)], dtype=np.int64)


def _runs(marks: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    return np.asarray(_window_sum(marks, length) >= length, dtype=np.bool_)


def _alternating(turn: NDArray[np.float64], length: int) -> NDArray[np.bool_]:
    # ``length`` steps in turns are ``length - 1`` changes of direction in a row.
    changes = np.zeros(turn.size, dtype=np.bool_)
    changes[1:] = turn[1:] * turn[:-1] < 0.0
    return _runs(changes, length - 1)


def _most(side: NDArray[np.float64], beyond: NDArray[np.bool_], count: int, length: int) -> NDArray[np.bool_]:
    found = np.zeros(side.size, dtype=np.bool_)
    for which in (1.0, -1.0):
        marks = beyond & (side == which)
        found |= marks & (_window_sum(marks, length) >= count)
    return found


def newest_rules(recent: ArrayLike) -> tuple[int, ...]:
    """Numbers, 1 to 8, of the rules that the last of some standardised values fulfils; the last `LONGEST` suffice."""
    z = np.asarray(recent, dtype=np.float64)[-LONGEST:]
    return tuple(
        rule for rule, points in enumerate(nelson_rules(z, 0.0, 1.0), 1) if points.size and points[-1] == z.size - 1
    )


def chance_rates() -> tuple[float, ...]:
    """Share of points that each rule finds by chance in independent normal values, once enough have passed.

    Exact, by counting: so that a report can say how many findings are to be expected if nothing is wrong.
    """
    beyond_1, beyond_2, beyond_3 = (math.erfc(limit / math.sqrt(2.0)) for limit in (1.0, 2.0, 3.0))
    one, two = beyond_1 / 2.0, beyond_2 / 2.0
    return (
        beyond_3,
        2.0 * 0.5**9,
        2.0 / math.factorial(6),
        2.0 * _zigzags(14) / math.factorial(14),
        2.0 * two * (1.0 - (1.0 - two) ** 2),
        2.0 * one * (4.0 * one**3 * (1.0 - one) + one**4),
        (1.0 - beyond_1) ** 15,
        beyond_1**8,
    )


def _zigzags(n: int) -> int:
    """How many orders of n different values rise and fall in turns, beginning with a rise (Euler's zigzag numbers)."""
    row = [1]
    for _ in range(n):
        sums = [0]
        for value in reversed(row):
            sums.append(sums[-1] + value)
        row = sums
    return row[-1]


@dataclass(frozen=True)
class RuleFindings:
    """One rule's findings among ``values`` values: how often, and how often chance alone would find it."""

    rule: int
    text: str
    points: int
    by_chance: float


def count_findings(z: ArrayLike) -> tuple[RuleFindings, ...]:
    """Count what the eight rules find in standardised values."""
    values = np.asarray(z, dtype=np.float64)
    found = nelson_rules(values, 0.0, 1.0)
    return tuple(
        RuleFindings(rule, text, points.size, rate * values.size)
        for rule, (text, points, rate) in enumerate(zip(RULES, found, chance_rates(), strict=True), 1)
    )
