"""The first page of a line report: what a manager needs to know, in ten seconds."""

from __future__ import annotations

from dataclasses import replace

from tilefab.inspection.records import Grade
from tilefab.report.layout import Block, Page, flow, section_heading, space, two_columns
from tilefab.report.line_charts import (
    TimeAxis,
    around,
    clock_text,
    draw_level,
    draw_stream,
    empty_panel,
    span_text,
    time_panel,
)
from tilefab.report.line_figures import LineFigures, TileCounts, colour_series, shift_figures
from tilefab.report.line_parts import Cell, Column, figure_row, grade_fill, line_name, table
from tilefab.report.line_view import LineReportView
from tilefab.report.profile_pages_summary import subheading, warning_block
from tilefab.report.profile_view import VerdictView
from tilefab.report.style import (
    ACCENT,
    BODY,
    BOLD,
    GREY,
    INK,
    LEFT,
    MM,
    MUTED,
    SMALL_MUTED,
    STRONG,
    SUBHEADING,
    TITLE,
    WHITE,
    WIDTH,
    Canvas,
    TextStyle,
    draw_lines,
    draw_rule,
    draw_text,
    number,
    percent,
    short_hash,
    wrap,
)

SECTION = "Summary"
_MARK = TextStyle(BOLD, 7.5, 10, WHITE)
_GRADE_WIDTH = 15 * MM
_WHAT_WIDTH = 24 * MM
_CHART_HEIGHT = 42 * MM
_MOST_WARNINGS = 6
_FEW_SHIFTS = 4


def summary_pages(view: LineReportView, figures: LineFigures, verdicts: tuple[VerdictView, ...]) -> list[Page]:
    """Make the summary."""
    blocks = [_title(view), _grade_bar(figures.counts), *_figures(view, figures), space(4 * MM), subheading("In short")]
    blocks += [_verdict(verdict) for verdict in verdicts]
    if view.warnings:
        shown = view.warnings[:_MOST_WARNINGS]
        blocks += [space(3 * MM), subheading("Warnings"), *(warning_block(text) for text in shown)]
        if len(view.warnings) > len(shown):
            blocks.append(warning_block(f"{len(view.warnings) - len(shown)} more are in the JSON beside this report."))
    blocks += [space(3 * MM), _chart(view)]
    if 1 < len(view.shifts) <= _FEW_SHIFTS:
        blocks += [space(4 * MM), subheading("By shift"), *_shifts(view)]
    blocks += [space(4 * MM), subheading("The job"), *two_columns(_facts(view))]
    pages = flow(SECTION, blocks)
    if len(view.shifts) > _FEW_SHIFTS:
        pages += flow("Shifts", [section_heading("Shifts"), *_shifts(view)])
    return pages


def _title(view: LineReportView) -> Block:
    style = TITLE
    while style.size > 12 and len(wrap(view.title, WIDTH, style)) > 2:
        style = replace(style, size=style.size * 0.94, leading=style.leading * 0.94)
    titles = wrap(view.title, WIDTH, style, 2, middle=True)
    span = (
        f"{clock_text(view.begun_s, view.utc_offset_min)} to {clock_text(view.ended_s, view.utc_offset_min)}, "
        f"{span_text(max(view.ended_s - view.begun_s, 0.0))}"
    )
    lines = wrap(f"{line_name(view)}  ·  run {view.run}  ·  {span}", WIDTH, MUTED, 2)
    height = 4 * MM + SUBHEADING.leading + len(titles) * style.leading + len(lines) * MUTED.leading + 4 * MM

    def draw(canvas: Canvas, top: float) -> None:
        canvas.setFillColor(ACCENT)
        canvas.rect(LEFT, top - 1.2 * MM, 18 * MM, 1.2 * MM, stroke=0, fill=1)
        y = draw_text(canvas, view.scope, LEFT, top - 4 * MM, WIDTH, SUBHEADING)
        y = draw_lines(canvas, titles, LEFT, y, style)
        draw_lines(canvas, lines, LEFT, y, MUTED)

    return Block(height, draw, keep=True)


def _grade_bar(counts: TileCounts) -> Block:
    """Build a bar of the page's width, divided into first choice, second choice, scrap and what is not graded."""
    parts = [
        (Grade.FIRST, counts.first, "first choice"),
        (Grade.SECOND, counts.second, "second choice"),
        (Grade.SCRAP, counts.scrap, "scrap"),
        (None, max(counts.printed - counts.inspected, 0), "not graded"),
    ]
    total = sum(count for _, count, _ in parts)
    bar = 5 * MM

    def draw(canvas: Canvas, top: float) -> None:
        x = LEFT
        for grade, count, _ in parts:
            if count:
                wide = WIDTH * count / total
                grade_fill(canvas, grade, x, top - bar, wide, bar)
                x += wide
        if not total:
            grade_fill(canvas, None, LEFT, top - bar, WIDTH, bar)
        x = LEFT
        for grade, count, label in parts:
            if count:
                grade_fill(canvas, grade, x, top - bar - 3.9 * MM, 3 * MM, 2 * MM)
                draw_text(canvas, label, x + 4 * MM, top - bar - 1.4 * MM, 30 * MM, SMALL_MUTED)
                x += 34 * MM

    return Block(bar + 6.5 * MM, draw)


def _figures(view: LineReportView, figures: LineFigures) -> list[Block]:
    counts = figures.counts
    of_planned = "" if view.planned is None else f"of {number(view.planned, 0)} planned"
    seen = f"{number(counts.waiting, 0)} printed weren't seen (yet)" if counts.waiting else "all that were printed"

    def share(count: int) -> str:
        return f"{percent(100 * count / counts.inspected, even=True)} of graded tiles" if counts.inspected else ""

    tolerance = view.limits.delta_e_mean
    target = "no tolerance set" if tolerance is None else f"tolerance {number(tolerance)}"
    mean = "–" if figures.delta_e_mean is None else number(figures.delta_e_mean, 2)
    held = [hold for hold in view.holds if hold.ended_s is None]
    used = "–" if figures.ink_used is None else number(figures.ink_used, 0 if figures.ink_used >= 100 else 1)
    made = len(view.corrections)
    alarms, open_alarms = len(view.alarms), sum(alarm.ended_s is None for alarm in view.alarms)
    return [
        figure_row(
            [
                Cell(number(counts.printed, 0), "printed", of_planned),
                Cell(number(counts.fired, 0), "seen behind the kiln", seen if counts.printed else ""),
                Cell(number(counts.first, 0), "first choice", share(counts.first)),
                Cell(number(counts.second, 0), "second choice", share(counts.second)),
                Cell(number(counts.scrap, 0), "scrap", share(counts.scrap)),
            ]
        ),
        figure_row(
            [
                Cell(mean, "mean ΔE00", f"against each tile's own face, {target}"),
                Cell(
                    number(made, 0),
                    "correction" if made == 1 else "corrections",
                    "the controller holds" if held else _drift(figures),
                    alert=bool(held),
                ),
                Cell(
                    span_text(figures.downtime_s) if view.downtime else "none",
                    "downtime",
                    f"{percent(100 * figures.availability)} running",
                ),
                Cell(used, f"ink, {view.ink_unit}" if view.ink_unit else "ink", _saved(figures)),
                Cell(
                    number(alarms, 0),
                    "alarm" if alarms == 1 else "alarms",
                    f"{number(open_alarms, 0)} without an end" if open_alarms else "all over",
                    alert=open_alarms > 0,
                ),
            ]
        ),
    ]


def _drift(figures: LineFigures) -> str:
    return "" if figures.drift_delta_e is None else f"of drift up to ΔE {number(figures.drift_delta_e)}"


def _saved(figures: LineFigures) -> str:
    if figures.ink_saved is None or figures.ink_used is None:
        return "saving not known"
    share = 100 * figures.ink_saved / max(figures.ink_used + figures.ink_saved, 1e-12)
    return f"{number(figures.ink_saved, 0 if figures.ink_saved >= 100 else 1)} saved, {percent(share)}"


def _verdict(verdict: VerdictView) -> Block:
    lines = wrap(verdict.text, WIDTH - _GRADE_WIDTH - _WHAT_WIDTH, BODY, 3)
    height = len(lines) * BODY.leading + 2.2 * MM

    def draw(canvas: Canvas, top: float) -> None:
        filled = {"good": ACCENT, "poor": INK}.get(verdict.grade)
        edge = ACCENT if verdict.grade in ("good", "fair") else INK if filled else GREY
        canvas.setStrokeColor(edge)
        canvas.setLineWidth(0.7)
        canvas.setDash()
        canvas.setFillColor(filled or WHITE)
        box = BODY.leading
        canvas.rect(LEFT, top - 1.1 * MM - box, _GRADE_WIDTH - 3 * MM, box, stroke=1, fill=1)
        style = _MARK if filled else TextStyle(BOLD, 7.5, 10, edge)
        label = "–" if verdict.grade == "none" else verdict.grade
        draw_text(canvas, label, LEFT, top - 1.1 * MM - 0.5, _GRADE_WIDTH - 3 * MM, style, align="centre")
        draw_text(canvas, verdict.what, LEFT + _GRADE_WIDTH, top - 1.1 * MM, _WHAT_WIDTH - 2 * MM, STRONG, shrink=0.8)
        draw_lines(canvas, lines, LEFT + _GRADE_WIDTH + _WHAT_WIDTH, top - 1.1 * MM, BODY)
        draw_rule(canvas, LEFT, top - height, WIDTH, thickness=0.35)

    return Block(height, draw)


def _chart(view: LineReportView) -> Block:
    series = colour_series(view.tiles)
    title = "Colour of the fired tiles: mean ΔE00 of each, corrections marked"

    def draw(canvas: Canvas, top: float) -> None:
        if not len(series.at_s):
            empty_panel(canvas, title, "no tile was measured", LEFT, top, WIDTH, _CHART_HEIGHT)
            return
        limit = view.limits.delta_e_mean
        low, high = around([*series.delta_e, *([1.15 * limit] if limit else [])], least=1.0, zero=True)
        axis = TimeAxis.of(view)
        axes = time_panel(
            canvas, axis, title, LEFT, top, WIDTH, _CHART_HEIGHT, low, high, clock=True, numbers=bool(axis.corrections)
        )
        draw_stream(canvas, axes, series.at_s, series.delta_e)
        if limit is not None:
            draw_level(canvas, axes, limit, f"tolerance {number(limit)}")

    return Block(_CHART_HEIGHT, draw)


def _shifts(view: LineReportView) -> list[Block]:
    columns = [Column("shift", 46 * MM)]
    columns += [
        Column(head, 128 * MM / 8, right=True)
        for head in ("printed", "fired", "first", "second", "scrap", "mean ΔE00", "corrections", "running")
    ]
    rows = []
    for name, figures, corrections in shift_figures(view):
        counts = figures.counts
        rows.append(
            (
                name,
                *(number(n, 0) for n in (counts.printed, counts.fired, counts.first, counts.second, counts.scrap)),
                "–" if figures.delta_e_mean is None else number(figures.delta_e_mean, 2),
                number(corrections, 0),
                percent(100 * figures.availability),
            )
        )
    return table(columns, rows, max_lines=1)


def _facts(view: LineReportView) -> list[tuple[str, str]]:
    width, height = view.tile_size_mm
    return [
        *([] if any(label == "Tile" for label, _ in view.facts) else [("Tile", f"{width:g} × {height:g} mm")]),
        *view.facts,
        ("Job file", view.job_file),
        ("Job", short_hash(view.job_hash)),
        ("Texture map", short_hash(view.map_hash)),
        ("Press profile", short_hash(view.profile_hash)),
    ]
