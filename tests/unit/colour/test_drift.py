"""The drift of a kiln: learnt from fired colours, as far as they say, and exactly where the state can hold it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.kiln import drift_of_size, random_recipes
from sim.spectral_press import SpectralPress
from tilefab.colour.drift import DriftState, aged, drift_slopes, drifted, no_drift, update_drift
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.spaces import delta_e_2000

INKS = 4
PRESS = SpectralPress("ceramic4")


def recipes_of(count: int, seed: int) -> np.ndarray:
    return random_recipes(INKS, count, np.random.default_rng(seed), 2.8)


@pytest.fixture(scope="module")
def model() -> PressModel:
    recipes = recipes_of(140, 1)
    recipes[: INKS + 1] = np.vstack([np.zeros((1, INKS)), np.eye(INKS)])
    return fit_press_model(recipes, PRESS.lab(recipes))


@pytest.fixture(scope="module")
def truth() -> DriftState:
    """A drift of the family that states span, of the usual size."""
    fresh = no_drift(INKS)
    return replace(fresh, mean=0.7 * fresh.spread() * np.random.default_rng(2).standard_normal(len(fresh.mean)))


def test_without_drift_nothing_changes(model: PressModel) -> None:
    recipes = recipes_of(50, 3)
    np.testing.assert_array_equal(drifted(model, no_drift(INKS)).lab(recipes), model.lab(recipes))


def test_parts_are_those_of_the_mean() -> None:
    state = replace(no_drift(3), mean=np.arange(27.0))
    gain, bend, glaze, fade, cross = state.parts()
    assert gain.tolist() == [0, 1, 2]
    assert bend.tolist() == [3, 4, 5]
    assert glaze.tolist() == [6, 7, 8]
    assert fade.shape == (3, 3)
    assert fade[1].tolist() == [12, 13, 14]
    assert cross.shape == (3, 3)
    assert cross[-1].tolist() == [24, 25, 26]


def test_slopes_are_those_of_differences(model: PressModel, truth: DriftState) -> None:
    recipes = recipes_of(30, 4)
    lab, slopes = drift_slopes(model, truth, recipes)
    np.testing.assert_allclose(lab, drifted(model, truth).lab(recipes), rtol=0.0, atol=1e-12)
    step = 1e-3
    for place in range(len(truth.mean)):
        ends = []
        for sign in (1.0, -1.0):
            mean = truth.mean.copy()
            mean[place] += sign * step
            ends.append(drifted(model, replace(truth, mean=mean)).lab(recipes))
        np.testing.assert_allclose(slopes[:, :, place], (ends[0] - ends[1]) / (2.0 * step), rtol=0.0, atol=0.01)


def test_exact_readings_of_a_drift_that_states_span_are_learnt_exactly(model: PressModel, truth: DriftState) -> None:
    recipes, fresh = recipes_of(120, 5), recipes_of(300, 6)
    wanted = drifted(model, truth).lab(fresh)
    assert delta_e_2000(model.lab(fresh), wanted).mean() > 0.5
    found = update_drift(model, no_drift(INKS), recipes, drifted(model, truth).lab(recipes), 0.003)
    assert delta_e_2000(drifted(model, found).lab(fresh), wanted).max() < 0.02
    assert np.abs(found.mean - truth.mean).max() < 0.01


def test_the_state_grows_surer_with_every_chart(model: PressModel, truth: DriftState) -> None:
    state = no_drift(INKS)
    for seed in (7, 8):
        recipes = recipes_of(24, seed)
        later = update_drift(model, state, recipes, drifted(model, truth).lab(recipes), 0.4)
        assert (later.spread() < state.spread()).all()
        assert np.linalg.eigvalsh(later.covariance).min() > 0.0
        np.testing.assert_array_equal(later.covariance, later.covariance.T)
        state = later
    older = aged(state, 0.1)
    assert (older.spread() > state.spread()).all()
    np.testing.assert_array_equal(older.mean, state.mean)


def test_two_charts_one_after_the_other_say_what_both_say(model: PressModel, truth: DriftState) -> None:
    recipes, fresh = recipes_of(60, 9), recipes_of(200, 10)
    read = drifted(model, truth).lab(recipes) + np.random.default_rng(11).normal(0.0, 0.3, (60, 3))
    noise = np.where(np.arange(60) < 30, 0.3, 0.5)
    both = update_drift(model, no_drift(INKS), recipes, read, noise)
    state = update_drift(model, no_drift(INKS), recipes[:30], read[:30], 0.3)
    state = update_drift(model, state, recipes[30:], read[30:], 0.5)
    # Equal for a model that is straight in its state; this one nearly is.
    apart = delta_e_2000(drifted(model, state).lab(fresh), drifted(model, both).lab(fresh))
    assert apart.mean() < 0.05
    np.testing.assert_allclose(state.spread(), both.spread(), rtol=0.05)


def test_noisy_readings_move_the_state_little(model: PressModel, truth: DriftState) -> None:
    recipes = recipes_of(20, 12)
    read = drifted(model, truth).lab(recipes)
    near, far = (update_drift(model, no_drift(INKS), recipes, read, noise) for noise in (0.3, 300.0))
    assert np.linalg.norm(far.mean) < 0.01 * np.linalg.norm(near.mean)


def test_wild_readings_stay_within_what_presses_do(model: PressModel) -> None:
    recipes = recipes_of(20, 13)
    state = update_drift(model, no_drift(INKS), recipes, np.full((20, 3), 5.0), 0.001)
    assert np.abs(state.mean[: 2 * INKS]).max() <= 0.5
    assert np.isfinite(drifted(model, state).lab(recipes)).all()


def test_a_drifted_kiln_is_mostly_made_good_from_48_patches(model: PressModel) -> None:
    random = np.random.default_rng(14)
    firing = drift_of_size(PRESS, random, 3.0)
    recipes, fresh = recipes_of(48, 15), recipes_of(400, 16)
    read = PRESS.lab(recipes, firing) + random.normal(0.0, 0.3, (48, 3))
    state = update_drift(model, no_drift(INKS), recipes, read, 0.4)
    before = delta_e_2000(model.lab(fresh), PRESS.lab(fresh, firing)).mean()
    after = delta_e_2000(drifted(model, state).lab(fresh), PRESS.lab(fresh, firing)).mean()
    assert after < before / 3.0


def test_misuse_is_refused(model: PressModel) -> None:
    state, recipes = no_drift(INKS), recipes_of(5, 17)
    lab = model.lab(recipes)
    with pytest.raises(ValueError, match="of 3 inks, the press of 4"):
        drifted(model, no_drift(3))
    with pytest.raises(ValueError, match="don't fit a press of 4 inks"):
        update_drift(model, state, recipes[:, :3], lab, 0.3)
    with pytest.raises(ValueError, match="don't fit a press of 4 inks"):
        update_drift(model, state, recipes, lab[:4], 0.3)
    with pytest.raises(ValueError, match="noise above 0"):
        update_drift(model, state, recipes, lab, 0.0)
    with pytest.raises(ValueError, match="must be finite"):
        update_drift(model, state, recipes, np.full_like(lab, np.nan), 0.3)
