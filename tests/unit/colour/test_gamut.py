"""Gamut boundaries, and the perceptual way into them."""

import numpy as np
import pytest

from sim.press import CeramicPress
from tilefab.colour.gamut import (
    GamutBoundary,
    boundary_of,
    compress_chroma,
    compress_lightness,
    image_boundary,
    perceptual_map,
    press_boundary,
)
from tilefab.colour.hue_linear import lab_from_oklab, oklab_from_lab
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.separation import SeparationSettings, Separator
from tilefab.colour.spaces import relative_lab


def round_boundary(chroma: float, dark: float = 0.25) -> GamutBoundary:
    return GamutBoundary(dark, 1.0, np.full((33, 48), chroma))


def colours(count: int, most_chroma: float, seed: int, lightness: tuple[float, float] = (0.35, 0.95)) -> np.ndarray:
    """Lab of random Oklab colours."""
    draw = np.random.default_rng(seed)
    hue, chroma = draw.uniform(0.0, 2.0 * np.pi, count), most_chroma * np.sqrt(draw.random(count))
    return lab_from_oklab(
        np.column_stack([draw.uniform(*lightness, count), chroma * np.cos(hue), chroma * np.sin(hue)])
    )


def parts(lab: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    oklab = oklab_from_lab(lab)
    return oklab[:, 0], np.hypot(oklab[:, 1], oklab[:, 2]), np.arctan2(oklab[:, 2], oklab[:, 1])


def test_boundary_finds_the_chroma_of_a_cylinder() -> None:
    lab = colours(60_000, 0.1, 1)
    found = boundary_of(lab)
    assert found.dark == pytest.approx(0.35, abs=0.002)
    assert found.light == pytest.approx(0.95, abs=0.002)
    assert found.chroma.shape == (33, 48)
    assert found.chroma.max() <= 0.1 + 1e-9
    assert np.median(found.chroma) > 0.095
    lightness, chroma, hue = parts(lab)
    assert (chroma <= found.chroma_at(lightness, hue) * 1.1).mean() > 0.99
    # Turning once round changes nothing.
    np.testing.assert_allclose(found.chroma_at(lightness, hue), found.chroma_at(lightness, hue + 2 * np.pi), atol=1e-12)


def test_boundary_of_few_colours_is_filled() -> None:
    one = boundary_of(np.array([[60.0, 20.0, 10.0]]))
    assert np.isfinite(one.chroma).all()
    assert one.chroma.max() == pytest.approx(one.chroma.min())


def test_stray_colours_of_an_image_are_left_out() -> None:
    lab = colours(60_000, 0.08, 2)
    stray = colours(60, 0.3, 3, (0.05, 0.95))
    whole, robust = boundary_of(np.vstack([lab, stray])), image_boundary(np.vstack([lab, stray]))
    assert whole.dark < 0.2 < 0.3 < robust.dark
    assert whole.chroma.max() > 0.2
    assert np.percentile(robust.chroma, 95) < 0.1


@pytest.mark.parametrize(("source", "dark"), [(0.0, 0.2), (0.1, 0.35), (0.0, 0.6)])
def test_lightness_rises_smoothly_into_the_gamut(source: float, dark: float) -> None:
    lightness = np.linspace(source, 1.0, 2001)
    fitted = compress_lightness(lightness, source, dark)
    assert fitted[0] == pytest.approx(dark)
    assert (np.diff(fitted) > 0.0).all()
    assert (fitted >= lightness - 1e-12).all()
    above = lightness > dark + 0.35 * (1.0 - dark) + 1e-9
    assert np.array_equal(fitted[above], lightness[above])
    # No kink where the toe begins.
    slopes = np.diff(fitted) / np.diff(lightness)
    assert np.abs(np.diff(slopes)).max() < 0.02


def test_lightness_stays_where_the_press_is_as_dark() -> None:
    lightness = np.linspace(0.0, 1.0, 11)
    assert np.array_equal(compress_lightness(lightness, 0.3, 0.3), lightness)
    assert np.array_equal(compress_lightness(lightness, 0.4, 0.3), lightness)


def test_chroma_is_compressed_just_as_far_as_needed() -> None:
    chroma, most = np.linspace(0.0, 0.4, 4001), np.full(4001, 0.1)
    endless = compress_chroma(chroma, most, None)
    assert (np.diff(endless) > 0.0).all()
    assert endless.max() < 0.1
    assert np.array_equal(endless[chroma <= 0.08], chroma[chroma <= 0.08])
    for source in (0.12, 0.2, 0.4):
        bounded = compress_chroma(chroma, most, np.full(4001, source))
        inside = chroma <= source
        assert (np.diff(bounded[inside]) > 0.0).all()
        assert bounded[inside].max() <= 0.1 + 1e-9
        assert np.interp(source, chroma, bounded) == pytest.approx(0.1, rel=1e-3)
        assert (bounded >= endless - 1e-12).all()
    within = chroma <= 0.09
    assert np.allclose(compress_chroma(chroma, most, np.full(4001, 0.09))[within], chroma[within], atol=1e-12)


def test_an_image_inside_the_gamut_is_left_as_it_is() -> None:
    lab = colours(20_000, 0.07, 4)
    fitted = perceptual_map(round_boundary(0.12), image_boundary(lab))(lab)
    np.testing.assert_allclose(fitted, lab, atol=1e-6)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("vivid", [False, True])
def test_colours_are_brought_in_with_their_hue(known: bool, vivid: bool) -> None:
    lab = colours(20_000, 0.25, 5, (0.05, 1.0))
    press = round_boundary(0.1)
    fitted = perceptual_map(press, boundary_of(lab) if known else None, vivid=vivid)(lab)
    before, after = parts(lab), parts(fitted)
    assert after[1].max() < 0.1 * 1.05
    assert after[0].min() > 0.25 - 1e-6
    coloured = before[1] > 0.005
    turn = np.angle(np.exp(1j * (after[2] - before[2])))[coloured]
    assert np.abs(turn).max() < 1e-5
    # Lightness alone decides lightness, and its order stays.
    order = np.argsort(before[0])
    assert (np.diff(after[0][order]) > -1e-9).all()


def test_saturation_is_more_vivid_than_perceptual() -> None:
    lab = colours(2000, 0.06, 6)
    press = round_boundary(0.12)
    calm, vivid = parts(perceptual_map(press)(lab))[1], parts(perceptual_map(press, vivid=True)(lab))[1]
    np.testing.assert_allclose(vivid, 1.2 * calm, rtol=1e-6)


def test_white_and_black_go_to_their_places() -> None:
    fit = perceptual_map(round_boundary(0.1))
    ends = fit(np.array([[100.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(ends[0], [100.0, 0.0, 0.0], atol=0.05)
    assert oklab_from_lab(ends[1])[0] == pytest.approx(0.25, abs=1e-6)


@pytest.fixture(scope="module")
def model() -> PressModel:
    inks = np.vstack([np.random.default_rng(1).random((220, 4)) ** 1.3, np.eye(4), np.zeros((1, 4)), np.ones((1, 4))])
    return fit_press_model(inks, CeramicPress().lab(inks))


def test_boundary_of_a_press_holds_what_it_prints(model: PressModel) -> None:
    separator = Separator(model, SeparationSettings(2.8))
    found = press_boundary(separator)
    draw = np.random.default_rng(2)
    recipes = separator.feasible(draw.random((4000, 4)) * (draw.random((4000, 4)) < 0.6))
    lightness, chroma, hue = parts(relative_lab(model.lab(recipes), model.white_lab))
    over = chroma - found.chroma_at(lightness, hue)
    assert (over < 0.012).mean() > 0.97
    # The solid inks lie near it.
    lightness, chroma, hue = parts(relative_lab(model.lab(np.eye(4)[:3]), model.white_lab))
    np.testing.assert_allclose(found.chroma_at(lightness, hue), chroma, atol=0.025)
    assert found.light == pytest.approx(1.0, abs=1e-3)
    dark = oklab_from_lab(relative_lab(separator.dark_lab, model.white_lab))[0]
    assert found.dark == pytest.approx(dark, abs=0.02)
    # Less ink reaches less far.
    tight = press_boundary(Separator(model, SeparationSettings(1.0, ink_limits=(0.5,) * 4)))
    assert tight.chroma.mean() < 0.9 * found.chroma.mean()
    assert tight.dark > found.dark
