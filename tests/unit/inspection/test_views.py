"""Cells of a face are the same from an image and from a rendering; the kernel is the plain computation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.tile_photo import PhotoConditions
from tests.imagined_stone import ImaginedStone, to_xyz, true_corners
from tilefab.colour import lab_from_xyz
from tilefab.inspection.fingerprint_kernels import gather_cells
from tilefab.inspection.views import (
    Cells,
    Window,
    cells_of_image,
    cells_of_view,
    detail,
    face_corners,
    grid_of,
    lightness,
    matrix_of,
)
from tilefab.types import SizeMm, SizePx

SIZE = SizeMm(150.0, 150.0)


@given(st.floats(20.0, 3000.0), st.floats(20.0, 3000.0), st.integers(64, 4096))
def test_grid_is_nearly_full_and_square(width: float, height: float, cells: int) -> None:
    grid = grid_of(SizeMm(width, height), cells)
    assert 1 <= grid.rows * grid.cols <= cells
    if max(width, height) < 4.0 * min(width, height):
        assert grid.rows * grid.cols > 0.6 * cells
        assert 0.6 < (width / grid.cols) / (height / grid.rows) < 1.7


def test_kernel_is_the_plain_computation() -> None:
    generator = np.random.default_rng(1)
    light = generator.random((40, 50), dtype=np.float32)
    mask = generator.random((40, 50)) > 0.2
    matrix = np.array([[4.013, 0.517, 3.07], [-0.311, 3.709, 5.03], [0.0, 0.0, 1.0]])
    mean, share = np.empty((9, 12), np.float32), np.empty((9, 12), np.float32)
    gather_cells(light, mask, matrix, 5, mean, share)
    for row in range(9):
        for col in range(12):
            values, places = [], 0
            for i in range(5):
                for j in range(5):
                    x, y, _ = matrix @ np.array([col + (j + 0.5) / 5, row + (i + 0.5) / 5, 1.0])
                    places += 1
                    if 0 <= x < 50 and 0 <= y < 40 and mask[int(y), int(x)]:
                        values.append(light[int(y), int(x)])
            assert share[row, col] == pytest.approx(len(values) / places)
            assert mean[row, col] == pytest.approx(np.mean(values) if values else 0.0, abs=1e-5)


@pytest.mark.parametrize("turns", range(4))
def test_image_and_rendering_agree(turns: int) -> None:
    stone = ImaginedStone(SIZE)
    photo = stone.photo(3, PhotoConditions(turns, 2.0, noise=0.002, perspective=0.01))
    xyz = to_xyz(photo.image)
    lying = np.roll(true_corners(photo, SIZE), turns, axis=0)
    grid = SizePx(24, 24)
    matrix = matrix_of(face_corners(lying, turns), grid)
    seen = cells_of_image(np.ascontiguousarray(xyz[..., 1]), np.ones(xyz.shape[:2], np.bool_), matrix, grid)
    wanted = cells_of_view(stone(3, 100), grid)
    assert seen.seen.all()
    difference = seen.lightness - wanted.lightness
    assert np.abs(difference).max() < 2.5
    assert np.abs(difference[2:-2, 2:-2]).mean() < 0.4


@given(st.integers(5, 60), st.integers(5, 60), st.integers(1, 5), st.integers(1, 5))
def test_means_of_a_rendering(rows: int, cols: int, grid_rows: int, grid_cols: int) -> None:
    view = np.random.default_rng(rows * cols).random((rows, cols), dtype=np.float32)
    cells = cells_of_view(view, SizePx(grid_rows, grid_cols)).lightness
    assert cells.shape == (grid_rows, grid_cols)
    assert cells.mean() == pytest.approx(view.mean(), abs=1e-5)
    # Each pixel as many times as there are cells, then plain blocks.
    fine = np.repeat(np.repeat(view.astype(np.float64), grid_rows, axis=0), grid_cols, axis=1)
    np.testing.assert_allclose(cells, fine.reshape(grid_rows, rows, grid_cols, cols).mean(axis=(1, 3)), atol=1e-5)
    whole = cells_of_view(view, SizePx(rows, cols)).lightness
    np.testing.assert_allclose(whole, view, atol=1e-5)


def test_lightness_is_cie() -> None:
    light = np.array([-0.1, 0.0, 0.001, 0.005, 0.18, 1.0], dtype=np.float32)
    xyz = np.maximum(light, 0.0)[:, np.newaxis] * np.array([0.9642, 1.0, 0.8249])
    np.testing.assert_allclose(lightness(light), lab_from_xyz(xyz)[:, 0], atol=1e-3)


def test_detail_knows_nothing_of_slow_light() -> None:
    generator = np.random.default_rng(2)
    stone = generator.standard_normal((32, 32)).astype(np.float32)
    slope = np.linspace(0.0, 6.0, 32, dtype=np.float32)[np.newaxis, :]
    seen = np.ones((32, 32), dtype=np.bool_)
    seen[:, 20:] = False
    plain, sloped = detail(Cells(stone, seen), 3.0), detail(Cells(stone + slope, seen), 3.0)
    assert np.abs(plain - sloped)[:, 4:16].max() < 0.15
    assert (plain[:, 20:] == 0.0).all()
    weights = seen.astype(np.float32)
    np.testing.assert_allclose(Window(weights, 3.0).mean(np.full((32, 32), 7.0, np.float32))[:, :20], 7.0, rtol=1e-5)
