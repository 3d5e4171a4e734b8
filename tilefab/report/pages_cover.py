"""The cover: what was made, at a glance, and the code and hashes to make it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tilefab.errors import ReportError
from tilefab.report.figures import (
    QUIET_MODULES,
    draw_image,
    draw_qr,
    fit_size,
    qr_least_side,
    qr_modules,
    qr_side,
)
from tilefab.report.layout import Block, Page, fact_rows, flow, section_heading, two_columns
from tilefab.report.style import (
    ACCENT,
    BOLD,
    BOTTOM,
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
    TOP,
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
from tilefab.report.view_model import RunReportView
from tilefab.types import Mask

_FIGURE = TextStyle(BOLD, 17, 21, INK)
_FIGURE_ALERT = TextStyle(BOLD, 17, 21, WHITE)
_LABEL = TextStyle(REGULAR, 7, 9, GREY)
_LABEL_ALERT = TextStyle(REGULAR, 7, 9, WHITE)
_FIGURES_HEIGHT = 19 * MM
_BASE_HEIGHT = 66 * MM
_QR_BOX = 36 * MM
_IDENTITY_WIDTH = 54 * MM
_FACTS_WIDTH = WIDTH - _IDENTITY_WIDTH - 8 * MM


def cover_pages(view: RunReportView) -> list[Page]:
    """Make the cover, and a page for the facts that it has no room for.

    Raises
    ------
    ReportError
        If the hashes are too long for a QR code.
    """
    code = f"tilefab-job job={view.job_hash} map={view.map_hash} profile={view.profile_hash}"
    modules = qr_modules(code, "the text of the three hashes")
    if qr_least_side(modules) > _QR_BOX:
        raise ReportError("job_hash, map_hash and profile_hash are too long for the cover's QR code; shorten them")
    head = _head(view)
    facts = fact_rows(view.facts, LEFT, _FACTS_WIDTH)
    captions = wrap(view.wall_caption, WIDTH, MUTED, 2)
    around = 5 * MM + 1.5 * MM + len(captions) * MUTED.leading + 6 * MM
    room = TOP - head.height - around - BOTTOM - _BASE_HEIGHT
    rows, cols, _ = view.wall_preview.shape
    base = TOP - head.height - around - fit_size(rows, cols, WIDTH, room)[1]
    shown = _how_many(facts, base - BOTTOM - SUBHEADING.leading - 1 * MM)

    def draw(canvas: Canvas) -> None:
        head.draw(canvas, TOP)
        y = TOP - head.height - 5 * MM
        _, _, _, high = draw_image(canvas, view.wall_preview, LEFT, y, WIDTH, room)
        draw_lines(canvas, captions, LEFT, y - high - 1.5 * MM, MUTED)
        if facts:
            draw_text(canvas, "The job", LEFT, base, _FACTS_WIDTH, SUBHEADING)
        row = base - SUBHEADING.leading - 1 * MM
        for fact in facts[:shown]:
            fact.draw(canvas, row)
            row -= fact.height
        if shown < len(facts):
            draw_text(
                canvas,
                f"{len(facts) - shown} more on the next page",
                LEFT,
                row - 2,
                _FACTS_WIDTH,
                SMALL_MUTED,
            )
        _draw_identity(canvas, view, modules, base)

    pages = [Page("Overview", draw)]
    if shown < len(facts):
        pages += flow("The job", [section_heading("The job, further facts"), *two_columns(view.facts[shown:])])
    return pages


def _how_many(facts: Sequence[Block], room: float) -> int:
    """How many rows fit in a height; when not all do, with a line left to say so."""
    total = 0.0
    for place, fact in enumerate(facts):
        total += fact.height
        last = place == len(facts) - 1
        if total + (0 if last else SMALL_MUTED.leading + 2) > room:
            return place
    return len(facts)


def _draw_identity(canvas: Canvas, view: RunReportView, modules: Mask, top: float) -> None:
    """Draw the job's code and the heads of the three hashes, at the page's right."""
    x = LEFT + WIDTH - _IDENTITY_WIDTH
    draw_text(canvas, "To make it again", x, top, _IDENTITY_WIDTH, SUBHEADING)
    side = qr_side(modules, _QR_BOX)
    quiet = side * QUIET_MODULES / (len(modules) + 2 * QUIET_MODULES)
    row = top - SUBHEADING.leading - 1 * MM
    draw_qr(canvas, modules, x - quiet, row - 1 * MM + quiet * 0.5, side)
    row -= side
    for label, digest in (
        ("job", view.job_hash),
        ("texture map", view.map_hash),
        ("profile", view.profile_hash),
    ):
        draw_text(canvas, label, x, row - 0.6, 18 * MM, SMALL_MUTED)
        draw_text(canvas, short_hash(digest), x + 18 * MM, row, 36 * MM, STRONG, shrink=0.7)
        row -= STRONG.leading


def _head(view: RunReportView) -> Block:
    """Measure and build the title with the key figures below it."""
    size = TITLE
    while size.size > 12 and len(wrap(view.title, WIDTH, size)) > 2:
        size = replace(size, size=size.size * 0.94, leading=size.leading * 0.94)
    titles = wrap(view.title, WIDTH, size, 2, middle=True)
    files = wrap(view.job_file, WIDTH, MUTED, 2, middle=True)
    made = wrap(f"{view.created}  ·  tilefab {view.software_version}", WIDTH, MUTED, 1)
    upper = 5 * MM + SUBHEADING.leading + len(titles) * size.leading + (len(files) + 1) * MUTED.leading

    def draw(canvas: Canvas, top: float) -> None:
        canvas.setFillColor(ACCENT)
        canvas.rect(LEFT, top - 1.2 * MM, 18 * MM, 1.2 * MM, stroke=0, fill=1)
        y = draw_text(canvas, "Run report", LEFT, top - 4 * MM, WIDTH, SUBHEADING)
        y = draw_lines(canvas, titles, LEFT, y, size) - 1 * MM
        draw_lines(canvas, files + made, LEFT, y, MUTED)
        _draw_figures(canvas, view, top - upper - 4 * MM)

    return Block(upper + 4 * MM + _FIGURES_HEIGHT, draw)


def _draw_figures(canvas: Canvas, view: RunReportView, top: float) -> None:
    colour = view.colour
    limit = "no limit" if colour.ink_limit_percent is None else f"limit {percent(colour.ink_limit_percent)}"
    warnings = len(view.warnings)
    cells = (
        (number(len(view.faces), 0), "face" if len(view.faces) == 1 else "faces", "each has its own index"),
        (number(colour.delta_e_mean), "mean ΔE00", f"95 % of pixels below {number(colour.delta_e_p95)}"),
        (percent(100 * colour.out_of_gamut_share), "out of gamut", "share of the slab's pixels"),
        (
            percent(colour.mean_total_ink_percent),
            "mean total ink",
            f"max {percent(colour.max_total_ink_percent)}, {limit}",
        ),
        (
            number(warnings, 0),
            "warning" if warnings == 1 else "warnings",
            "see the last part" if warnings else "none",
        ),
    )
    width = WIDTH / len(cells)
    draw_rule(canvas, LEFT, top, WIDTH, INK, 0.8)
    draw_rule(canvas, LEFT, top - _FIGURES_HEIGHT, WIDTH, RULE, 0.5)
    for place, (figure, label, note) in enumerate(cells):
        x = LEFT + place * width
        alert = place == len(cells) - 1 and warnings > 0
        if alert:
            canvas.setFillColor(INK)
            canvas.rect(x, top - _FIGURES_HEIGHT, width, _FIGURES_HEIGHT, stroke=0, fill=1)
        elif place:
            canvas.setStrokeColor(RULE)
            canvas.setLineWidth(0.5)
            canvas.line(x, top - 2 * MM, x, top - _FIGURES_HEIGHT + 2 * MM)
        inset = 0.0 if place == 0 else 2.5 * MM
        room = width - inset - 1.5 * MM
        y = top - 1.5 * MM
        draw_text(canvas, figure, x + inset, y, room, _FIGURE_ALERT if alert else _FIGURE, shrink=0.4)
        style = _LABEL_ALERT if alert else _LABEL
        y -= _FIGURE.leading
        y = draw_text(canvas, label, x + inset, y, room, TextStyle(BOLD, 7, 9, style.colour if alert else INK))
        draw_text(canvas, note, x + inset, y, room, TextStyle(REGULAR, 6, 7.6, style.colour), max_lines=2)
