"""Instrument and kiln: the colour difference, the scatter of readings, drifts of a wanted size."""

import numpy as np
import pytest

from sim.instrument import delta_e_2000, measure, measure_spectra
from sim.kiln import Firing, drift_of_size, random_recipes
from sim.spectral_press import SpectralPress

# Sharma, Wu and Dalal (2005), table 1: pairs 1, 4, 7, 9, 11, 13, 15, 17, 20, 21, 25, 29, 33, 34.
PAIRS = [
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0),
    ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
    ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0009), 7.1792),
    ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0011), 7.2195),
    ((50.0, -0.001, 2.49), (50.0, 0.0009, -2.49), 4.8045),
    ((50.0, -0.001, 2.49), (50.0, 0.0011, -2.49), 4.7461),
    ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((50.0, 2.5, 0.0), (58.0, 24.0, 15.0), 19.4535),
    ((50.0, 2.5, 0.0), (50.0, 3.1736, 0.5854), 1.0),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.694), (23.0331, 14.973, -42.5619), 2.0373),
    ((6.7747, -0.2908, -2.4247), (5.8714, -0.0985, -2.2286), 0.6377),
    ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
]


def test_colour_difference_agrees_with_published_pairs() -> None:
    one, two = np.array([pair[0] for pair in PAIRS]), np.array([pair[1] for pair in PAIRS])
    wanted = [pair[2] for pair in PAIRS]
    np.testing.assert_allclose(delta_e_2000(one, two), wanted, atol=1e-4)
    np.testing.assert_allclose(delta_e_2000(two, one), wanted, atol=1e-4)
    np.testing.assert_array_equal(delta_e_2000(one, one), 0.0)


def test_lab_readings_scatter_as_asked() -> None:
    press = SpectralPress("ceramic4")
    inks = np.full((4000, 4), 0.4)
    read = measure(press, inks, np.random.default_rng(1), lab_noise=0.3)
    np.testing.assert_allclose(read.std(axis=0), 0.3, rtol=0.05)
    np.testing.assert_allclose(read.mean(axis=0), press.lab(inks[:1])[0], atol=0.03)
    np.testing.assert_array_equal(read, measure(press, inks, np.random.default_rng(1)))
    assert not np.array_equal(read, measure(press, inks, np.random.default_rng(2)))
    exact = measure(press, inks, np.random.default_rng(1), lab_noise=0.0)
    np.testing.assert_allclose(exact, press.lab(inks), atol=1e-12)
    uneven = measure(press, inks, np.random.default_rng(1), ink_noise=0.01, lab_noise=0.0)
    assert 0.05 < uneven.std(axis=0).max() < 1.0


def test_spectra_scatter_as_asked() -> None:
    press = SpectralPress("ceramic6")
    inks = np.zeros((3000, 6))
    read = measure_spectra(press, inks, np.random.default_rng(3), level_noise=0.004, reading_noise=0.001)
    bare = press.reflectance(inks[:1])[0]
    assert read.shape == (3000, 36)
    np.testing.assert_allclose(read.mean(axis=0), bare, atol=3e-4)
    np.testing.assert_allclose(read.std(axis=0), np.hypot(0.004 * bare, 0.001), rtol=0.06)
    assert measure_spectra(press, np.ones((50, 6)), np.random.default_rng(3), reading_noise=0.1).min() == 0.0


@pytest.mark.parametrize("name", ["ceramic4", "offset4", "ceramic6", "ceramic8"])
def test_drift_has_the_wanted_size(name: str) -> None:
    press = SpectralPress(name)
    inks = len(press.ink_names)
    firing = drift_of_size(press, np.random.default_rng(4), 3.0)
    assert firing == drift_of_size(press, np.random.default_rng(4), 3.0)
    assert firing != drift_of_size(press, np.random.default_rng(5), 3.0)
    # The recipes that the helper averaged over are redrawn from its generator, after the direction.
    source = np.random.default_rng(4)
    source.standard_normal(5 + inks)
    recipes = random_recipes(inks, 1000, source)
    reached = delta_e_2000(press.lab(recipes), press.lab(recipes, firing)).mean()
    assert reached == pytest.approx(3.0, rel=0.01)
    others = random_recipes(inks, 3000, np.random.default_rng(6))
    assert delta_e_2000(press.lab(others), press.lab(others, firing)).mean() == pytest.approx(3.0, rel=0.06)


def test_drift_changes_every_part_of_the_firing() -> None:
    firing = drift_of_size(SpectralPress("ceramic4"), np.random.default_rng(7), 1.0)
    assert firing != Firing()
    assert firing.peak_offset_degc != 0.0
    assert firing.moisture_offset_percent != 0.0
    assert len(firing.ink_offset_frac) == 4
    with pytest.raises(ValueError, match="outside"):
        drift_of_size(SpectralPress("ceramic4"), np.random.default_rng(7), 0.0)


@pytest.mark.parametrize("inks", [1, 4, 8])
def test_random_recipes_keep_their_limit(inks: int) -> None:
    recipes = random_recipes(inks, 2000, np.random.default_rng(8), 2.4)
    assert recipes.shape == (2000, inks)
    assert recipes.min() >= 0.0
    assert recipes.max() <= 1.0
    assert recipes.sum(axis=1).max() <= 2.4 + 1e-12
