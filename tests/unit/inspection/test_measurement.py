"""Tests of colours measured region by region."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tilefab.colour import delta_e_2000, delta_e_cmc, lab_from_xyz, xyz_from_lab
from tilefab.inspection.measurement import colour_figures, difference_maps, region_colours
from tilefab.inspection.measurement_kernels import pair_sums, pair_sums_plain, region_sums, region_sums_plain

PX_PER_MM = 4.0


def patches(labs, patch_px):
    """XYZ image of square patches, Lab (A, B, 3)."""
    xyz = xyz_from_lab(np.asarray(labs, dtype=float)).astype(np.float32)
    return np.ascontiguousarray(np.repeat(np.repeat(xyz, patch_px, axis=0), patch_px, axis=1))


def some_labs(rows, cols, seed=1):
    random = np.random.default_rng(seed)
    return np.stack([random.uniform(low, high, (rows, cols)) for low, high in ((25, 90), (-15, 30), (-10, 40))], -1)


def measured(predicted, fired, inks=None, valid=None, **kwargs):
    shape = predicted.shape[:2]
    inks = np.zeros((*shape, 3), dtype=np.float32) if inks is None else inks
    valid = np.ones(shape, dtype=bool) if valid is None else valid
    return region_colours(predicted, fired, inks, valid, PX_PER_MM, **{"edge_mm": 0.0, "region_mm": 5.0, **kwargs})


def test_even_regions_give_their_colours_and_inks() -> None:
    predicted, fired = some_labs(6, 8), some_labs(6, 8, seed=2)
    inks = np.random.default_rng(3).random((6, 8, 3)).astype(np.float32)
    regions = measured(patches(predicted, 20), patches(fired, 20), np.repeat(np.repeat(inks, 20, 0), 20, 1))
    assert regions.grid == (6, 8)
    assert len(regions) == 48
    np.testing.assert_allclose(regions.predicted_lab, predicted.reshape(-1, 3), atol=1e-3)
    np.testing.assert_allclose(regions.fired_lab, fired.reshape(-1, 3), atol=1e-3)
    np.testing.assert_allclose(regions.ink_frac, inks.reshape(-1, 3), atol=1e-6)
    np.testing.assert_allclose(regions.at_mm[:2], [[2.5, 2.5], [7.5, 2.5]])
    np.testing.assert_allclose(regions.noise_lab, 0.1, atol=1e-3)
    assert (regions.share == 1.0).all()


def test_means_are_of_light_not_of_lab() -> None:
    predicted = patches(np.full((1, 1, 3), [50.0, 0, 0]), 20)
    fired = predicted.copy()
    fired[::2] = xyz_from_lab([90.0, 0, 0])
    fired[1::2] = xyz_from_lab([10.0, 0, 0])
    regions = measured(predicted, fired)
    mean = (xyz_from_lab([90.0, 0, 0]) + xyz_from_lab([10.0, 0, 0])) / 2
    np.testing.assert_allclose(regions.fired_lab[0], lab_from_xyz(mean), atol=1e-3)


def test_edges_and_what_is_hidden_are_left_out() -> None:
    labs = some_labs(6, 6)
    predicted = patches(labs, 20)
    fired = predicted.copy()
    fired[:3] = fired[:, -3:] = 0.03
    fired[40:60, 40:55] = 0.9
    valid = np.ones(predicted.shape[:2], dtype=bool)
    valid[40:60, 40:55] = False
    regions = measured(predicted, fired, valid=valid, edge_mm=0.75)
    np.testing.assert_allclose(regions.fired_lab, regions.predicted_lab, atol=1e-3)
    assert len(regions) == 35
    assert [2, 2] not in regions.place.tolist()
    assert ((regions.share >= 0.5) & (regions.share <= 1.0)).all()


def test_noise_is_of_the_size_of_the_error() -> None:
    random = np.random.default_rng(5)
    predicted = patches(np.full((20, 20, 3), [60.0, 5, 10]), 20)
    scatter = 0.05 * random.standard_normal(predicted.shape).astype(np.float32)
    regions = measured(predicted, predicted * (1 + scatter))
    error = np.sqrt(((regions.fired_lab - regions.predicted_lab) ** 2).mean())
    # It allows for neighbours that are alike, which these are not.
    own = np.sqrt(regions.noise_lab**2 - 0.1**2)
    assert math.sqrt(6.0) * error == pytest.approx(float(own.mean()), rel=0.1)


def test_uneven_regions_count_as_noisier() -> None:
    even = patches(np.full((4, 4, 3), [60.0, 0, 0]), 20)
    uneven = even.copy()
    uneven[::2] *= 1.5
    uneven[1::2] *= 0.5
    one, other = measured(even, even), measured(uneven, uneven)
    # A half of the light is a big step: mean of the cube roots against cube root of the mean.
    y = float(even[0, 0, 1])
    bend = 116 * abs((np.cbrt(1.5 * y) + np.cbrt(0.5 * y)) / 2 - np.cbrt(y))
    assert other.noise_lab[0] == pytest.approx(bend / math.sqrt(3), rel=0.35)
    assert other.noise_lab[0] > 8 * one.noise_lab[0]


def test_regions_cover_a_face_that_they_do_not_divide() -> None:
    predicted = patches(some_labs(1, 1), 103)
    regions = measured(predicted, predicted, region_mm=2.5)
    assert regions.grid == (10, 10)
    assert regions.at_mm.min() > 1.2
    assert regions.at_mm.max() < 103 / PX_PER_MM - 1.2


def test_figures_are_those_of_the_formulas() -> None:
    predicted, fired = some_labs(5, 5), some_labs(5, 5, seed=9)
    figures = colour_figures(measured(patches(predicted, 20), patches(fired, 20)))
    assert figures is not None
    one, other = predicted.reshape(-1, 3), fired.reshape(-1, 3)
    delta_e, cmc = delta_e_2000(one, other), delta_e_cmc(one, other)
    worst = int(np.argmax(delta_e))
    assert figures.delta_e_mean == pytest.approx(delta_e.mean(), abs=1e-3)
    assert figures.delta_e_p95 == pytest.approx(np.percentile(delta_e, 95), abs=1e-3)
    assert figures.delta_e_worst == pytest.approx(delta_e.max(), abs=1e-3)
    assert figures.worst_at_mm == pytest.approx((5 * (worst % 5) + 2.5, 5 * (worst // 5) + 2.5))
    assert figures.cmc_mean == pytest.approx(cmc.mean(), abs=1e-3)
    assert figures.cmc_p95 == pytest.approx(np.percentile(cmc, 95), abs=1e-3)
    assert figures.lightness == pytest.approx((other - one)[:, 0].mean(), abs=1e-3)
    assert figures.fired_lab == pytest.approx(tuple(other.mean(axis=0)), abs=1e-3)
    assert figures.predicted_lab == pytest.approx(tuple(one.mean(axis=0)), abs=1e-3)


@pytest.mark.parametrize("turn_deg", [4.0, -4.0, 200.0])
def test_hue_is_signed_and_completes_the_difference(turn_deg: float) -> None:
    hue = math.radians(170.0)
    turned = hue + math.radians(turn_deg)
    one = [[[55.0, 20 * math.cos(hue), 20 * math.sin(hue)]]]
    other = [[[58.0, 23 * math.cos(turned), 23 * math.sin(turned)]]]
    figures = colour_figures(measured(patches(one, 20), patches(other, 20)))
    assert figures is not None
    assert figures.chroma == pytest.approx(3.0, abs=1e-3)
    assert figures.lightness == pytest.approx(3.0, abs=1e-3)
    assert figures.hue == pytest.approx(2 * math.sqrt(20 * 23) * math.sin(math.radians(turn_deg) / 2), abs=2e-3) or (
        turn_deg == 200.0 and figures.hue < 0
    )
    total = np.sum((np.array(other) - np.array(one)) ** 2)
    assert figures.lightness**2 + figures.chroma**2 + figures.hue**2 == pytest.approx(total, rel=1e-3)


def test_no_region_no_figures() -> None:
    predicted = patches(some_labs(2, 2), 20)
    regions = measured(predicted, predicted, valid=np.zeros((40, 40), dtype=bool))
    assert len(regions) == 0
    assert regions.ink_frac.shape == (0, 3)
    assert colour_figures(regions) is None
    assert np.isnan(difference_maps(regions).delta_e).all()


def test_maps_lie_where_the_regions_are() -> None:
    predicted, fired = some_labs(4, 3), some_labs(4, 3, seed=4)
    valid = np.ones((80, 60), dtype=bool)
    valid[20:40, :20] = False
    regions = measured(patches(predicted, 20), patches(fired, 20), valid=valid)
    maps = difference_maps(regions, lightness=1.0)
    wanted = delta_e_2000(predicted, fired)
    assert np.isnan(maps.delta_e[1, 0])
    wanted[1, 0] = np.nan
    np.testing.assert_allclose(maps.delta_e, wanted, atol=1e-3)
    np.testing.assert_allclose(maps.cmc[3, 2], delta_e_cmc(predicted[3, 2], fired[3, 2], lightness=1.0), atol=1e-3)
    np.testing.assert_allclose(maps.lab[3, 2], fired[3, 2] - predicted[3, 2], atol=1e-3)


def test_misuse_is_refused() -> None:
    xyz = patches(some_labs(2, 2), 20)
    with pytest.raises(ValueError, match="inks must be float32"):
        measured(xyz, xyz, np.zeros((40, 40), dtype=np.float32))
    with pytest.raises(ValueError, match="more than 0"):
        measured(xyz, xyz, region_mm=0.0)
    with pytest.raises(ValueError, match="shapes differ"):
        measured(xyz, xyz[:-1])


def test_kernels_are_their_plain_twins() -> None:
    random = np.random.default_rng(7)
    one, other = (random.random((50, 40, 3), dtype=np.float32) for _ in range(2))
    inks = random.random((50, 40, 5), dtype=np.float32)
    valid = random.random((50, 40)) > 0.2
    row_cuts, col_cuts = np.array([0, 13, 30, 50]), np.array([0, 7, 22, 31, 40])
    sums, ink_sums = np.empty((3, 4, 16)), np.empty((3, 4, 5))
    pair_sums(one, other, valid, row_cuts, col_cuts, sums)
    region_sums(inks, valid, row_cuts, col_cuts, ink_sums)
    np.testing.assert_allclose(sums, pair_sums_plain(one, other, valid, row_cuts, col_cuts), rtol=1e-10)
    np.testing.assert_allclose(ink_sums, region_sums_plain(inks, valid, row_cuts, col_cuts), rtol=1e-10)
