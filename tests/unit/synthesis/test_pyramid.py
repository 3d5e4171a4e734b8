"""Scales of an exemplar: nothing is lost but detail, and no hole gets into a patch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX
from tilefab.synthesis.pyramid import COARSEST_PX, SCALE, STEPS_PER_UNIT, features, resized, scaled_size, scales
from tilefab.types import SizePx

Stone = Callable[[int, int, int], NDArray[np.float32]]


def everywhere(image: NDArray[np.floating]) -> NDArray[np.bool_]:
    return np.ones(image.shape[:2], dtype=bool)


@pytest.mark.parametrize("size", [SizePx(41, 52), SizePx(32, 40), SizePx(11, 13), SizePx(40, 20)])
def test_one_colour_stays_the_same(size: SizePx) -> None:
    image = np.full((41, 52, 3), [50.125, -7.5, 0.0])
    small = resized(image, size)
    assert small.shape == (size.rows, size.cols, 3)
    assert_array_equal(small, np.full(small.shape, [50.125, -7.5, 0.0]))


def test_a_size_of_its_own_changes_nothing() -> None:
    image = np.random.default_rng(1).integers(0, 800, (23, 31, 4)) / 8
    assert_array_equal(resized(image, SizePx(23, 31)), image)


@pytest.mark.parametrize("size", [SizePx(77, 92), SizePx(46, 51), SizePx(20, 60)])
def test_the_mean_stays(size: SizePx) -> None:
    image = np.random.default_rng(2).uniform(0, 100, (100, 120, 3))
    small = resized(image, size)
    assert_allclose(small.mean(axis=(0, 1)), image.mean(axis=(0, 1)), atol=0.4)
    # Noise that the coarser image cannot hold is averaged out, not folded back.
    assert small.std() < image.std() * np.sqrt(1.6 * size.rows * size.cols / 12_000)


def test_a_slope_keeps_its_places() -> None:
    image = np.arange(120.0)[None, :, None] * np.ones((30, 1, 1))
    small = resized(image, SizePx(30, 60))
    # The middle of a pixel lies between those of the two it stands for; the ends are mirrored.
    assert_allclose(small[:, 3:-3, 0], 2 * np.arange(3, 57) + 0.5 + np.zeros((30, 1)), atol=0.01)


def test_turned_first_or_last_is_the_same() -> None:
    image = np.random.default_rng(3).uniform(0, 100, (37, 50, 2))
    small = resized(image, SizePx(28, 38))
    assert_allclose(resized(image[::-1, ::-1], SizePx(28, 38))[::-1, ::-1], small, atol=1e-3)
    assert_allclose(resized(image.transpose(1, 0, 2), SizePx(38, 28)).transpose(1, 0, 2), small, atol=1e-3)
    assert_array_equal(small * 2**16, np.rint(small * 2**16))


def test_scales_are_each_a_little_coarser(stone: Stone) -> None:
    lab = stone(90, 110, 1)
    found = scales(features(lab, None, 0.0), everywhere(lab), None, None)
    assert_allclose([scale.factor for scale in found], SCALE ** -np.arange(len(found)))
    for scale in found:
        shape = (round(90 * scale.factor), round(110 * scale.factor))
        assert scale.image.shape == (*shape, CHANNELS)
        assert scale.image.dtype == np.int16
        assert scale.valid.shape == scale.allowed.shape == shape
        assert scale.weights is None
        assert scale.valid.all()
        assert scale.allowed.sum() == (shape[0] - PATCH_PX + 1) * (shape[1] - PATCH_PX + 1)
    assert min(found[-1].valid.shape) >= COARSEST_PX > min(found[-1].valid.shape) / SCALE
    assert_array_equal(found[0].image[..., :3], np.rint(lab * STEPS_PER_UNIT))
    assert not found[0].image[..., 3].any()


def test_small_exemplars_have_one_scale(stone: Stone) -> None:
    for side in (PATCH_PX, 16, 44):
        lab = stone(side, side + 3, 1)
        assert len(scales(features(lab, None, 0.0), everywhere(lab), None, None)) == 1
    lab = stone(PATCH_PX - 1, 50, 1)
    with pytest.raises(ValueError, match="no usable square of 10 x 10"):
        scales(features(lab, None, 0.0), everywhere(lab), None, None)


def test_the_coarsest_scale_sees_the_largest_feature(stone: Stone) -> None:
    lab = stone(200, 180, 1)
    counts = []
    for feature_px in (1, 12, 20, 40, 60, 1000):
        found = scales(features(lab, None, 0.0), everywhere(lab), None, feature_px)
        counts.append(len(found))
        if len(found) > 1 and feature_px <= 60:
            # A patch there is larger than the thing, and would not be one scale finer.
            assert feature_px * found[-1].factor <= PATCH_PX
            assert feature_px * found[-2].factor > 0.75 * PATCH_PX
    assert counts == sorted(counts)
    assert counts[0] == 1
    assert len(set(counts)) >= 5


def test_no_allowed_patch_shows_a_hole(stone: Stone) -> None:
    lab = stone(100, 120, 2)
    valid = everywhere(lab)
    valid[30:36, 50:53] = valid[80, 100] = valid[0, 0] = False
    holes = 0
    for scale in scales(features(lab, None, 0.0), valid, None, None):
        rows, cols = scale.valid.shape
        for row, col in np.ndindex(rows, cols):
            whole = row + PATCH_PX <= rows and col + PATCH_PX <= cols
            whole = whole and bool(scale.valid[row : row + PATCH_PX, col : col + PATCH_PX].all())
            assert scale.allowed[row, col] == whole
        # What is valid at a coarse scale stands for valid pixels only.
        for row, col in np.argwhere(scale.valid):
            first, last = row * 100 // rows, -(-(row + 1) * 100 // rows)
            left, right = col * 120 // cols, -(-(col + 1) * 120 // cols)
            assert valid[first:last, left:right].all()
        holes += int((~scale.valid).sum())
    assert holes > 4 * 20


def test_colours_under_a_hole_reach_no_coarse_pixel_that_is_kept(stone: Stone) -> None:
    lab = stone(100, 120, 3)
    valid = everywhere(lab)
    valid[40:60, 40:60] = False
    other = lab.copy()
    other[45:55, 45:55] += 30
    one, two = (scales(features(image, None, 0.0), valid, None, None) for image in (lab, other))
    for first, second in zip(one, two, strict=True):
        changed = np.abs(first.image[first.valid].astype(int) - second.image[second.valid])
        assert changed.max() <= STEPS_PER_UNIT  # the kernel's tails


def test_marks_reach_the_coarser_scales(stone: Stone) -> None:
    lab = stone(100, 120, 2)
    weights = np.zeros((100, 120), dtype=np.uint8)
    weights[33, 77], weights[60:70, 20:30] = 200, 90
    for scale in scales(features(lab, None, 0.0), everywhere(lab), weights, None):
        assert scale.weights is not None
        assert scale.weights.shape == scale.valid.shape
        assert scale.weights[int(33.5 * scale.factor), int(77.5 * scale.factor)] == 200
        assert scale.weights[int(65 * scale.factor), int(25 * scale.factor)] == 90
        assert 0 < (scale.weights > 0).mean() < 0.03


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_few_channels_are_taken_as_they_are(channels: int) -> None:
    exemplar = np.random.default_rng(4).uniform(-90, 200, (20, 30, channels)).astype(np.float32)
    found = features(exemplar, None, 1.0)
    assert found.shape == (20, 30, CHANNELS)
    assert_array_equal(found[..., :channels], exemplar)
    assert not found[..., channels:].any()


def test_guidance_is_the_fourth() -> None:
    exemplar = np.zeros((20, 30, 1), dtype=np.float32)
    guidance = np.random.default_rng(5).uniform(0, 50, (20, 30)).astype(np.float32)
    found = features(exemplar, guidance, 3.0)
    assert_allclose(found[..., 3], guidance * np.sqrt(3.0), rtol=1e-6)
    assert not found[..., :3].any()


def test_of_many_channels_the_principal_ones_are_compared() -> None:
    random = np.random.default_rng(6)
    hidden = random.normal(size=(40, 50, 3)) * [20.0, 9.0, 4.0]
    axes, _ = np.linalg.qr(random.normal(size=(5, 5)))
    exemplar = (50 + hidden @ axes[:3]).astype(np.float32)
    found = features(exemplar, None, 0.0)[..., :3].reshape(-1, 3)
    flat = exemplar.reshape(-1, 5).astype(np.float64)
    # All differences are kept if three directions hold all there is.
    pairs = random.integers(0, len(flat), (2, 500))
    expected = np.linalg.norm(flat[pairs[0]] - flat[pairs[1]], axis=1)
    assert_allclose(np.linalg.norm(found[pairs[0]] - found[pairs[1]], axis=1), expected, rtol=1e-3, atol=1e-3)
    spreads = found.std(axis=0)
    assert spreads[0] > spreads[1] > spreads[2] > 0
    # A little of a fourth direction is what gets lost.
    noisy = exemplar + (random.normal(size=(40, 50, 1)) * 0.5 * axes[3]).astype(np.float32)
    assert_allclose(features(noisy, None, 0.0)[..., :3].std(axis=(0, 1)), spreads, rtol=0.01)


def test_sums_over_a_patch_fit_into_31_bits() -> None:
    extreme = np.where(np.indices((12, 12)).sum(axis=0)[..., None] % 2, 1e9, -1e9) * np.ones(3)
    guidance = extreme[..., 0].astype(np.float32)
    steps = scales(features(extreme.astype(np.float32), guidance, 3.0), np.ones((12, 12), bool), None, None)[0].image
    span = int(steps.max()) - int(steps.min())
    assert CHANNELS * PATCH_PX * span**2 < 2**31


def test_sizes_of_results_are_scaled() -> None:
    assert scaled_size(SizePx(100, 333), 1.0) == SizePx(100, 333)
    assert scaled_size(SizePx(100, 333), SCALE**-2) == SizePx(59, 197)
    assert scaled_size(SizePx(30, 333), SCALE**-4) == SizePx(2 * PATCH_PX, 117)
    assert scaled_size(SizePx(3, 4), 1.0) == SizePx(2 * PATCH_PX, 2 * PATCH_PX)
