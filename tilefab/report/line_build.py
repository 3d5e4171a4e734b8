"""Puts the pages of a line report together into one PDF."""

from __future__ import annotations

import io

from reportlab.pdfgen.canvas import Canvas as PdfCanvas

from tilefab.report.layout import Page
from tilefab.report.line_check import check_line_view
from tilefab.report.line_figures import line_figures, loop_statistics
from tilefab.report.line_pages_colour import colour_over_time_pages
from tilefab.report.line_pages_defects import defect_pages
from tilefab.report.line_pages_loop import loop_pages
from tilefab.report.line_pages_running import running_pages
from tilefab.report.line_pages_shade import shade_pages
from tilefab.report.line_pages_summary import summary_pages
from tilefab.report.line_pages_trace import trace_pages
from tilefab.report.line_pages_worst import worst_pages
from tilefab.report.line_parts import line_name
from tilefab.report.line_verdicts import line_verdicts
from tilefab.report.line_view import LineReportView
from tilefab.report.style import (
    BOTTOM,
    LEFT,
    MM,
    PAGE_HEIGHT,
    PAGE_WIDTH,
    SMALL_MUTED,
    SMALL_STRONG,
    WIDTH,
    Canvas,
    clean,
    draw_rule,
    draw_text,
    short_hash,
)


def build_line_report(view: LineReportView, *, compress: bool = True) -> bytes:
    """Draw the report of a job or a shift as an A4 PDF file.

    Parameters
    ----------
    view
        All that the report shows. Of very many tiles, charts show bands and tables a choice.
    compress
        Whether the pages' drawing commands are compressed; False makes them readable.

    Returns
    -------
    bytes
        The file. Equal views give equal bytes with the same versions of the libraries that draw it.

    Raises
    ------
    ReportError
        If something in ``view`` can't be drawn; nothing is left half done.
    """
    check_line_view(view)
    pages = line_report_pages(view)
    file = io.BytesIO()
    canvas = PdfCanvas(file, pagesize=(PAGE_WIDTH, PAGE_HEIGHT), pageCompression=int(compress), invariant=1, lang="en")
    canvas.setTitle(clean(f"{view.scope}: {view.title}"))
    canvas.setAuthor("tilefab")
    canvas.setSubject(clean(f"{view.scope}, {line_name(view)}, run {view.run}, job {view.job_hash}"))
    canvas.setCreator(clean(f"tilefab {view.software_version}"))
    section = ""
    for place, page in enumerate(pages, 1):
        if page.section != section:
            section = page.section
            canvas.bookmarkPage(f"page-{place}")
            canvas.addOutlineEntry(section, f"page-{place}", 0)
        page.draw(canvas)
        _draw_margins(canvas, view, page, place, len(pages))
        canvas.showPage()
    canvas.save()
    return file.getvalue()


def line_report_pages(view: LineReportView) -> list[Page]:
    """All pages, in order."""
    figures, loop = line_figures(view), loop_statistics(view.innovations)
    return [
        *summary_pages(view, figures, line_verdicts(view, figures, loop)),
        *colour_over_time_pages(view),
        *loop_pages(view, figures, loop),
        *defect_pages(view),
        *shade_pages(view),
        *worst_pages(view),
        *running_pages(view, figures),
        *trace_pages(view),
    ]


def _draw_margins(canvas: Canvas, view: LineReportView, page: Page, place: int, total: int) -> None:
    """Draw header and footer: what this sheet belongs to, should it ever lie alone on a desk."""
    half = WIDTH / 2
    top = PAGE_HEIGHT - 10 * MM
    draw_text(canvas, f"{view.scope}: {view.title}", LEFT, top, WIDTH - 62 * MM, SMALL_MUTED, middle=True)
    belongs = f"{line_name(view)}, run {view.run}, job {short_hash(view.job_hash, 8)}"
    draw_text(canvas, belongs, LEFT + WIDTH - 60 * MM, top, 60 * MM, SMALL_STRONG, align="right", middle=True)
    draw_rule(canvas, LEFT, top - 4.2 * MM, WIDTH)
    foot = BOTTOM - 6 * MM
    draw_rule(canvas, LEFT, foot + 1 * MM, WIDTH)
    note = f"{page.section}  ·  {view.created}  ·  tilefab {view.software_version}"
    draw_text(canvas, note, LEFT, foot, WIDTH - 40 * MM, SMALL_MUTED)
    draw_text(canvas, f"page {place} of {total}", LEFT + half, foot, half, SMALL_STRONG, align="right")
