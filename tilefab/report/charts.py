"""Charts drawn straight onto the page: lines, hatching and marker shapes carry the meaning, not colour."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tilefab.report.style import (
    ACCENT,
    GREY,
    INK,
    MM,
    PALE,
    RULE,
    SMALL,
    SMALL_MUTED,
    SUBHEADING,
    TINT,
    WHITE,
    Canvas,
    draw_text,
)
from tilefab.report.view_model import ColourView, HistogramView
from tilefab.types import Array

_MOST_POINTS = 1500
_MOST_BARS = 80


@dataclass(frozen=True)
class Axes:
    """A rectangle of the page, in points, that stands for a rectangle of data."""

    x: float
    bottom: float
    width: float
    height: float
    x_low: float
    x_high: float
    y_low: float
    y_high: float

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Where a value lies on the page."""
        return (
            self.x + (x - self.x_low) / (self.x_high - self.x_low) * self.width,
            self.bottom + (y - self.y_low) / (self.y_high - self.y_low) * self.height,
        )


def ticks(low: float, high: float, most: int = 6) -> list[float]:
    """Round values from ``low`` to ``high`` at steps of 1, 2 or 5 times a power of ten.

    >>> ticks(0, 100)
    [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]
    """
    span = high - low
    if not span > 0:
        return [low]
    step = 10.0 ** math.floor(math.log10(span / most))
    step *= next(factor for factor in (1.0, 2.0, 5.0, 10.0, 20.0) if span / (step * factor) <= most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [place * step for place in range(first, last + 1)]


def tick_labels(values: Sequence[float]) -> list[str]:
    """Short labels for the ticks of one axis, all of one kind.

    >>> tick_labels([0.0, 50000.0]), tick_labels([-1e6, 0.0]), tick_labels([0.0, 0.02])
    (['0', '50 000'], ['−1e6', '0'], ['0', '0.02'])
    """
    most = max((abs(value) for value in values), default=0.0)
    if most != 0 and not 1e-2 <= most < 1e6:
        labels = [re.sub(r"\.0e|e", "e", f"{value:.1e}") if value else "0" for value in values]
        labels = [re.sub(r"e([+-])0*", r"e\1", label).replace("e+", "e") for label in labels]
    else:
        labels = [f"{value:,.0f}" if most >= 1000 else f"{round(value, 6):g}" for value in values]
    return [label.replace(",", " ").replace("-", "−") for label in labels]


def _widened(low: float, high: float) -> tuple[float, float]:
    pad = 0.06 * (high - low) if high > low else max(1.0, abs(high) * 0.1)
    return low - pad, high + pad


def draw_grid(canvas: Canvas, axes: Axes, x_label: str, y_label: str, *, x_most: int = 6, y_most: int = 6) -> None:
    """Draw an axes' white ground, grid lines, tick labels, frame and the names of both axes."""
    canvas.setFillColor(WHITE)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=0, fill=1)
    canvas.setDash()
    across = ticks(axes.x_low, axes.x_high, x_most)
    for value, label in zip(across, tick_labels(across), strict=True):
        x, _ = axes.at(value, axes.y_low)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.7 if value == 0 else 0.3)
        canvas.line(x, axes.bottom, x, axes.bottom + axes.height)
        draw_text(canvas, label, x - 20, axes.bottom - 2, 40, SMALL_MUTED, align="centre")
    upward = ticks(axes.y_low, axes.y_high, y_most)
    for value, label in zip(upward, tick_labels(upward), strict=True):
        _, y = axes.at(axes.x_low, value)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.7 if value == 0 else 0.3)
        canvas.line(axes.x, y, axes.x + axes.width, y)
        draw_text(canvas, label, axes.x - 34, y + 4.3, 31, SMALL_MUTED, align="right")
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.6)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=1, fill=0)
    draw_text(canvas, x_label, axes.x, axes.bottom - 11, axes.width, SMALL, align="right")
    draw_text(canvas, y_label, axes.x, axes.bottom + axes.height + 11, axes.width, SMALL)


def draw_histogram(
    canvas: Canvas,
    histogram: HistogramView,
    x: float,
    top: float,
    width: float,
    height: float,
    *,
    title: str,
    x_label: str,
    y_label: str,
    hatched: bool,
) -> None:
    """Draw a histogram in a box, title and labels included; ``hatched`` bars or plain ones."""
    draw_text(canvas, title, x, top, width, SUBHEADING)
    left, floor = x + 12 * MM, top - height + 9 * MM
    plot_width, plot_height = width - 16 * MM, height - 18 * MM
    edges, counts = _merged(histogram)
    if counts.size == 0 or not counts.any():
        _draw_no_data(canvas, left, floor, plot_width, plot_height)
        return
    axes = Axes(
        left,
        floor,
        plot_width,
        plot_height,
        float(edges[0]),
        float(edges[-1]),
        0.0,
        float(counts.max()) * 1.06,
    )
    draw_grid(canvas, axes, x_label, y_label, y_most=min(5, max(1, int(counts.max()))))
    canvas.saveState()
    canvas.setStrokeColor(ACCENT)
    canvas.setLineWidth(0.5)
    for low, high, count in zip(edges[:-1], edges[1:], counts, strict=True):
        if count == 0:
            continue
        x0, y0 = axes.at(float(low), 0.0)
        x1, y1 = axes.at(float(high), float(count))
        canvas.setFillColor(WHITE if hatched else TINT)
        canvas.rect(x0, y0, x1 - x0, y1 - y0, stroke=1, fill=1)
        if hatched:
            _hatch(canvas, x0, y0, x1 - x0, y1 - y0)
    canvas.restoreState()


def _merged(histogram: HistogramView) -> tuple[Array, Array]:
    """Edges and counts with neighbours added up until there are few enough bars to see."""
    edges, counts = histogram.edges.astype(np.float64), histogram.counts.astype(np.float64)
    if counts.size == 0:
        return edges, counts
    group = -(-counts.size // _MOST_BARS)
    starts = np.arange(0, counts.size, group)
    return np.append(edges[starts], edges[-1]), np.add.reduceat(counts, starts)


def _hatch(canvas: Canvas, x: float, y: float, width: float, height: float, pitch: float = 2.6) -> None:
    """Draw rising 45° lines inside a rectangle, in step with those of its neighbours."""
    path = canvas.beginPath()
    first = math.floor((y - (x + width)) / pitch) + 1
    last = math.ceil((y + height - x) / pitch)
    for step in range(first, last):
        offset = step * pitch
        x0, x1 = max(x, y - offset), min(x + width, y + height - offset)
        if x1 > x0:
            path.moveTo(x0, x0 + offset)
            path.lineTo(x1, x1 + offset)
    canvas.setLineWidth(0.35)
    canvas.drawPath(path, stroke=1, fill=0)


def _draw_no_data(canvas: Canvas, x: float, bottom: float, width: float, height: float) -> None:
    canvas.setFillColor(PALE)
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.5)
    canvas.setDash(2, 2)
    canvas.rect(x, bottom, width, height, stroke=1, fill=1)
    canvas.setDash()
    draw_text(canvas, "no data", x, bottom + height / 2 + 5, width, SMALL_MUTED, align="centre")


def draw_gamut_ab(canvas: Canvas, colour: ColourView, x: float, top: float, width: float, height: float) -> None:
    """Draw a* against b*, at one scale: the press's outline, the slab's colours, where they move."""
    draw_text(canvas, "Hue and chroma: b* over a*", x, top, width, SUBHEADING)
    moves = [(swatch.lab_slab[1:], swatch.lab_printed[1:]) for swatch in colour.swatches]
    sample = _thinned(colour.slab_lab_sample)[:, 1:]
    side = min(width - 13 * MM, height - 18 * MM)
    left, floor = x + 12 * MM, top - height + 9 * MM
    points = _together(sample, colour.gamut_ab, moves)
    if points.size == 0:
        _draw_no_data(canvas, left, floor, side, side)
        return
    lows, highs = points.min(axis=0), points.max(axis=0)
    half = 0.56 * max(float((highs - lows).max()), 2.0)
    middle = (lows + highs) / 2
    x_mid, y_mid = float(middle[0]), float(middle[1])
    axes = Axes(left, floor, side, side, x_mid - half, x_mid + half, y_mid - half, y_mid + half)
    draw_grid(canvas, axes, "a*", "b*")
    _draw_colours(canvas, axes, sample, colour.gamut_ab, moves)


def draw_gamut_lc(canvas: Canvas, colour: ColourView, x: float, top: float, width: float, height: float) -> None:
    """Draw lightness over chroma: the press's outline, the slab's colours, and its main colours' move."""
    draw_text(canvas, "Lightness and chroma: L* over C*", x, top, width, SUBHEADING)
    moves = []
    for swatch in colour.swatches:
        pair = [(math.hypot(lab[1], lab[2]), lab[0]) for lab in (swatch.lab_slab, swatch.lab_printed)]
        moves.append((pair[0], pair[1]))
    lab = _thinned(colour.slab_lab_sample)
    sample = np.stack([np.hypot(lab[:, 1], lab[:, 2]), lab[:, 0]], axis=1)
    outline = colour.gamut_lc[:, ::-1].astype(np.float64)
    left, floor = x + 12 * MM, top - height + 9 * MM
    plot_width, plot_height = width - 13 * MM, height - 18 * MM
    points = _together(sample, outline, moves)
    if points.size == 0:
        _draw_no_data(canvas, left, floor, plot_width, plot_height)
        return
    _, c_high = _widened(0.0, float(points[:, 0].max()))
    l_low, l_high = min(0.0, float(points[:, 1].min())), max(100.0, float(points[:, 1].max()))
    axes = Axes(left, floor, plot_width, plot_height, 0.0, c_high, l_low, l_high)
    draw_grid(canvas, axes, "C*", "L*")
    _draw_colours(canvas, axes, sample, outline, moves)


_Move = tuple[Sequence[float], Sequence[float]]


def _thinned(table: Array) -> Array:
    """At most some 1500 rows of a table, evenly chosen."""
    step = max(1, -(-len(table) // _MOST_POINTS))
    return table[::step].astype(np.float64)


def _together(sample: Array, outline: Array, moves: Sequence[_Move]) -> Array:
    ends = np.array([end for move in moves for end in move], dtype=np.float64).reshape(-1, 2)
    return np.concatenate([sample, outline.astype(np.float64), ends])


def _draw_colours(canvas: Canvas, axes: Axes, sample: Array, outline: Array, moves: Sequence[_Move]) -> None:
    canvas.saveState()
    clip = canvas.beginPath()
    clip.rect(axes.x, axes.bottom, axes.width, axes.height)
    canvas.clipPath(clip, stroke=0, fill=0)
    dots = canvas.beginPath()
    for first, second in sample:
        px, py = axes.at(float(first), float(second))
        dots.rect(px - 0.45, py - 0.45, 0.9, 0.9)
    canvas.setFillColor(GREY)
    canvas.drawPath(dots, stroke=0, fill=1)
    if len(outline):
        line = canvas.beginPath()
        line.moveTo(*axes.at(float(outline[0, 0]), float(outline[0, 1])))
        for first, second in outline[1:]:
            line.lineTo(*axes.at(float(first), float(second)))
        line.close()
        canvas.setStrokeColor(ACCENT)
        canvas.setLineWidth(1.2)
        canvas.setLineJoin(1)
        canvas.drawPath(line, stroke=1, fill=0)
    for start, end in moves:
        x0, y0 = axes.at(float(start[0]), float(start[1]))
        x1, y1 = axes.at(float(end[0]), float(end[1]))
        canvas.setStrokeColor(INK)
        canvas.setLineWidth(0.6)
        canvas.line(x0, y0, x1, y1)
        draw_square(canvas, x1, y1)
        draw_disc(canvas, x0, y0)
    canvas.restoreState()


def draw_disc(canvas: Canvas, x: float, y: float) -> None:
    """Draw the mark of a colour on the slab: a dark disc with a white rim."""
    canvas.setFillColor(INK)
    canvas.setStrokeColor(WHITE)
    canvas.setLineWidth(0.4)
    canvas.circle(x, y, 1.8, stroke=1, fill=1)


def draw_square(canvas: Canvas, x: float, y: float) -> None:
    """Draw the mark of a colour as printed: a white square with a dark rim."""
    canvas.setFillColor(WHITE)
    canvas.setStrokeColor(INK)
    canvas.setLineWidth(0.8)
    canvas.rect(x - 1.8, y - 1.8, 3.6, 3.6, stroke=1, fill=1)


def draw_gamut_legend(canvas: Canvas, x: float, top: float, width: float) -> None:
    """Draw what the marks of both gamut charts mean, on one line."""
    y = top - 0.5 * SMALL.leading
    part = width / 4
    canvas.setStrokeColor(ACCENT)
    canvas.setLineWidth(1.2)
    canvas.line(x, y, x + 12, y)
    canvas.setFillColor(GREY)
    for dx, dy in ((0, 1.5), (4, -1.5), (8, 0.5)):
        canvas.rect(x + part + dx, y + dy - 0.45, 0.9, 0.9, stroke=0, fill=1)
    draw_disc(canvas, x + 2 * part + 6, y)
    draw_square(canvas, x + 3 * part + 6, y)
    labels = ("outline of the press", "colours of the slab", "main colour, slab", "main colour, printed")
    for place, label in enumerate(labels):
        draw_text(canvas, label, x + place * part + 16, top, part - 18, SMALL)


def draw_ink_bar(
    canvas: Canvas, mean: float, most: float, full: float, x: float, top: float, width: float, height: float
) -> None:
    """Draw one ink's bar (mean) and its line with an end mark (maximum) on a scale from 0 to ``full``."""
    middle = top - height / 2
    bar = min(mean / full, 1.0) * width
    end = x + min(most / full, 1.0) * width
    canvas.setDash()
    canvas.setStrokeColor(INK)
    canvas.setLineWidth(0.6)
    canvas.line(x, middle, end, middle)
    canvas.setFillColor(ACCENT)
    canvas.rect(x, middle - 0.28 * height, bar, 0.56 * height, stroke=0, fill=1)
    canvas.setLineWidth(1.1)
    canvas.line(end, middle - 0.28 * height, end, middle + 0.28 * height)
