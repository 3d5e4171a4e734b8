"""The sheet of a profile check, as one PDF or as a picture of each page."""

from __future__ import annotations

import io

from reportlab.pdfgen.canvas import Canvas as PdfCanvas

from tilefab.report.layout import Page
from tilefab.report.picture_canvas import PictureCanvas
from tilefab.report.profile_pages_colour import gamut_pages, tone_pages
from tilefab.report.profile_pages_ramps import ramp_pages
from tilefab.report.profile_pages_summary import summary_pages
from tilefab.report.profile_view import ProfileCheckView
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

PICTURE_DPI = 150.0


def build_profile_sheet(view: ProfileCheckView, *, created: str, version: str, compress: bool = True) -> bytes:
    """Draw a profile check as an A4 PDF file.

    Parameters
    ----------
    view
        All that the sheet shows.
    created
        The date as it is to be shown.
    version
        Version of the software.
    compress
        Whether drawing commands are compressed.

    Returns
    -------
    bytes
        The file. Equal views give equal bytes with the same versions of the libraries that draw it.
    """
    file = io.BytesIO()
    canvas = PdfCanvas(file, pagesize=(PAGE_WIDTH, PAGE_HEIGHT), pageCompression=int(compress), invariant=1, lang="en")
    canvas.setTitle(clean(f"Profile check: {view.facts.description}"))
    canvas.setAuthor("tilefab")
    canvas.setSubject(clean(f"Profile check, profile {view.facts.sha256}"))
    canvas.setCreator(clean(f"tilefab {version}"))
    pages = sheet_pages(view)
    section = ""
    for place, page in enumerate(pages, 1):
        if page.section != section:
            section = page.section
            canvas.bookmarkPage(f"page-{place}")
            canvas.addOutlineEntry(section, f"page-{place}", 0)
        page.draw(canvas)
        _draw_margins(canvas, view, page, place, len(pages), f"{created}  ·  tilefab {version}")
        canvas.showPage()
    canvas.save()
    return file.getvalue()


def build_profile_pictures(
    view: ProfileCheckView, *, created: str, version: str, dpi: float = PICTURE_DPI
) -> tuple[bytes, ...]:
    """Draw the same pages as PNG files, one a page; arguments as in `build_profile_sheet`, and their resolution."""
    pages = sheet_pages(view)
    files = []
    for place, page in enumerate(pages, 1):
        canvas = PictureCanvas(PAGE_WIDTH, PAGE_HEIGHT, dpi)
        page.draw(canvas)
        _draw_margins(canvas, view, page, place, len(pages), f"{created}  ·  tilefab {version}")
        files.append(canvas.png())
    return tuple(files)


def sheet_pages(view: ProfileCheckView) -> list[Page]:
    """All pages, in order."""
    return [*summary_pages(view), *gamut_pages(view), *tone_pages(view), *ramp_pages(view)]


def _draw_margins(canvas: Canvas, view: ProfileCheckView, page: Page, place: int, total: int, made: str) -> None:
    """Draw header and footer: what this sheet belongs to, should it ever lie alone on a desk."""
    half = WIDTH / 2
    top = PAGE_HEIGHT - 10 * MM
    draw_text(canvas, view.facts.description, LEFT, top, WIDTH - 55 * MM, SMALL_MUTED, middle=True)
    draw_text(canvas, f"profile {short_hash(view.facts.sha256)}", LEFT + half, top, half, SMALL_STRONG, align="right")
    draw_rule(canvas, LEFT, top - 4.2 * MM, WIDTH)
    foot = BOTTOM - 6 * MM
    draw_rule(canvas, LEFT, foot + 1 * MM, WIDTH)
    draw_text(canvas, f"{page.section}  ·  {made}", LEFT, foot, WIDTH - 40 * MM, SMALL_MUTED)
    draw_text(canvas, f"page {place} of {total}", LEFT + half, foot, half, SMALL_STRONG, align="right")
