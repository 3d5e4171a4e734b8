"""What can't be drawn is refused, and the message names the field."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tilefab.errors import ReportError
from tilefab.report import HistogramView, InkView, PictureView, RunReportView, SwatchView, build_run_report

NAN = float("nan")


def with_colour(view: RunReportView, **changes: Any) -> RunReportView:
    return replace(view, colour=replace(view.colour, **changes))


def with_map(view: RunReportView, **changes: Any) -> RunReportView:
    return replace(view, texture_map=replace(view.texture_map, **changes))


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4), np.uint8),
        np.zeros((4, 4, 4), np.uint8),
        np.zeros((4, 4, 3), np.float32),
        np.zeros((0, 4, 3), np.uint8),
        None,
    ],
)
def test_pictures_of_another_kind(minimal: RunReportView, image: Any) -> None:
    with pytest.raises(ReportError, match="wall_preview"):
        build_run_report(replace(minimal, wall_preview=image))
    pictures = minimal.texture_map.pictures[0], PictureView("", "", image)
    with pytest.raises(ReportError, match=r"texture_map\.pictures\[1\]\.image"):
        build_run_report(with_map(minimal, pictures=pictures))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("delta_e_mean", NAN),
        ("delta_e_p95", float("inf")),
        ("ink_limit_percent", -1.0),
        ("max_total_ink_percent", NAN),
        ("mean_total_ink_percent", -0.1),
        ("share_limited", 1.5),
        ("out_of_gamut_share", -0.1),
    ],
)
def test_figures_out_of_range(minimal: RunReportView, field: str, value: float) -> None:
    with pytest.raises(ReportError, match=f"colour.{field}"):
        build_run_report(with_colour(minimal, **{field: value}))


def test_inks_and_swatches_with_figures_out_of_range(minimal: RunReportView) -> None:
    with pytest.raises(ReportError, match=r"inks\[1\]"):
        build_run_report(with_colour(minimal, inks=(InkView("a", 1, 2, 0.01), InkView("b", NAN, 2, 0.01))))
    good = SwatchView((50.0, 0.0, 0.0), (50.0, 0.0, 0.0), 0.0, 1.0, (0, 0, 0), (0, 0, 0))
    for bad in (
        replace(good, lab_slab=(NAN, 0.0, 0.0)),
        replace(good, delta_e_2000=-1.0),
        replace(good, share=2.0),
        replace(good, rgb_printed=(0, 0, 256)),
    ):
        with pytest.raises(ReportError, match=r"swatches\[0\]"):
            build_run_report(with_colour(minimal, swatches=(bad,)))


@pytest.mark.parametrize(
    ("field", "table"),
    [
        ("slab_lab_sample", np.zeros((5, 2))),
        ("slab_lab_sample", np.full((5, 3), NAN)),
        ("gamut_ab", np.zeros(4)),
        ("gamut_lc", np.full((2, 2), np.inf)),
        ("gamut_lc", np.array([["a", "b"]])),
    ],
)
def test_tables_of_another_kind(minimal: RunReportView, field: str, table: Any) -> None:
    with pytest.raises(ReportError, match=f"colour.{field}"):
        build_run_report(with_colour(minimal, **{field: table}))


@pytest.mark.parametrize(
    ("edges", "counts"),
    [
        ([0.0, 1.0], [1, 2]),
        ([0.0, 0.0, 1.0], [1, 2]),
        ([0.0, NAN], [1]),
        ([0.0, 1.0], [-1]),
        ([[0.0, 1.0]], [1]),
    ],
)
def test_histograms_that_are_none(minimal: RunReportView, edges: Any, counts: Any) -> None:
    bad = HistogramView(np.array(edges), np.array(counts))
    good = minimal.texture_map.charts[0]
    with pytest.raises(ReportError, match=r"charts\[1\]\.histogram"):
        build_run_report(with_map(minimal, charts=(good, replace(good, histogram=bad))))


@pytest.mark.parametrize("count", [0, 5])
def test_too_few_or_too_many_pictures(minimal: RunReportView, count: int) -> None:
    with pytest.raises(ReportError, match=r"texture_map\.pictures"):
        build_run_report(with_map(minimal, pictures=minimal.texture_map.pictures * count))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_another_number_of_charts(minimal: RunReportView, count: int) -> None:
    with pytest.raises(ReportError, match=r"texture_map\.charts"):
        build_run_report(with_map(minimal, charts=(minimal.texture_map.charts * 2)[:count]))


@pytest.mark.parametrize("code", ["", "x" * 1990, "x" * 5000, "\udc80"])
def test_codes_that_give_no_readable_square(minimal: RunReportView, code: str) -> None:
    with pytest.raises(ReportError, match="code"):
        build_run_report(replace(minimal, faces=(replace(minimal.faces[0], code=code),)))


def test_hashes_too_long_for_the_cover(minimal: RunReportView) -> None:
    with pytest.raises(ReportError, match="too long"):
        build_run_report(replace(minimal, map_hash="0f" * 600))


def test_no_contact_sheet_at_all(minimal: RunReportView) -> None:
    with pytest.raises(ReportError, match="max_contact_faces"):
        build_run_report(replace(minimal, max_contact_faces=0))
