"""Lists of charts: what is written is read back, and edited lists are refused."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from tilefab.chart import ChartDesign, ChartLayout, design_chart, lay_out_chart
from tilefab.errors import ProfileError
from tilefab.io.chart_list import chart_text, parse_chart, read_chart_list
from tilefab.types import SizeMm


def make(inks: int) -> tuple[ChartDesign, ChartLayout, str]:
    design = design_chart(inks, 60, total_limit_percent=min(100.0 * inks, 260.0), seed=1)
    layout = lay_out_chart(design, tile_mm=SizeMm(100.0, 90.0), dpi=150.5, patch_mm=8.0, seed=1)
    names = tuple(f"Ink {ink}" for ink in range(inks))
    return (
        design,
        layout,
        chart_text(layout, ink_names=names, kinds=design.kinds, description="test", created="2026-11-24"),
    )


@pytest.mark.parametrize("inks", range(1, 9))
def test_a_list_is_read_back(inks: int) -> None:
    _, layout, text = make(inks)
    chart = parse_chart(text, "x")
    for name, value in layout.__dict__.items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(chart.layout, name), value)
        else:
            assert getattr(chart.layout, name) == value
    assert chart.ink_names == tuple(f"Ink {ink}" for ink in range(inks))
    assert chart.sample_ids == tuple(str(patch + 1) for patch in range(60))
    assert chart.locations == tuple(layout.location(patch) for patch in range(60))
    assert chart.description == "test"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('CHART_VERSION "1"', 'CHART_VERSION "2"', "another version"),
        ('KEYWORD "CHART_VERSION"\nCHART_VERSION "1"\n', "", "is no list of a chart"),
        ('CHART_PATCH_PX "47"', 'CHART_PATCH_PX "0"', "CHART_PATCH_PX is '0', but must be 4"),
        ('CHART_PATCH_PX "47"', 'CHART_PATCH_PX "88"', "place of patch"),
        ('CHART_TILE_ROWS_PX "533"', 'CHART_TILE_ROWS_PX "nan"', "CHART_TILE_ROWS_PX is 'nan'"),
        ('CHART_GAP_PX "6"\n', "", "CHART_GAP_PX is missing"),
        ('CHART_MARK_INK "', 'CHART_MARK_INK "1 ', "CHART_MARK_INK must give"),
        (" TILE ROW", " TILES ROW", "lacks columns TILE"),
        ("\n2 ", "\n1 ", "two patches have one SAMPLE_ID"),
        (" white 0 0", " white 0.2 0", "whole 255ths"),
    ],
)
def test_edited_lists_are_refused(old: str, new: str, message: str) -> None:
    _, _, text = make(5)
    assert old in text
    with pytest.raises(ProfileError, match=message):
        parse_chart(text.replace(old, new, 1), "x")


def test_cells_without_end_are_not_counted_out() -> None:
    _, _, text = make(4)
    for name in ("ROWS", "COLS"):
        line = next(line for line in text.split("\n") if line.startswith(f"CHART_TILE_{name}_PX"))
        text = text.replace(line, f'CHART_TILE_{name}_PX "200000"')
    with pytest.raises(ProfileError, match="place of patch 1 is not"):
        parse_chart(text.replace('CHART_PATCH_PX "47"', 'CHART_PATCH_PX "4"'), "x")


def test_mutated_lists_are_refused_or_sound() -> None:
    _, _, text = make(3)
    random = np.random.default_rng(5)
    for _ in range(300):
        at = int(random.integers(len(text)))
        spoiled = text[:at] + chr(int(random.integers(32, 127))) * int(random.integers(1, 4)) + text[at + 1 :]
        with suppress(ProfileError):
            chart = parse_chart(spoiled, "x")
            assert len(chart.layout.ink_counts) == len(chart.sample_ids) == len(chart.layout.places)


def test_other_files_are_no_lists(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="can't be read"):
        read_chart_list(tmp_path / "absent.cgats")
    (tmp_path / "x.cgats").write_text("hello")
    with pytest.raises(ProfileError, match="is no list of a chart"):
        read_chart_list(tmp_path / "x.cgats")
