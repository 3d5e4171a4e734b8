"""Millimetres, pixels and dots per inch."""

from __future__ import annotations

import doctest
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab import units
from tilefab.types import SizeMm, SizePx


@pytest.mark.parametrize(
    ("length_mm", "dpi", "px"),
    [
        (600, 400, 9449),
        (1200, 400, 18898),
        (25.4, 360, 360),
        (0, 400, 0),
        (0.4999, 25.4, 0),
        # At one dot per inch: halves go up, below zero too.
        (12.7, 1, 1),
        (38.1, 1, 2),
        (63.5, 1, 3),
        (63.4, 1, 2),
        (-12.7, 1, 0),
        (-19.05, 1, -1),
        (-25.4, 1, -1),
    ],
)
def test_pixels_of_a_length(length_mm: float, dpi: float, px: int) -> None:
    result = units.px_from_mm(length_mm, dpi)
    assert result == px
    assert isinstance(result, int)


@given(st.integers(-(10**6), 10**6), st.integers(25, 2400))
def test_whole_pixels_survive_the_way_through_millimetres(px: int, dpi: int) -> None:
    assert units.px_from_mm(units.mm_from_px(px, dpi), dpi) == px


@given(st.integers(-(10**7), 10**7), st.integers(25, 2400))
def test_pixels_are_the_nearest(length_um: int, dpi: int) -> None:
    exact = Fraction(length_um, 25400) * dpi
    off = units.px_from_mm(length_um / 1000, dpi) - exact
    assert Fraction(-1, 2) - Fraction(1, 10**9) <= off <= Fraction(1, 2) + Fraction(1, 10**9)


def test_width_is_columns_and_height_is_rows() -> None:
    assert units.size_px_from_mm(SizeMm(width=600, height=1200), 400) == SizePx(rows=18898, cols=9449)


def test_square_metres() -> None:
    # 1000 x 1000 px at 254 dpi are 100 mm x 100 mm.
    assert units.square_metres_from_px(10**6, 254) == pytest.approx(0.01, rel=1e-12)
    assert units.square_metres_from_px(0, 254) == 0.0


def test_examples_in_the_docstrings_hold() -> None:
    failed, attempted = doctest.testmod(units)
    assert (failed, attempted) == (0, 4)
