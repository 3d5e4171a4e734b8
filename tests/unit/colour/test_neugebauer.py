"""The Neugebauer kernel against explicit sums over overlaps, its slopes against differences, and known fits."""

import numpy as np
import pytest

from tilefab.colour.neugebauer import (
    CURVE_TERMS,
    Neugebauer,
    NeugebauerFit,
    _unpack,
    fit_neugebauer,
    neugebauer_at,
    overlap_bits,
    predict_with_slopes,
    refine,
)
from tilefab.colour.spaces import WHITE_XYZ_D50, delta_e_2000, lab_from_xyz


def made_up(inks: int, seed: int) -> Neugebauer:
    draw = np.random.default_rng(seed)
    curves = np.array([0.5, 0.0, 0.0]) + draw.normal(0.0, 0.15, (inks, 3, CURVE_TERMS))
    density = draw.uniform(0.1, 1.2, (inks, 3))
    return Neugebauer(curves, 0.9 * np.exp(-overlap_bits(inks) @ density), float(draw.uniform(1.3, 2.4)))


def twin(model: Neugebauer, recipes: np.ndarray) -> np.ndarray:
    """Lab (M, 3): Demichel's shares of every overlap, summed in Yule and Nielsen's power."""
    x = recipes[:, :, np.newaxis]
    t = 2.0 * x - 1.0
    terms = model.curves[np.newaxis]
    cover = x + x * (1.0 - x) * (terms[..., 0] + terms[..., 1] * t + terms[..., 2] * t**2)
    mixed = np.zeros((len(recipes), 3))
    for corner, present in enumerate(overlap_bits(model.inks)):
        share = np.prod(np.where(present[np.newaxis, :, np.newaxis] == 1.0, cover, 1.0 - cover), axis=1)
        mixed += share * model.primaries[corner]
    return lab_from_xyz(np.maximum(mixed, 1e-4) ** model.factor * np.array(WHITE_XYZ_D50))


def kernel(model: Neugebauer, recipe: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    inks, corners = model.inks, len(model.primaries)
    lab, jacobian = np.empty(3), np.empty((3, inks))
    neugebauer_at(
        recipe,
        model.curves,
        model.primaries,
        model.factor,
        lab,
        jacobian,
        np.empty(2 * corners),
        np.empty(2 * corners),
        np.empty((inks, 3, 3)),
        np.empty((corners, 3)),
        np.empty(3),
    )
    return lab, jacobian


@pytest.mark.parametrize("inks", [1, 2, 3, 4, 6, 8])
def test_kernel_agrees_with_its_twin(inks: int) -> None:
    model = made_up(inks, inks)
    recipes = np.random.default_rng(20 + inks).random((40, inks))
    recipes[0], recipes[1] = 0.0, 1.0
    found = np.array([kernel(model, recipe)[0] for recipe in recipes])
    np.testing.assert_allclose(found, twin(model, recipes), atol=1e-9)


def test_a_dark_print_takes_the_straight_end_of_lab() -> None:
    """Below Y = 0.008856 Lab is linear; the slopes there are checked, too."""
    model = Neugebauer(np.zeros((1, 3, 3)), np.array([[0.9] * 3, [0.03] * 3]), 2.0)
    at = np.array([0.995])
    lab, jacobian = kernel(model, at)
    assert lab[0] < 8.0
    np.testing.assert_allclose(lab, twin(model, at[np.newaxis])[0], atol=1e-9)
    slope = (twin(model, at[np.newaxis] + 1e-6) - twin(model, at[np.newaxis] - 1e-6))[0] / 2e-6
    np.testing.assert_allclose(jacobian[:, 0], slope, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("inks", [1, 3, 6])
def test_slopes_for_inks(inks: int) -> None:
    model = made_up(inks, 30 + inks)
    recipes = 0.05 + 0.9 * np.random.default_rng(31).random((8, inks))
    for recipe in recipes:
        jacobian = kernel(model, recipe)[1]
        steps = 1e-6 * np.eye(inks)
        slope = (twin(model, recipe + steps) - twin(model, recipe - steps)).T / 2e-6
        np.testing.assert_allclose(jacobian, slope, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("inks", [1, 2, 4])
def test_slopes_for_parameters(inks: int) -> None:
    draw = np.random.default_rng(40 + inks)
    recipes = draw.random((12, inks))
    mean = np.log(made_up(inks, 41).primaries)
    size = 12 * inks + 3 * (1 << inks) + 1
    parameters = draw.normal(0.0, 0.5, size)

    def at(values: np.ndarray) -> NeugebauerFit:
        return NeugebauerFit(_unpack(values, mean, 0.3), values, mean, 0.3)

    _, slopes = predict_with_slopes(at(parameters), recipes)
    assert slopes.shape == (3, 12, size)
    for which in range(size):
        step = np.zeros(size)
        step[which] = 1e-5
        difference = twin(at(parameters + step).model, recipes) - twin(at(parameters - step).model, recipes)
        np.testing.assert_allclose(slopes[:, :, which], difference.T / 2e-5, rtol=1e-4, atol=1e-5)


def test_overlaps_are_counted_from_the_first_ink() -> None:
    assert overlap_bits(2).tolist() == [[0, 0], [1, 0], [0, 1], [1, 1]]


@pytest.mark.parametrize("inks", [1, 2, 4])
def test_a_press_of_this_kind_is_found_again(inks: int) -> None:
    truth = made_up(inks, 50 + inks)
    draw = np.random.default_rng(51)
    recipes = draw.random((60 * inks, inks))
    recipes = np.vstack([recipes, overlap_bits(inks)])
    fit = fit_neugebauer(recipes, twin(truth, recipes), np.full(len(recipes), 0.05))
    fresh = draw.random((200, inks))
    error = delta_e_2000(twin(fit.model, fresh), twin(truth, fresh))
    assert error.mean() < 0.1
    assert error.max() < 0.6


def test_tone_curves_rise_even_where_measurements_waver() -> None:
    """An ink that the glaze takes no more of, with readings that fall back a little: covers flatten, not turn."""
    amounts = np.linspace(0.0, 1.0, 41)[:, np.newaxis]
    lightness = 90.0 - 45.0 * np.minimum(amounts[:, 0] / 0.7, 1.0) + 2.0 * np.maximum(amounts[:, 0] - 0.7, 0.0)
    lab = np.column_stack([lightness, np.zeros(41), np.zeros(41)])
    fit = fit_neugebauer(amounts, lab, np.full(41, 0.45))
    x = np.linspace(0.0, 1.0, 101)
    t = 2.0 * x - 1.0
    for terms in fit.model.curves[0]:
        cover = x + x * (1.0 - x) * (terms[0] + terms[1] * t + terms[2] * t**2)
        assert np.diff(cover).min() > -3e-4


def test_refining_never_makes_a_fit_worse() -> None:
    truth = made_up(3, 60)
    draw = np.random.default_rng(61)
    recipes = draw.random((120, 3))
    lab = twin(truth, recipes) + draw.normal(0.0, 0.3, (120, 3))
    noise = np.full(120, 0.3)
    fit = fit_neugebauer(recipes, lab, noise)

    def cost(of: NeugebauerFit) -> float:
        misses = (lab - predict_with_slopes(of, recipes)[0]) / 0.3
        return float((misses**2).sum() + of.parameters @ of.parameters)

    finer = refine(fit, recipes, lab, None, noise, 5)
    assert cost(finer) <= cost(fit) + 1e-6
    whiten = np.eye(120) / 0.3
    same = refine(fit, recipes, lab, (whiten, whiten, whiten), noise, 5)
    np.testing.assert_allclose(same.parameters, finer.parameters, atol=1e-6)
