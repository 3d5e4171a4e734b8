"""Distances between distributions of gradient magnitude."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import wasserstein_distance

from tilefab.texture.gradients import gradient_distance, gradient_magnitude_de76


def lab_noise(rows, cols, seed, sigma_px=1.0):
    values = np.random.default_rng(seed).normal(size=(rows + 20, cols + 20, 3))
    return 50 + 20 * ndimage.gaussian_filter(values, (sigma_px, sigma_px, 0))[10:-10, 10:-10]


def test_gradient_of_a_ramp():
    rows, cols = np.mgrid[:9, :12].astype(float)
    lab = np.stack([3 * rows, 4 * cols, 12 * cols], axis=2)
    magnitude = gradient_magnitude_de76(lab)
    assert magnitude.shape == (8, 11)
    np.testing.assert_allclose(magnitude, 13)


def test_same_and_shuffled_images_have_no_distance():
    lab = lab_noise(60, 70, 1)
    assert gradient_distance(lab, lab.copy()) == 0
    assert gradient_distance(lab, lab[::-1, ::-1]) == pytest.approx(0, abs=0.01)


def test_contrast_counts_relative_to_the_exemplar():
    lab = lab_noise(60, 70, 2)
    assert gradient_distance(lab, 1.3 * lab) == pytest.approx(0.3, abs=1e-3)


def test_equals_the_earth_movers_distance():
    exemplar, image = lab_noise(120, 120, 3), lab_noise(150, 90, 4, 1.5)
    wanted, found = gradient_magnitude_de76(exemplar).ravel(), gradient_magnitude_de76(image).ravel()
    expected = wasserstein_distance(wanted, found) / wanted.mean()
    assert gradient_distance(exemplar, image) == pytest.approx(expected, rel=0.01)


def test_samples_of_one_texture_are_nearer_than_blurred_ones():
    exemplar, image = lab_noise(120, 120, 5), lab_noise(200, 240, 6)
    fresh = gradient_distance(exemplar, image)
    assert fresh < 0.03
    assert gradient_distance(exemplar, ndimage.gaussian_filter(image, (0.7, 0.7, 0))) > 5 * fresh


def test_flat_exemplar_gives_finite_numbers():
    flat = np.full((20, 20, 3), 50.0)
    assert gradient_distance(flat, flat) == 0
    assert 0 < gradient_distance(flat, lab_noise(20, 20, 1)) < 1000


def test_misuse_is_refused():
    good = lab_noise(20, 20, 1)
    with pytest.raises(ValueError, match="needs 8 x 8 pixels; image is 7 x 20"):
        gradient_distance(good, good[:7])
    with pytest.raises(ValueError, match=r"image must be \(rows, cols, 3\)"):
        gradient_distance(good, good[:, :, :2])
    with pytest.raises(ValueError, match="exemplar has values that aren't finite"):
        gradient_distance(np.full((20, 20, 3), np.nan), good)
