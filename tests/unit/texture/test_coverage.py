"""Maps found by looking, against maps that are known; the search against a plain one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture.coverage import PATCH_PX, estimate_source
from tilefab.texture.coverage_kernels import FRESH_DRAWS, extend_pieces, match_patches
from tilefab.texture.matching import matching_image, window_is_valid
from tilefab.texture.repetition import usage

SIDE_PX = 64
MASK_64 = (1 << 64) - 1


def stone(seed: int, side: int = SIDE_PX) -> NDArray[np.float64]:
    random = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(random.normal(size=(side, side, 3)), (1.2, 1.2, 0), mode="wrap")
    return 50 + 12 * noise / noise.std()


def mosaic(seed: int, rows: int, cols: int, piece: int, shape: tuple[int, int]) -> NDArray[np.int32]:
    """The map of square pieces laid edge to edge."""
    random = np.random.default_rng(seed)
    source = np.zeros((rows, cols), dtype=np.int32)
    index = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)
    for top in range(0, rows, piece):
        for left in range(0, cols, piece):
            there = source[top : top + piece, left : left + piece]
            r, c = random.integers(shape[0] - piece + 1), random.integers(shape[1] - piece + 1)
            there[...] = index[r : r + piece, c : c + piece][: there.shape[0], : there.shape[1]]
    return source


def plain_hash(place: int, round_: int, draw: int) -> int:
    x = (place << 32 | round_ << 16 | draw) + 1
    x = x * 0x9E3779B97F4A7C15 & MASK_64
    x = (x ^ x >> 30) * 0xBF58476D1CE4E5B9 & MASK_64
    x = (x ^ x >> 27) * 0x94D049BB133111EB & MASK_64
    return x ^ x >> 31


def plain_match(image, exemplar, usable, side, rounds):
    """The search of `match_patches`, candidate by candidate, without early ends."""
    rows, cols = image.shape[0] - side + 1, image.shape[1] - side + 1
    listed = np.flatnonzero(usable)
    width = usable.shape[1]

    def square(r, c, row, col):
        d = image[r : r + side, c : c + side].astype(int) - exemplar[row : row + side, col : col + side]
        return int((d * d).sum())

    places, squares = np.zeros((rows, cols), dtype=int), np.zeros((rows, cols), dtype=int)
    for r, c in np.ndindex(rows, cols):
        places[r, c] = listed[plain_hash(r * cols + c, 0, 0) % len(listed)]
        squares[r, c] = square(r, c, *divmod(places[r, c], width))
    for round_ in range(1, rounds + 1):
        step = 1 if round_ % 2 else -1
        for r in range(rows)[::step]:
            for c in range(cols)[::step]:
                if squares[r, c] == 0:
                    continue

                def offer(row, col, r=r, c=c):
                    if row in range(usable.shape[0]) and col in range(width) and usable[row, col]:
                        found = square(r, c, row, col)
                        if found < squares[r, c]:
                            squares[r, c], places[r, c] = found, row * width + col

                if 0 <= c - step < cols:
                    row, col = divmod(places[r, c - step], width)
                    offer(row, col + step)
                if 0 <= r - step < rows:
                    row, col = divmod(places[r - step, c], width)
                    offer(row + step, col)
                for draw in range(FRESH_DRAWS):
                    offer(*divmod(int(listed[plain_hash(r * cols + c, round_, draw) % len(listed)]), width))
                reach, draw = max(usable.shape) // 2, FRESH_DRAWS
                while reach >= 1:
                    bits = plain_hash(r * cols + c, round_, draw)
                    row, col = divmod(places[r, c], width)
                    offer(row + bits % (2 * reach + 1) - reach, col + (bits >> 32) % (2 * reach + 1) - reach)
                    reach, draw = reach // 2, draw + 1
    return places, squares


@pytest.mark.parametrize("side", [3, 5])
def test_search_is_that_of_the_plain_one(side: int) -> None:
    random = np.random.default_rng(side)
    image, exemplar = (random.integers(-40, 40, (n, n + 3, 2)).astype(np.int16) for n in (14, 17))
    valid = random.random(exemplar.shape[:2]) > 0.02
    usable = window_is_valid(valid, side, side)
    places = np.empty((image.shape[0] - side + 1, image.shape[1] - side + 1), dtype=np.int32)
    squares = np.empty(places.shape, dtype=np.int64)
    match_patches(image, exemplar, usable, np.flatnonzero(usable).astype(np.int32), side, 3, places, squares)
    expected = plain_match(image, exemplar, usable, side, 3)
    assert_array_equal(places, expected[0])
    assert_array_equal(squares, expected[1])


def test_pieces_grow_as_they_do_one_pixel_at_a_time() -> None:
    random = np.random.default_rng(7)
    exemplar = random.integers(0, 9, (12, 13, 1)).astype(np.int16)
    image = random.integers(0, 9, (15, 16, 1)).astype(np.int16)
    valid = random.random((12, 13)) > 0.1
    source = random.choice(np.flatnonzero(valid), (15, 16)).astype(np.int32)
    known = random.random((15, 16)) < 0.2
    grown, holds = source.copy(), known.copy()
    extend_pieces(image, exemplar, valid, 4, grown, holds)
    changed, step = True, 1
    while changed:
        changed = False
        for r in range(15)[::step]:
            for c in range(16)[::step]:
                if known[r, c]:
                    continue
                best = (5, -1)
                for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                    if r + down in range(15) and c + right in range(16) and known[r + down, c + right]:
                        row, col = divmod(int(source[r + down, c + right]), 13)
                        row, col = row - down, col - right
                        if row in range(12) and col in range(13) and valid[row, col]:
                            square = (int(image[r, c, 0]) - int(exemplar[row, col, 0])) ** 2
                            if square < best[0]:
                                best = (square, row * 13 + col)
                if best[1] >= 0:
                    source[r, c], known[r, c], changed = best[1], True, True
        step = -step
    assert_array_equal(grown, source)
    assert_array_equal(holds, known)
    assert 0.3 < holds.mean() <= 1


@pytest.mark.parametrize("piece", [16, 30])
def test_a_mosaic_is_taken_apart_again(piece: int) -> None:
    exemplar = stone(1)
    true = mosaic(2, 120, 150, piece, (SIDE_PX, SIDE_PX))
    found = estimate_source(exemplar, exemplar.reshape(-1, 3)[true])
    assert found.known_share > 0.93
    assert np.mean((found.source == true)[found.known]) > 0.98
    shape = (SIDE_PX, SIDE_PX)
    assert usage(found.source, shape).coverage == pytest.approx(usage(true, shape).coverage, abs=0.02)


def test_little_is_known_of_another_stone() -> None:
    exemplar = stone(1)
    found = estimate_source(exemplar, stone(2, 80))
    assert found.known_share < 0.05
    assert found.source.min() >= 0
    assert found.source.max() < SIDE_PX**2


def test_small_changes_dont_hide_a_copy() -> None:
    exemplar = stone(3)
    true = mosaic(4, 90, 90, 30, (SIDE_PX, SIDE_PX))
    rounded = exemplar.reshape(-1, 3)[true] + np.random.default_rng(5).normal(0, 0.4, (90, 90, 3))
    found = estimate_source(exemplar, rounded)
    assert np.mean(found.source == true) > 0.9


def test_only_valid_places_are_named() -> None:
    exemplar = stone(6)
    valid = np.ones((SIDE_PX, SIDE_PX), dtype=bool)
    valid[:, 40:] = False
    source = estimate_source(exemplar, exemplar, valid).source
    assert valid.ravel()[source].all()


def test_an_image_of_one_patch_and_one_channel() -> None:
    exemplar = stone(8)[:, :, :1]
    found = estimate_source(exemplar, exemplar[10 : 10 + PATCH_PX, 20 : 20 + PATCH_PX])
    assert found.source.shape == (PATCH_PX, PATCH_PX)
    assert matching_image(exemplar).shape == (SIDE_PX, SIDE_PX, 1)


@pytest.mark.parametrize(
    ("exemplar", "image", "valid", "message"),
    [
        (np.zeros((9, 9, 3)), np.zeros((9, 9, 1)), None, "same channels"),
        (np.zeros((9, 9, 3)), np.zeros((9, 9)), None, "same channels"),
        (np.zeros((9, 9, 3)), np.zeros((6, 9, 3)), None, "image is"),
        (np.zeros((9, 6, 3)), np.zeros((9, 9, 3)), None, "exemplar is"),
        (np.zeros((9, 9, 3)), np.zeros((9, 9, 3)), np.ones((9, 8), dtype=bool), "mask"),
        (np.zeros((9, 9, 3)), np.zeros((9, 9, 3)), np.zeros((9, 9), dtype=bool), "no patch"),
    ],
)
def test_misuse_is_refused(exemplar, image, valid, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        estimate_source(exemplar, image, valid)
