"""Tests of taking the light's unevenness out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tilefab.inspection.light import even_light, worn

SHAPE = (240, 300)


def stone_xyz(seed, shape=SHAPE, slope=0.0):
    """XYZ of a made-up stone of two colours, blended; it may get brighter from left to right."""
    random = np.random.default_rng(seed)
    share = ndimage.gaussian_filter(random.standard_normal(shape), 4)
    share = np.clip(0.5 + 0.25 * share / share.std() + slope * np.linspace(-0.5, 0.5, shape[1]), 0, 1)[..., np.newaxis]
    return (share * [0.55, 0.57, 0.4] + (1 - share) * [0.2, 0.19, 0.1]).astype(np.float32)


def light_on(shape, size, direction=0.7):
    y, x = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    light = 1 + size * (np.cos(direction) * x + np.sin(direction) * y - 0.25 * (x * x + y * y))
    return (light / light.mean()).astype(np.float32)


def drifted(xyz):
    """As a firing changes colours: by channel, and dark ones otherwise than bright ones."""
    return (xyz ** np.array([1.03, 1.02, 0.98]) * np.array([1.05, 1.0, 0.94])).astype(np.float32)


@pytest.mark.parametrize("slope", [0.0, 0.5], ids=["even stone", "stone with a slope of its own"])
@pytest.mark.parametrize("size", [0.0, 0.05, 0.15])
def test_light_is_taken_out_and_drift_is_kept(size: float, slope: float) -> None:
    random = np.random.default_rng(3)
    predicted = stone_xyz(1, slope=slope)
    wanted = drifted(predicted)
    light = light_on(SHAPE, size)
    fired = wanted * light[..., np.newaxis] * (1 + 0.02 * random.standard_normal((*SHAPE, 3)))
    evened, fit = even_light(predicted, fired.astype(np.float32), np.ones(SHAPE, dtype=bool))
    ratio = ndimage.uniform_filter(evened / wanted, (15, 15, 0))
    np.testing.assert_allclose(ratio, 1.0, atol=0.012)
    assert abs(float((evened / wanted).mean()) - 1.0) < 0.003
    assert fit.cells > 500
    assert fit.unevenness == pytest.approx(light.max() / light.min() - 1.0, abs=0.02)


def test_mean_light_is_one_and_cast_stays() -> None:
    predicted = stone_xyz(2)
    cast = np.array([1.2, 1.1, 0.8], dtype=np.float32)
    evened, fit = even_light(predicted, predicted * cast, np.ones(SHAPE, dtype=bool))
    np.testing.assert_allclose(evened / predicted, np.broadcast_to(cast, evened.shape), rtol=1e-4)
    assert fit.surface(SHAPE).mean() == pytest.approx(1.0, abs=1e-4)


def test_covered_broken_and_badly_fired_parts_do_not_pull() -> None:
    predicted = stone_xyz(4)
    light = light_on(SHAPE, 0.12, direction=2.0)
    fired = predicted * light[..., np.newaxis]
    fired[30:110, 20:120] *= 0.5
    valid = np.ones(SHAPE, dtype=bool)
    valid[:, 220:] = False
    fired[:, 220:] = 0.03
    evened, _ = even_light(predicted, fired, valid)
    sound = np.s_[130:, :200]
    np.testing.assert_allclose(evened[sound] / predicted[sound], (evened[sound] / predicted[sound]).mean(), rtol=3e-3)


def test_too_little_to_fit_leaves_colours_alone() -> None:
    predicted = stone_xyz(5)
    valid = np.zeros(SHAPE, dtype=bool)
    valid[:40, :40] = True
    evened, fit = even_light(predicted, predicted * np.float32(1.1), valid)
    np.testing.assert_array_equal(evened, predicted * np.float32(1.1))
    assert (fit.cells, fit.unevenness) == (0, 0.0)
    assert (fit.surface((5, 7)) == 1.0).all()


def test_misuse_is_refused() -> None:
    xyz, valid = stone_xyz(1), np.ones(SHAPE, dtype=bool)
    with pytest.raises(ValueError, match="fired_xyz must be float32"):
        even_light(xyz, xyz.astype(np.float64), valid)
    with pytest.raises(ValueError, match="shapes differ"):
        even_light(xyz, xyz, valid[:-1])


def test_worn_takes_away_from_border_and_holes() -> None:
    valid = np.ones((40, 40), dtype=bool)
    valid[20, 20] = False
    smaller = worn(valid, 3)
    wanted = ndimage.binary_erosion(valid, np.ones((7, 7)))
    np.testing.assert_array_equal(smaller, wanted)
    assert worn(valid, 0) is valid
