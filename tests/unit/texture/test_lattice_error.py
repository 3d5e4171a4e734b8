"""Lattices drawn here, bent by amounts that are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture.lattice_error import lattice_error, lattice_generators

GENERATORS = np.array([[17.3, 2.4], [-1.1, 21.7]])


def bumps(rows: int, cols: int, seed: int = 1, bend_px: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """A bump at each node and a smaller one beside it, with noise; places moved by ``bend_px`` (rows, cols, 2)."""
    places = np.stack(np.mgrid[:rows, :cols], axis=-1).astype(np.float64)
    if bend_px is not None:
        places = places + bend_px
    lattice = (places @ np.linalg.inv(GENERATORS)) % 1.0 - 0.5
    square = ((lattice @ GENERATORS) ** 2).sum(axis=-1)
    beside = (((lattice + np.array([0.15, -0.3])) % 1.0 - 0.5) @ GENERATORS) ** 2
    clean = 40 + 40 * np.exp(-square / 18) - 15 * np.exp(-beside.sum(axis=-1) / 8)
    return clean + np.random.default_rng(seed).normal(0, 1.5, (rows, cols))


def same_lattice(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether the generators of one are whole sums of the other's, and the other way round."""
    factors = one @ np.linalg.inv(other)
    return bool(
        np.abs(factors - np.rint(factors)).max() < 0.01 and abs(abs(np.linalg.det(np.rint(factors))) - 1) < 1e-9
    )


def test_generators_are_found_to_a_fraction_of_a_pixel() -> None:
    found = lattice_generators(bumps(110, 120))
    assert found is not None
    assert same_lattice(found, GENERATORS)
    assert np.hypot(*found.T) == pytest.approx(np.sort(np.hypot(*GENERATORS.T)), abs=0.1)


def test_irregular_textures_have_no_lattice() -> None:
    random = np.random.default_rng(2)
    assert lattice_generators(ndimage.gaussian_filter(random.normal(size=(100, 100)), 3)) is None
    assert lattice_generators(random.normal(size=(64, 64))) is None
    assert lattice_generators(np.full((32, 32), 50.0)) is None
    stripes = np.broadcast_to(np.sin(np.arange(96) / 3), (96, 96))
    # Stripes repeat at every shift along them, at none that is shortest.
    assert lattice_error(random.normal(size=(64, 64)), stripes) is None


def test_a_true_lattice_has_hardly_an_error_wherever_it_begins() -> None:
    exemplar = bumps(110, 120)
    for top, left in ((0, 0), (7, 13)):
        found = lattice_error(exemplar, bumps(260, 300, 3)[top:, left:])
        assert found is not None
        assert found.worst_px < 0.5
        assert found.rms_px < 0.2
        assert found.nodes > 100


def test_a_wave_comes_out_as_large_as_it_is() -> None:
    bend = np.zeros((260, 300, 2))
    bend[..., 1] = 3 * np.sin(2 * np.pi * np.arange(260) / 130)[:, None]
    found = lattice_error(bumps(110, 120), bumps(260, 300, 4, bend))
    assert found is not None
    assert found.rms_px == pytest.approx(3 / np.sqrt(2), rel=0.25)
    assert found.worst_px == pytest.approx(3, rel=0.3)


def test_half_the_image_shifted_by_a_third_of_a_cell_is_seen() -> None:
    image = bumps(260, 300, 5)
    image[:, 150:] = np.roll(image, -7, axis=1)[:, 150:]
    found = lattice_error(bumps(110, 120), image)
    assert found is not None
    assert found.rms_px > 1.5


def test_a_uniform_stretch_is_drift_but_no_error() -> None:
    bend = np.zeros((260, 300, 2))
    bend[..., 0] = 0.01 * np.arange(260)[:, None]
    found = lattice_error(bumps(110, 120), bumps(260, 300, 7, bend))
    assert found is not None
    assert found.rms_px < 0.3
    assert found.drift_px == pytest.approx(2.6, abs=1.2)


def test_an_image_smaller_than_a_cell_tells_nothing() -> None:
    assert lattice_error(bumps(110, 120), bumps(20, 20)) is None


@pytest.mark.parametrize(
    ("exemplar", "image"), [(np.zeros((64, 64, 3)), np.zeros((64, 64))), (np.zeros((64, 64)), np.zeros((64, 64, 3)))]
)
def test_misuse_is_refused(exemplar, image) -> None:
    with pytest.raises(ValueError, match="rows, cols"):
        lattice_error(exemplar, image)


def test_too_small_an_exemplar_is_refused() -> None:
    with pytest.raises(ValueError, match="16 pixels"):
        lattice_generators(np.zeros((15, 64)))
