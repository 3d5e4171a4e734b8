"""Parts that several pages of a line report share: cells of figures, bars, tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tilefab.inspection.records import Grade
from tilefab.report.layout import Block
from tilefab.report.line_charts import hatch
from tilefab.report.line_view import LineReportView
from tilefab.report.style import (
    ACCENT,
    BOLD,
    GREY,
    INK,
    LEFT,
    MM,
    REGULAR,
    RULE,
    SMALL_MUTED,
    WHITE,
    WIDTH,
    Canvas,
    TextStyle,
    draw_lines,
    draw_rule,
    draw_text,
    wrap,
)

_FIGURE = TextStyle(BOLD, 16, 20, INK)
_LABEL = TextStyle(BOLD, 7, 9, INK)
_NOTE = TextStyle(REGULAR, 6, 7.6, GREY)
FIGURES_HEIGHT = 18 * MM

_ALERT = tuple(TextStyle(style.font, style.size, style.leading, WHITE) for style in (_FIGURE, _LABEL, _NOTE))


def line_name(view: LineReportView) -> str:
    """The line's name, and that it is a line's unless it says so itself."""
    return view.line if "line" in view.line.lower() else f"Line {view.line}"


@dataclass(frozen=True)
class Cell:
    """A figure with its label and a note; ``alert`` sets it on black."""

    figure: str
    label: str
    note: str = ""
    alert: bool = False


def figure_row(cells: Sequence[Cell]) -> Block:
    """Build a row of large figures between rules."""
    width = WIDTH / len(cells)

    def draw(canvas: Canvas, top: float) -> None:
        draw_rule(canvas, LEFT, top, WIDTH, INK, 0.8)
        draw_rule(canvas, LEFT, top - FIGURES_HEIGHT, WIDTH, RULE, 0.5)
        for place, cell in enumerate(cells):
            x = LEFT + place * width
            if cell.alert:
                canvas.setFillColor(INK)
                canvas.rect(x, top - FIGURES_HEIGHT, width, FIGURES_HEIGHT, stroke=0, fill=1)
            elif place and not cells[place - 1].alert:
                canvas.setStrokeColor(RULE)
                canvas.setLineWidth(0.5)
                canvas.setDash()
                canvas.line(x, top - 2 * MM, x, top - FIGURES_HEIGHT + 2 * MM)
            figure, label, note = _ALERT if cell.alert else (_FIGURE, _LABEL, _NOTE)
            inset = 0.0 if place == 0 and not cell.alert else 2.5 * MM
            room = width - inset - 1.5 * MM
            draw_text(canvas, cell.figure, x + inset, top - 1.5 * MM, room, figure, shrink=0.4)
            y = draw_text(canvas, cell.label, x + inset, top - 1.5 * MM - figure.leading, room, label, shrink=0.8)
            draw_text(canvas, cell.note, x + inset, y, room, note, max_lines=2)

    return Block(FIGURES_HEIGHT, draw)


def grade_fill(canvas: Canvas, grade: Grade | None, x: float, y: float, width: float, height: float) -> None:
    """Fill a rectangle the way a grade is always shown: first choice tinted, second hatched, scrap black."""
    canvas.setDash()
    canvas.setFillColor({Grade.FIRST: ACCENT, Grade.SCRAP: INK}.get(grade, WHITE) if grade else WHITE)
    canvas.rect(x, y, width, height, stroke=0, fill=1)
    canvas.setStrokeColor(ACCENT if grade is not Grade.SCRAP else INK)
    if grade is Grade.SECOND:
        hatch(canvas, x, y, width, height)
    canvas.setLineWidth(0.6)
    canvas.rect(x, y, width, height, stroke=1, fill=0)


@dataclass(frozen=True)
class Column:
    """A table's column: its head, its width in points, and whether its figures stand at the right."""

    head: str
    width: float
    right: bool = False


def table(
    columns: Sequence[Column], rows: Sequence[Sequence[str]], *, max_lines: int = 2, x: float = LEFT
) -> list[Block]:
    """Build a table whose head is drawn again on every page; widths should add up to the page's."""
    gap = 2.5 * MM
    total = sum(column.width for column in columns)

    def draw_head(canvas: Canvas, top: float) -> None:
        left = x
        for column in columns:
            align = "right" if column.right else "left"
            draw_text(canvas, column.head, left, top, column.width - gap, SMALL_MUTED, align=align, shrink=0.8)
            left += column.width
        draw_rule(canvas, x, top - SMALL_MUTED.leading - 0.8 * MM, total, INK, 0.6)

    head = Block(SMALL_MUTED.leading + 1.2 * MM, draw_head, keep=True)
    return [head, *(_table_row(columns, row, max_lines, gap, x, total, head) for row in rows)]


_CELL = TextStyle(REGULAR, 7, 9, INK)


def _table_row(
    columns: Sequence[Column], row: Sequence[str], max_lines: int, gap: float, x: float, total: float, head: Block
) -> Block:
    cells = [
        wrap(text, column.width - gap, _CELL, max_lines, middle=column.right is False and max_lines == 1)
        for column, text in zip(columns, row, strict=True)
    ]
    height = max(len(lines) for lines in cells) * _CELL.leading + 1.6 * MM

    def draw(canvas: Canvas, top: float) -> None:
        left = x
        for column, lines in zip(columns, cells, strict=True):
            edge = left + column.width - gap if column.right else left
            draw_lines(canvas, lines, edge, top - 0.8 * MM, _CELL, "right" if column.right else "left")
            left += column.width
        draw_rule(canvas, x, top - height, total, thickness=0.3)

    return Block(height, draw, head=head)


def muted_note(text: str, max_lines: int = 4, *, keep: bool = False) -> Block:
    """Build a small muted paragraph; ``keep`` holds it on the page of what follows."""
    style = TextStyle(REGULAR, 6.5, 8.6, GREY)
    lines = wrap(text, WIDTH, style, max_lines)

    def draw(canvas: Canvas, top: float) -> None:
        draw_lines(canvas, lines, LEFT, top - 0.6 * MM, style)

    return Block(len(lines) * style.leading + 1.6 * MM, draw, keep=keep)
