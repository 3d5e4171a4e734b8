"""What colour inks fire to: physics, what physics leaves over, and how the kiln has drifted since.

A recipe's inks are first moved by the drift of kiln and heads (none in a fresh model), then go through the
Yule-Nielsen modified Neugebauer model of `tilefab.colour.neugebauer`, to which the smooth residual of
`tilefab.colour.residual` is added. Both are fitted together to measured patches; the error that the model reports of
itself is for patches it has not seen.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from tilefab import rng
from tilefab.colour.neugebauer import (
    NeugebauerFit,
    fit_neugebauer,
    neugebauer_at,
    overlap_bits,
    predict_with_slopes,
    refine,
)
from tilefab.colour.residual import Covariance, Evidence, add_residual, fit_covariance
from tilefab.colour.spaces import delta_e_2000
from tilefab.jit import kernel

Float64Array = NDArray[np.float64]

_SAME_RECIPE = 5e-5
_FIRST_NOISE, _FIRST_MISFIT = 0.3, 0.45
_ROUNDS = 2
_COVARIANCE_STEPS = 20
_REFINE_STEPS = 6
_JUDGED_PATCHES = 500
_SURFACE_SHARE = 0.9


class PressArrays(NamedTuple):
    """A press model as kernels take it; shapes for N inks and P patches.

    ``curves`` (N, 3, 3), ``primaries`` (2**N, 3) and ``factor`` are the physics; ``centres`` (N, P), ``strengths``
    (3, P), ``reach`` (N,), ``weight`` (N,) and ``growth`` the residual; ``gain`` (N,) and ``bend`` (N,) the drift of
    tones: an ink fraction x prints as ``x (1 + gain) + bend x (1 - x)``.
    """

    curves: Float64Array
    primaries: Float64Array
    factor: float
    centres: Float64Array
    strengths: Float64Array
    reach: Float64Array
    weight: Float64Array
    growth: float
    gain: Float64Array
    bend: Float64Array


class PressWork(NamedTuple):
    """Work space of `press_at`, made by `press_work`."""

    printed: Float64Array
    level: Float64Array
    adjoint: Float64Array
    by_curve: Float64Array
    by_primary: Float64Array
    by_factor: Float64Array
    whole: Float64Array
    slopes: Float64Array


@kernel
def press_work(press: PressArrays) -> PressWork:
    """Work space for one thread."""
    inks, patches = press.centres.shape
    corners = press.primaries.shape[0]
    return PressWork(
        np.empty(inks),
        np.empty(2 * corners),
        np.empty(2 * corners),
        np.empty((inks, 3, 3)),
        np.empty((corners, 3)),
        np.empty(3),
        np.empty(patches),
        np.empty((inks, patches)),
    )


@kernel
def press_at(ink: Float64Array, press: PressArrays, work: PressWork, lab: Float64Array, jacobian: Float64Array) -> None:
    """Colour and its slopes at one recipe.

    Parameters
    ----------
    ink
        (N,) ink fractions.
    press, work
        The model and its work space.
    lab, jacobian
        (3,) and (3, N), overwritten.
    """
    inks = ink.shape[0]
    for i in range(inks):
        work.printed[i] = ink[i] * (1.0 + press.gain[i]) + press.bend[i] * ink[i] * (1.0 - ink[i])
    neugebauer_at(
        work.printed,
        press.curves,
        press.primaries,
        press.factor,
        lab,
        jacobian,
        work.level,
        work.adjoint,
        work.by_curve,
        work.by_primary,
        work.by_factor,
    )
    add_residual(
        work.printed,
        press.centres,
        press.strengths,
        press.reach,
        press.weight,
        press.growth,
        lab,
        jacobian,
        work.whole,
        work.slopes,
    )
    for k in range(3):
        for i in range(inks):
            jacobian[k, i] *= 1.0 + press.gain[i] + press.bend[i] * (1.0 - 2.0 * ink[i])


@kernel
def press_rows(inks: Float64Array, press: PressArrays, lab: Float64Array, jacobian: Float64Array) -> None:
    """`press_at` for every row: inks (M, N), lab (M, 3), jacobian (M, 3, N)."""
    work = press_work(press)
    for row in range(inks.shape[0]):
        press_at(inks[row], press, work, lab[row], jacobian[row])


@dataclass(frozen=True)
class ModelErrors:
    """How near a model comes to patches; colour differences are CIEDE2000.

    Attributes
    ----------
    fit_mean, fit_p95
        Between the model and the patches it was fitted to.
    held_out_mean, held_out_p95
        Between every patch and the model as it would be without it; the patch's own noise included.
    expected_mean
        Between the model and the press itself, the noise of measurements taken off; an estimate.
    noise
        Spread of a single reading of L*, a* and b* about the model, in Lab units.
    repeat_noise
        The same from recipes that were measured more than once; None without any.
    held_out
        (P,) difference of each patch, in the order of the measurements.
    held_out_lab
        (P, 3) what the model says of each patch without it.
    surprise
        (P,) how far each patch lies from that, in units of how sure the model is of it.
    """

    fit_mean: float
    fit_p95: float
    held_out_mean: float
    held_out_p95: float
    expected_mean: float
    noise: float
    repeat_noise: float | None
    held_out: Float64Array = field(repr=False)
    held_out_lab: Float64Array = field(repr=False)
    surprise: Float64Array = field(repr=False)


@dataclass(frozen=True)
class PressModel:
    """A fitted press: from ink fractions to the colour after firing.

    Attributes
    ----------
    arrays
        The model as kernels take it.
    max_total
        Largest ink sum among the patches: beyond it the model is a guess.
    errors
        How good it is.
    """

    arrays: PressArrays = field(repr=False)
    max_total: float
    errors: ModelErrors

    @property
    def inks(self) -> int:
        """Number of inks."""
        return len(self.arrays.reach)

    def lab_and_slopes(self, ink_frac: NDArray[np.floating]) -> tuple[Float64Array, Float64Array]:
        """Absolute Lab (M, 3) under D50 of recipes (M, N), and its slopes (M, 3, N) in Lab units a whole ink.

        Raises
        ------
        ValueError
            If the shape is not (M, inks).
        """
        inks = np.ascontiguousarray(ink_frac, dtype=np.float64)
        if inks.ndim != 2 or inks.shape[1] != self.inks:
            raise ValueError(f"ink_frac must be (M, {self.inks}), but its shape is {inks.shape}")
        lab = np.empty((inks.shape[0], 3))
        jacobian = np.empty((inks.shape[0], 3, self.inks))
        press_rows(inks, self.arrays, lab, jacobian)
        return lab, jacobian

    def lab(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Absolute Lab under D50, (M, 3) float64, of recipes (M, N) of ink fractions 0 to 1.

        Raises
        ------
        ValueError
            If the shape is not (M, inks).
        """
        return self.lab_and_slopes(ink_frac)[0]

    @property
    def white_lab(self) -> Float64Array:
        """(3,) absolute Lab of the unprinted tile."""
        return np.asarray(self.lab(np.zeros((1, self.inks)))[0])

    def with_drift(
        self, gain: Float64Array, bend: Float64Array, glaze: Float64Array, fade: Float64Array, cross: Float64Array
    ) -> PressModel:
        """The same press after its kiln has drifted.

        Parameters
        ----------
        gain, bend
            (N,) change of each ink's tone; see `PressArrays`.
        glaze
            (3,) by how much all overlaps and the bare tile grow lighter in each band: change of the logarithm of the
            primaries.
        fade
            (N, 3) the same for all overlaps that an ink is in.
        cross
            (N (N - 1) / 2, 3) the same for all that two inks are in, in the order of `ink_pairs`.
        """
        bits = overlap_bits(self.inks)
        both = np.stack([bits[:, i] * bits[:, j] for i, j in ink_pairs(self.inks)], axis=1) if self.inks > 1 else None
        light = self.arrays.primaries**self.arrays.factor
        # What the surface reflects before any light meets an ink can't fade.
        inside = 1.0 - _SURFACE_SHARE * light.min(axis=0) / light
        change = np.exp((glaze + bits @ fade + (0.0 if both is None else both @ cross)) * inside)
        arrays = self.arrays._replace(primaries=self.arrays.primaries * change, gain=gain, bend=bend)
        return replace(self, arrays=arrays)


def ink_pairs(inks: int) -> list[tuple[int, int]]:
    """All pairs of inks, first (0, 1), then (0, 2) and so on."""
    return list(itertools.combinations(range(inks), 2))


@dataclass(frozen=True)
class _Patches:
    """Distinct recipes in a fixed order, their mean colours, how often each was measured, and each row's recipe."""

    recipes: Float64Array
    lab: Float64Array
    counts: Float64Array
    rows: NDArray[np.int64]


def merge_repeats(ink_frac: Float64Array, lab_d50: Float64Array) -> _Patches:
    """Average patches of one recipe."""
    rounded = np.round(ink_frac / _SAME_RECIPE).astype(np.int64)
    keys, inverse, counts = np.unique(rounded, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    recipes = np.zeros((len(keys), ink_frac.shape[1]))
    colours = np.zeros((len(keys), lab_d50.shape[1]))
    np.add.at(recipes, inverse, ink_frac)
    np.add.at(colours, inverse, lab_d50)
    weight = counts[:, np.newaxis]
    return _Patches(recipes / weight, colours / weight, counts.astype(np.float64), inverse)


def fit_press_model(ink_frac: NDArray[np.floating], lab: NDArray[np.floating]) -> PressModel:
    """Fit a press model to measured patches.

    Parameters
    ----------
    ink_frac
        (P, N) ink fractions, 0 to 1, N 1 to 8. Recipes measured more than once are averaged and trusted more.
    lab
        (P, 3) measured absolute Lab under D50.

    Returns
    -------
    PressModel

    Raises
    ------
    ValueError
        If shapes don't match, a value is not finite, or there are too few distinct recipes to hold the model
        (fewer than 4 (N + 1), or all in one plane).

    Notes
    -----
    Physics and residual are one Gaussian process: the physics' parameters have a prior, the residual a covariance. The
    covariance is fitted to at most 500 patches, with the physics taken as straight in its parameters; then the physics
    anew to all patches, errors weighed by that covariance; twice.

    References
    ----------
    `tilefab.colour.neugebauer`, `tilefab.colour.residual`; the leave-one-out residual ``[inverse y]_i / inverse_ii``
    by C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine Learning" (2006), equation 5.12.
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    colours = np.asarray(lab, dtype=np.float64)
    if inks.ndim != 2 or colours.shape != (inks.shape[0], 3):
        raise ValueError(f"ink_frac {inks.shape} and lab {colours.shape} must be (P, N) and (P, 3)")
    if not (np.isfinite(inks).all() and np.isfinite(colours).all()):
        raise ValueError("ink_frac and lab must be finite")
    patches = merge_repeats(inks, colours)
    count, size = patches.recipes.shape
    linear = np.hstack([np.ones((count, 1)), patches.recipes])
    if count < 4 * (size + 1) or np.linalg.matrix_rank(linear) < size + 1:
        raise ValueError(f"{count} distinct recipes of {size} inks are too few or too alike to fit a press model")

    misfit = np.full(count, _FIRST_MISFIT)
    physics = fit_neugebauer(patches.recipes, patches.lab, misfit)
    judged = np.arange(count)
    if count > _JUDGED_PATCHES:
        judged = np.sort(rng.generator(0, "patches that judge the covariance").permutation(count)[:_JUDGED_PATCHES])
    noise = _FIRST_NOISE
    for _ in range(_ROUNDS):
        part = _Patches(patches.recipes[judged], patches.lab[judged], patches.counts[judged], judged)
        covariance = fit_covariance(_evidence(physics, part, noise), _COVARIANCE_STEPS)
        noise = covariance.noise
        whiten = _whitening(physics, patches, covariance)
        physics = refine(physics, patches.recipes, patches.lab, whiten, misfit, _REFINE_STEPS, covariance.trust)
    return _assembled(physics, patches, covariance, inks, colours)


def _evidence(physics: NeugebauerFit, patches: _Patches, noise: float) -> Evidence:
    lab, slopes = predict_with_slopes(physics, patches.recipes)
    # Taken as straight, the physics could still move back to where its parameters are expected.
    misses = patches.lab - lab + np.einsum("kpq,q->pk", slopes, physics.parameters)
    return Evidence(patches.recipes, misses, patches.counts, lab[:, 0], slopes, noise)


def _smooth(physics: NeugebauerFit, patches: _Patches, covariance: Covariance) -> Float64Array:
    """Correlation of residuals, growth included."""
    grown = covariance.grown(predict_with_slopes(physics, patches.recipes)[0][:, 0])
    return covariance.alike(patches.recipes, patches.recipes) * grown[:, np.newaxis] * grown


def _whitening(
    physics: NeugebauerFit, patches: _Patches, covariance: Covariance
) -> tuple[Float64Array, Float64Array, Float64Array]:
    alike = _smooth(physics, patches, covariance)
    scatter = np.diag(covariance.scatter(patches.counts))
    unit = np.eye(len(alike))
    first, second, third = (
        solve_triangular(cholesky(covariance.size[k] ** 2 * alike + scatter, lower=True), unit, lower=True)
        for k in range(3)
    )
    return first, second, third


def _assembled(
    physics: NeugebauerFit, patches: _Patches, covariance: Covariance, inks: Float64Array, colours: Float64Array
) -> PressModel:
    """The model of a fit, with its errors."""
    lab, slopes = predict_with_slopes(physics, patches.recipes)
    grown = covariance.grown(lab[:, 0])
    alike = covariance.alike(patches.recipes, patches.recipes) * grown[:, np.newaxis] * grown
    scatter = covariance.scatter(patches.counts)
    count, size = patches.recipes.shape
    misses = patches.lab - lab
    free = misses + np.einsum("kpq,q->pk", slopes, physics.parameters)
    strengths = np.empty((3, count))
    left_out = np.empty((count, 3))
    spread = np.empty((count, 3))
    surprise = np.empty((count, 3))
    whole = float(np.prod(1.0 + covariance.weight))
    for k in range(3):
        smooth = covariance.size[k] ** 2 * alike + np.diag(scatter)
        pull = cho_solve((cholesky(smooth, lower=True), True), misses[:, k])
        strengths[k] = covariance.size[k] ** 2 / whole * grown * pull
        total = smooth + covariance.trust**2 * (slopes[k] @ slopes[k].T)
        inverse = cho_solve((cholesky(total, lower=True), True), np.eye(count))
        left_out[:, k] = (inverse @ free[:, k]) / np.diag(inverse)
        surprise[:, k] = left_out[:, k] * np.sqrt(np.diag(inverse))
        spread[:, k] = np.sqrt(np.maximum(1.0 / np.diag(inverse) - scatter, 0.0))
    arrays = PressArrays(
        physics.model.curves,
        physics.model.primaries,
        physics.model.factor,
        np.ascontiguousarray(patches.recipes.T),
        strengths,
        covariance.reach,
        covariance.weight,
        covariance.growth,
        np.zeros(size),
        np.zeros(size),
    )
    model_lab = np.empty((len(inks), 3))
    press_rows(inks, arrays, model_lab, np.empty((len(inks), 3, size)))
    residual = delta_e_2000(model_lab, colours)
    unseen_lab = (patches.lab - left_out)[patches.rows]
    unseen = delta_e_2000(unseen_lab, colours)
    steps = [delta_e_2000(patches.lab + spread[:, [k]] * np.eye(3)[k], patches.lab) for k in range(3)]
    expected = np.sqrt(np.square(steps).sum(axis=0))
    repeats = colours - patches.lab[patches.rows]
    degrees = int(patches.counts.sum() - count)
    errors = ModelErrors(
        fit_mean=float(residual.mean()),
        fit_p95=float(np.percentile(residual, 95)),
        held_out_mean=float(unseen.mean()),
        held_out_p95=float(np.percentile(unseen, 95)),
        expected_mean=float(expected.mean()),
        noise=covariance.noise,
        repeat_noise=float(np.sqrt((repeats**2).sum() / (3 * degrees))) if degrees else None,
        held_out=np.asarray(unseen),
        held_out_lab=unseen_lab,
        surprise=np.sqrt((surprise**2).mean(axis=1))[patches.rows],
    )
    return PressModel(arrays, float(inks.sum(axis=1).max()), errors)
