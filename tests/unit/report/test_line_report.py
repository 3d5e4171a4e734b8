"""The report of a line as a reader gets it, its twin in JSON, and what can't be drawn."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.line_report_samples import BEGUN_S, empty, long_job, one_tile, stone, typical
from tilefab.errors import ReportError
from tilefab.inspection.records import Grade
from tilefab.report.line_build import build_line_report, line_report_pages
from tilefab.report.line_json import line_report_json
from tilefab.report.line_pages_trace import MOST_ROWS, chosen_tiles
from tilefab.report.line_view import (
    CorrectionView,
    InkUseView,
    KilnZoneView,
    LimitsView,
    LineReportView,
    LotView,
    ShiftView,
    SpanView,
    TileView,
    VariationView,
    WorstTileView,
)
from tilefab.report.picture_canvas import PictureCanvas
from tilefab.report.style import INK, LEFT, PAGE_HEIGHT, PAGE_WIDTH, SMALL, TextStyle, text_width

PDFTOTEXT = shutil.which("pdftotext")
needs_pdftotext = pytest.mark.skipif(PDFTOTEXT is None, reason="pdftotext (poppler-utils) is not installed")
LONG = "Mármore – Größe 60×120 Ž 大理石 رخام " + "Very_long_name-" * 11


@pytest.fixture(scope="module")
def shift() -> LineReportView:
    return typical(300)


@pytest.fixture(scope="module")
def report(shift: LineReportView) -> bytes:
    return build_line_report(shift)


def extreme(shift: LineReportView) -> LineReportView:
    """The longest texts, most parts and oddest shapes that might come."""
    odd = replace(shift.tiles[3], face=10**15, arm=10**15, image=LONG, lot="ABC", reasons=(LONG,) * 3)
    return replace(
        shift,
        title=LONG * 2,
        line=LONG,
        job_file=LONG,
        created=LONG,
        facts=((LONG, LONG * 4),) * 9,
        tile_size_mm=(50.0, 2400.0),
        tiles=(odd, *shift.tiles),
        corrections=tuple(CorrectionView(n, BEGUN_S + 60.0 * n, LONG * 3, "ab" * 32, 0.01 * n) for n in range(1, 90)),
        kiln=tuple(
            KilnZoneView(LONG, (BEGUN_S, BEGUN_S + 50.0), (20.0 + place, 20.0), None if place % 2 else 900.0)
            for place in range(30)
        ),
        downtime=tuple(SpanView(BEGUN_S + 9.0 * n, BEGUN_S + 9.0 * n + 4.0, LONG, LONG * 3) for n in range(130)),
        alarms=tuple(SpanView(BEGUN_S + n, None if n % 2 else BEGUN_S + n + 1.0, LONG, LONG) for n in range(130)),
        lots=tuple(
            LotView("AB", 3, (0.1 * n, -0.1 * n, 0.0), 0.4, BEGUN_S, BEGUN_S + 9, (250, 250, 250)) for n in range(200)
        ),
        inks=tuple(InkUseView(LONG, 10.0**n, -1.0 if n % 2 else 0.5) for n in range(12)),
        shifts=tuple(ShiftView(LONG, BEGUN_S + 100.0 * n, BEGUN_S + 100.0 * (n + 1)) for n in range(12)),
        variation=VariationView("V4", 1e6, 1e6, 1e6, True, 0.31, LONG * 9),
        worst=(WorstTileView(odd, stone(4, 900, 1), stone(900, 4, 2), None),) * 11,
        tile_picture=stone(3, 400, 3),
        warnings=(LONG * 4,) * 20,
    )


def words_of(pdf: bytes, tmp_path: Path) -> str:
    path = tmp_path / "report.pdf"
    path.write_bytes(pdf)
    assert PDFTOTEXT is not None
    done = subprocess.run([PDFTOTEXT, "-layout", str(path), "-"], capture_output=True, check=True, timeout=60)
    assert done.stderr == b""
    return done.stdout.decode("utf-8")


@needs_pdftotext
def test_words_of_a_shift(shift: LineReportView, report: bytes, tmp_path: Path) -> None:
    text = words_of(report, tmp_path)
    graded = sum(tile.grade is not None for tile in shift.tiles)
    for part in (
        "Shift report",
        "Verde Alpi 600 × 300, honed",
        "2026-11-24 06:00 to 2026-11-24 14:00, 8 h 00 min",
        f"of {graded} graded tiles are first choice",
        "Line 2, run 17, job 8f14 e45f",
        "nozzle line",
        "ISO 10545-2:2018",
        "not told: that",
        "Print head 3: purge, vacuum low",
        "Three photographs of the camera could not be read",
        shift.corrections[0].reason[:30],
        "zone 5: 1195 °C",
        "EWMA, weight 0.2, limits at 2.962 sigma",
        "15 points in a row within 1 sigma of the centre",
        "no fired tile was measured for 15 minutes",
        "Traceability",
    ):
        assert part in text, part
    for tile in shift.tiles[:20]:
        assert f"{tile.arm}" in text


@needs_pdftotext
def test_words_of_nothing(tmp_path: Path) -> None:
    text = words_of(build_line_report(empty()), tmp_path)
    for part in (
        "No tile's colour was measured.",
        "no tile was measured",
        "no temperatures were recorded",
        "The controller recorded no innovations in this span.",
        "No tile was inspected.",
        "No shade lots were made",
        "No tile was inspected with pictures.",
        "The ink used is not known.",
        "The line ran without a stop.",
        "No alarm was raised.",
        "No tile was printed in this span.",
    ):
        assert part in text, part


def test_same_view_same_bytes(shift: LineReportView, report: bytes) -> None:
    build_line_report(empty())
    assert build_line_report(shift) == report
    assert build_line_report(replace(shift, created="later")) != report
    assert report.startswith(b"%PDF-1.")
    assert report.rstrip().endswith(b"%%EOF")


@pytest.mark.parametrize("name", ["empty", "one tile", "extreme"])
def test_odd_reports_can_be_drawn(shift: LineReportView, name: str) -> None:
    view = {"empty": empty(), "one tile": one_tile(), "extreme": extreme(shift)}[name]
    assert build_line_report(view, compress=False).count(b"/Type /Page\n") == len(line_report_pages(view))


def test_a_long_job_is_thinned() -> None:
    view = long_job(3000)
    sections = [page.section for page in line_report_pages(view)]
    # Ten of traceability's pages show what the view has thousands of.
    assert sections.count("Traceability") <= 10
    assert sections.count("Shifts") == 2
    assert len(sections) <= 30
    assert len(build_line_report(view)) < 1.5 * len(build_line_report(typical(300)))


def test_every_section_has_its_pages(shift: LineReportView) -> None:
    sections = list(dict.fromkeys(page.section for page in line_report_pages(shift)))
    assert sections == [
        "Summary",
        "Colour over time",
        "The loop",
        "Defects and dimensions",
        "Shade and variation",
        "Worst tiles",
        "Ink, stops and alarms",
        "Traceability",
    ]


class Watched(PictureCanvas):
    """Notes where texts and lines reach."""

    def __init__(self) -> None:
        super().__init__(PAGE_WIDTH, PAGE_HEIGHT, 36.0)
        self.reach: list[tuple[float, float]] = []
        self.style = SMALL

    def line(self, x0: float, y0: float, x1: float, y1: float) -> None:
        self.reach += [(x0, y0), (x1, y1)]
        super().line(x0, y0, x1, y1)

    def drawString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        self.reach += [(x, y), (x + text_width(text, self.style), y)]

    def drawRightString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        self.reach += [(x - text_width(text, self.style), y), (x, y)]

    def drawCentredString(self, x: float, y: float, text: str) -> None:  # noqa: N802
        half = text_width(text, self.style) / 2
        self.reach += [(x - half, y), (x + half, y)]

    def setFont(self, name: str, size: float) -> None:  # noqa: N802
        self.style = TextStyle(name, size, size, INK)


@pytest.mark.parametrize("which", ["shift", "one tile"])
def test_everything_stays_on_the_page(shift: LineReportView, which: str) -> None:
    for page in line_report_pages(shift if which == "shift" else one_tile())[:9]:
        canvas = Watched()
        page.draw(canvas)
        reach = np.array(canvas.reach)
        assert reach[:, 0].min() >= LEFT - 0.5
        assert reach[:, 0].max() <= PAGE_WIDTH - LEFT + 0.5
        assert reach[:, 1].min() >= 50.0
        assert reach[:, 1].max() <= PAGE_HEIGHT - 50.0


def test_too_many_tiles_are_chosen_from() -> None:
    tiles = [
        TileView(place, place + 1, grade=Grade.SCRAP if place % 100 == 7 else Grade.FIRST) for place in range(20_000)
    ]
    chosen = chosen_tiles(tiles)
    faces = [tile.face for tile in chosen]
    assert len(chosen) == MOST_ROWS
    assert faces == sorted(set(faces))
    assert faces[0] == 0
    assert faces[-1] == 19_999
    assert sum(tile.grade is Grade.SCRAP for tile in chosen) == 200
    scrap = [tile for tile in tiles if tile.grade is Grade.SCRAP]
    assert len(chosen_tiles(scrap * 10)) == MOST_ROWS
    assert chosen_tiles(tiles[:MOST_ROWS]) == tiles[:MOST_ROWS]


def test_json_says_the_same(shift: LineReportView) -> None:
    plain = line_report_json(shift)
    again = json.loads(json.dumps(plain, allow_nan=False))
    assert again == plain
    assert plain["schema_version"] == 1
    assert len(plain["tiles"]) == len(shift.tiles)
    first = next(tile for tile in shift.tiles if tile.colour is not None)
    told = plain["tiles"][shift.tiles.index(first)]
    assert first.colour is not None
    assert first.grade is not None
    assert (told["face"], told["grade"]) == (first.face, first.grade.value)
    assert told["colour"]["fired_lab"] == list(first.colour.fired_lab)
    assert plain["figures"]["counts"]["printed"] == len(shift.tiles)
    assert {verdict["what"] for verdict in plain["verdicts"]} >= {"Colour", "Control", "Line"}
    assert plain["corrections"][0]["sha256"] == shift.corrections[0].sha256
    assert plain["loop"]["innovations"] + plain["loop"]["rejected"] == len(shift.innovations)
    assert len(plain["loop"]["signals_at_s"]["cusum"]) == plain["loop"]["signals"]["cusum"]
    assert len(plain["loop"]["rules"]) == 8
    assert plain["control_limits"]["lightness"]["n"] == 5
    assert len(plain["worst"]) == len(shift.worst)
    assert "predicted" not in plain["worst"][0]
    assert "tile_picture" not in plain
    kinds = {row["kind"]: row for row in plain["defect_counts"]}
    assert kinds["nozzle_line"]["tiles_not_first"] > 0


def test_json_of_nothing_has_nulls() -> None:
    plain = line_report_json(empty())
    assert plain["loop"] is None
    assert plain["variation"] is None
    assert plain["figures"]["delta_e_mean"] is None
    assert plain["control_limits"] == {"lightness": None, "a": None, "b": None}


def test_json_has_no_infinities(shift: LineReportView) -> None:
    measured = [tile for tile in shift.tiles if tile.colour is not None]
    alike = tuple(replace(tile, colour=measured[0].colour) for tile in measured[:3])
    plain = line_report_json(replace(shift, tiles=alike, limits=LimitsView(50.0)))
    assert plain["figures"]["capability"]["cpk"] is None


NAN = math.nan


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"begun_s": NAN}, "begun_s"),
        ({"ended_s": BEGUN_S - 1.0}, "before begun_s"),
        ({"ended_s": 1e18}, "between the years"),
        ({"utc_offset_min": 5000}, "within a day"),
        ({"tile_size_mm": (0.0, 1.0)}, "tile_size_mm"),
        ({"tiles": (TileView(0, 1, printed_s=NAN),)}, "tiles[0]"),
        ({"tile_picture": np.zeros((4, 4), np.uint8)}, "tile_picture"),
        ({"tile_picture": np.zeros((0, 4, 3), np.uint8)}, "at least one pixel"),
        ({"worst": (WorstTileView(TileView(0, 1), None, np.zeros((2, 3), np.uint8), None),)}, "worst[0].fired"),
        ({"kiln": (KilnZoneView("z", (1.0, 2.0), (3.0,)),)}, "kiln[0]"),
        ({"kiln": (KilnZoneView("z", (1.0,), (NAN,)),)}, "kiln[0].temp_degc"),
        ({"corrections": (CorrectionView(1, 0.0, "", "", -1.0),)}, "corrections[0].drift_delta_e"),
        ({"holds": (SpanView(0.0, NAN, "", ""),)}, "holds[0]"),
        ({"lots": (LotView("A", 1, (NAN, 0.0, 0.0), 0.0, 0.0, 0.0),)}, "lots[0]"),
        ({"lots": (LotView("A", 1, (0.0, 0.0, 0.0), 0.0, 0.0, 0.0, (300, 0, 0)),)}, "lots[0].rgb"),
        ({"inks": (InkUseView("x", -1.0),)}, "inks[0].used"),
        ({"limits": LimitsView(NAN)}, "limits.delta_e_mean"),
        ({"variation": VariationView("V1", NAN, 0.0, 0.0, False, None, "")}, "variation"),
        ({"shifts": (ShiftView("s", 0.0, math.inf),)}, "shifts[0]"),
    ],
)
def test_what_cannot_be_drawn_is_named(changes: dict[str, object], said: str) -> None:
    view = replace(empty(), **changes)  # type: ignore[arg-type]
    for make in (build_line_report, line_report_json):
        with pytest.raises(ReportError) as caught:
            make(view)
        assert said in str(caught.value)
