"""What colour inks fire to: a smooth model from ink fractions to Lab, fitted to measured patches.

A polyharmonic spline (radial functions of the distance between ink recipes, and a linear part) passes near
every measured patch. How near, and whether the functions are cubic or linear in the distance, is chosen by
leaving each patch out in turn, so the error it reports is for colours it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import delta_e_2000
from tilefab.jit import kernel

Float64Array = NDArray[np.float64]

_POWERS = (1, 3)
_SMOOTHINGS = (1e-6, 1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
_SAME_RECIPE = 5e-5


@kernel
def evaluate_at(
    ink: Float64Array,
    centres: Float64Array,
    weights: Float64Array,
    drift: Float64Array,
    power: int,
    lab: Float64Array,
    jacobian: Float64Array,
) -> None:
    """Colour and its slopes at one recipe.

    Parameters
    ----------
    ink
        (N,) ink fractions.
    centres, weights
        (P, N) and (P, 3): places and strengths of the radial functions.
    drift
        (N + 1, 3): constant, then the slope for each ink.
    power
        1 or 3: the functions are ``-r`` or ``r**3``.
    lab, jacobian
        (3,) and (3, N), overwritten.
    """
    inks = ink.shape[0]
    for k in range(3):
        value = drift[0, k]
        for i in range(inks):
            value += drift[i + 1, k] * ink[i]
            jacobian[k, i] = drift[i + 1, k]
        lab[k] = value
    for p in range(centres.shape[0]):
        squared = 0.0
        for i in range(inks):
            squared += (ink[i] - centres[p, i]) ** 2
        distance = np.sqrt(squared)
        if power == 3:
            value = squared * distance
            slope = 3.0 * distance
        else:
            value = -distance
            slope = -1.0 / max(distance, 1e-9)
        for k in range(3):
            lab[k] += weights[p, k] * value
        for i in range(inks):
            pull = slope * (ink[i] - centres[p, i])
            for k in range(3):
                jacobian[k, i] += weights[p, k] * pull


@kernel
def evaluate_rows(
    inks: Float64Array,
    centres: Float64Array,
    weights: Float64Array,
    drift: Float64Array,
    power: int,
    lab: Float64Array,
    jacobian: Float64Array,
) -> None:
    """`evaluate_at` for every row: inks (M, N), lab (M, 3), jacobian (M, 3, N)."""
    for row in range(inks.shape[0]):
        evaluate_at(inks[row], centres, weights, drift, power, lab[row], jacobian[row])


@dataclass(frozen=True)
class PressModel:
    """A fitted press: from ink fractions to the colour after firing.

    Attributes
    ----------
    centres
        (P, N) distinct measured recipes, ink fractions.
    weights
        (P, 3) strengths of their radial functions, in Lab.
    drift
        (N + 1, 3) constant and linear part.
    power
        1 or 3: radial functions ``-r`` or ``r**3``.
    smoothing
        The smoothing that was chosen; 0 would pass exactly through every patch.
    max_total
        Largest ink sum among the patches: beyond it the model is a guess.
    fit_mean, fit_p95
        CIEDE2000 between model and patches, mean and 95th percentile.
    held_out_mean, held_out_p95
        The same for every patch from a model fitted without it.
    """

    centres: Float64Array = field(repr=False)
    weights: Float64Array = field(repr=False)
    drift: Float64Array = field(repr=False)
    power: int
    smoothing: float
    max_total: float
    fit_mean: float
    fit_p95: float
    held_out_mean: float
    held_out_p95: float

    @property
    def inks(self) -> int:
        """Number of inks."""
        return int(self.centres.shape[1])

    def _evaluate(self, ink_frac: NDArray[np.floating]) -> tuple[Float64Array, Float64Array]:
        inks = np.ascontiguousarray(ink_frac, dtype=np.float64)
        if inks.ndim != 2 or inks.shape[1] != self.inks:
            raise ValueError(f"ink_frac must be (M, {self.inks}), but its shape is {inks.shape}")
        lab = np.empty((inks.shape[0], 3))
        jacobian = np.empty((inks.shape[0], 3, self.inks))
        evaluate_rows(inks, self.centres, self.weights, self.drift, self.power, lab, jacobian)
        return lab, jacobian

    def lab(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Absolute Lab under D50, (M, 3) float64, of recipes (M, N) of ink fractions 0 to 1.

        Raises
        ------
        ValueError
            If the shape is not (M, inks).
        """
        return self._evaluate(ink_frac)[0]

    def jacobian(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Slopes of Lab for each ink, (M, 3, N) float64 in Lab units a whole ink, at recipes (M, N).

        Raises
        ------
        ValueError
            If the shape is not (M, inks).
        """
        return self._evaluate(ink_frac)[1]


def _merge_duplicates(ink_frac: Float64Array, lab: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Distinct recipes in a fixed order, the mean colour of each, and how often it was measured."""
    rounded = np.round(ink_frac / _SAME_RECIPE).astype(np.int64)
    keys, inverse, counts = np.unique(rounded, axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    recipes = np.zeros((len(keys), ink_frac.shape[1]))
    colours = np.zeros((len(keys), 3))
    np.add.at(recipes, inverse, ink_frac)
    np.add.at(colours, inverse, lab)
    return recipes / counts[:, np.newaxis], colours / counts[:, np.newaxis], counts.astype(np.float64)


def _radial(distance: Float64Array, power: int) -> Float64Array:
    return distance**3 if power == 3 else -distance


def fit_press_model(ink_frac: NDArray[np.floating], lab: NDArray[np.floating]) -> PressModel:
    """Fit a press model to measured patches.

    Parameters
    ----------
    ink_frac
        (P, N) ink fractions, 0 to 1. Recipes measured more than once are averaged and trusted more.
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

    References
    ----------
    J. Duchon, "Splines minimizing rotation-invariant semi-norms in Sobolev spaces" (1977); the leave-one-out
    residual ``c_i / inverse_ii`` by G. Wahba, "Spline Models for Observational Data" (1990), section 4.2.
    """
    inks = np.asarray(ink_frac, dtype=np.float64)
    colours = np.asarray(lab, dtype=np.float64)
    if inks.ndim != 2 or colours.shape != (inks.shape[0], 3):
        raise ValueError(f"ink_frac {inks.shape} and lab {colours.shape} must be (P, N) and (P, 3)")
    if not (np.isfinite(inks).all() and np.isfinite(colours).all()):
        raise ValueError("ink_frac and lab must be finite")
    recipes, means, counts = _merge_duplicates(inks, colours)
    patches, size = recipes.shape
    linear = np.hstack([np.ones((patches, 1)), recipes])
    if patches < 4 * (size + 1) or np.linalg.matrix_rank(linear) < size + 1:
        raise ValueError(f"{patches} distinct recipes of {size} inks are too few or too alike to fit a press model")

    distance = np.sqrt(((recipes[:, np.newaxis, :] - recipes[np.newaxis, :, :]) ** 2).sum(axis=-1))
    wanted = np.vstack([means, np.zeros((size + 1, 3))])
    best: tuple[float, int, float, Float64Array, Float64Array] | None = None
    for power in _POWERS:
        system = np.zeros((patches + size + 1, patches + size + 1))
        system[:patches, :patches] = _radial(distance, power)
        system[:patches, patches:] = linear
        system[patches:, :patches] = linear.T
        diagonal = np.arange(patches)
        base = system[diagonal, diagonal].copy()
        for smoothing in _SMOOTHINGS:
            system[diagonal, diagonal] = base + smoothing / counts
            inverse = np.linalg.inv(system)
            solution = inverse @ wanted
            left_out = solution[:patches] / inverse[diagonal, diagonal][:, np.newaxis]
            errors = delta_e_2000(means - left_out, means)
            score = float(errors.mean())
            if best is None or score < best[0]:
                best = (score, power, smoothing, solution, errors)
    if best is None:
        raise ValueError("no press model could be fitted")
    _, power, smoothing, solution, errors = best

    model = PressModel(
        centres=np.ascontiguousarray(recipes),
        weights=np.ascontiguousarray(solution[:patches]),
        drift=np.ascontiguousarray(solution[patches:]),
        power=power,
        smoothing=smoothing,
        max_total=float(inks.sum(axis=1).max()),
        fit_mean=0.0,
        fit_p95=0.0,
        held_out_mean=float(errors.mean()),
        held_out_p95=float(np.percentile(errors, 95)),
    )
    residual = delta_e_2000(model.lab(inks), colours)
    object.__setattr__(model, "fit_mean", float(residual.mean()))
    object.__setattr__(model, "fit_p95", float(np.percentile(residual, 95)))
    return model
