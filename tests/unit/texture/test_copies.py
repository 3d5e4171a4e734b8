"""Large pieces: counted by another way of finding what hangs together."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.texture import copies as module
from tilefab.texture.copies import Copies, large_copies

SHAPE = (10, 12)
INDEX = np.arange(120, dtype=np.int32).reshape(SHAPE)


def wall(seed: int) -> NDArray[np.int32]:
    random = np.random.default_rng(seed)
    source = random.integers(120, size=(17, 22)).astype(np.int32)
    for _ in range(25):
        height, width = random.integers(1, 9), random.integers(1, 9)
        r, c = random.integers(18 - height), random.integers(23 - width)
        row, col = random.integers(11 - height), random.integers(13 - width)
        source[r : r + height, c : c + width] = INDEX[row : row + height, col : col + width]
    return source


def counted(source: NDArray[np.int32], known: NDArray[np.bool_], least_share: float) -> tuple[NDArray[np.int64], int]:
    """For each offset, what hangs together at it."""
    row, col = np.divmod(source, SHAPE[1])
    r, c = np.mgrid[: source.shape[0], : source.shape[1]]
    down, right = row - r, col - c
    count, largest = np.zeros(120, dtype=np.int64), 0
    for offset in {*zip(down.ravel().tolist(), right.ravel().tolist(), strict=True)}:
        labels, pieces = ndimage.label((down == offset[0]) & (right == offset[1]) & known)
        for piece in range(1, pieces + 1):
            places = source[labels == piece]
            largest = max(largest, places.size)
            if places.size > least_share * 120:
                count[places] += 1
    return count, largest


@given(st.integers(0, 10_000), st.sampled_from([1 / 60, 1 / 16, 0.2]), st.booleans())
def test_pieces_are_those_that_hang_together_at_one_offset(seed: int, share: float, all_known: bool) -> None:
    source = wall(seed)
    known = np.ones(source.shape, dtype=bool) if all_known else np.random.default_rng(seed).random(source.shape) > 0.1
    count, largest = counted(source, known, share)
    found = large_copies(source, SHAPE, least_share=share, known=known)
    assert found.most == count.max()
    assert count[np.ravel_multi_index(found.place, SHAPE)] == count.max()
    assert found.largest_share == largest / 120
    assert found.over_ratio == pytest.approx(count.max() * 120 / source.size)


def test_the_exemplar_itself_repeats_nothing() -> None:
    assert large_copies(INDEX, SHAPE) == Copies(1, 1.0, 1.0, (0, 0))


def test_exemplars_side_by_side_take_their_share() -> None:
    found = large_copies(np.tile(INDEX, (3, 3)), SHAPE)
    assert (found.most, found.over_ratio, found.too_many) == (9, 1.0, False)


def test_one_piece_again_and_again_is_too_many() -> None:
    found = large_copies(np.tile(INDEX[:5, :6], (4, 6)), SHAPE)
    assert (found.most, found.too_many) == (24, True)
    # So small a piece isn't known again.
    assert not large_copies(np.tile(INDEX[:2, :3], (10, 12)), SHAPE).too_many


def test_a_single_piece_of_a_small_image_is_no_repetition() -> None:
    found = large_copies(INDEX[:5, :6], SHAPE)
    assert (found.most, found.over_ratio, found.too_many) == (1, 4.0, False)


@pytest.mark.parametrize(
    ("source", "options", "message"),
    [
        (np.zeros((0, 3), dtype=np.int32), {}, "not empty"),
        (np.zeros(3, dtype=np.int32), {}, "rows, cols"),
        (np.array([[120]], dtype=np.int32), {}, "outside"),
        (np.array([[-1]], dtype=np.int32), {}, "outside"),
        (INDEX, {"least_share": 0.0}, "over 0"),
        (INDEX, {"known": np.ones((2, 2), dtype=bool)}, "differ in shape"),
    ],
)
def test_misuse_is_refused(source: NDArray[np.int32], options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        large_copies(source, SHAPE, **options)


def test_example_in_the_docstring_holds() -> None:
    failed, tried = doctest.testmod(module)
    assert (failed, tried > 0) == (0, True)
