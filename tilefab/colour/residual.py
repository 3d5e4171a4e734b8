"""What physics leaves over: a smooth function of the inks, learnt from the measured patches themselves.

A Gaussian process whose covariance is a product over inks of ``1 + weight * bump(distance / reach)``: it holds what one
ink does alone, what pairs do together and so on, each less trusted than the last. Reaches, weights, sizes and the noise
are those under which the measurements are most probable.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky
from scipy.optimize import minimize

from tilefab.jit import kernel

Float64Array = NDArray[np.float64]

_REACH_MEAN, _REACH_SPREAD = float(np.log(1.6)), 0.7
_WEIGHT_SPREAD = 1.4
_SIZE_MEAN, _SIZE_SPREAD = float(np.log(0.5)), 1.0
_TRUST_SPREAD = 1.0
_NOISE_SPREAD = 0.7
_JITTER = 1e-6


@kernel
def residual_at(
    ink: Float64Array,
    centres: Float64Array,
    reach: Float64Array,
    weight: Float64Array,
    strengths: Float64Array,
    lab: Float64Array,
    jacobian: Float64Array,
    ahead: Float64Array,
    slopes: Float64Array,
) -> None:
    """Add the residual of one recipe to its colour and slopes.

    Parameters
    ----------
    ink
        (N,) ink fractions.
    centres, strengths
        (P, N) and (P, 3): recipes that the function is made of, and how strongly each pulls.
    reach, weight
        (N,) distance at which an ink's bump ends, and how much it counts.
    lab, jacobian
        (3,) and (3, N), added to.
    ahead, slopes
        (N + 1,) and (N,): work space.
    """
    inks = ink.shape[0]
    for p in range(centres.shape[0]):
        ahead[0] = 1.0
        for i in range(inks):
            offset = (ink[i] - centres[p, i]) / reach[i]
            r = abs(offset)
            value = 0.0
            slope = 0.0
            if r < 1.0:
                left = 1.0 - r
                fourth = left * left
                fourth *= fourth
                value = fourth * left * (8.0 * r * r + 5.0 * r + 1.0)
                slope = -14.0 * offset * (4.0 * r + 1.0) * fourth / reach[i]
            factor = 1.0 + weight[i] * value
            slopes[i] = weight[i] * slope / factor
            ahead[i + 1] = ahead[i] * factor
        whole = ahead[inks]
        for k in range(3):
            pull = strengths[p, k] * whole
            lab[k] += pull
            for i in range(inks):
                jacobian[k, i] += pull * slopes[i]


def bump(r: Float64Array) -> Float64Array:
    """``(1 - r)**5 (8 r**2 + 5 r + 1)`` up to r = 1, then 0: positive definite and four times smooth on a line.

    References
    ----------
    H. Wendland, "Piecewise polynomial, positive definite and compactly supported radial functions of minimal degree",
    Advances in Computational Mathematics 4 (1995), table for one dimension.
    """
    left = np.maximum(1.0 - r, 0.0)
    fourth = left * left
    fourth *= fourth
    return np.asarray(fourth * left * ((8.0 * r + 5.0) * r + 1.0), dtype=np.float64)


@dataclass(frozen=True)
class Covariance:
    """How alike the residuals of two recipes are.

    Attributes
    ----------
    reach, weight
        (N,) as in `residual_at`.
    size
        (3,) spread of the residual in L*, a* and b*.
    trust
        (3,) factor on the spread that the physics' parameters are given.
    noise
        Spread of a single measurement of L*, a* and b*.
    """

    reach: Float64Array
    weight: Float64Array
    size: Float64Array
    trust: Float64Array
    noise: float

    def alike(self, first: Float64Array, second: Float64Array) -> Float64Array:
        """Correlation (A, B) of recipes (A, N) and (B, N), 1 for equal ones."""
        product = np.ones((len(first), len(second)))
        for i in range(len(self.reach)):
            distance = np.abs(first[:, i][:, np.newaxis] - second[:, i][np.newaxis]) / self.reach[i]
            product *= (1.0 + self.weight[i] * bump(distance)) / (1.0 + self.weight[i])
        return product


@dataclass
class _Evidence:
    """The measurements' improbability under a covariance, with its slopes: what the fit makes small."""

    ink_frac: Float64Array
    misses: Float64Array
    counts: Float64Array
    leans: Float64Array
    noise: float
    distances: list[Float64Array] = field(init=False)

    def __post_init__(self) -> None:
        self.distances = [np.abs(x[:, np.newaxis] - x[np.newaxis]) for x in self.ink_frac.T]
        self.spreads = [lean @ lean.T for lean in self.leans]

    def unpack(self, theta: Float64Array) -> Covariance:
        inks = self.ink_frac.shape[1]
        reach, weight, size, trust, noise = np.split(np.exp(theta), [inks, 2 * inks, 2 * inks + 3, 2 * inks + 6])
        return Covariance(reach, weight, size, trust, float(noise[0]))

    def start(self) -> Float64Array:
        inks = self.ink_frac.shape[1]
        return np.concatenate(
            [np.full(inks, _REACH_MEAN), np.zeros(inks), np.full(3, _SIZE_MEAN), np.zeros(3), [np.log(self.noise)]]
        )

    def __call__(self, theta: Float64Array) -> tuple[float, Float64Array]:
        inks = self.ink_frac.shape[1]
        covariance = self.unpack(theta)
        spread = np.concatenate(
            [
                np.full(inks, _REACH_SPREAD),
                np.full(inks, _WEIGHT_SPREAD),
                np.full(3, _SIZE_SPREAD),
                np.full(3, _TRUST_SPREAD),
                [_NOISE_SPREAD],
            ]
        )
        off = (theta - self.start()) / spread
        value = 0.5 * float(off @ off)
        slope = off / spread
        alike = covariance.alike(self.ink_frac, self.ink_frac)
        shared = np.zeros_like(alike)
        for k in range(3):
            smooth = covariance.size[k] ** 2 * alike
            physics = covariance.trust[k] ** 2 * self.spreads[k]
            total = smooth + physics
            scatter = covariance.noise**2 / self.counts + _JITTER
            total[np.diag_indices_from(total)] += scatter
            try:
                factor = cholesky(total, lower=True, check_finite=False)
            except np.linalg.LinAlgError:
                return 1e12, np.zeros_like(theta)
            inverse = cho_solve((factor, True), np.eye(len(total)), check_finite=False)
            pull = inverse @ self.misses[:, k]
            value += 0.5 * float(self.misses[:, k] @ pull) + float(np.log(np.diag(factor)).sum())
            gradient = inverse - np.outer(pull, pull)
            slope[2 * inks + k] += float((gradient * smooth).sum())
            slope[2 * inks + 3 + k] += float((gradient * physics).sum())
            slope[-1] += float((np.diag(gradient) * covariance.noise**2 / self.counts).sum())
            shared += gradient * smooth
        for i in range(inks):
            r = np.minimum(self.distances[i] / covariance.reach[i], 1.0)
            weighted = covariance.weight[i] * bump(r)
            part = shared / (1.0 + weighted)
            fourth = (1.0 - r) * (1.0 - r)
            fourth *= fourth
            slope[i] += 7.0 * covariance.weight[i] * float((part * fourth * r * r * (4.0 * r + 1.0)).sum())
            share = covariance.weight[i] / (1.0 + covariance.weight[i])
            slope[inks + i] += 0.5 * (float((part * weighted).sum()) - share * float(shared.sum()))
        return value, slope


def fit_covariance(
    ink_frac: Float64Array,
    misses: Float64Array,
    counts: Float64Array,
    leans: Float64Array,
    noise: float,
    iterations: int = 40,
) -> Covariance:
    """Find the covariance under which what physics missed is most probable.

    Parameters
    ----------
    ink_frac, misses, counts
        (P, N) distinct recipes, (P, 3) measured Lab less the physics', and (P,) how often each was measured.
    leans
        (3, P, Q) slopes of the physics for its parameters in units of their spread, so that what the physics could
        still explain is not taken for residual.
    noise
        Spread of a measurement to begin with.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8 and 5.9.
    """
    evidence = _Evidence(ink_frac, misses, counts, leans, noise)
    found = minimize(
        evidence, evidence.start(), jac=True, method="L-BFGS-B", options={"maxiter": iterations, "ftol": 1e-7}
    )
    return evidence.unpack(found.x)
