"""Pictures made smaller."""

from __future__ import annotations

import numpy as np
import pytest

from tilefab.colour import reduce_srgb


def test_a_factor_of_one_changes_nothing() -> None:
    rgb = np.random.default_rng(1).integers(0, 256, (5, 7, 3)).astype(np.uint8)
    np.testing.assert_array_equal(reduce_srgb(rgb, 1), rgb)


@pytest.mark.parametrize("factor", [2, 3, 5, 100])
def test_every_flat_colour_stays_itself(factor: int) -> None:
    for value in range(0, 256, 5):
        flat = np.full((11, 9, 3), (value, 255 - value, value // 2), dtype=np.uint8)
        reduced = reduce_srgb(flat, factor)
        assert reduced.shape == (max(1, 11 // min(factor, 9)), max(1, 9 // min(factor, 9)), 3)
        assert (reduced == flat[0, 0]).all()


def test_light_is_averaged_not_numbers() -> None:
    # Half black and half white is half the light: 188 in sRGB, not 128.
    checks = np.indices((4, 4)).sum(axis=0)[..., None].repeat(3, axis=2) % 2
    assert reduce_srgb((checks * 255).astype(np.uint8), 2).tolist() == [[[188] * 3] * 2] * 2


def test_tall_pictures_are_reduced_in_strips_without_seams() -> None:
    ramp = np.repeat(np.arange(900, dtype=np.int64) // 4, 6).reshape(900, 6, 1).repeat(3, axis=2).astype(np.uint8)
    reduced = reduce_srgb(ramp, 3)
    assert reduced.shape == (300, 2, 3)
    assert (np.diff(reduced[:, 0, 0].astype(int)) >= 0).all()
    assert np.diff(reduced[:, 0, 0].astype(int)).max() <= 2
