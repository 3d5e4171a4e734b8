"""Lattices: made textures whose generators are known, and textures that have none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from skimage import data

from tilefab.synthesis.lattice import ACCEPTED, Lattice, autocorrelation, find_lattice, unlikeness
from tilefab.types import Mask


def everywhere(exemplar: NDArray[np.float32]) -> Mask:
    return np.ones(exemplar.shape[:2], dtype=bool)


def tiled(generators: list[list[float]], side: int = 213, wobble_px: float = 0.0) -> NDArray[np.float32]:
    """Two boxes in every cell, blurred, with noise; generators as rows of the argument."""
    rng = np.random.default_rng(0)
    places = np.indices((side, side)).astype(np.float64)
    if wobble_px:
        bend = ndimage.gaussian_filter(rng.normal(size=places.shape), (0, 12, 12))
        places += wobble_px * bend / bend.std()
    cell = np.einsum("ij,jhw->ihw", np.linalg.inv(np.array(generators).T), places)
    cell -= np.floor(cell)
    plane = 50 + 30.0 * ((cell[0] < 0.4) & (cell[1] < 0.3))
    plane -= 20.0 * ((cell[0] > 0.6) & (cell[0] < 0.9) & (cell[1] > 0.5) & (cell[1] < 0.7))
    plane = ndimage.gaussian_filter(plane, 0.7) + rng.normal(0, 4, plane.shape)
    return np.asarray(plane[..., None], dtype=np.float32)


def same_lattice_px(lattice: Lattice, generators: list[list[float]], reach: int = 10) -> float:
    """Largest distance of a true lattice's point, ``reach`` cells away, to the nearest found one; inf if finer."""
    true = np.array(generators).T
    if abs(abs(np.linalg.det(lattice.matrix)) / abs(np.linalg.det(true)) - 1) > 0.1:
        return np.inf
    times = np.rint(np.linalg.solve(lattice.matrix, true))
    return float(np.hypot(*(reach * (true - lattice.matrix @ times))).max())


@pytest.mark.parametrize(
    "generators",
    [
        [[31.3, 0.0], [0.0, 24.7]],
        [[30.0, 0.0], [11.5, 27.2]],
        [[25.3, 13.0], [-14.0, 26.0]],
        [[12.4, 5.0], [0.0, 13.3]],
        [[60.0, -3.0], [30.0, 70.0]],
    ],
)
def test_finds_generators_to_fractions_of_a_pixel(generators: list[list[float]]) -> None:
    lattice = find_lattice(tiled(generators), np.ones((213, 213), dtype=bool))
    assert lattice is not None
    assert lattice.confidence >= ACCEPTED
    assert same_lattice_px(lattice, generators) < 0.6


def test_near_regular_is_regular_enough() -> None:
    generators = [[30.0, 0.0], [11.5, 27.2]]
    lattice = find_lattice(tiled(generators, wobble_px=0.8), np.ones((213, 213), dtype=bool))
    assert lattice is not None
    assert same_lattice_px(lattice, generators, reach=1) < 1.0


def test_the_checkerboard_steps_diagonally() -> None:
    rows, cols = np.mgrid[:85, :85]
    board = np.where((rows // 32 + cols // 32) % 2, 0.0, 100.0).astype(np.float32)[..., None]
    lattice = find_lattice(board, everywhere(board))
    assert lattice is not None
    assert same_lattice_px(lattice, [[32.0, 32.0], [32.0, -32.0]]) < 0.1


def test_a_large_exemplar_is_looked_at_smaller() -> None:
    generators = [[81.0, 20.0], [-17.0, 90.5]]
    exemplar = tiled(generators, side=1100)
    lattice = find_lattice(exemplar, everywhere(exemplar))
    assert lattice is not None
    assert same_lattice_px(lattice, generators) < 2.0


def test_holes_do_not_count() -> None:
    generators = [[31.3, 0.0], [0.0, 24.7]]
    exemplar = tiled(generators)
    valid = everywhere(exemplar)
    valid[40:120, 100:190] = False
    exemplar[~valid] = np.nan
    lattice = find_lattice(exemplar, valid)
    assert lattice is not None
    assert same_lattice_px(lattice, generators) < 0.6


def test_colour_alone_is_enough() -> None:
    generators = [[31.3, 0.0], [0.0, 24.7]]
    pattern = tiled(generators)
    exemplar = np.concatenate([np.full_like(pattern, 50), pattern - 50, np.zeros_like(pattern)], axis=2)
    lattice = find_lattice(exemplar, everywhere(exemplar))
    assert lattice is not None
    assert same_lattice_px(lattice, generators) < 0.6


@pytest.mark.parametrize("sigma", [0.0, 2.0, 6.0])
def test_grain_has_none(sigma: float) -> None:
    noise = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(200, 200, 3)), (sigma, sigma, 0))
    grain = (50 + 10 * noise / noise.std()).astype(np.float32)
    assert find_lattice(grain, everywhere(grain)) is None


@pytest.mark.parametrize("name", ["gravel", "grass"])
def test_stone_and_grass_have_none(name: str) -> None:
    image = (getattr(data, name)() / 2.55).astype(np.float32)[:256, :256, None]
    assert find_lattice(image, everywhere(image)) is None


@pytest.mark.parametrize("side", [16, 40])
def test_one_colour_has_none(side: int) -> None:
    flat = np.full((side, side, 3), 50, dtype=np.float32)
    assert find_lattice(flat, everywhere(flat)) is None


def test_generators_are_the_shortest_in_a_fixed_order() -> None:
    lattice = find_lattice(tiled([[31.3, 0.0], [0.0, 24.7]]), np.ones((213, 213), dtype=bool))
    assert lattice is not None
    assert lattice.first == pytest.approx((31.3, 0), abs=0.1)
    assert lattice.second == pytest.approx((0, 24.7), abs=0.1)
    assert lattice.cell_px == pytest.approx((31.3, 24.7), abs=0.2)


def test_scaling() -> None:
    lattice = Lattice((30.0, 2.0), (-4.0, 20.0), 0.8)
    assert lattice.scaled(0.5) == Lattice((15.0, 1.0), (-2.0, 10.0), 0.8)
    assert lattice.scaled((2.0, 0.5)) == Lattice((60.0, 1.0), (-8.0, 10.0), 0.8)


def shifted_pairs(planes: NDArray[np.float64], valid: Mask, down: int, across: int) -> NDArray[np.float64]:
    """Differences (n, channels) between all valid pixels and those so far away."""
    rows, cols = valid.shape
    return np.array(
        [
            planes[r, c] - planes[r + down, c + across]
            for r in range(rows)
            for c in range(cols)
            if 0 <= r + down < rows and 0 <= c + across < cols and valid[r, c] and valid[r + down, c + across]
        ]
    )


@pytest.mark.parametrize(("down", "across"), [(0, 0), (3, -2), (-7, 5), (0, 9)])
def test_unlikeness_by_brute_force(down: int, across: int) -> None:
    rng = np.random.default_rng(2)
    planes = rng.uniform(0, 100, (20, 17, 2))
    valid = rng.random((20, 17)) < 0.8
    found = unlikeness(planes, valid)
    middle = np.array(found.shape) // 2
    expected = (shifted_pairs(planes, valid, down, across) ** 2).sum(axis=1).mean()
    assert found[middle[0] + down, middle[1] + across] == pytest.approx(expected, abs=1e-6)


def test_autocorrelation_is_one_at_rest_and_even() -> None:
    planes = tiled([[31.3, 0.0], [0.0, 24.7]], side=90).astype(np.float64)
    found = autocorrelation(planes, np.ones((90, 90), dtype=bool))
    assert found[found.shape[0] // 2, found.shape[1] // 2] == 1.0
    np.testing.assert_allclose(found, found[::-1, ::-1], atol=2e-4)
    assert np.abs(found).max() <= 1.0


def test_misuse_is_refused() -> None:
    with pytest.raises(ValueError, match="no valid pixel"):
        find_lattice(np.zeros((20, 20, 1), np.float32), np.zeros((20, 20), bool))
