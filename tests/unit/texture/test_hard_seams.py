"""Seams that can be seen, and seams that can't."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture.coverage import estimate_source
from tilefab.texture.hard_seams import MAX_HARD_SHARE, hard_seams

SIDE_PX = 96


def texture(seed: int, sigma: float, contrast: float = 12) -> NDArray[np.float64]:
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE_PX, SIDE_PX, 3)), (sigma, sigma, 0))
    return 50 + contrast * noise / noise.std()


def mosaic(seed: int, piece: int, rows: int = 192, cols: int = 192) -> NDArray[np.int32]:
    random = np.random.default_rng(seed)
    source = np.zeros((rows, cols), dtype=np.int32)
    index = np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX)
    for top in range(0, rows, piece):
        for left in range(0, cols, piece):
            r, c = random.integers(SIDE_PX - piece + 1, size=2)
            there = source[top : top + piece, left : left + piece]
            there[...] = index[r : r + piece, c : c + piece][: there.shape[0], : there.shape[1]]
    return source


def two_halves(exemplar: NDArray[np.float64]) -> NDArray[np.int32]:
    """The left third of an exemplar beside its right third."""
    index = np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX)
    third = SIDE_PX // 3
    return np.concatenate([index[:, :third], index[:, -third:]], axis=1)


def test_a_whole_exemplar_has_none() -> None:
    exemplar = texture(1, 3)
    found = hard_seams(np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX), exemplar)
    assert (found.share, found.count, found.longest_px) == (0, 0, 0)


def test_a_straight_step_is_found_where_it_is_and_as_long_as_it_is() -> None:
    exemplar = texture(2, 3, 4)
    exemplar[:, SIDE_PX // 2 :] += 15
    found = hard_seams(two_halves(exemplar), exemplar)
    assert found.count == 1
    assert found.longest_px == pytest.approx(SIDE_PX, abs=4)
    cols = np.flatnonzero(found.where.any(axis=0))
    assert abs((cols.min() + cols.max()) / 2 - (SIDE_PX // 3 - 0.5)) <= 1
    assert np.ptp(cols) < 10


def test_a_mosaic_fails_and_a_patchwork_of_grains_passes() -> None:
    exemplar = texture(3, 4)
    assert hard_seams(mosaic(4, 32), exemplar).share > 4 * MAX_HARD_SHARE
    # Grit: every pixel goes its own way, and so do the steps between pieces.
    grit = np.random.default_rng(5).normal(50, 12, (SIDE_PX, SIDE_PX, 3))
    assert hard_seams(mosaic(6, 4), grit).share < MAX_HARD_SHARE


def test_where_pieces_agree_there_is_no_seam_however_strong_the_edge() -> None:
    exemplar = np.full((SIDE_PX, SIDE_PX, 1), 20.0)
    exemplar[:, 8::16] = 90
    exemplar[:, 9::16] = 90
    index = np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX)
    # A period further on, the exemplar shows the same: the cut beside the stripe is free.
    agrees = np.concatenate([index[:, :42], index[:, 26:]], axis=1)
    assert hard_seams(agrees, exemplar).share == 0
    disagrees = np.concatenate([index[:, :41], index[:, 43:]], axis=1)
    assert hard_seams(disagrees, exemplar).longest_px > 80


def test_the_estimate_without_a_map_tells_the_same() -> None:
    exemplar = texture(7, 3)
    source = mosaic(8, 32)
    image = exemplar.reshape(-1, 3)[source]
    by_map = hard_seams(source, exemplar)
    found = estimate_source(exemplar, image)
    by_looking = hard_seams(found.source, exemplar, image, found.known)
    assert by_looking.share == pytest.approx(by_map.share, rel=0.15)
    assert by_looking.share > 4 * MAX_HARD_SHARE


def test_what_isnt_known_isnt_judged() -> None:
    exemplar, source = texture(9, 3), mosaic(10, 32)
    nothing = np.zeros(source.shape, dtype=bool)
    assert hard_seams(source, exemplar, None, nothing).share == 0


def test_turned_and_mirrored_images_have_the_same_seams() -> None:
    exemplar, source = texture(11, 3), mosaic(12, 32)
    index = np.arange(SIDE_PX**2, dtype=np.int32).reshape(SIDE_PX, SIDE_PX)
    place = np.empty(SIDE_PX**2, dtype=np.int32)
    place[np.rot90(index).ravel()] = np.arange(SIDE_PX**2, dtype=np.int32)
    turned = hard_seams(np.rot90(place[source]), np.rot90(exemplar))
    straight = hard_seams(source, exemplar)
    # Steps are kept at the pixel before them, which after a turn is the one behind.
    assert turned.share == pytest.approx(straight.share, rel=0.03)


def test_one_colour_has_no_seams() -> None:
    assert hard_seams(mosaic(13, 32), np.full((SIDE_PX, SIDE_PX, 3), 40.0)).share == 0


@pytest.mark.parametrize(
    ("source", "exemplar", "image", "message"),
    [
        (np.zeros((4, 4), dtype=np.int32), np.zeros((9, 9)), None, "channels"),
        (np.zeros((4, 4), dtype=np.int32), np.zeros((7, 9, 3)), None, "8 pixels"),
        (np.zeros(4, dtype=np.int32), np.zeros((9, 9, 3)), None, "source map"),
        (np.full((4, 4), 81, dtype=np.int32), np.zeros((9, 9, 3)), None, "outside"),
        (np.zeros((4, 4), dtype=np.int32), np.zeros((9, 9, 3)), np.zeros((4, 5, 3)), "differ"),
    ],
)
def test_misuse_is_refused(source, exemplar, image, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hard_seams(source, exemplar, image)
