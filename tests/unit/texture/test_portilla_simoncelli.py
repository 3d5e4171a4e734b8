"""Distances of joint wavelet statistics."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tilefab.texture.portilla_simoncelli import (
    ORIENTATIONS,
    _facing,
    _high,
    _low,
    _polar,
    _pyramid,
    portilla_simoncelli_distance,
    scales_that_fit,
)
from tilefab.texture.spectrum import radial_psd_distance


def blobs(rows, cols, seed, *, elongated=1.0, sharp=True):
    """Dark grains on light ground, (rows, cols) lightness."""
    noise = np.random.default_rng(seed).normal(size=(rows + 64, cols + 64))
    smooth = ndimage.gaussian_filter(noise, (2.5, 2.5 * elongated))[32:-32, 32:-32]
    smooth /= smooth.std()
    return 50 + 20 * np.tanh(6 * smooth) if sharp else 50 + 20 * smooth


def phase_noise(plane, seed):
    """Noise with the power spectrum of a plane."""
    random = np.random.default_rng(seed).normal(size=plane.shape)
    tapered = plane - plane.mean()
    phases = np.exp(1j * np.angle(np.fft.fft2(random)))
    return plane.mean() + np.fft.ifft2(np.abs(np.fft.fft2(tapered)) * phases).real


def test_filters_keep_all_energy():
    radius, angle = _polar(64, 48)
    np.testing.assert_allclose(_high(radius, 0.5) ** 2 + _low(radius, 0.5) ** 2, 1)
    towards = [k * np.pi / ORIENTATIONS for k in range(ORIENTATIONS)]
    fans = sum(_facing(angle, t) ** 2 + _facing(angle + np.pi, t) ** 2 for t in towards)
    # An analytic band has twice the amplitude on half of the plane.
    np.testing.assert_allclose(fans, 4)


def test_parts_of_the_pyramid_hold_the_energy_of_the_image():
    plane = np.random.default_rng(1).normal(size=(300, 260))
    bands = _pyramid(plane, 3)
    # Coarser bands have fewer samples but keep their amplitude: mean squares add up.
    energy = np.mean(bands.high_pass**2) + np.mean(bands.low_pass[-1] ** 2)
    energy += sum(np.mean(band.real**2) for scale in bands.oriented for band in scale)
    assert energy == pytest.approx(1, rel=0.02)


def test_parents_are_the_next_scale_at_twice_the_resolution():
    bands = _pyramid(blobs(200, 180, 3), 2)
    for finer, band in zip(bands.parents[0], bands.oriented[1], strict=True):
        # Both crop two coefficients of their own scale from the border.
        np.testing.assert_allclose(finer[2::2, 2::2][: band.shape[0], : band.shape[1]], band, atol=1e-9)


def test_orientations_separate_stripes():
    across = np.broadcast_to(np.sin(np.arange(128) * 2 * np.pi / 5), (128, 128))
    bands = _pyramid(np.ascontiguousarray(across), 1)
    energies = [np.mean(np.abs(band) ** 2) for band in bands.oriented[0]]
    assert np.argmax(energies) == 0
    assert energies[0] > 50 * energies[2]


def test_same_image_has_no_distance():
    plane = blobs(120, 150, 2)
    assert portilla_simoncelli_distance(plane, plane.copy()) == 0


def test_shifted_window_of_one_texture_is_near():
    plane = blobs(400, 400, 4)
    own = portilla_simoncelli_distance(plane[:300, :300], plane[7:307, 11:311])
    assert 0 < own < 0.05


def test_samples_of_one_texture_are_nearer_than_other_textures():
    exemplar = blobs(200, 200, 5)
    fresh = portilla_simoncelli_distance(exemplar, blobs(300, 400, 6))
    others = {
        "turned": np.ascontiguousarray(blobs(400, 300, 6, elongated=3).T),
        "blurred": ndimage.gaussian_filter(blobs(300, 400, 6), 2),
        "soft": blobs(300, 400, 6, sharp=False),
        "noise": np.random.default_rng(7).normal(50, 20, (300, 400)),
    }
    assert fresh < 0.15
    for name, other in others.items():
        assert portilla_simoncelli_distance(exemplar, other) > 2 * fresh, name


def test_direction_matters():
    along = blobs(200, 200, 8, elongated=3)
    fresh = portilla_simoncelli_distance(along, blobs(200, 200, 9, elongated=3))
    assert portilla_simoncelli_distance(along, np.ascontiguousarray(along.T)) > 4 * fresh


def test_phase_noise_has_the_spectrum_and_not_the_statistics():
    exemplar = blobs(256, 256, 10)
    fresh = blobs(256, 256, 11)
    noise = phase_noise(exemplar, 12)
    assert radial_psd_distance(exemplar, noise) < 1.5 * radial_psd_distance(exemplar, fresh)
    assert portilla_simoncelli_distance(exemplar, noise) > 2 * portilla_simoncelli_distance(exemplar, fresh)


def test_light_and_contrast_of_both_scaled_alike_change_nothing():
    exemplar, image = blobs(100, 100, 13), blobs(120, 130, 14)
    value = portilla_simoncelli_distance(exemplar, image)
    assert portilla_simoncelli_distance(2 * exemplar - 30, 2 * image - 30) == pytest.approx(value)
    assert portilla_simoncelli_distance(exemplar, image + 20) > value


def test_flat_exemplar_gives_finite_numbers():
    flat = np.full((64, 64), 40.0)
    assert portilla_simoncelli_distance(flat, flat) == 0
    assert 0 < portilla_simoncelli_distance(flat, blobs(64, 64, 1)) < np.inf
    assert 0 < portilla_simoncelli_distance(blobs(64, 64, 1), flat) < np.inf


@pytest.mark.parametrize(("rows", "cols"), [(40, 40), (41, 47), (40, 200), (85, 61), (213, 97)])
def test_every_size_works(rows, cols):
    value = portilla_simoncelli_distance(blobs(rows, cols, 1), blobs(rows + 13, cols + 5, 2))
    assert 0 < value < 2


def test_scales_follow_the_size():
    assert [scales_that_fit(side) for side in (40, 79, 80, 159, 160, 5000)] == [2, 2, 3, 3, 4, 4]


def test_misuse_is_refused():
    good = blobs(64, 64, 1)
    with pytest.raises(ValueError, match="needs 40 x 40 pixels; image is 39 x 64"):
        portilla_simoncelli_distance(good, good[:39])
    with pytest.raises(ValueError, match=r"exemplar must be \(rows, cols\)"):
        portilla_simoncelli_distance(good[:, :, None], good)
    with pytest.raises(ValueError, match="aren't finite"):
        portilla_simoncelli_distance(good, np.where(good > 60, np.nan, good))
