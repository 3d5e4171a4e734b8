"""The look of the pages: fonts, sizes, colours, and text that always stays inside its box."""

from __future__ import annotations

import functools
import unicodedata
from dataclasses import dataclass, replace
from typing import Any

from reportlab.lib.colors import Color, HexColor
from reportlab.lib.pagesizes import A4
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont

MM = float(mm)
"""Points in a millimetre."""

PAGE_WIDTH, PAGE_HEIGHT = float(A4[0]), float(A4[1])
LEFT = 18 * MM
WIDTH = PAGE_WIDTH - 2 * LEFT
TOP = PAGE_HEIGHT - 22 * MM
BOTTOM = 20 * MM
GUTTER = 6 * MM

INK: Color = HexColor(0x1C1F22)
GREY: Color = HexColor(0x5B6166)
RULE: Color = HexColor(0xC4C8CB)
PALE: Color = HexColor(0xF0F2F3)
WHITE: Color = HexColor(0xFFFFFF)
ACCENT: Color = HexColor(0x0F5468)
TINT: Color = HexColor(0xD6E4E8)

REGULAR, BOLD = "tilefab-regular", "tilefab-bold"
_FILES = {REGULAR: "Vera.ttf", BOLD: "VeraBd.ttf"}
_ELLIPSIS = "…"
_TWINS = str.maketrans({"Δ": "∆", "μ": "µ", "Ω": "Ω", "‐": "-", "‑": "-"})
_LONGEST = 6000

Canvas = Any
"""A reportlab canvas (the library has no types)."""


@dataclass(frozen=True)
class TextStyle:
    """A font at a size in points, with its line distance and colour."""

    font: str
    size: float
    leading: float
    colour: Color


TITLE = TextStyle(BOLD, 20, 25, INK)
HEADING = TextStyle(BOLD, 13, 17, INK)
SUBHEADING = TextStyle(BOLD, 8.5, 11, ACCENT)
BODY = TextStyle(REGULAR, 8, 11, INK)
STRONG = TextStyle(BOLD, 8, 11, INK)
MUTED = TextStyle(REGULAR, 7.5, 10, GREY)
SMALL = TextStyle(REGULAR, 6.5, 8.6, INK)
SMALL_MUTED = TextStyle(REGULAR, 6.5, 8.6, GREY)
SMALL_STRONG = TextStyle(BOLD, 6.5, 8.6, INK)


@functools.cache
def _glyphs() -> frozenset[int]:
    """Code points that every font of the report can draw; registers the fonts on the first call."""
    covered: set[int] | None = None
    for name, file_name in _FILES.items():
        font = TTFont(name, file_name)
        pdfmetrics.registerFont(font)
        covered = set(font.face.charToGlyph) if covered is None else covered & set(font.face.charToGlyph)
    return frozenset(covered or ())


def clean(text: str) -> str:
    """Text that the report's font can draw: composed, on one line, "?" for each character the font lacks.

    >>> clean("Große Fliese 大 №1")
    'Große Fliese ? ?1'
    """
    drawable = _glyphs()
    whole = unicodedata.normalize("NFC", text).translate(_TWINS)
    return "".join(
        " " if letter.isspace() else letter if ord(letter) in drawable and ord(letter) > 31 else "?" for letter in whole
    ).strip()


def text_width(text: str, style: TextStyle) -> float:
    """Width of an already clean text, in points."""
    _glyphs()
    return float(pdfmetrics.stringWidth(text, style.font, style.size))


def wrap(text: str, width: float, style: TextStyle, max_lines: int = 40, *, middle: bool = False) -> list[str]:
    """Break a text into at most ``max_lines`` lines no wider than ``width`` points.

    Words too long for a line are broken, after a separator where there is one. What is too long for all the
    lines is cut at its end, or, with ``middle``, in its middle (for paths and names), at an ellipsis.
    """
    whole = clean(text[:_LONGEST] if len(text) <= _LONGEST else text[: _LONGEST // 2] + text[-_LONGEST // 2 :])
    lines = _break(whole, width, style)
    if len(lines) <= max_lines:
        return lines
    low, high = 0, len(whole) - 1
    best = [_ELLIPSIS]
    while low <= high:
        keep = (low + high) // 2
        tail = keep // 2 if middle else 0
        short = whole[: keep - tail].rstrip() + _ELLIPSIS + (whole[len(whole) - tail :].lstrip() if tail else "")
        attempt = _break(short, width, style)
        if len(attempt) <= max_lines:
            best, low = attempt, keep + 1
        else:
            high = keep - 1
    return best


def _break(text: str, width: float, style: TextStyle) -> list[str]:
    lines: list[str] = []
    line = ""
    for word in text.split(" "):
        rest = word
        longer = f"{line} {rest}" if line else rest
        if text_width(longer, style) <= width:
            line = longer
            continue
        ahead = width - text_width(f"{line} ", style) if line else 0.0
        if ahead > 0.3 * width and text_width(rest, style) > width:
            cut = _cut(rest, ahead, style)
            lines.append(f"{line} {rest[:cut]}")
            rest = rest[cut:]
        elif line:
            lines.append(line)
        while text_width(rest, style) > width:
            cut = _cut(rest, width, style)
            lines.append(rest[:cut])
            rest = rest[cut:]
        line = rest
    if line or not lines:
        lines.append(line)
    return lines


def _cut(word: str, width: float, style: TextStyle) -> int:
    """How many letters of a word fit, at least one; after a separator if one stands in the last half."""
    low, high = 1, len(word)
    while low < high:
        half = (low + high + 1) // 2
        low, high = (half, high) if text_width(word[:half], style) <= width else (low, half - 1)
    at_separator = max((word.rfind(mark, 0, low) for mark in "/\\_-.:"), default=-1) + 1
    return at_separator if at_separator > low // 2 else low


def draw_lines(canvas: Canvas, lines: list[str], x: float, top: float, style: TextStyle, align: str = "left") -> float:
    """Draw broken lines below ``top``; return the y below. ``x`` is the edge or centre they align to."""
    canvas.setFont(style.font, style.size)
    canvas.setFillColor(style.colour)
    draw = {"left": canvas.drawString, "right": canvas.drawRightString, "centre": canvas.drawCentredString}[align]
    for place, line in enumerate(lines):
        draw(x, top - place * style.leading - 0.5 * style.leading - 0.36 * style.size, line)
    return top - len(lines) * style.leading


def draw_text(
    canvas: Canvas,
    text: str,
    x: float,
    top: float,
    width: float,
    style: TextStyle,
    *,
    max_lines: int = 1,
    middle: bool = False,
    align: str = "left",
    shrink: float = 1.0,
) -> float:
    """Draw a text inside ``width`` points below ``top``, shortened at need; return the y below it.

    ``shrink`` below 1 lets the size go down to that part of the style's before anything is cut.
    """
    fitted = style
    while shrink < 1.0 and fitted.size > style.size * shrink and len(wrap(text, width, fitted)) > max_lines:
        fitted = replace(fitted, size=fitted.size * 0.94, leading=fitted.leading * 0.94)
    edge = x + {"left": 0.0, "centre": width / 2, "right": width}[align]
    return draw_lines(canvas, wrap(text, width, fitted, max_lines, middle=middle), edge, top, fitted, align)


def draw_rule(canvas: Canvas, x: float, y: float, width: float, colour: Color = RULE, thickness: float = 0.5) -> None:
    """Draw a horizontal rule."""
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(thickness)
    canvas.setDash()
    canvas.line(x, y, x + width, y)


def short_hash(digest: str, letters: int = 12) -> str:
    """Return the head of a hash in groups of four, for people to compare.

    >>> short_hash("sha256:0123456789abcdef0123")
    '0123 4567 89ab'
    """
    head = clean(digest).rsplit(":", 1)[-1].replace(" ", "")[:letters]
    return " ".join(head[start : start + 4] for start in range(0, len(head), 4)) or "–"


def number(value: float, decimals: int = 1) -> str:
    """Return a number for reading: grouped thousands, a true minus, powers of ten when huge.

    >>> number(-1234.56), number(3.2e11)
    ('−1 234.6', '3.20e+11')
    """
    if abs(value) >= 1e9:
        return f"{value:.2e}".replace("-", "−")
    text = f"{value:,.{decimals}f}".replace(",", " ")
    if float(text.replace(" ", "")) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def percent(value: float, *, even: bool = False) -> str:
    """Return a percentage with its sign; small but not zero stays visible. ``even`` always keeps one decimal.

    >>> percent(0.0), percent(0.02), percent(12.34), percent(180.0), percent(180.0, even=True)
    ('0 %', '< 0.1 %', '12.3 %', '180 %', '180.0 %')
    """
    if 0 < value < 0.05:
        return "< 0.1 %"
    whole = not even and abs(value - round(value)) < 1e-9
    return f"{number(value, 0 if whole else 1)} %"
