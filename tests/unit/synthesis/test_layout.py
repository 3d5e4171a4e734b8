"""The first layout: lattices kept over the whole result, and exemplars dealt out evenly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tilefab.synthesis.lattice import Lattice
from tilefab.synthesis.layout import fit_note, fitting_sizes, initial_field
from tilefab.types import Mask, SizePx

SQUARE = Lattice((20.0, 0.0), (0.0, 25.0), 0.9)
ODD = Lattice((20.37, 3.11), (-4.62, 25.83), 0.9)
BOARD = Lattice((32.0, -32.0), (32.0, 32.0), 0.9)


def waves(lattice: Lattice, rows: int, cols: int, shift: NDArray[np.float64] | None = None) -> NDArray[np.float32]:
    """A smooth texture on the lattice: its phase can be read off at every pixel."""
    places = np.indices((rows, cols)).astype(np.float64) + (0 if shift is None else shift[:, None, None])
    phase = 2 * np.pi * np.einsum("ij,jhw->ihw", np.linalg.inv(lattice.matrix), places)
    return np.stack([50 + 20 * wave(part) for part in phase for wave in (np.cos, np.sin)], axis=2).astype(np.float32)


def everywhere(exemplar: NDArray[np.float32]) -> Mask:
    return np.ones(exemplar.shape[:2], dtype=bool)


def phase_error_px(
    exemplar: NDArray[np.float32], source: NDArray[np.int32], lattice: Lattice, stretched: Lattice | None = None
) -> float:
    """Largest distance, over all pixels, from where the best global lattice has the phase that they show."""
    rows, cols = np.divmod(source, exemplar.shape[1])
    shown = np.linalg.solve(lattice.matrix, np.stack([rows, cols]).reshape(2, -1).astype(float))
    here = np.linalg.solve((stretched or lattice).matrix, np.indices(source.shape).reshape(2, -1).astype(float))
    turns = np.exp(2j * np.pi * (shown - here))
    middle = np.angle(turns.mean(axis=1, keepdims=True))
    off = np.angle(turns * np.exp(-1j * middle)) / (2 * np.pi)
    return float(np.hypot(*(lattice.matrix @ off)).max())


@pytest.mark.parametrize("lattice", [SQUARE, ODD, BOARD])
@pytest.mark.parametrize("seed", [0, 7])
def test_the_phase_is_kept_over_the_whole_result(lattice: Lattice, seed: int) -> None:
    exemplar = waves(lattice, 110, 120)
    source = initial_field(exemplar, everywhere(exemplar), lattice, SizePx(640, 500), False, seed)
    assert source.shape == (640, 500)
    # One pixel, half of it from rounding, and no more however far it goes; the global lattice is fitted, too.
    assert phase_error_px(exemplar, source, lattice) < 1.05


def test_a_repeating_result_that_fits_closes() -> None:
    exemplar = waves(SQUARE, 110, 120)
    source = initial_field(exemplar, everywhere(exemplar), SQUARE, SizePx(200, 250), True, 3)
    assert phase_error_px(exemplar, np.tile(source, (2, 2)), SQUARE) < 1.0


def test_one_that_does_not_fit_is_stretched_until_it_closes() -> None:
    exemplar = waves(SQUARE, 110, 120)
    source = initial_field(exemplar, everywhere(exemplar), SQUARE, SizePx(194, 258), True, 3)
    stretched = Lattice((19.4, 0.0), (0.0, 25.8), 0.9)
    # Blocks stay rigid: towards their rims the phase is off by the stretch of half a block.
    assert phase_error_px(exemplar, np.tile(source, (2, 2)), SQUARE, stretched) < 2.5


def test_a_result_smaller_than_a_cell_is_cut_out() -> None:
    exemplar = waves(SQUARE, 110, 120)
    source = initial_field(exemplar, everywhere(exemplar), SQUARE, SizePx(9, 7), True, 3)
    assert source.shape == (9, 7)


@pytest.mark.parametrize("lattice", [None, ODD])
def test_every_part_is_used_about_as_often(lattice: Lattice | None) -> None:
    exemplar = waves(ODD, 160, 200)
    source = initial_field(exemplar, everywhere(exemplar), lattice, SizePx(800, 1000), False, 1)
    counts = np.bincount(source.ravel(), minlength=160 * 200).reshape(160, 200)
    parts = counts.reshape(8, 20, 8, 25).mean(axis=(1, 3))
    assert parts.mean() == pytest.approx(25)
    assert parts.min() > (12 if lattice else 20)
    assert parts.max() < (40 if lattice else 30)


@pytest.mark.parametrize("lattice", [None, SQUARE, ODD, BOARD])
def test_holes_are_never_shown(lattice: Lattice | None) -> None:
    exemplar = waves(lattice or ODD, 110, 120)
    valid = np.random.default_rng(0).random((110, 120)) > 0.02
    valid[30:50, 60:] = False
    source = initial_field(exemplar, valid, lattice, SizePx(150, 170), True, 2)
    assert valid.ravel()[source].all()


@pytest.mark.parametrize("lattice", [None, SQUARE])
def test_one_valid_pixel_is_enough(lattice: Lattice | None) -> None:
    exemplar = np.full((40, 40, 3), 50.0, dtype=np.float32)
    valid = np.zeros((40, 40), dtype=bool)
    valid[13, 22] = True
    source = initial_field(exemplar, valid, lattice, SizePx(12, 9), True, 2)
    assert (source == 13 * 40 + 22).all()


@pytest.mark.parametrize("lattice", [None, ODD])
def test_the_seed_decides(lattice: Lattice | None) -> None:
    exemplar = waves(ODD, 110, 120)
    first, again, other = (
        initial_field(exemplar, everywhere(exemplar), lattice, SizePx(100, 90), False, seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize(("rows", "cols"), [(16, 16), (5, 64), (1, 1)])
def test_small_exemplars(rows: int, cols: int) -> None:
    exemplar = np.random.default_rng(1).uniform(0, 100, (rows, cols, 1)).astype(np.float32)
    source = initial_field(exemplar, everywhere(exemplar), None, SizePx(50, 40), True, 0)
    assert source.shape == (50, 40)
    assert source.dtype == np.int32
    assert source.min() >= 0
    assert source.max() < rows * cols


def test_a_result_smaller_than_the_exemplar() -> None:
    exemplar = waves(ODD, 110, 120)
    source = initial_field(exemplar, everywhere(exemplar), None, SizePx(30, 20), True, 0)
    assert source.shape == (30, 20)


def test_sizes_that_fit() -> None:
    assert fitting_sizes(SQUARE, SizePx(200, 250)) == (SizePx(200, 250),)
    found = fitting_sizes(SQUARE, SizePx(210, 260))
    assert set(found) == {SizePx(rows, cols) for rows in (200, 220) for cols in (250, 275)}
    assert found[0] == SizePx(200, 250)
    # What a turned lattice has to offer is less exact.
    assert len(fitting_sizes(ODD, SizePx(210, 260))) >= 1


def test_the_note_names_them() -> None:
    assert fit_note(SQUARE, SizePx(200, 250)) is None
    assert fit_note(SQUARE, SizePx(201, 249)) is None
    note = fit_note(BOARD, SizePx(256, 170))
    assert note is not None
    assert "128 or 192 columns" in note
    assert "256 rows" in note


@pytest.mark.parametrize(
    ("size", "seed", "message"),
    [(SizePx(0, 5), 0, "size"), (SizePx(5, 5), -1, "seed"), (SizePx(5, 5), 1 << 63, "seed")],
)
def test_misuse_is_refused(size: SizePx, seed: int, message: str) -> None:
    exemplar = waves(SQUARE, 40, 40)
    with pytest.raises(ValueError, match=message):
        initial_field(exemplar, everywhere(exemplar), None, size, True, seed)
