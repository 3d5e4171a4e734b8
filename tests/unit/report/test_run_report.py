"""The report as a reader gets it: its words, where they stand, and the same bytes each time."""

from __future__ import annotations

import hashlib
import html
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from tilefab.report import RunReportView, build_run_report, contact_faces

PDFTOTEXT = shutil.which("pdftotext")
needs_pdftotext = pytest.mark.skipif(PDFTOTEXT is None, reason="pdftotext (poppler-utils) is not installed")
SCENARIOS = ("typical", "minimal", "extreme")
MM = 72 / 25.4


@pytest.fixture(scope="session")
def reports(typical: RunReportView, minimal: RunReportView, extreme: RunReportView) -> dict[str, bytes]:
    views = dict(zip(SCENARIOS, (typical, minimal, extreme), strict=True))
    return {name: build_run_report(view) for name, view in views.items()}


def words_of(pdf: bytes, tmp_path: Path, *options: str) -> str:
    path = tmp_path / "report.pdf"
    path.write_bytes(pdf)
    assert PDFTOTEXT is not None
    done = subprocess.run([PDFTOTEXT, *options, str(path), "-"], capture_output=True, check=True, timeout=60)
    assert done.stderr == b""
    return done.stdout.decode("utf-8")


@pytest.mark.parametrize("name", SCENARIOS)
def test_is_a_whole_pdf_file(reports: dict[str, bytes], name: str) -> None:
    assert reports[name].startswith(b"%PDF-1.")
    assert reports[name].rstrip().endswith(b"%%EOF")


@pytest.mark.parametrize("name", ["typical", "minimal"])
def test_same_bytes_again_also_after_another_report(
    reports: dict[str, bytes], name: str, typical: RunReportView, minimal: RunReportView
) -> None:
    assert build_run_report(typical if name == "typical" else minimal) == reports[name]


def test_same_bytes_in_another_process(typical: RunReportView, tmp_path: Path) -> None:
    # Hash seeds differ between processes; a report that depended on the order of a set would show it.
    script = (
        "import hashlib, sys, numpy as np\n"
        "from tilefab.report import *\n"
        "px = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)\n"
        "none = np.zeros(0)\n"
        "h = HistogramView(none, none)\n"
        "c = ColourView('p', 'i', None, 1., 1., 0., (InkView('Žluť Δ', 1., 2., .01),), (),\n"
        "    np.zeros((2, 3)), np.zeros((0, 2)), np.zeros((0, 2)), 1., 2., 0., 0., 0.)\n"
        "ch = ChartView('t', 'x', 'y', h)\n"
        "t = TextureMapView((PictureView('t', 'c', px),), (), (ch, ch))\n"
        "f = FaceView(3, 'x', px, 'n', 'o', 's')\n"
        "v = RunReportView('T', 'f', 'a', 'b', 'c', 'd', '1', (), px, '', (f,), c, t, (), ())\n"
        "print(hashlib.sha256(build_run_report(v)).hexdigest())\n"
    )
    sums = {
        subprocess.run(
            [sys.executable, "-c", script],
            capture_output=True,
            check=True,
            timeout=60,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": str(Path(__file__).parents[3]), "PATH": ""},
        ).stdout
        for seed in ("1", "2")
    }
    assert len(sums) == 1


def test_other_input_gives_other_bytes(typical: RunReportView, reports: dict[str, bytes]) -> None:
    later = build_run_report(replace(typical, created="2026-01-16 08:00"))
    assert hashlib.sha256(later).digest() != hashlib.sha256(reports["typical"]).digest()


def test_uncompressed_pages_can_be_read(minimal: RunReportView) -> None:
    loose = build_run_report(minimal, compress=False)
    assert b"/MediaBox [ 0 0 595.27" in loose
    assert b" Tj" in loose


@needs_pdftotext
def test_typical_text(reports: dict[str, bytes], typical: RunReportView, tmp_path: Path) -> None:
    text = words_of(reports["typical"], tmp_path, "-layout")
    short = " ".join(typical.job_hash[start : start + 4] for start in (0, 4, 8))
    for part in (
        "Verde Alpi 60×120",
        "2026-01-15 14:32",
        f"job {short}",
        "All 14 faces of the run",
        "Face 13",
        "verde_00013.tif",
        "Press A, six inks",
        "75.3 %",
        "limit 180 %",
        "6.4 %",
        "< 0.1 %",
        "4.41",
        "−9.0",
        "Cut 14 mm off each side.",
        "3.1 % of pixels were reduced to the ink limit.",
    ):
        assert part in text
    assert "No warnings" not in text
    assert "continued" in text
    assert text.count(f"job {short}") >= 6


@needs_pdftotext
def test_minimal_text(reports: dict[str, bytes], tmp_path: Path) -> None:
    text = words_of(reports["minimal"], tmp_path, "-layout")
    for part in (
        "No warnings.",
        "The one face of the run",
        "no preview",
        "no data",
        "No main colours were recorded.",
        "No inks were recorded.",
        "Nothing: the scan was used as it was.",
        "no limit",
    ):
        assert part in text


@needs_pdftotext
def test_extreme_text(reports: dict[str, bytes], tmp_path: Path) -> None:
    text = words_of(reports["extreme"], tmp_path, "-layout")
    assert "20 of 1 000 faces, evenly chosen from first to last; 980 left out." in text
    assert "Face 1000000000000999" in text
    assert "Mármore – Größe 60×120 Ž ??? ????" in text
    assert re.search(r"\b\d\d more on the next page", text)


@needs_pdftotext
@pytest.mark.parametrize("name", SCENARIOS)
def test_every_page_says_which_it_is(reports: dict[str, bytes], name: str, tmp_path: Path) -> None:
    pages = words_of(reports[name], tmp_path).split("\f")[:-1]
    for place, page in enumerate(pages, 1):
        assert f"page {place} of {len(pages)}" in page


@needs_pdftotext
@pytest.mark.parametrize("name", SCENARIOS)
def test_no_word_leaves_the_page_or_touches_another(reports: dict[str, bytes], name: str, tmp_path: Path) -> None:
    boxes = words_of(reports[name], tmp_path, "-bbox")
    word = re.compile(r'<word xMin="([\d.-]+)" yMin="([\d.-]+)" xMax="([\d.-]+)" yMax="([\d.-]+)">(.*?)</word>')
    for number, page in enumerate(boxes.split("<page ")[1:], 1):
        words = [(*map(float, found[:4]), html.unescape(found[4])) for found in word.findall(page)]
        assert words
        for x0, y0, x1, y1, text in words:
            assert x0 >= 17.9 * MM, (number, text)
            assert x1 <= 192.5 * MM, (number, text)
            assert y0 >= 7 * MM, (number, text)
            assert y1 <= 287 * MM, (number, text)
        # a font's box is higher than its letters: compare the middle half of each
        inner = [
            (x0 + 0.3, y0 + 0.25 * (y1 - y0), x1 - 0.3, y1 - 0.25 * (y1 - y0), text) for x0, y0, x1, y1, text in words
        ]
        inner.sort(key=lambda box: box[1])
        for place, one in enumerate(inner):
            for other in inner[place + 1 :]:
                if other[1] >= one[3]:
                    break
                assert other[0] >= one[2] or one[0] >= other[2], (number, one, other)


@pytest.mark.parametrize(("count", "limit"), [(0, 5), (1, 1), (5, 5), (6, 5), (1000, 60), (7, 1), (10**6, 60)])
def test_contact_faces_are_even_and_hold_both_ends(count: int, limit: int) -> None:
    chosen = contact_faces(count, limit)
    assert len(chosen) == min(count, limit)
    assert list(chosen) == sorted(set(chosen))
    if count and limit > 1:
        assert (chosen[0], chosen[-1]) == (0, count - 1)
    if len(chosen) > 2:
        steps = {after - before for before, after in pairwise(chosen)}
        assert max(steps) - min(steps) <= 1


def test_a_run_without_faces(minimal: RunReportView) -> None:
    assert build_run_report(replace(minimal, faces=())).startswith(b"%PDF")
