"""A small convex quadratic programme with bounds and one sum limit: the step of the ink solver."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel

Vector = NDArray[np.float64]

_FREE = 0
_AT_LOWER = 1
_AT_UPPER = 2
_TOLERANCE = 1e-11
_MAX_CHANGES = 60


@kernel
def _solve_free(hess: Vector, rhs: Vector, index: NDArray[np.int64], count: int, out: Vector) -> None:
    """Solve ``hess[free, free] x = rhs`` for two right-hand sides by Gaussian elimination with pivoting."""
    matrix = np.empty((count, count + 2))
    for i in range(count):
        for j in range(count):
            matrix[i, j] = hess[index[i], index[j]]
        matrix[i, count] = rhs[i, 0]
        matrix[i, count + 1] = rhs[i, 1]
    for i in range(count):
        pivot = i
        for k in range(i + 1, count):
            if abs(matrix[k, i]) > abs(matrix[pivot, i]):
                pivot = k
        if pivot != i:
            for j in range(count + 2):
                matrix[i, j], matrix[pivot, j] = matrix[pivot, j], matrix[i, j]
        for k in range(i + 1, count):
            factor = matrix[k, i] / matrix[i, i]
            for j in range(i, count + 2):
                matrix[k, j] -= factor * matrix[i, j]
    for side in range(2):
        for i in range(count - 1, -1, -1):
            value = matrix[i, count + side]
            for j in range(i + 1, count):
                value -= matrix[i, j] * out[j, side]
            out[i, side] = value / matrix[i, i]


@kernel
def bounded_step(hess: Vector, grad: Vector, lower: Vector, upper: Vector, sum_upper: float, step: Vector) -> None:
    """Minimise ``step' hess step / 2 + grad' step`` within bounds on each value and on their sum.

    Parameters
    ----------
    hess
        (N, N) symmetric, positive definite.
    grad
        (N,).
    lower, upper
        (N,) with ``lower <= 0 <= upper``: the current point, step 0, is feasible.
    sum_upper
        0 or more.
    step
        (N,) receives the solution.

    Notes
    -----
    The primal active-set method: J. Nocedal, S. Wright, "Numerical Optimization", 2nd edition, algorithm
    16.3. The step stays feasible throughout, so even a stop at the limit of changes gives a usable one.
    """
    size = grad.shape[0]
    state = np.zeros(size, np.int64)
    index = np.empty(size, np.int64)
    rhs = np.empty((size, 2))
    solved = np.empty((size, 2))
    goal = np.empty(size)
    sum_active = False
    step[:] = 0.0
    for _ in range(_MAX_CHANGES):
        count = 0
        fixed_sum = 0.0
        for i in range(size):
            if state[i] == _FREE:
                index[count] = i
                count += 1
            else:
                fixed_sum += step[i]
        goal[:] = step
        force = 0.0
        if count == 0:
            sum_active = False
        else:
            for row in range(count):
                i = index[row]
                value = -grad[i]
                for j in range(size):
                    if state[j] != _FREE:
                        value -= hess[i, j] * step[j]
                rhs[row, 0] = value
                rhs[row, 1] = 1.0
            _solve_free(hess, rhs, index, count, solved)
            if sum_active:
                total = 0.0
                ones = 0.0
                for row in range(count):
                    total += solved[row, 0]
                    ones += solved[row, 1]
                force = (total + fixed_sum - sum_upper) / ones
            for row in range(count):
                goal[index[row]] = solved[row, 0] - force * solved[row, 1]

        # How far towards the goal the bounds allow.
        fraction = 1.0
        blocking = -1
        goal_sum = 0.0
        step_sum = 0.0
        for i in range(size):
            change = goal[i] - step[i]
            goal_sum += goal[i]
            step_sum += step[i]
            if state[i] == _FREE:
                if goal[i] < lower[i] and (lower[i] - step[i]) / change < fraction:
                    fraction = max((lower[i] - step[i]) / change, 0.0)
                    blocking = i
                elif goal[i] > upper[i] and (upper[i] - step[i]) / change < fraction:
                    fraction = max((upper[i] - step[i]) / change, 0.0)
                    blocking = i
        if not sum_active and goal_sum > sum_upper:
            limit = max((sum_upper - step_sum) / (goal_sum - step_sum), 0.0)
            if limit < fraction:
                fraction = limit
                blocking = size
        for i in range(size):
            step[i] += fraction * (goal[i] - step[i])
        if blocking == size:
            sum_active = True
            continue
        if blocking >= 0:
            if goal[blocking] < lower[blocking]:
                state[blocking] = _AT_LOWER
                step[blocking] = lower[blocking]
            else:
                state[blocking] = _AT_UPPER
                step[blocking] = upper[blocking]
            continue

        # At the goal: release the bound that most wants to be left, or stop.
        worst = -_TOLERANCE
        release = -1
        if sum_active and force < worst:
            worst = force
            release = size
        for i in range(size):
            if state[i] != _FREE:
                slope = grad[i] + force
                for j in range(size):
                    slope += hess[i, j] * step[j]
                if state[i] == _AT_UPPER:
                    slope = -slope
                if slope < worst:
                    worst = slope
                    release = i
        if release < 0:
            return
        if release == size:
            sum_active = False
        else:
            state[release] = _FREE
