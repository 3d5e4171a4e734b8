"""Moved nodes against dense least squares."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from tilefab.colour.node_fit import fit_nodes, multilinear_weights


@pytest.mark.parametrize("shape", [(7,), (4, 5), (3, 4, 5), (2, 3, 2, 3), (2,) * 6])
def test_weights_are_those_of_multilinear_interpolation(shape: tuple[int, ...]) -> None:
    draw = np.random.default_rng(len(shape))
    grid = draw.random(shape)
    places = draw.random((60, len(shape))) * (np.array(shape) - 1.0)
    places[0], places[1] = 0.0, np.array(shape) - 1.0
    weights = multilinear_weights(places, shape)
    wanted = RegularGridInterpolator([np.arange(float(count)) for count in shape], grid)(places)
    np.testing.assert_allclose(weights @ grid.ravel(), wanted, atol=1e-12)
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1.0, atol=1e-12)


def test_places_beyond_the_ends_take_the_ends() -> None:
    weights = multilinear_weights(np.array([[-0.5], [4.5]]), (5,))
    np.testing.assert_allclose(weights.toarray(), np.eye(5)[[0, 4]])


def test_fit_is_the_least_squares_solution() -> None:
    draw = np.random.default_rng(7)
    shape = (4, 3)
    grid = draw.random((*shape, 2))
    places = draw.random((300, 2)) * (np.array(shape) - 1.0)
    values, importance = draw.random((300, 2)), draw.random(300)
    weights = multilinear_weights(places, shape)
    found = fit_nodes(grid, weights, values, importance, stiffness=0.3)
    scale = np.sqrt(importance)[:, np.newaxis]
    system = np.vstack([weights.toarray() * scale, 0.3 * np.eye(12)])
    missed = np.vstack([(values - weights @ grid.reshape(12, 2)) * scale, np.zeros((12, 2))])
    moved = np.linalg.lstsq(system, missed, rcond=None)[0]
    assert found.shape == grid.shape
    np.testing.assert_allclose(found, grid + moved.reshape(grid.shape), atol=1e-4)


def test_what_is_right_stays() -> None:
    grid = np.random.default_rng(8).random((5, 5, 1))
    weights = multilinear_weights(np.random.default_rng(9).random((50, 2)) * 4.0, (5, 5))
    values = weights @ grid.reshape(-1, 1)
    assert np.array_equal(fit_nodes(grid, weights, values, np.ones(50), stiffness=0.1), grid)
    untouched = fit_nodes(grid, weights, values + 1.0, np.zeros(50), stiffness=0.1)
    assert np.array_equal(untouched, grid)


def test_curved_functions_come_out_right_between_the_nodes() -> None:
    x = np.linspace(0.0, 6.0, 1201)[:, np.newaxis]

    def wanted(at: np.ndarray) -> np.ndarray:
        return at**2

    grid = wanted(np.arange(7.0))[:, np.newaxis]
    weights = multilinear_weights(x, (7,))
    before = np.abs(weights @ grid - wanted(x)).mean()
    fitted = fit_nodes(grid, weights, wanted(x), np.ones(len(x)), stiffness=0.05)
    assert np.abs(weights @ fitted - wanted(x)).mean() < 0.5 * before
