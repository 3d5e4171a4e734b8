"""The first page of a profile check: what a person needs to know, in ten seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tilefab.report.layout import Block, Page, flow, space, two_columns
from tilefab.report.profile_view import ProfileCheckView, RoundTripView, SpreadView, VerdictView
from tilefab.report.style import (
    ACCENT,
    BODY,
    BOLD,
    GREY,
    INK,
    LEFT,
    MM,
    MUTED,
    REGULAR,
    RULE,
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
from tilefab.report.view_model import Lab

SECTION = "Summary"
_FIGURE = TextStyle(BOLD, 15, 19, INK)
_LABEL = TextStyle(BOLD, 7, 9, INK)
_NOTE = TextStyle(REGULAR, 6, 7.6, GREY)
_MARK = TextStyle(BOLD, 7.5, 10, WHITE)
_FIGURES_HEIGHT = 18 * MM
_GRADE_WIDTH = 15 * MM
_WHAT_WIDTH = 30 * MM
_COLUMNS = (0.0, 66 * MM, 90 * MM, 111 * MM, 132 * MM, 153 * MM)
_ROW = 5.2 * MM


def summary_pages(view: ProfileCheckView) -> list[Page]:
    """Make the summary."""
    blocks = [_title(view), _figures(view), space(5 * MM), subheading("In short")]
    blocks += [_verdict(verdict) for verdict in view.verdicts]
    if view.warnings:
        blocks += [space(3 * MM), subheading("Warnings"), *(warning_block(text) for text in view.warnings)]
    blocks += [space(4 * MM), *_numbers(view), space(4 * MM), subheading("The profile"), *two_columns(_facts(view))]
    return flow(SECTION, blocks)


def subheading(text: str) -> Block:
    """Build a small heading."""

    def draw(canvas: Canvas, top: float) -> None:
        draw_text(canvas, text, LEFT, top, WIDTH, SUBHEADING)

    return Block(SUBHEADING.leading + 1.5 * MM, draw, keep=True)


def _title(view: ProfileCheckView) -> Block:
    style = TITLE
    while style.size > 12 and len(wrap(view.facts.description, WIDTH, style)) > 2:
        style = replace(style, size=style.size * 0.94, leading=style.leading * 0.94)
    titles = wrap(view.facts.description, WIDTH, style, 2, middle=True)
    files = wrap(view.facts.path, WIDTH, MUTED, 2, middle=True)
    height = 4 * MM + SUBHEADING.leading + len(titles) * style.leading + len(files) * MUTED.leading + 5 * MM

    def draw(canvas: Canvas, top: float) -> None:
        canvas.setFillColor(ACCENT)
        canvas.rect(LEFT, top - 1.2 * MM, 18 * MM, 1.2 * MM, stroke=0, fill=1)
        y = draw_text(canvas, "Profile check", LEFT, top - 4 * MM, WIDTH, SUBHEADING)
        y = draw_lines(canvas, titles, LEFT, y, style)
        draw_lines(canvas, files, LEFT, y, MUTED)

    return Block(height, draw, keep=True)


def _figures(view: ProfileCheckView) -> Block:
    cells = _cells(view)
    width = WIDTH / len(cells)

    def draw(canvas: Canvas, top: float) -> None:
        draw_rule(canvas, LEFT, top, WIDTH, INK, 0.8)
        draw_rule(canvas, LEFT, top - _FIGURES_HEIGHT, WIDTH, RULE, 0.5)
        for place, (figure, label, note) in enumerate(cells):
            x = LEFT + place * width
            if place:
                canvas.setStrokeColor(RULE)
                canvas.setLineWidth(0.5)
                canvas.line(x, top - 2 * MM, x, top - _FIGURES_HEIGHT + 2 * MM)
            inset = 0.0 if place == 0 else 2.5 * MM
            room = width - inset - 1.5 * MM
            draw_text(canvas, figure, x + inset, top - 1.5 * MM, room, _FIGURE, shrink=0.4)
            y = draw_text(canvas, label, x + inset, top - 1.5 * MM - _FIGURE.leading, room, _LABEL, shrink=0.8)
            draw_text(canvas, note, x + inset, y, room, _NOTE, max_lines=2)

    return Block(_FIGURES_HEIGHT, draw)


def _cells(view: ProfileCheckView) -> list[tuple[str, str, str]]:
    relative = next((trip for trip in view.round_trips if trip.intent == "relative"), None)
    bend, limit, volume = view.smoothness.ink_bend_percent, view.facts.ink_limit_percent, view.gamut.volume
    share = view.gamut.share_reached
    reached = "no table reaches it" if share is None else f"{percent(100.0 * share)} reached within ΔE 1"
    cells = [
        ("–", "against measurements", "none given or embedded")
        if view.match is None
        else (
            number(view.match.spread.mean, 2),
            "mean ΔE00 to patches",
            f"95 % of patches below {number(view.match.spread.p95, 2)}",
        ),
        ("–", "round trip", "no table to inks")
        if relative is None
        else (
            number(relative.spread.mean, 2),
            "mean ΔE00 round trip",
            f"95 % of printable colours below {number(relative.spread.p95, 2)}",
        ),
        ("–", "smoothness", "can't be told")
        if bend is None
        else (percent(bend.p95, even=True), "ink bend, 95 %", "second difference per step of ΔE 1"),
        (number(volume / 1000.0, 0 if volume > 1e5 else 1), "gamut, thousand units", f"cubic units of Lab; {reached}"),
        ("–", "total ink", "no table to inks")
        if limit is None
        else (percent(limit), "largest total ink", "in any table from colour to inks"),
    ]
    if view.image is not None:
        note = f"of the image, by ΔE {number(view.image.outside_mean)} in the mean"
        cells.append((percent(100.0 * view.image.share_outside), "out of gamut", note))
    return cells


def _verdict(verdict: VerdictView) -> Block:
    lines = wrap(verdict.text, WIDTH - _GRADE_WIDTH - _WHAT_WIDTH, BODY, 3)
    height = len(lines) * BODY.leading + 2.4 * MM

    def draw(canvas: Canvas, top: float) -> None:
        filled = {"good": ACCENT, "poor": INK}.get(verdict.grade)
        box = BODY.leading
        canvas.setStrokeColor(ACCENT if verdict.grade == "fair" else INK if filled else GREY)
        canvas.setLineWidth(0.7)
        canvas.setDash()
        canvas.setFillColor(filled or WHITE)
        canvas.rect(LEFT, top - 1.2 * MM - box, _GRADE_WIDTH - 3 * MM, box, stroke=1, fill=1)
        style = _MARK if filled else TextStyle(BOLD, 7.5, 10, ACCENT if verdict.grade == "fair" else GREY)
        label = "–" if verdict.grade == "none" else verdict.grade
        draw_text(canvas, label, LEFT, top - 1.2 * MM - 0.5, _GRADE_WIDTH - 3 * MM, style, align="centre")
        draw_text(canvas, verdict.what, LEFT + _GRADE_WIDTH, top - 1.2 * MM, _WHAT_WIDTH - 2 * MM, STRONG, shrink=0.8)
        draw_lines(canvas, lines, LEFT + _GRADE_WIDTH + _WHAT_WIDTH, top - 1.2 * MM, BODY)
        draw_rule(canvas, LEFT, top - height, WIDTH, thickness=0.35)

    return Block(height, draw)


def warning_block(text: str) -> Block:
    """Build a warning with a mark."""
    lines = wrap(text, WIDTH - 13 * MM, BODY, 20)
    box = len(lines) * BODY.leading + 2 * MM

    def draw(canvas: Canvas, top: float) -> None:
        canvas.setStrokeColor(INK)
        canvas.setLineWidth(0.6)
        canvas.setDash()
        canvas.rect(LEFT, top - box, WIDTH, box, stroke=1, fill=0)
        canvas.setFillColor(INK)
        canvas.rect(LEFT, top - box, 7 * MM, box, stroke=0, fill=1)
        draw_text(canvas, "!", LEFT, top - 1.2 * MM, 7 * MM, _MARK, align="centre")
        draw_lines(canvas, lines, LEFT + 10 * MM, top - 1 * MM, BODY)

    return Block(box + 1.2 * MM, draw)


def _numbers(view: ProfileCheckView) -> list[Block]:
    rows: list[tuple[str, SpreadView | None, str]] = []
    if view.match is not None:
        rows.append(("inks to colour, ΔE00", view.match.spread, ""))
    rows += [(_trip_name(trip), trip.spread, "") for trip in view.round_trips]
    rows += [
        ("bend of inks per step, %", view.smoothness.ink_bend_percent, ""),
        ("bend of printed colour per step, ΔE*ab", view.smoothness.lab_bend, ""),
    ]

    def draw_head(canvas: Canvas, top: float) -> None:
        for place, label in enumerate(("", "count", "mean", "median", "95 %", "largest")):
            x, room = column(_COLUMNS, place)
            draw_text(canvas, label, x, top, room, SMALL_MUTED, align="left" if place == 0 else "right")
        draw_rule(canvas, LEFT, top - SMALL_MUTED.leading - 1 * MM, WIDTH, INK, 0.6)

    head = Block(SMALL_MUTED.leading + 1.2 * MM, draw_head, keep=True)
    return [subheading("Figures"), head, *(_number_row(label, found, head) for label, found, _ in rows)]


def _trip_name(trip: RoundTripView) -> str:
    kind = "" if trip.colorimetric else ", maps colours"
    return f"round trip, {trip.intent}{kind}, ΔE00"


def _number_row(label: str, found: SpreadView | None, head: Block) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        y = top - 0.5 * (_ROW - BODY.leading)
        draw_text(canvas, label, LEFT, y, _COLUMNS[1] - 2 * MM, BODY, shrink=0.75)
        figures = ["–"] * 5
        if found is not None:
            values = (found.mean, found.median, found.p95, found.largest)
            figures = [number(found.count, 0), *(number(value, 2) for value in values)]
        for place, figure in enumerate(figures, 1):
            x, room = column(_COLUMNS, place)
            draw_text(canvas, figure, x, y, room, BODY, align="right", shrink=0.6)
        draw_rule(canvas, LEFT, top - _ROW, WIDTH, thickness=0.35)

    return Block(_ROW, draw, head=head)


def column(columns: Sequence[float], place: int) -> tuple[float, float]:
    """Left edge of a table's column, and its width less the gap to the next."""
    end = columns[place + 1] - 3 * MM if place + 1 < len(columns) else WIDTH
    return LEFT + columns[place], end - columns[place]


def lab_text(lab: Lab | None) -> str:
    """A colour as text."""
    return "unknown" if lab is None else "  ".join(number(value) for value in lab)


def _facts(view: ProfileCheckView) -> list[tuple[str, str]]:
    facts, smooth, image = view.facts, view.smoothness, view.image
    limits = ", ".join(f"{intent} {percent(limit)}" for intent, limit in facts.ink_limits_percent) or "unknown"
    most = ", ".join(
        f"{name} {percent(value)}" for name, value in zip(facts.ink_names, facts.ink_most_percent, strict=False)
    )
    rows = [
        ("Inks", ", ".join(facts.ink_names)),
        ("Kind", f"ICC {facts.version}, class {facts.device_class}, {facts.colour_space} to {facts.pcs}"),
        ("Size", f"{number(facts.size_bytes / 1024.0, 0)} KiB"),
        ("SHA-256", short_hash(facts.sha256)),
        ("Unprinted, absolute L* a* b*", lab_text(facts.white_lab)),
        ("Darkest, absolute L* a* b*", lab_text(facts.dark_lab)),
        ("Total ink by intent", limits),
        ("Largest amount of each ink", most or "unknown"),
        ("Tables as the relative one", ", ".join(facts.same_tables) or "none"),
        ("Measurements in the profile", facts.embedded),
        ("Compared with", "nothing" if view.match is None else view.match.source),
        ("White to measured white", _white_text(view)),
        ("Lines followed in Lab", number(smooth.lines, 0)),
        ("Largest jump per step", _jump_text(view)),
        ("Gamut as a convex hull", f"{number(view.gamut.hull_volume / 1000.0, 0)} thousand cubic units"),
        ("Tags", ", ".join(facts.tags)),
    ]
    if image is not None:
        outside = f"{percent(100.0 * image.share_outside)} beyond ΔE00 {number(image.outside_delta_e)}"
        rows += [
            ("Image", image.path),
            ("Out of gamut", f"{outside}: mean {number(image.outside_mean, 2)}, 95 % {number(image.outside_p95, 2)}"),
            ("Whole image", f"ΔE00 mean {number(image.all_mean, 2)}, 95 % {number(image.all_p95, 2)}"),
        ]
    return rows


def _white_text(view: ProfileCheckView) -> str:
    if view.match is None or view.match.white_delta_e is None:
        return "unknown"
    return f"ΔE00 {number(view.match.white_delta_e, 2)}"


def _jump_text(view: ProfileCheckView) -> str:
    smooth = view.smoothness
    if smooth.jump_percent is None or smooth.jump_ink is None:
        return "unknown"
    return f"{percent(smooth.jump_percent, even=True)} of {smooth.jump_ink}, near L* a* b* {lab_text(smooth.jump_lab)}"
