"""The contact sheet: what each face looks like, and the code it is re-created from."""

from __future__ import annotations

from dataclasses import dataclass

from tilefab.errors import ReportError
from tilefab.report.figures import (
    QUIET_MODULES,
    draw_image,
    draw_no_image,
    draw_qr,
    qr_least_side,
    qr_modules,
    qr_side,
)
from tilefab.report.layout import Block, Page, flow, section_heading, text_block
from tilefab.report.style import (
    GREY,
    GUTTER,
    LEFT,
    MM,
    SMALL,
    SMALL_MUTED,
    SMALL_STRONG,
    STRONG,
    WIDTH,
    Canvas,
    draw_rule,
    draw_text,
    number,
    short_hash,
)
from tilefab.report.view_model import FaceView, RunReportView, contact_faces
from tilefab.types import Mask


@dataclass(frozen=True)
class _Grid:
    """Cards a row, the space for a code and a picture in each, and a card's height, in points."""

    columns: int
    qr_box: float
    picture_height: float
    height: float

    @property
    def card_width(self) -> float:
        return (WIDTH - (self.columns - 1) * GUTTER) / self.columns


_GRIDS = (
    _Grid(columns=3, qr_box=26 * MM, picture_height=40 * MM, height=57 * MM),
    _Grid(columns=2, qr_box=48 * MM, picture_height=55 * MM, height=73 * MM),
)


def face_pages(view: RunReportView) -> list[Page]:
    """Make the contact sheet of the faces evenly chosen from the run; wider cards when a code needs them.

    Raises
    ------
    ReportError
        If a face's code is too long to be printed so that it scans.
    """
    shown = [view.faces[place] for place in contact_faces(len(view.faces), view.max_contact_faces)]
    if not shown:
        return flow("Faces", [section_heading("Faces"), text_block("No faces were printed.")])
    codes = [qr_modules(face.code, f"the code of face {face.index}") for face in shown]
    needed = max(qr_least_side(code) for code in codes)
    grid = next((grid for grid in _GRIDS if grid.qr_box >= needed), None)
    if grid is None:
        raise ReportError(
            f"the longest face code needs a QR code {needed / MM:.0f} mm wide to scan from print, and "
            f"{_GRIDS[-1].qr_box / MM:.0f} mm is the most that fits; shorten the code"
        )
    rows = [slice(start, start + grid.columns) for start in range(0, len(shown), grid.columns)]
    heading = section_heading("Faces", _note(len(shown), len(view.faces)))
    return flow("Faces", [heading, *(_row(shown[row], codes[row], grid) for row in rows)])


def _note(shown: int, total: int) -> str:
    how = "Scan a code, or give its index to the job, to make the same face again."
    if shown == total:
        return f"{'The one face' if total == 1 else f'All {number(total, 0)} faces'} of the run. {how}"
    chosen = f"{number(shown, 0)} of {number(total, 0)} faces, evenly chosen from first to last"
    return f"{chosen}; {number(total - shown, 0)} left out. {how}"


def _row(faces: list[FaceView], codes: list[Mask], grid: _Grid) -> Block:
    def draw(canvas: Canvas, top: float) -> None:
        for place, (face, code) in enumerate(zip(faces, codes, strict=True)):
            _draw_card(canvas, face, code, LEFT + place * (grid.card_width + GUTTER), top, grid)

    return Block(grid.height, draw)


def _draw_card(canvas: Canvas, face: FaceView, code: Mask, x: float, top: float, grid: _Grid) -> None:
    """Draw a card; the code's quiet zone lies in the gutter, so that its dark square ends flush."""
    width = grid.card_width
    side = qr_side(code, grid.qr_box)
    quiet = side * QUIET_MODULES / (len(code) + 2 * QUIET_MODULES)
    draw_rule(canvas, x, top, width, GREY, 0.6)
    title_width = width - side + quiet
    draw_text(canvas, f"Face {face.index}", x, top - 0.8 * MM, title_width, STRONG, shrink=0.6, middle=True)
    y = top - 0.8 * MM - STRONG.leading - 0.8 * MM
    picture_width = width - grid.qr_box - 2 * MM
    if face.thumbnail is None:
        draw_no_image(canvas, x, y, picture_width, grid.picture_height)
    else:
        draw_image(canvas, face.thumbnail, x, y, picture_width, grid.picture_height, centre=False)
    draw_qr(canvas, code, x + width - side + quiet, y + quiet, side)
    text_x, text_width = x + width - grid.qr_box + 2 * quiet, grid.qr_box - 2 * quiet
    below = draw_text(canvas, face.origin, text_x, y - side + quiet, text_width, SMALL, max_lines=3)
    draw_text(canvas, short_hash(face.sha256, 8), text_x, below, text_width, SMALL_MUTED)
    floor = y - grid.picture_height - 0.8 * MM
    draw_text(canvas, face.file_name, x, floor, width, SMALL_STRONG, max_lines=2, middle=True)
