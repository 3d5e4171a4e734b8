"""The parts that pages are made of: text that fits, ticks, codes, pages that fill."""

from __future__ import annotations

import doctest
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tilefab.report import charts, figures, layout, style, view_model
from tilefab.report.charts import tick_labels, ticks
from tilefab.report.figures import QUIET_MODULES, fit_size, qr_least_side, qr_modules, qr_side
from tilefab.report.style import BODY, MM, STRONG, clean, text_width, wrap


@pytest.mark.parametrize("module", [charts, style, view_model])
def test_examples_in_docstrings(module: object) -> None:
    result = doctest.testmod(module)  # type: ignore[arg-type]
    assert result.attempted > 0
    assert result.failed == 0


@pytest.mark.parametrize(
    ("text", "drawn"),
    [
        ("Mármore – Größe 60×120 Ž", "Mármore – Größe 60×120 Ž"),
        ("大理石", "???"),
        ("رخام", "????"),
        ("a\tb\nc", "a b c"),
        ("a\x00b\u200fc\U0001f600", "a?b?c?"),
        ("a\u0301", "á"),
        ("ΔE μm", "∆E µm"),
        ("\udc80", "?"),
        ("", ""),
    ],
)
def test_clean(text: str, drawn: str) -> None:
    assert clean(text) == drawn


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=300), st.floats(12.0, 400.0), st.integers(1, 5), st.booleans())
def test_wrapped_text_stays_inside(text: str, width: float, most: int, middle: bool) -> None:
    lines = wrap(text, width, BODY, most, middle=middle)
    assert 1 <= len(lines) <= most
    assert all(text_width(line, BODY) <= width + 1e-6 for line in lines)


def test_wrap_keeps_all_the_words_and_both_ends_of_a_path() -> None:
    text = "the quick brown fox jumps over the lazy dog " * 5
    assert " ".join(wrap(text, 100, BODY)) == text.strip()
    (line,) = wrap("/mnt/jobs/" + "deep/" * 50 + "face_00017.tif", 200, STRONG, 1, middle=True)
    assert line.startswith("/mnt/jobs/")
    assert line.endswith("face_00017.tif")
    assert "…" in line
    assert wrap("word " * 100000, 100, BODY, 2)[-1].endswith("…")


@settings(max_examples=100, deadline=None)
@given(st.floats(-1e9, 1e9), st.floats(1e-9, 1e9), st.integers(1, 8))
def test_ticks_are_round_few_and_inside(low: float, span: float, most: int) -> None:
    if low + span == low or span < 1e-6 * abs(low):
        return
    values = ticks(low, low + span, most)
    assert len(values) <= most + 1
    assert all(low - 1e-6 * span <= value <= low + span + 1e-6 * span for value in values)
    assert len(tick_labels(values)) == len(values)


def test_ticks_without_a_span() -> None:
    assert ticks(3.0, 3.0) == [3.0]


@pytest.mark.parametrize("length", [1, 20, 120, 140, 160, 280])
def test_codes_can_be_scanned_from_print(length: int) -> None:
    modules = qr_modules("f" * length, "a code")
    count = len(modules) + 2 * QUIET_MODULES
    side = qr_side(modules, 26 * MM)
    assert side <= 26 * MM
    assert side >= qr_least_side(modules) >= 14 * MM
    assert side / count >= 0.35 * MM


def test_codes_have_their_three_finders_and_their_own_content() -> None:
    one, other = qr_modules("face 17", "a code"), qr_modules("face 18", "a code")
    ring = np.ones((7, 7), np.bool_)
    ring[1:-1, 1:-1] = False
    ring[2:-2, 2:-2] = True
    for corner in (one[:7, :7], one[:7, -7:], one[-7:, :7]):
        np.testing.assert_array_equal(corner, ring)
    assert one.shape == other.shape
    assert (one != other).any()


def test_fit_size_keeps_the_shape_and_never_vanishes() -> None:
    assert fit_size(10, 20, 100, 100) == (100, 50)
    assert fit_size(1, 100000, 100, 100) == (100, 2.0)


def test_pages_fill_and_keep_what_belongs_together() -> None:
    drawn: list[tuple[str, float]] = []

    def block(name: str, height: float, keep: bool = False, head: layout.Block | None = None) -> layout.Block:
        return layout.Block(height, lambda _canvas, top: drawn.append((name, top)), keep=keep, head=head)

    head = block("head", 10)
    room = style.TOP - style.BOTTOM
    blocks = [block("a", room - 50), block("title", 30, keep=True), block("b", 30, head=head), block("c", 10)]
    pages = layout.flow("Part", blocks)
    assert len(pages) == 2
    assert [page.section for page in pages] == ["Part", "Part"]
    pages[0].draw(None)
    assert drawn == [("a", style.TOP)]


def test_numbers_for_reading() -> None:
    assert style.number(-0.01) == "0.0"
    assert style.number(1234567.0, 0) == "1 234 567"
    assert style.short_hash("") == "–"
    for value, decimals in itertools.product((0.0, 1e-9, 12.345, 1e8, 1e300), (0, 2)):
        assert math.isfinite(float(style.number(value, decimals).replace(" ", "")))
    assert figures.QUIET_MODULES == 4
