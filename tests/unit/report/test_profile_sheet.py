"""Sheets of a profile check: the same pages as PDF and as pictures."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.profile_samples import formula_profile
from tilefab.pipeline.profile_check import check_profile
from tilefab.report.picture_canvas import PictureCanvas
from tilefab.report.profile_sheet import build_profile_pictures, build_profile_sheet, sheet_pages
from tilefab.report.style import ACCENT, INK, WHITE


@pytest.mark.parametrize(("inks", "without"), [(1, ()), (6, ()), (4, ("B2A0", "B2A1", "B2A2", "targ"))])
def test_every_profile_can_be_drawn_both_ways(tmp_path: Path, inks: int, without: tuple[str, ...]) -> None:
    path = tmp_path / "press.icc"
    path.write_bytes(formula_profile(inks, leave_out=without))
    view = check_profile(path, lines=100)
    pdf = build_profile_sheet(view, created="2026-01-15", version="0.1.0")
    assert pdf.startswith(b"%PDF")
    assert pdf == build_profile_sheet(view, created="2026-01-15", version="0.1.0")
    pictures = build_profile_pictures(view, created="2026-01-15", version="0.1.0", dpi=40)
    assert len(pictures) == len(sheet_pages(view))
    for picture in pictures:
        pixels = np.asarray(Image.open(io.BytesIO(picture)))
        assert pixels.shape == (468, 331, 3)
        assert pixels.min() < 100


def test_the_picture_canvas_clips_and_restores() -> None:
    canvas = PictureCanvas(72.0, 72.0, 72.0)
    canvas.setFillColor(ACCENT)
    canvas.saveState()
    clip = canvas.beginPath()
    clip.rect(0.0, 0.0, 36.0, 72.0)
    canvas.clipPath(clip, stroke=0, fill=0)
    canvas.setFillColor(INK)
    canvas.rect(0.0, 0.0, 72.0, 36.0, stroke=0, fill=1)
    canvas.restoreState()
    canvas.rect(60.0, 60.0, 12.0, 12.0, stroke=0, fill=1)
    pixels = np.asarray(Image.open(io.BytesIO(canvas.png())))
    colour = [[round(255 * part) for part in (c.red, c.green, c.blue)] for c in (INK, WHITE, ACCENT)]
    assert [pixels[60, 10].tolist(), pixels[60, 60].tolist(), pixels[5, 66].tolist()] == colour
