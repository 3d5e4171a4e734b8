"""The worst ten tiles: what each should look like and what came out of the kiln, side by side."""

from __future__ import annotations

from dataclasses import dataclass

from tilefab.inspection.records import Grade
from tilefab.report.figures import draw_image, draw_no_image
from tilefab.report.layout import Block, Page, flow, section_heading, text_block
from tilefab.report.line_charts import clock_text
from tilefab.report.line_pages_defects import kind_text
from tilefab.report.line_view import LineReportView, TileView, WorstTileView
from tilefab.report.style import (
    BODY,
    BOLD,
    GREY,
    GUTTER,
    INK,
    LEFT,
    MM,
    SMALL,
    SMALL_MUTED,
    STRONG,
    WHITE,
    WIDTH,
    Canvas,
    TextStyle,
    draw_rule,
    draw_text,
    number,
)

SECTION = "Worst tiles"
MOST = 10
_NOTE = (
    "Predicted and fired face of each, side by side. Defects are ringed; ticks at the edges point along lines and "
    "bands that run right across."
)
_MARK = TextStyle(BOLD, 6.5, 8.6, WHITE)
_OUTLINED = TextStyle(BOLD, 6.5, 8.6, INK)
_LABELS = {Grade.SCRAP: "scrap", Grade.SECOND: "second choice", Grade.FIRST: "first choice"}


_GAP = 1.5 * MM
_TALLEST = 52 * MM
_NARROWEST = 18 * MM
_TALL = 1.3
_FLAT = 27 * MM
_AROUND = 18.5 * MM
_MOST_RINGS = 12
_FAR = 0.4


@dataclass(frozen=True)
class _Grid:
    """Cards in a row of so many pictures each, for tiles that are so many times as high as wide."""

    columns: int
    pictures: int
    aspect: float

    @property
    def card(self) -> float:
        return (WIDTH - (self.columns - 1) * GUTTER) / self.columns

    @property
    def room(self) -> float:
        most = (self.card - (self.pictures - 1) * _GAP) / self.pictures
        return min(most, max(self.picture / self.aspect, _NARROWEST))

    @property
    def picture(self) -> float:
        most = (self.card - (self.pictures - 1) * _GAP) / self.pictures
        # Five rows of tiles that are not tall fit a page: all of the worst ten, if they stand two in a row.
        return min(most * self.aspect, _FLAT if self.aspect < _TALL else _TALLEST)

    @property
    def height(self) -> float:
        return self.picture + _AROUND


def worst_pages(view: LineReportView) -> list[Page]:
    """Make the pages."""
    worst = view.worst[:MOST]
    if not worst:
        return flow(SECTION, [section_heading(SECTION), text_block("No tile was inspected with pictures.")])
    wide, high = view.tile_size_mm
    # A long tile lying flat needs a row to itself to be seen; others stand two in a row.
    pictures = 2 if all(one.difference is None for one in worst) else 3
    grid = _Grid(1 if wide > 1.6 * high else 2, pictures, high / wide)
    rows = [worst[start : start + grid.columns] for start in range(0, len(worst), grid.columns)]
    return flow(SECTION, [section_heading(SECTION, _NOTE), *(_row(view, row, grid) for row in rows)])


def _row(view: LineReportView, row: tuple[WorstTileView, ...], grid: _Grid) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        for place, worst in enumerate(row):
            _draw_card(canvas, view, worst, LEFT + place * (grid.card + GUTTER), top, grid)

    return Block(grid.height, draw)


def _draw_card(canvas: Canvas, view: LineReportView, worst: WorstTileView, x: float, top: float, grid: _Grid) -> None:
    tile, width = worst.tile, grid.card
    draw_rule(canvas, x, top, width, GREY, 0.6)
    y = top - 0.8 * MM
    draw_text(canvas, f"Face {tile.face}", x, y, width - 24 * MM, STRONG, shrink=0.6)
    _draw_grade(canvas, tile.grade, x + width - 22 * MM, y)
    y -= STRONG.leading
    pictures = (("predicted", worst.predicted), ("fired", worst.fired), ("difference", worst.difference))[
        : grid.pictures
    ]
    room = grid.room
    for place, (label, picture) in enumerate(pictures):
        left = x + place * (room + _GAP)
        draw_text(canvas, label, left, y, room, SMALL_MUTED)
        if picture is None:
            draw_no_image(canvas, left, y - SMALL.leading, room, grid.picture)
        else:
            box = draw_image(canvas, picture, left, y - SMALL.leading, room, grid.picture, centre=False)
            if label == "fired":
                _draw_rings(canvas, tile, view.tile_size_mm, box)
    y -= SMALL.leading + grid.picture + 0.8 * MM
    y = draw_text(canvas, _figures(tile, view.utc_offset_min), x, y, width, SMALL)
    draw_text(canvas, _why(tile), x, y, width, BODY, max_lines=2, shrink=0.8)


def _draw_rings(
    canvas: Canvas, tile: TileView, size_mm: tuple[float, float], box: tuple[float, float, float, float]
) -> None:
    """Ring small defects in a picture, and point at the ends of those that run far across it."""
    left, top, width, height = box
    canvas.setDash()
    for defect in tile.defects[:_MOST_RINGS]:
        x = left + min(max(defect.x_mm / size_mm[0], 0.0), 1.0) * width
        y = top - min(max(defect.y_mm / size_mm[1], 0.0), 1.0) * height
        for colour, thickness in ((WHITE, 1.8), (INK, 0.7)):
            canvas.setStrokeColor(colour)
            canvas.setLineWidth(thickness)
            if defect.height_mm > _FAR * size_mm[1]:
                canvas.line(x, top, x, top - 5)
                canvas.line(x, top - height, x, top - height + 5)
            elif defect.width_mm > _FAR * size_mm[0]:
                canvas.line(left, y, left + 5, y)
                canvas.line(left + width, y, left + width - 5, y)
            else:
                canvas.circle(x, y, 4.5, stroke=1, fill=0)


def _draw_grade(canvas: Canvas, grade: Grade | None, x: float, top: float) -> None:
    box = 22 * MM
    canvas.setDash()
    canvas.setStrokeColor(INK)
    canvas.setLineWidth(0.6)
    canvas.setFillColor(INK if grade is Grade.SCRAP else WHITE)
    canvas.rect(x, top - 9.6, box, 9.2, stroke=1, fill=1)
    label = "not graded" if grade is None else _LABELS[grade]
    style = _MARK if grade is Grade.SCRAP else _OUTLINED
    draw_text(canvas, label, x, top - 0.6, box, style, align="centre", shrink=0.7)


def _figures(tile: TileView, offset_min: int) -> str:
    parts = []
    if tile.colour is not None:
        parts.append(f"ΔE00 {number(tile.colour.delta_e_mean, 2)}, 95 % {number(tile.colour.delta_e_p95, 2)}")
    if tile.fired_s is not None:
        parts.append(f"fired {clock_text(tile.fired_s, offset_min)[5:]}")
    parts.append(f"correction {tile.correction}" if tile.correction else "no correction")
    if tile.lot:
        parts.append(f"lot {tile.lot}")
    return "  ·  ".join(parts)


def _why(tile: TileView) -> str:
    if tile.reasons:
        return "; ".join(tile.reasons)
    if tile.defects:
        return ", ".join(kind_text(defect.kind) for defect in tile.defects[:4])
    return "nothing wrong was found"
