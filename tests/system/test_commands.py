"""Every other command: the same faces again, pictures of them, and facts for programs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

import tilefab


def test_a_face_again_is_the_run_s_file(finished: Any, tmp_path: Path) -> None:
    for face in (0, 5):
        path = tmp_path / f"{face}.tif"
        done = finished.cli("face", finished.folder / "job.toml", face, "-o", path, "--json", "--threads", 2)
        assert done.code == 0, done.err
        assert path.read_bytes() == (finished.out / "faces" / f"face_{face:06d}.tif").read_bytes()
        line = finished.lines()[face]
        facts = done.json
        assert set(facts) == {"face", "file", "kind", "origin", "rows", "cols", "code"}
        assert (facts["face"], facts["kind"], facts["file"]) == (face, "print", str(path))
        assert [facts["origin"], facts["rows"], facts["cols"]] == [line["origin"], line["rows"], line["cols"]]


def test_a_face_again_without_the_run_is_the_same(finished_once: Any, workshop: Any, tmp_path: Path) -> None:
    done = workshop.cli("face", workshop.folder / "job.toml", "3", "-o", tmp_path / "3.tif")
    assert done.code == 0, done.err
    assert (tmp_path / "3.tif").read_bytes() == (finished_once.out / "faces" / "face_000003.tif").read_bytes()


def test_a_face_beyond_the_count_can_be_made(finished: Any, tmp_path: Path) -> None:
    done = finished.cli("face", finished.folder / "job.toml", (1 << 40) - 1, "-o", tmp_path / "a.tif", "--json")
    assert done.code == 0, done.err
    assert tifffile.imread(tmp_path / "a.tif").shape == (61, 51, 4)


def test_the_proof_of_a_face_is_the_run_s(finished: Any, tmp_path: Path) -> None:
    done = finished.cli("face", finished.folder / "job.toml", "4", "-o", tmp_path / "4.png", "--json")
    assert done.code == 0, done.err
    assert done.json["kind"] == "proof"
    assert (tmp_path / "4.png").read_bytes() == (finished.out / "proofs" / "face_000004.png").read_bytes()


def test_a_face_by_its_code(finished: Any, tmp_path: Path) -> None:
    original = finished.out / "faces" / "face_000006.tif"
    with tifffile.TiffFile(original) as file:
        code = file.pages[0].description
    done = finished.cli("face", finished.folder / "job.toml", f" {code}\n", "-o", tmp_path / "a.tif", "--json")
    assert done.code == 0, done.err
    assert done.json["code"] == code
    assert (tmp_path / "a.tif").read_bytes() == original.read_bytes()


def test_the_code_of_another_job_is_refused(finished: Any, snap: Callable[[Path], Any]) -> None:
    with tifffile.TiffFile(finished.out / "faces" / "face_000006.tif") as file:
        code = file.pages[0].description
    other = finished.job(("seed = 7", "seed = 8"), name="other.toml")
    before = snap(finished.folder)
    for job, text in (
        (other, code),
        (finished.folder / "job.toml", code[:-1] + ("0" if code[-1] != "0" else "1")),
        (finished.folder / "job.toml", code[:-1]),
        (finished.folder / "job.toml", code.replace("face=6", "face=")),
        (finished.folder / "job.toml", code.replace("face=6", f"face={1 << 40}")),
    ):
        done = finished.cli("face", job, text, "-o", finished.folder / "a.tif")
        assert done.code == 2, (text, done.out, done.err)
        assert "code" in done.err
    assert snap(finished.folder) == before


def test_a_code_printed_from_another_map_is_refused(finished: Any, snap: Callable[[Path], Any]) -> None:
    with tifffile.TiffFile(finished.out / "faces" / "face_000006.tif") as file:
        code = file.pages[0].description
    start = code.index("map=") + 4
    before = snap(finished.folder)
    for text in (f"{code[:start]}{'0' * 32}{code[start + 32 :]}", code.replace(" at=", " at=1")):
        done = finished.cli("face", finished.folder / "job.toml", text, "-o", finished.folder / "a.tif")
        assert done.code == 8, (done.out, done.err)
        assert "this code was printed beside another face" in done.errors[0]
    assert snap(finished.folder) == before


@pytest.mark.parametrize(
    "target",
    [
        *("slab.tif", "out/faces/face_000003.tif", "out/faces/new.tif", "out/proofs/face_000003.png"),
        *("out/../out/faces/face_000003.tif", "out/maps/new.png"),
    ],
)
@pytest.mark.parametrize("command", ["face", "wall"])
def test_no_result_goes_over_a_file_of_the_job_or_its_run(
    finished: Any, snap: Callable[[Path], Any], command: str, target: str
) -> None:
    before = snap(finished.folder)
    more = {"face": ["1"], "wall": ["--rows", 1, "--cols", 1]}[command]
    done = finished.cli(command, finished.folder / "job.toml", *more, "-o", finished.folder / target)
    assert done.code == 8, (done.out, done.err)
    assert "write to another" in done.errors[0]
    assert snap(finished.folder) == before


@pytest.mark.parametrize("target", ["out/manifest.jsonl", "out/job.json", "job.toml", "slab.tif", "r.txt"])
def test_no_report_goes_over_another_file(finished: Any, snap: Callable[[Path], Any], target: str) -> None:
    before = snap(finished.folder)
    done = finished.cli("report", finished.folder / "job.toml", "-o", finished.folder / target)
    assert done.code == 8, (done.out, done.err)
    assert snap(finished.folder) == before


@pytest.mark.parametrize("ending", ["png", "jpg", "tif"])
def test_a_wall(finished: Any, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"wall.{ending}"
    done = finished.cli("wall", finished.folder / "job.toml", "--rows", 2, "--cols", 3, "-o", path, "--json")
    assert done.code == 0, done.err
    # 2 mm of 20 mm wide tiles of 47 pixels are 5 pixels of grout.
    size = (2 * 57 + 5, 3 * 47 + 2 * 5)
    assert done.json == {"file": str(path), "rows": size[0], "cols": size[1], "tiles": [2, 3]}
    with Image.open(path) as image:
        assert image.size == size[::-1]
        wall = np.asarray(image)
    if ending == "jpg":
        return
    for index in range(6):
        row, col = index // 3 * 62, index % 3 * 52
        with Image.open(finished.out / "proofs" / f"face_{index:06d}.png") as proof:
            np.testing.assert_array_equal(wall[row : row + 57, col : col + 47], np.asarray(proof)[2:-2, 2:-2])
    assert (wall[57:62] == 205).all()
    assert (wall[:, 47:52] == 205).all()


def test_a_wall_of_a_running_pattern_has_no_joints_without_grout(workshop: Any, tmp_path: Path) -> None:
    job = workshop.job(("bleed_mm = 1", 'bleed_mm = 0\nlayout = "continuous"\ncolumns = 4'))
    for rows, cols, first, name in ((3, 4, 0, "whole.png"), (2, 2, 5, "part.png")):
        more = ["--rows", rows, "--cols", cols, "--first", first, "--grout-mm", 0, "-o", tmp_path / name]
        done = workshop.cli("wall", job, *more)
        assert done.code == 0, done.err
    whole, part = np.asarray(Image.open(tmp_path / "whole.png")), np.asarray(Image.open(tmp_path / "part.png"))
    assert whole.shape == (3 * 57, 4 * 47, 3)
    np.testing.assert_array_equal(whole[57:, 47 : 3 * 47], part)
    more = ["--rows", 1, "--cols", 3, "--first", 2, "-o", tmp_path / "beyond.png"]
    done = workshop.cli("wall", job, *more)
    assert done.code == 8
    assert "the job's wall has 4 columns" in done.errors[0]
    assert not (tmp_path / "beyond.png").exists()


def test_a_large_wall_is_reduced(finished: Any, tmp_path: Path) -> None:
    more = ["--rows", 5, "--cols", 5, "--size-px", 100, "-o", tmp_path / "a.png"]
    done = finished.cli("wall", finished.folder / "job.toml", *more, "--json")
    assert done.code == 0, done.err
    assert max(done.json["rows"], done.json["cols"]) <= 110


def test_a_map_is_built_once_and_told_about(workshop: Any, snap: Callable[[Path], Any]) -> None:
    done = workshop.cli("map", "build", workshop.folder / "job.toml", "--json")
    assert done.code == 0, done.err
    facts = done.json
    fields = {
        *("file", "hash", "format_version", "design", "space", "channels", "dtype", "dpi", "base_px", "cell_px"),
        *("cell_mm", "crops", "crops_shown", "crops_rationed", "features", "overlap_px", "candidates", "sweeps"),
        *("weights", "slabs", "preparation"),
    }
    assert set(facts) == fields | {"warnings"}
    assert (facts["design"], facts["crops"], facts["crops_shown"]) == ("crops", 64, 64)
    assert facts["base_px"] == [110, 100]
    assert (facts["space"], facts["dtype"], facts["dpi"]) == ("lab16", "uint16", 60.0)
    assert facts["slabs"] == ["slab.tif"]
    before = snap(workshop.out)
    assert list(before) == [Path(facts["file"]).relative_to(workshop.out).as_posix()]
    again = workshop.cli("map", "build", workshop.folder / "job.toml", "--json")
    assert again.json == facts
    assert snap(workshop.out) == before
    info = workshop.cli("map", "info", facts["file"], "--json")
    assert info.code == 0, info.err
    assert info.json == {name: value for name, value in facts.items() if name != "warnings"}
    assert facts["hash"] in "".join(workshop.cli("map", "info", facts["file"]).out.split())


def test_a_map_built_before_is_used_by_the_run(finished_once: Any, workshop: Any) -> None:
    assert workshop.cli("map", "build", workshop.folder / "job.toml").code == 0
    done = workshop.cli("run", workshop.folder / "job.toml")
    assert done.code == 0, done.err
    assert "Growing the tile" not in done.err
    assert workshop.hashes() == finished_once.hashes()


def test_a_report_can_be_drawn_anew(finished: Any, snap: Callable[[Path], Any]) -> None:
    (finished.out / "report.pdf").unlink()
    before = snap(finished.out)
    done = finished.cli("report", finished.folder / "job.toml", "--json")
    assert done.code == 0, done.err
    assert done.json == {"report": str(finished.out / "report.pdf")}
    assert (finished.out / "report.pdf").read_bytes().startswith(b"%PDF-")
    elsewhere = finished.folder / "elsewhere" / "r.pdf"
    done = finished.cli("report", finished.folder / "job.toml", "-o", elsewhere)
    assert done.code == 0, done.err
    assert done.out.strip() == str(elsewhere)
    assert elsewhere.read_bytes().startswith(b"%PDF-")
    after = snap(finished.out)
    assert {name: after[name] for name in before} == before


def test_a_report_leaves_a_line_that_a_run_is_writing(finished: Any) -> None:
    path = finished.out / "manifest.jsonl"
    torn = path.read_bytes()[:-30]
    path.write_bytes(torn)
    assert finished.cli("report", finished.folder / "job.toml").code == 0
    assert path.read_bytes() == torn


def test_a_check_prints_the_resolved_job(workshop: Any) -> None:
    done = workshop.cli("job", "check", workshop.folder / "job.toml", "--json")
    assert done.code == 0, done.err
    facts = done.json
    assert facts["valid"] is True
    assert set(facts) == {
        *("valid", "schema_version", "job", "slab", "texture", "tile", "colour", "output", "report", "line", "hashes"),
    }
    assert facts["slab"]["scans"] == [str(workshop.folder / "slab.tif")]
    assert facts["slab"]["dpi"] == [60.0]
    assert facts["tile"]["size_px"] == [47, 57]
    assert facts["tile"]["bleed_px"] == 2
    assert facts["colour"]["ink_names"] == ["Blue", "Brown", "Yellow", "Black"]
    assert facts["output"]["directory"] == str(workshop.out)
    assert set(facts["hashes"]) == {"job", "map_key", "press_profile"}
    assert all(len(value) == 64 for value in facts["hashes"].values())
    assert not workshop.out.exists()
    text = workshop.cli("job", "check", workshop.folder / "job.toml")
    assert text.code == 0
    assert "colour.ink_limit_percent" in text.out


def test_the_hash_of_a_check_is_that_of_the_run(finished: Any) -> None:
    done = finished.cli("job", "check", finished.folder / "job.toml", "--json")
    assert done.json["hashes"]["job"] == finished.lines()[0]["job"]


@pytest.mark.parametrize("name", ["[red]job.toml", "job [1].toml", "[bold"])
def test_brackets_in_a_path_are_just_brackets(finished: Any, name: str) -> None:
    job = finished.folder / name
    shutil.copy(finished.folder / "job.toml", job)
    done = finished.cli("job", "check", job)
    assert done.code == 0, done.err
    assert "".join(name.split()) in "".join(done.out.split())
    out = finished.folder / "[" / "b]"  # "[/b]" ends bold text in rich's markup
    shutil.copytree(finished.out, out)
    done = finished.cli("run", job, "--out", out)
    assert done.code == 0, done.err
    assert "/[/b]" in "".join(done.out.split())


def test_results_for_people_are_on_standard_output_and_progress_is_not(finished: Any) -> None:
    done = finished.cli("run", finished.folder / "job.toml")
    assert "0 written, 8 there already" in done.out
    assert "Printing faces: done" in done.err
    assert "done" not in done.out


def test_the_version(workshop: Any) -> None:
    done = workshop.cli("--version")
    assert (done.code, done.out) == (0, f"tilefab {tilefab.__version__}\n")


@pytest.mark.parametrize("arguments", [[], ["job"], ["map"], ["profile"]])
def test_no_command_shows_help(workshop: Any, arguments: list[str]) -> None:
    done = workshop.cli(*arguments)
    assert done.code in (0, 2)
    assert "Usage: " in done.out + done.err


def test_a_pipe_gets_nothing_but_json(finished: Any) -> None:
    done = finished.process("run", finished.folder / "job.toml", "--json")
    assert done.code == 0, done.err
    assert json.loads(done.out)["kept"] == 8
    assert "\x1b" not in done.out + done.err


@pytest.mark.parametrize(("first", "cols", "fits"), [(0, 3, True), (3, 3, True), (0, 4, False), (1, 3, False)])
def test_a_running_wall_shows_only_faces_that_hang_side_by_side(
    workshop: Any, tmp_path: Path, first: int, cols: int, fits: bool
) -> None:
    job = workshop.job(("count = 8", 'count = 8\nlayout = "continuous"\ncolumns = 3'))
    picture = tmp_path / "wall.png"
    done = workshop.cli("wall", job, "--rows", 2, "--cols", cols, "--first", first, "-o", picture)
    assert done.code == (0 if fits else 8), done.err
    assert picture.exists() == fits
    if not fits:
        assert "don't hang side by side" in done.errors[0]


def test_no_map_is_left_in_the_folder_of_another_job(
    finished: Any, snap: Callable[[Path], Any], tmp_path: Path
) -> None:
    other = finished.job(("seed = 7", "seed = 8"), name="other.toml")
    before = snap(finished.out)
    done = finished.cli("face", other, 0, "-o", tmp_path / "face.tif")
    assert done.code == 0, done.err
    assert "The map was not kept" in done.err
    assert finished.cli("map", "build", other).code == 8
    assert snap(finished.out) == before


def test_warnings_and_what_was_done_reach_the_operator(workshop: Any) -> None:
    job = workshop.job(("ink_limit_percent = 260", "ink_limit_percent = 20"), ("count = 8", "count = 1"))
    told = workshop.cli("run", job)
    assert told.code == 0, told.err
    assert "warning: " in told.out
    assert "reduced to the ink limit of 20 %" in told.out
    assert "slab.tif: 110 x 100 pixels" in " ".join(told.out.split())
    facts = workshop.cli("run", job, "--json").json
    assert any("ink limit" in warning for warning in facts["warnings"])
    assert {entry["step"] for entry in facts["preparation"]} >= {"Colour space", "Resolution"}


def test_ink_names_may_change_between_runs(finished: Any) -> None:
    job = finished.job(("260", '260\nink_names = ["Cobalt", "Iron", "Zircon", "Black"]'), name="job.toml")
    (finished.out / "faces" / "face_000003.tif").unlink()
    assert finished.cli("run", job).code == 0
    with tifffile.TiffFile(finished.out / "faces" / "face_000003.tif") as file:
        assert b"Cobalt\0Iron\0Zircon\0Black" in bytes(file.pages[0].tags[333].value, "ascii")
