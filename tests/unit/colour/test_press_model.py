"""The press model on presses that are known: accuracy, honesty about it, slopes, and what it refuses."""

import numpy as np
import pytest

from sim.instrument import measure
from sim.spectral_press import SpectralPress
from tilefab.colour.neugebauer import fit_neugebauer
from tilefab.colour.press_model import PressModel, fit_press_model, merge_repeats
from tilefab.colour.spaces import delta_e_2000

NOISE = 0.3
# The press's inks, how many patches, and the most that mean and 95th percentile may err on recipes never seen.
CASES = {
    1: ((0,), 40, 0.3, 0.6),
    2: ((0, 1), 90, 0.4, 0.9),
    3: ((0, 1, 3), 130, 0.5, 1.1),
    4: ((0, 1, 2, 3), 260, 0.5, 1.1),
    6: ((0, 1, 2, 3, 4, 5), 350, 0.7, 1.5),
}


def random_recipes(inks: int, count: int, seed: int) -> np.ndarray:
    """At most four inks in each, more of them light."""
    draw = np.random.default_rng(seed)
    recipes = draw.random((count, inks)) ** 1.5
    rank = recipes.argsort(axis=1).argsort(axis=1)
    recipes[rank < inks - 4] = 0.0
    return recipes


class Press:
    """Some inks of a simulated press, with a fitted model."""

    def __init__(self, inks: int) -> None:
        self.channels, count, self.most_mean, self.most_p95 = CASES[inks]
        self.press = SpectralPress("ceramic4" if inks <= 4 else f"ceramic{inks}")
        self.recipes = random_recipes(inks, count, inks)
        self.recipes[: inks + 1] = np.vstack([np.zeros((1, inks)), np.eye(inks)])
        self.lab = measure(self.press, self.padded(self.recipes), np.random.default_rng(100 + inks), lab_noise=NOISE)
        self.model = fit_press_model(self.recipes, self.lab)

    def padded(self, recipes: np.ndarray) -> np.ndarray:
        whole = np.zeros((len(recipes), len(self.press.ink_names)))
        whole[:, list(self.channels)] = recipes
        return whole

    def true_lab(self, recipes: np.ndarray) -> np.ndarray:
        return np.asarray(self.press.lab(self.padded(recipes)))


@pytest.fixture(scope="module")
def presses() -> dict[int, Press]:
    return {inks: Press(inks) for inks in CASES}


def plain(model: PressModel, recipes: np.ndarray) -> np.ndarray:
    """Lab (M, 3) by explicit sums; see `tilefab.colour.press_model.PressArrays`."""
    arrays = model.arrays
    printed = recipes * (1.0 + arrays.gain) + arrays.bend * recipes * (1.0 - recipes)
    x = printed[:, :, np.newaxis]
    t = 2.0 * x - 1.0
    terms = arrays.curves[np.newaxis]
    cover = x + x * (1.0 - x) * (terms[..., 0] + terms[..., 1] * t + terms[..., 2] * t * t)
    mixed = np.zeros((len(recipes), 3))
    for corner, values in enumerate(arrays.primaries):
        present = np.array([(corner >> ink) & 1 for ink in range(model.inks)], dtype=bool)
        mixed += np.prod(np.where(present[:, np.newaxis], cover, 1.0 - cover), axis=1) * values
    ratio = np.maximum(mixed, 1e-4) ** arrays.factor
    f = np.where(ratio > (6.0 / 29.0) ** 3, np.cbrt(ratio), ratio * (29.0 / 6.0) ** 2 / 3.0 + 4.0 / 29.0)
    lab = np.column_stack([116.0 * f[:, 1] - 16.0, 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])])
    whole = np.ones((len(recipes), arrays.centres.shape[1]))
    for ink in range(model.inks):
        r = np.minimum(np.abs(printed[:, [ink]] - arrays.centres[ink]) / arrays.reach[ink], 1.0)
        whole *= 1.0 + arrays.weight[ink] * (1.0 - r) ** 5 * (8.0 * r * r + 5.0 * r + 1.0)
    lab += whole @ arrays.strengths.T * np.exp(arrays.growth * (lab[:, :1] / 50.0 - 1.0))
    return np.asarray(lab)


def drifted(model: PressModel) -> PressModel:
    draw = np.random.default_rng(9)
    inks = model.inks
    return model.with_drift(
        draw.normal(0.0, 0.05, inks),
        draw.normal(0.0, 0.05, inks),
        draw.normal(0.0, 0.02, 3),
        draw.normal(0.0, 0.02, (inks, 3)),
        draw.normal(0.0, 0.02, (inks * (inks - 1) // 2, 3)),
    )


@pytest.mark.parametrize("inks", CASES)
def test_colours_it_has_not_seen(presses: dict[int, Press], inks: int) -> None:
    press = presses[inks]
    fresh = random_recipes(inks, 500, 50 + inks)
    error = delta_e_2000(press.model.lab(fresh), press.true_lab(fresh))
    assert error.mean() < press.most_mean
    assert np.percentile(error, 95) < press.most_p95


@pytest.mark.parametrize("inks", CASES)
def test_it_says_how_good_it_is(presses: dict[int, Press], inks: int) -> None:
    press = presses[inks]
    errors = press.model.errors
    true = delta_e_2000(press.model.lab(press.recipes), press.true_lab(press.recipes)).mean()
    fresh = random_recipes(inks, 500, 60 + inks)
    unseen = delta_e_2000(press.model.lab(fresh), press.true_lab(fresh)).mean()
    assert min(true, unseen) / 1.5 < errors.expected_mean < 1.5 * max(true, unseen)
    assert errors.noise == pytest.approx(NOISE, rel=0.25)
    assert errors.fit_mean < errors.held_out_mean < errors.held_out_p95
    assert errors.held_out.shape == (len(press.recipes),)
    assert errors.held_out.mean() == errors.held_out_mean
    assert errors.repeat_noise is None
    assert press.model.max_total == pytest.approx(press.recipes.sum(axis=1).max())


@pytest.mark.parametrize("inks", CASES)
def test_kernel_agrees_with_its_twin(presses: dict[int, Press], inks: int) -> None:
    recipes = np.vstack([random_recipes(inks, 60, 1), np.zeros((1, inks)), np.ones((1, inks))])
    for model in (presses[inks].model, drifted(presses[inks].model)):
        np.testing.assert_allclose(model.lab(recipes), plain(model, recipes), atol=1e-8)


@pytest.mark.parametrize("inks", CASES)
def test_slopes(presses: dict[int, Press], inks: int) -> None:
    recipes = 0.02 + 0.96 * np.random.default_rng(2).random((25, inks))
    for model in (presses[inks].model, drifted(presses[inks].model)):
        _, slopes = model.lab_and_slopes(recipes)
        for ink in range(inks):
            step = 1e-5 * np.eye(inks)[ink]
            difference = (model.lab(recipes + step) - model.lab(recipes - step)) / 2e-5
            np.testing.assert_allclose(slopes[:, :, ink], difference, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize("inks", CASES)
def test_single_inks_darken_throughout(presses: dict[int, Press], inks: int) -> None:
    for ink in range(inks):
        ramp = np.linspace(0.0, 1.0, 101)[:, np.newaxis] * np.eye(inks)[ink]
        assert (np.diff(presses[inks].model.lab(ramp)[:, 0]) < 0.02).all(), ink


def test_held_out_is_what_leaving_out_gives(presses: dict[int, Press]) -> None:
    """Refitted from nothing without some patches; the formula keeps covariance and slopes, so only about."""
    press = presses[2]
    left_out = np.arange(20, 32)
    again = []
    for patch in left_out:
        kept = np.arange(len(press.recipes)) != patch
        model = fit_press_model(press.recipes[kept], press.lab[kept])
        again.append(float(delta_e_2000(model.lab(press.recipes[[patch]]), press.lab[[patch]])[0]))
    claimed = press.model.errors.held_out[left_out]
    assert np.mean(again) == pytest.approx(claimed.mean(), rel=0.25)
    assert np.corrcoef(again, claimed)[0, 1] > 0.9


def test_better_than_physics_alone(presses: dict[int, Press]) -> None:
    press = presses[4]
    fresh = random_recipes(4, 500, 70)
    physics = fit_neugebauer(press.recipes, press.lab, np.full(len(press.recipes), 0.45)).model
    bare = PressModel(
        press.model.arrays._replace(
            curves=physics.curves,
            primaries=physics.primaries,
            factor=physics.factor,
            strengths=np.zeros_like(press.model.arrays.strengths),
        ),
        press.model.max_total,
        press.model.errors,
    )
    truth = press.true_lab(fresh)
    both, alone = delta_e_2000(press.model.lab(fresh), truth), delta_e_2000(bare.lab(fresh), truth)
    assert both.mean() < 0.8 * alone.mean()


def test_repeats_are_merged_and_tell_the_noise(presses: dict[int, Press]) -> None:
    press = presses[2]
    recipes = np.vstack([press.recipes, np.repeat(press.recipes[:20], 3, axis=0)])
    lab = measure(press.press, press.padded(recipes), np.random.default_rng(8), lab_noise=NOISE)
    model = fit_press_model(recipes, lab)
    assert model.arrays.centres.shape == (2, len(press.recipes))
    assert model.errors.repeat_noise == pytest.approx(NOISE, rel=0.25)
    assert model.errors.held_out.shape == (len(recipes),)
    merged = merge_repeats(recipes, lab)
    assert merged.counts.sum() == len(recipes)
    assert sorted(set(merged.counts)) == [1.0, 4.0]
    np.testing.assert_allclose(merged.recipes[merged.rows], recipes, atol=1e-12)
    np.testing.assert_allclose(merged.lab[merged.rows[0]], lab[merged.rows == merged.rows[0]].mean(axis=0))
    nearly = merge_repeats(np.array([[0.5], [0.500004], [0.51]]), np.zeros((3, 3)))
    assert nearly.counts.tolist() == [2.0, 1.0]


def test_order_of_patches_and_runs_never_change_it(presses: dict[int, Press]) -> None:
    press = presses[3]
    fresh = random_recipes(3, 100, 80)
    again = fit_press_model(press.recipes, press.lab)
    assert np.array_equal(again.lab(fresh), press.model.lab(fresh))
    turned = fit_press_model(press.recipes[::-1], press.lab[::-1])
    np.testing.assert_allclose(turned.lab(fresh), press.model.lab(fresh), atol=1e-9)


def test_white_is_the_bare_tile(presses: dict[int, Press]) -> None:
    for press in presses.values():
        assert np.abs(press.model.white_lab - press.true_lab(np.zeros((1, press.model.inks)))[0]).max() < 3 * NOISE


def test_misuse_is_refused(presses: dict[int, Press]) -> None:
    press = presses[4]
    with pytest.raises(ValueError, match="too few"):
        fit_press_model(press.recipes[:19], press.lab[:19])
    flat = press.recipes.copy()
    flat[:, 2] = 0.5
    with pytest.raises(ValueError, match="too alike"):
        fit_press_model(flat, press.lab)
    with pytest.raises(ValueError, match="finite"):
        fit_press_model(press.recipes, np.full(press.lab.shape, np.nan))
    with pytest.raises(ValueError, match="must be"):
        fit_press_model(press.recipes, press.lab[:3])
    with pytest.raises(ValueError, match="must be"):
        press.model.lab(np.zeros((2, 3)))
