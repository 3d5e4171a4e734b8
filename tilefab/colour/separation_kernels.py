"""Inks for a colour: the search for one recipe, in machine code."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.press_model import PressArrays, press_at, press_work
from tilefab.colour.qp import bounded_step
from tilefab.jit import kernel

Float64Array = NDArray[np.float64]

_FIRST_DAMPING = 0.1
_SMALL_STEP = 5e-5


@kernel
def solve_rows(
    lab_d50: Float64Array,
    metric: Float64Array,
    start: Float64Array,
    anchor: Float64Array,
    pull: Float64Array,
    price: Float64Array,
    upper: Float64Array,
    total_limit: float,
    press: PressArrays,
    iterations: int,
    ink_frac: Float64Array,
) -> None:
    """Minimise ``|metric (model(ink) - lab)|^2 + sum(pull (ink - anchor)^2) + 2 sum(price ink)`` within the limits.

    Every row alone, by Levenberg-Marquardt with exact bounded steps.

    Parameters
    ----------
    lab_d50, metric
        (M, 3) wanted colours; (M, 3, 3) matrices that turn a Lab error into the one to make small.
    start, anchor, pull
        (M, N) feasible starting points, (M, N) wishes, (M, N) their weights.
    price
        (M, N) what a whole ink costs.
    upper, total_limit
        (M, N) largest fraction of each ink, and largest sum.
    press
        The press model, see `tilefab.colour.press_model.press_at`.
    iterations
        Most steps for a colour.
    ink_frac
        (M, N), receives the solution.
    """
    inks = start.shape[1]
    work = press_work(press)
    lab = np.empty(3)
    jacobian = np.empty((3, inks))
    trial_jacobian = np.empty((3, inks))
    weighted = np.empty((3, inks))
    residual = np.empty(3)
    hess = np.empty((inks, inks))
    grad = np.empty(inks)
    lower_step = np.empty(inks)
    upper_step = np.empty(inks)
    step = np.empty(inks)
    here = np.empty(inks)
    trial = np.empty(inks)
    for row in range(lab_d50.shape[0]):
        here[:] = start[row]
        press_at(here, press, work, lab, jacobian)
        cost = 0.0
        for k in range(3):
            residual[k] = 0.0
            for m in range(3):
                residual[k] += metric[row, k, m] * (lab[m] - lab_d50[row, m])
            cost += residual[k] ** 2
        for i in range(inks):
            cost += pull[row, i] * (here[i] - anchor[row, i]) ** 2 + 2.0 * price[row, i] * here[i]
        damping = _FIRST_DAMPING
        for _ in range(iterations):
            for k in range(3):
                for i in range(inks):
                    weighted[k, i] = 0.0
                    for m in range(3):
                        weighted[k, i] += metric[row, k, m] * jacobian[m, i]
            room = total_limit
            for i in range(inks):
                grad[i] = pull[row, i] * (here[i] - anchor[row, i]) + price[row, i]
                for k in range(3):
                    grad[i] += weighted[k, i] * residual[k]
                for j in range(inks):
                    hess[i, j] = 0.0
                    for k in range(3):
                        hess[i, j] += weighted[k, i] * weighted[k, j]
                hess[i, i] += pull[row, i] + damping
                lower_step[i] = min(-here[i], 0.0)
                upper_step[i] = max(upper[row, i] - here[i], 0.0)
                room -= here[i]
            bounded_step(hess, grad, lower_step, upper_step, max(room, 0.0), step)
            longest = 0.0
            for i in range(inks):
                trial[i] = min(max(here[i] + step[i], 0.0), upper[row, i])
                longest = max(longest, abs(step[i]))
            press_at(trial, press, work, lab, trial_jacobian)
            trial_cost = 0.0
            for k in range(3):
                value = 0.0
                for m in range(3):
                    value += metric[row, k, m] * (lab[m] - lab_d50[row, m])
                trial_cost += value**2
            for i in range(inks):
                trial_cost += pull[row, i] * (trial[i] - anchor[row, i]) ** 2 + 2.0 * price[row, i] * trial[i]
            if trial_cost < cost:
                cost = trial_cost
                here[:] = trial
                jacobian[:] = trial_jacobian
                for k in range(3):
                    residual[k] = 0.0
                    for m in range(3):
                        residual[k] += metric[row, k, m] * (lab[m] - lab_d50[row, m])
                damping = max(damping * 0.2, 1e-4)
            else:
                damping *= 8.0
            if longest < _SMALL_STEP or damping > 1e10:
                break
        ink_frac[row] = here
