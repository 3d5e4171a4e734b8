"""Charts of a profile check: curves of inks, slices of the gamut, strips of colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from reportlab.lib.colors import Color
from reportlab.lib.utils import ImageReader

from tilefab.report.charts import Axes, draw_grid, tick_labels, ticks
from tilefab.report.profile_view import PlaneView
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
    WHITE,
    Canvas,
    draw_text,
)
from tilefab.report.view_model import Rgb, RgbImage

Float64Array = NDArray[np.float64]

_DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (5.0, 1.6),
    (1.4, 1.4),
    (5.0, 1.5, 1.3, 1.5),
    (2.8, 1.2),
    (8.0, 1.5),
    (5.0, 1.2, 1.2, 1.2, 1.2, 1.2),
    (1.2, 2.6),
)
_LEVEL_STOPS = (10.0, 40.0, 65.0, 90.0)
_LEVEL_RGB = ((0.25, 0.10, 0.10, 0.95), (0.03, 0.35, 0.65, 0.62), (0.40, 0.70, 0.35, 0.10))
_DARKEST_LUMA = 165.0
_STRIP_ROWS = 2


def line_colour(rgb: Rgb) -> Color:
    """An ink's colour, darkened where it could not be seen as a thin line on white."""
    luma = 0.3 * rgb[0] + 0.59 * rgb[1] + 0.11 * rgb[2]
    scale = min(1.0, _DARKEST_LUMA / max(luma, 1.0))
    return Color(*(scale * part / 255.0 for part in rgb))


def fill_colour(rgb: Sequence[int]) -> Color:
    """A colour as it is."""
    return Color(*(int(part) / 255.0 for part in rgb))


def chart_axes(
    x: float, top: float, width: float, height: float, across: tuple[float, float], upward: tuple[float, float]
) -> Axes:
    """Axes in a box, with room for labels around."""
    return Axes(x + 11 * MM, top - height + 8 * MM, width - 13 * MM, height - 17 * MM, *across, *upward)


def begin_clip(canvas: Canvas, axes: Axes) -> None:
    """Keep what follows, up to ``restoreState``, inside the axes."""
    canvas.saveState()
    clip = canvas.beginPath()
    clip.rect(axes.x, axes.bottom, axes.width, axes.height)
    canvas.clipPath(clip, stroke=0, fill=0)


def draw_curves(
    canvas: Canvas, axes: Axes, x: Float64Array, curves: Sequence[Float64Array], colours: Sequence[Color]
) -> None:
    """Draw curves over common ``x``, told apart by dashes as well as by colour."""
    begin_clip(canvas, axes)
    canvas.setLineWidth(1.1)
    canvas.setLineJoin(1)
    for place, (curve, colour) in enumerate(zip(curves, colours, strict=True)):
        path = canvas.beginPath()
        path.moveTo(*axes.at(float(x[0]), float(curve[0])))
        for first, second in zip(x[1:], curve[1:], strict=True):
            path.lineTo(*axes.at(float(first), float(second)))
        canvas.setStrokeColor(colour)
        canvas.setDash(list(_DASHES[place % len(_DASHES)]))
        canvas.drawPath(path, stroke=1, fill=0)
    canvas.setDash()
    canvas.restoreState()


def draw_line_legend(
    canvas: Canvas, names: Sequence[str], colours: Sequence[Color], x: float, top: float, width: float
) -> None:
    """Draw what each line of `draw_curves` means, on one line."""
    part = width / max(len(names), 1)
    y = top - 0.5 * SMALL.leading
    for place, (name, colour) in enumerate(zip(names, colours, strict=True)):
        left = x + place * part
        canvas.setStrokeColor(colour)
        canvas.setLineWidth(1.4)
        canvas.setDash(list(_DASHES[place % len(_DASHES)]))
        canvas.line(left, y, left + 18, y)
        canvas.setDash()
        draw_text(canvas, name, left + 21, top, part - 23, SMALL, shrink=0.8)


def draw_title(canvas: Canvas, title: str, x: float, top: float, width: float) -> None:
    """Draw a chart's title."""
    draw_text(canvas, title, x, top, width, SUBHEADING, shrink=0.8)


def draw_no_data(canvas: Canvas, x: float, top: float, width: float, height: float, text: str = "no data") -> None:
    """Draw an empty frame where there is nothing to show."""
    canvas.setFillColor(PALE)
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.5)
    canvas.setDash(2, 2)
    canvas.rect(x, top - height, width, height, stroke=1, fill=1)
    canvas.setDash()
    draw_text(canvas, text, x, top - height / 2 + 5, width, SMALL_MUTED, align="centre")


def draw_picture(canvas: Canvas, picture: RgbImage, x: float, bottom: float, width: float, height: float) -> None:
    """Draw a picture without loss, stretched to a box."""
    canvas.drawImage(_reader(picture), x, bottom, width, height)


def _reader(picture: RgbImage) -> Any:
    return ImageReader(Image.fromarray(np.ascontiguousarray(picture)))


def draw_strip(
    canvas: Canvas, colours: RgbImage, x: float, top: float, width: float, height: float, *, frame: bool = True
) -> None:
    """Draw colours (K, 3) side by side as one strip."""
    draw_picture(canvas, np.repeat(colours[np.newaxis], _STRIP_ROWS, axis=0), x, top - height, width, height)
    if frame:
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.4)
        canvas.rect(x, top - height, width, height, stroke=1, fill=0)


def draw_pieces(canvas: Canvas, axes: Axes, pieces: Float64Array, colour: Color, width: float) -> None:
    """Draw line pieces (S, 4) in data coordinates."""
    if not len(pieces):
        return
    path = canvas.beginPath()
    for x0, y0, x1, y1 in pieces:
        path.moveTo(*axes.at(float(x0), float(y0)))
        path.lineTo(*axes.at(float(x1), float(y1)))
    canvas.setStrokeColor(colour)
    canvas.setLineWidth(width)
    canvas.setDash()
    canvas.drawPath(path, stroke=1, fill=0)


def draw_points(canvas: Canvas, axes: Axes, points: Float64Array, colour: Color, side: float = 0.9) -> None:
    """Draw points (K, 2) in data coordinates as small squares."""
    dots = canvas.beginPath()
    for first, second in points:
        px, py = axes.at(float(first), float(second))
        dots.rect(px - side / 2.0, py - side / 2.0, side, side)
    canvas.setFillColor(colour)
    canvas.drawPath(dots, stroke=0, fill=1)


def draw_levels(
    canvas: Canvas,
    levels: Sequence[tuple[float, PlaneView]],
    sample: Float64Array,
    x: float,
    top: float,
    side: float,
    most_points: int,
) -> None:
    """Draw outlines of the gamut at several lightnesses over a* and b*, at one scale, with the sample's points."""
    draw_title(canvas, "Outlines at several lightnesses: b* over a*", x, top, side)
    found = [plane.outline for _, plane in levels if len(plane.outline)]
    shown = sample[:: max(1, -(-len(sample) // most_points))] if len(sample) else sample
    ends = [outline.reshape(-1, 2) for outline in found] + ([shown[:, 1:]] if len(shown) else [])
    if not ends:
        draw_no_data(canvas, x + 11 * MM, top - 9 * MM, side - 13 * MM, side - 17 * MM)
        return
    every = np.concatenate(ends)
    low, high = every.min(axis=0), every.max(axis=0)
    plot = side - 17 * MM
    half = 0.54 * max(float((high - low).max()), 2.0)
    middle = (low + high) / 2.0
    axes = Axes(
        x + 11 * MM,
        top - side + 8 * MM,
        plot,
        plot,
        float(middle[0]) - half,
        float(middle[0]) + half,
        float(middle[1]) - half,
        float(middle[1]) + half,
    )
    draw_grid(canvas, axes, "a*", "b*")
    begin_clip(canvas, axes)
    if len(shown):
        draw_points(canvas, axes, shown[:, 1:], GREY, 0.8)
    for level, plane in levels:
        draw_pieces(canvas, axes, plane.outline, level_colour(level), 1.0)
    canvas.restoreState()


def level_colour(level: float) -> Color:
    """From dark violet for L* 10 over blue and green to orange for L* 90: hue and lightness both tell."""
    return Color(*(float(np.interp(level, _LEVEL_STOPS, part)) for part in _LEVEL_RGB))


def draw_plane(canvas: Canvas, plane: PlaneView, x: float, top: float, width: float, height: float) -> None:
    """Draw a slice along a hue: its colours, its outline, and the sample's points near it."""
    draw_title(canvas, plane.title, x, top, width)
    axes = chart_axes(x, top, width, height, (plane.low[0], plane.high[0]), (plane.low[1], plane.high[1]))
    draw_grid(canvas, axes, "C*", "L*")
    begin_clip(canvas, axes)
    if plane.picture is not None:
        cut = _cut_to_colours(plane.picture)
        if cut is not None:
            rows, cols, piece = cut
            total_rows, total_cols = plane.picture.shape[:2]
            draw_picture(
                canvas,
                piece,
                axes.x + cols[0] / total_cols * axes.width,
                axes.bottom + (1.0 - rows[1] / total_rows) * axes.height,
                (cols[1] - cols[0]) / total_cols * axes.width,
                (rows[1] - rows[0]) / total_rows * axes.height,
            )
    _draw_lines(canvas, axes)
    draw_pieces(canvas, axes, plane.outline, INK, 0.7)
    draw_points(canvas, axes, plane.points, WHITE, 1.5)
    draw_points(canvas, axes, plane.points, INK, 0.8)
    canvas.restoreState()
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.6)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=1, fill=0)


def _draw_lines(canvas: Canvas, axes: Axes) -> None:
    """Draw the grid's lines again, over a picture."""
    canvas.setStrokeColor(RULE)
    canvas.setLineWidth(0.3)
    for value in ticks(axes.x_low, axes.x_high):
        x, _ = axes.at(value, axes.y_low)
        canvas.line(x, axes.bottom, x, axes.bottom + axes.height)
    for value in ticks(axes.y_low, axes.y_high):
        _, y = axes.at(axes.x_low, value)
        canvas.line(axes.x, y, axes.x + axes.width, y)


def _cut_to_colours(picture: RgbImage) -> tuple[tuple[int, int], tuple[int, int], RgbImage] | None:
    """Rows, columns and pixels of the least box around what is not white; None where all is."""
    rows, cols, _ = np.nonzero(picture < 255)
    if not len(rows):
        return None
    box = (int(rows.min()), int(rows.max()) + 1), (int(cols.min()), int(cols.max()) + 1)
    return *box, picture[box[0][0] : box[0][1], box[1][0] : box[1][1]]


def draw_level_key(
    canvas: Canvas, levels: Sequence[tuple[float, PlaneView]], x: float, top: float, width: float
) -> None:
    """Draw which outline is which lightness."""
    room = width / max(len(levels), 1)
    y = top - 0.5 * SMALL.leading
    canvas.setDash()
    for place, (level, plane) in enumerate(levels):
        left = x + place * room
        canvas.setStrokeColor(level_colour(level))
        canvas.setLineWidth(1.6)
        canvas.line(left, y, left + 8, y)
        draw_text(canvas, f"{level:g}", left + 10, top, room - 11, SMALL if len(plane.outline) else SMALL_MUTED)


def lightness_axes(x: float, top: float, width: float, height: float, upward: tuple[float, float]) -> Axes:
    """Axes with lightness across, from white at the left to black at the right."""
    return chart_axes(x, top, width, height, (100.0, 0.0), upward)


def draw_falling_grid(canvas: Canvas, axes: Axes, x_label: str, y_label: str, *, y_most: int = 5) -> None:
    """As `draw_grid`, for axes whose ``x_low`` is above ``x_high``."""
    canvas.setFillColor(WHITE)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=0, fill=1)
    canvas.setDash()
    marks = ticks(axes.x_high, axes.x_low, 6)
    for value, label in zip(marks, tick_labels(marks), strict=True):
        px, _ = axes.at(value, axes.y_low)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.3)
        canvas.line(px, axes.bottom, px, axes.bottom + axes.height)
        draw_text(canvas, label, px - 20, axes.bottom - 2, 40, SMALL_MUTED, align="centre")
    upward = ticks(axes.y_low, axes.y_high, y_most)
    for value, label in zip(upward, tick_labels(upward), strict=True):
        _, py = axes.at(axes.x_low, value)
        canvas.setStrokeColor(RULE)
        canvas.setLineWidth(0.7 if value == 0 else 0.3)
        canvas.line(axes.x, py, axes.x + axes.width, py)
        draw_text(canvas, label, axes.x - 34, py + 4.3, 31, SMALL_MUTED, align="right")
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.6)
    canvas.rect(axes.x, axes.bottom, axes.width, axes.height, stroke=1, fill=0)
    if x_label:
        draw_text(canvas, x_label, axes.x, axes.bottom - 11, axes.width, SMALL, align="right")
    draw_text(canvas, y_label, axes.x, axes.bottom + axes.height + 11, axes.width, SMALL)


def draw_bar(canvas: Canvas, value: float, full: float, x: float, top: float, width: float, height: float) -> None:
    """Draw a bar from 0 to ``full``."""
    canvas.setFillColor(ACCENT)
    canvas.rect(x, top - height, min(value / full, 1.0) * width if full > 0 else 0.0, height, stroke=0, fill=1)
