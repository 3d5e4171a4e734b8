"""The spectral press: its colours look like the press it stands for, and its physics behaves."""

import numpy as np
import pytest

from sim.ink_sets import PRESS_NAMES, press_inks
from sim.inks import WAVELENGTHS_NM
from sim.kiln import Firing, random_recipes
from sim.spectral_press import SpectralPress, _cell_weights, _layer, _node_powers, _products

INKS = {"ceramic4": 4, "offset4": 4, "ceramic6": 6, "ceramic8": 8}


@pytest.fixture(params=PRESS_NAMES)
def press(request: pytest.FixtureRequest) -> SpectralPress:
    return SpectralPress(request.param)


def _ramp(press: SpectralPress, ink: int, steps: int = 101) -> np.ndarray:
    recipes = np.zeros((steps, len(press.ink_names)))
    recipes[:, ink] = np.linspace(0.0, 1.0, steps)
    return recipes


def test_shapes_and_ranges(press: SpectralPress) -> None:
    inks = INKS[press.name]
    assert len(press.ink_names) == inks
    recipes = np.random.default_rng(1).random((300, inks))
    spectra = press.reflectance(recipes)
    assert spectra.shape == (300, len(WAVELENGTHS_NM))
    assert spectra.min() > 0.0
    assert spectra.max() < 1.0
    assert press.lab(recipes).shape == (300, 3)
    assert press.reflectance(recipes[:0]).shape == (0, 36)


def test_no_ink_is_the_bare_body(press: SpectralPress) -> None:
    bare = press.reflectance(np.zeros((1, len(press.ink_names))))[0]
    np.testing.assert_allclose(bare, press_inks(press.name).body, rtol=1e-9)
    light, a, b = press.lab(np.zeros((1, len(press.ink_names))))[0]
    assert 92.0 < light < 95.5
    assert abs(a) < 1.0
    assert -1.0 < b < 5.0


def test_spectra_of_inks_are_physical(press: SpectralPress) -> None:
    for ink in press_inks(press.name).inks:
        assert ink.absorbance.shape == (36,)
        assert (ink.absorbance > 0.0).all()


def test_black_solid_is_nearly_black(press: SpectralPress) -> None:
    light, a, b = press.lab(np.eye(len(press.ink_names)))[press.ink_names.index("Black")]
    assert 14.0 < light < 20.0
    assert np.hypot(a, b) < 3.0


def test_ceramic_solids_look_like_their_names() -> None:
    press = SpectralPress("ceramic8")
    solid = dict(zip(press.ink_names, press.lab(np.eye(8)), strict=True))
    assert solid["Blue"][2] < -30.0
    assert solid["Brown"][1] > 15.0
    assert solid["Brown"][2] > 15.0
    assert solid["Yellow"][2] > 40.0
    assert solid["Pink"][1] > 25.0
    assert abs(solid["Pink"][2]) < 10.0
    assert 75.0 < solid["Beige"][0] < 85.0
    assert solid["Green"][1] < -20.0
    assert solid["Orange"][1] > 15.0
    assert solid["Orange"][2] > 30.0
    assert "Green" not in SpectralPress("ceramic6").ink_names


def test_offset_solids_are_near_the_standard_ones() -> None:
    """ISO 12647-2 solids on coated paper, within what a look-alike may differ."""
    standard = [[55, -37, -50], [48, 74, -3], [89, -5, 93], [16, 0, 0]]
    np.testing.assert_allclose(SpectralPress("offset4").lab(np.eye(4)), standard, atol=7.0)


def test_more_of_an_ink_alone_is_darker(press: SpectralPress) -> None:
    for ink in range(len(press.ink_names)):
        assert (np.diff(press.lab(_ramp(press, ink))[:, 0]) < 0.0).all(), press.ink_names[ink]


def test_black_darkens_light_mixtures(press: SpectralPress) -> None:
    recipes = 0.3 * np.random.default_rng(2).random((200, len(press.ink_names)))
    black = press.ink_names.index("Black")
    with_black = recipes.copy()
    with_black[:, black] += 0.3
    assert (press.lab(with_black)[:, 0] < press.lab(recipes)[:, 0] - 3.0).all()


def test_cover_grows_steadily_from_none_to_full(press: SpectralPress) -> None:
    for ink in range(len(press.ink_names)):
        cover = press.cover(_ramp(press, ink))[:, ink]
        assert cover[0] == 0.0
        assert cover[-1] == 1.0
        assert (np.diff(cover) > 0.0).all()
        assert cover[50] > 0.5
    halves = np.full((1, len(press.ink_names)), 0.5)
    assert (press.cover(halves, Firing(moisture_offset_percent=2.0)) > press.cover(halves)).all()
    assert (press.cover(halves)[0] < press.cover(0.5 * np.eye(len(press.ink_names))).max(axis=0)).all()


def test_cell_weights_share_out_one_and_keep_the_mean() -> None:
    cover = np.linspace(0.0, 1.0, 201)[:, np.newaxis]
    weights = _cell_weights(cover)[:, 0, :]
    assert weights.min() >= -1e-15
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(weights @ [0.0, 0.5, 1.0], cover[:, 0], atol=1e-14)
    np.testing.assert_allclose(weights[[0, -1]], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-14)


def test_interpolation_agrees_with_a_sum_over_all_nodes() -> None:
    press = SpectralPress("ceramic6")
    recipes = np.random.default_rng(3).random((4, 6))
    nodes = _node_powers("ceramic6", Firing()).reshape(3**6, 36)
    plain = (_products(_cell_weights(press.cover(recipes))) @ nodes) ** press_inks("ceramic6").yule_nielsen
    np.testing.assert_allclose(press.reflectance(recipes), plain, rtol=1e-12)


def test_layer_has_the_limits_of_kubelka_and_munk() -> None:
    background, none, much = np.array([0.8]), np.array([0.0]), np.array([50.0])
    np.testing.assert_allclose(_layer(background, none, none), 0.8)
    # Without scattering light is absorbed twice on its way; without absorption a thick layer is white.
    np.testing.assert_allclose(_layer(background, np.array([0.7]), none), 0.8 * np.exp(-1.4), rtol=1e-9)
    np.testing.assert_allclose(_layer(np.array([0.0]), none, much), 50.0 / 51.0, rtol=1e-4)
    # Infinitely thick: 1 + K/S - sqrt((K/S)^2 + 2 K/S).
    np.testing.assert_allclose(_layer(background, 0.5 * much, much), 1.5 - np.sqrt(1.25), rtol=1e-9)


def test_a_hotter_and_a_longer_firing_fade(press: SpectralPress) -> None:
    count = len(press.ink_names)
    recipes = np.vstack([0.8 * np.eye(count), np.full((1, count), 0.25)])
    normal = press.lab(recipes)[:, 0]
    assert (press.lab(recipes, Firing(soak_offset_min=4.0))[:, 0] > normal).all()
    assert (press.lab(recipes, Firing(soak_offset_min=-4.0))[:, 0] < normal).all()
    hot, cold = press.lab(recipes, Firing(10.0))[:, 0], press.lab(recipes, Firing(-10.0))[:, 0]
    assert hot[-1] > normal[-1] > cold[-1]


def test_firing_moves_hue_and_glaze() -> None:
    press = SpectralPress("ceramic6")
    bare = np.zeros((1, 6))
    assert press.lab(bare, Firing(8.0))[0, 2] > press.lab(bare)[0, 2] + 0.1
    assert press.lab(bare, Firing(glaze_tint=0.01))[0, 2] > press.lab(bare)[0, 2] + 0.5
    pink = np.array([[0.0, 0.0, 0.0, 0.0, 0.8, 0.0]])
    normal = press.lab(pink)[0]
    reduced = press.lab(pink, Firing(oxygen_offset_percent=-4.0))[0]
    assert np.arctan2(reduced[2], reduced[1]) > np.arctan2(normal[2], normal[1])
    stronger = press.lab(pink, Firing(ink_offset_frac=(0.0, 0.0, 0.0, 0.0, 0.1, 0.0)))[0]
    assert np.hypot(*stronger[1:]) > np.hypot(*normal[1:]) + 0.5


def test_small_changes_of_the_firing_have_small_effects() -> None:
    press = SpectralPress("ceramic4")
    recipes = random_recipes(4, 200, np.random.default_rng(4))
    for step in (0.01, -0.01):
        moved = press.lab(recipes, Firing(step, step, step, step, 0.001 * step, (step / 10.0,) * 4))
        assert np.abs(moved - press.lab(recipes)).max() < 0.05


def test_the_same_recipe_is_the_same_colour_in_any_company(press: SpectralPress) -> None:
    recipes = np.random.default_rng(5).random((2100, len(press.ink_names)))
    again = SpectralPress(press.name).lab(recipes[2090:])
    np.testing.assert_allclose(press.lab(recipes)[2090:], again, atol=1e-9)


def test_misuse_is_refused() -> None:
    press = SpectralPress("ceramic4")
    with pytest.raises(ValueError, match="must be"):
        press.lab(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="0 to 1"):
        press.lab(np.full((1, 4), 1.1))
    with pytest.raises(ValueError, match="0 to 1"):
        press.lab(np.full((1, 4), np.nan))
    with pytest.raises(ValueError, match="for 4 inks"):
        press.lab(np.zeros((1, 4)), Firing(ink_offset_frac=(0.1,)))
    with pytest.raises(ValueError, match="unknown"):
        SpectralPress("ceramic5")
