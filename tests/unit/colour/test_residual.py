"""The residual: the kernel against its covariance, slopes against differences, and parameters found again."""

import numpy as np
import pytest

from tilefab.colour.residual import Covariance, Evidence, add_residual, bump, fit_covariance


def made_up(inks: int, seed: int) -> Covariance:
    draw = np.random.default_rng(seed)
    return Covariance(
        draw.uniform(0.4, 2.0, inks), draw.uniform(0.2, 2.0, inks), draw.uniform(0.3, 0.9, 3), 0.8, 1.1, 0.3
    )


def residual(
    covariance: Covariance,
    recipe: np.ndarray,
    centres: np.ndarray,
    strengths: np.ndarray,
    lab: np.ndarray,
    slope: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    lab, slope = lab.copy(), slope.copy()
    inks, patches = centres.T.shape
    add_residual(
        recipe,
        np.ascontiguousarray(centres.T),
        strengths,
        covariance.reach,
        covariance.weight,
        covariance.growth,
        lab,
        slope,
        np.empty(patches),
        np.empty((inks, patches)),
    )
    return lab, slope


@pytest.mark.parametrize("inks", [1, 2, 4, 6, 8])
def test_kernel_agrees_with_the_covariance(inks: int) -> None:
    draw = np.random.default_rng(inks)
    covariance = made_up(inks, 10 + inks)
    centres, strengths = draw.random((37, inks)), draw.normal(0.0, 1.0, (3, 37))
    whole = np.prod(1.0 + covariance.weight)
    for recipe in draw.random((6, inks)):
        lab = draw.uniform(20.0, 80.0, 3)
        alike = whole * covariance.alike(recipe[np.newaxis], centres)[0]
        wanted = lab + strengths @ alike * covariance.grown(lab[:1])
        found, _ = residual(covariance, recipe, centres, strengths, lab, np.zeros((3, inks)))
        np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-10)


def test_slopes_are_those_of_the_sum() -> None:
    """Physics that is straight in the inks, so that its lightness moves with them."""
    draw = np.random.default_rng(3)
    covariance = made_up(3, 4)
    centres, strengths = draw.random((50, 3)), draw.normal(0.0, 1.0, (3, 50))
    straight = draw.normal(0.0, 30.0, (3, 3))

    def at(recipe: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lab = np.array([60.0, 5.0, 10.0]) + straight @ recipe
        return residual(covariance, recipe, centres, strengths, lab, straight)

    for recipe in draw.random((10, 3)):
        slopes = at(recipe)[1]
        for ink in range(3):
            step = 1e-6 * np.eye(3)[ink]
            difference = (at(recipe + step)[0] - at(recipe - step)[0]) / 2e-6
            np.testing.assert_allclose(slopes[:, ink], difference, rtol=1e-4, atol=1e-4)


def test_bump_is_smooth_and_ends() -> None:
    r = np.linspace(0.0, 1.5, 1501)
    values = bump(r)
    assert values[0] == 1.0
    assert (values[r >= 1.0] == 0.0).all()
    assert (np.diff(values) <= 0.0).all()
    # Flat at 0 and at 1: a product of bumps has no kink anywhere.
    assert values[1] == pytest.approx(1.0, abs=1e-4)
    assert abs(values[1000] - values[990]) < 1e-8


def test_covariance_is_one_that_can_be() -> None:
    draw = np.random.default_rng(5)
    covariance = made_up(4, 6)
    recipes = draw.random((120, 4))
    alike = covariance.alike(recipes, recipes)
    np.testing.assert_allclose(np.diag(alike), 1.0, rtol=1e-12)
    np.testing.assert_allclose(alike, alike.T, rtol=1e-12)
    assert np.linalg.eigvalsh(alike).min() > -1e-10
    assert covariance.grown(np.array([50.0]))[0] == 1.0
    assert covariance.scatter(np.array([1.0, 4.0])) == pytest.approx([0.09, 0.0225], abs=1e-5)


def example(count: int, seed: int) -> Evidence:
    draw = np.random.default_rng(seed)
    recipes = draw.random((count, 2))
    counts = draw.integers(1, 4, count).astype(np.float64)
    lightness = 90.0 - 50.0 * recipes.mean(axis=1)
    leans = draw.normal(0.0, 0.5, (3, count, 7))
    return Evidence(recipes, draw.normal(0.0, 1.0, (count, 3)), counts, lightness, leans, 0.3)


def test_evidence_is_the_improbability_of_the_measurements() -> None:
    evidence = example(25, 7)
    theta = evidence.start()
    covariance = evidence.unpack(theta)
    grown = covariance.grown(evidence.lightness)
    wanted = 0.0
    for k in range(3):
        total = (
            covariance.size[k] ** 2 * covariance.alike(evidence.ink_frac, evidence.ink_frac) * np.outer(grown, grown)
        )
        total += covariance.trust**2 * evidence.leans[k] @ evidence.leans[k].T
        total += np.diag(covariance.scatter(evidence.counts))
        misses = evidence.misses[:, k]
        wanted += 0.5 * misses @ np.linalg.solve(total, misses) + 0.5 * np.linalg.slogdet(total)[1]
    assert evidence(theta)[0] == pytest.approx(wanted, rel=1e-10)


@pytest.mark.parametrize("seed", [8, 9, 10])
def test_evidence_slopes(seed: int) -> None:
    evidence = example(30, seed)
    theta = evidence.start() + np.random.default_rng(seed).normal(0.0, 0.3, len(evidence.start()))
    _, slope = evidence(theta)
    for which in range(len(theta)):
        step = np.zeros(len(theta))
        step[which] = 1e-5
        difference = (evidence(theta + step)[0] - evidence(theta - step)[0]) / 2e-5
        assert slope[which] == pytest.approx(difference, rel=1e-4, abs=1e-4), which


def test_a_covariance_that_can_t_be_is_passed_over() -> None:
    evidence = example(20, 11)
    theta = evidence.start()
    # Wide reaches and a size that drowns the noise: singular, as far as numbers go.
    theta[:2], theta[4:7] = 8.0, 40.0
    value, slope = evidence(theta)
    assert value >= 1e12
    assert (slope == 0.0).all()


def test_noise_is_found_again() -> None:
    draw = np.random.default_rng(12)
    recipes = draw.random((120, 2))
    truth = Covariance(np.array([0.9, 1.4]), np.array([1.0, 1.0]), np.array([1.0, 0.8, 0.6]), 0.0, 1.0, 0.25)
    factor = np.linalg.cholesky(truth.alike(recipes, recipes) + 1e-9 * np.eye(120))
    misses = factor @ draw.normal(0.0, 1.0, (120, 3)) * truth.size + draw.normal(0.0, 0.25, (120, 3))
    evidence = Evidence(recipes, misses, np.ones(120), np.full(120, 50.0), np.zeros((3, 120, 1)), 0.5)
    found = fit_covariance(evidence, 40)
    assert found.noise == pytest.approx(0.25, rel=0.15)
    assert found.size == pytest.approx(truth.size, rel=0.6)
    logs = [np.log(found.reach), np.log(found.weight), np.log(found.size)]
    theta = np.concatenate([*logs, [found.growth, np.log(found.trust), np.log(found.noise)]])
    assert evidence(theta)[0] < evidence(evidence.start())[0]
