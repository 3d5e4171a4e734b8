"""What faces should look like: means of the print in linear light, at any resolution, with any correction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import tifffile

from tilefab.colour.drift import no_drift
from tilefab.config import load_job
from tilefab.errors import ProfileError
from tilefab.io.drift_file import DriftFile, drift_text, parse_drift
from tilefab.pipeline import Plan, plan_job, press_tables
from tilefab.pipeline.corrected import corrected_plan
from tilefab.pipeline.faces import render_face
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.maps import JobMaps, job_maps
from tilefab.pipeline.progress import Silent
from tilefab.types import SizePx

JOB = """\
[slab]
scans = ["slab.tif"]
dpi = 60
square = false
lighting = false
[texture]
design = "{design}"
{more}
[tile]
size_mm = [40, 24]
dpi = 60
bleed_mm = 1
count = 50
[colour]
press_profile = "demo_ceramic.icc"
ink_limit_percent = 260
[output]
directory = "out_{design}"
[report]
pdf = false
"""
MORE = {"crops": "crops = 32", "tile": "patches = 20\nactive_per_cell = 9"}


@pytest.fixture(scope="module", autouse=True)
def _small_tables() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(press_tables, "FORWARD_GRIDS", {4: 7})
        patch.setattr(press_tables, "BACKWARD_GRID", 13)
        yield


@pytest.fixture(scope="module", params=["crops", "tile"])
def job(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, JobMaps]:
    folder = tmp_path_factory.mktemp(request.param)
    coarse = np.random.default_rng(1).integers(40, 220, (16, 18, 3)).repeat(7, axis=0).repeat(7, axis=1)
    tifffile.imwrite(folder / "slab.tif", coarse.astype(np.uint8), photometric="rgb")
    path = folder / "job.toml"
    path.write_text(JOB.format(design=request.param, more=MORE[request.param]))
    plan = plan_job(load_job(path))
    return plan, job_maps(plan, Silent(), must_keep=True)


@pytest.fixture(scope="module")
def faces(job: tuple[Plan, JobMaps]) -> PredictedFaces:
    return PredictedFaces(*job)


def test_inks_are_those_of_the_print(job: tuple[Plan, JobMaps], faces: PredictedFaces) -> None:
    plan, maps = job
    print_data = render_face(plan, maps.press, 7, bleed=False)
    assert np.array_equal(np.rint(faces.ink_frac(7, 1) * 255.0), print_data)
    rows, cols = plan.tile_px.rows // 3, plan.tile_px.cols // 3
    means = print_data[: 3 * rows, : 3 * cols].reshape(rows, 3, cols, 3, 4).mean(axis=(1, 3)) / 255.0
    assert faces.ink_frac(7, 3) == pytest.approx(means, abs=1e-6)
    assert faces.grid(3) == SizePx(rows, cols)


def test_colours_are_means_of_light(faces: PredictedFaces) -> None:
    whole = faces.xyz(3, 1)
    rows, cols, _ = faces.xyz(3, 2).shape
    means = whole[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2, 3).mean(axis=(1, 3))
    assert faces.xyz(3, 2) == pytest.approx(means, abs=1e-6)
    assert 0.01 < whole[..., 1].mean() < 0.9


def test_factors_are_never_coarser_than_asked_for(faces: PredictedFaces) -> None:
    for wanted in (0.3, 0.5, 1.0, 1.18, 2.0, 5.0):
        factor = faces.factor(wanted)
        assert factor == 1 or faces.px_per_mm(factor) >= wanted - 1e-6
        assert faces.px_per_mm(factor + 1) < wanted


def test_lightness_follows_the_face(job: tuple[Plan, JobMaps], faces: PredictedFaces) -> None:
    for face in (0, 9):
        shown = faces.lightness(face, 20)
        assert 20 <= max(shown.shape) < 40
        assert shown.shape[1] / shown.shape[0] == pytest.approx(40 / 24, rel=0.1)
        printed = faces.xyz(face, max(1, job[0].tile_px.cols // shown.shape[1]))[..., 1]
        rows, cols = min(printed.shape[0], shown.shape[0]), min(printed.shape[1], shown.shape[1])
        assert np.corrcoef(printed[:rows, :cols].ravel(), shown[:rows, :cols].ravel())[0, 1] > 0.8
    assert not np.array_equal(faces.lightness(0, 20), faces.lightness(9, 20))


def test_a_correction_changes_inks_and_nothing_else(job: tuple[Plan, JobMaps], faces: PredictedFaces) -> None:
    plan, _ = job
    mean = no_drift(4).mean.copy()
    mean[:4] = -0.04  # every ink prints weaker
    state = replace(no_drift(4), mean=mean)
    drift, sha256 = parse_drift(
        drift_text(DriftFile(state, plan.ink_names, plan.press_profile.sha256, 9)).encode(), "x"
    )
    corrected = corrected_plan(plan, drift, sha256)
    assert corrected.job_hash == plan.job_hash
    assert corrected.map_key == plan.map_key
    assert corrected.press_key != plan.press_key
    press = job_maps(corrected, Silent(), must_keep=True).press
    more, usual = faces.ink_frac(4, 1, press), faces.ink_frac(4, 1)
    assert more.mean() > usual.mean() * 1.02
    # Seen through the press as it was profiled, the corrected print is too dark: that is what the drift takes away.
    assert faces.xyz(4, 1, press)[..., 1].mean() < faces.xyz(4, 1)[..., 1].mean()


def test_a_correction_of_another_press_is_refused(job: tuple[Plan, JobMaps]) -> None:
    drift = DriftFile(no_drift(4), job[0].ink_names, "0" * 64, 9)
    with pytest.raises(ProfileError, match="another profile"):
        corrected_plan(job[0], drift, "x")
