"""Pictures made smaller."""

from __future__ import annotations

import numpy as np
import pytest

from tilefab.colour import reduce_srgb
from tilefab.pipeline.wall import box_shrink


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


def test_boxes_of_whole_rows_are_means() -> None:
    image = np.random.default_rng(2).random((24, 5, 3), dtype=np.float32)
    expected = image[4:16].reshape(4, 3, 5, 3).mean(axis=1)
    np.testing.assert_allclose(box_shrink(image, 4.0, 3.0, 4), expected, rtol=1e-6)


@pytest.mark.parametrize("begin", [0.0, 0.3, 7.9])
@pytest.mark.parametrize("step", [1.0, 1.25, 1.9999, 2.5])
def test_boxes_across_rows_are_integrals(begin: float, step: float) -> None:
    image = np.random.default_rng(3).random((40, 2, 1), dtype=np.float32)
    total = np.concatenate([np.zeros((1, 2, 1)), image.astype(np.float64).cumsum(axis=0)])

    def until(place: float) -> np.ndarray:
        low = int(np.floor(place))
        return total[low] + (place - low) * image[low].astype(np.float64)

    expected = [(until(begin + (k + 1) * step) - until(begin + k * step)) / step for k in range(11)]
    np.testing.assert_allclose(box_shrink(image, begin, step, 11), expected, rtol=1e-5)


def test_a_flat_image_stays_flat() -> None:
    flat = np.full((30, 3, 3), 7.0, dtype=np.float32)
    np.testing.assert_allclose(box_shrink(flat, 1.7, 1.3, 20), 7.0, rtol=1e-6)
