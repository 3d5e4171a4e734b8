"""The list that belongs to a printed chart: every patch with its ink and place, and all that a reader must know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tilefab.chart import ChartLayout
from tilefab.chart.design import FULL, MOST_INKS
from tilefab.chart.marks import CHARTS, MOST_TILES
from tilefab.errors import ProfileError
from tilefab.io.cgats import read_ink_names
from tilefab.io.cgats_columns import ink_columns
from tilefab.io.cgats_tables import Table, check_table, numbers, read_tables, read_text
from tilefab.io.cgats_write import amount, cgats_text, ink_column_names
from tilefab.types import SizePx

_VERSION = "1"
_LARGEST_PX = 200_000
_MOST_CELLS = 200_000
_SLACK_COUNTS = 0.01


@dataclass(frozen=True, eq=False)
class ChartList:
    """A chart as its list describes it.

    Attributes
    ----------
    layout
        Where everything lies.
    ink_names
        N names, in channel order.
    sample_ids, locations
        P names and places of the patches.
    description
        The list's DESCRIPTOR.
    """

    layout: ChartLayout = field(repr=False)
    ink_names: tuple[str, ...]
    sample_ids: tuple[str, ...] = field(repr=False)
    locations: tuple[str, ...] = field(repr=False)
    description: str


def chart_text(
    layout: ChartLayout, *, ink_names: tuple[str, ...], kinds: Sequence[str], description: str, created: str
) -> str:
    """The list of a chart as CGATS text.

    Parameters
    ----------
    layout
        The chart.
    ink_names
        N names without commas.
    kinds
        Why each patch is there, a word each.
    description, created
        What it is, and the day, as ``2026-11-24``.
    """
    inks = layout.ink_counts.shape[1]
    keywords = {
        "DESCRIPTOR": description,
        "ORIGINATOR": "tilefab",
        "CREATED": created,
        "DEVICE_CLASS": "OUTPUT",
        "COLOR_REP": "CMYK" if inks == 4 else f"{inks}CLR",
        "INK_NAMES": ",".join(ink_names),
        "CHART_VERSION": _VERSION,
        "CHART_NUMBER": str(layout.chart),
        "CHART_TILES": str(layout.tiles),
        "CHART_DPI": f"{layout.dpi:.10g}",
        "CHART_TILE_ROWS_PX": str(layout.tile.rows),
        "CHART_TILE_COLS_PX": str(layout.tile.cols),
        "CHART_PATCH_PX": str(layout.patch_px),
        "CHART_GAP_PX": str(layout.gap_px),
        "CHART_MARGIN_PX": str(layout.margin_px),
        "CHART_MODULE_PX": str(layout.module_px),
        "CHART_LABEL_PX": str(layout.label_px),
        "CHART_MARK_INK": " ".join(amount(100.0 * int(count) / FULL) for count in layout.mark_counts),
    }
    rows = []
    for patch, counts in enumerate(layout.ink_counts):
        tile, row, col = (str(int(value) + 1) for value in layout.places[patch])
        rows.append(
            [
                str(patch + 1),
                layout.location(patch),
                tile,
                row,
                col,
                kinds[patch],
                *(amount(100.0 * int(count) / FULL) for count in counts),
            ]
        )
    columns = ["SAMPLE_ID", "SAMPLE_LOC", "TILE", "ROW", "COL", "KIND", *ink_column_names(inks)]
    return cgats_text("CGATS.17", keywords, columns, rows)


def _number(table: Table, keyword: str, low: float, high: float, name: str) -> float:
    word = table.keywords.get(keyword, "")
    try:
        value = float(word[:30])
    except ValueError:
        value = float("nan")
    if not low <= value <= high:
        what = f"is {word[:30]!r}" if word else "is missing"
        raise ProfileError(
            f"{name}: {keyword} {what}, but must be {low:g} to {high:g}: give the list that the chart came with",
            path=name,
        )
    return value


def parse_chart(text: str, name: str) -> ChartList:
    """Read a chart's list back from the text that `chart_text` made.

    Raises
    ------
    ProfileError
        If it is no such list, or contradicts itself.
    """
    table = next((table for table in read_tables(text, name) if "CHART_VERSION" in table.keywords), None)
    if table is None:
        raise ProfileError(
            f"{name}: is no list of a chart: give the .cgats file that tilefab profile chart wrote", path=name
        )
    if table.keywords["CHART_VERSION"] != _VERSION:
        raise ProfileError(
            f"{name}: is of another version of tilefab ({table.keywords['CHART_VERSION'][:30]}, not {_VERSION}): read "
            "it with that version",
            path=name,
        )
    check_table(table, name)
    inks = ink_columns(table.spelled)
    wanted = ("TILE", "ROW", "COL")
    missing = [column for column in ("SAMPLE_ID", "SAMPLE_LOC", *wanted) if column not in table.columns]
    if missing or not 1 <= len(inks) <= MOST_INKS:
        raise ProfileError(f"{name}: lacks columns {' '.join(missing) or 'of ink'}: print the chart anew", path=name)
    samples = table.column("SAMPLE_ID") or []
    if len({sample.casefold() for sample in samples}) < len(samples):
        raise ProfileError(f"{name}: two patches have one SAMPLE_ID: the list was edited", path=name)
    counts = numbers(table, inks, name, spelled=True) * (FULL / 100.0)
    whole = np.rint(counts)
    if (np.abs(counts - whole) > _SLACK_COUNTS).any() or whole.min() < 0 or whole.max() > FULL:
        raise ProfileError(
            f"{name}: ink is not in whole 255ths: the list was edited; take the one printed with", path=name
        )
    places = numbers(table, wanted, name)
    if (places != np.rint(places)).any() or np.abs(places).max() > _LARGEST_PX:
        raise ProfileError(f"{name}: TILE, ROW and COL must be whole numbers: the list was edited", path=name)

    def whole_number(keyword: str, low: int, high: int) -> int:
        return int(_number(table, keyword, low, high, name))

    layout = ChartLayout(
        dpi=_number(table, "CHART_DPI", 10.0, 20_000.0, name),
        tile=SizePx(
            whole_number("CHART_TILE_ROWS_PX", 32, _LARGEST_PX), whole_number("CHART_TILE_COLS_PX", 32, _LARGEST_PX)
        ),
        patch_px=whole_number("CHART_PATCH_PX", 4, _LARGEST_PX),
        gap_px=whole_number("CHART_GAP_PX", 1, _LARGEST_PX),
        margin_px=whole_number("CHART_MARGIN_PX", 0, _LARGEST_PX),
        module_px=whole_number("CHART_MODULE_PX", 1, _LARGEST_PX // 8),
        label_px=whole_number("CHART_LABEL_PX", 0, _LARGEST_PX),
        tiles=whole_number("CHART_TILES", 1, MOST_TILES),
        chart=whole_number("CHART_NUMBER", 0, CHARTS - 1),
        ink_counts=whole.astype(np.uint8),
        mark_counts=_mark_counts(table, len(inks), name),
        places=places.astype(np.int64) - 1,
    )
    _check_places(layout, name)
    return ChartList(
        layout,
        read_ink_names(table, inks, name),
        tuple(samples),
        tuple(table.column("SAMPLE_LOC") or ()),
        table.keywords.get("DESCRIPTOR", Path(name).stem),
    )


def _mark_counts(table: Table, inks: int, name: str) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    words = table.keywords.get("CHART_MARK_INK", "").split()
    try:
        percent = np.array([float(word[:30]) for word in words])
    except ValueError:
        percent = np.empty(0)
    if len(percent) != inks or not ((percent >= 0.0) & (percent <= 100.0)).all():
        raise ProfileError(f"{name}: CHART_MARK_INK must give 0 to 100 percent of each ink", path=name)
    return np.rint(percent * FULL / 100.0).astype(np.uint8)


def _check_places(layout: ChartLayout, name: str) -> None:
    fits = layout.grid.rows * layout.grid.cols <= _MOST_CELLS
    cells = {tuple(cell) for cell in layout.cells().tolist()} if fits else set()
    taken: set[tuple[int, ...]] = set()
    for patch, place in enumerate(layout.places.tolist()):
        key = tuple(place)
        if not 0 <= place[0] < layout.tiles or key[1:] not in cells or key in taken:
            raise ProfileError(
                f"{name}: the place of patch {patch + 1} is not on the chart or taken twice: the list was edited; take "
                "the one that the chart came with",
                path=name,
            )
        taken.add(key)


def read_chart_list(path: str | Path) -> ChartList:
    """Read a chart's list; see `parse_chart`.

    Raises
    ------
    ProfileError
        If the file can't be read, or for what `parse_chart` refuses.
    """
    return parse_chart(read_text(path), str(path))
