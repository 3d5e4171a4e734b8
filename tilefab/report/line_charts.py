"""Charts over the time of a shift or a job: one clock for all of them, with stops, holds and corrections marked."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from reportlab.lib.colors import Color

from tilefab.report.charts import Axes, tick_labels, ticks
from tilefab.report.line_view import LineReportView
from tilefab.report.profile_charts import begin_clip, draw_no_data
from tilefab.report.style import (
    ACCENT,
    GREY,
    INK,
    MM,
    RULE,
    SMALL_MUTED,
    SMALL_STRONG,
    SUBHEADING,
    TINT,
    WHITE,
    Canvas,
    clean,
    draw_text,
    number,
    text_width,
)

Float64Array = NDArray[np.float64]

_MINUTE, _HOUR, _DAY = 60, 3600, 86400
_STEPS_S = (
    *(5, 10, 15, 30),
    *(count * _MINUTE for count in (1, 2, 5, 10, 15, 30)),
    *(count * _HOUR for count in (1, 2, 3, 6, 12)),
    *(count * _DAY for count in (1, 2, 7, 14, 28, 91, 364)),
)
_MOST_TICKS = 9
_MOST_DOTS = 700
_FEW_DOTS = 120
_FEWEST_TO_BREAK = 8
_GAP = 0.02
_MOST_LINES = 60
_BINS = 240
_LABELS_WIDTH = 11 * MM


def clock_text(at_s: float, offset_min: int, *, date: bool = True, seconds: bool = False) -> str:
    """A time on the factory's clock.

    >>> clock_text(1790000000.0, 60), clock_text(1790000000.0, 0, date=False)
    ('2026-09-21 15:13', '14:13')
    """
    local = datetime.fromtimestamp(at_s, UTC) + timedelta(minutes=offset_min)
    return local.strftime(("%Y-%m-%d " if date else "") + ("%H:%M:%S" if seconds else "%H:%M"))


def span_text(seconds: float) -> str:
    """How long something took.

    >>> span_text(42.0), span_text(754.0), span_text(7500.0), span_text(266400.0)
    ('42 s', '13 min', '2 h 05 min', '3 d 2 h')
    """
    minutes = round(seconds / _MINUTE)
    if seconds < 1.5 * _MINUTE:
        return f"{seconds:.0f} s"
    if minutes < 60:
        return f"{minutes} min"
    if minutes < 48 * 60:
        return f"{minutes // 60} h {minutes % 60:02d} min"
    return f"{minutes // 1440} d {minutes % 1440 // 60} h"


@dataclass(frozen=True)
class TimeAxis:
    """The span that all charts of a page share, and what is marked on each of them."""

    begun_s: float
    ended_s: float
    offset_min: int
    stops: tuple[tuple[float, float], ...]
    holds: tuple[tuple[float, float], ...]
    corrections: tuple[tuple[int, float], ...]

    @classmethod
    def of(cls, view: LineReportView) -> TimeAxis:
        """The axis of a report's span."""
        end = max(view.ended_s, view.begun_s + 1.0)

        def spans(found: Sequence[tuple[float, float | None]]) -> tuple[tuple[float, float], ...]:
            clipped = [(max(first, view.begun_s), min(end if last is None else last, end)) for first, last in found]
            return tuple((first, last) for first, last in clipped if last > first)

        return cls(
            view.begun_s,
            end,
            view.utc_offset_min,
            spans([(stop.begun_s, stop.ended_s) for stop in view.downtime]),
            spans([(hold.begun_s, hold.ended_s) for hold in view.holds]),
            tuple((one.number, one.at_s) for one in view.corrections if view.begun_s <= one.at_s <= end),
        )

    def ticks(self) -> list[tuple[float, str]]:
        """Round times of the factory's clock, and how they are written: the day where one begins, else the time."""
        span = self.ended_s - self.begun_s
        step = next((step for step in _STEPS_S if span / step <= _MOST_TICKS), math.ceil(span / _MOST_TICKS))
        shift = self.offset_min * _MINUTE
        first = math.ceil((self.begun_s + shift) / step)
        last = math.floor((self.ended_s + shift) / step)
        found = []
        for place in range(first, last + 1):
            local = datetime.fromtimestamp(place * step, UTC)
            day = step >= _DAY or (local.hour, local.minute, local.second) == (0, 0, 0)
            form = "%d %b" if day else "%H:%M:%S" if step < _MINUTE else "%H:%M"
            found.append((float(place * step - shift), local.strftime(form)))
        return found


def time_panel(
    canvas: Canvas,
    axis: TimeAxis,
    title: str,
    x: float,
    top: float,
    width: float,
    height: float,
    low: float,
    high: float,
    *,
    clock: bool,
    numbers: bool = False,
    scale: bool = True,
) -> Axes:
    """Draw an empty chart over time in a box: title, grid, stops and holds shaded, corrections as upright lines.

    ``clock`` writes the times below it, ``numbers`` the corrections' numbers above their lines; without ``scale`` the
    upright axis has no lines and figures.
    """
    draw_text(canvas, title, x, top, width, SUBHEADING, shrink=0.8)
    head = SUBHEADING.leading + (4.4 * MM if numbers else 0.6 * MM)
    foot = 4 * MM if clock else 1.2 * MM
    axes = Axes(
        x + _LABELS_WIDTH,
        top - height + foot,
        width - _LABELS_WIDTH,
        height - head - foot,
        axis.begun_s,
        axis.ended_s,
        low,
        high,
    )
    canvas.setFillColor(WHITE)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=0, fill=1)
    _draw_spans(canvas, axes, axis)
    canvas.setDash()
    most = max(2, min(5, int(axes.height / (4.2 * MM))))
    upward = ticks(low, high, most) if scale else []
    for value, label in zip(upward, tick_labels(upward), strict=True):
        _, y = axes.at(axis.begun_s, value)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.7 if value == 0 else 0.3)
        canvas.line(axes.x, y, axes.x + axes.width, y)
        draw_text(canvas, label, x, y + 4.3, _LABELS_WIDTH - 1.2 * MM, SMALL_MUTED, align="right", shrink=0.6)
    for at_s, label in axis.ticks():
        place, _ = axes.at(at_s, low)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.3)
        canvas.line(place, axes.bottom, place, axes.bottom + axes.height)
        if clock:
            half = text_width(label, SMALL_MUTED) / 2
            middle = min(max(place, x + half), x + width - half)
            draw_text(canvas, label, middle - 22, axes.bottom - 2, 44, SMALL_MUTED, align="centre")
    _draw_corrections(canvas, axes, axis, numbers)
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.6)
    canvas.setDash()
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=1, fill=0)
    return axes


def _draw_spans(canvas: Canvas, axes: Axes, axis: TimeAxis) -> None:
    for first, last in axis.stops:
        x0, x1 = axes.at(first, axes.y_low)[0], axes.at(last, axes.y_low)[0]
        canvas.setFillColor(RULE)
        canvas.rect(x0, axes.bottom, max(x1 - x0, 0.5), axes.height, stroke=0, fill=1)
    canvas.setStrokeColor(GREY)
    for first, last in axis.holds:
        x0, x1 = axes.at(first, axes.y_low)[0], axes.at(last, axes.y_low)[0]
        hatch(canvas, x0, axes.bottom, max(x1 - x0, 0.8), axes.height)


def _draw_corrections(canvas: Canvas, axes: Axes, axis: TimeAxis, numbers: bool) -> None:
    canvas.setStrokeColor(ACCENT)
    many = len(axis.corrections) > _MOST_LINES
    canvas.setLineWidth(0.3 if many else 0.5)
    canvas.setDash(*([] if many else [[2.4, 1.6]]))
    # So many lines would hide the chart: ticks at its upper edge tell when corrections were made.
    floor = axes.bottom + axes.height - 1.2 * MM if many else axes.bottom
    written = -math.inf
    for count, at_s in axis.corrections:
        x, _ = axes.at(at_s, axes.y_low)
        canvas.line(x, floor, x, axes.bottom + axes.height + (1.4 * MM if numbers else 0.0))
        label = str(count)
        room = max(5.0 * len(label) + 4.0, 34.0 if many else 0.0)
        if numbers and x - written >= room:
            draw_text(canvas, label, x - 20, axes.bottom + axes.height + 4.1 * MM, 40, SMALL_STRONG, align="centre")
            written = x
    canvas.setDash()


def hatch(canvas: Canvas, x: float, y: float, width: float, height: float, pitch: float = 2.6) -> None:
    """Draw rising lines inside a rectangle, in step with those of its neighbours, in the present stroke colour."""
    path = canvas.beginPath()
    first, last = math.floor((y - (x + width)) / pitch) + 1, math.ceil((y + height - x) / pitch)
    for place in range(first, last):
        offset = place * pitch
        x0, x1 = max(x, y - offset), min(x + width, y + height - offset)
        if x1 > x0:
            path.moveTo(x0, x0 + offset)
            path.lineTo(x1, x1 + offset)
    canvas.setDash()
    canvas.setLineWidth(0.35)
    canvas.drawPath(path, stroke=1, fill=0)


def draw_level(
    canvas: Canvas, axes: Axes, value: float, label: str, *, dash: Sequence[float] = (5.0, 2.0), colour: Color = INK
) -> None:
    """Draw a level line across a chart with its name at the right end, if it lies inside."""
    if not axes.y_low <= value <= axes.y_high:
        return
    _, y = axes.at(axes.x_low, value)
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(0.8)
    canvas.setDash(list(dash))
    canvas.line(axes.x, y, axes.x + axes.width, y)
    canvas.setDash()
    if label:
        wide = text_width(clean(label), SMALL_MUTED)
        canvas.setFillColor(WHITE)
        canvas.rect(axes.x + axes.width - wide - 5, y + 1, wide + 4, 7, stroke=0, fill=1)
        draw_text(canvas, label, axes.x, y + 8.8, axes.width - 3, SMALL_MUTED, align="right")


def draw_stream(canvas: Canvas, axes: Axes, at_s: Float64Array, values: Float64Array, *, mean_of: int = 9) -> None:
    """Draw many values over time: dots with their moving mean, or, where they are too many, a band with its mean.

    ``mean_of`` values make the moving mean; 0: dots only.
    """
    if not len(at_s):
        return
    begin_clip(canvas, axes)
    if len(at_s) <= _MOST_DOTS:
        draw_dots(canvas, axes, at_s, values, side=2.2 if len(at_s) < _FEW_DOTS else 1.3)
        if mean_of and len(values) >= mean_of:
            smooth = np.convolve(values, np.full(mean_of, 1.0 / mean_of), mode="valid")
            ends = (mean_of - 1) // 2
            draw_polyline(canvas, axes, at_s[ends : ends + smooth.size], smooth, INK, 1.1)
    else:
        middle, lowest, mean, highest = binned(axes, at_s, values)
        canvas.setFillColor(TINT)
        for piece in _pieces(axes, middle):
            _draw_band(canvas, axes, middle[piece], lowest[piece], highest[piece])
        draw_polyline(canvas, axes, middle, mean, INK, 1.1)
    canvas.restoreState()


def _draw_band(canvas: Canvas, axes: Axes, x: Float64Array, low: Float64Array, high: Float64Array) -> None:
    corners = [*zip(x, low, strict=True), *zip(x[::-1], high[::-1], strict=True)]
    band = canvas.beginPath()
    band.moveTo(*axes.at(float(corners[0][0]), float(corners[0][1])))
    for at, value in corners[1:]:
        band.lineTo(*axes.at(float(at), float(value)))
    band.close()
    canvas.drawPath(band, stroke=0, fill=1)


def _pieces(axes: Axes, x: Float64Array) -> list[slice]:
    """Runs of points without a gap: where nothing was measured for long, no line should say that something was."""
    if len(x) < _FEWEST_TO_BREAK:
        return [slice(0, len(x))]
    steps = np.diff(x)
    longest = max(6.0 * float(np.median(steps)), _GAP * (axes.x_high - axes.x_low))
    ends = [0, *(np.flatnonzero(steps > longest) + 1), len(x)]
    return [slice(int(first), int(last)) for first, last in pairwise(ends)]


def binned(
    axes: Axes, at_s: Float64Array, values: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    """Middle time, lowest, mean and highest value of each piece of the axis that has values."""
    width = (axes.x_high - axes.x_low) / _BINS
    places = np.clip(((at_s - axes.x_low) / width).astype(np.int64), 0, _BINS - 1)
    order = np.argsort(places, kind="stable")
    kept, starts = np.unique(places[order], return_index=True)
    sorted_values = values[order]
    counts = np.diff(np.append(starts, len(values)))
    middle: Float64Array = axes.x_low + (kept.astype(np.float64) + 0.5) * width
    return (
        middle,
        np.minimum.reduceat(sorted_values, starts),
        np.add.reduceat(sorted_values, starts) / counts,
        np.maximum.reduceat(sorted_values, starts),
    )


def draw_polyline(
    canvas: Canvas,
    axes: Axes,
    x: Float64Array,
    y: Float64Array,
    colour: Color,
    width: float,
    dash: Sequence[float] = (),
    *,
    whole: bool = False,
) -> None:
    """Draw a line through points, unless it is ``whole`` broken where there are none for long; the caller clips."""
    if not len(x):
        return
    path = canvas.beginPath()
    for piece in [slice(0, len(x))] if whole else _pieces(axes, x):
        path.moveTo(*axes.at(float(x[piece.start]), float(y[piece.start])))
        for first, second in zip(x[piece][1:], y[piece][1:], strict=True):
            path.lineTo(*axes.at(float(first), float(second)))
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(width)
    canvas.setLineJoin(1)
    canvas.setDash(list(dash))
    canvas.drawPath(path, stroke=1, fill=0)
    canvas.setDash()


def draw_dots(
    canvas: Canvas, axes: Axes, x: Float64Array, y: Float64Array, *, side: float = 1.3, colour: Color = GREY
) -> None:
    """Draw points as small squares; the caller clips."""
    dots = canvas.beginPath()
    for first, second in zip(x, y, strict=True):
        px, py = axes.at(float(first), float(second))
        dots.rect(px - side / 2, py - side / 2, side, side)
    canvas.setFillColor(colour)
    canvas.drawPath(dots, stroke=0, fill=1)


def onsets(beyond: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The first of each run of marked points."""
    first = beyond.copy()
    first[1:] &= ~beyond[:-1]
    return first


def draw_rings(canvas: Canvas, axes: Axes, x: Float64Array, y: Float64Array, colour: Color = INK) -> None:
    """Draw points that stand for a signal as rings; those outside the chart stand at its edge."""
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(0.9)
    canvas.setDash()
    for first, second in zip(x, y, strict=True):
        px, py = axes.at(float(first), min(max(float(second), axes.y_low), axes.y_high))
        canvas.circle(px, py, 2.4, stroke=1, fill=0)


def around(values: Sequence[float] | Float64Array, *, least: float, zero: bool = False) -> tuple[float, float]:
    """Limits of an axis around values: a little room, never narrower than ``least``; ``zero`` begins it at 0."""
    found = np.asarray(values, dtype=np.float64)
    found = found[np.isfinite(found)]
    low, high = (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)
    if zero:
        return 0.0, max(1.08 * high, least)
    middle, half = (low + high) / 2, max(0.54 * (high - low), least / 2)
    return middle - half, middle + half


def empty_panel(canvas: Canvas, title: str, text: str, x: float, top: float, width: float, height: float) -> None:
    """Draw a chart's title over an empty frame that says why there is nothing."""
    draw_text(canvas, title, x, top, width, SUBHEADING, shrink=0.8)
    head = SUBHEADING.leading + 0.6 * MM
    draw_no_data(
        canvas, x + _LABELS_WIDTH, top - head, width - _LABELS_WIDTH, max(height - head - 4 * MM, 6 * MM), text
    )


def signed(value: float, decimals: int = 2) -> str:
    """A number with its sign.

    >>> signed(0.5), signed(-0.25), signed(0.0)
    ('+0.50', '−0.25', '0.00')
    """
    text = number(value, decimals)
    return f"+{text}" if value > 0 and float(text.replace(" ", "")) != 0 else text
