"""CIE76, CIE94 and CMC(l:c) against published values and other people's code."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.colour import delta_e_76, delta_e_94, delta_e_cmc

# Values that the library "colour" holds itself to (far outside the world of colours, so every weight tells).
ONE = (100.0, 21.57210357, 272.22819350)
OTHERS = ((100.0, 426.67945353, 72.39590835), (100.0, 74.05216981, 276.45318193), (100.0, 8.32281957, -73.58297716))
PUBLISHED = {
    delta_e_76: (451.713301974, 52.6498611564, 346.064891718),
    delta_e_94: (83.779225500887, 10.053931954554, 57.535453706667),
    partial(delta_e_94, textiles=True): (88.335553057507, 10.612657890048, 60.368687261063),
    delta_e_cmc: (172.70477129, 20.59732717, 121.71841479),
    partial(delta_e_cmc, lightness=1.0): (172.70477129, 20.59732717, 121.71841479),
}
DIFFERENCES = list(PUBLISHED)
LAB = st.tuples(st.floats(0, 100), st.floats(-120, 120), st.floats(-120, 120))


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_published_values(difference: Callable[..., Any]) -> None:
    np.testing.assert_allclose(difference(ONE, OTHERS), PUBLISHED[difference], rtol=1e-9)


def test_lightness_counts_in_published_values() -> None:
    pair = (48.99183622, -0.10561667, 400.65619925), (50.65907324, -0.11671910, 402.82235718)
    assert delta_e_94(*pair) == pytest.approx(1.6711191305412, abs=1e-9)
    assert delta_e_cmc(*pair) == pytest.approx(0.899699975683419, abs=1e-9)


def test_cie94_by_hand() -> None:
    # Chroma 40 weighs differences of chroma with 1 + 0.045 x 40 = 2.8, of hue with 1 + 0.015 x 40 = 1.6.
    assert delta_e_94([50, 40, 0], [53, 45.6, 0]) == pytest.approx(math.hypot(3.0, 2.0))
    assert delta_e_94([50, 40, 0], [50, 40 * math.cos(0.1), 40 * math.sin(0.1)]) == pytest.approx(
        80 * math.sin(0.05) / 1.6
    )
    # Textiles: 1 + 0.048 x 50 = 3.4, 1 + 0.014 x 50 = 1.7, and lightness counts by half.
    assert delta_e_94([50, 50, 0], [54, 53.4, 0], textiles=True) == pytest.approx(math.hypot(2.0, 1.0))
    assert delta_e_94([50, 50, 0], [50, 0, 50], textiles=True) == pytest.approx(math.sqrt(2.0) * 50 / 1.7)


def test_cmc_by_hand() -> None:
    # Grey of L* 50: S_L = 0.040975 x 50 / 1.8825.
    s_l = 0.040975 * 50 / (1 + 0.01765 * 50)
    assert delta_e_cmc([50, 0, 0], [51, 0, 0], lightness=1.0) == pytest.approx(1 / s_l)
    assert delta_e_cmc([50, 0, 0], [51, 0, 0]) == pytest.approx(0.5 / s_l)
    # Dark: S_L is 0.511 below L* 16; grey has S_C 0.638.
    assert delta_e_cmc([15.999, 0, 0], [17.021, 0, 0], lightness=1.0) == pytest.approx(2.0)
    assert delta_e_cmc([0, 0, 0], [0, 6.38, 0]) == pytest.approx(10.0)
    assert delta_e_cmc([0, 0, 0], [0, 6.38, 0], chroma=2.0) == pytest.approx(5.0)
    # A turn of hue at chroma 50, hue 270 degrees: T = 0.56 + 0.2 |cos 438 degrees|.
    s_c = 0.0638 * 50 / (1 + 0.0131 * 50) + 0.638
    f = math.sqrt(50**4 / (50**4 + 1900))
    s_h = s_c * (f * (0.56 + 0.2 * abs(math.cos(math.radians(78.0)))) + 1 - f)
    turned = [50, 50 * math.sin(0.2), -50 * math.cos(0.2)]
    assert delta_e_cmc([50, 0, -50], turned) == pytest.approx(100 * math.sin(0.1) / s_h)


def test_cmc_takes_another_weight_of_hue_between_164_and_345_degrees() -> None:
    def turned(hue_deg: float) -> float:
        at, near = np.radians(hue_deg), np.radians(hue_deg + 1.0)
        return float(delta_e_cmc([50, 40 * np.cos(at), 40 * np.sin(at)], [50, 40 * np.cos(near), 40 * np.sin(near)]))

    f = 1600 / math.sqrt(40**4 + 1900)
    for edge, inside in ((164.0, 0.001), (345.0, -0.001)):
        blue = 0.56 + abs(0.2 * math.cos(math.radians(edge + 168.0)))
        other = 0.36 + abs(0.4 * math.cos(math.radians(edge + 35.0)))
        ratio = turned(edge - inside) / turned(edge + inside)
        assert ratio == pytest.approx((f * blue + 1 - f) / (f * other + 1 - f), abs=1e-4)


def test_against_scikit_image() -> None:
    delta_e = pytest.importorskip("skimage.color")
    random = np.random.default_rng(20261124)
    first, second = random.uniform([0, -110, -110], [100, 110, 110], (2, 4000, 3))
    second[::2] = first[::2] + random.normal(0, 2, (2000, 3))
    np.testing.assert_allclose(delta_e_76(first, second), delta_e.deltaE_cie76(first, second), atol=1e-9)
    np.testing.assert_allclose(delta_e_94(first, second), delta_e.deltaE_ciede94(first, second), atol=1e-9)
    theirs = delta_e.deltaE_ciede94(first, second, kL=2, k1=0.048, k2=0.014)
    np.testing.assert_allclose(delta_e_94(first, second, textiles=True), theirs, atol=1e-9)
    for weights in ((2.0, 1.0), (1.0, 1.0), (1.5, 0.7)):
        theirs = delta_e.deltaE_cmc(first, second, kL=weights[0], kC=weights[1])
        ours = delta_e_cmc(first, second, lightness=weights[0], chroma=weights[1])
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("difference", DIFFERENCES)
@given(one=LAB, other=LAB)
@settings(max_examples=40, deadline=None)
def test_nil_for_equal_colours_and_never_below(
    difference: Callable[..., Any], one: tuple[float, float, float], other: tuple[float, float, float]
) -> None:
    assert difference(one, one) == pytest.approx(0.0, abs=1e-6)
    assert difference(one, other) >= 0.0
    assert np.isfinite(difference(one, other))


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_a_step_twice_as_large_counts_twice(difference: Callable[..., Any]) -> None:
    grey = np.array([40.0, 0.0, 0.0])
    steps = np.random.default_rng(5).normal(0, 1, (50, 3))
    np.testing.assert_allclose(difference(grey, grey + 2 * steps), 2 * difference(grey, grey + steps), rtol=1e-12)


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_hue_has_no_seam_at_half_and_whole_turns(difference: Callable[..., Any]) -> None:
    for a in (-30.0, 30.0):
        above, below = [60.0, a, 1e-9], [60.0, a, -1e-9]
        assert difference(above, [60.0, a, 3.0]) == pytest.approx(difference(below, [60.0, a, 3.0]), rel=1e-6)
        assert difference(above, below) == pytest.approx(0.0, abs=1e-6)


def test_only_cie76_is_symmetric() -> None:
    pale, strong = np.array([50.0, 5.0, 5.0]), np.array([55.0, 60.0, 20.0])
    assert delta_e_76(pale, strong) == delta_e_76(strong, pale)
    for difference in (delta_e_94, delta_e_cmc):
        assert difference(pale, strong) > 1.5 * difference(strong, pale)


@pytest.mark.parametrize("difference", DIFFERENCES)
def test_broadcasting_and_wrong_shapes(difference: Callable[..., Any]) -> None:
    grid = np.random.default_rng(2).uniform(0, 50, (4, 5, 3))
    assert difference(grid, grid[0, 0]).shape == (4, 5)
    assert difference(grid[0, 0], grid).shape == (4, 5)
    with pytest.raises(ValueError, match="3 values"):
        difference(np.zeros((4, 2)), np.zeros((4, 2)))


def test_cmc_refuses_weights_of_nil() -> None:
    for weights in ({"lightness": 0.0}, {"chroma": -1.0}, {"lightness": float("nan")}):
        with pytest.raises(ValueError, match="above 0"):
            delta_e_cmc(ONE, ONE, **weights)
