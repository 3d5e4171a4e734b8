"""Slabs grown before crops are taken, and tiles grown by any method: jobs that say so, and jobs that don't."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from tilefab.colour import srgb_from_xyz, xyz_from_lab
from tilefab.config import load_job
from tilefab.errors import ConfigError, SynthesisError
from tilefab.pipeline import Plan, growing_slab, maps, plan, plan_job
from tilefab.pipeline.growing_slab import grow_slab
from tilefab.pipeline.maps import build_map, texture_map
from tilefab.pipeline.prepare import prepare_slab
from tilefab.pipeline.progress import Silent
from tilefab.sampling import CropMap, SlabArea, TileMap
from tilefab.synthesis import METHODS, Step, SynthesisRequest, SynthesisResult
from tilefab.types import SizePx

JOB = """\
[slab]
scans = ["slab.tif"]
dpi = 60
square = false
lighting = false
[texture]
crops = 16
seed = 7
[tile]
size_mm = [20, 24]
dpi = 60
[colour]
press_profile = "demo_ceramic.icc"
[output]
directory = "out"
"""
GROWN = ("seed = 7", 'seed = 7\ngrow = "quilting"\ngrown_size_mm = [60, 50]')
SIZE = SizePx(118, 142)  # of 60 x 50 mm at 60 dpi
TILE = ("crops = 16", 'design = "tile"\nmap_size_mm = [30, 34]\npatches = 8\nactive_per_cell = 3')


@pytest.fixture
def planned(
    tmp_path: Path, stone: Callable[..., NDArray[np.float32]], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Plan]:
    """Plan of the job, with changes; its scan counts as always the same."""
    rgb = np.clip(srgb_from_xyz(xyz_from_lab(stone(72, 90, 3))), 0, 1)
    tifffile.imwrite(tmp_path / "slab.tif", np.rint(rgb * 65535).astype(np.uint16), photometric="rgb")
    monkeypatch.setattr(plan, "_file_hash", lambda _: "0" * 64)

    def make(*changes: tuple[str, str]) -> Plan:
        text = JOB
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "job.toml").write_text(text)
        return plan_job(load_job(tmp_path / "job.toml"))

    return make


def test_jobs_that_grow_nothing_keep_their_keys(planned: Callable[..., Plan]) -> None:
    for changes, build_key, map_key in (
        ((), "951cbc4444b633ee", "4a96ffabdaacc9a1"),
        ((TILE,), "e23d5b4b30b57530", "2f9a9af619c23d7f"),
    ):
        job = planned(*changes)
        assert (job.build_key[:16], job.map_key[:16]) == (build_key, map_key)


def test_how_a_slab_is_grown_is_part_of_the_keys(planned: Callable[..., Plan]) -> None:
    jobs = [
        planned(),
        planned(GROWN),
        planned(GROWN, ("[60, 50]", "[60, 51]")),
        planned(("seed = 7", 'seed = 7\ngrow = "quilting"')),
    ]
    for key in ("build_key", "map_key", "job_hash"):
        assert len({getattr(job, key) for job in jobs}) == len(jobs)
    assert len({job.slab_key for job in jobs}) == 1


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ([("seed = 7", "seed = 7\ngrown_size_mm = [60, 50]")], r"texture\.grown_size_mm.*say how with grow"),
        ([("seed = 7", 'seed = 7\ngrow = "magic"')], "texture.grow.*quilting"),
        ([TILE, ("seed = 7", 'seed = 7\ngrow = "quilting"')], r'texture\.grow.*design = "crops" only'),
        ([TILE, ("seed = 7", 'seed = 7\nmethod = "magic"')], "texture.method.*quilting"),
    ],
)
def test_wrong_settings_are_explained(planned: Callable[..., Plan], changes: list[tuple[str, str]], match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        planned(*changes)


def test_a_grown_slab_is_exact_copies_of_the_prepared_one(planned: Callable[..., Plan]) -> None:
    job = planned(GROWN)
    slab = prepare_slab(job, Silent())
    weights = np.zeros(slab.valid.shape, dtype=np.uint8)
    weights[20:30, 20:30] = 200
    slab = replace(slab, weights=weights)
    grown = grow_slab(job, slab, Silent(), 1)
    request = SynthesisRequest(slab.lab_d50, slab.valid, SIZE, 7, toroidal=False, weights=weights)
    source = METHODS["quilting"](request).source
    assert_array_equal(grown.lab16, slab.lab16.reshape(-1, 3)[source])
    assert grown.weights is not None
    assert_array_equal(grown.weights, weights.ravel()[source])
    assert grown.valid.all()
    assert grown.slabs == (SlabArea("slab.tif, grown", 0, 0, SIZE.rows, SIZE.cols),)
    assert grown.log[:-1] == slab.log
    step, summary = grown.log[-1]
    assert step == "Growing"
    assert summary.startswith(f"from 90 x 72 to {SIZE.cols} x {SIZE.rows} pixels by quilting; ")


def test_without_a_size_it_is_twice_the_slab(planned: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch) -> None:
    job = planned(("seed = 7", 'seed = 7\ngrow = "quilting"'))
    slab = prepare_slab(job, Silent())
    assert grow_slab(job, slab, Silent(), 1).valid.shape == (144, 180)
    monkeypatch.setattr(growing_slab, "_LARGEST_DEFAULT_PX", 80)
    assert grow_slab(job, slab, Silent(), 1).valid.shape == (80, 90)


def test_a_slab_that_shrinks_is_warned_of(planned: Callable[..., Plan]) -> None:
    for size, warned in (("[20, 18]", True), ("[60, 50]", False)):
        job = planned(GROWN, ("[60, 50]", size))
        warnings = grow_slab(job, prepare_slab(job, Silent()), Silent(), 1).warnings
        assert (
            any("smaller than the slab itself (from 90 x 72 to 47 x 43 pixels" in text for text in warnings) == warned
        )
        assert any("smaller than the slab itself" in text for text in warnings) == warned


@pytest.mark.parametrize("size", ["[6, 50]", "[50, 6]", "[50, 20000]"])
def test_a_size_that_cannot_be_had_is_refused(planned: Callable[..., Plan], size: str) -> None:
    job = planned(GROWN, ("[60, 50]", size))
    with pytest.raises(SynthesisError, match=r"grown_size_mm.*16 to 32,768"):
        build_map(job, Silent())


def test_a_slab_that_cannot_be_grown_is_explained(
    planned: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(request: SynthesisRequest, watch: object = None) -> SynthesisResult:
        raise ValueError("too plain")

    monkeypatch.setattr("tilefab.pipeline.growing_slab.METHODS", {"quilting": refuse})
    with pytest.raises(SynthesisError, match="can't be grown by quilting at 60 dpi: too plain; use a larger scan"):
        build_map(planned(GROWN), Silent())


class Watching(Silent):
    """Keeps the stages that it is told of."""

    def __init__(self) -> None:
        super().__init__()
        self.stages: dict[str, list[float]] = {}

    def stage(self, name: str, share: float) -> None:
        self.stages.setdefault(name, []).append(share)


def test_crops_are_taken_from_the_grown_slab(planned: Callable[..., Plan]) -> None:
    job, watching = planned(GROWN), Watching()
    built = texture_map(job, watching, 1, must_keep=True)
    assert isinstance(built, CropMap)
    slab = prepare_slab(job, Silent())
    grown = grow_slab(job, slab, Silent(), 2)
    assert_array_equal(built.base[: SIZE.rows, : SIZE.cols], grown.lab16)
    assert ["Growing", grown.log[-1][1]] in json.loads(built.provenance["preparation"])
    shares = watching.stages["Growing the slab"]
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert shares == sorted(shares)
    # Found again, not built again.
    again = Watching()
    assert texture_map(job, again, 1).hash == built.hash
    assert again.stages == {}
    # Were it lost, the slab needn't be grown anew; the same map comes of it.
    folder = job.output / "maps"
    maps.texture_map_path(job).unlink()
    assert texture_map(job, again, 1, must_keep=True).hash == built.hash
    assert "Growing the slab" not in again.stages
    assert "The slab that an earlier build has grown is used" in again.notes
    maps.texture_map_path(job).unlink()
    growing_slab.grown_path(job, folder).write_bytes(b"rubbish")
    assert texture_map(job, again, 1, must_keep=True).hash == built.hash
    assert "Growing the slab" in again.stages
    assert any("The slab is grown anew" in note for note in again.notes)


def test_a_tile_can_be_grown_by_any_method(planned: Callable[..., Plan], monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[SynthesisRequest] = []

    def strange(request: SynthesisRequest, watch: Callable[[Step], bool] | None = None) -> SynthesisResult:
        asked.append(request)
        assert watch is not None
        assert watch(Step(0.5))
        source = np.arange(request.size.rows * request.size.cols, dtype=np.int32).reshape(
            request.size.rows, request.size.cols
        )
        return SynthesisResult(source % (request.valid.size), notes=("It is strange",))

    monkeypatch.setattr("tilefab.pipeline.tiles.METHODS", {"quilting": strange})
    job = planned(TILE, ("seed = 7", 'seed = 7\nmethod = "quilting"\nfeature_mm = 8'))
    built = build_map(job, Silent(), 1)
    assert isinstance(built, TileMap)
    assert_array_equal(built.tile[0, :5], built.base[0, :5])
    (request,) = asked
    assert request.toroidal
    assert (request.seed, request.feature_px, request.threads) == (7, 19, 1)
    assert (request.size.rows, request.size.cols) == (80, 71)
    assert "It is strange" in json.loads(built.provenance["warnings"])
    assert built.provenance["method"] == "quilting"


@pytest.mark.parametrize("design", [(), (TILE,)])
def test_without_growing_the_slab_itself_is_used(
    planned: Callable[..., Plan], design: tuple[tuple[str, str], ...]
) -> None:
    job, watching = planned(*design), Watching()
    built = build_map(job, watching, 1)
    assert "Growing the slab" not in watching.stages
    assert_array_equal(built.base[:72, :90], prepare_slab(job, Silent()).lab16)
