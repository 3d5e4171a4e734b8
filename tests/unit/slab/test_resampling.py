"""Resampling against plain twins, reference values and invariances."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tilefab.slab.kernels import (
    cubic_taps,
    keys_cubic,
    resample_columns,
    resample_columns_plain,
    resample_rows,
    warp_plain,
    warp_rows,
)
from tilefab.slab.resampling import resample, resampled_size
from tilefab.types import SizePx


def random_image(rows: int, cols: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((rows, cols, 3), np.float32)


def all_valid(image: np.ndarray) -> np.ndarray:
    return np.ones(image.shape[:2], np.bool_)


def test_keys_cubic_has_its_published_values() -> None:
    assert [keys_cubic(x) for x in (0.0, 1.0, 2.0, 3.0)] == [1.0, 0.0, 0.0, 0.0]
    assert_allclose([keys_cubic(0.5), keys_cubic(1.5)], [9 / 16, -1 / 16])


@given(st.integers(1, 40), st.floats(0.02, 8.0))
@settings(max_examples=60, deadline=None)
def test_taps_sum_to_one_and_stay_inside(in_px: int, scale: float) -> None:
    out_px = resampled_size(SizePx(in_px, 1), scale).rows
    first, count, weights = cubic_taps(in_px, out_px, scale)
    assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)
    assert first.min() >= 0
    assert (first + count).max() <= in_px
    assert (count >= 1).all()


@pytest.mark.parametrize("scale", [0.13, 0.5, 0.77, 1.0, 1.5, 3.2])
def test_kernels_do_what_their_plain_twin_does(scale: float) -> None:
    image, valid = random_image(7, 23), np.random.default_rng(1).random((7, 23)) > 0.1
    out_cols = resampled_size(SizePx(7, 23), scale).cols
    taps = cubic_taps(23, out_cols, scale)
    out, out_valid = np.empty((7, out_cols, 3), np.float32), np.empty((7, out_cols), np.bool_)
    resample_columns(image, valid, *taps, out, out_valid)
    plain, plain_valid = resample_columns_plain(image, valid, *taps)
    assert_allclose(out, plain, atol=1e-6)
    assert_array_equal(out_valid, plain_valid)
    turned, turned_valid = np.empty((out_cols, 7, 3), np.float32), np.empty((out_cols, 7), np.bool_)
    image_t, valid_t = np.ascontiguousarray(image.transpose(1, 0, 2)), np.ascontiguousarray(valid.T)
    resample_rows(image_t, valid_t, *taps, turned, turned_valid)
    assert_array_equal(turned.transpose(1, 0, 2), out)
    assert_array_equal(turned_valid.T, out_valid)


def test_warp_does_what_its_plain_twin_does() -> None:
    image, valid = random_image(20, 25), np.random.default_rng(2).random((20, 25)) > 0.05
    matrix = np.array([[0.9, 0.1, 1.3], [-0.12, 1.05, 2.0], [1e-3, -5e-4, 1.0]])
    out, out_valid = np.empty((22, 24, 3), np.float32), np.empty((22, 24), np.bool_)
    warp_rows(image, valid, matrix, 0, 0, out, out_valid)
    plain, plain_valid = warp_plain(image, valid, matrix, 22, 24)
    assert_allclose(out, plain, atol=1e-6)
    assert_array_equal(out_valid, plain_valid)
    lower, lower_valid = np.empty((5, 10, 3), np.float32), np.empty((5, 10), np.bool_)
    warp_rows(image, valid, matrix, 9, 4, lower, lower_valid)
    assert_array_equal(lower, out[9:14, 4:14])
    assert_array_equal(lower_valid, out_valid[9:14, 4:14])


def test_warp_by_the_identity_copies_bit_for_bit() -> None:
    image, valid = random_image(9, 11), np.random.default_rng(3).random((9, 11)) > 0.3
    out, out_valid = np.empty_like(image), np.empty_like(valid)
    warp_rows(image, valid, np.eye(3), 0, 0, out, out_valid)
    assert_array_equal(out, image)
    assert_array_equal(out_valid, valid)


def test_same_resolution_changes_nothing() -> None:
    image, valid = random_image(5, 4), np.array([[True] * 4] * 4 + [[False] * 4])
    out, out_valid, record = resample(image, valid, 1.0)
    assert_array_equal(out, image)
    assert_array_equal(out_valid, valid)
    assert out is image
    assert record.summary.startswith("nothing, because")


@pytest.mark.parametrize("scale", [0.1, 0.36, 0.5, 1.7, 4.0])
def test_flat_light_stays_flat(scale: float) -> None:
    image = np.full((31, 17, 3), 0.3, np.float32)
    out, valid, record = resample(image, all_valid(image), scale)
    assert_allclose(out, 0.3, rtol=1e-6)
    assert valid.all()
    assert out.shape[:2] == (record.size_after.rows, record.size_after.cols)
    assert out.dtype == np.float32


@given(st.integers(1, 30), st.integers(1, 30), st.floats(0.05, 4.0), st.integers(0, 9))
@settings(max_examples=40, deadline=None)
def test_nothing_is_brighter_or_darker_than_the_stone(rows: int, cols: int, scale: float, seed: int) -> None:
    image = random_image(rows, cols, seed)
    out, valid, _ = resample(image, all_valid(image), scale)
    assert out.min() >= image.min()
    assert out.max() <= image.max()
    assert valid.all()
    assert out.flags.c_contiguous


def test_a_hard_edge_does_not_ring() -> None:
    image = np.zeros((16, 40, 3), np.float32)
    image[:, 20:] = 0.8
    for scale in (0.4, 2.5):
        line = resample(image, all_valid(image), scale)[0][5, :, 1]
        assert (np.diff(line) >= -1e-6).all()


def test_reducing_keeps_the_mean_and_removes_what_it_cannot_show() -> None:
    image = random_image(400, 400)
    out, _, _ = resample(image, all_valid(image), 0.125)
    assert abs(float(out.mean()) - float(image.mean())) < 1e-3
    columns = np.arange(400)
    stripes = (0.5 + 0.4 * np.sin(2 * np.pi * columns / 3.0)).astype(np.float32)
    fine = np.ascontiguousarray(np.broadcast_to(stripes[None, :, None], (400, 400, 3)))
    left = resample(fine, all_valid(fine), 0.25)[0][:, 4:-4]
    assert float(left.std()) < 0.01


def test_enlarging_follows_a_slope_exactly() -> None:
    ramp = np.broadcast_to(np.arange(30, dtype=np.float32)[None, :, None], (30, 30, 3))
    image = np.ascontiguousarray(ramp)
    out = resample(image, all_valid(image), 2.0)[0]
    wanted = (np.arange(60) + 0.5) / 2.0 - 0.5
    assert_allclose(out[10, 4:-4, 0], wanted[4:-4], atol=1e-5)


def test_output_pixels_are_valid_only_where_their_whole_support_was() -> None:
    image, valid = random_image(40, 40), np.ones((40, 40), np.bool_)
    valid[20, 20] = False
    image[20, 20] = 1e6
    for scale in (0.5, 0.8, 2.0, 3.3):
        out, out_valid, record = resample(image, valid, scale)
        assert not out_valid.all()
        assert out[out_valid].max() <= 1.0
        assert out_valid.mean() > 0.9
        assert record.valid_frac_after == pytest.approx(out_valid.mean())


def test_bands_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    image, valid = random_image(60, 50), np.random.default_rng(4).random((60, 50)) > 0.02
    for scale in (0.3, 1.9):
        whole, whole_valid, _ = resample(image, valid, scale)
        with monkeypatch.context() as patch:
            patch.setattr("tilefab.slab.resampling._BAND_PX", 100)
            banded, banded_valid, _ = resample(image, valid, scale)
        assert_array_equal(banded, whole)
        assert_array_equal(banded_valid, whole_valid)


def test_sizes_round_halves_up_and_never_vanish() -> None:
    assert resampled_size(SizePx(5, 3), 0.5) == SizePx(3, 2)
    assert resampled_size(SizePx(1, 1), 0.01) == SizePx(1, 1)
    image = random_image(1, 1)
    assert resample(image, all_valid(image), 0.01)[0].shape == (1, 1, 3)
    assert_allclose(resample(image, all_valid(image), 5.0)[0], np.broadcast_to(image, (5, 5, 3)), rtol=1e-6)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_refuses_scales_that_make_no_sense(scale: float) -> None:
    image = random_image(4, 4)
    with pytest.raises(ValueError, match="scale"):
        resample(image, all_valid(image), scale)


def test_refuses_arrays_that_break_the_conventions() -> None:
    image, valid = random_image(4, 5), np.ones((4, 5), np.bool_)
    for bad_image, bad_valid, words in (
        (image.astype(np.float64), valid, "float64"),
        (image[..., :2], valid, "shape"),
        (image[:0], valid[:0], "at least one pixel"),
        (image[:, ::2], valid[:, ::2], "C-contiguous"),
        (image, valid[:3], "mask has shape"),
        (image, valid.astype(np.uint8), "uint8"),
        (image, np.zeros_like(valid), "no pixel is valid"),
    ):
        with pytest.raises(ValueError, match=words):
            resample(bad_image, bad_valid, 0.5)
