"""The spectral model on presses that are known: accuracy, honesty about it, illuminant A, and what it refuses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.inks import WAVELENGTHS_NM
from sim.instrument import measure_spectra
from sim.kiln import random_recipes
from sim.spectral_press import SpectralPress
from tilefab.colour.spaces import delta_e_2000, lab_from_xyz
from tilefab.colour.spectra import Illuminant, spectral_weights
from tilefab.colour.spectral_model import MOST_REFLECTANCE, SpectralModel, _Evidence, fit_spectral_model

PATCHES = 320
PRESS = SpectralPress("ceramic4")


@dataclass(frozen=True)
class Fitted:
    """A model with the patches it was fitted to, and others."""

    model: SpectralModel
    recipes: NDArray[np.float64]
    measured: NDArray[np.float64]
    unseen: NDArray[np.float64]


def chart(count: int, seed: int) -> NDArray[np.float64]:
    """Recipes with every ink missing now and then, and solid now and then."""
    draw = np.random.default_rng(seed)
    recipes = random_recipes(4, count, draw)
    recipes[draw.random(recipes.shape) < 0.25] = 0.0
    recipes[draw.random(recipes.shape) < 0.05] = 1.0
    return recipes


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    recipes = chart(PATCHES, 1)
    recipes[:3] = 0.0
    measured = measure_spectra(PRESS, recipes, np.random.default_rng(2))
    return Fitted(fit_spectral_model(recipes, measured, WAVELENGTHS_NM), recipes, measured, chart(500, 3))


def rms(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.square(one - other).mean()))


def difference(one: NDArray[np.float64], other: NDArray[np.float64], light: Illuminant) -> NDArray[np.float64]:
    weights = spectral_weights(WAVELENGTHS_NM, light)
    return np.asarray(delta_e_2000(lab_from_xyz(one @ weights), lab_from_xyz(other @ weights)))


def test_spectra_never_seen_come_out_right(fitted: Fitted) -> None:
    true, found = PRESS.reflectance(fitted.unseen), fitted.model.reflectance(fitted.unseen)
    apart = np.abs(fitted.unseen[:, np.newaxis] - fitted.recipes[np.newaxis]).sum(axis=2)
    nearest = fitted.measured[apart.argmin(axis=1)]
    assert rms(found, true) < 0.004
    assert rms(found, true) < 0.1 * rms(nearest, true)
    assert difference(found, true, "D50").mean() < 0.45
    assert difference(found, true, "A").mean() < 0.45
    assert 4 <= len(fitted.model.components) <= 8


def test_errors_are_those_of_patches_never_seen(fitted: Fitted) -> None:
    measured = measure_spectra(PRESS, fitted.unseen, np.random.default_rng(4))
    found, errors = fitted.model.reflectance(fitted.unseen), fitted.model.errors
    assert errors.rms == pytest.approx(rms(found, measured), rel=0.3)
    for true, mean, p95 in (
        (difference(found, measured, "D50"), errors.delta_e_d50_mean, errors.delta_e_d50_p95),
        (difference(found, measured, "A"), errors.delta_e_a_mean, errors.delta_e_a_p95),
    ):
        assert mean == pytest.approx(true.mean(), rel=0.2)
        assert p95 == pytest.approx(np.percentile(true, 95), rel=0.3)


def test_leaving_out_costs_what_fitting_again_shows() -> None:
    """With everything else kept, a patch's left-out spectrum is what the others say; hyperparameters move a little."""
    recipes = chart(90, 5)
    measured = measure_spectra(PRESS, recipes, np.random.default_rng(6))
    whole = fit_spectral_model(recipes, measured, WAVELENGTHS_NM).errors.rms
    missed = []
    for fold in range(10):
        out = np.arange(len(recipes)) % 10 == fold
        part = fit_spectral_model(recipes[~out], measured[~out], WAVELENGTHS_NM)
        missed.append(np.square(part.reflectance(recipes[out]) - measured[out]))
    assert whole == pytest.approx(float(np.sqrt(np.concatenate(missed).mean())), rel=0.35)


def test_slopes_of_the_evidence_are_those_of_differences() -> None:
    draw = np.random.default_rng(7)
    recipes = draw.random((50, 3))
    scores = np.sin(3.0 * recipes) @ draw.normal(0.0, 1.0, (3, 2)) + draw.normal(0.0, 0.1, (50, 2))
    evidence = _Evidence(recipes, scores, draw.integers(1, 4, 50).astype(float))
    theta = evidence.start() + draw.normal(0.0, 0.3, 6)
    _, slopes = evidence(theta)
    steps = 1e-3 * np.eye(6)
    differences = [(evidence(theta + step)[0] - evidence(theta - step)[0]) / 2e-3 for step in steps]
    np.testing.assert_allclose(slopes, differences, atol=0.05)


def test_repeats_are_trusted_more() -> None:
    recipes, unseen = chart(100, 8), chart(200, 9)
    often = np.repeat(recipes, 4, axis=0)
    read = measure_spectra(PRESS, often, np.random.default_rng(10), level_noise=0.02, reading_noise=0.002)
    once = fit_spectral_model(recipes, read[::4], WAVELENGTHS_NM)
    many = fit_spectral_model(often, read, WAVELENGTHS_NM)
    assert len(many.centres) == len(recipes)
    true = PRESS.reflectance(recipes)
    assert rms(many.reflectance(recipes), true) < 0.8 * rms(once.reflectance(recipes), true)
    true = PRESS.reflectance(unseen)
    usual = [np.median(np.abs(model.reflectance(unseen) - true)) for model in (once, many)]
    assert usual[1] < usual[0]
    # Repeats of a recipe are left out together: what they say of each other is no prediction.
    assert many.errors.rms > rms(many.reflectance(unseen), true)


def test_order_of_patches_does_not_matter(fitted: Fitted) -> None:
    order = np.random.default_rng(11).permutation(PATCHES)
    again = fit_spectral_model(fitted.recipes[order], fitted.measured[order], WAVELENGTHS_NM)
    np.testing.assert_allclose(
        again.reflectance(fitted.unseen), fitted.model.reflectance(fitted.unseen), rtol=0.0, atol=1e-5
    )


@pytest.mark.parametrize("level", [0.0, 0.5, 1.1])
def test_spectra_that_are_all_alike(level: float) -> None:
    recipes = chart(40, 12)
    model = fit_spectral_model(recipes, np.full((40, 36), level), WAVELENGTHS_NM)
    np.testing.assert_allclose(model.reflectance(recipes), level, atol=1e-12)
    assert model.errors.rms == pytest.approx(0.0, abs=1e-12)


def test_predictions_are_reflectances_everywhere() -> None:
    """Fitted to spectra that end abruptly, at 0 and above 1, and asked in every corner."""
    recipes = chart(60, 13)
    model = fit_spectral_model(recipes, np.where(recipes[:, :1] > 0.3, -0.01, 1.19) + np.zeros(36), WAVELENGTHS_NM)
    found = model.reflectance(np.indices((2, 2, 2, 2)).reshape(4, -1).T.astype(float))
    assert found.min() >= 0.0
    assert found.max() <= MOST_REFLECTANCE


def test_bands_that_make_no_colour(fitted: Fitted) -> None:
    some = slice(10, 20)
    model = fit_spectral_model(fitted.recipes, fitted.measured[:, some], WAVELENGTHS_NM[some])
    assert model.errors.delta_e_d50_mean is None
    assert model.errors.delta_e_a_p95 is None
    assert model.errors.rms < 0.005


def test_what_is_refused(fitted: Fitted) -> None:
    recipes, measured = fitted.recipes, fitted.measured
    with pytest.raises(ValueError, match="must be"):
        fit_spectral_model(recipes, measured[1:], WAVELENGTHS_NM)
    with pytest.raises(ValueError, match="must be"):
        fit_spectral_model(recipes, measured, WAVELENGTHS_NM[1:])
    with pytest.raises(ValueError, match="finite"):
        fit_spectral_model(recipes, np.where(measured > 0.5, np.nan, measured), WAVELENGTHS_NM)
    with pytest.raises(ValueError, match="too few or too alike"):
        fit_spectral_model(recipes[:19], measured[:19], WAVELENGTHS_NM)
    with pytest.raises(ValueError, match="too few or too alike"):
        fit_spectral_model(recipes * [1.0, 1.0, 1.0, 0.0], measured, WAVELENGTHS_NM)
    with pytest.raises(ValueError, match=r"must be \(M, 4\)"):
        fitted.model.reflectance(recipes[:, :3])
