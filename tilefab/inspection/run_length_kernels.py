"""How long control charts run until they signal, one keyed stream of normal values a run. See `run_lengths`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.rng import philox_4x32

SHEWHART, EWMA, CUSUM = 0, 1, 2

_11 = np.uint64(11)
_UNIT = 1.0 / 9007199254740992.0


@kernel
def normal_pair(key: np.uint64, run: int, pair: int) -> tuple[float, float]:
    """Two independent standard normal values: the ``pair``-th of a run (Box and Muller's transform)."""
    first, second = philox_4x32(key, np.uint64(pair), np.uint64(run))
    radius = math.sqrt(-2.0 * math.log((np.float64(first >> _11) + 0.5) * _UNIT))
    angle = 2.0 * math.pi * (np.float64(second >> _11) * _UNIT)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def fill_run_lengths(
    key: np.uint64,
    first: int,
    chart: int,
    pace: float,
    bound: float,
    shift: float,
    most: int,
    lengths: NDArray[np.int64],
) -> None:
    """Fill (R,) ``lengths`` with the number of values that runs ``first``, ``first`` + 1 ... took to their signal.

    ``pace`` is the EWMA's weight or the CUSUM's slack; a run that has not ended is cut at ``most``.
    """
    for place in range(lengths.size):
        run = first + place
        average = high = low = spare = 0.0
        done = most
        for count in range(most):
            if count % 2 == 0:
                value, spare = normal_pair(key, run, count // 2)
            else:
                value = spare
            value += shift
            if chart == CUSUM:
                high = max(0.0, high + value - pace)
                low = max(0.0, low - value - pace)
                beyond = high > bound or low > bound
            elif chart == EWMA:
                average = average + pace * (value - average)
                beyond = abs(average) > bound
            else:
                beyond = abs(value) > bound
            if beyond:
                done = count + 1
                break
        lengths[place] = done
