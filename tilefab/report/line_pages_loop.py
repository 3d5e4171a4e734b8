"""Statistics of the closed loop: charts of the controller's innovations, the rules' findings, capability."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tilefab.inspection.spc import Capability, CusumChart, EwmaChart, ShewhartChart
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.line_charts import (
    Float64Array,
    TimeAxis,
    around,
    draw_dots,
    draw_level,
    draw_polyline,
    draw_rings,
    draw_stream,
    onsets,
    time_panel,
)
from tilefab.report.line_figures import GROUP, Groups, LineFigures, LoopStatistics
from tilefab.report.line_parts import Column, muted_note, table
from tilefab.report.line_view import LineReportView
from tilefab.report.profile_charts import begin_clip
from tilefab.report.profile_pages_summary import subheading
from tilefab.report.style import ACCENT, GREY, INK, LEFT, MM, RULE, WIDTH, Canvas, number

SECTION = "The loop"
_NOTE = (
    "Charted is how far each tile's lightness was from what the controller expected, in standard deviations (sigma). "
    "These innovations are independent while all is well, which the colours of a closed loop are not. Rings: signals. "
    "A chart begins anew after a signal."
)
_SINGLE_HEIGHT, _HEIGHT, _GROUP_HEIGHT = 31 * MM, 27 * MM, 23 * MM
_MOST_POINTS = 600


def loop_pages(view: LineReportView, figures: LineFigures, loop: LoopStatistics | None) -> list[Page]:
    """Make the pages of statistics."""
    axis = TimeAxis.of(view)
    blocks = [section_heading("The loop, by its surprises", _NOTE)]
    if loop is None or not len(loop.values):
        blocks.append(text_block("The controller recorded no innovations in this span."))
    else:
        blocks += [_single(view, loop, axis), _ewma(loop, axis), _cusum(loop, axis), *_mean_range(loop.groups, axis)]
        blocks += [space(4 * MM), subheading("Signals and patterns"), *_findings(loop)]
    blocks += [space(4 * MM), subheading("Capability"), *_capability(view, figures.capability)]
    return flow(SECTION, blocks)


def _single(view: LineReportView, loop: LoopStatistics, axis: TimeAxis) -> Block:
    limit = ShewhartChart().limit
    beyond = np.array([said.shewhart != 0 for said in loop.signals])
    refused = [(one.at_s, one.value) for one in view.innovations if not one.accepted]
    title = "Single innovations, limits at 3 sigma"
    if refused:
        title += f"; crosses: {number(len(refused), 0)} that the controller did not believe"

    def draw(canvas: Canvas, top: float) -> None:
        axes = time_panel(
            canvas,
            axis,
            title,
            LEFT,
            top,
            WIDTH,
            _SINGLE_HEIGHT,
            -5.0,
            5.0,
            clock=False,
            numbers=bool(axis.corrections),
        )
        draw_stream(canvas, axes, loop.at_s, loop.values, mean_of=0)
        for level in (-limit, limit):
            draw_level(canvas, axes, level, "", colour=GREY)
        draw_rings(canvas, axes, loop.at_s[beyond], loop.values[beyond])
        canvas.setStrokeColor(INK)
        canvas.setLineWidth(0.9)
        for at_s, value in refused:
            x, y = axes.at(min(max(at_s, axes.x_low), axes.x_high), min(max(value, axes.y_low), axes.y_high))
            canvas.line(x - 2, y - 2, x + 2, y + 2)
            canvas.line(x - 2, y + 2, x + 2, y - 2)

    return Block(_SINGLE_HEIGHT, draw)


def _ewma(loop: LoopStatistics, axis: TimeAxis) -> Block:
    chart = EwmaChart()
    values = np.array([said.average for said in loop.signals])
    beyond = np.array([said.ewma != 0 for said in loop.signals])
    title = f"EWMA, weight {chart.weight:g}, limits at {chart.limit:g} sigma of the average"
    return _running(title, loop.at_s, [values], beyond, (-chart.bound, chart.bound), axis, clock=False)


def _cusum(loop: LoopStatistics, axis: TimeAxis) -> Block:
    chart = CusumChart()
    high, low = np.array([said.high for said in loop.signals]), -np.array([said.low for said in loop.signals])
    beyond = np.array([said.cusum != 0 for said in loop.signals])
    title = f"CUSUM of both sides, k {chart.slack:g}, h {chart.limit:g}: slow drift shows here first"
    limits = (-chart.limit, chart.limit)
    return _running(title, loop.at_s, [high, low], beyond, limits, axis, clock=loop.groups is None)


def _running(
    title: str,
    at_s: Float64Array,
    lines: Sequence[Float64Array],
    beyond: np.ndarray,
    limits: tuple[float, float],
    axis: TimeAxis,
    *,
    clock: bool,
) -> Block:
    height = _HEIGHT + (3 * MM if clock else 0.0)

    def draw(canvas: Canvas, top: float) -> None:
        low, high = around([*limits, *(value for line in lines for value in (line.min(), line.max()))], least=1.0)
        axes = time_panel(canvas, axis, title, LEFT, top, WIDTH, height, low, high, clock=clock)
        for level in limits:
            draw_level(canvas, axes, level, "", colour=GREY)
        begin_clip(canvas, axes)
        step = max(1, len(at_s) // (4 * _MOST_POINTS))
        for line in lines:
            draw_polyline(canvas, axes, at_s[::step], line[::step], INK, 0.8)
        canvas.restoreState()
        # Of both CUSUM sums, the one that signalled is the farther out.
        farther = np.stack(lines)[np.abs(np.stack(lines)).argmax(axis=0), np.arange(len(at_s))]
        draw_rings(canvas, axes, at_s[beyond], farther[beyond], ACCENT)

    return Block(height, draw)


def _mean_range(groups: Groups | None, axis: TimeAxis) -> list[Block]:
    if groups is None:
        return []
    limits = groups.limits
    return [
        _group_chart(
            f"Means of {GROUP} neighbouring innovations (x-bar), limits by the mean range",
            groups.at_s,
            groups.mean,
            (limits.mean_low, limits.mean, limits.mean_high),
            axis,
            clock=False,
        ),
        _group_chart(
            f"Ranges of {GROUP} neighbouring innovations (R)",
            groups.at_s,
            groups.range,
            (limits.range_low, limits.range_mean, limits.range_high),
            axis,
            clock=True,
        ),
    ]


def _group_chart(
    title: str,
    at_s: Float64Array,
    values: Float64Array,
    limits: tuple[float, float, float],
    axis: TimeAxis,
    *,
    clock: bool,
) -> Block:
    height = _GROUP_HEIGHT + (3 * MM if clock else 0.0)
    lowest, centre, highest = limits
    beyond = onsets((values > highest) | (values < lowest))

    def draw(canvas: Canvas, top: float) -> None:
        low, high = around([*values, *limits], least=0.5)
        axes = time_panel(canvas, axis, title, LEFT, top, WIDTH, height, low, high, clock=clock)
        draw_level(canvas, axes, centre, "", dash=(), colour=RULE)
        for level in (lowest, highest):
            draw_level(canvas, axes, level, "", colour=GREY)
        if len(values) > _MOST_POINTS:
            draw_stream(canvas, axes, at_s, values)
        else:
            begin_clip(canvas, axes)
            draw_polyline(canvas, axes, at_s, values, INK, 0.8)
            draw_dots(canvas, axes, at_s, values, side=1.7, colour=INK)
            canvas.restoreState()
        draw_rings(canvas, axes, at_s[beyond][:_MOST_POINTS], values[beyond][:_MOST_POINTS], ACCENT)

    return Block(height, draw)


def _findings(loop: LoopStatistics) -> list[Block]:
    columns = [Column("", 12 * MM), Column("what is looked for", 100 * MM)]
    columns += [Column(head, 31 * MM, right=True) for head in ("found", "by chance alone")]
    names = ("single values beyond 3 sigma", "EWMA beyond its limits", "CUSUM beyond its limits")
    rows = [
        ("chart", name, number(found, 0), number(chance))
        for name, found, chance in zip(names, loop.counts, loop.chance, strict=True)
    ]
    rows += [
        (f"rule {found.rule}", found.text, number(found.points, 0), number(found.by_chance)) for found in loop.rules
    ]
    note = (
        f"{number(len(loop.values), 0)} innovations; {number(loop.rejected, 0)} more were refused as outliers. "
        "Rules: L. S. Nelson, Journal of Quality Technology 16 (1984). By chance: how many a controller in perfect "
        "order would show in as many tiles."
    )
    return [*table(columns, rows, max_lines=1), muted_note(note)]


def _capability(view: LineReportView, found: Capability | None) -> list[Block]:
    limit = view.limits.delta_e_mean
    if found is None or limit is None:
        return [text_block("Not told: no tolerance is set, or fewer than two tiles were measured.")]

    def index(value: float) -> str:
        return number(value, 2) if math.isfinite(value) else "–"

    columns = [Column("", 62 * MM)]
    columns += [
        Column(head, 112 * MM / 6, right=True) for head in ("tiles", "mean", "sigma within", "overall", "Cpk", "Ppk")
    ]
    row = (
        f"mean ΔE00 of a tile, at most {number(limit)}",
        number(found.count, 0),
        number(found.mean, 2),
        number(found.sigma_within, 2),
        number(found.sigma_overall, 2),
        index(found.cpk),
        index(found.ppk),
    )
    note = (
        "Within: by the ranges of neighbours, overall: of all tiles. Neighbours in a closed loop are alike, so Cpk "
        "promises more than customers get; Ppk is what they got."
    )
    return [*table(columns, [row]), muted_note(note)]
