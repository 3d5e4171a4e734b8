"""Defects: where on the tile they lie, how often each kind comes; and the tiles' dimensions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import accumulate

import numpy as np
from PIL import Image
from reportlab.lib.colors import Color

from tilefab.inspection.records import Defect, DefectKind, Grade, TileDimensions
from tilefab.report.charts import Axes
from tilefab.report.figures import draw_image
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.line_figures import defect_counts
from tilefab.report.line_parts import Column, grade_fill, muted_note, table
from tilefab.report.line_view import LineReportView
from tilefab.report.profile_pages_summary import subheading
from tilefab.report.style import (
    ACCENT,
    GREY,
    INK,
    LEFT,
    MM,
    PALE,
    RULE,
    SMALL,
    SMALL_MUTED,
    SMALL_STRONG,
    SUBHEADING,
    WIDTH,
    Canvas,
    draw_text,
    number,
    percent,
)
from tilefab.report.view_model import RgbImage

SECTION = "Defects and dimensions"
_MAP_HEIGHT = 108 * MM
_LEGEND_WIDTH = 44 * MM
_MOST_MARKS = 4000
_BAR_ROW = 5.6 * MM
_PALED = 0.62
_NOTE = (
    "Defects are what differs from the tile's own predicted face. The map lays all of them over one tile: marks that "
    "pile up in one place or along one column point at the machine, scattered ones at clay, glaze or handling."
)
_Mark = Callable[[Canvas, float, float], None]


def defect_pages(view: LineReportView) -> list[Page]:
    """Make the pages."""
    defects = [defect for tile in view.tiles for defect in tile.defects]
    blocks = [section_heading(SECTION, _NOTE)]
    if defects:
        blocks += [_map(view, defects), space(4 * MM), subheading("How often"), *_pareto(view)]
    else:
        inspected = any(tile.grade is not None for tile in view.tiles)
        blocks.append(text_block("No defect was found." if inspected else "No tile was inspected."))
    blocks += [space(5 * MM), subheading("Dimensions, in the terms of ISO 10545-2:2018"), *_dimensions(view)]
    return flow(SECTION, blocks)


def _map(view: LineReportView, defects: Sequence[Defect]) -> Block:
    wide, high = view.tile_size_mm
    kinds = [kind for kind, _, _, _ in defect_counts(view.tiles)]
    scale = min((WIDTH - _LEGEND_WIDTH - 6 * MM) / wide, _MAP_HEIGHT / high)
    width, height = wide * scale, high * scale
    # Evenly thinned, the worst kept: they're what the reader looks for.
    by_grade = sorted(defects, key=lambda defect: _SERIOUS[defect.grade])
    kept = by_grade[:: max(1, -(-len(by_grade) // _MOST_MARKS))]

    def draw(canvas: Canvas, top: float) -> None:
        if view.tile_picture is None:
            canvas.setFillColor(PALE)
            canvas.rect(LEFT, top - height, width, height, stroke=0, fill=1)
        else:
            # The view gives the finished tile; a picture of another shape is stretched to it, as the marks are.
            draw_image(canvas, _paled(view.tile_picture, wide / high), LEFT, top, width, height, centre=False)
        canvas.setStrokeColor(GREY)
        canvas.setLineWidth(0.7)
        canvas.setDash()
        canvas.rect(LEFT, top - height, width, height, stroke=1, fill=0)
        axes = Axes(LEFT, top - height, width, height, 0.0, wide, high, 0.0)
        for defect in reversed(kept):
            _draw_defect(canvas, axes, defect)
        _draw_legend(canvas, kinds, LEFT + width + 6 * MM, top)
        note = "upper left corner of the face at the upper left"
        if len(kept) < len(defects):
            note += f"; {number(len(kept), 0)} of {number(len(defects), 0)} shown, the worst first"
        draw_text(canvas, note, LEFT, top - height - 1 * MM, WIDTH, SMALL_MUTED)

    return Block(height + SMALL_MUTED.leading + 1 * MM, draw)


_SERIOUS = {Grade.SCRAP: 0, Grade.SECOND: 1, Grade.FIRST: 2}


def _paled(picture: RgbImage, aspect: float) -> RgbImage:
    rows, cols = picture.shape[:2]
    shape = (cols, max(1, round(cols / aspect))) if abs(cols / rows - aspect) > 0.01 * aspect else (cols, rows)
    resized = np.asarray(Image.fromarray(np.ascontiguousarray(picture)).resize(shape), dtype=np.float64)
    return np.asarray(255.0 - (1.0 - _PALED) * (255.0 - resized), dtype=np.uint8)


def _draw_defect(canvas: Canvas, axes: Axes, defect: Defect) -> None:
    """Draw a long defect as its box, and the mark of its kind in its middle."""
    x, y = axes.at(defect.x_mm, defect.y_mm)
    wide, high = defect.width_mm / abs(axes.x_high) * axes.width, defect.height_mm / abs(axes.y_low) * axes.height
    colour = _colour(defect.grade)
    if max(wide, high) > 6.0:
        canvas.setStrokeColor(colour)
        canvas.setLineWidth(0.7)
        left, right = max(x - wide / 2, axes.x), min(x + wide / 2, axes.x + axes.width)
        low, top = max(y - high / 2, axes.bottom), min(y + high / 2, axes.bottom + axes.height)
        canvas.rect(left, low, max(right - left, 0.7), max(top - low, 0.7), stroke=1, fill=0)
    canvas.setStrokeColor(colour)
    canvas.setFillColor(colour)
    canvas.setLineWidth(1.0)
    _MARKS[defect.kind](canvas, x, y)


def _colour(grade: Grade) -> Color:
    return {Grade.SCRAP: INK, Grade.SECOND: ACCENT}.get(grade, GREY)


def _draw_legend(canvas: Canvas, kinds: Sequence[DefectKind], x: float, top: float) -> None:
    draw_text(canvas, "Kinds", x, top, _LEGEND_WIDTH, SUBHEADING)
    y = top - SUBHEADING.leading - 1 * MM
    for kind in kinds:
        canvas.setStrokeColor(INK)
        canvas.setFillColor(INK)
        canvas.setLineWidth(1.0)
        _MARKS[kind](canvas, x + 4, y - 0.5 * SMALL.leading)
        draw_text(canvas, kind_text(kind), x + 12, y, _LEGEND_WIDTH - 12, SMALL)
        y -= SMALL.leading + 0.8 * MM
    y -= 2 * MM
    draw_text(canvas, "What it costs the tile", x, y, _LEGEND_WIDTH, SUBHEADING)
    y -= SUBHEADING.leading + 1 * MM
    for grade, label in ((Grade.SCRAP, "scrap"), (Grade.SECOND, "second choice"), (Grade.FIRST, "still first choice")):
        canvas.setFillColor(_colour(grade))
        canvas.rect(x, y - 0.5 * SMALL.leading - 2.5, 8, 5, stroke=0, fill=1)
        draw_text(canvas, label, x + 12, y, _LEGEND_WIDTH - 12, SMALL)
        y -= SMALL.leading + 0.8 * MM


def kind_text(kind: DefectKind) -> str:
    """A kind of defect, for people.

    >>> kind_text(DefectKind.NOZZLE_LINE)
    'nozzle line'
    """
    return kind.value.replace("_", " ")


def _bar(dx: float, dy: float) -> _Mark:
    return lambda canvas, x, y: canvas.line(x - dx, y - dy, x + dx, y + dy)


def _ring(radius: float, fill: int) -> _Mark:
    return lambda canvas, x, y: canvas.circle(x, y, radius, stroke=1, fill=fill)


def _square(side: float, fill: int) -> _Mark:
    return lambda canvas, x, y: canvas.rect(x - side / 2, y - side / 2, side, side, stroke=1, fill=fill)


def _lines(*points: tuple[float, float], closed: bool = False, fill: int = 0) -> _Mark:
    def draw(canvas: Canvas, x: float, y: float) -> None:
        path = canvas.beginPath()
        path.moveTo(x + points[0][0], y + points[0][1])
        for dx, dy in points[1:]:
            path.lineTo(x + dx, y + dy)
        if closed:
            path.close()
        canvas.drawPath(path, stroke=1, fill=fill)

    return draw


def _cross(size: float) -> _Mark:
    first, second = _bar(size, size), _bar(size, -size)

    def draw(canvas: Canvas, x: float, y: float) -> None:
        first(canvas, x, y)
        second(canvas, x, y)

    return draw


_MARKS: dict[DefectKind, _Mark] = {
    DefectKind.NOZZLE_LINE: _bar(0.0, 3.4),
    DefectKind.BANDING: _bar(3.4, 0.0),
    DefectKind.SPOT: _ring(1.8, 1),
    DefectKind.PINHOLE: _ring(1.8, 0),
    DefectKind.SCRATCH: _bar(2.4, 2.4),
    DefectKind.CRACK: _lines((-3.0, 1.2), (-1.0, -1.4), (1.0, 1.4), (3.0, -1.2)),
    DefectKind.CHIP: _lines((-2.2, -2.0), (2.2, -2.0), (-2.2, 2.4), closed=True, fill=1),
    DefectKind.MISREGISTRATION: _square(3.6, 0),
    DefectKind.MISSING_INK: _cross(2.0),
    DefectKind.DOUBLE_PRINT: _square(3.4, 1),
}


def _pareto(view: LineReportView) -> list[Block]:
    """Build a bar for each kind, the most frequent first, with its share and what came before it added up."""
    rows = defect_counts(view.tiles)
    inspected = max(sum(tile.grade is not None for tile in view.tiles), 1)
    most = max(on_tiles for _, _, on_tiles, _ in rows)
    total = sum(on_tiles for _, _, on_tiles, _ in rows)
    so_far = list(accumulate(on_tiles for _, _, on_tiles, _ in rows))
    columns = (36 * MM, 62 * MM, 19 * MM, 19 * MM, 19 * MM, 19 * MM)
    heads = ("", "tiles with it; hatched: still first choice", "tiles", "of graded", "defects", "added up")

    def row_block(texts: Sequence[str], bar: tuple[int, int] | None) -> Block:
        def draw(canvas: Canvas, top: float) -> None:
            x = LEFT
            for place, (text, width) in enumerate(zip(texts, columns, strict=True)):
                style = SMALL_MUTED if bar is None else (SMALL_STRONG if place == 0 else SMALL)
                align = "left" if place < 2 else "right"
                draw_text(canvas, text, x, top - 1.4 * MM, width - 2 * MM, style, align=align, shrink=0.8)
                x += width
            if bar is not None:
                on_tiles, cost = bar
                full = columns[1] - 4 * MM
                y, height = top - _BAR_ROW + 1.1 * MM, _BAR_ROW - 2.2 * MM
                left = LEFT + columns[0]
                grade_fill(canvas, Grade.SECOND, left, y, full * on_tiles / most, height)
                if cost:
                    grade_fill(canvas, Grade.FIRST, left, y, full * cost / most, height)
            canvas.setStrokeColor(INK if bar is None else RULE)
            canvas.setLineWidth(0.6 if bar is None else 0.3)
            canvas.line(LEFT, top - _BAR_ROW, LEFT + WIDTH, top - _BAR_ROW)

        return Block(_BAR_ROW, draw, keep=bar is None)

    blocks = [row_block(heads, None)]
    for (kind, defects, on_tiles, cost), added in zip(rows, so_far, strict=True):
        texts = (
            kind_text(kind),
            "",
            number(on_tiles, 0),
            percent(100 * on_tiles / inspected, even=True),
            number(defects, 0),
            percent(100 * added / total),
        )
        blocks.append(row_block(texts, (on_tiles, cost)))
    return blocks


def _dimensions(view: LineReportView) -> list[Block]:
    found = [tile.dimensions for tile in view.tiles if tile.dimensions is not None]
    if not found:
        return [text_block("No tile's dimensions were measured.")]
    limits = view.limits
    rows = [
        _dimension_row("width, mm", [one.width_mm for one in found], None),
        _dimension_row("height, mm", [one.height_mm for one in found], None),
        _dimension_row("size, % off the work size", [one.size_deviation_percent for one in found], limits.size_percent),
        _dimension_row(
            "straightness of sides, %", [one.straightness_percent for one in found], limits.straightness_percent
        ),
        _dimension_row(
            "rectangularity, %", [one.rectangularity_percent for one in found], limits.rectangularity_percent
        ),
    ]
    columns = [Column("", 50 * MM)]
    columns += [
        Column(head, 124 * MM / 6, right=True) for head in ("tiles", "least", "mean", "most", "tolerance", "within")
    ]
    return [*table(columns, rows), muted_note(_dimension_note(found))]


def _dimension_row(label: str, values: Sequence[float], limit: float | None) -> tuple[str, ...]:
    within = "–" if limit is None else percent(100 * float(np.mean(np.abs(values) <= limit)))
    return (
        label,
        number(len(values), 0),
        number(min(values), 2),
        number(float(np.mean(values)), 2),
        number(max(values), 2),
        "–" if limit is None else f"± {number(limit, 2)}",
        within,
    )


def _dimension_note(found: Sequence[TileDimensions]) -> str:
    note = "Percentages are of the work size; each tile's straightness and rectangularity are the worst of its sides."
    if not all(one.scale_known for one in found):
        note += " The camera's scale is not calibrated: sizes are relative to the work size, shapes are not affected."
    return note
