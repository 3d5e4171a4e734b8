"""Charts that can't be believed, and charts that can."""

import os
from pathlib import Path

import numpy as np
import pytest

from sim.instrument import measure
from sim.spectral_press import SpectralPress
from tilefab.colour.chart_checks import ChartFindings, check_chart
from tilefab.colour.press_model import fit_press_model
from tilefab.colour.spaces import delta_e_2000
from tilefab.io.cgats import read_measurements

DEMO = Path(__file__).parents[3] / "profiles" / "demo_ceramic.ti3"
REAL = os.environ.get("TILEFAB_MEASUREMENTS")
NAMES = ("Blue", "Brown", "Yellow", "Black")


def judged(recipes: np.ndarray, lab: np.ndarray, names: tuple[str, ...] = NAMES) -> ChartFindings:
    ids = [f"P{row}" for row in range(len(recipes))]
    return check_chart(fit_press_model(recipes, lab), recipes, lab, names, ids)


@pytest.fixture(scope="module")
def chart() -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(1)
    recipes = draw.random((260, 4)) ** 1.4
    recipes[:5] = np.vstack([np.zeros((1, 4)), np.eye(4)])
    for ink in range(4):
        recipes[5 + 7 * ink : 12 + 7 * ink] = np.linspace(0.1, 0.95, 7)[:, np.newaxis] * np.eye(4)[ink]
    recipes[-12:] = recipes[:12]
    return recipes, measure(SpectralPress("ceramic4"), recipes, draw, lab_noise=0.25)


def test_a_good_chart_gives_no_words(chart: tuple[np.ndarray, np.ndarray]) -> None:
    found = judged(*chart)
    assert found.refusal is None
    assert found.warnings == ()
    assert not found.outliers.any()


def test_the_demo_chart_gives_no_words() -> None:
    demo = read_measurements(DEMO)
    found = judged(demo.ink_frac[::2], demo.lab_d50[::2], demo.ink_names)
    assert (found.refusal, found.warnings) == (None, ())
    assert not found.outliers.any()


@pytest.mark.skipif(REAL is None, reason="TILEFAB_MEASUREMENTS is not set")
@pytest.mark.parametrize("name", ["FOGRA29L", "FOGRA39L", "TR003", "TR005", "TR006"])
def test_real_charts_give_no_words(name: str) -> None:
    real = read_measurements(Path(REAL or "") / f"{name}.ti3")
    rows = np.random.default_rng(3).permutation(len(real.ink_frac))[:450]
    found = judged(real.ink_frac[rows], real.lab_d50[rows], real.ink_names)
    assert found.refusal is None
    assert found.warnings == ()


def test_swapped_patches_are_named(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes, lab = chart[0], chart[1].copy()
    assert delta_e_2000(lab[60], lab[61]) > 8.0
    lab[[60, 61]] = lab[[61, 60]]
    found = judged(recipes, lab)
    assert found.refusal is None
    assert any("P60 and P61 seem to be swapped" in words for words in found.warnings)
    assert found.outliers[[60, 61]].all()
    assert found.outliers.sum() == 2


def test_an_outlier_is_named_and_left_out(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes, lab = chart[0], chart[1].copy()
    lab[77] += [12.0, -6.0, 5.0]
    found = judged(recipes, lab)
    assert found.refusal is None
    assert any(words.startswith("patch P77 (ΔE") and "fits nothing" in words for words in found.warnings)
    assert np.flatnonzero(found.outliers).tolist() == [77]


def test_many_outliers_are_counted(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes, lab = chart[0], chart[1].copy()
    rows = np.arange(50, 220, 20)
    lab[rows] += np.random.default_rng(4).choice([-15.0, 15.0], (len(rows), 3))
    found = judged(recipes, lab)
    assert found.outliers[rows].mean() > 0.8
    assert any("and" in words and "more: measure them again" in words for words in found.warnings)


def test_exchanged_columns_are_refused() -> None:
    demo = read_measurements(DEMO)
    exchanged = demo.ink_frac[:, [0, 1, 3, 2]]
    found = judged(exchanged[::2], demo.lab_d50[::2], demo.ink_names)
    assert found.refusal is not None
    assert "Black" in found.refusal
    assert "order" in found.refusal


def test_shifted_rows_are_refused(chart: tuple[np.ndarray, np.ndarray]) -> None:
    found = judged(chart[0], np.roll(chart[1], 1, axis=0))
    assert found.refusal is not None


def test_two_presses_in_one_chart_are_refused(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes, lab = chart
    cmyk = SpectralPress("offset4").lab(recipes)
    found = judged(np.vstack([recipes, recipes]), np.vstack([lab, cmyk]))
    assert found.refusal is not None
    assert "different presses" in found.refusal


def test_repeats_that_disagree_are_told(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes, lab = chart[0], chart[1].copy()
    lab[-3] += [6.0, 0.0, 0.0]
    found = judged(recipes, lab)
    assert found.refusal is None
    assert any("one recipe disagree" in words and "P257" in words for words in found.warnings)


def test_clipped_inks_are_told(chart: tuple[np.ndarray, np.ndarray]) -> None:
    recipes = chart[0]
    laid = recipes.copy()
    laid[:, 3] = np.minimum(laid[:, 3], 0.55)
    lab = measure(SpectralPress("ceramic4"), laid, np.random.default_rng(5), lab_noise=0.1)
    found = judged(recipes, lab)
    assert found.refusal is None
    assert any("ink Black no longer changes the colour above" in words for words in found.warnings)
    assert len(found.warnings) == 1


def test_names_that_don_t_suit_the_colours_are_told(chart: tuple[np.ndarray, np.ndarray]) -> None:
    found = judged(*chart, ("Yellow", "Brown", "Blue", "Black"))
    assert found.refusal is None
    assert any("ink Yellow" in words and "nobody calls yellow" in words for words in found.warnings)


def test_a_chart_of_one_colour_is_refused(chart: tuple[np.ndarray, np.ndarray]) -> None:
    found = judged(chart[0], np.full_like(chart[1], 50.0))
    assert found.refusal is not None
    assert "one colour" in found.refusal
