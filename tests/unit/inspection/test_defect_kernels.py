"""The loops against their plain twins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tilefab.inspection import defect_colour_kernels as colouring
from tilefab.inspection import defect_kernels as laying
from tilefab.inspection import defect_search_kernels as searching

ROWS, COLS = 37, 45


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(11)


def lab_image(random: np.random.Generator) -> Any:
    return (random.normal((55.0, 2.0, 8.0), 6.0, (ROWS, COLS, 3))).astype(np.float32)


def weights(random: np.random.Generator) -> Any:
    return (random.random((ROWS, COLS)) > 0.2).astype(np.float32)


@pytest.mark.parametrize("inks", [0, 1, 4])
def test_mapped(random: np.random.Generator, inks: int) -> None:
    lab, laid = lab_image(random), random.random((ROWS, COLS, inks)).astype(np.float32)
    middle, turn = np.array([55.0, 2.0, 8.0]), random.normal(0.0, 0.2, (3, 3))
    colour = random.normal(0.0, 1.0, (colouring.COLOUR_TERMS + inks + inks * (inks + 1) // 2, 3))
    place = random.normal(0.0, 1.0, (2, colouring.PLACE_TERMS, 3))
    most = np.full(inks, 0.7)
    wanted = colouring.mapped_plain(lab, laid, most, middle, turn, colour, place)
    assert_allclose(colouring.mapped(lab, laid, most, middle, turn, colour, place), wanted, rtol=1e-4, atol=1e-3)
    nothing = colouring.mapped(lab, laid, most, middle, turn, 0.0 * colour, 0.0 * place)
    assert_array_equal(nothing, lab)


def test_light_and_back(random: np.random.Generator) -> None:
    lab = lab_image(random)
    lab[0, :5, 0] = (0.0, 1.0, 5.0, 8.0, 12.0)
    lab[0, :5, 1:] = 0.0
    light = laying.light_of(lab)
    assert_allclose(light, laying.light_of_plain(lab), rtol=1e-4, atol=1e-6)
    assert_allclose(laying.lab_of(light), laying.lab_of_plain(light), rtol=1e-4, atol=1e-3)
    assert_allclose(laying.lab_of(light), lab, atol=2e-3)
    below = np.full((1, 1, 3), -0.002, dtype=np.float32)
    assert_allclose(laying.lab_of(below), laying.lab_of_plain(below), atol=1e-4)


def test_distance_squared(random: np.random.Generator) -> None:
    image, middle = lab_image(random), np.array([55.0, 2.0, 8.0])
    inverse = np.array([[0.2, 0.05, 0.0], [0.05, 0.3, 0.0], [0.0, 0.0, 0.1]])
    found = colouring.distance_squared(image, middle, inverse)
    assert_allclose(found, colouring.distance_squared_plain(image, middle, inverse), rtol=1e-5)


def test_means(random: np.random.Generator) -> None:
    image = lab_image(random)
    assert_allclose(laying.means_of(image, 4), laying.means_of_plain(image, 4), rtol=1e-5)
    assert laying.means_of(image, 4).shape == (9, 11, 3)


def test_binomial(random: np.random.Generator) -> None:
    image = lab_image(random)
    assert_allclose(laying.binomial(image), laying.binomial_plain(image), rtol=1e-5, atol=1e-5)
    even = np.full((5, 6, 3), 7.0, dtype=np.float32)
    assert_array_equal(laying.binomial(even), even)


@pytest.mark.parametrize("every", [1, 3])
def test_block_sums(random: np.random.Generator, every: int) -> None:
    one, other = (random.uniform(0.001, 0.9, (ROWS, COLS, 3)).astype(np.float32) for _ in range(2))
    scale, share = np.array([0.01, 0.02, 0.03]), weights(random)
    found = laying.block_sums(one, other, share, scale, 8, every)
    wanted = laying.block_sums_plain(one, other, share, scale, 8, every)
    assert found.shape == (5, 6, 9)
    assert_allclose(found, wanted, rtol=2e-4, atol=1e-2)


def test_moved_by(random: np.random.Generator) -> None:
    light = random.random((ROWS, COLS, 3)).astype(np.float32)
    moves = random.normal(0.0, 0.3, (5, 6, 3))
    assert_allclose(laying.moved_by(light, moves, 8), laying.moved_by_plain(light, moves, 8), atol=1e-5)
    ramp = np.broadcast_to(np.linspace(0.1, 0.8, COLS, dtype=np.float32)[:, np.newaxis], (ROWS, COLS, 3)).copy()
    moved = laying.moved_by(ramp, np.broadcast_to([0.5, 0.0, 0.3], (5, 6, 3)).copy(), 8)
    step = float(ramp[0, 1, 0] - ramp[0, 0, 0])
    assert_allclose(moved[1:-1, 1:-1] - ramp[1:-1, 1:-1], 0.5 * step, atol=1e-5)


def test_tables_of_colour(random: np.random.Generator) -> None:
    lab, values, share = lab_image(random), lab_image(random) - np.float32(30.0), weights(random)
    axes = np.array([[0.3, 0.0, 0.1, -8.0], [0.0, 0.2, -0.1, 4.0]])
    most = np.array([20.0, 25.0, 28.0])
    found = colouring.colour_sums(lab, values, share, axes, most, (12, 6))
    assert_allclose(found, colouring.colour_sums_plain(lab, values, share, axes, most, (12, 6)), rtol=1e-6, atol=1e-4)
    assert found[..., 3].sum() == share.sum()
    table = random.random((12, 6, 4))
    wanted = colouring.by_colour_plain(lab, axes, table)
    assert_allclose(colouring.by_colour(lab, axes, table), wanted, atol=1e-5)


def test_blocks(random: np.random.Generator) -> None:
    values, share, most = lab_image(random), weights(random), np.array([50.0, 3.0, 9.0])
    wanted = laying.block_means_plain(values, share, most, 8)
    assert_allclose(laying.block_means(values, share, most, 8), wanted, rtol=1e-6, atol=1e-4)
    grid = random.random((5, 6, 3))
    found = laying.less_blocks(values, share, grid, 8)
    assert_allclose(found, laying.less_blocks_plain(values, share, grid, 8), rtol=1e-5, atol=1e-4)
    assert not found[share == 0.0].any()


def test_in_noise(random: np.random.Generator) -> None:
    values, likes = lab_image(random), random.random((ROWS, COLS, 2)).astype(np.float32)
    knots = np.array([[0.1, 0.3, 0.5, 0.9], [0.2, 0.4, 0.6, 0.8]])
    sizes = random.uniform(0.5, 3.0, (2, 4))
    white = random.normal(0.0, 1.0, (3, 3))
    found, wanted = (
        searching.in_noise(values, likes, white, knots, sizes),
        searching.in_noise_plain(values, likes, white, knots, sizes),
    )
    for one, other in zip(found, wanted, strict=True):
        assert_allclose(one, other, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("inner", "outer"), [(1, 3), (2, 5), (0, 1)])
def test_local_contrast(random: np.random.Generator, inner: int, outer: int) -> None:
    residual, share = lab_image(random), weights(random)
    share[20:, 30:] = 0.0
    found, seen = searching.local_contrast(residual, share, inner, outer)
    wanted, wanted_seen = searching.local_contrast_plain(residual, share, inner, outer)
    assert_array_equal(seen > 0.0, wanted_seen > 0.0)
    assert_allclose(found, wanted, atol=2e-3)
    even, _ = searching.local_contrast(np.full_like(residual, 3.0), share, inner, outer)
    assert_allclose(even, 0.0, atol=1e-5)


def test_line_strengths(random: np.random.Generator) -> None:
    whitened, share = random.standard_normal((ROWS, COLS, 3)).astype(np.float32), weights(random)
    row, col = random.integers(0, ROWS, 60), random.integers(0, COLS, 60)
    strength, way = searching.line_strengths(whitened, share, row, col, 6, 12)
    wanted, wanted_way = searching.line_strengths_plain(whitened, share, row, col, 6, 12)
    assert_allclose(strength, wanted, rtol=1e-5)
    assert_array_equal(way, wanted_way)


def test_a_line_is_strongest_along_itself() -> None:
    whitened = np.zeros((41, 41, 3), dtype=np.float32)
    for t in range(-15, 16):
        whitened[20 + t, 20 + t, 0] = 1.0
    full = np.ones((41, 41), dtype=np.float32)
    strength, way = searching.line_strengths(whitened, full, np.array([20]), np.array([20]), 6, 12)
    # Directions are 15 degrees apart, rows go down: 45 degrees is the third. Thirteen pixels of 1: root of 13.
    assert way[0] == 3
    assert strength[0] == pytest.approx(np.sqrt(13.0), rel=0.35)
