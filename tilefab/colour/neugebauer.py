"""The physics of ink on a tile: a Yule-Nielsen modified Neugebauer model in three broad bands.

Drops spread, so an ink covers more than it was asked to (a curve for each ink and band); inks overlap at random
(Demichel), every overlap has a colour of its own (the Neugebauer primaries), and light that spreads under the glaze
mixes their powers ``1 / n`` (Yule and Nielsen). What this can't say of a press is left to `tilefab.colour.residual`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel

Float64Array = NDArray[np.float64]

CURVE_TERMS = 3
"""Terms of a tone curve: ``x + x (1 - x) (c0 + c1 (2 x - 1) + c2 (2 x - 1)**2)``."""

_EPSILON = (6.0 / 29.0) ** 3
_SLOPE = (29.0 / 6.0) ** 2 / 3.0
_LEAST = 1e-4


@kernel
def neugebauer_at(
    ink: Float64Array,
    curves: Float64Array,
    primaries: Float64Array,
    factor: float,
    lab: Float64Array,
    jacobian: Float64Array,
    level: Float64Array,
    adjoint: Float64Array,
    by_curve: Float64Array,
    by_primary: Float64Array,
    by_factor: Float64Array,
) -> None:
    """Colour of one recipe, with its slopes for inks and for all parameters.

    Parameters
    ----------
    ink
        (N,) ink fractions.
    curves
        (N, 3, 3): terms of the tone curve of each ink in each band.
    primaries
        (2**N, 3): band values to the power 1 / factor of every overlap; bit i of the index says whether ink i is in.
    factor
        The Yule-Nielsen factor.
    lab, jacobian
        (3,) Lab and (3, N), overwritten.
    level, adjoint
        Work space, 2 ** (N + 1) each.
    by_curve, by_primary, by_factor
        (N, 3, 3), (2**N, 3) and (3,): slopes of the *band values' cube roots* for the parameters of each band.
    """
    inks = ink.shape[0]
    corners = primaries.shape[0]
    f = np.empty(3)
    slope_by_ink = np.empty((3, inks))
    for band in range(3):
        for k in range(corners):
            level[k] = primaries[k, band]
        begin = 0
        size = corners
        for i in range(inks - 1, -1, -1):
            x = ink[i]
            t = 2.0 * x - 1.0
            cover = x + x * (1.0 - x) * (curves[i, band, 0] + t * (curves[i, band, 1] + t * curves[i, band, 2]))
            half = size // 2
            for k in range(half):
                low = level[begin + k]
                level[begin + size + k] = low + cover * (level[begin + half + k] - low)
            begin += size
            size = half
        mixed = max(level[begin], _LEAST)
        ratio = mixed**factor
        if ratio > _EPSILON:
            f[band] = ratio ** (1.0 / 3.0)
            slope = f[band] / (3.0 * ratio)
        else:
            f[band] = ratio * _SLOPE + 4.0 / 29.0
            slope = _SLOPE
        by_factor[band] = slope * ratio * np.log(mixed)
        slope *= factor * ratio / mixed

        # Backwards through the same tree: how the mixture leans on every node.
        adjoint[begin] = slope
        for i in range(inks):
            x = ink[i]
            t = 2.0 * x - 1.0
            c0, c1, c2 = curves[i, band, 0], curves[i, band, 1], curves[i, band, 2]
            bell = x * (1.0 - x)
            cover = x + bell * (c0 + t * (c1 + t * c2))
            slope_cover = 1.0 - t * (c0 + t * (c1 + t * c2)) + bell * (2.0 * c1 + 4.0 * t * c2)
            half = size
            size *= 2
            above = begin
            begin -= size
            lean = 0.0
            for k in range(half):
                pull = adjoint[above + k]
                lean += pull * (level[begin + half + k] - level[begin + k])
                adjoint[begin + k] = (1.0 - cover) * pull
                adjoint[begin + half + k] = cover * pull
            slope_by_ink[band, i] = lean * slope_cover
            by_curve[i, band, 0] = lean * bell
            by_curve[i, band, 1] = lean * bell * t
            by_curve[i, band, 2] = lean * bell * t * t
        for k in range(corners):
            by_primary[k, band] = adjoint[k]
    lab[0] = 116.0 * f[1] - 16.0
    lab[1] = 500.0 * (f[0] - f[1])
    lab[2] = 200.0 * (f[1] - f[2])
    for i in range(inks):
        jacobian[0, i] = 116.0 * slope_by_ink[1, i]
        jacobian[1, i] = 500.0 * (slope_by_ink[0, i] - slope_by_ink[1, i])
        jacobian[2, i] = 200.0 * (slope_by_ink[1, i] - slope_by_ink[2, i])


@kernel
def neugebauer_rows(
    inks: Float64Array,
    curves: Float64Array,
    primaries: Float64Array,
    factor: float,
    lab: Float64Array,
    by_curve: Float64Array,
    by_primary: Float64Array,
    by_factor: Float64Array,
) -> None:
    """`neugebauer_at` for every row of inks (M, N), keeping the slopes for the parameters."""
    jacobian = np.empty((3, inks.shape[1]))
    level = np.empty(2 * primaries.shape[0])
    adjoint = np.empty(2 * primaries.shape[0])
    for row in range(inks.shape[0]):
        neugebauer_at(
            inks[row],
            curves,
            primaries,
            factor,
            lab[row],
            jacobian,
            level,
            adjoint,
            by_curve[row],
            by_primary[row],
            by_factor[row],
        )


@dataclass(frozen=True)
class Neugebauer:
    """A fitted Yule-Nielsen modified Neugebauer model.

    Attributes
    ----------
    curves
        (N, 3, 3) terms of the tone curve of each ink in each band (X, Y, Z).
    primaries
        (2**N, 3) band values, 1 for the D50 white, to the power ``1 / factor``; bit i of the index: ink i is in.
    factor
        The Yule-Nielsen factor.
    """

    curves: Float64Array = field(repr=False)
    primaries: Float64Array = field(repr=False)
    factor: float

    @property
    def inks(self) -> int:
        """Number of inks."""
        return len(self.curves)


_CURVE_MEAN = np.array([0.5, 0.0, 0.0])
_CURVE_SPREAD = np.array([0.3, 0.3, 0.3])
_BAND_SPREAD = 0.15
_FACTOR_MEAN = float(np.log(2.0))
_FACTOR_SPREAD = 0.3
_LOOSE, _TIGHT = 0.6, 0.15
_PAIR_SPREAD = 0.3
_LEAST_SLOPE, _SLOPE_SPREAD = 0.05, 0.02
_SLOPE_PLACES = np.linspace(0.0, 1.0, 9)
_TRANSFORM = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])


@dataclass(frozen=True)
class NeugebauerFit:
    """A model with what the next step of a fit needs.

    Attributes
    ----------
    model
        The model.
    parameters
        (Q,) in units of their prior spread.
    primary_mean, primary_spread
        (2**N, 3) logarithms of what the primaries are expected to be, and how far from it they may be.
    """

    model: Neugebauer
    parameters: Float64Array = field(repr=False)
    primary_mean: Float64Array = field(repr=False)
    primary_spread: float


def overlap_bits(inks: int) -> Float64Array:
    """(2**N, N): which inks are in every overlap."""
    index = np.arange(1 << inks)
    return ((index[:, np.newaxis] >> np.arange(inks)) & 1).astype(np.float64)


def _unpack(parameters: Float64Array, primary_mean: Float64Array, primary_spread: float) -> Neugebauer:
    corners = len(primary_mean)
    inks = corners.bit_length() - 1
    common = parameters[: 3 * inks].reshape(inks, 1, 3) * _CURVE_SPREAD + _CURVE_MEAN
    own = parameters[3 * inks : 12 * inks].reshape(inks, 3, 3) * _BAND_SPREAD
    primaries = np.exp(primary_mean + primary_spread * parameters[12 * inks : -1].reshape(corners, 3))
    factor = float(np.exp(_FACTOR_MEAN + _FACTOR_SPREAD * parameters[-1]))
    return Neugebauer(np.ascontiguousarray(common + own), np.ascontiguousarray(primaries), factor)


def predict_with_slopes(fit: NeugebauerFit, ink_frac: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Lab (M, 3) of recipes (M, N), and slopes (3, M, Q) for the parameters in units of their prior spread."""
    model = fit.model
    count, inks = ink_frac.shape
    corners = len(model.primaries)
    lab = np.empty((count, 3))
    by_curve = np.empty((count, inks, 3, 3))
    by_primary = np.empty((count, corners, 3))
    by_factor = np.empty((count, 3))
    neugebauer_rows(
        np.ascontiguousarray(ink_frac),
        model.curves,
        model.primaries,
        model.factor,
        lab,
        by_curve,
        by_primary,
        by_factor,
    )
    slopes = np.empty((3, count, 12 * inks + 3 * corners + 1))
    for k in range(3):
        weight = _TRANSFORM[k]
        banded = by_curve * weight[np.newaxis, np.newaxis, :, np.newaxis]
        slopes[k, :, : 3 * inks] = (banded.sum(axis=2) * _CURVE_SPREAD).reshape(count, -1)
        slopes[k, :, 3 * inks : 12 * inks] = _BAND_SPREAD * banded.reshape(count, -1)
        slopes[k, :, 12 * inks : -1] = (fit.primary_spread * by_primary * weight * model.primaries).reshape(count, -1)
        slopes[k, :, -1] = _FACTOR_SPREAD * model.factor * (by_factor @ weight)
    return lab, slopes


def _slope_penalty(model: Neugebauer) -> tuple[Float64Array, Float64Array]:
    """How far tone curves fall short of rising, in units of a spread, and the slopes of that for the parameters."""
    x = _SLOPE_PLACES
    t = 2.0 * x - 1.0
    bell = x * (1.0 - x)
    basis = np.stack([-t, -t * t + 2.0 * bell, -(t**3) + 4.0 * t * bell])
    slope = 1.0 + np.einsum("ikc,cp->ikp", model.curves, basis)
    short = np.maximum(_LEAST_SLOPE - slope, 0.0) / _SLOPE_SPREAD
    inks = model.inks
    rows = np.zeros((inks, 3, len(x), 12 * inks))
    active = np.where(short > 0.0, -1.0 / _SLOPE_SPREAD, 0.0)
    for i in range(inks):
        for k in range(3):
            pull = active[i, k][:, np.newaxis] * basis.T
            rows[i, k, :, 3 * i : 3 * i + 3] = pull * _CURVE_SPREAD
            at = 3 * inks + 9 * i + 3 * k
            rows[i, k, :, at : at + 3] = pull * _BAND_SPREAD
    chosen = short.reshape(-1) > 0.0
    return short.reshape(-1)[chosen], rows.reshape(-1, 12 * inks)[chosen]


def refine(
    fit: NeugebauerFit,
    ink_frac: Float64Array,
    lab_d50: Float64Array,
    whiten: tuple[Float64Array, Float64Array, Float64Array] | None,
    noise: Float64Array,
    iterations: int,
    trust: float = 1.0,
) -> NeugebauerFit:
    """Move a model towards measurements by damped Gauss-Newton steps.

    Parameters
    ----------
    fit
        Where to start.
    ink_frac, lab_d50
        (P, N) recipes and (P, 3) their colours.
    whiten
        For each of L*, a*, b* a (P, P) matrix that turns errors into independent ones of unit spread; None takes
        errors as independent, with the spread ``noise``.
    noise
        (P,) spread of each patch's L*, a* and b*; used where ``whiten`` is None.
    iterations
        Most steps.
    """

    def system(at: NeugebauerFit) -> tuple[float, Float64Array, Float64Array]:
        predicted, slopes = predict_with_slopes(at, ink_frac)
        size = slopes.shape[2]
        normal = np.eye(size) / trust**2
        pull = -at.parameters / trust**2
        cost = float(at.parameters @ at.parameters) / trust**2
        for k in range(3):
            miss = lab_d50[:, k] - predicted[:, k]
            if whiten is None:
                miss, lean = miss / noise, slopes[k] / noise[:, np.newaxis]
            else:
                miss, lean = whiten[k] @ miss, whiten[k] @ slopes[k]
            normal += lean.T @ lean
            pull += lean.T @ miss
            cost += float(miss @ miss)
        short, rows = _slope_penalty(at.model)
        curves = rows.shape[1]
        normal[:curves, :curves] += rows.T @ rows
        pull[:curves] -= rows.T @ short
        return cost + float(short @ short), normal, pull

    cost, normal, pull = system(fit)
    damping = 1e-2
    for _ in range(iterations):
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), pull)
        parameters = fit.parameters + step
        trial = NeugebauerFit(
            _unpack(parameters, fit.primary_mean, fit.primary_spread),
            parameters,
            fit.primary_mean,
            fit.primary_spread,
        )
        trial_cost, trial_normal, trial_pull = system(trial)
        if trial_cost < cost:
            small = cost - trial_cost < 1e-6 * cost
            fit, cost, normal, pull = trial, trial_cost, trial_normal, trial_pull
            damping = max(damping * 0.2, 1e-6)
            if small:
                break
        else:
            damping *= 10.0
            if damping > 1e6:
                break
    return fit


def _recentred(fit: NeugebauerFit, ink_frac: Float64Array, noise: Float64Array) -> NeugebauerFit:
    """The same model with primaries expected where single inks and pairs of inks put them.

    Overlaps that no patch shows are then where the rest says, instead of where the last expectation was.
    """
    inks = fit.model.inks
    bits = overlap_bits(inks)
    pairs = [bits[:, i] * bits[:, j] for i in range(inks) for j in range(i)]
    design = np.column_stack([np.ones(len(bits)), bits, *pairs])
    _, slopes = predict_with_slopes(fit, ink_frac)
    known = ((slopes / noise[:, np.newaxis]) ** 2).sum(axis=(0, 1))[12 * inks : -1].reshape(-1, 3)
    logs = np.log(fit.model.primaries)
    mean = np.empty_like(logs)
    penalty = np.diag(np.r_[np.zeros(1 + inks), np.full(len(pairs), 1.0 / _PAIR_SPREAD**2)])
    for band in range(3):
        information = known[:, band] / fit.primary_spread**2
        weight = 1.0 / (_TIGHT**2 + 1.0 / np.maximum(information, 1e-9))
        normal = design.T @ (weight[:, np.newaxis] * design) + penalty + 1e-9 * np.eye(design.shape[1])
        mean[:, band] = design @ np.linalg.solve(normal, design.T @ (weight * logs[:, band]))
    mean = np.minimum(mean, logs[0].max())
    parameters = fit.parameters.copy()
    parameters[12 * inks : -1] = np.clip((logs - mean) / _TIGHT, -6.0, 6.0).reshape(-1)
    return NeugebauerFit(_unpack(parameters, mean, _TIGHT), parameters, mean, _TIGHT)


def fit_neugebauer(ink_frac: Float64Array, lab_d50: Float64Array, noise: Float64Array) -> NeugebauerFit:
    """Fit a model to measured patches.

    Parameters
    ----------
    ink_frac, lab_d50
        (P, N) recipes and (P, 3) absolute Lab under D50.
    noise
        (P,) what spread of L*, a* and b* to expect between model and patches.

    References
    ----------
    J. A. C. Yule, W. J. Nielsen, "The penetration of light into paper and its effect on halftone reproduction", TAGA
    (1951); R. Balasubramanian, "Optimization of the spectral Neugebauer model for printer characterization", Journal
    of Electronic Imaging 8 (1999).
    """
    inks = ink_frac.shape[1]
    height = (lab_d50[:, 0] + 16.0) / 116.0
    f = np.stack([height + lab_d50[:, 1] / 500.0, height, height - lab_d50[:, 2] / 200.0], axis=1)
    ratio = np.where(f > 6.0 / 29.0, f**3, (f - 4.0 / 29.0) / _SLOPE)
    logs = np.log(np.maximum(ratio, 1e-4)) / np.exp(_FACTOR_MEAN)
    linear = np.column_stack([np.ones(len(ink_frac)), ink_frac])
    slopes, *_ = np.linalg.lstsq(linear, logs, rcond=None)
    mean = np.column_stack([np.ones(1 << inks), overlap_bits(inks)]) @ slopes
    parameters = np.zeros(12 * inks + 3 * (1 << inks) + 1)
    fit = NeugebauerFit(_unpack(parameters, mean, _LOOSE), parameters, mean, _LOOSE)
    fit = refine(fit, ink_frac, lab_d50, None, noise, 15)
    for _ in range(2):
        fit = _recentred(fit, ink_frac, noise)
        fit = refine(fit, ink_frac, lab_d50, None, noise, 12)
    return fit
