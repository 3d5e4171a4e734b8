"""Weights that travel beside a slab: where it goes, they go, and no stroke gets lost."""

from __future__ import annotations

import doctest

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tilefab.slab import weights as module
from tilefab.slab.atlas import build_atlas
from tilefab.slab.kernels import warp_weights, warp_weights_plain
from tilefab.slab.resampling import resampled_size
from tilefab.slab.squaring import SquaringOptions, square_slab
from tilefab.slab.weights import join_weights, resample_weights, square_weights
from tilefab.types import SizePx


def on_a_bed(angle_deg: float) -> tuple[np.ndarray, np.ndarray]:
    """Scan of 300 x 360 px of a mottled slab on a dark bed, a bright disc on it, and weights that mark the disc."""
    row, col = np.indices((300, 360)) + 0.5
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    x, y = cos * (col - 180) + sin * (row - 150), cos * (row - 150) - sin * (col - 180)
    inside = np.clip(np.minimum(140 - np.abs(x), 110 - np.abs(y)) + 0.5, 0, 1)
    disc = np.clip(12 - np.hypot(x - 40, y + 30) + 0.5, 0, 1)
    light = 0.3 + 0.02 * np.random.default_rng(0).standard_normal(row.shape) + 0.4 * disc
    image = (0.01 + inside * (light - 0.01))[..., None] * np.array([0.96, 1.0, 0.82])
    return image.astype(np.float32), np.rint(255 * disc).astype(np.uint8)


@pytest.mark.parametrize("angle_deg", [0.0, 2.0])
@pytest.mark.parametrize("trim_px", [0, 7])
def test_weights_stay_on_what_they_mark(angle_deg: float, trim_px: int) -> None:
    image, weights = on_a_bed(angle_deg)
    valid = np.ones(weights.shape, np.bool_)
    squared, _, record = square_slab(image, valid, SquaringOptions(trim_px=trim_px))
    assert record.squared
    held = square_weights(weights, record)
    assert held.shape == squared.shape[:2]
    assert held.flags.c_contiguous
    disc = np.clip((squared[..., 1] - 0.3) / 0.4, 0, 1)
    assert np.abs(held / 255 - disc)[disc > 0.5].mean() < 0.1
    assert held[disc < 0.1].max() < 128
    assert_array_equal(square_weights(weights, record, threads=3), held)


def test_weights_of_a_slab_not_squared_are_trimmed_with_it() -> None:
    weights = np.random.default_rng(1).integers(0, 256, (40, 50)).astype(np.uint8)
    image = np.random.default_rng(2).random((40, 50, 3), np.float32)
    _, _, record = square_slab(image, np.ones((40, 50), np.bool_), SquaringOptions(trim_px=3))
    assert not record.squared
    assert_array_equal(square_weights(weights, record), weights[3:-3, 3:-3])
    with pytest.raises(ValueError, match="wanted uint8"):
        square_weights(weights[1:], record)


def test_the_kernel_does_what_its_plain_twin_does() -> None:
    weights = np.random.default_rng(3).integers(0, 256, (20, 25)).astype(np.uint8)
    matrix = np.array([[0.9, 0.1, 1.3], [-0.12, 1.05, 2.0], [1e-3, -5e-4, 1.0]])
    out = np.empty((22, 26), np.uint8)
    warp_weights(weights, matrix, 0, 0, out)
    assert_array_equal(out, warp_weights_plain(weights, matrix, 22, 26))
    band = np.empty((5, 10), np.uint8)
    warp_weights(weights, matrix, 9, 4, band)
    assert_array_equal(band, out[9:14, 4:14])
    same = np.empty_like(weights)
    warp_weights(weights, np.eye(3), 0, 0, same)
    assert_array_equal(same, weights)


@given(st.integers(1, 40), st.integers(1, 40), st.floats(0.05, 4.0), st.integers(0, 99))
def test_a_pixel_weighs_as_much_as_the_heaviest_that_it_overlaps(rows: int, cols: int, scale: float, seed: int) -> None:
    weights = np.random.default_rng(seed).integers(0, 256, (rows, cols)).astype(np.uint8)
    out = resample_weights(weights, scale)
    size = resampled_size(SizePx(rows, cols), scale)
    assert out.shape == (size.rows, size.cols)
    for row, col in ((0, 0), (size.rows // 2, size.cols // 3), (size.rows - 1, size.cols - 1)):
        above, below = (min(int(np.floor(k / scale + 1e-6)), rows - 1) for k in (row, row + 1 - 2e-6 * scale))
        left, right = (min(int(np.floor(k / scale + 1e-6)), cols - 1) for k in (col, col + 1 - 2e-6 * scale))
        assert out[row, col] == weights[above : below + 1, left : right + 1].max()


@pytest.mark.parametrize("scale", [0.07, 0.31, 0.5, 0.9, 1.0, 1.7, 3.0])
def test_a_thin_stroke_survives(scale: float) -> None:
    weights = np.zeros((300, 200), np.uint8)
    weights[:, 83] = 200
    out = resample_weights(weights, scale)
    assert (out.max(axis=1) == 200).all()
    assert set(np.unique(out)) == {0, 200}


def test_weights_are_joined_as_their_slabs_are() -> None:
    sizes = [(30, 20), (25, 40), (10, 12)]
    labs = [np.full((*size, 3), 50, np.float32) for size in sizes]
    valids = [np.ones(size, np.bool_) for size in sizes]
    _, _, record = build_atlas(labs, valids)
    own = [np.full(sizes[0], 7, np.uint8), None, np.full(sizes[2], 9, np.uint8)]
    joined = join_weights(own, record)
    assert joined.shape == (record.size.rows, record.size.cols)
    for place, value in zip(record.placements, (7, 0, 9), strict=True):
        part = joined[place.row : place.row + place.rows, place.col : place.col + place.cols]
        assert (part == value).all()
    assert np.count_nonzero(joined) == 30 * 20 + 10 * 12
    with pytest.raises(ValueError, match="2 weights for 3 slabs"):
        join_weights(own[:2], record)
    with pytest.raises(ValueError, match="wanted uint8"):
        join_weights([own[0], own[2], own[2]], record)


def test_examples() -> None:
    assert doctest.testmod(module).failed == 0
