"""Pieces that are nearly in step are put in step, and others are left alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.lattice import Lattice
from tilefab.synthesis.lattice_phase import in_step
from tilefab.types import SizePx

SHAPE = (90, 100)
SIZE = SizePx(80, 96)
SQUARE = Lattice((16.0, 0.0), (0.0, 16.0), 1.0)
LEANING = Lattice((20.0, 4.0), (-3.0, 18.5), 1.0)
ALL = np.ones(SHAPE, dtype=bool)


def pieces(offsets: NDArray[np.int64]) -> NDArray[np.int32]:
    """A patchwork of 8 x 8: the offset (down, right) of each piece, (rows, cols, 2), folded into the exemplar."""
    moved = offsets.repeat(8, axis=0).repeat(8, axis=1)
    rows, cols = np.indices(moved.shape[:2])
    return ((rows + moved[..., 0]) * SHAPE[1] + cols + moved[..., 1]).astype(np.int32)


def whole_cells(lattice: Lattice, seed: int, phase: tuple[int, int]) -> NDArray[np.float64]:
    """Exact offsets that stay within the exemplar and show one phase, (10, 12, 2)."""
    random, found = np.random.default_rng(seed), np.zeros((10, 12, 2))
    for i, j in np.ndindex(10, 12):
        while True:
            exact = lattice.matrix @ random.integers(-8, 9, 2) + phase
            at = exact + np.array([8 * i, 8 * j])
            if (at >= 4).all() and (at <= np.array(SHAPE) - 13).all():
                found[i, j] = exact
                break
    return found


@pytest.mark.parametrize("lattice", [SQUARE, LEANING])
@pytest.mark.parametrize("phase", [(0, 0), (5, 11)])
def test_small_errors_are_taken_back(lattice: Lattice, phase: tuple[int, int]) -> None:
    exact = whole_cells(lattice, 1, phase)
    right = pieces(np.rint(exact).astype(np.int64))
    # As many a pixel too far as too near: the phase itself stays.
    wrong = np.rint(exact).astype(np.int64)
    wrong += np.array([-1, 0, 1])[np.random.default_rng(2).permutation(240) % 3].reshape(wrong.shape)
    assert np.mean(pieces(wrong) != right) > 0.7
    mended = in_step(pieces(wrong), ALL, lattice, SIZE, toroidal=False)
    assert mended.dtype == np.int32
    off = np.abs(np.stack(np.divmod(mended, SHAPE[1])) - np.stack(np.divmod(right, SHAPE[1])))
    # The phase is a mean: where a fraction lies near a half, it may be rounded the other way.
    assert off.max() <= (0 if lattice is SQUARE else 1)
    assert np.mean(mended == right) > 0.6
    assert_array_equal(in_step(mended, ALL, lattice, SIZE, toroidal=False), mended)


def test_what_is_far_off_is_meant() -> None:
    exact = np.rint(whole_cells(SQUARE, 3, (3, 3))).astype(np.int64)
    exact[4, 5] += [6, 0]
    exact[2, 9] += [0, -5]
    assert_array_equal(in_step(pieces(exact), ALL, SQUARE, SIZE, toroidal=False), pieces(exact))


def test_a_hole_and_the_edge_are_kept_clear_of() -> None:
    random = np.random.default_rng(4)
    valid = random.random(SHAPE) < 0.7
    places = np.flatnonzero(valid)
    source = random.choice(places, (SIZE.rows, SIZE.cols)).astype(np.int32)
    for toroidal in (True, False):
        found = in_step(source, valid, LEANING, SIZE, toroidal=toroidal)
        assert valid.reshape(-1)[found].all()
        assert 0.01 < np.mean(found != source) < 0.5


def test_a_torus_closes_on_a_stretched_lattice() -> None:
    # 80 and 96 are whole numbers of cells of 16, not of 16.4: five cells take in 82 pixels of the exemplar.
    lattice = Lattice((16.4, 0.0), (0.0, 16.4), 1.0)
    rows, cols = np.indices((SIZE.rows, SIZE.cols))
    source = ((rows % 16 + 16) * SHAPE[1] + cols % 16 + 16).astype(np.int32)
    phases = []
    for toroidal in (True, False):
        found = np.stack(np.divmod(in_step(source, ALL, lattice, SIZE, toroidal=toroidal), SHAPE[1]))
        # The phase of each pixel's place, against that of the pixel a cell of 16 before it.
        drift = (found - np.stack([rows, cols]) * 1.025) / 16.4
        phases.append(np.abs(np.exp(2j * np.pi * drift).mean(axis=(1, 2))).min())
    assert phases[0] > 0.99 > phases[1]
