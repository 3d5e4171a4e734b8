"""The simulated press: its gamut looks like a ceramic one, and its physics behaves."""

import numpy as np
import pytest

from sim.inks import WAVELENGTHS_NM, ceramic_ink_set, lab_from_reflectance, xyz_from_reflectance
from sim.press import CeramicPress, KilnState, measure


@pytest.fixture
def press() -> CeramicPress:
    return CeramicPress()


def test_observer_sees_the_diffuser_as_white() -> None:
    white = np.ones((1, len(WAVELENGTHS_NM)))
    np.testing.assert_allclose(xyz_from_reflectance(white)[0], [0.9642, 1.0, 0.8249], atol=1e-12)
    np.testing.assert_allclose(lab_from_reflectance(white)[0], [100.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(lab_from_reflectance(0.18 * white)[0], [49.496, 0.0, 0.0], atol=1e-3)


def test_spectra_are_physical() -> None:
    inks = ceramic_ink_set()
    assert inks.density.shape == (4, len(WAVELENGTHS_NM))
    assert (inks.density > 0.0).all()
    assert ((inks.body > 0.5) & (inks.body < 0.95)).all()


def test_single_inks_look_like_their_names(press: CeramicPress) -> None:
    white, blue, brown, yellow, black = press.lab(np.vstack([np.zeros(4), np.eye(4)]))
    assert 91.0 < white[0] < 94.0
    assert abs(white[1]) < 1.0
    assert 2.0 < white[2] < 5.0
    assert blue[2] < -30.0
    assert brown[1] > 15.0
    assert brown[2] > 15.0
    assert 35.0 < yellow[2] < 60.0
    assert yellow[0] > 80.0
    assert 18.0 < black[0] < 30.0
    assert np.hypot(*black[1:]) < 3.0


def test_near_neutral_greys_are_reachable_and_colours_stay_ceramic(press: CeramicPress) -> None:
    inks = np.random.default_rng(1).random((20000, 4))
    lab = press.lab(inks[inks.sum(axis=1) <= 2.8])
    chroma = np.hypot(lab[:, 1], lab[:, 2])
    for lightness in (25, 40, 55, 70):
        assert chroma[np.abs(lab[:, 0] - lightness) < 4].min() < 2.5
    assert lab[:, 0].min() > 14.0
    assert chroma.max() < 55.0


def test_more_ink_is_darker(press: CeramicPress) -> None:
    for ink in range(4):
        ramp = np.zeros((21, 4))
        ramp[:, ink] = np.linspace(0.0, 1.0, 21)
        assert (np.diff(press.lab(ramp)[:, 0]) < 0.0).all()


def test_neugebauer_by_hand(press: CeramicPress) -> None:
    """One ink at half cover, worked out without the loop over overlaps."""
    gain = press.dot_gain[3]
    cover = 0.5 + gain
    inks = press.ink_set
    solid = inks.surface + (inks.body - inks.surface) * 10.0 ** -inks.density[3]
    n = press.yule_nielsen
    plain = ((1 - cover) * inks.body ** (1 / n) + cover * solid ** (1 / n)) ** n
    np.testing.assert_allclose(press.reflectance(np.array([[0.0, 0.0, 0.0, 0.5]]))[0], plain, rtol=1e-12)


def test_a_hotter_kiln_fades(press: CeramicPress) -> None:
    inks = np.array([[0.5, 0.5, 0.5, 0.2]])
    assert press.lab(inks, KilnState(8.0))[0, 0] > press.lab(inks)[0, 0] > press.lab(inks, KilnState(-8.0))[0, 0]
    bare = np.zeros((1, 4))
    np.testing.assert_array_equal(press.lab(bare, KilnState(20.0)), press.lab(bare))


def test_noise_comes_from_the_generator_alone(press: CeramicPress) -> None:
    inks = np.full((500, 4), 0.4)
    first = measure(press, inks, np.random.default_rng(3))
    np.testing.assert_array_equal(first, measure(press, inks, np.random.default_rng(3)))
    assert not np.array_equal(first, measure(press, inks, np.random.default_rng(4)))
    assert 0.1 < first.std(axis=0).max() < 0.4
    np.testing.assert_allclose(first.mean(axis=0), press.lab(inks[:1])[0], atol=0.06)


def test_misuse_is_refused(press: CeramicPress) -> None:
    with pytest.raises(ValueError, match="must be"):
        press.lab(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="0 to 1"):
        press.lab(np.full((1, 4), 1.1))
    with pytest.raises(ValueError, match="0 to 1"):
        press.lab(np.full((1, 4), np.nan))
