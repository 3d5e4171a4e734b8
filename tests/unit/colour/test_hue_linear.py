"""Oklab against published values, there and back."""

import numpy as np
import pytest

from tilefab.colour.hue_linear import lab_from_oklab, oklab_from_lab
from tilefab.colour.spaces import lab_from_xyz

D50_FROM_D65 = np.linalg.inv(
    [[0.9555766, -0.0230393, 0.0631636], [-0.0282895, 1.0099416, 0.0210077], [0.0122982, -0.0204830, 1.3299098]]
)


@pytest.mark.parametrize(
    ("xyz_d65", "oklab"),
    [
        ((0.950, 1.000, 1.089), (1.000, 0.000, 0.000)),
        ((1.000, 0.000, 0.000), (0.450, 1.236, -0.019)),
        ((0.000, 1.000, 0.000), (0.922, -0.671, 0.263)),
        ((0.000, 0.000, 1.000), (0.153, -1.415, -0.449)),
    ],
)
def test_published_values(xyz_d65: tuple[float, ...], oklab: tuple[float, ...]) -> None:
    """Table of B. Ottosson, "A perceptual color space for image processing" (2020); three decimals."""
    lab = lab_from_xyz(np.array(xyz_d65) @ D50_FROM_D65.T)
    np.testing.assert_allclose(oklab_from_lab(lab), oklab, atol=2.5e-3)


def test_primaries_of_srgb() -> None:
    """Oklab of the sRGB primaries, as the standard's own matrix for D50 has them (CSS Color 4, sample values)."""
    lab = np.array([[54.29, 80.81, 69.89], [87.82, -79.29, 80.99], [29.57, 68.30, -112.03]])
    wanted = np.array([[0.62796, 0.22486, 0.12585], [0.86644, -0.23389, 0.17950], [0.45201, -0.03246, -0.31153]])
    np.testing.assert_allclose(oklab_from_lab(lab), wanted, atol=1e-3)


def test_there_and_back() -> None:
    lab = np.random.default_rng(1).uniform([1, -90, -90], [100, 90, 90], (4, 500, 3))
    np.testing.assert_allclose(lab_from_oklab(oklab_from_lab(lab)), lab, atol=1e-6)


def test_neutrals_are_neutral_and_rise() -> None:
    greys = np.zeros((101, 3))
    greys[:, 0] = np.linspace(0.0, 100.0, 101)
    oklab = oklab_from_lab(greys)
    assert np.abs(oklab[:, 1:]).max() < 2e-4
    assert (np.diff(oklab[:, 0]) > 0.0).all()
    assert oklab[0, 0] == pytest.approx(0.0, abs=1e-9)
    assert oklab[-1, 0] == pytest.approx(1.0, abs=2e-4)
