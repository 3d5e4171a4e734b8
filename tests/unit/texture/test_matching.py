"""Matching in integers: sums by FFT are the true sums, searches find what brute force finds."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.texture.matching import (
    TemplateSearch,
    largest_square,
    largest_square_plain,
    matching_image,
    reduced,
    reduced_mask,
    refine_place,
    window_is_valid,
)

LAB_STEPS = st.integers(-256, 255)


def direct_sum(
    image: NDArray[np.int16], template: NDArray[np.int16], mask: NDArray[np.bool_], row: int, col: int
) -> int:
    rows, cols = mask.shape
    difference = image[row : row + rows, col : col + cols].astype(np.int64) - template
    return int((difference**2)[mask].sum())


def test_matching_image_counts_half_units() -> None:
    lab = np.array([[[50.0, -0.2, 0.3], [99.74, -127.5, 127.26]]], dtype=np.float32)
    image = matching_image(lab)
    assert image.dtype == np.int16
    assert_array_equal(image, [[[100, 0, 1], [199, -255, 255]]])


@given(st.data())
def test_reduced_is_the_mean_rounded_half_up(data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3)))
    factor = data.draw(st.integers(1, 4))
    image = data.draw(hnp.arrays(np.int16, shape, elements=LAB_STEPS))
    small = reduced(image, factor)
    assert small.shape == (shape[0] // factor, shape[1] // factor, 3)
    assert small.dtype == np.int16
    for r, c, k in np.ndindex(small.shape):
        block = image[r * factor : (r + 1) * factor, c * factor : (c + 1) * factor, k]
        assert small[r, c, k] == math.floor(Fraction(int(block.sum()), factor**2) + Fraction(1, 2))


@given(st.data())
def test_reduced_mask_is_true_where_all_of_a_block_is(data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    factor = data.draw(st.integers(1, 4))
    mask = ~data.draw(hnp.arrays(bool, shape, fill=st.just(False)))
    small = reduced_mask(mask, factor)
    assert small.shape == (shape[0] // factor, shape[1] // factor)
    for r, c in np.ndindex(small.shape):
        assert small[r, c] == mask[r * factor : (r + 1) * factor, c * factor : (c + 1) * factor].all()


@given(st.data())
def test_window_is_valid_where_all_of_the_window_is(data: st.DataObject) -> None:
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 9)))
    rows, cols = data.draw(st.integers(1, 11)), data.draw(st.integers(1, 11))
    valid = ~data.draw(hnp.arrays(bool, shape, fill=st.just(False)))
    result = window_is_valid(valid, rows, cols)
    assert result.dtype == bool
    assert result.shape == (max(shape[0] - rows + 1, 0), max(shape[1] - cols + 1, 0))
    for r, c in np.ndindex(result.shape):
        assert result[r, c] == valid[r : r + rows, c : c + cols].all()


@settings(max_examples=60)
@given(st.data())
def test_sums_by_fft_are_the_direct_sums(data: st.DataObject) -> None:
    rows, cols = data.draw(st.integers(1, 14)), data.draw(st.integers(1, 14))
    t_rows, t_cols = data.draw(st.integers(1, rows)), data.draw(st.integers(1, cols))
    image = data.draw(hnp.arrays(np.int16, (rows, cols, 3), elements=LAB_STEPS))
    template = data.draw(hnp.arrays(np.int16, (t_rows, t_cols, 3), elements=LAB_STEPS))
    mask = data.draw(hnp.arrays(bool, (t_rows, t_cols)))
    sums = TemplateSearch(image).squared_differences(template, mask)
    assert sums.dtype == np.int64
    assert sums.shape == (rows - t_rows + 1, cols - t_cols + 1)
    for r, c in np.ndindex(sums.shape):
        assert sums[r, c] == direct_sum(image, template, mask, r, c)


def test_sums_stay_exact_at_full_size_with_the_largest_differences() -> None:
    random = np.random.default_rng(1)
    # The search works on up to 2**20 pixels: a quarter of that, nothing but extremes.
    image = random.choice(np.array([-256, 0, 255], dtype=np.int16), (512, 512, 3))
    template = -image[100:300, 50:290]
    mask = random.random((200, 240)) < 0.9
    search = TemplateSearch(image)
    sums = search.squared_differences(template, mask)
    for r, c in [(0, 0), (100, 50), (312, 272), *random.integers(0, 270, (40, 2)).tolist()]:
        assert sums[r, c] == direct_sum(image, template, mask, r, c)
    template = image[100:300, 50:290].copy()
    template[~mask] = 20000
    sums = search.squared_differences(template, mask)
    assert sums[100, 50] == 0
    assert np.count_nonzero(sums == 0) == 1


@settings(max_examples=60)
@given(st.data())
def test_refine_place_finds_what_brute_force_finds(data: st.DataObject) -> None:
    rows, cols = data.draw(st.integers(3, 10)), data.draw(st.integers(3, 10))
    t_rows, t_cols = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 3))
    few = st.integers(0, data.draw(st.sampled_from([1, 255])))  # few levels make ties
    image = data.draw(hnp.arrays(np.int16, (rows, cols, 3), elements=few))
    template = data.draw(hnp.arrays(np.int16, (t_rows, t_cols, 3), elements=few))
    mask = data.draw(hnp.arrays(bool, (t_rows, t_cols)))
    allowed = data.draw(hnp.arrays(bool, (rows - t_rows + 1, cols - t_cols + 1)))
    row, col = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, cols - 1))
    reach = data.draw(st.integers(0, 4))
    places = [
        (direct_sum(image, template, mask, r, c), r, c)
        for r, c in np.ndindex(allowed.shape)
        if allowed[r, c] and abs(r - row) <= reach and abs(c - col) <= reach
    ]
    best, best_row, best_col = min(places, default=(-1, -1, -1))
    assert refine_place(image, template, mask, allowed, row, col, reach) == (best_row, best_col, best)


@pytest.mark.parametrize("reach", [0, 2])
def test_refine_place_without_an_allowed_place(reach: int) -> None:
    image = np.zeros((8, 8, 3), dtype=np.int16)
    allowed = np.zeros((6, 6), dtype=bool)
    allowed[5, 5] = True
    found = refine_place(image, image[:3, :3], np.ones((3, 3), dtype=bool), allowed, 2, 2, reach)
    assert found == (-1, -1, -1)


@given(hnp.arrays(np.bool_, hnp.array_shapes(min_dims=2, max_dims=2, min_side=0, max_side=14), elements=st.booleans()))
def test_the_largest_square_is_what_bisection_finds(mask: NDArray[np.bool_]) -> None:
    mask = mask | np.roll(mask, 1) if mask.size else mask
    assert largest_square(mask) == largest_square_plain(mask)


def test_the_largest_square_of_a_mask_with_a_hole() -> None:
    mask = np.ones((40, 55), dtype=bool)
    assert largest_square(mask) == 40
    mask[20, 30] = False
    assert largest_square(mask) == 30
    assert largest_square(~mask) == 1
    assert largest_square(np.zeros((3, 4), dtype=bool)) == 0
