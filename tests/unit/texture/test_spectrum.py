"""Radial power spectra and their distance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tilefab.texture.spectrum import radial_psd, radial_psd_distance


def noise(rows, cols, seed, sigma_px=0.0):
    values = np.random.default_rng(seed).normal(size=(rows + 40, cols + 40))
    return 50 + 20 * ndimage.gaussian_filter(values, sigma_px)[20:-20, 20:-20]


def test_density_of_white_noise_is_its_variance_whatever_the_window():
    plane = np.random.default_rng(1).normal(0, 3, (400, 500))
    for window in (64, 128, 200):
        frequency, density = radial_psd(plane, window, window)
        np.testing.assert_allclose(density[frequency > 6 / window], 9, rtol=0.2)
        np.testing.assert_allclose(density[-4:], 9, rtol=0.03)


def test_a_wave_stands_in_its_bin_at_any_window():
    plane = np.broadcast_to(10 * np.sin(2 * np.pi * 0.11 * np.arange(500)), (400, 500))
    for rows, cols in ((100, 100), (150, 90), (200, 200)):
        frequency, density = radial_psd(plane, rows, cols)
        assert frequency[np.argmax(density)] == pytest.approx(0.11, rel=0.1)


def test_same_image_has_no_distance():
    plane = noise(90, 110, 2, 1)
    assert radial_psd_distance(plane, plane.copy()) == 0


def test_contrast_counts_in_logarithms():
    plane = noise(128, 128, 3)
    doubled = 2 * (plane - plane.mean()) + plane.mean()
    assert radial_psd_distance(plane, doubled) == pytest.approx(np.log(4), rel=1e-3)


def test_size_hardly_matters_and_scale_does():
    exemplar = noise(200, 200, 4, 2)
    fresh = radial_psd_distance(exemplar, noise(300, 640, 5, 2))
    assert fresh < 0.25
    assert radial_psd_distance(exemplar, noise(300, 640, 5, 2.5)) > 3 * fresh
    assert radial_psd_distance(exemplar, noise(300, 640, 5, 0)) > 10 * fresh


def test_shift_and_brightness_hardly_matter():
    plane = noise(260, 260, 6, 1)
    assert radial_psd_distance(plane[:250, :250], plane[9:259, 5:255] + 15) < 0.1


def test_windows_reach_every_border():
    plane = np.full((100, 130), 50.0)
    plane[85:95, 115:125] = 90
    assert radial_psd(plane, 64, 64)[1].max() > 1


def test_image_smaller_than_the_exemplar_is_measured():
    assert radial_psd_distance(noise(200, 200, 7, 1), noise(70, 300, 8, 1)) < 0.35


def test_flat_images_give_finite_numbers():
    flat = np.full((50, 50), 30.0)
    assert radial_psd_distance(flat, flat) == 0
    assert 0 < radial_psd_distance(flat, noise(60, 60, 1)) < 50


@pytest.mark.parametrize("side", [16, 17, 23, 31])
def test_small_sizes_work(side):
    assert np.isfinite(radial_psd_distance(noise(side, side, 1), noise(side + 9, side, 2)))


def test_misuse_is_refused():
    good = noise(40, 40, 1)
    with pytest.raises(ValueError, match="needs 16 x 16 pixels; exemplar is 15 x 40"):
        radial_psd_distance(good[:15], good)
    with pytest.raises(ValueError, match="image must be"):
        radial_psd_distance(good, good[:, :, None])
    with pytest.raises(ValueError, match="image has values that aren't finite"):
        radial_psd_distance(good, np.full((40, 40), np.inf))
