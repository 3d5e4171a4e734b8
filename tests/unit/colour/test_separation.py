"""Turning the press round: accuracy in gamut, limits, prices, black, smoothness, and colour given up for ink."""

from dataclasses import replace

import numpy as np
import pytest

from sim.spectral_press import SpectralPress
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.separation import (
    SeparationSettings,
    SeparationStyle,
    Separator,
    black_cap,
    black_wish,
    error_metric,
    neighbour_mean,
    refined,
)
from tilefab.colour.spaces import delta_e_2000

LIMIT = 2.6
STYLES: tuple[SeparationStyle, ...] = ("standard", "least_ink")
STANDARD = SeparationSettings(LIMIT)
LEAST = SeparationSettings(LIMIT, style="least_ink")


def fitted(name: str, inks: int, count: int) -> PressModel:
    """A model of the first inks of a press."""
    press = SpectralPress(name)
    draw = np.random.default_rng(1)
    recipes = draw.random((count, inks)) ** 1.3
    recipes[draw.random((count, inks)) < 0.3] = 0.0
    recipes[: inks + 2] = np.vstack([np.eye(inks), np.zeros((1, inks)), np.ones((1, inks))])
    return fit_press_model(recipes, press.lab(np.pad(recipes, ((0, 0), (0, len(press.ink_names) - inks)))))


@pytest.fixture(scope="module")
def model() -> PressModel:
    return fitted("ceramic4", 4, 220)


@pytest.fixture(scope="module")
def six() -> PressModel:
    return fitted("ceramic6", 6, 260)


@pytest.fixture(scope="module")
def wanted(model: PressModel) -> np.ndarray:
    """Colours that the standard way can make: black is not needed in the highlights."""
    draw = np.random.default_rng(2)
    recipes = draw.random((500, 4)) * np.array([0.7, 0.7, 0.7, 0.5])
    recipes[:, 3] *= recipes[:, :3].mean(axis=1) > 0.35
    return model.lab(recipes[recipes.sum(axis=1) <= LIMIT])


@pytest.mark.parametrize("style", STYLES)
def test_colours_in_gamut_are_met_exactly(model: PressModel, wanted: np.ndarray, style: SeparationStyle) -> None:
    inks = Separator(model, replace(STANDARD, style=style)).separate(wanted)
    error = delta_e_2000(model.lab(inks), wanted)
    assert error.mean() < 0.05
    assert np.percentile(error, 95) < 0.1


@pytest.mark.parametrize("style", STYLES)
@pytest.mark.parametrize("count", [4, 6])
def test_limits_are_never_passed(model: PressModel, six: PressModel, style: SeparationStyle, count: int) -> None:
    press = model if count == 4 else six
    limits = (0.8, 0.5, 1.0, 0.6, 0.3, 0.9)[:count]
    separator = Separator(press, SeparationSettings(1.7, ink_limits=limits, style=style, tolerance=0.5))
    colours = np.random.default_rng(3).uniform([0, -128, -128], [100, 127, 127], (250, 3))
    inks = separator.separate(colours)
    near = separator.feasible(np.random.default_rng(4).random(inks.shape) * 2.0 - 0.5)
    for found in (inks, near, separator.follow(colours, near), separator.dark_ink[np.newaxis]):
        assert found.min() >= 0.0
        assert (found <= np.array(limits) + 1e-12).all()
        assert found.sum(axis=1).max() <= 1.7 + 1e-9


@pytest.mark.parametrize("count", [4, 6])
def test_least_ink_takes_no_more_than_standard(
    model: PressModel, six: PressModel, wanted: np.ndarray, count: int
) -> None:
    press = model if count == 4 else six
    prices = (1.0, 2.0, 1.0, 0.5, 3.0, 1.0)[:count]
    limits = SeparationSettings(LIMIT, prices=prices)
    usual = Separator(press, limits).separate(wanted)
    thrifty = Separator(press, replace(limits, style="least_ink")).separate(wanted)
    both = (delta_e_2000(press.lab(usual), wanted) < 0.1) & (delta_e_2000(press.lab(thrifty), wanted) < 0.1)
    assert both.mean() > 0.6
    cost = np.array(prices)
    # Each colour has more than one cheap recipe: a search from one place need not find the cheapest of all.
    assert (thrifty @ cost <= usual @ cost + 0.02)[both].mean() > (0.98 if count == 4 else 0.85)
    assert (thrifty @ cost)[both].sum() < 0.97 * (usual @ cost)[both].sum()


def test_prices_change_what_is_used(six: PressModel, wanted: np.ndarray) -> None:
    """A dear ink is left to the colours that need it."""
    even = Separator(six, LEAST).separate(wanted)
    for ink in (0, 1, 4):
        prices = [1.0] * 6
        prices[ink] = 8.0
        dear = Separator(six, replace(LEAST, prices=tuple(prices))).separate(wanted)
        assert dear[:, ink].sum() <= 1.01 * even[:, ink].sum()
        assert (dear @ prices).sum() <= (even @ prices).sum()
    # Only ratios count.
    again = Separator(six, replace(LEAST, prices=(7.0,) * 6)).separate(wanted[:50])
    np.testing.assert_allclose(again, even[:50], atol=1e-12)


def test_black_is_kept_out_of_highlights(model: PressModel) -> None:
    for settings in (STANDARD, LEAST):
        separator = Separator(model, settings)
        white, dark = separator.white_lab[0], separator.dark_lab[0]
        lightness = np.linspace(white, dark, 60)
        colours = np.column_stack([lightness, np.zeros(60), np.full(60, 2.0)])
        inks = separator.separate(colours)
        cap = black_cap(separator.depth(colours), settings)
        assert (inks[:, 3] <= cap + 1e-9).all()
        assert (inks[separator.depth(colours) <= settings.grain_start, 3] == 0.0).all()
        assert inks[-1, 3] > 0.5
    steps = np.linspace(0.0, 1.0, 101)
    cap = black_cap(steps, STANDARD)
    assert (np.diff(cap) >= 0.0).all()
    assert (cap[steps <= STANDARD.grain_start] == 0.0).all()
    assert (cap[steps >= STANDARD.grain_end] == 1.0).all()


def test_black_grows_towards_dark_neutrals(model: PressModel) -> None:
    separator = Separator(model, STANDARD)
    lightness = np.linspace(88.0, separator.dark_lab[0] + 8.0, 40)
    greys = np.column_stack([lightness, np.zeros(40), np.full(40, 1.0)])
    black = separator.separate(greys)[:, 3]
    assert black[0] < 0.02
    assert black[-1] > 0.5
    assert (np.diff(black) > -0.03).all()
    depth = np.linspace(0.0, 1.0, 50)
    wish = black_wish(depth, np.zeros(50), STANDARD)
    assert (np.diff(wish) >= 0.0).all()
    assert wish[-1] == STANDARD.black_most
    assert black_wish(np.ones(1), np.full(1, 40.0), STANDARD)[0] < 0.02


def test_colours_out_of_gamut_keep_their_hue(model: PressModel) -> None:
    hue = np.radians(np.arange(0.0, 360.0, 30.0))
    far = np.column_stack([np.full(12, 60.0), 100.0 * np.cos(hue), 100.0 * np.sin(hue)])

    def turned(weight: float) -> np.ndarray:
        found = model.lab(Separator(model, replace(STANDARD, hue_weight=weight)).separate(far))
        return np.abs(np.degrees(np.angle((found[:, 1] + 1j * found[:, 2]) / np.exp(1j * hue))))

    assert np.median(turned(2.0)) < 15.0
    assert turned(2.0).mean() < turned(1.0).mean()


def test_error_metric_is_ciede2000_in_the_small() -> None:
    draw = np.random.default_rng(6)
    # Away from the blues, where its rotation term counts.
    lab = draw.uniform([10, -10, 0], [90, 60, 60], (200, 3))
    step = draw.normal(0.0, 0.02, (200, 3))
    found = np.linalg.norm(np.einsum("pij,pj->pi", error_metric(lab, 1.0), step), axis=1)
    np.testing.assert_allclose(found, delta_e_2000(lab + step, lab), rtol=0.06, atol=1e-4)


@pytest.mark.parametrize("tolerance", [0.5, 1.5])
def test_colour_may_be_given_up_for_ink(model: PressModel, wanted: np.ndarray, tolerance: float) -> None:
    near = Separator(model, STANDARD).separate(wanted)
    exact = Separator(model, LEAST).follow(wanted, near)
    saving = Separator(model, replace(LEAST, tolerance=tolerance)).follow(wanted, near)
    moved = delta_e_2000(model.lab(saving), model.lab(exact))
    assert moved.max() < 1.5 * tolerance
    assert np.percentile(moved, 99) < 1.15 * tolerance
    assert saving.sum() < 0.95 * exact.sum()
    assert (saving.sum(axis=1) <= exact.sum(axis=1) + 1e-3).all()


def test_following_stays_near(model: PressModel, wanted: np.ndarray) -> None:
    separator = Separator(model, STANDARD)
    near = separator.separate(wanted)
    found = separator.follow(wanted, near)
    assert np.abs(found - near).max() < 0.03
    assert delta_e_2000(model.lab(found), wanted).mean() < 0.05
    # From a recipe of a colour nearby, to one nearby.
    moved = separator.follow(wanted + np.array([0.5, 0.0, 0.0]), near)
    assert np.percentile(np.abs(moved - near), 99) < 0.1


@pytest.mark.parametrize("style", STYLES)
def test_grids_are_smooth_and_exact(model: PressModel, style: SeparationStyle) -> None:
    separator = Separator(model, replace(STANDARD, style=style), threads=2)
    low, high = np.array([30.0, -6.0, -2.0]), np.array([75.0, 8.0, 14.0])

    def colours_at(nodes: int) -> np.ndarray:
        axes = [np.linspace(low[k], high[k], nodes) for k in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    grid = separator.separate_grid(colours_at, 19)
    assert grid.shape == (19, 19, 19, 4)
    assert grid.min() >= 0.0
    assert grid.sum(axis=-1).max() <= LIMIT + 1e-9
    assert delta_e_2000(model.lab(grid.reshape(-1, 4)), colours_at(19)).mean() < 0.15
    for axis in range(3):
        bends = np.abs(np.diff(grid, 2, axis=axis))
        assert np.median(bends) < 0.01
        assert np.percentile(bends, 99) < 0.1


def test_helpers_of_grids() -> None:
    grid = np.random.default_rng(7).random((4, 5, 6, 2))
    mean = neighbour_mean(grid)
    inner = grid[2, 2, 2]
    around = [grid[1, 2, 2], grid[3, 2, 2], grid[2, 1, 2], grid[2, 3, 2], grid[2, 2, 1], grid[2, 2, 3]]
    np.testing.assert_allclose(mean[2, 2, 2], np.mean(around, axis=0))
    np.testing.assert_allclose(mean[0, 0, 0], np.mean([grid[1, 0, 0], grid[0, 1, 0], grid[0, 0, 1]], axis=0))
    assert inner.shape == (2,)
    coarse = np.random.default_rng(8).random((5, 5, 5, 1))
    np.testing.assert_allclose(refined(coarse, 9)[::2, ::2, ::2], coarse, atol=1e-9)
    assert refined(coarse[:2, :2, :2], 3)[1, 1, 1] == pytest.approx(coarse[:2, :2, :2].mean())


def test_threads_and_runs_never_change_inks(model: PressModel) -> None:
    colours = np.random.default_rng(4).uniform([10, -30, -30], [90, 30, 40], (1100, 3))
    one = Separator(model, LEAST).separate(colours)
    assert np.array_equal(one, Separator(model, LEAST, threads=3).separate(colours))
    # Each colour alone, whatever stands beside it.
    assert np.array_equal(one[700:710], Separator(model, LEAST).separate(colours[700:710]))


@pytest.mark.parametrize("inks", [1, 2, 3])
def test_few_inks(inks: int) -> None:
    press = fitted("ceramic4", inks, 60)
    separator = Separator(press, SeparationSettings(min(LIMIT, float(inks)), black_channel=None))
    recipes = 0.1 + 0.6 * np.random.default_rng(5).random((60, inks))
    found = separator.separate(press.lab(recipes))
    np.testing.assert_allclose(found, recipes, atol=0.03)


def test_misuse_is_refused(model: PressModel) -> None:
    for settings, message in (
        (SeparationSettings(0.0), "total_limit"),
        (SeparationSettings(float("nan")), "total_limit"),
        (SeparationSettings(2.8, ink_limits=(1.0,)), "ink_limits"),
        (SeparationSettings(2.8, ink_limits=(1.0, 1.0, 0.0, 1.0)), "ink_limits"),
        (SeparationSettings(2.8, prices=(1.0, 1.0, -1.0, 1.0)), "prices"),
        (SeparationSettings(2.8, prices=(1.0, 2.0)), "prices"),
        (SeparationSettings(2.8, black_channel=7), "black_channel"),
    ):
        with pytest.raises(ValueError, match=message):
            Separator(model, settings)
    with pytest.raises(ValueError, match="lab_d50"):
        Separator(model, STANDARD).separate(np.zeros((5, 4)))
