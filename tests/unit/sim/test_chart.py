"""The demo chart: its rules, and that the shipped file is what the simulator makes."""

from pathlib import Path

import numpy as np

from sim.chart import MAX_TOTAL_PERCENT, PATCHES, chart_percent, chart_text, main

SHIPPED = Path(__file__).parents[3] / "profiles" / "demo_ceramic.ti3"


def test_chart_keeps_its_rules() -> None:
    percent = chart_percent()
    assert percent.shape == (PATCHES, 4)
    assert percent.min() == 0.0
    assert percent.max() == 100.0
    assert percent.sum(axis=1).max() <= MAX_TOTAL_PERCENT
    assert percent.sum(axis=1).max() > 300.0
    assert len(np.unique(percent, axis=0)) == PATCHES - 7  # the bare tile is measured 8 times


def test_shipped_file_is_reproduced_exactly(tmp_path: Path) -> None:
    main(["-o", str(tmp_path / "again.ti3")])
    assert (tmp_path / "again.ti3").read_bytes() == SHIPPED.read_bytes()


def test_file_says_that_it_is_synthetic() -> None:
    text = chart_text()
    assert "SYNTHETIC" in text
    assert "not from a real press" in text
    assert text == chart_text()
