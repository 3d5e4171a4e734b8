"""What spectra a press fires: a smooth function of the inks for each of the few shapes that spectra are made of.

Square roots of reflectances are nearly straight in what inks cover (Yule and Nielsen), so they are taken apart into
their mean and principal components. Each component's score is a Gaussian process over the inks with the covariance of
`tilefab.colour.residual`, about a straight line. What a component owes to noise is judged for each on its own: the
first ones carry how the instrument sat on the patch, the last ones the noise of single bands.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import minimize

from tilefab import rng
from tilefab.colour.press_model import merge_repeats
from tilefab.colour.residual import likeness, likeness_slopes
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz
from tilefab.colour.spectra import Illuminant, spectral_weights

Float64Array = NDArray[np.float64]

MOST_REFLECTANCE = 1.2
"""Predictions end here: glossy or fluorescing patches may pass 1."""

_POWER = 2.0
_MOST_COMPONENTS = 8
_LEAST_SHARE = 1e-5
_MOST_UNEXPLAINED = 0.9
_JUDGED_PATCHES = 300
_STEPS = 20
_REACH_MEAN, _REACH_SPREAD = float(np.log(1.6)), 0.7
_WEIGHT_SPREAD = 1.4
_NOISE_SHARES = np.linspace(np.log(1e-7), np.log(1e2), 76)
_ROWS_AT_ONCE = 4096


@dataclass(frozen=True)
class SpectralErrors:
    """Between measured patches and the model as it would be without their recipes; the patches' noise is included.

    The bare tile is not left out: every chart has it, and nothing else can stand in for it.

    Attributes
    ----------
    rms
        Root mean square over patches and bands, in reflectance.
    delta_e_d50_mean, delta_e_d50_p95, delta_e_a_mean, delta_e_a_p95
        CIEDE2000 under the illuminants D50 and A; None where no colours can be made of the bands.
    """

    rms: float
    delta_e_d50_mean: float | None
    delta_e_d50_p95: float | None
    delta_e_a_mean: float | None
    delta_e_a_p95: float | None


@dataclass(frozen=True)
class SpectralModel:
    """A fitted press: from ink fractions to the spectrum after firing.

    Attributes
    ----------
    centres
        (P, N) recipes that the model is made of.
    strengths
        (P, K) how strongly each pulls on each component.
    reach, weight
        (N,) as in `tilefab.colour.residual.add_residual`.
    mean, components
        (B,) and (K, B): square root of the mean reflectance, and what is added to it for a score of 1.
    errors
        How good it is.
    """

    centres: Float64Array = field(repr=False)
    strengths: Float64Array = field(repr=False)
    reach: Float64Array
    weight: Float64Array
    mean: Float64Array = field(repr=False)
    components: Float64Array = field(repr=False)
    errors: SpectralErrors

    def reflectance(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Reflectance (M, B) float64, 0 to 1.2, of recipes (M, N) of ink fractions 0 to 1.

        Raises
        ------
        ValueError
            If the shape is not (M, inks).
        """
        recipes = np.asarray(ink_frac, dtype=np.float64)
        inks = self.centres.shape[1]
        if recipes.ndim != 2 or recipes.shape[1] != inks:
            raise ValueError(f"ink_frac must be (M, {inks}), but its shape is {recipes.shape}")
        out = np.empty((len(recipes), len(self.mean)))
        for start in range(0, len(recipes), _ROWS_AT_ONCE):
            some = recipes[start : start + _ROWS_AT_ONCE]
            scores = _alike(some, self.centres, self.reach, self.weight) @ self.strengths
            out[start : start + _ROWS_AT_ONCE] = _from_roots(self.mean + scores @ self.components)
        return out


def fit_spectral_model(
    ink_frac: NDArray[np.floating], reflectance: NDArray[np.floating], wavelengths_nm: NDArray[np.floating]
) -> SpectralModel:
    """Fit a spectral model to measured patches.

    Parameters
    ----------
    ink_frac
        (P, N) ink fractions, 0 to 1. Recipes measured more than once are averaged and trusted more.
    reflectance
        (P, B) measured reflectance, 1 = perfect reflector; what is below 0 counts as 0.
    wavelengths_nm
        (B,) centres of the bands in nm. Only the errors' colour differences are made with them.

    Returns
    -------
    SpectralModel

    Raises
    ------
    ValueError
        If shapes don't match, a value is not finite, or there are too few distinct recipes to hold the model (fewer
        than 4 (N + 1), or all in one plane).

    Notes
    -----
    Reaches and weights are common to all components and those under which at most 300 patches are most probable. With
    the covariance's eigenvectors, the size and the noise of each component follow from all patches at little cost.
    Components that are predicted no better than by their mean, left out one by one, are noise and are dropped.

    References
    ----------
    D.-Y. Tzeng, R. S. Berns, "A review of principal component analysis and its applications to color technology",
    Color Research & Application 30 (2005); C. E. Rasmussen, C. K. I. Williams, "Gaussian Processes for Machine
    Learning" (2006), equations 5.8, 5.9 and 5.12.
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    spectra = np.asarray(reflectance, dtype=np.float64)
    bands = np.asarray(wavelengths_nm, dtype=np.float64)
    if inks.ndim != 2 or spectra.ndim != 2 or len(inks) != len(spectra) or bands.shape != spectra.shape[1:]:
        raise ValueError(
            f"ink_frac {inks.shape}, reflectance {spectra.shape} and wavelengths_nm {bands.shape} must be (P, N), "
            "(P, B) and (B,)"
        )
    if not (np.isfinite(inks).all() and np.isfinite(spectra).all()):
        raise ValueError("ink_frac and reflectance must be finite")
    # What is averaged need not be Lab, whatever its name there.
    patches = merge_repeats(inks, np.maximum(spectra, 0.0) ** (1.0 / _POWER))
    roots = patches.lab
    count, size = patches.recipes.shape
    if count < 4 * (size + 1) or np.linalg.matrix_rank(np.hstack([np.ones((count, 1)), patches.recipes])) < size + 1:
        raise ValueError(f"{count} distinct recipes of {size} inks are too few or too alike to fit a spectral model")

    mean = roots.mean(axis=0)
    left, spread, shapes = np.linalg.svd(roots - mean, full_matrices=False)
    found = spread[:_MOST_COMPONENTS] > _LEAST_SHARE * np.linalg.norm(roots)
    scores = left[:, :_MOST_COMPONENTS][:, found] * np.sqrt(count)
    components = (spread[:, np.newaxis] * shapes)[:_MOST_COMPONENTS][found] / np.sqrt(count)

    judged = np.arange(count)
    if count > _JUDGED_PATCHES:
        judged = np.sort(rng.generator(0, "patches that judge the spectra").permutation(count)[:_JUDGED_PATCHES])
    evidence = _Evidence(patches.recipes[judged], scores[judged], patches.counts[judged])
    best = minimize(evidence, evidence.start(), jac=True, method="L-BFGS-B", options={"maxiter": _STEPS})
    reach, weight = np.split(np.exp(best.x), 2)

    alike = _alike(patches.recipes, patches.recipes, reach, weight)
    parts = _taken_apart(alike, scores, patches.counts)
    root = np.sqrt(patches.counts)[:, np.newaxis]
    damped = 1.0 / (parts.values[:, np.newaxis] + parts.noise)
    pull = parts.vectors @ (parts.turned * damped)
    missed = pull / (np.square(parts.vectors) @ damped) / root
    kept = np.square(missed).mean(axis=0) < _MOST_UNEXPLAINED
    inked = inks.sum(axis=1) > 0.0
    unseen = _from_roots(mean + (scores - missed)[:, kept] @ components[kept])
    return SpectralModel(
        centres=patches.recipes,
        strengths=(root * pull)[:, kept],
        reach=reach,
        weight=weight,
        mean=mean,
        components=components[kept],
        errors=_errors(unseen[patches.rows][inked], spectra[inked], bands),
    )


@dataclass(frozen=True)
class _Parts:
    """A covariance taken apart, and scores seen through it.

    Attributes
    ----------
    values, vectors, turned
        (P,) eigenvalues, (P, P) eigenvectors, and scores (P, K) turned into them.
    size, noise
        (K,) variance of each score, and of a single reading in units of it.
    improbable
        How improbable the scores are then.
    """

    values: Float64Array
    vectors: Float64Array
    turned: Float64Array
    size: Float64Array
    noise: Float64Array
    improbable: float


def _taken_apart(alike: Float64Array, scores: Float64Array, counts: Float64Array) -> _Parts:
    """Find the size and noise of each score under which it is most probable."""
    # A mean of several readings is scaled until it scatters as a single one does.
    root = np.sqrt(counts)
    values, vectors = eigh(alike * root[:, np.newaxis] * root, check_finite=False, driver="evd")
    values = np.maximum(values, 0.0)
    turned = vectors.T @ (scores * root[:, np.newaxis])
    number = len(values)

    def judge(logs: Float64Array) -> tuple[Float64Array, Float64Array]:
        total = values[:, np.newaxis, np.newaxis] + np.exp(logs)
        size = (np.square(turned)[:, :, np.newaxis] / total).mean(axis=0)
        return size, 0.5 * number * np.log(size) + 0.5 * np.log(total).sum(axis=0)

    _, steps = judge(_NOISE_SHARES[np.newaxis])
    best = np.clip(steps.argmin(axis=1), 1, len(_NOISE_SHARES) - 2)
    before, at, after = (steps[np.arange(len(best)), best + step] for step in (-1, 0, 1))
    bend = np.maximum(before - 2.0 * at + after, 1e-12)
    logs = _NOISE_SHARES[best] + np.clip(0.5 * (before - after) / bend, -1.0, 1.0) * np.diff(_NOISE_SHARES[:2])
    size, improbable = judge(logs[:, np.newaxis])
    return _Parts(values, vectors, turned, size[:, 0], np.exp(logs), float(improbable.sum()))


@dataclass
class _Evidence:
    """How improbable scores are under reaches and weights, with slopes for their logarithms (2 N,)."""

    ink_frac: Float64Array
    scores: Float64Array
    counts: Float64Array
    _distances: list[Float64Array] = field(init=False)

    def __post_init__(self) -> None:
        self._distances = [np.abs(x[:, np.newaxis] - x[np.newaxis]) for x in self.ink_frac.T]

    def start(self) -> Float64Array:
        inks = self.ink_frac.shape[1]
        return np.concatenate([np.full(inks, _REACH_MEAN), np.zeros(inks)])

    def __call__(self, theta: Float64Array) -> tuple[float, Float64Array]:
        reach, weight = np.split(np.exp(theta), 2)
        off = (theta - self.start()) / np.repeat([_REACH_SPREAD, _WEIGHT_SPREAD], len(reach))
        curved = likeness(self.ink_frac, self.ink_frac, reach, weight)
        parts = _taken_apart(curved + _straight(self.ink_frac, self.ink_frac), self.scores, self.counts)
        damped = 1.0 / (parts.values[:, np.newaxis] + parts.noise)
        pull = parts.vectors @ (parts.turned * damped) / np.sqrt(parts.size)
        gradient = (parts.vectors * damped.sum(axis=1)) @ parts.vectors.T - pull @ pull.T
        root = np.sqrt(self.counts)
        shared = gradient * curved * root[:, np.newaxis] * root
        slopes = np.concatenate(likeness_slopes(shared, self._distances, reach, weight))
        slopes += off / np.repeat([_REACH_SPREAD, _WEIGHT_SPREAD], len(reach))
        return parts.improbable + 0.5 * float(off @ off), slopes


def _straight(first: Float64Array, second: Float64Array) -> Float64Array:
    """Covariance (A, B) of straight lines: a level, and one slope over each ink's whole range."""
    return np.asarray(1.0 + (2.0 * first - 1.0) @ (2.0 * second - 1.0).T)


def _alike(first: Float64Array, second: Float64Array, reach: Float64Array, weight: Float64Array) -> Float64Array:
    return likeness(first, second, reach, weight) + _straight(first, second)


def _from_roots(roots: Float64Array) -> Float64Array:
    return np.asarray(np.minimum(np.maximum(roots, 0.0) ** _POWER, MOST_REFLECTANCE), dtype=np.float64)


def _errors(unseen: Float64Array, spectra: Float64Array, wavelengths_nm: Float64Array) -> SpectralErrors:
    rms = float(np.sqrt(np.square(unseen - spectra).mean()))
    try:
        daylight, lamp = (_difference(unseen, spectra, wavelengths_nm, light) for light in ("D50", "A"))
    except ValueError:
        return SpectralErrors(rms, None, None, None, None)
    return SpectralErrors(rms, *daylight, *lamp)


def _difference(
    one: Float64Array, other: Float64Array, wavelengths_nm: Float64Array, light: Illuminant
) -> tuple[float, float]:
    """Mean and 95th percentile of CIEDE2000 between spectra."""
    weights = spectral_weights(wavelengths_nm, light)
    apart = delta_e_2000(lab_from_xyz(one @ weights), lab_from_xyz(np.maximum(other, 0.0) @ weights))
    return float(apart.mean()), float(np.percentile(apart, 95))
