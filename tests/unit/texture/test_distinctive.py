"""Distinctive places: made slabs whose odd places are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture.distinctive import distinctive_places
from tilefab.types import Mask

SIDE = 480
SIZE_PX = 40


def grain(seed: int = 0, side: int = SIDE) -> NDArray[np.float32]:
    """Stationary grain about a mid grey, blotches of some pixels, standard deviation 3."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(side, side, 3)), (3, 3, 0), mode="wrap")
    lab: NDArray[np.float32] = (3 * noise / noise.std() + np.array([60.0, 2.0, 8.0])).astype(np.float32)
    return lab


def blot(
    lab: NDArray[np.float32],
    row: int,
    col: int,
    colour: tuple[float, ...] = (-25, 20, 10),
    size_px: int = SIZE_PX,
) -> None:
    """Paint a soft round blotch, as large as what is looked for."""
    at_row, at_col = np.indices(lab.shape[:2])
    near = np.exp(-(((at_row - row) ** 2 + (at_col - col) ** 2) / (2 * (size_px / 4) ** 2)))
    lab += (near[..., None] * colour).astype(np.float32)


def everywhere(lab: NDArray[np.float32]) -> Mask:
    return np.ones(lab.shape[:2], dtype=bool)


@pytest.mark.parametrize(("row", "col"), [(130, 300), (333, 97), (30, 452)])
def test_finds_the_one_blotch(row: int, col: int) -> None:
    lab = grain()
    blot(lab, row, col)
    places = distinctive_places(lab, everywhere(lab), SIZE_PX)
    assert len(places) == 1
    assert math.hypot(places[0].row - row, places[0].col - col) < SIZE_PX / 3
    assert SIZE_PX / 2 * 0.7 < places[0].radius_px < SIZE_PX / 2 * 1.3
    assert places[0].score > 3


@pytest.mark.parametrize(("row", "col"), [(331, 101), (333, 97), (90, 211)])
def test_a_blotch_seen_twice_is_none(row: int, col: int) -> None:
    lab = grain()
    blot(lab, 130, 300)
    blot(lab, row, col)
    assert distinctive_places(lab, everywhere(lab), SIZE_PX) == []


def test_two_unlike_blotches_are_two() -> None:
    lab = grain()
    blot(lab, 130, 300)
    blot(lab, 340, 100, (20, -15, -20))
    places = distinctive_places(lab, everywhere(lab), SIZE_PX)
    assert len(places) == 2
    assert len(distinctive_places(lab, everywhere(lab), SIZE_PX, most=1)) == 1
    assert places[0].score >= places[1].score


def test_grain_has_none() -> None:
    lab = grain(1)
    assert distinctive_places(lab, everywhere(lab), SIZE_PX) == []


def test_white_noise_has_none() -> None:
    lab = np.random.default_rng(2).normal(50, 20, (SIDE, SIDE, 3)).astype(np.float32)
    assert distinctive_places(lab, everywhere(lab), SIZE_PX) == []


def test_flat_has_none() -> None:
    lab = np.full((SIDE, SIDE, 3), 40.0, dtype=np.float32)
    assert distinctive_places(lab, everywhere(lab), SIZE_PX) == []


def test_what_is_masked_is_no_place_and_no_likeness() -> None:
    lab = grain()
    blot(lab, 130, 300)
    valid = everywhere(lab)
    valid[100:160, 270:330] = False
    assert distinctive_places(lab, valid, SIZE_PX) == []
    blot(lab, 340, 100)
    places = distinctive_places(lab, valid, SIZE_PX)
    assert len(places) == 1
    assert math.hypot(places[0].row - 340, places[0].col - 100) < SIZE_PX / 3


def test_numbers_under_the_mask_don_t_matter() -> None:
    lab = grain()
    blot(lab, 130, 300)
    valid = everywhere(lab)
    valid[300:, 300:] = False
    clean = distinctive_places(lab, valid, SIZE_PX)
    lab[~valid] = np.nan
    assert distinctive_places(lab, valid, SIZE_PX) == clean
    assert len(clean) == 1


@pytest.mark.parametrize("shape", [(1, 1), (17, 300), (40, 40)])
def test_a_slab_too_small_to_tell_has_none(shape: tuple[int, int]) -> None:
    lab = np.random.default_rng(3).normal(50, 20, (*shape, 3)).astype(np.float32)
    assert distinctive_places(lab, np.ones(shape, dtype=bool), 30) == []


def test_nothing_valid_has_none() -> None:
    lab = grain()
    assert distinctive_places(lab, ~everywhere(lab), SIZE_PX) == []


def test_places_keep_apart_on_a_large_slab() -> None:
    lab = np.tile(grain(4), (3, 3, 1))
    rng = np.random.default_rng(5)
    for row, col in ((200, 300), (230, 340), (900, 1100), (1200, 200)):
        blot(lab, row, col, tuple(rng.uniform(-40, 40, 3)), 100)
    places = distinctive_places(lab, everywhere(lab), 100)
    assert places
    for k, one in enumerate(places):
        assert all(math.hypot(one.row - p.row, one.col - p.col) >= 100 for p in places[:k])


def test_refuses_what_doesn_t_fit() -> None:
    lab = grain()
    with pytest.raises(ValueError, match="belong together"):
        distinctive_places(lab, np.ones((3, 3), dtype=bool), SIZE_PX)
    with pytest.raises(ValueError, match="at least 1"):
        distinctive_places(lab, everywhere(lab), 0)
