"""Spectra into tristimulus values, against sums over finer tables and known whites."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tilefab.colour.spaces import delta_e_2000, lab_from_xyz
from tilefab.colour.spectra import spectral_weights, xyz_from_reflectance

Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def step(nm: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.1 + 0.8 / (1.0 + np.exp((560.0 - nm) / 12.0))


def band(nm: NDArray[np.float64]) -> NDArray[np.float64]:
    return 0.05 + 0.7 * np.exp(-(((nm - 450.0) / 30.0) ** 2))


@pytest.mark.parametrize(
    "bands", [np.arange(380.0, 781.0, 5.0), np.arange(380.0, 731.0, 10.0), np.arange(400.0, 701.0, 20.0)]
)
def test_a_grey_is_neutral_and_white_is_the_white_of_profiles(bands: NDArray[np.float64]) -> None:
    for level in (1.0, 0.18):
        xyz = xyz_from_reflectance(np.full(len(bands), level), bands)
        np.testing.assert_allclose(xyz, level * np.array([0.9642, 1.0, 0.8249]), rtol=1e-12)


@pytest.mark.parametrize(
    ("curve", "known"),
    [
        # Sums over the CIE's tables by 1 nm, taken to the same white.
        (step, (0.6410552, 0.4960683, 0.0845069)),
        (band, (0.1185450, 0.0678805, 0.4327868)),
    ],
)
@pytest.mark.parametrize(
    ("bands", "most"),
    [
        (np.arange(380.0, 781.0, 5.0), 0.005),
        (np.arange(380.0, 731.0, 10.0), 0.005),
        (np.arange(360.0, 751.0, 7.0), 0.005),
        (np.arange(400.0, 701.0, 20.0), 0.02),
    ],
)
def test_steps_of_5_10_20_nm_and_others_agree(
    curve: Curve, known: tuple[float, ...], bands: NDArray[np.float64], most: float
) -> None:
    xyz = xyz_from_reflectance(curve(bands), bands)
    assert delta_e_2000(lab_from_xyz(xyz), lab_from_xyz(known)) < most


def test_many_spectra_at_once_are_one_by_one() -> None:
    bands = np.arange(400.0, 701.0, 10.0)
    spectra = np.random.default_rng(3).random((2, 5, len(bands)))
    together = xyz_from_reflectance(spectra, bands)
    assert together.shape == (2, 5, 3)
    np.testing.assert_allclose(together[1, 3], xyz_from_reflectance(spectra[1, 3], bands), rtol=1e-13)


@pytest.mark.parametrize(
    "bands",
    [
        [500.0],
        [400.0, 390.0, 700.0],
        list(range(450, 701, 10)),
        list(range(400, 661, 10)),
        list(range(400, 701, 30)),
        [400.0, float("nan"), 700.0],
    ],
)
def test_bands_that_make_no_colour(bands: list[float]) -> None:
    with pytest.raises(ValueError):
        spectral_weights(bands)


def test_shapes_must_agree() -> None:
    with pytest.raises(ValueError):
        xyz_from_reflectance(np.ones((2, 30)), np.arange(400.0, 701.0, 10.0))


def test_illuminant_a_is_the_published_one() -> None:
    """CIE 15:2004, table T.1, relative to D50 in the same table; columns are scaled, so only ratios are seen."""
    nm = np.arange(380.0, 781.0, 5.0)
    ratio = spectral_weights(nm, "A")[:, 1] / spectral_weights(nm, "D50")[:, 1]
    published = {400.0: (14.7080, 49.308), 450.0: (33.0859, 87.247), 600.0: (129.043, 97.688), 700.0: (198.261, 91.604)}
    at_560 = ratio[nm == 560.0][0]
    for wavelength, (lamp, daylight) in published.items():
        assert ratio[nm == wavelength][0] / at_560 == pytest.approx(lamp / daylight, rel=2e-5)


def test_a_lamp_shows_what_daylight_hides() -> None:
    """A grey is neutral under both; a spectrum that makes the same colour under D50 is another under A."""
    nm = np.arange(380.0, 731.0, 10.0)
    weights = spectral_weights(nm)
    np.testing.assert_allclose(xyz_from_reflectance(np.full(36, 0.4), nm, "A"), 0.4 * weights.sum(axis=0), rtol=1e-12)
    wave = np.cos(np.linspace(0.0, 25.0, 36))
    hidden = wave - weights @ np.linalg.solve(weights.T @ weights, weights.T @ wave)
    grey = np.full(36, 0.4)
    pair = np.stack([grey, grey + 0.2 * hidden])
    day, lamp = (lab_from_xyz(xyz_from_reflectance(pair, nm, light)) for light in ("D50", "A"))
    assert delta_e_2000(day[0], day[1]) < 1e-6
    assert delta_e_2000(lamp[0], lamp[1]) > 0.5
