"""Figures and verdicts of a line report, counted by hand where that can be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.line_report_samples import BEGUN_S, empty, typical
from tilefab.inspection.records import ColourFigures, Defect, DefectKind, Grade
from tilefab.report.line_figures import (
    GROUP,
    TileCounts,
    colour_series,
    count_tiles,
    defect_counts,
    grouped,
    line_figures,
    loop_statistics,
    shift_figures,
    union_s,
)
from tilefab.report.line_verdicts import line_verdicts
from tilefab.report.line_view import (
    CorrectionView,
    InkUseView,
    InnovationView,
    LimitsView,
    LineReportView,
    LotView,
    ShiftView,
    SpanView,
    TileView,
)
from tilefab.report.profile_view import VerdictView


@pytest.fixture(scope="module")
def shift() -> LineReportView:
    return typical(300)


def colour(mean: float, p95: float = 2.0, fired: float = 50.5) -> ColourFigures:
    return ColourFigures(mean, p95, 3.0, (1.0, 2.0), mean, p95, 0.5, 0.0, 0.0, (fired, 1.0, 2.0), (50.0, 1.0, 2.0))


def defect(kind: DefectKind, grade: Grade) -> Defect:
    return Defect(kind, 10.0, 10.0, 1.0, 1.0, 1.0, 5.0, 2.0, grade)


def tile(
    face: int, at_s: float | None, mean: float | None = None, grade: Grade | None = None, *found: Defect
) -> TileView:
    figures = None if mean is None else colour(mean)
    return TileView(face, face + 1, 0, BEGUN_S, at_s, "", grade, figures, None, found)


TILES = (
    tile(0, BEGUN_S + 30.0, 1.0, Grade.FIRST),
    tile(
        1,
        BEGUN_S + 10.0,
        2.0,
        Grade.SECOND,
        defect(DefectKind.SPOT, Grade.SECOND),
        defect(DefectKind.SPOT, Grade.FIRST),
    ),
    tile(2, BEGUN_S + 20.0, 3.0, Grade.SCRAP, defect(DefectKind.CRACK, Grade.SCRAP)),
    tile(3, None),
    tile(4, BEGUN_S + 40.0, None, Grade.FIRST, defect(DefectKind.SPOT, Grade.FIRST)),
)


def test_tiles_are_counted() -> None:
    assert count_tiles(TILES) == TileCounts(printed=5, fired=4, inspected=4, first=2, second=1, scrap=1, waiting=1)
    assert count_tiles(TILES).share_first == 0.5
    assert count_tiles(()).share_first is None


def test_series_is_in_order_of_firing() -> None:
    series = colour_series(TILES)
    assert (series.at_s - BEGUN_S).tolist() == [10.0, 20.0, 30.0]
    assert series.delta_e.tolist() == [2.0, 3.0, 1.0]
    assert series.difference_lab.tolist() == [[0.5, 0.0, 0.0]] * 3
    assert colour_series(()).difference_lab.shape == (0, 3)


def test_defects_are_counted_by_tile_and_by_what_they_cost() -> None:
    assert defect_counts(TILES) == ((DefectKind.SPOT, 3, 2, 1), (DefectKind.CRACK, 1, 1, 1))
    assert defect_counts(()) == ()


@pytest.mark.parametrize(
    ("spans", "seconds"),
    [
        ([], 0.0),
        ([(0.0, 10.0), (5.0, 20.0)], 20.0),
        ([(5.0, 20.0), (0.0, 10.0), (12.0, 13.0)], 20.0),
        ([(-50.0, 10.0), (90.0, None)], 20.0),
        ([(90.0, 500.0), (200.0, 300.0)], 10.0),
    ],
)
def test_stops_that_overlap_count_once(spans: list[tuple[float, float | None]], seconds: float) -> None:
    assert union_s([SpanView(begun, ended, "", "") for begun, ended in spans], 0.0, 100.0) == seconds


def test_figures_of_the_first_page() -> None:
    view = replace(
        empty(),
        tiles=TILES,
        ended_s=BEGUN_S + 100.0,
        limits=LimitsView(2.5, None),
        downtime=(SpanView(BEGUN_S + 80.0, None, "printer", "stopped"),),
        corrections=(CorrectionView(1, BEGUN_S, "", "", 0.4), CorrectionView(2, BEGUN_S, "", "", 1.1)),
        inks=(InkUseView("a", 3.0, 1.0), InkUseView("b", 2.0)),
    )
    figures = line_figures(view)
    assert figures.delta_e_mean == pytest.approx(2.0)
    assert figures.share_within == pytest.approx(2.0 / 3.0)
    assert figures.drift_delta_e == 1.1
    assert (figures.downtime_s, figures.availability) == pytest.approx((20.0, 0.8))
    assert (figures.ink_used, figures.ink_saved) == (5.0, 1.0)
    assert figures.capability is not None
    assert figures.capability.ppk == pytest.approx(0.5 / 3.0)


def test_figures_of_nothing() -> None:
    figures = line_figures(empty())
    assert (figures.delta_e_mean, figures.share_within, figures.capability, figures.ink_used) == (None,) * 4
    assert figures.availability == 1.0


def test_shifts_divide_the_tiles() -> None:
    shifts = (ShiftView("one", BEGUN_S, BEGUN_S + 25.0), ShiftView("two", BEGUN_S + 25.0, BEGUN_S + 100.0))
    made = (CorrectionView(1, BEGUN_S + 50.0, ""),)
    rows = shift_figures(replace(empty(), tiles=TILES, shifts=shifts, corrections=made, ended_s=BEGUN_S + 100.0))
    assert [name for name, _, _ in rows] == ["one", "two"]
    assert [figures.counts.printed for _, figures, _ in rows] == [3, 2]
    assert [figures.counts.fired for _, figures, _ in rows] == [2, 2]
    assert [figures.delta_e_mean for _, figures, _ in rows] == [2.5, 1.0]
    assert [corrections for _, _, corrections in rows] == [0, 1]


def test_shifts_of_a_lifelike_run_add_up(shift: LineReportView) -> None:
    middle = (shift.begun_s + shift.ended_s) / 2
    halves = (ShiftView("a", shift.begun_s - 1e5, middle), ShiftView("b", middle, shift.ended_s + 1e5))
    rows = shift_figures(replace(shift, shifts=halves))
    whole = line_figures(shift).counts
    assert sum(figures.counts.first for _, figures, _ in rows) == whole.first
    assert sum(figures.counts.printed for _, figures, _ in rows) == whole.printed
    assert sum(corrections for _, _, corrections in rows) == len(shift.corrections)


def test_groups_are_of_neighbours() -> None:
    at_s, values = np.arange(2.0 * GROUP + 3), np.arange(2.0 * GROUP + 3)
    found = grouped(at_s, values)
    assert found is not None
    assert found.mean.tolist() == [2.0, 7.0]
    assert found.range.tolist() == [4.0, 4.0]
    assert found.at_s.tolist() == [2.0, 7.0]
    assert grouped(at_s[:9], values[:9]) is None


def test_loop_charts_only_what_was_believed() -> None:
    generator = np.random.default_rng(3)
    told = [InnovationView(float(place), float(value)) for place, value in enumerate(generator.normal(0, 1, 400))]
    told[100] = InnovationView(100.0, 40.0, False)
    loop = loop_statistics(told)
    assert loop is not None
    assert (len(loop.values), loop.rejected, len(loop.signals)) == (399, 1, 399)
    assert loop.values.max() < 40.0
    assert loop.chance == pytest.approx((399 / 370.4, 399 / 500, 399 / 465), rel=0.01)
    assert loop.groups is not None
    assert loop_statistics(()) is None
    refused = loop_statistics([InnovationView(0.0, 9.0, False)])
    assert refused is not None
    assert (refused.counts, refused.groups) == ((0, 0, 0), None)


def by_what(view: LineReportView) -> dict[str, VerdictView]:
    loop = loop_statistics(view.innovations)
    return {verdict.what: verdict for verdict in line_verdicts(view, line_figures(view), loop)}


def test_nothing_is_judged_without_figures() -> None:
    found = by_what(empty())
    assert {verdict.grade for verdict in found.values()} == {"none"}
    assert set(found) == {"Colour", "Quality", "Control", "Shade", "Recognition", "Line"}


def many(count: int, mean: float, grade: Grade, *found: Defect) -> tuple[TileView, ...]:
    return tuple(tile(place, BEGUN_S + place, mean, grade, *found) for place in range(count))


@pytest.mark.parametrize(
    ("bad", "colour_grade", "quality"), [(0, "good", "good"), (4, "fair", "fair"), (20, "poor", "poor")]
)
def test_colour_and_quality_are_graded(bad: int, colour_grade: str, quality: str) -> None:
    crack = defect(DefectKind.CRACK, Grade.SCRAP)
    tiles = many(100 - bad, 1.0, Grade.FIRST) + many(bad, 9.0, Grade.SCRAP, crack)
    view = replace(empty(), tiles=tiles, limits=LimitsView(1.5, 3.0), ended_s=BEGUN_S + 1e4)
    found = by_what(view)
    assert (found["Colour"].grade, found["Quality"].grade) == (colour_grade, quality)
    assert ("crack" in found["Quality"].text) == (bad > 0)
    assert found["Line"].grade == "good"


def test_a_hold_that_lasts_is_poor_control() -> None:
    hold = SpanView(BEGUN_S, None, "stale", "no tile for an hour")
    told = tuple(InnovationView(BEGUN_S + place, (-1.0) ** place) for place in range(100))
    view = replace(empty(), innovations=told, ended_s=BEGUN_S + 200.0)
    assert by_what(view)["Control"].grade == "good"
    held = by_what(replace(view, holds=(hold,)))["Control"]
    assert held.grade == "poor"
    assert "no tile for an hour" in held.text
    assert by_what(replace(view, holds=(replace(hold, ended_s=BEGUN_S + 9.0),)))["Control"].grade == "fair"
    shifted = tuple(replace(one, value=1.6) for one in told)
    assert by_what(replace(view, innovations=shifted))["Control"].grade == "fair"


def test_recognition_and_shade_are_graded() -> None:
    lots = tuple(LotView(name, tiles, (0.0, 0.0, 0.0), 0.2, 0.0, 1.0) for name, tiles in (("A", 70), ("B", 30)))
    view = replace(
        empty(),
        tiles=many(94, 1.0, Grade.FIRST),
        unreadable=(("black", 4),),
        strangers=2,
        lots=lots,
        ended_s=BEGUN_S + 200,
    )
    found = by_what(view)
    assert (found["Recognition"].grade, found["Shade"].grade) == ("fair", "fair")
    assert "94 of 100" in found["Recognition"].text
    assert "lot A holds 70 %" in found["Shade"].text
    assert by_what(replace(view, lots=lots[:1]))["Shade"].grade == "good"


def test_long_stops_are_poor() -> None:
    stops = (
        SpanView(BEGUN_S, BEGUN_S + 30.0, "printer", "head crash"),
        SpanView(BEGUN_S + 50.0, BEGUN_S + 51.0, "x", "y"),
    )
    found = by_what(replace(empty(), downtime=stops, ended_s=BEGUN_S + 100.0))["Line"]
    assert found.grade == "poor"
    assert "head crash" in found.text
    assert "69 %" in found.text
