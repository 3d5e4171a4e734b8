"""Maps of crops from end to end: chosen from by hand, built again in a moment, interrupted, reviewed and traced."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from tilefab.io import load_texture_map
from tilefab.pipeline.run_report import job_warnings
from tilefab.sampling import CropMap, TileMap, render
from tilefab.sampling.crop_plan import plan_region


def build(workshop: Any, *changes: tuple[str, str], out: Path | None = None) -> tuple[CropMap, str, list[str]]:
    """Build a job's map: the map, what was said meanwhile, and the warnings."""
    more = ["--out", out] if out else []
    done = workshop.cli("map", "build", workshop.job(*changes), "--json", *more)
    assert done.code == 0, done.err
    loaded = load_texture_map(done.json["file"])
    assert isinstance(loaded, CropMap)
    return loaded, done.err, done.json["warnings"]


def shown(texture: CropMap) -> set[int]:
    """Crops on a large piece of the plane."""
    side = 40 * texture.pitch_px
    return set(plan_region(texture, 0, 0, side, side, seed=7).crops.ravel().tolist())


def test_dropped_crops_are_gone_and_nothing_is_joined_again(workshop: Any, tmp_path: Path) -> None:
    first, said, _ = build(workshop)
    assert "joining costs of the map built before" not in said
    dropped = sorted(shown(first))[:6]
    change = ("crops = 64", f"crops = 64\ndrop = {dropped}")
    again, said, _ = build(workshop, change)
    assert "The crops and joining costs of the map built before are used" in said
    assert "Preparing the slab" not in said
    assert not shown(again) & set(dropped)
    # The short way leads to the same map as the long one.
    fresh, said, _ = build(workshop, change, out=tmp_path / "fresh")
    assert "Preparing the slab" in said
    assert fresh.hash == again.hash
    # And back.
    back, _, _ = build(workshop)
    assert back.hash == first.hash


def test_only_kept_crops_are_shown(workshop: Any) -> None:
    keep = [1, 4, 9, 16, 25, 36]
    texture, _, _ = build(workshop, ("crops = 64", f"crops = 64\nkeep = {keep}\ndrop = [9]"))
    assert shown(texture) == set(keep) - {9}


def test_dropping_what_isn_t_there_is_told_before_any_work(workshop: Any) -> None:
    done = workshop.cli("map", "build", workshop.job(("crops = 64", "crops = 64\ndrop = [64]")))
    assert done.code == 3
    assert "there is no crop 64" in done.errors[0]


def test_crops_that_show_little_of_the_stone_are_told(workshop: Any) -> None:
    texture, _, _ = build(workshop, ("crops = 64", "crops = 64\nkeep = [3]"))
    warnings = " ".join(job_warnings(texture))
    assert "1 different crops only" in warnings
    assert "of the usable stone: the rest is never printed" in warnings
    texture, _, _ = build(workshop)
    assert "different crops only" not in " ".join(job_warnings(texture))


def interrupted(*_: Any, **__: Any) -> None:
    raise KeyboardInterrupt


def test_an_interrupted_build_needn_t_prepare_the_slab_again(
    workshop: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from tilefab.pipeline import crops as module

    with monkeypatch.context() as patched:
        patched.setattr(module, "build_crop_map", interrupted)
        assert workshop.cli("map", "build", workshop.job()).code == 130
    (slab,) = workshop.out.glob("maps/*")
    assert slab.name.endswith(".slab.npz")
    texture, said, _ = build(workshop)
    assert "The slab that an interrupted build has prepared is used" in said
    assert "Preparing the slab" not in said
    assert not slab.exists()
    assert texture.hash == build(workshop, out=tmp_path / "fresh")[0].hash


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty"])
def test_a_damaged_slab_is_prepared_anew(workshop: Any, monkeypatch: pytest.MonkeyPatch, damage: str) -> None:
    from tilefab.pipeline import crops as module

    with monkeypatch.context() as patched:
        patched.setattr(module, "build_crop_map", interrupted)
        workshop.cli("map", "build", workshop.job())
    (slab,) = workshop.out.glob("maps/*")
    whole = slab.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1
    slab.write_bytes({"cut": whole[:-300], "flipped": bytes(flipped), "empty": b""}[damage])
    _, said, _ = build(workshop)
    assert "the slab is prepared anew" in said
    assert "Preparing the slab" in said


def test_a_flat_stone_works_with_a_warning(workshop: Any, scanner: Any) -> None:
    scanner(workshop.folder / "slab.tif", np.full((100, 110, 3), 150, np.uint8))
    texture, _, warnings = build(workshop)
    assert any("no texture at all" in warning for warning in warnings)
    assert len(np.unique(render(texture, 0, 0, 90, 90, seed=7).reshape(-1, 3), axis=0)) == 1
    assert workshop.cli("run", workshop.folder / "job.toml", "--faces", "0:1").code == 0


def test_a_hard_border_works(workshop: Any, scanner: Any) -> None:
    pixels = np.full((100, 110, 3), 30, np.uint8)
    pixels[:, 55:] = 220
    scanner(workshop.folder / "slab.tif", pixels)
    done = workshop.cli("run", workshop.folder / "job.toml", "--faces", "0:2", "--json")
    assert done.code == 0, done.err
    assert len(set(workshop.hashes().values())) == 2


def test_weights_become_part_of_the_guide(workshop: Any) -> None:
    weights = np.zeros((100, 110), np.uint8)
    weights[40:60, 30:50] = 255
    tifffile.imwrite(workshop.folder / "weights.tif", weights)
    without, _, _ = build(workshop)
    texture, _, _ = build(workshop, ("square = false", 'square = false\nweights = ["weights.tif"]'))
    assert (without.guide.shape[2], texture.guide.shape[2]) == (3, 4)
    assert texture.guide[50, 40, 3] == 255
    assert texture.guide[5, 5, 3] == 0


@pytest.mark.parametrize("layout", ["scatter", "continuous"])
def test_a_reduced_wall_looks_like_the_whole_one_reduced(workshop: Any, layout: str) -> None:
    from tilefab.colour import reduce_srgb
    from tilefab.config import load_job
    from tilefab.pipeline import plan_job
    from tilefab.pipeline.faces import render_face
    from tilefab.pipeline.maps import job_maps, proof_map
    from tilefab.pipeline.progress import Silent
    from tilefab.pipeline.wall import render_wall

    more = '\nlayout = "continuous"\ncolumns = 4' if layout == "continuous" else ""
    job = workshop.job(("dpi = 60\ncount = 8", "dpi = 120\ncount = 8" + more), ("crops = 64", "feature_mm = 25"))
    plan = plan_job(load_job(job))
    proof = proof_map(plan, job_maps(plan, Silent()).press)
    assert isinstance(proof, CropMap)
    assert proof.coarsest_level >= 1
    small = render_wall(plan, proof, 2, 4, largest_side_px=75, grout_mm=0)
    assert small.shape == (2 * 18, 4 * 15, 3)
    faces = [reduce_srgb(render_face(plan, proof, index, bleed=False), 6) for index in range(8)]
    whole = np.concatenate([np.concatenate(faces[:4], axis=1), np.concatenate(faces[4:], axis=1)]).astype(int)
    difference = np.abs(whole - small).mean()
    assert difference < 0.5 * min(np.abs(whole - np.roll(small, 1, axis=axis)).mean() for axis in (0, 1))


# --- sheets


@pytest.mark.parametrize("design", ["crops", "tile"])
def test_a_sheet_shows_every_piece(workshop: Any, tile_design: tuple[str, str], design: str) -> None:
    job = workshop.job(*([tile_design] if design == "tile" else []))
    sheet = workshop.folder / "sheet.html"
    done = workshop.cli("map", "review", job, "-o", sheet, "--json")
    assert done.code == 0, done.err
    assert (done.json["file"], done.json["design"]) == (str(sheet), design)
    text = sheet.read_text()
    assert not re.findall(r'(?:src|href)="(?!data:image/jpeg;base64,)', text)
    if design == "crops":
        assert {int(n) for n in re.findall(r"<b>crop (\d+)</b>", text)} == set(range(64))
        assert text.count("<b>cost ") == 24
        costs = [float(cost) for cost in re.findall(r"joins (\d+\.\d)", text)]
        assert costs == sorted(costs, reverse=True)
        assert "drop = " in text
    else:
        assert text.count("<b>patch ") == 40
        assert "the tile" in text
    picture = workshop.folder / "sheet.png"
    done = workshop.cli("map", "review", job, "-o", picture)
    assert done.code == 0, done.err
    with Image.open(picture) as image:
        assert image.size[0] >= 1800


def test_a_sheet_marks_what_is_dropped(workshop: Any) -> None:
    job = workshop.job(("crops = 64", "crops = 64\ndrop = [5]"), ('"Workshop"', '"<b>&amp;"'))
    sheet = workshop.folder / "sheet.html"
    assert workshop.cli("map", "review", job, "-o", sheet).code == 0
    text = sheet.read_text()
    assert len(re.findall(r"<b>crop 5</b><br>0 uses<br>joins -<br>(?:takes turns<br>)?dropped<", text)) == 1
    assert "&lt;b&gt;&amp;amp;" in text


def test_a_sheet_replaces_nothing_of_the_job(finished: Any, snap: Callable[[Path], Any]) -> None:
    before = snap(finished.folder)
    job = finished.folder / "job.toml"
    for path in (finished.folder / "sheet.pdf", finished.folder / "sheet", finished.out / "maps" / "a.html"):
        done = finished.cli("map", "review", job, "-o", path)
        assert done.code == 8, done.err
    assert snap(finished.folder) == before


# --- tracing


@pytest.mark.parametrize("design", ["crops", "tile"])
def test_a_point_is_traced_to_the_stone(workshop: Any, tile_design: tuple[str, str], design: str) -> None:
    job = workshop.job(*([tile_design] if design == "tile" else []))
    assert workshop.cli("run", job, "--faces", "0:3").code == 0
    (path,) = workshop.out.glob("maps/*.press.tfmap")
    press = load_texture_map(path)
    assert isinstance(press, CropMap if design == "crops" else TileMap)
    face = tifffile.imread(workshop.out / "faces" / "face_000002.tif")
    for x, y in ((0, 0), (46, 56), (20, 33), (-2, -2)):
        done = workshop.cli("map", "trace", job, "--face", 2, f"--px={x},{y}", "--json")
        assert done.code == 0, done.err
        found = done.json
        assert (found["face"], found["face_px"], found["slab"]["name"]) == (2, [x, y], "slab.tif")
        col, row = found["base_px"]
        assert face[y + 2, x + 2].tolist() == press.base[row, col].tolist()
        assert found["slab_px"] == [col, row]
        assert found["slab_mm"] == [round((k + 0.5) * 25.4 / 60, 2) for k in (col, row)]
        assert (found["crop"] is not None) == (design == "crops")
    told = workshop.cli("map", "trace", job, "--face", 2, "--at", "3.5,10").out
    assert told.startswith("slab.tif: ")
    by_mm = workshop.cli("map", "trace", job, "--face", 2, "--at", "3.5,10", "--json").json
    assert by_mm["face_px"] == [8, 23]


def test_the_crop_of_a_point_can_be_dropped(workshop: Any) -> None:
    job = workshop.job()
    found = workshop.cli("map", "trace", job, "--face", 0, "--px", "9,9", "--json").json
    texture, _, _ = build(workshop, ("crops = 64", f"crops = 64\ndrop = [{found['crop']}]"))
    assert found["crop"] not in shown(texture)


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--at", "1,2", "--px", "1,2"],
        ["--at", "1"],
        ["--at", "1,2,3"],
        ["--at", "a,b"],
        ["--at", "nan,1"],
        ["--at", "20.9,1"],
        ["--px", "1.5,2"],
        ["--px", "60,2"],
        ["--px=-3,0"],
    ],
)
def test_a_point_that_is_none_is_refused(finished: Any, options: list[str]) -> None:
    done = finished.cli("map", "trace", finished.folder / "job.toml", "--face", 0, *options)
    assert done.code == 2, (done.out, done.err)
    assert "Invalid value" in done.err


def test_a_job_of_a_tile_runs_and_reports(workshop: Any, tile_design: tuple[str, str]) -> None:
    job = workshop.job(tile_design, ("pdf = false", 'pdf = "report.pdf"'))
    done = workshop.cli("run", job, "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], len(set(workshop.hashes().values()))) == (8, 8)
    assert (workshop.out / "report.pdf").read_bytes().startswith(b"%PDF-")
    facts = workshop.cli("map", "build", job, "--json").json
    assert (facts["design"], facts["cell_px"], facts["method"]) == ("tile", [94, 104], "quilting")
    assert facts["patches_a"] + facts["patches_b"] == 40
    assert "quilting" in workshop.cli("map", "info", facts["file"]).out
    wall = workshop.folder / "wall.png"
    assert workshop.cli("wall", job, "--rows", 2, "--cols", 3, "--size-px", 60, "-o", wall).code == 0
    assert json.loads((workshop.out / "job.json").read_text())["settings"]["texture"]["design"] == "tile"
