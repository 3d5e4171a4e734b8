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

from tilefab.jit import summing_kernel

Float64Array = NDArray[np.float64]

_REACH_MEAN, _REACH_SPREAD = float(np.log(1.6)), 0.7
_WEIGHT_SPREAD = 1.4
_SIZE_MEAN, _SIZE_SPREAD = float(np.log(0.5)), 1.0
_TRUST_SPREAD = 1.0
_GROWTH_MEAN, _GROWTH_SPREAD = 1.0, 1.5
_NOISE_SPREAD = 0.7
_JITTER = 1e-6


@summing_kernel
def add_residual(
    ink: Float64Array,
    centres: Float64Array,
    strengths: Float64Array,
    reach: Float64Array,
    weight: Float64Array,
    growth: float,
    lab: Float64Array,
    jacobian: Float64Array,
    whole: Float64Array,
    slopes: Float64Array,
) -> None:
    """Add the residual of one recipe to what physics says of its colour and slopes.

    Parameters
    ----------
    ink
        (N,) ink fractions.
    centres, strengths
        (N, P) and (3, P): recipes that the function is made of, and how strongly each pulls.
    reach, weight
        (N,) distance at which an ink's bump ends, and how much it counts.
    growth
        How much larger residuals are in light colours than in dark ones; see `Covariance`.
    lab, jacobian
        (3,) and (3, N): the physics', added to.
    whole, slopes
        (P,) and (N, P): work space.
    """
    inks, patches = centres.shape
    whole[:] = 1.0
    for i in range(inks):
        scale = 1.0 / reach[i]
        x = ink[i]
        counts = weight[i]
        for p in range(patches):
            offset = (x - centres[i, p]) * scale
            r = min(abs(offset), 1.0)
            left = 1.0 - r
            fourth = left * left
            fourth *= fourth
            factor = 1.0 + counts * fourth * left * ((8.0 * r + 5.0) * r + 1.0)
            slopes[i, p] = -14.0 * counts * scale * offset * (4.0 * r + 1.0) * fourth / factor
            whole[p] *= factor
    size = np.exp(growth * (lab[0] / 50.0 - 1.0))
    rise = growth / 50.0
    lightness_slope = jacobian[0].copy()
    for k in range(3):
        value = 0.0
        for p in range(patches):
            value += strengths[k, p] * whole[p]
        value *= size
        lab[k] += value
        for i in range(inks):
            slope = 0.0
            for p in range(patches):
                slope += strengths[k, p] * whole[p] * slopes[i, p]
            jacobian[k, i] += size * slope + value * rise * lightness_slope[i]


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


def likeness(first: Float64Array, second: Float64Array, reach: Float64Array, weight: Float64Array) -> Float64Array:
    """Correlation (A, B) of recipes (A, N) and (B, N), 1 for equal ones; reach and weight as in `add_residual`."""
    product = np.ones((len(first), len(second)))
    for i in range(len(reach)):
        distance = np.abs(first[:, i][:, np.newaxis] - second[:, i][np.newaxis]) / reach[i]
        product *= (1.0 + weight[i] * bump(distance)) / (1.0 + weight[i])
    return product


def likeness_slopes(
    shared: Float64Array, distances: list[Float64Array], reach: Float64Array, weight: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Slopes (N,) for the logarithms of reach and weight of a value that leans on `likeness`.

    Parameters
    ----------
    shared
        (P, P) likeness of recipes, each entry times twice the slope of the value for it.
    distances
        For each ink (P, P), how far recipes are apart.
    reach, weight
        (N,) as in `add_residual`.
    """
    by_reach, by_weight = np.empty(len(reach)), np.empty(len(weight))
    for i in range(len(reach)):
        r = np.minimum(distances[i] / reach[i], 1.0)
        weighted = weight[i] * bump(r)
        part = shared / (1.0 + weighted)
        fourth = (1.0 - r) * (1.0 - r)
        fourth *= fourth
        by_reach[i] = 7.0 * weight[i] * float((part * fourth * r * r * (4.0 * r + 1.0)).sum())
        share = weight[i] / (1.0 + weight[i])
        by_weight[i] = 0.5 * (float((part * weighted).sum()) - share * float(shared.sum()))
    return by_reach, by_weight


@dataclass(frozen=True)
class Covariance:
    """How alike the residuals of two recipes are.

    Attributes
    ----------
    reach, weight
        (N,) as in `add_residual`.
    size
        (3,) spread of the residual in L*, a* and b* at L* = 50.
    growth
        The spread grows as ``exp(growth (L* / 50 - 1))``: an error in how much an ink covers shows most where there is
        light for it to take.
    trust
        Factor on the spread that the physics' parameters are given.
    noise
        Spread of a single measurement of L*, a* and b*.
    """

    reach: Float64Array
    weight: Float64Array
    size: Float64Array
    growth: float
    trust: float
    noise: float

    def alike(self, first: Float64Array, second: Float64Array) -> Float64Array:
        """Correlation (A, B) of recipes (A, N) and (B, N), 1 for equal ones."""
        return likeness(first, second, self.reach, self.weight)

    def grown(self, lightness: Float64Array) -> Float64Array:
        """Factor (P,) on the spread at L* (P,)."""
        return np.asarray(np.exp(self.growth * (lightness / 50.0 - 1.0)), dtype=np.float64)

    def scatter(self, counts: Float64Array) -> Float64Array:
        """Variance (P,) of the mean of (P,) measurements."""
        return np.asarray(self.noise**2 / counts + _JITTER, dtype=np.float64)


@dataclass
class Evidence:
    """The measurements' improbability under a covariance, with its slopes: what the fit makes small.

    Attributes
    ----------
    ink_frac, misses, counts
        (P, N) distinct recipes, (P, 3) measured Lab less the physics', (P,) how often each was measured.
    lightness
        (P,) L* as physics has it.
    leans
        (3, P, Q) slopes of the physics for its parameters in units of their spread.
    noise
        Spread of a measurement to begin with.
    """

    ink_frac: Float64Array
    misses: Float64Array
    counts: Float64Array
    lightness: Float64Array
    leans: Float64Array
    noise: float
    _distances: list[Float64Array] = field(init=False)
    _physics: list[Float64Array] = field(init=False)

    def __post_init__(self) -> None:
        self._distances = [np.abs(x[:, np.newaxis] - x[np.newaxis]) for x in self.ink_frac.T]
        self._physics = [lean @ lean.T for lean in self.leans]

    def unpack(self, theta: Float64Array) -> Covariance:
        """Covariance of the parameters ``theta``: growth as it is, the others as logarithms."""
        inks = self.ink_frac.shape[1]
        reach, weight, size = np.split(np.exp(theta[: 2 * inks + 3]), [inks, 2 * inks])
        growth, trust, noise = float(theta[-3]), float(np.exp(theta[-2])), float(np.exp(theta[-1]))
        return Covariance(reach, weight, size, growth, trust, noise)

    def start(self) -> Float64Array:
        """Parameters to begin with: their expectation."""
        inks = self.ink_frac.shape[1]
        last = [_GROWTH_MEAN, 0.0, np.log(self.noise)]
        return np.concatenate([np.full(inks, _REACH_MEAN), np.zeros(inks), np.full(3, _SIZE_MEAN), last])

    def __call__(self, theta: Float64Array) -> tuple[float, Float64Array]:
        """Value and slopes."""
        inks = self.ink_frac.shape[1]
        covariance = self.unpack(theta)
        last = [_GROWTH_SPREAD, _TRUST_SPREAD, _NOISE_SPREAD]
        spread = np.concatenate(
            [np.full(inks, _REACH_SPREAD), np.full(inks, _WEIGHT_SPREAD), np.full(3, _SIZE_SPREAD), last]
        )
        off = (theta - self.start()) / spread
        value = 0.5 * float(off @ off)
        slope = off / spread
        grown = covariance.grown(self.lightness)
        alike = covariance.alike(self.ink_frac, self.ink_frac) * grown[:, np.newaxis] * grown
        depth = self.lightness / 50.0 - 1.0
        scatter = covariance.scatter(self.counts)
        shared = np.zeros_like(alike)
        for k in range(3):
            physics = covariance.trust**2 * self._physics[k]
            total = covariance.size[k] ** 2 * alike + physics
            total[np.diag_indices_from(total)] += scatter
            try:
                factor = cholesky(total, lower=True, check_finite=False)
            except np.linalg.LinAlgError:
                return 1e12, np.zeros_like(theta)
            inverse = cho_solve((factor, True), np.eye(len(total)), check_finite=False)
            pull = inverse @ self.misses[:, k]
            value += 0.5 * float(self.misses[:, k] @ pull) + float(np.log(np.diag(factor)).sum())
            gradient = inverse - np.outer(pull, pull)
            smooth = covariance.size[k] ** 2 * gradient * alike
            slope[2 * inks + k] += float(smooth.sum())
            slope[-3] += float(smooth.sum(axis=1) @ depth)
            slope[-2] += float((gradient * physics).sum())
            slope[-1] += float((np.diag(gradient) * covariance.noise**2 / self.counts).sum())
            shared += smooth
        by_reach, by_weight = likeness_slopes(shared, self._distances, covariance.reach, covariance.weight)
        slope[:inks] += by_reach
        slope[inks : 2 * inks] += by_weight
        return value, slope


def fit_covariance(evidence: Evidence, iterations: int) -> Covariance:
    """Find the covariance under which what physics missed is most probable.

    References
    ----------
    C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equations 5.8 and 5.9.
    """
    options = {"maxiter": iterations, "ftol": 1e-7}
    found = minimize(evidence, evidence.start(), jac=True, method="L-BFGS-B", options=options)
    return evidence.unpack(found.x)
