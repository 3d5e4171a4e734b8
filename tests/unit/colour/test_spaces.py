"""CIE spaces and CIEDE2000 against published values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour.spaces import (
    RGB_LIN_FROM_XYZ_D50,
    XYZ_D50_FROM_RGB_LIN,
    absolute_lab,
    delta_e_2000,
    lab_from_xyz,
    relative_lab,
    rgb_lin_from_srgb,
    srgb_from_xyz,
    xyz_from_lab,
)

# The 34 pairs of Sharma, Wu and Dalal (2005), table 1: L a b, L a b, difference.
SHARMA = """
50.0000 2.6772 -79.7751 50.0000 0.0000 -82.7485 2.0425
50.0000 3.1571 -77.2803 50.0000 0.0000 -82.7485 2.8615
50.0000 2.8361 -74.0200 50.0000 0.0000 -82.7485 3.4412
50.0000 -1.3802 -84.2814 50.0000 0.0000 -82.7485 1.0000
50.0000 -1.1848 -84.8006 50.0000 0.0000 -82.7485 1.0000
50.0000 -0.9009 -85.5211 50.0000 0.0000 -82.7485 1.0000
50.0000 0.0000 0.0000 50.0000 -1.0000 2.0000 2.3669
50.0000 -1.0000 2.0000 50.0000 0.0000 0.0000 2.3669
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0009 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0010 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0011 7.2195
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0012 7.2195
50.0000 -0.0010 2.4900 50.0000 0.0009 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0010 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0011 -2.4900 4.7461
50.0000 2.5000 0.0000 50.0000 0.0000 -2.5000 4.3065
50.0000 2.5000 0.0000 73.0000 25.0000 -18.0000 27.1492
50.0000 2.5000 0.0000 61.0000 -5.0000 29.0000 22.8977
50.0000 2.5000 0.0000 56.0000 -27.0000 -3.0000 31.9030
50.0000 2.5000 0.0000 58.0000 24.0000 15.0000 19.4535
50.0000 2.5000 0.0000 50.0000 3.1736 0.5854 1.0000
50.0000 2.5000 0.0000 50.0000 3.2972 0.0000 1.0000
50.0000 2.5000 0.0000 50.0000 1.8634 0.5757 1.0000
50.0000 2.5000 0.0000 50.0000 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""
PAIRS = np.array([[float(word) for word in line.split()] for line in SHARMA.strip().splitlines()])
LAB = st.tuples(st.floats(0, 100), st.floats(-120, 120), st.floats(-120, 120))


def test_all_34_published_pairs_are_met() -> None:
    assert PAIRS.shape == (34, 7)
    found = delta_e_2000(PAIRS[:, :3], PAIRS[:, 3:6])
    np.testing.assert_allclose(found, PAIRS[:, 6], atol=1e-4)
    np.testing.assert_allclose(delta_e_2000(PAIRS[:, 3:6], PAIRS[:, :3]), PAIRS[:, 6], atol=1e-4)


def test_difference_broadcasts_and_is_nil_for_equal_colours() -> None:
    grid = PAIRS[:, :3].reshape(2, 17, 3)
    assert delta_e_2000(grid, grid[0, 0]).shape == (2, 17)
    assert (delta_e_2000(grid, grid) == 0.0).all()


@given(LAB)
@settings(max_examples=60, deadline=None)
def test_lab_and_xyz_are_inverse(lab: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(lab_from_xyz(xyz_from_lab(lab)), lab, atol=1e-8)


def test_lab_of_known_colours() -> None:
    np.testing.assert_allclose(lab_from_xyz([0.9642, 1.0, 0.8249]), [100.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(lab_from_xyz([0.0, 0.0, 0.0]), [0.0, 0.0, 0.0], atol=1e-12)
    # 18 % grey is L* 49.496 (CIE 15).
    np.testing.assert_allclose(lab_from_xyz(0.18 * np.array([0.9642, 1.0, 0.8249]))[0], 49.496, atol=1e-3)


def test_srgb_preview() -> None:
    np.testing.assert_allclose(XYZ_D50_FROM_RGB_LIN @ RGB_LIN_FROM_XYZ_D50, np.eye(3), atol=1e-8)
    srgb = np.random.default_rng(1).random((5, 4, 3))
    back = srgb_from_xyz(rgb_lin_from_srgb(srgb) @ XYZ_D50_FROM_RGB_LIN.T)
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, srgb, atol=1e-6)
    assert srgb_from_xyz([2.0, 2.0, 2.0]).max() == 1.0
    assert srgb_from_xyz([0.0, 0.1, 0.0]).min() == 0.0


def test_relative_lab_makes_the_tile_white() -> None:
    white = np.array([92.9, -0.1, 3.7])
    np.testing.assert_allclose(relative_lab(white, white), [100.0, 0.0, 0.0], atol=1e-10)
    some = np.array([[50.0, 10.0, 20.0], [20.0, -3.0, -9.0]])
    np.testing.assert_allclose(absolute_lab(relative_lab(some, white), white), some, atol=1e-9)


@pytest.mark.parametrize("function", [lab_from_xyz, xyz_from_lab, srgb_from_xyz])
def test_two_channels_are_refused(function: object) -> None:
    with pytest.raises(ValueError, match="3 values"):
        function(np.zeros((4, 2)))  # type: ignore[operator]
