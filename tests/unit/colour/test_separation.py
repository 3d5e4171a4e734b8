"""Turning the press round: accuracy in gamut, limits, black, smoothness, and tables."""

import numpy as np
import pytest

from sim.press import CeramicPress
from tilefab.colour.gamut import compress_chroma, compress_lightness
from tilefab.colour.lut import CURVE_ENTRIES, backward_axes, build_backward, build_forward
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.separation import SeparationSettings, Separator, black_wish
from tilefab.colour.spaces import absolute_lab, delta_e_2000, relative_lab

LIMIT = 2.6


@pytest.fixture(scope="module")
def model() -> PressModel:
    inks = np.vstack([np.random.default_rng(1).random((250, 4)), np.eye(4), np.zeros((1, 4))])
    inks = np.vstack([inks, [[float(bit) for bit in f"{corner:04b}"] for corner in range(16)]])
    return fit_press_model(inks, CeramicPress().lab(inks))


@pytest.fixture(scope="module")
def separator(model: PressModel) -> Separator:
    return Separator(model, SeparationSettings(LIMIT))


def test_printable_colours_are_met_within_the_limits(model: PressModel, separator: Separator) -> None:
    recipes = np.random.default_rng(2).random((600, 4))
    recipes = recipes[recipes.sum(axis=1) <= LIMIT]
    wanted = model.lab(recipes)
    inks = separator.separate(wanted)
    assert inks.min() >= 0.0
    assert inks.max() <= 1.0
    assert inks.sum(axis=1).max() <= LIMIT + 1e-9
    error = delta_e_2000(model.lab(inks), wanted)
    assert error.mean() < 0.05
    assert np.percentile(error, 95) < 0.2


def test_ink_limits_hold(model: PressModel) -> None:
    limits = (0.8, 0.5, 1.0, 0.6)
    narrow = Separator(model, SeparationSettings(2.0, ink_limits=limits))
    colours = np.random.default_rng(3).uniform([0, -80, -80], [100, 80, 80], (300, 3))
    inks = narrow.separate(colours)
    assert (inks <= np.array(limits) + 1e-12).all()
    assert inks.sum(axis=1).max() <= 2.0 + 1e-9


def test_out_of_gamut_colours_keep_their_hue(model: PressModel, separator: Separator) -> None:
    hue = np.radians(np.arange(0.0, 360.0, 30.0))
    wanted = np.column_stack([np.full(12, 60.0), 100.0 * np.cos(hue), 100.0 * np.sin(hue)])
    found = model.lab(separator.separate(wanted))
    turn = np.degrees(np.angle((found[:, 1] + 1j * found[:, 2]) / np.exp(1j * hue)))
    assert np.abs(turn).max() < 40.0
    assert np.abs(found[:, 0] - 60.0).max() < 35.0


def test_threads_never_change_inks(model: PressModel, separator: Separator) -> None:
    colours = np.random.default_rng(4).uniform([10, -30, -30], [90, 30, 40], (1500, 3))
    many = Separator(model, SeparationSettings(LIMIT), threads=3)
    assert np.array_equal(separator.separate(colours), many.separate(colours))


def test_black_grows_towards_dark_neutrals(model: PressModel, separator: Separator) -> None:
    lightness = np.linspace(90.0, 20.0, 29)
    greys = np.column_stack([lightness, np.zeros(29), np.full(29, 1.0)])
    inks = separator.separate(greys)
    assert inks[0, 3] < 0.02
    assert inks[-1, 3] > 0.7
    assert (np.diff(inks[:, 3]) > -0.02).all()
    wish = black_wish(greys, 93.0, 17.0, separator.settings)
    assert (np.diff(wish) >= 0.0).all()
    assert black_wish(np.array([[30.0, 40.0, 40.0]]), 93.0, 17.0, separator.settings)[0] < wish[-1] / 4


def test_separation_is_smooth_over_colour(model: PressModel, separator: Separator) -> None:
    """Along straight ways through the gamut, inks move in proportion to colour."""
    steps = np.linspace(0.0, 1.0, 60)[:, np.newaxis]
    for begin, end in (((85.0, 0.0, 8.0), (30.0, 2.0, 3.0)), ((60.0, -8.0, 5.0), (55.0, 12.0, 18.0))):
        inks = separator.separate(np.array(begin) * (1.0 - steps) + np.array(end) * steps)
        assert np.abs(np.diff(inks, axis=0)).max() < 0.12


def test_perceptual_curves_rise_and_leave_the_middle_alone() -> None:
    lightness = np.linspace(0.0, 100.0, 201)
    fitted = compress_lightness(lightness, 18.0)
    assert fitted[0] == pytest.approx(18.0)
    assert (np.diff(fitted) > 0.0).all()
    assert (fitted[lightness > 50.0] == lightness[lightness > 50.0]).all()
    chroma = np.linspace(0.0, 200.0, 401)
    squeezed = compress_chroma(chroma, np.full(401, 40.0))
    assert (np.diff(squeezed) > 0.0).all()
    assert squeezed.max() < 40.0
    assert (squeezed[chroma <= 32.0] == chroma[chroma <= 32.0]).all()


def test_tables_hold_what_they_say(model: PressModel, separator: Separator) -> None:
    forward = build_forward(model, 5)
    assert forward.grid.shape == (5, 5, 5, 5, 3)
    assert forward.curves.shape == (4, CURVE_ENTRIES)
    assert (np.diff(forward.curves, axis=1) >= 0.0).all()
    white = model.lab(np.zeros((1, 4)))[0]
    np.testing.assert_allclose(forward.grid[0, 0, 0, 0], [100.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(forward.grid[-1, 0, 0, 0], relative_lab(model.lab(np.eye(4)[:1]), white)[0], atol=1e-6)

    backward = build_backward(separator, 9)
    assert backward.relative.shape == backward.perceptual.shape == (9, 9, 9, 4)
    for table in (backward.relative, backward.perceptual):
        assert (table[-1, 4, 4] == 0.0).all()
        assert table.min() >= 0.0
        assert table.sum(axis=-1).max() <= LIMIT + 1e-9
    _, axes = backward_axes(9)
    assert axes[0][-1] == 100.0
    assert axes[1][4] == 0.0
    inside = np.argwhere(backward.gamut == 0.0)
    assert len(inside) > 5
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)[tuple(inside.T)]
    error = delta_e_2000(model.lab(backward.relative[tuple(inside.T)]), absolute_lab(nodes, white))
    assert error.max() < 1.05
    assert backward.gamut[4, 0, 0] > 0.1


def test_misuse_is_refused(model: PressModel, separator: Separator) -> None:
    for settings in (
        SeparationSettings(0.0),
        SeparationSettings(2.8, ink_limits=(1.0,)),
        SeparationSettings(2.8, black_channel=7),
    ):
        with pytest.raises(ValueError):
            Separator(model, settings)
    with pytest.raises(ValueError, match="grid"):
        separator.separate(np.zeros((5, 3)), (2, 2, 2))
    with pytest.raises(ValueError, match="grid"):
        build_forward(model, 1)
    with pytest.raises(ValueError, match="grid"):
        build_backward(separator, 2)
