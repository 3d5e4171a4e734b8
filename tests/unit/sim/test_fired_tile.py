"""Fired tiles: every print pixel in its place, its flaws in it, bare glaze where nothing was printed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.fired_tile import LaidPrint, fired_tile, flawed, inks_on_tile
from sim.kiln import Firing
from sim.plant.physics.flaws import Flaw
from sim.scanner import fired_rgb
from sim.spectral_press import SpectralPress

PRESS = SpectralPress("ceramic4")
RANDOM = np.random.default_rng(3)
PIXELS = RANDOM.integers(0, 120, (24, 20, 4), dtype=np.uint8)


def laid(pixels: Any = PIXELS, offset_mm: float = 0.0, *flaws: Flaw) -> LaidPrint:
    return LaidPrint(pixels, 0.5, offset_mm, flaws)


def test_a_print_as_large_as_its_tile_is_fired_pixel_for_pixel():
    fired = fired_tile([laid()], (10.0, 12.0), PRESS, Firing(peak_offset_degc=5.0), px_per_mm=4.0)
    expected = fired_rgb(PIXELS, PRESS, Firing(peak_offset_degc=5.0))
    assert fired.shape == (48, 40, 3)
    assert fired.dtype == np.float32
    np.testing.assert_allclose(fired, expected.repeat(2, axis=0).repeat(2, axis=1), atol=1e-6)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_bleed_falls_off_all_round_and_the_rest_stays_bare(dtype):
    pixels = PIXELS.astype(dtype) * (257 if dtype == np.uint16 else 1)
    small = fired_tile([laid(pixels, -1.0)], (8.0, 10.0), PRESS, px_per_mm=2.0)
    np.testing.assert_allclose(small, fired_rgb(pixels[2:22, 2:18], PRESS), atol=1e-6)
    large = fired_tile([laid(pixels, 2.0)], (12.0, 15.0), PRESS, px_per_mm=2.0)
    bare = fired_rgb(np.zeros((1, 1, 4), np.uint8), PRESS)[0, 0]
    np.testing.assert_allclose(large[4:28, 2:22], fired_rgb(pixels, PRESS), atol=1e-6)
    large[4:28, 2:22] = bare
    np.testing.assert_allclose(large, np.broadcast_to(bare, large.shape), atol=1e-6)
    np.testing.assert_allclose(fired_tile([], (3.0, 2.0), PRESS, px_per_mm=2.0), np.broadcast_to(bare, (4, 6, 3)))


def test_half_pixels_of_a_shift_are_seen_on_a_finer_grid():
    column = np.zeros((20, 1, 4), np.uint8)
    column[10:] = 200
    fired = fired_tile([laid(column, 0.13)], (0.5, 10.0), PRESS, px_per_mm=20.0)
    edge = int(np.flatnonzero(np.diff(fired[:, 0, 1]) < -0.1)[0]) + 1
    assert edge / 20.0 == pytest.approx(5.13, abs=0.03)


@given(
    offset=st.floats(-9.0, 9.0),
    size=st.tuples(st.floats(1.0, 16.0), st.floats(1.0, 18.0)),
    shift=st.floats(-30.0, 30.0),
)
def test_wherever_prints_lie_each_pixel_is_where_it_belongs(offset, size, shift):
    both = [laid(PIXELS, offset), laid(PIXELS, offset + shift)]
    inks, row0_mm, col0_mm = inks_on_tile(both[:1], size, 4)
    assert -0.5 < row0_mm <= 1e-6
    assert -0.5 < col0_mm <= 1e-6
    assert inks.shape[0] * 0.5 + row0_mm >= size[1] - 1e-6
    assert inks.shape[1] * 0.5 + col0_mm >= size[0] - 1e-6
    for row, col in ((0, 0), (inks.shape[0] - 1, inks.shape[1] - 1), (inks.shape[0] // 2, inks.shape[1] // 2)):
        r = round((row0_mm + row * 0.5 - offset) / 0.5)
        c = round((col0_mm + col * 0.5 - (size[0] - 10.0) / 2) / 0.5)
        inside = 0 <= r < 24 and 0 <= c < 20
        assert inks[row, col].tolist() == (PIXELS[r, c].tolist() if inside else [0, 0, 0, 0])
    assert (inks_on_tile(both, size, 4)[0] >= inks).all()


def test_prints_over_each_other_add_up_to_full_covers_at_most():
    inks, _, _ = inks_on_tile([laid(), laid(), laid()], (10.0, 12.0), 4)
    assert (inks == np.minimum(3 * PIXELS.astype(int), 255)).all()


def test_inks_that_a_print_has_not_are_laid_nowhere():
    inks, _, _ = inks_on_tile([laid(PIXELS[:, :, :2])], (10.0, 12.0), 4)
    assert (inks[:, :, :2] == PIXELS[:, :, :2]).all()
    assert not inks[:, :, 2:].any()


def test_a_nozzle_leaves_one_ink_s_column_white_from_a_row_on():
    solid = np.full((24, 20, 4), 200, np.uint8)
    out = flawed(laid(solid, 0.0, Flaw("nozzle", ink=1, at_mm=2.1, width_mm=0.2, from_row=5)))
    missing = np.argwhere(out == 0)
    assert {tuple(place) for place in missing} == {(row, 14, 1) for row in range(5, 24)}
    assert (solid == 200).all()
    assert (flawed(laid(solid, 0.0, Flaw("nozzle", at_mm=99.0, width_mm=0.2))) == 200).all()
    wide = flawed(laid(solid, 0.0, Flaw("nozzle", at_mm=0.0, width_mm=2.0)))
    assert np.unique(np.argwhere(wide == 0)[:, 1]).tolist() == [8, 9, 10, 11]


def test_banding_follows_its_period_along_the_rows():
    solid = np.full((24, 20, 4), 200, np.uint8)
    out = flawed(laid(solid, 0.0, Flaw("banding", strength=0.1, period_mm=4.0)))
    assert (out == out[:, :1, :1]).all()
    assert out[[0, 2, 4, 6, 8], 0, 0].tolist() == [200, 220, 200, 180, 200]


def test_a_double_print_lies_further_down():
    one = np.zeros((24, 20, 4), np.uint8)
    one[3] = 100
    inks, _, _ = inks_on_tile([laid(one, 0.0, Flaw("double_print", strength=0.5, shift_mm=2.0))], (10.0, 12.0), 4)
    assert inks[:, 0, 0].nonzero()[0].tolist() == [3, 7]
    assert (inks[3, 0, 0], inks[7, 0, 0]) == (100, 50)


def test_a_tile_of_too_many_pixels_is_refused():
    with pytest.raises(ValueError, match="larger than 8192"):
        inks_on_tile([LaidPrint(PIXELS, 0.01, 0.0)], (10.0, 120.0), 4)
