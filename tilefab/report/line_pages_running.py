"""How the line ran: stops and alarms; and the ink it took."""

from __future__ import annotations

from collections.abc import Sequence

from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.line_charts import clock_text, hatch, span_text
from tilefab.report.line_figures import LineFigures, union_s
from tilefab.report.line_parts import Column, muted_note, table
from tilefab.report.line_view import InkUseView, LineReportView, SpanView
from tilefab.report.profile_pages_summary import subheading
from tilefab.report.style import (
    ACCENT,
    GREY,
    INK,
    LEFT,
    MM,
    RULE,
    SMALL,
    SMALL_MUTED,
    SMALL_STRONG,
    WIDTH,
    Canvas,
    draw_text,
    number,
    percent,
)

SECTION = "Ink, stops and alarms"
_MOST_ROWS = 120
_INK_ROW = 5.6 * MM
_INK_COLUMNS = (36 * MM, 78 * MM, 20 * MM, 20 * MM, 20 * MM)


def running_pages(view: LineReportView, figures: LineFigures) -> list[Page]:
    """Make the pages."""
    blocks = [section_heading(SECTION), subheading(_ink_title(view)), *_inks(view)]
    blocks += [space(6 * MM), subheading("Downtime"), *_downtime(view, figures)]
    blocks += [space(6 * MM), subheading("Alarms"), *_alarms(view)]
    return flow(SECTION, blocks)


def _ink_title(view: LineReportView) -> str:
    return f"Ink, {view.ink_unit}" if view.inks and view.ink_unit else "Ink"


def _inks(view: LineReportView) -> list[Block]:
    if not view.inks:
        return [text_block("The ink used is not known.")]
    most = max(ink.used + (ink.saved or 0.0) for ink in view.inks) or 1.0
    total = InkUseView(
        "all inks",
        sum(ink.used for ink in view.inks),
        sum(ink.saved or 0.0 for ink in view.inks) if any(ink.saved is not None for ink in view.inks) else None,
    )
    head = _ink_row(("", "used, and hatched what was saved", "used", "saved", "saved, %"), None, most, head=True)
    rows = [_ink_row(_ink_texts(ink), ink, most) for ink in view.inks]
    against = f"Saved against {view.ink_saved_against}." if view.ink_saved_against else ""
    return [head, *rows, _ink_row(_ink_texts(total), None, most), *([muted_note(against)] if against else [])]


def _ink_texts(ink: InkUseView) -> tuple[str, ...]:
    decimals = 0 if ink.used >= 100 else 2
    if ink.saved is None:
        return ink.name, "", number(ink.used, decimals), "–", "–"
    share = 100 * ink.saved / max(ink.used + ink.saved, 1e-12)
    return ink.name, "", number(ink.used, decimals), number(ink.saved, decimals), _signed_percent(share)


def _signed_percent(value: float) -> str:
    return f"−{percent(-value)}" if value < 0 else percent(value)


def _ink_row(texts: Sequence[str], ink: InkUseView | None, most: float, *, head: bool = False) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        x = LEFT
        for place, (text, width) in enumerate(zip(texts, _INK_COLUMNS, strict=True)):
            style = SMALL_MUTED if head else SMALL_STRONG if place == 0 or ink is None else SMALL
            align = "left" if place < 2 else "right"
            draw_text(canvas, text, x, top - 1.4 * MM, width - 2 * MM, style, align=align, shrink=0.8)
            x += width
        canvas.setDash()
        if ink is not None:
            full = _INK_COLUMNS[1] - 4 * MM
            left, y, height = LEFT + _INK_COLUMNS[0], top - _INK_ROW + 1.1 * MM, _INK_ROW - 2.2 * MM
            used = full * ink.used / most
            canvas.setFillColor(ACCENT)
            canvas.rect(left, y, used, height, stroke=0, fill=1)
            if ink.saved is not None and ink.saved > 0:
                canvas.setStrokeColor(GREY)
                hatch(canvas, left + used, y, full * ink.saved / most, height)
        canvas.setStrokeColor(INK if head else RULE)
        canvas.setLineWidth(0.6 if head else 0.3)
        canvas.line(LEFT, top - _INK_ROW, LEFT + WIDTH, top - _INK_ROW)

    return Block(_INK_ROW, draw, keep=head)


def _span_columns() -> list[Column]:
    return [
        Column("from", 29 * MM),
        Column("to", 29 * MM),
        Column("for", 20 * MM, right=True),
        Column("code", 34 * MM),
        Column("what it was", 62 * MM),
    ]


def _span_rows(spans: Sequence[SpanView], view: LineReportView) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for span in spans:
        end = view.ended_s if span.ended_s is None else span.ended_s
        rows.append(
            (
                clock_text(span.begun_s, view.utc_offset_min),
                "still" if span.ended_s is None else clock_text(span.ended_s, view.utc_offset_min),
                span_text(max(end - span.begun_s, 0.0)),
                span.code,
                span.text,
            )
        )
    return rows


def _by_cause(view: LineReportView) -> list[Block]:
    """Build a table of downtime by cause, the longest first."""
    codes = sorted({stop.code for stop in view.downtime})
    totals = []
    for code in codes:
        stops = [stop for stop in view.downtime if stop.code == code]
        totals.append((union_s(stops, view.begun_s, view.ended_s), len(stops), stops[-1].text, code))
    totals.sort(key=lambda row: (-row[0], row[3]))
    columns = [Column("cause", 40 * MM), Column("stops", 16 * MM, right=True), Column("in all", 24 * MM, right=True)]
    columns += [Column("share of the span", 26 * MM, right=True), Column("as last told", 68 * MM)]
    span = max(view.ended_s - view.begun_s, 1e-9)
    rows = [
        (code, number(count, 0), span_text(seconds), percent(100 * seconds / span), text)
        for seconds, count, text, code in totals
    ]
    return table(columns, rows[:_MOST_ROWS])


def _downtime(view: LineReportView, figures: LineFigures) -> list[Block]:
    if not view.downtime:
        return [text_block("The line ran without a stop.")]
    stops = sorted(view.downtime, key=lambda stop: stop.begun_s - (stop.ended_s or view.ended_s))[:_MOST_ROWS]
    shown = sorted(stops, key=lambda stop: stop.begun_s)
    note = (
        f"{span_text(figures.downtime_s)} of {span_text(max(figures.span_s, 0.0))}: running "
        f"{percent(100 * figures.availability)} of the time. Stops that overlap count once."
    )
    if len(shown) < len(view.downtime):
        note += f" The longest {len(shown)} of {number(len(view.downtime), 0)} stops are listed; the JSON has all."
    causes = [] if len({stop.code for stop in shown}) == len(view.downtime) else [*_by_cause(view), space(3 * MM)]
    return [*causes, *table(_span_columns(), _span_rows(shown, view)), muted_note(note)]


def _alarms(view: LineReportView) -> list[Block]:
    if not view.alarms:
        return [text_block("No alarm was raised.")]
    still = [alarm for alarm in view.alarms if alarm.ended_s is None]
    past = [alarm for alarm in view.alarms if alarm.ended_s is not None]
    shown = sorted([*still, *past[-max(_MOST_ROWS - len(still), 0) :]][:_MOST_ROWS], key=lambda alarm: alarm.begun_s)
    notes = []
    if len(shown) < len(view.alarms):
        notes = [muted_note(f"The newest {len(shown)} of {number(len(view.alarms), 0)} are listed; the JSON has all.")]
    return [*table(_span_columns(), _span_rows(shown, view)), *notes]
