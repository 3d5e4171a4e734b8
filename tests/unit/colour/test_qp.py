"""The bounded step against brute force over all sets of active bounds."""

import itertools

import numpy as np

from tilefab.colour.qp import bounded_step


def plain_step(hess: np.ndarray, grad: np.ndarray, low: np.ndarray, up: np.ndarray, most: float) -> float:
    """Least value over every choice of which bounds hold with equality."""
    size = len(grad)
    best = np.inf
    for states in itertools.product((0, 1, 2), repeat=size):
        for with_sum in (False, True):
            fixed = np.array([low[i] if s == 1 else up[i] if s == 2 else 0.0 for i, s in enumerate(states)])
            free = [i for i, s in enumerate(states) if s == 0]
            step = fixed.copy()
            if free:
                k = len(free)
                system = np.zeros((k + with_sum, k + with_sum))
                system[:k, :k] = hess[np.ix_(free, free)]
                right = np.zeros(k + with_sum)
                right[:k] = -grad[free] - hess[free] @ fixed
                if with_sum:
                    system[:k, k] = system[k, :k] = 1.0
                    right[k] = most - fixed.sum()
                step[free] = np.linalg.solve(system, right)[:k]
            feasible = (step >= low - 1e-9).all() and (step <= up + 1e-9).all() and step.sum() <= most + 1e-9
            if feasible:
                best = min(best, 0.5 * step @ hess @ step + grad @ step)
    return float(best)


def test_step_is_the_best_feasible_one() -> None:
    draw = np.random.default_rng(11)
    step = np.empty(4)
    for trial in range(150):
        root = draw.normal(size=(3, 4)) * 10.0 ** draw.uniform(-1, 1)
        hess = root.T @ root + 10.0 ** draw.uniform(-3, 0) * np.eye(4)
        grad = draw.normal(size=4) * 5.0
        low, up = -draw.random(4), draw.random(4)
        low[draw.random(4) < 0.3] = 0.0
        up[draw.random(4) < 0.3] = 0.0
        most = 0.0 if trial % 5 == 0 else float(draw.uniform(0, 1.5))
        bounded_step(hess, grad, low, up, most, step)
        assert (step >= low - 1e-12).all()
        assert (step <= up + 1e-12).all()
        assert step.sum() <= most + 1e-9
        value = 0.5 * step @ hess @ step + grad @ step
        best = plain_step(hess, grad, low, up, most)
        assert value <= best + 1e-7 * max(1.0, abs(best))
