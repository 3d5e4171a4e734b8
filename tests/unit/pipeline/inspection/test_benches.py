"""What a run's tiles are inspected with: its own job, its corrections' maps, its press."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
import tifffile

from tests.unit.pipeline.inspection.test_service import CAMERA, LINE
from tilefab.colour.drift import drifted, no_drift
from tilefab.config import load_job
from tilefab.config.line import LineFile, load_line
from tilefab.control.drift_control import expected
from tilefab.control.drift_control_state import ControlSettings
from tilefab.control.drift_events import Propose
from tilefab.errors import ConfigError, ProfileError, TilefabError
from tilefab.inspection.measurement import RegionColours
from tilefab.inspection.records import Grade, Recognition, TileInspection
from tilefab.io.cgats import read_measurements
from tilefab.io.cgats_write import measurements_text
from tilefab.io.drift_file import DriftFile, drift_text, parse_drift
from tilefab.io.journal import CorrectionRecord, RunFacts, RunRecord
from tilefab.pipeline import Plan, plan_job, press_tables
from tilefab.pipeline.inspection.benches import OPEN_AT_ONCE, Bench, Benches, RunBench, WhenPrinted
from tilefab.pipeline.inspection.one_tile import AS_THE_JOB_SAYS, InspectedTile
from tilefab.pipeline.maps import job_maps
from tilefab.pipeline.profiling import ProfileSettings, build_profile
from tilefab.pipeline.progress import Silent
from tilefab.types import Array

JOB = """\
[slab]
scans = ["slab.tif"]
dpi = 60
square = false
lighting = false
[texture]
crops = 32
[tile]
size_mm = [40, 24]
dpi = 60
count = 50
[colour]
press_profile = "press.icc"
ink_limit_percent = 260
[output]
directory = "out"
[report]
pdf = false
"""
CHART = Path(__file__).parents[4] / "profiles/demo_ceramic.ti3"
NOW = datetime(2026, 11, 24, 12, 0, tzinfo=UTC)
WHEN = WhenPrinted(arm_id=5, correction=3_000_000, fired_s=100.0, measured_s=110.0)


@pytest.fixture(scope="module", autouse=True)
def _small_tables() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(press_tables, "FORWARD_GRIDS", {4: 7})
        patch.setattr(press_tables, "BACKWARD_GRID", 13)
        yield


@pytest.fixture(scope="module")
def line_file(tmp_path_factory: pytest.TempPathFactory) -> LineFile:
    path = tmp_path_factory.mktemp("line") / "line.toml"
    path.write_text(LINE + CAMERA)
    return load_line(path)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    folder = tmp_path_factory.mktemp("job")
    coarse = np.random.default_rng(1).integers(40, 220, (16, 18, 3)).repeat(7, axis=0).repeat(7, axis=1)
    tifffile.imwrite(folder / "slab.tif", coarse.astype(np.uint8), photometric="rgb")
    (folder / "job.toml").write_text(JOB)
    # Of part of the demo's chart: fitted in a second.
    whole = read_measurements(CHART)
    rows = sorted({*range(0, 800, 9), *np.flatnonzero(np.isin(whole.ink_frac.sum(axis=1), (0.0, 1.0)))})
    chart = measurements_text(
        whole.ink_frac[rows], whole.lab_d50[rows], ink_names=whole.ink_names, description="chart", created="2026-11-24"
    )
    (folder / "chart.ti3").write_text(chart)
    build_profile(folder / "chart.ti3", folder / "press.icc", ProfileSettings(forward_grid=5, backward_grid=9))
    plan = plan_job(load_job(folder / "job.toml"))
    job_maps(plan, Silent(), must_keep=True)
    return plan


def run_of(plan: Plan, run_id: int = 3) -> RunRecord:
    facts = RunFacts(plan.job_hash, plan.name, str(plan.job_file.path), 50, plan.seed, "ab")
    return RunRecord(run_id, facts, NOW, None)


@pytest.fixture(scope="module")
def bench(plan: Plan, line_file: LineFile) -> RunBench:
    return RunBench(run_of(plan), line_file)


def correction(plan: Plan, mean: Array, number: int = 1) -> CorrectionRecord:
    state = replace(no_drift(4), mean=mean)
    drift = drift_text(DriftFile(state, plan.press_profile.ink_names, plan.press_profile.sha256, 9, "why"))
    return CorrectionRecord(3, number, "key", drift, "why", NOW)


def tile_of(printed: RegionColours | None) -> InspectedTile:
    seen = Recognition(1, 0, (), 1.0, 0.9, 0.1, 1.0, None, "")
    return InspectedTile(TileInspection(seen, None, None, (), Grade.FIRST, ()), printed=printed)


def regions(inks: Array, fired: Array, predicted: Array) -> RegionColours:
    many = len(inks)
    zeros = np.zeros((many, 2))
    return RegionColours(
        at_mm=zeros,
        ink_frac=inks,
        fired_lab=fired,
        predicted_lab=predicted,
        noise_lab=np.full(many, 0.5),
        share=np.ones(many),
        place=zeros.astype(np.int64),
        grid=(1, many),
        region_mm=4.0,
    )


def inks_of_a_stone() -> Array:
    """Regions of a tile: one ramp of tones, and a little of all colours."""
    random = np.random.default_rng(2)
    ramp = random.uniform(0.1, 1.0, (300, 1)) * np.array([0.4, 0.25, 0.35, 0.2])
    return np.clip(ramp + random.normal(0.0, 0.02, (300, 4)), 0.0, 1.0)


def test_what_grain_does_to_means_is_no_drift(bench: RunBench) -> None:
    """A region's colour is the mean of its pixels', which isn't the colour of its mean ink."""
    inks = inks_of_a_stone()
    of_mean = bench._model.lab(inks)
    predicted = of_mean + np.array([3.0, -0.3, -0.4])
    control = bench.start(0.0, ControlSettings())
    found = bench.measured(tile_of(regions(inks, predicted, predicted)), control, WHEN)
    assert found is not None
    assert (found.tile, found.correction, found.fired_at_s, found.measured_at_s) == (5, 3_000_000, 100.0, 110.0)
    known = np.linalg.inv(no_drift(4).covariance)
    change = np.linalg.solve(found.information + known, found.vector)
    assert np.sqrt(change @ found.effect @ change) < 0.03


def test_a_drift_is_seen_in_what_the_inks_of_the_tile_fire_to(bench: RunBench) -> None:
    state = no_drift(4)
    moved = replace(
        state, mean=state.mean + 0.3 * state.spread() * np.random.default_rng(3).normal(size=len(state.mean))
    )
    inks = inks_of_a_stone()
    model = bench._model
    assert model is not None
    predicted = model.lab(inks) + np.array([2.0, 0.0, 0.5])
    fired = predicted + drifted(model, moved).lab(inks) - model.lab(inks)
    control = bench.start(0.0, ControlSettings())
    found = bench.measured(tile_of(regions(inks, fired, predicted)), control, WHEN)
    assert found is not None
    known = np.linalg.inv(state.covariance)
    learnt = found.at + np.linalg.solve(found.information + known, found.vector - known @ found.at)
    seen = replace(state, mean=learnt)
    off = np.linalg.norm(drifted(model, seen).lab(inks) - drifted(model, moved).lab(inks), axis=1).mean()
    before = np.linalg.norm(model.lab(inks) - drifted(model, moved).lab(inks), axis=1).mean()
    assert off < 0.4 * before


def test_a_tile_without_regions_says_nothing(bench: RunBench) -> None:
    control = bench.start(0.0, ControlSettings())
    assert bench.measured(tile_of(None), control, WHEN) is None
    none = np.empty((0, 3))
    assert bench.measured(tile_of(regions(np.empty((0, 4)), none, none)), control, WHEN) is None


def test_a_proposal_becomes_a_drift_file_of_this_press(bench: RunBench, plan: Plan) -> None:
    mean = np.linspace(-0.02, 0.02, len(no_drift(4).mean))
    # As sums of floating-point numbers leave it: not quite the same on both sides of the diagonal.
    covariance = no_drift(4).covariance
    covariance[0, 1] += 1e-18
    text = bench.drift(Propose(mean, covariance, 1.0, "drift"), 12, "run 3: drift")
    found, _ = parse_drift(json.dumps(json.loads(text)).encode(), "x")
    assert np.array_equal(found.state.mean, mean)
    assert (found.profile_sha256, found.ink_names) == (plan.press_profile.sha256, plan.press_profile.ink_names)
    assert (found.patches, found.note) == (12, "run 3: drift")
    assert bench.press == plan.press_profile.sha256
    record = CorrectionRecord(3, 1, "key", text, "why", NOW)
    assert np.array_equal(bench.state(record), mean)
    with pytest.raises(ProfileError):
        bench.state(replace(record, drift="{}"))


def test_a_controller_begins_with_the_jobs_own_drift(bench: RunBench) -> None:
    control = bench.start(50.0, ControlSettings())
    assert np.array_equal(bench.begun, np.zeros_like(bench.begun))
    assert np.array_equal(expected(control, 0), bench.begun)


def test_maps_of_corrections_are_made_if_they_are_gone_and_kept(bench: RunBench, plan: Plan) -> None:
    assert bench._printed_with(None) is AS_THE_JOB_SAYS
    made = correction(plan, np.full(len(no_drift(4).mean), 0.03))
    found = bench._printed_with(made)
    assert found.number == 1
    assert found.press is not None
    own = job_maps(plan, Silent()).press
    assert found.press.base.shape == own.base.shape
    assert not np.array_equal(found.press.base, own.base)
    assert bench._printed_with(made) is found


def test_a_job_that_has_changed_isnt_what_was_printed(plan: Plan, line_file: LineFile) -> None:
    run = run_of(plan)
    with pytest.raises(ConfigError, match="has changed since the run began"):
        RunBench(replace(run, facts=replace(run.facts, job_hash="other")), line_file)
    with pytest.raises(ConfigError):
        RunBench(replace(run, facts=replace(run.facts, job_file="/nowhere/job.toml")), line_file)


def test_benches_are_opened_once_and_the_oldest_are_closed(bench: RunBench, plan: Plan) -> None:
    opened: list[int] = []

    def open_bench(run: RunRecord) -> Bench:
        opened.append(run.run_id)
        return bench

    benches = Benches(open_bench)
    for run_id in (1, 2, 1, 3, 1, 4, 1, 2):
        assert benches.of(run_of(plan, run_id), 0.0) is bench
    assert opened == [1, 2, 3, 4, 2]
    assert OPEN_AT_ONCE == 3
    assert [benches.opened(run_id) is not None for run_id in (1, 2, 3, 4)] == [True, True, False, True]


def test_a_bench_that_cant_be_opened_is_tried_again_after_a_minute(bench: RunBench, plan: Plan) -> None:
    broken = True

    def open_bench(run: RunRecord) -> Bench:
        if broken:
            raise TilefabError("no such file")
        return bench

    benches = Benches(open_bench)
    assert benches.of(run_of(plan), 0.0) is None
    assert dict(benches.failures) == {3: "no such file"}
    broken = False
    assert benches.of(run_of(plan), 59.0) is None
    assert benches.of(run_of(plan), 60.0) is bench
    assert dict(benches.failures) == {}
