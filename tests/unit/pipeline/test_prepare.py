"""From scans to a clean slab: what a job asks for is done, weights come along, threads don't show."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.config import load_job
from tilefab.pipeline.plan import Plan, plan_job, shipped_profiles
from tilefab.pipeline.prepare import PreparedSlab, prepare_slab
from tilefab.pipeline.progress import Silent

DPI = 100
ROWS, COLS = 260, 320
JOB = """\
[slab]
{slab}
[tile]
size_mm = [20, 20]
dpi = {dpi}
count = 1
[colour]
press_profile = "demo_ceramic.icc"
ink_limit_percent = 260
[output]
directory = "out"
"""


def stone(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(60, 220, (ROWS, COLS, 3)).astype(np.uint8)


def on_a_bed() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Grey slab lying askew on a black bed, a pale disc on it, and weights that mark the disc."""
    row, col = np.indices((ROWS, COLS)) + 0.5
    cos, sin = np.cos(np.radians(1.5)), np.sin(np.radians(1.5))
    x, y = cos * (col - 160) + sin * (row - 130), cos * (row - 130) - sin * (col - 160)
    disc = np.hypot(x + 50, y - 20) < 14
    level = 120 + np.random.default_rng(0).normal(0, 5, row.shape) + 90 * disc
    inside = np.clip(np.minimum(130 - np.abs(x), 100 - np.abs(y)) + 0.5, 0, 1)
    pixels = np.rint(np.clip(10 + inside * (level - 10), 0, 255)).astype(np.uint8)
    return np.repeat(pixels[..., None], 3, axis=2), (255 * disc).astype(np.uint8)


class Jobs:
    """Writes scans and job files into a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copy(shipped_profiles() / "demo_ceramic.icc", folder)

    def image(self, name: str, pixels: NDArray[np.uint8]) -> Path:
        path = self.folder / name
        kind = "rgb" if pixels.ndim == 3 else "minisblack"
        tifffile.imwrite(path, pixels, photometric=kind, resolution=(DPI, DPI), resolutionunit="INCH")
        return path

    def plan(self, slab: str, dpi: int = DPI) -> Plan:
        (self.folder / "job.toml").write_text(JOB.format(slab=slab, dpi=dpi))
        return plan_job(load_job(self.folder / "job.toml"))


@pytest.fixture
def jobs(tmp_path: Path) -> Jobs:
    return Jobs(tmp_path)


def with_weights(plan: Plan, *paths: Path | None) -> Plan:
    return replace(plan, scans=tuple(replace(scan, weights=path) for scan, path in zip(plan.scans, paths, strict=True)))


def prepared(plan: Plan, threads: int | None = None) -> PreparedSlab:
    return prepare_slab(plan, Silent(), threads)


def test_a_clean_scan_is_only_brought_to_the_working_space(jobs: Jobs) -> None:
    pixels = stone(1)
    jobs.image("a.tif", pixels)
    slab = prepared(jobs.plan('scans = ["a.tif"]\nsquare = false\nlighting = false'))
    assert_array_equal(slab.lab16, encode_lab16(lab_from_xyz(scan_to_xyz(pixels, None)).astype(np.float32)))
    assert_array_equal(slab.lab_d50, decode_lab16(slab.lab16))
    assert slab.valid.all()
    assert slab.weights is None
    assert slab.warnings == ()
    assert [(area.base_row, area.base_col, area.rows, area.cols) for area in slab.slabs] == [(0, 0, ROWS, COLS)]


@pytest.mark.parametrize("dpi", [DPI, 80, 120])
def test_threads_don_t_show(jobs: Jobs, dpi: int) -> None:
    jobs.image("a.tif", on_a_bed()[0])
    jobs.image("b.tif", stone(2))
    mark = jobs.image("mark.tif", on_a_bed()[1])
    plan = with_weights(jobs.plan('scans = ["a.tif", "b.tif"]\ntrim_mm = 1', dpi), mark, None)
    one, three = prepared(plan, 1), prepared(plan, 3)
    assert_array_equal(one.lab16, three.lab16)
    assert_array_equal(one.valid, three.valid)
    assert one.weights is not None
    assert three.weights is not None
    assert_array_equal(one.weights, three.weights)
    assert (one.log, one.slabs) == (three.log, three.slabs)


@pytest.mark.parametrize("dpi", [DPI, 70, 130])
@pytest.mark.parametrize("square", ["true", "false"])
def test_weights_stay_on_what_they_mark(jobs: Jobs, dpi: int, square: str) -> None:
    pixels, marked = on_a_bed()
    jobs.image("a.tif", pixels)
    mark = jobs.image("mark.tif", marked)
    slab = prepared(with_weights(jobs.plan(f'scans = ["a.tif"]\nsquare = {square}\ntrim_mm = 1', dpi), mark))
    assert slab.weights is not None
    assert slab.weights.shape == slab.valid.shape
    pale = slab.lab_d50[..., 0] > 68
    assert slab.weights[pale].mean() > 230
    assert slab.weights[~pale].mean() < 3
    squared = [sentence for step, sentence in slab.log if step == "Squaring"]
    assert [("turned upright" in sentence) for sentence in squared] == ([True] if square == "true" else [])
    assert any(step == "Weights" for step, _ in slab.log)


def test_weights_of_one_slab_of_several(jobs: Jobs) -> None:
    jobs.image("a.tif", stone(3))
    jobs.image("b.tif", stone(4))
    mark = jobs.image("mark.tif", np.full((ROWS, COLS), 90, np.uint8))
    slab = prepared(with_weights(jobs.plan('scans = ["a.tif", "b.tif"]\nsquare = false'), None, mark))
    assert slab.weights is not None
    area = slab.slabs[1]
    part = slab.weights[area.base_row : area.base_row + area.rows, area.base_col : area.base_col + area.cols]
    assert (part == 90).all()
    assert np.count_nonzero(slab.weights) == part.size
