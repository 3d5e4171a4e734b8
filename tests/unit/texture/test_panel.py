"""The quality panel and its gates, on textures made here."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
import pytest
from scipy import ndimage

from tilefab.texture.panel import (
    MAX_REPETITION,
    MAX_SEAMS,
    SHARPNESS_RANGE,
    Panel,
    measure_panel,
    principal_axes,
    repetition_excess,
    seam_excess,
    sharpness_ratio,
)

PERFECT = Panel(
    portilla_simoncelli=0.0,
    radial_psd=0.0,
    bidirectional_de76=0.0,
    gradient=0.0,
    sharpness_ratio=1.0,
    repetition=0.0,
    seams=0.0,
)


def grains(rows, cols, seed):
    """Grains with some finer grit, (rows, cols) lightness."""
    random = np.random.default_rng(seed)
    coarse = ndimage.gaussian_filter(random.normal(size=(rows + 40, cols + 40)), 2.5)[20:-20, 20:-20]
    fine = ndimage.gaussian_filter(random.normal(size=(rows, cols)), 0.7)
    return 50 + 20 * np.tanh(4 * coarse / coarse.std()) + 10 * fine


def stone(rows, cols, seed):
    """The same as CIELAB, redder where it is dark."""
    light = grains(rows, cols, seed)
    return np.stack([light, 20 - 0.2 * light, np.full_like(light, 8.0)], axis=2)


def weave(rows, cols, seed):
    """A near-regular texture of period 14 px."""
    row, col = np.mgrid[:rows, :cols]
    regular = np.sign(np.sin(2 * np.pi * row / 14) * np.sin(2 * np.pi * col / 14))
    return 50 + 20 * regular + np.random.default_rng(seed).normal(0, 2, (rows, cols))


def blocks(exemplar, rows, cols, side, seed):
    """Random pieces of an exemplar laid edge to edge."""
    random = np.random.default_rng(seed)
    image = np.zeros((rows, cols))
    for top in range(0, rows, side):
        for left in range(0, cols, side):
            r, c = random.integers(0, exemplar.shape[0] - side + 1, 2)
            place = image[top : top + side, left : left + side]
            place[...] = exemplar[r : r + side, c : c + side][: place.shape[0], : place.shape[1]]
    return image


def test_same_image_is_perfect():
    exemplar = stone(120, 140, 1)
    panel = measure_panel(exemplar, exemplar.copy())
    assert panel.gates_passed
    assert panel.sharpness_ratio == 1
    assert panel.repetition < 0.05
    assert astuple(replace(panel, sharpness_ratio=0, repetition=0)) == pytest.approx((0,) * 7, abs=1e-5)


def test_fresh_sample_passes_and_noise_is_further_in_every_measure():
    exemplar = stone(128, 128, 2)
    fresh = measure_panel(exemplar, stone(200, 256, 3))
    assert fresh.failed_gates == ()
    noise = np.random.default_rng(4).normal(0, 1, (200, 256, 3)) * exemplar.std(axis=(0, 1)) + exemplar.mean(
        axis=(0, 1)
    )
    worse = measure_panel(exemplar, noise)
    assert worse.failed_gates == ("noise",)
    assert worse.portilla_simoncelli > 3 * fresh.portilla_simoncelli
    assert worse.radial_psd > 3 * fresh.radial_psd
    assert worse.gradient > 3 * fresh.gradient


def test_tiled_copy_pleases_every_measure_and_fails_the_gate():
    exemplar = stone(128, 128, 5)
    fresh = measure_panel(exemplar, stone(256, 256, 6))
    tiled = measure_panel(exemplar, np.tile(exemplar, (2, 2, 1)))
    assert tiled.portilla_simoncelli < fresh.portilla_simoncelli
    assert tiled.bidirectional_de76 < fresh.bidirectional_de76
    assert "repetition" in tiled.failed_gates
    assert "repetition" not in fresh.failed_gates


@pytest.mark.parametrize(("rows", "cols"), [(256, 200), (200, 384), (200, 200)])
def test_repetition_is_seen_at_any_shift_within_reach(rows, cols):
    exemplar = grains(128, 128, 7)
    assert repetition_excess(exemplar, np.tile(exemplar, (3, 3))[:rows, :cols]) > 2 * MAX_REPETITION


def test_repetition_counts_by_its_share():
    exemplar = grains(128, 128, 8)
    image = grains(256, 256, 9)
    image[:, 150:250] = image[:, 20:120]
    # Of the 126 columns that overlap at a shift of 130, 100 are copies; the exemplar's own peak by chance comes off.
    whole = repetition_excess(exemplar, image)
    assert 0.6 < whole < 0.8
    image[:128] = grains(128, 256, 10)
    assert repetition_excess(exemplar, image) == pytest.approx(0.4 * whole / 0.8, abs=0.1)


def test_near_regular_exemplars_may_repeat():
    exemplar = weave(112, 112, 1)
    assert repetition_excess(exemplar, weave(224, 336, 2)) < MAX_REPETITION
    assert repetition_excess(grains(112, 112, 1), weave(224, 336, 2)) > MAX_REPETITION


def test_repetition_has_no_sign_of_contrast_or_brightness():
    exemplar, image = grains(100, 100, 3), np.tile(grains(100, 100, 3), (2, 2))
    value = repetition_excess(exemplar, image)
    assert repetition_excess(100 - exemplar, 100 - 0.5 * image) == pytest.approx(value, abs=1e-3)


@pytest.mark.parametrize("sigma_px", [0.8, 1.0, 2.0])
def test_blur_is_caught(sigma_px):
    exemplar, image = grains(128, 128, 11), grains(200, 200, 12)
    assert SHARPNESS_RANGE[0] < sharpness_ratio(exemplar, image) < SHARPNESS_RANGE[1]
    assert sharpness_ratio(exemplar, ndimage.gaussian_filter(image, sigma_px)) < SHARPNESS_RANGE[0]


def test_added_grain_is_caught():
    exemplar, image = grains(128, 128, 13), grains(200, 200, 14)
    noisy = image + np.random.default_rng(1).normal(0, 10, image.shape)
    assert sharpness_ratio(exemplar, noisy) > SHARPNESS_RANGE[1]


def test_grid_of_straight_edges_is_caught():
    exemplar = grains(160, 160, 15)
    fresh = seam_excess(exemplar, grains(320, 480, 16))
    laid = seam_excess(exemplar, blocks(exemplar, 320, 480, 40, 17))
    assert fresh < MAX_SEAMS / 2
    assert laid > 2 * MAX_SEAMS


def test_one_seam_in_either_direction_is_caught():
    exemplar, image = grains(160, 160, 18), grains(320, 320, 19)
    cut = image.copy()
    cut[:, 130:] = grains(320, 190, 20)
    assert seam_excess(exemplar, cut) > MAX_SEAMS
    assert seam_excess(exemplar, np.ascontiguousarray(cut.T)) == pytest.approx(
        seam_excess(np.ascontiguousarray(exemplar.T), cut), rel=0.5
    )
    assert seam_excess(exemplar, np.ascontiguousarray(cut.T)) > MAX_SEAMS


def test_straight_edges_of_the_exemplar_are_no_seams():
    assert seam_excess(weave(112, 112, 3), weave(224, 336, 4)) < MAX_SEAMS


def test_flat_images_give_finite_numbers():
    flat = np.full((64, 64, 3), 50.0)
    assert measure_panel(flat, flat).gates_passed
    for exemplar, image in ((flat, stone(64, 64, 1)), (stone(64, 64, 1), flat)):
        panel = measure_panel(exemplar, image)
        assert np.isfinite(astuple(panel)).all()
        assert not panel.gates_passed


def test_principal_axes_follow_the_colours():
    lab = stone(64, 64, 2)
    axes, shares = principal_axes(lab)
    assert axes.shape == (3, 1)
    assert axes[0, 0] > 0.9
    assert shares == pytest.approx([1])
    red = np.random.default_rng(1).normal(size=(64, 64, 3)) * [1, 30, 20]
    axes, shares = principal_axes(red)
    assert axes.shape == (3, 2)
    assert abs(axes[1, 0]) > 0.9
    assert shares.sum() == pytest.approx(1)
    assert shares[0] > shares[1]


def test_patterns_of_colour_alone_are_seen():
    lab = np.stack([np.full((128, 128), 60.0), grains(128, 128, 21) - 50, np.zeros((128, 128))], axis=2)
    assert "repetition" in measure_panel(lab, np.tile(lab, (2, 2, 1))).failed_gates


def test_gates_name_what_fails():
    assert PERFECT.gates_passed
    assert replace(PERFECT, repetition=MAX_REPETITION + 0.01).failed_gates == ("repetition",)
    assert replace(PERFECT, seams=MAX_SEAMS + 0.01).failed_gates == ("seams",)
    assert replace(PERFECT, sharpness_ratio=SHARPNESS_RANGE[0] - 0.01).failed_gates == ("blur",)
    assert replace(PERFECT, sharpness_ratio=SHARPNESS_RANGE[1] + 0.01).failed_gates == ("noise",)


def test_float32_images_measure_the_same():
    exemplar, image = stone(64, 64, 3), stone(96, 80, 4)
    single = measure_panel(exemplar.astype(np.float32), image.astype(np.float32))
    assert astuple(single) == pytest.approx(astuple(measure_panel(exemplar, image)), rel=1e-3, abs=1e-3)


def test_misuse_is_refused():
    good = stone(64, 64, 1)
    with pytest.raises(ValueError, match="the panel needs 40 x 40 pixels; exemplar is 20 x 64"):
        measure_panel(good[:20], good)
    with pytest.raises(ValueError, match=r"image must be \(rows, cols, 3\) CIELAB"):
        measure_panel(good, good[:, :, 0])
    with pytest.raises(ValueError, match="image has values that aren't finite"):
        measure_panel(good, np.full((64, 64, 3), np.inf))
