"""Shade lots: when each was made, how they differ; and how much the faces vary by design."""

from __future__ import annotations

import numpy as np

from tilefab.report.charts import Axes, draw_grid
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.line_charts import TimeAxis, around, clock_text, draw_dots, signed, time_panel
from tilefab.report.line_figures import ColourSeries, colour_series
from tilefab.report.line_parts import Cell, Column, figure_row, muted_note, table
from tilefab.report.line_view import LineReportView, LotView, VariationView
from tilefab.report.profile_charts import begin_clip, fill_colour
from tilefab.report.profile_pages_summary import subheading
from tilefab.report.style import (
    ACCENT,
    BOLD,
    GREY,
    INK,
    LEFT,
    MM,
    RULE,
    SMALL_STRONG,
    WHITE,
    WIDTH,
    Canvas,
    TextStyle,
    draw_text,
    number,
    percent,
)

SECTION = "Shade and variation"
_NOTE = (
    "Every face differs by design, so lots are made of what the kiln did: the mean of each tile fired less that of its "
    "own predicted face. Tiles of one lot match each other and may lie in one box."
)
_MOST_LANES, _MOST_LOTS, _SHORT_TABLE = 10, 120, 8
_LANE = 5 * MM
_PLANE_HEIGHT = 66 * MM
_MOST_POINTS = 1500
_LETTER = TextStyle(BOLD, 7, 9, WHITE)


def shade_pages(view: LineReportView) -> list[Page]:
    """Make the pages."""
    series = colour_series(view.tiles)
    blocks = [section_heading("Shade lots", _NOTE)]
    if view.lots:
        blocks += [_lanes(view, series), space(4 * MM), _planes(view, series), space(3 * MM)]
    else:
        blocks.append(text_block("No shade lots were made: no tile's colour was measured."))
    by_design = [subheading("Variation of the faces by design"), *_variation(view.variation)]
    lots = [subheading("Lots"), *_table(view)] if view.lots else []
    # Many lots need pages of their own: what is short goes before them.
    parts = (lots, by_design) if len(view.lots) <= _SHORT_TABLE else (by_design, lots)
    blocks += [*parts[0], space(4 * MM), *parts[1]]
    return flow(SECTION, blocks)


def _lanes(view: LineReportView, series: ColourSeries) -> Block:
    """Build a lane for each of the largest lots, with a tick for each of its tiles over time."""
    chosen = sorted(view.lots, key=lambda lot: -lot.tiles)[:_MOST_LANES]
    lanes = [lot for lot in view.lots if lot in chosen]
    axis = TimeAxis.of(view)
    height = len(lanes) * _LANE + 10 * MM
    title = "Which lot tiles went to, over time"
    if len(lanes) < len(view.lots):
        title += f": the largest {len(lanes)} of {len(view.lots)} lots"
    lots = np.array(series.lots)

    def draw(canvas: Canvas, top: float) -> None:
        axes = time_panel(
            canvas, axis, title, LEFT, top, WIDTH, height, 0.0, float(len(lanes)), clock=True, scale=False
        )
        for place, lot in enumerate(lanes):
            y = axes.bottom + (len(lanes) - place - 1) * _LANE
            _chip(canvas, lot, LEFT + 2 * MM, y + 0.8 * MM)
            canvas.setStrokeColor(RULE)
            canvas.setLineWidth(0.3)
            canvas.line(axes.x, y, axes.x + axes.width, y)
            at_s = series.at_s[lots == lot.name]
            ticks = np.unique(np.round((at_s - axis.begun_s) / (axis.ended_s - axis.begun_s) * axes.width / 0.4))
            path = canvas.beginPath()
            for tick in ticks:
                if 0 <= tick * 0.4 <= axes.width:
                    path.rect(axes.x + tick * 0.4 - 0.2, y + 0.9 * MM, 0.4, _LANE - 1.8 * MM)
            canvas.setFillColor(INK if place % 2 else ACCENT)
            canvas.drawPath(path, stroke=0, fill=1)

    return Block(height, draw)


def _chip(canvas: Canvas, lot: LotView, x: float, y: float) -> None:
    """Draw a lot's colour with its letter on it."""
    rgb = lot.rgb or (110, 110, 110)
    canvas.setDash()
    canvas.setFillColor(fill_colour(rgb))
    canvas.setStrokeColor(GREY)
    canvas.setLineWidth(0.4)
    canvas.rect(x, y, 7 * MM, 3.4 * MM, stroke=1, fill=1)
    bright = 0.3 * rgb[0] + 0.59 * rgb[1] + 0.11 * rgb[2] > 140
    style = TextStyle(BOLD, 7, 9, INK) if bright else _LETTER
    draw_text(canvas, lot.name, x, y + 3.4 * MM - 0.2, 7 * MM, style, align="centre", shrink=0.6)


def _planes(view: LineReportView, series: ColourSeries) -> Block:
    half = (WIDTH - 8 * MM) / 2
    step = max(1, -(-len(series.at_s) // _MOST_POINTS))
    points = series.difference_lab[::step]

    def draw(canvas: Canvas, top: float) -> None:
        for place, (first, second, title) in enumerate(
            ((1, 2, "Hue and chroma: Δb* over Δa*"), (1, 0, "Lightness: ΔL* over Δa*"))
        ):
            x = LEFT + place * (half + 8 * MM)
            middles = np.array([lot.difference_lab for lot in view.lots])
            every = np.concatenate([points, middles])
            wide, high = half - 13 * MM, _PLANE_HEIGHT - 17 * MM
            across, upward = around(every[:, first], least=1.0), around(every[:, second], least=1.0)
            unit = max((across[1] - across[0]) / wide, (upward[1] - upward[0]) / high) / 2
            mid_x, mid_y = sum(across) / 2, sum(upward) / 2
            axes = Axes(
                x + 11 * MM,
                top - _PLANE_HEIGHT + 8 * MM,
                wide,
                high,
                mid_x - unit * wide,
                mid_x + unit * wide,
                mid_y - unit * high,
                mid_y + unit * high,
            )
            draw_text(canvas, title, x, top, half, SMALL_STRONG)
            draw_grid(canvas, axes, "Δa*", "Δb*" if second == 2 else "ΔL*")
            begin_clip(canvas, axes)
            draw_dots(canvas, axes, points[:, first], points[:, second], side=1.2 if len(points) > 100 else 2.2)
            canvas.restoreState()
            for lot in view.lots[:_MOST_LANES]:
                px, py = axes.at(lot.difference_lab[first], lot.difference_lab[second])
                canvas.setStrokeColor(WHITE)
                canvas.setFillColor(ACCENT)
                canvas.setLineWidth(0.6)
                canvas.circle(px, py, 4.2, stroke=1, fill=1)
                draw_text(canvas, lot.name, px - 5, py + 4.7, 10, _LETTER, align="centre", shrink=0.5)

    return Block(_PLANE_HEIGHT, draw)


def _table(view: LineReportView) -> list[Block]:
    total = max(sum(lot.tiles for lot in view.lots), 1)
    columns = [Column("lot", 16 * MM), Column("tiles", 18 * MM, right=True), Column("share", 18 * MM, right=True)]
    columns += [Column(head, 18 * MM, right=True) for head in ("ΔL*", "Δa*", "Δb*", "spread ΔE00")]
    columns += [Column("first tile", 25 * MM, right=True), Column("last tile", 25 * MM, right=True)]
    shown = view.lots[:_MOST_LOTS]
    rows = [
        (
            lot.name,
            number(lot.tiles, 0),
            percent(100 * lot.tiles / total, even=True),
            *(signed(value) for value in lot.difference_lab),
            number(lot.spread_delta_e, 2),
            clock_text(lot.first_s, view.utc_offset_min)[5:],
            clock_text(lot.last_s, view.utc_offset_min)[5:],
        )
        for lot in shown
    ]
    note = "Differences are fired less predicted, means over the lot. Spread: the tile farthest from the lot's middle."
    if len(shown) < len(view.lots):
        note += f" The first {len(shown)} of {len(view.lots)} lots are listed; the JSON has all."
    return [*table(columns, rows), muted_note(note)]


def _variation(found: VariationView | None) -> list[Block]:
    if found is None:
        return [text_block("Not measured.")]
    plain = "–" if found.cmc_plain is None else number(found.cmc_plain, 2)
    why = "of plain tiles from their standard" if found.plain else "not told: that standard is for plain tile"
    return [
        figure_row(
            [
                Cell(found.look, "look, V0 to V4", "an aid, not the standard's own measure"),
                Cell(number(found.index, 2), "variation index", "its whole part is the look"),
                Cell(number(found.between_delta_e, 2), "ΔE00 between tiles", "of two tiles' mean colours"),
                Cell(number(found.within_delta_e, 2), "ΔE00 within a tile", "of its parts from its mean"),
                Cell(plain, "CMC, ISO 10545-16", why),
            ]
        ),
        muted_note(found.note),
    ]
