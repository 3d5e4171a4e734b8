"""The press model on functions that are known."""

import numpy as np
import pytest

from tilefab.colour.press_model import fit_press_model
from tilefab.colour.spaces import delta_e_2000


def known_press(inks: np.ndarray) -> np.ndarray:
    cover = 1.0 - np.exp(-1.6 * inks)
    lightness = 92.0 - 30.0 * cover @ np.array([1.0, 0.8, 0.2, 1.6])
    return np.column_stack(
        [
            np.maximum(lightness, 8.0),
            18.0 * cover[:, 1] - 9.0 * cover[:, 0] * (1.0 - cover[:, 3]),
            40.0 * cover[:, 2] * (1.0 - cover[:, 3]) - 35.0 * cover[:, 0],
        ]
    )


@pytest.fixture(scope="module")
def patches() -> np.ndarray:
    return np.random.default_rng(5).random((300, 4))


def test_model_meets_colours_it_has_not_seen(patches: np.ndarray) -> None:
    model = fit_press_model(patches, known_press(patches))
    fresh = 0.05 + 0.9 * np.random.default_rng(6).random((400, 4))
    error = delta_e_2000(model.lab(fresh), known_press(fresh))
    assert error.mean() < 0.5
    # The error it claims is of the size of the error it makes.
    assert 0.5 < model.held_out_mean / error.mean() < 3.0
    assert model.fit_mean <= model.held_out_mean
    assert model.max_total == pytest.approx(patches.sum(axis=1).max())


def test_leave_one_out_is_what_leaving_one_out_gives(patches: np.ndarray) -> None:
    inks = patches[:60]
    lab = known_press(inks)
    model = fit_press_model(inks, lab)
    errors = []
    for left in range(60):
        kept = np.arange(60) != left
        linear = np.hstack([np.ones((59, 1)), inks[kept]])
        distance = np.linalg.norm(inks[kept][:, None] - inks[kept][None], axis=2)
        radial = distance**3 if model.power == 3 else -distance
        system = np.block([[radial + model.smoothing * np.eye(59), linear], [linear.T, np.zeros((5, 5))]])
        solution = np.linalg.solve(system, np.vstack([lab[kept], np.zeros((5, 3))]))
        away = np.linalg.norm(inks[kept] - inks[left], axis=1)
        row = np.concatenate([away**3 if model.power == 3 else -away, [1.0], inks[left]])
        errors.append(float(delta_e_2000(row @ solution, lab[left])))
    assert model.held_out_mean == pytest.approx(np.mean(errors), rel=1e-3)


def test_kernel_agrees_with_its_twin(patches: np.ndarray) -> None:
    model = fit_press_model(patches, known_press(patches))
    at = np.random.default_rng(8).random((50, 4))
    distance = np.linalg.norm(at[:, None] - model.centres[None], axis=2)
    radial = distance**3 if model.power == 3 else -distance
    plain = radial @ model.weights + np.hstack([np.ones((50, 1)), at]) @ model.drift
    np.testing.assert_allclose(model.lab(at), plain, atol=1e-8)


def test_jacobian_is_the_slope(patches: np.ndarray) -> None:
    model = fit_press_model(patches, known_press(patches))
    at = np.random.default_rng(9).random((20, 4))
    jacobian = model.jacobian(at)
    for ink in range(4):
        ahead, behind = at.copy(), at.copy()
        ahead[:, ink] += 1e-5
        behind[:, ink] -= 1e-5
        slope = (model.lab(ahead) - model.lab(behind)) / 2e-5
        np.testing.assert_allclose(jacobian[:, :, ink], slope, atol=1e-3)


def test_noise_is_smoothed_and_duplicates_count_once(patches: np.ndarray) -> None:
    draw = np.random.default_rng(10)
    inks = np.vstack([patches, np.zeros((8, 4))])
    lab = known_press(inks) + draw.normal(0.0, 0.3, (len(inks), 3))
    model = fit_press_model(inks, lab)
    assert len(model.centres) == 301
    assert model.smoothing > 1e-6
    assert np.abs(model.lab(np.zeros((1, 4))) - known_press(np.zeros((1, 4)))).max() < 0.6


def test_misuse_is_refused(patches: np.ndarray) -> None:
    with pytest.raises(ValueError, match="too few"):
        fit_press_model(patches[:10], known_press(patches[:10]))
    flat = patches.copy()
    flat[:, 2] = 0.5
    with pytest.raises(ValueError, match="too alike"):
        fit_press_model(flat, known_press(flat))
    with pytest.raises(ValueError, match="finite"):
        fit_press_model(patches, np.full((300, 3), np.nan))
    with pytest.raises(ValueError, match="must be"):
        fit_press_model(patches, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="must be"):
        fit_press_model(patches, known_press(patches)).lab(np.zeros((2, 3)))
