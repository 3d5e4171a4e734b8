"""Grades and reasons."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tilefab.inspection.grading import Tolerances, grade_tile
from tilefab.inspection.records import ColourFigures, Defect, DefectKind, Grade, TileDimensions

COLOUR = ColourFigures(1.0, 2.0, 4.0, (10.0, 20.0), 0.8, 1.6, 0.1, 0.2, 0.3, (60.0, 1.0, 5.0), (60.0, 1.0, 5.0))
SIZE = TileDimensions((150.0,) * 4, 150.0, 150.0, 0.1, 0.05, 0.03, 0.05, 0.03, True)
SPOT = Defect(DefectKind.SPOT, 12.0, 34.5, 0.5, 0.5, 0.2, 6.0, 2.0, Grade.SECOND)
NONE = Tolerances()


def test_a_good_tile() -> None:
    assert grade_tile(COLOUR, SIZE, (), (0.3, -0.4), NONE) == (Grade.FIRST, ())


def test_nothing_measured_is_nothing_wrong() -> None:
    assert grade_tile(None, None, (), (0.0, 0.0), NONE) == (Grade.FIRST, ())


@pytest.mark.parametrize(
    ("colour", "size", "shift", "grade", "said"),
    [
        ({"delta_e_mean": 3.5}, {}, (0.0, 0.0), Grade.SECOND, "mean ΔE2000 3.5"),
        ({"delta_e_mean": 6.1}, {}, (0.0, 0.0), Grade.SCRAP, "mean ΔE2000 6.1"),
        ({"delta_e_p95": 7.0}, {}, (0.0, 0.0), Grade.SECOND, "on 5 % of it"),
        ({}, {"size_deviation_percent": -0.7}, (0.0, 0.0), Grade.SECOND, "size -0.70 %"),
        ({}, {"straightness_percent": 1.2}, (0.0, 0.0), Grade.SCRAP, "straight"),
        ({}, {"rectangularity_percent": -0.6}, (0.0, 0.0), Grade.SECOND, "square"),
        ({}, {}, (0.5, -2.5), Grade.SECOND, "print -2.5 mm off"),
    ],
)
def test_each_tolerance(
    colour: dict[str, float], size: dict[str, float], shift: tuple[float, float], grade: Grade, said: str
) -> None:
    found, reasons = grade_tile(replace(COLOUR, **colour), replace(SIZE, **size), (), shift, NONE)
    assert found is grade
    assert len(reasons) == 1
    assert said in reasons[0]


def test_on_the_tolerance_is_first_choice() -> None:
    at = replace(COLOUR, delta_e_mean=NONE.delta_e_mean, delta_e_p95=NONE.delta_e_p95)
    assert grade_tile(at, None, (), (2.0, -2.0), NONE)[0] is Grade.FIRST


def test_size_without_a_scale_does_not_count() -> None:
    size = replace(SIZE, size_deviation_percent=5.0, scale_known=False)
    assert grade_tile(None, size, (), (0.0, 0.0), NONE)[0] is Grade.FIRST


def test_the_gravest_reason_comes_first() -> None:
    crack = replace(SPOT, kind=DefectKind.CRACK, grade=Grade.SCRAP)
    grade, reasons = grade_tile(replace(COLOUR, delta_e_mean=4.0), None, (SPOT, crack), (0.0, 0.0), NONE)
    assert grade is Grade.SCRAP
    assert [reason.split()[0] for reason in reasons] == ["crack", "mean", "spot"]
    assert "(12.0, 34.5) mm" in reasons[2]


def test_defects_of_first_choice_do_not_count() -> None:
    assert grade_tile(None, None, (replace(SPOT, grade=Grade.FIRST),), (0.0, 0.0), NONE) == (Grade.FIRST, ())


def test_many_reasons_are_summed_up() -> None:
    _, reasons = grade_tile(None, None, (SPOT,) * 20, (0.0, 0.0), NONE)
    assert len(reasons) == 7
    assert reasons[-1] == "14 more"


def test_tolerances_are_positive() -> None:
    with pytest.raises(ValueError, match="shift_mm must be above 0"):
        Tolerances(shift_mm=0.0)
