"""Puts the pages together into one PDF."""

from __future__ import annotations

import io

from reportlab.pdfgen.canvas import Canvas as PdfCanvas

from tilefab.report.check import check_view
from tilefab.report.layout import Page
from tilefab.report.pages_colour import colour_pages
from tilefab.report.pages_cover import cover_pages
from tilefab.report.pages_faces import face_pages
from tilefab.report.pages_log import log_pages
from tilefab.report.pages_map import map_pages
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
from tilefab.report.view_model import RunReportView


def build_run_report(view: RunReportView, *, compress: bool = True) -> bytes:
    """Draw the report of a run as an A4 PDF file.

    Parameters
    ----------
    view
        All that the report shows.
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
    check_view(view)
    pages = [
        *cover_pages(view),
        *face_pages(view),
        *colour_pages(view.colour),
        *map_pages(view.texture_map),
        *log_pages(view.preparation, view.warnings),
    ]
    file = io.BytesIO()
    canvas = PdfCanvas(file, pagesize=(PAGE_WIDTH, PAGE_HEIGHT), pageCompression=int(compress), invariant=1, lang="en")
    canvas.setTitle(clean(view.title))
    canvas.setAuthor("tilefab")
    canvas.setSubject(clean(f"Run report, job {view.job_hash}"))
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


def _draw_margins(canvas: Canvas, view: RunReportView, page: Page, place: int, total: int) -> None:
    """Draw the header and footer: what this sheet belongs to, should it ever lie alone on a desk."""
    half = WIDTH / 2
    top = PAGE_HEIGHT - 10 * MM
    draw_text(canvas, view.title, LEFT, top, WIDTH - 50 * MM, SMALL_MUTED, middle=True)
    draw_text(canvas, f"job {short_hash(view.job_hash)}", LEFT + half, top, half, SMALL_STRONG, align="right")
    draw_rule(canvas, LEFT, top - 4.2 * MM, WIDTH)
    foot = BOTTOM - 6 * MM
    draw_rule(canvas, LEFT, foot + 1 * MM, WIDTH)
    note = f"{page.section}  ·  {view.created}  ·  tilefab {view.software_version}"
    draw_text(canvas, note, LEFT, foot, WIDTH - 40 * MM, SMALL_MUTED)
    draw_text(canvas, f"page {place} of {total}", LEFT + half, foot, half, SMALL_STRONG, align="right")
