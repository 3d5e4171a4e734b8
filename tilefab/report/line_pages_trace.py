"""Traceability: which face went through the line when, with which correction, and what became of it."""

from __future__ import annotations

from collections.abc import Sequence

from tilefab.inspection.records import Grade
from tilefab.report.layout import Page, flow, section_heading, text_block
from tilefab.report.line_charts import clock_text
from tilefab.report.line_parts import Column, table
from tilefab.report.line_view import LineReportView, TileView
from tilefab.report.style import MM, number
from tilefab.report.view_model import contact_faces

SECTION = "Traceability"
MOST_ROWS = 400


def trace_pages(view: LineReportView) -> list[Page]:
    """Make the table; where tiles are too many, those that aren't first choice go before the others."""
    shown = chosen_tiles(view.tiles)
    if not shown:
        return flow(SECTION, [section_heading(SECTION), text_block("No tile was printed in this span.")])
    columns = [
        Column("face", 15 * MM, right=True),
        Column("arm", 15 * MM, right=True),
        Column("printed", 23 * MM),
        Column("photographed", 23 * MM),
        Column("corr.", 11 * MM, right=True),
        Column("ΔE00", 12 * MM, right=True),
        Column("lot", 9 * MM),
        Column("grade", 13 * MM),
        Column("photograph", 53 * MM),
    ]
    return flow(
        SECTION,
        [
            section_heading(SECTION, _note(len(shown), len(view.tiles))),
            *table(columns, _rows(shown, view), max_lines=1),
        ],
    )


def _note(shown: int, total: int) -> str:
    how = "`tilefab trace PHOTOGRAPH JOB` tells the same from the tile's own pattern, and prints the face again."
    if shown == total:
        return f"Every tile of the span. {how}"
    return (
        f"{number(shown, 0)} of {number(total, 0)} tiles: those that aren't first choice, and others evenly chosen; "
        f"the JSON beside this report has all. {how}"
    )


def chosen_tiles(tiles: Sequence[TileView]) -> list[TileView]:
    """At most `MOST_ROWS` tiles in order: those graded below first choice, then others, each evenly chosen."""
    if len(tiles) <= MOST_ROWS:
        return list(tiles)
    below = [place for place, tile in enumerate(tiles) if tile.grade in (Grade.SECOND, Grade.SCRAP)]
    others = [place for place, tile in enumerate(tiles) if tile.grade not in (Grade.SECOND, Grade.SCRAP)]
    most_below = min(len(below), max(MOST_ROWS // 2, MOST_ROWS - len(others)))
    places = [below[index] for index in contact_faces(len(below), most_below)]
    places += [others[index] for index in contact_faces(len(others), MOST_ROWS - most_below)]
    return [tiles[place] for place in sorted(places)]


def _rows(tiles: Sequence[TileView], view: LineReportView) -> list[tuple[str, ...]]:
    offset = view.utc_offset_min

    def clock(at_s: float | None) -> str:
        return "–" if at_s is None else clock_text(at_s, offset, seconds=True)[5:]

    return [
        (
            str(tile.face),
            str(tile.arm),
            clock(tile.printed_s),
            clock(tile.fired_s),
            str(tile.correction) if tile.correction else "–",
            "–" if tile.colour is None else number(tile.colour.delta_e_mean, 2),
            tile.lot or "–",
            "–" if tile.grade is None else tile.grade.value,
            tile.image or "–",
        )
        for tile in tiles
    ]
