"""Colour over time with control limits, corrections and kiln zones on one clock; and what each correction was."""

from __future__ import annotations

import numpy as np
from reportlab.lib.colors import Color

from tilefab.report.charts import Axes
from tilefab.report.layout import Block, Page, flow, section_heading, space, text_block
from tilefab.report.line_charts import (
    Float64Array,
    TimeAxis,
    around,
    binned,
    clock_text,
    draw_dots,
    draw_level,
    draw_polyline,
    draw_rings,
    draw_stream,
    empty_panel,
    hatch,
    onsets,
    time_panel,
)
from tilefab.report.line_figures import GROUP, ColourSeries, Groups, colour_series, grouped
from tilefab.report.line_parts import Column, muted_note, table
from tilefab.report.line_view import KilnZoneView, LineReportView
from tilefab.report.profile_charts import begin_clip, level_colour
from tilefab.report.profile_pages_summary import subheading
from tilefab.report.style import (
    ACCENT,
    GREY,
    INK,
    LEFT,
    MM,
    RULE,
    SMALL,
    WIDTH,
    Canvas,
    draw_text,
    number,
    short_hash,
)

SECTION = "Colour over time"
_DASHES: tuple[tuple[float, ...], ...] = (
    (),
    (6, 1.5),
    (2, 1),
    (6, 1.2, 1.2, 1.2),
    (3.5, 1.2),
    (9, 1.5),
    (1, 1),
    (5, 1, 1, 1),
)
_MOST_ZONES = len(_DASHES)
_MOST_CORRECTIONS = 120
_MOST_STEPS = 240
_MOST_POINTS = 600
_DELTA_E_HEIGHT, _LAB_HEIGHT, _KILN_HEIGHT = 54 * MM, 34 * MM, 46 * MM
_NOTE = (
    "Each tile is held against its own predicted face. L*, a*, b*: means of {group} tiles, fired less predicted; "
    "dashed: control limits by the range within those groups. Tiles of a closed loop aren't independent: a mean beyond "
    "the limits says that the kiln moved; whether the loop is in order is judged by its surprises, in the next part."
)
_Zone = tuple[KilnZoneView, Float64Array, Float64Array]


def colour_over_time_pages(view: LineReportView) -> list[Page]:
    """Make the charts and the list of corrections."""
    series = colour_series(view.tiles)
    axis = TimeAxis.of(view)
    blocks = [section_heading(SECTION, _NOTE.format(group=GROUP)), _delta_e_chart(view, series, axis)]
    channels = [grouped(series.at_s, series.difference_lab[:, channel]) for channel in range(3)]
    for name, found in zip(("L* (up: lighter)", "a* (up: redder)", "b* (up: yellower)"), channels, strict=True):
        if found is not None:
            blocks.append(_lab_chart(f"Difference of {name}, means of {GROUP} tiles", found, axis))
    if channels[0] is None:
        blocks.append(_no_lab_chart())
    blocks += [_kiln_chart(view.kiln, axis), _legend(), space(5 * MM), *_corrections(view)]
    if view.holds:
        blocks += [space(4 * MM), subheading("Holds of the controller"), *_holds(view)]
    return flow(SECTION, blocks)


def _delta_e_chart(view: LineReportView, series: ColourSeries, axis: TimeAxis) -> Block:
    title = "Mean ΔE00 of each tile, their moving mean, and what the drift would have cost uncorrected (blue steps)"
    steps = [(one.at_s, one.drift_delta_e) for one in view.corrections if one.drift_delta_e is not None]

    def draw(canvas: Canvas, top: float) -> None:
        if not len(series.at_s):
            empty_panel(canvas, title, "no tile was measured", LEFT, top, WIDTH, _DELTA_E_HEIGHT)
            return
        limit = view.limits.delta_e_mean
        levels = [*series.delta_e, *(cost for _, cost in steps), *([] if limit is None else [1.15 * limit])]
        low, high = around(levels, least=1.0, zero=True)
        axes = time_panel(
            canvas,
            axis,
            title,
            LEFT,
            top,
            WIDTH,
            _DELTA_E_HEIGHT,
            low,
            high,
            clock=False,
            numbers=bool(view.corrections),
        )
        draw_stream(canvas, axes, series.at_s, series.delta_e)
        if steps:
            begin_clip(canvas, axes)
            _draw_costs(canvas, axes, np.array(steps))
            canvas.restoreState()
        if limit is not None:
            draw_level(canvas, axes, limit, f"tolerance {number(limit)}")

    return Block(_DELTA_E_HEIGHT, draw)


def _draw_costs(canvas: Canvas, axes: Axes, steps: Float64Array) -> None:
    """Draw what the drift would have cost: it holds from one correction to the next; of very many, the mean."""
    if len(steps) > _MOST_STEPS:
        middle, _, mean, _ = binned(axes, steps[:, 0], steps[:, 1])
        draw_polyline(canvas, axes, middle, mean, ACCENT, 1.0)
        return
    times = np.repeat(np.append(steps[:, 0], axes.x_high), 2)[1:-1]
    draw_polyline(canvas, axes, times, np.repeat(steps[:, 1], 2), ACCENT, 1.2, whole=True)


def _no_lab_chart() -> Block:
    text = f"fewer than {2 * GROUP} measured tiles"

    def draw(canvas: Canvas, top: float) -> None:
        empty_panel(canvas, "Differences of L*, a* and b*", text, LEFT, top, WIDTH, _LAB_HEIGHT)

    return Block(_LAB_HEIGHT, draw)


def _lab_chart(title: str, found: Groups, axis: TimeAxis) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        limits = found.limits
        low, high = around([*found.mean, limits.mean_low, limits.mean_high, 0.0], least=0.8)
        axes = time_panel(canvas, axis, title, LEFT, top, WIDTH, _LAB_HEIGHT, low, high, clock=False)
        draw_level(canvas, axes, limits.mean, "", dash=(), colour=RULE)
        draw_level(canvas, axes, limits.mean_high, "", colour=GREY)
        draw_level(canvas, axes, limits.mean_low, "", colour=GREY)
        beyond = onsets((found.mean > limits.mean_high) | (found.mean < limits.mean_low))
        if len(found.mean) > _MOST_POINTS:
            draw_stream(canvas, axes, found.at_s, found.mean)
            return
        begin_clip(canvas, axes)
        draw_polyline(canvas, axes, found.at_s, found.mean, INK, 0.8)
        draw_dots(canvas, axes, found.at_s, found.mean, side=1.7, colour=INK)
        canvas.restoreState()
        draw_rings(canvas, axes, found.at_s[beyond], found.mean[beyond], ACCENT)

    return Block(_LAB_HEIGHT, draw)


def _kiln_chart(kiln: tuple[KilnZoneView, ...], axis: TimeAxis) -> Block:
    zones = _restless(kiln, axis)
    known = all(zone.setpoint_degc is not None for zone, _, _ in zones)
    title = f"Kiln zones: °C off {'their set points' if known else 'their set points or, where unknown, their means'}"
    if len(kiln) > len(zones) > 0:
        title += f"; the {len(zones)} of {len(kiln)} that moved most"

    def draw(canvas: Canvas, top: float) -> None:
        if not zones:
            empty_panel(canvas, "Kiln zones", "no temperatures were recorded", LEFT, top, WIDTH, _KILN_HEIGHT)
            return
        offsets = [temps - _centre(zone, temps) for zone, _, temps in zones]
        low, high = around(np.concatenate([*offsets, np.zeros(1)]), least=4.0)
        panel = _KILN_HEIGHT - 9 * MM
        axes = time_panel(canvas, axis, title, LEFT, top, WIDTH, panel, low, high, clock=True)
        colours = [_zone_colour(place, len(zones)) for place in range(len(zones))]
        begin_clip(canvas, axes)
        for place, ((_, times, _), offset) in enumerate(zip(zones, offsets, strict=True)):
            step = max(1, len(times) // _MOST_POINTS)
            draw_polyline(canvas, axes, times[::step], offset[::step], colours[place], 1.0, _DASHES[place])
        canvas.restoreState()
        names = [f"{zone.name}: {_centre(zone, temps):.0f} °C" for zone, _, temps in zones]
        _draw_legend_rows(canvas, names, colours, top - panel - 1 * MM)

    return Block(_KILN_HEIGHT, draw)


def _draw_legend_rows(canvas: Canvas, names: list[str], colours: list[Color], top: float) -> None:
    part = WIDTH / 4
    for place, (name, colour) in enumerate(zip(names, colours, strict=True)):
        left, row = LEFT + place % 4 * part, top - place // 4 * SMALL.leading
        canvas.setStrokeColor(colour)
        canvas.setLineWidth(1.4)
        canvas.setDash(list(_DASHES[place]))
        canvas.line(left, row - 0.5 * SMALL.leading, left + 18, row - 0.5 * SMALL.leading)
        canvas.setDash()
        draw_text(canvas, name, left + 21, row, part - 23, SMALL, shrink=0.8)


def _restless(kiln: tuple[KilnZoneView, ...], axis: TimeAxis) -> list[_Zone]:
    """Zones with readings in the span, at most `_MOST_ZONES`: those that moved most, in the kiln's order."""
    found: list[_Zone] = []
    for zone in kiln:
        times, temps = np.array(zone.at_s, dtype=np.float64), np.array(zone.temp_degc, dtype=np.float64)
        inside = (times >= axis.begun_s) & (times <= axis.ended_s)
        if inside.any():
            found.append((zone, times[inside], temps[inside]))
    order = sorted(range(len(found)), key=lambda place: -float(np.ptp(found[place][2])))[:_MOST_ZONES]
    return [found[place] for place in sorted(order)]


def _centre(zone: KilnZoneView, temps: Float64Array) -> float:
    return float(temps.mean()) if zone.setpoint_degc is None else zone.setpoint_degc


def _zone_colour(place: int, count: int) -> Color:
    return level_colour(10.0 + 80.0 * place / max(count - 1, 1))


def _legend() -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        y = top - 0.5 * SMALL.leading
        part = WIDTH / 4
        canvas.setStrokeColor(ACCENT)
        canvas.setLineWidth(0.7)
        canvas.setDash([2.4, 1.6])
        canvas.line(LEFT + 5, y - 4, LEFT + 5, y + 4)
        canvas.setDash()
        canvas.setFillColor(RULE)
        canvas.rect(LEFT + part, y - 3, 11, 6, stroke=0, fill=1)
        canvas.setStrokeColor(GREY)
        hatch(canvas, LEFT + 2 * part, y - 3, 11, 6)
        canvas.setStrokeColor(ACCENT)
        canvas.setLineWidth(0.9)
        canvas.circle(LEFT + 3 * part + 5, y, 2.4, stroke=1, fill=0)
        labels = (
            "correction, with its number",
            "the line stood",
            "the controller held",
            "goes beyond the control limits",
        )
        for place, label in enumerate(labels):
            draw_text(canvas, label, LEFT + place * part + 15, top, part - 17, SMALL)

    return Block(SMALL.leading + 1 * MM, draw)


def _corrections(view: LineReportView) -> list[Block]:
    if not view.corrections:
        return [
            subheading("Corrections"),
            text_block("No correction was made: every tile was printed as the job says."),
        ]
    columns = [
        Column("no.", 10 * MM, right=True),
        Column("taken", 28 * MM),
        Column("drift ΔE00", 19 * MM, right=True),
        Column("tiles", 16 * MM, right=True),
        Column("state", 25 * MM),
        Column("reason", 76 * MM),
    ]
    printed: dict[int, int] = {}
    for tile in view.tiles:
        printed[tile.correction] = printed.get(tile.correction, 0) + 1
    shown = view.corrections[-_MOST_CORRECTIONS:]
    rows = [
        (
            number(one.number, 0),
            clock_text(one.at_s, view.utc_offset_min),
            "–" if one.drift_delta_e is None else number(one.drift_delta_e, 2),
            number(printed.get(one.number, 0), 0),
            short_hash(one.sha256),
            one.reason,
        )
        for one in shown
    ]
    note = (
        f"Drift: how far the press had gone by the controller's estimate, as mean ΔE00 of this job's colours printed "
        f"without any correction. {number(printed.get(0, 0), 0)} tiles were printed without one."
    )
    if len(shown) < len(view.corrections):
        note += f" The last {len(shown)} of {len(view.corrections)} are listed; the JSON has all."
    return [subheading("Corrections"), muted_note(note, keep=True), *table(columns, rows, max_lines=3)]


def _holds(view: LineReportView) -> list[Block]:
    columns = [Column("from", 32 * MM), Column("to", 32 * MM), Column("why", 110 * MM)]
    rows = [
        (
            clock_text(hold.begun_s, view.utc_offset_min),
            "still" if hold.ended_s is None else clock_text(hold.ended_s, view.utc_offset_min),
            hold.text,
        )
        for hold in view.holds[-100:]
    ]
    return table(columns, rows, max_lines=3)
