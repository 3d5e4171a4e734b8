"""Every bad input ends with its documented exit code and one clear line, and leaves nothing half-written."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import OpenImageIO as oiio
import pytest
import tifffile

from tilefab.pipeline.plan import shipped_profiles

Change = tuple[str, str]
SCAN = '"slab.tif"'
PROFILE = '"demo_ceramic.icc"'
TILE = ("crops = 64", 'design = "tile"\nmap_size_mm = [40, 44]\npatches = 40')


def scan(name: str) -> Change:
    return SCAN, f'"{name}"'


def setting(line: str) -> Change:
    """Add a line to [slab]."""
    return "square = false", f"square = false\n{line}"


def write_exr(path: Path, value: float) -> None:
    pixels = np.full((100, 110, 3), 0.4, dtype=np.float32)
    pixels[9, 7, 1] = value
    spec = oiio.ImageSpec(110, 100, 3, oiio.FLOAT)
    spec.attribute("XResolution", 60.0)
    spec.attribute("ResolutionUnit", "in")
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec)
    assert target.write_image(pixels)
    assert target.close()


def stock(folder: Path, made_stone: Any, scanner: Any) -> None:
    """Put bad files of every kind into a folder."""
    stone = made_stone(100, 110)
    whole = (folder / "slab.tif").read_bytes()
    (folder / "cut.tif").write_bytes(whole[: len(whole) // 2])
    (folder / "empty.tif").write_bytes(b"")
    (folder / "text.png").write_text("This is no picture. " * 50)
    (folder / "folder.tif").mkdir()
    clear = np.dstack([stone, np.zeros((100, 110), np.uint8)])
    scanner(folder / "clear.tif", clear, extrasamples=["unassalpha"])
    scanner(folder / "nowhere.tif", stone, resolution=(1, 1), resolutionunit="NONE")
    scanner(folder / "cmyk.tif", np.dstack([stone, stone[..., :1]]), photometric="separated")
    scanner(folder / "tiny.tif", stone[:6, :6].copy())
    scanner(folder / "six.tif", np.dstack([stone, stone]), photometric="separated", extrasamples=["unspecified"] * 2)
    damaged = bytearray(imagecodecs.cms_profile("srgb"))
    damaged[300:500] = bytes(200)
    scanner(folder / "odd_profile.tif", stone, iccprofile=bytes(damaged))
    scanner(folder / "wrong_profile.tif", stone, iccprofile=(shipped_profiles() / "demo_ceramic.icc").read_bytes())
    write_exr(folder / "nan.exr", np.nan)
    write_exr(folder / "inf.exr", np.inf)
    tifffile.imwrite(folder / "small_mask.tif", np.zeros((50, 50), np.uint8))
    tifffile.imwrite(folder / "white_mask.tif", np.full((100, 110), 255, np.uint8))
    tifffile.imwrite(folder / "whole_mask.tif", np.zeros((100, 110), np.uint8))
    grid = np.where((np.indices((100, 110)) % 4 == 0).any(axis=0), 255, 0).astype(np.uint8)
    tifffile.imwrite(folder / "grid_mask.tif", grid)
    (folder / "srgb.icc").write_bytes(imagecodecs.cms_profile("srgb"))
    (folder / "cut.icc").write_bytes((shipped_profiles() / "demo_ceramic.icc").read_bytes()[:5000])
    (folder / "gray.icc").write_bytes(imagecodecs.cms_profile("gray"))


CASES: dict[str, tuple[int, list[Change], str]] = {
    "a scan is missing": (3, [scan("absent.tif")], "job.toml:5: slab.scans: there is no file"),
    "a scan is a folder": (3, [scan("folder.tif")], "there is no file"),
    "no resolution is known": (3, [scan("nowhere.tif")], "doesn't state its resolution"),
    "a key is unknown": (3, [("crops = 64", "corps = 64")], "did you mean crops?"),
    "a value has the wrong type": (3, [("crops = 64", 'crops = "many"')], "'many' is not allowed"),
    "a number is none": (3, [("bleed_mm = 1", "bleed_mm = nan")], "nan is not allowed"),
    "a tile is larger than sense": (3, [("[20, 24]", "[200000, 240000]")], "a face can have 2**30 at most"),
    "a wall has no columns": (3, [("bleed_mm = 1", 'layout = "continuous"')], "how many faces a row of the wall has"),
    "the text is no TOML": (3, [("[report]", "[report")], "not valid TOML"),
    "a profile is missing": (3, [(PROFILE, '"absent.icc"')], "colour.press_profile: there is no file"),
    "a scan is cut short": (4, [scan("cut.tif")], "cut.tif: damaged or not an image"),
    "a scan is empty": (4, [scan("empty.tif")], "empty.tif: damaged or not an image"),
    "a scan is text": (4, [scan("text.png")], "text.png: damaged or not an image"),
    "a scan is all transparent": (4, [scan("clear.tif")], "the whole scan is transparent"),
    "a scan has six channels": (4, [scan("six.tif")], "6 channels"),
    "a scan holds NaN": (4, [scan("nan.exr")], "1 pixels are NaN or infinite, the first at row 9, column 7"),
    "a scan holds infinity": (4, [scan("inf.exr")], "1 pixels are NaN or infinite"),
    "a mask has another size": (4, [setting('masks = ["small_mask.tif"]')], "both must be of one size"),
    "a mask leaves nothing": (4, [setting('masks = ["white_mask.tif"]')], "the mask leaves nothing"),
    "trimming leaves nothing": (4, [setting("trim_mm = 25")], "trim_mm = 25 leaves nothing"),
    "a display profile is to drive the press": (5, [(PROFILE, '"srgb.icc"')], "is a display profile"),
    "a profile is cut short": (5, [(PROFILE, '"cut.icc"')], "it is cut short or damaged"),
    "a picture is to drive the press": (5, [(PROFILE, SCAN)], "is no ICC profile"),
    "a CMYK scan has no profile": (5, [scan("cmyk.tif")], "a CMYK scan without a profile: its colours are unknown"),
    "a scan's profile is damaged": (5, [scan("odd_profile.tif")], "profile"),
    "a scan's profile is for inks": (5, [scan("wrong_profile.tif")], "its embedded profile is for CMYK"),
    "the scanner's profile is for gray": (5, [setting('input_profile = "gray.icc"')], "its ICC profile is for GRAY"),
    "a setting is the other design's": (3, [("crops = 64", "patches = 64")], 'only, this job has "crops"'),
    "weights have another size": (4, [setting('weights = ["small_mask.tif"]')], "both must be of one size"),
    "weights for a tile": (3, [setting('weights = ["whole_mask.tif"]'), TILE], "only seams between crops"),
    "a map is too small": (6, [(TILE[0], TILE[1].replace("[40,", "[2,"))], "a map has 16 to 32,768 pixels a side"),
    "the mask leaves no room for a crop": (6, [setting('masks = ["grid_mask.tif"]')], "no crops can be made of this"),
    "a crop is dropped that isn't there": (3, [("crops = 64", "crops = 64\ndrop = [999]")], "there is no crop 999"),
    "every crop is dropped": (6, [("crops = 64", f"crops = 64\ndrop = {list(range(64))}")], "every crop is dropped"),
    "a scan is too small": (6, [scan("tiny.tif")], "a texture needs 16 at least"),
}


def is_stage(line: str) -> bool:
    return line.endswith((" ...", ": done"))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("command", ["run", "face", "map build"])
def test_bad_input(
    workshop: Any, made_stone: Any, scanner: Any, snap: Callable[[Path], Any], command: str, case: str
) -> None:
    code, changes, words = CASES[case]
    stock(workshop.folder, made_stone, scanner)
    job = workshop.job(*changes)
    before = snap(workshop.folder)
    more = {"run": [], "face": ["0", "-o", workshop.folder / "face.tif"], "map build": []}[command]
    done = workshop.cli(*command.split(), job, *more)
    assert done.code == code, (done.out, done.err)
    assert len(done.errors) == 1, done.err
    assert words in done.errors[0]
    assert "Traceback" not in done.err
    assert done.out == ""
    # Nothing but that line and the stages that were done.
    assert not [line for line in done.err.splitlines() if not line.startswith("error: ") and not is_stage(line)]
    left = snap(workshop.folder)
    assert {name: left[name] for name in before} == before
    assert set(left) - set(before) <= {"out/.lock"}


@pytest.mark.parametrize("case", [case for case, (code, _, _) in CASES.items() if code == 3])
def test_a_check_lists_the_same_problems(workshop: Any, made_stone: Any, scanner: Any, case: str) -> None:
    _, changes, words = CASES[case]
    stock(workshop.folder, made_stone, scanner)
    job = workshop.job(*changes)
    done = workshop.cli("job", "check", job, "--json")
    assert done.code == 3
    assert done.json["valid"] is False
    for problem in done.json["problems"]:
        assert set(problem) == {"file", "line", "key", "message"}
        assert problem["file"] == str(job)
    text = workshop.cli("job", "check", job)
    assert text.code == 3
    assert len(text.errors) == len(done.json["problems"])
    assert any(words in line for line in text.errors)
    assert not workshop.out.exists()


def test_a_check_lists_every_problem_at_once(workshop: Any) -> None:
    job = workshop.job(("crops = 64", "corps = 64"), ("count = 8", "count = 0"), ("[20, 24]", "[20, inf]"))
    done = workshop.cli("job", "check", job, "--json")
    assert [(problem["key"], problem["line"]) for problem in done.json["problems"]] == [
        ("texture.corps", 9),
        ("tile.size_mm", 12),
        ("tile.count", 14),
    ]
    assert len(workshop.cli("run", job).errors) == 3


def test_a_check_names_a_single_bad_file(workshop: Any, made_stone: Any, scanner: Any) -> None:
    stock(workshop.folder, made_stone, scanner)
    for change, code in ((scan("empty.tif"), 4), ((PROFILE, '"srgb.icc"'), 5)):
        done = workshop.cli("job", "check", workshop.job(change), "--json")
        assert done.code == code
        (problem,) = done.json["problems"]
        assert problem["message"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["run"],
        ["run", "{job}", "--threads", "0"],
        ["run", "{job}", "--colour"],
        ["rnu", "{job}"],
        ["face", "{job}", "0"],
        ["face", "{job}", "-1", "-o", "a.tif"],
        ["face", "{job}", "one", "-o", "a.tif"],
        ["face", "{job}", "²", "-o", "a.tif"],
        ["face", "{job}", str(1 << 40), "-o", "a.tif"],
        ["face", "{job}", "1" * 5000, "-o", "a.tif"],
        ["wall", "{job}", "--rows", "0", "--cols", "2", "-o", "a.png"],
        ["wall", "{job}", "--rows", "2", "--cols", "2", "--first", str((1 << 40) - 3), "-o", "a.png"],
        ["wall", "{job}", "--rows", "2", "--cols", "2", "--first", "9" * 60, "-o", "a.png"],
    ],
)
def test_wrong_usage(workshop: Any, snap: Callable[[Path], Any], arguments: list[str]) -> None:
    before = snap(workshop.folder)
    done = workshop.cli(*[argument.format(job=workshop.folder / "job.toml") for argument in arguments])
    assert done.code == 2, (done.out, done.err)
    assert "Traceback" not in done.err
    assert done.err.strip()
    assert snap(workshop.folder) == before


@pytest.mark.parametrize("faces", ["8", "0:9", "3:3", "-1", "a", "0;3"])
def test_faces_that_the_job_doesn_t_have(workshop: Any, faces: str) -> None:
    done = workshop.cli("run", workshop.folder / "job.toml", f"--faces={faces}")
    assert done.code == 2
    assert f"--faces {faces}: " in done.err
    assert "Traceback" not in done.err
    assert not workshop.out.exists()


@pytest.mark.parametrize("name", ["absent.toml", "slab.tif", "."])
def test_what_is_no_job(workshop: Any, name: str) -> None:
    done = workshop.cli("run", workshop.folder / name)
    assert done.code == 3
    assert len(done.errors) == 1
    assert "Traceback" not in done.err


@pytest.mark.parametrize("name", ["job.toml", "absent.tfmap", "slab.tif", "."])
def test_what_is_no_map(workshop: Any, name: str) -> None:
    done = workshop.cli("map", "info", workshop.folder / name)
    assert done.code == 7
    assert len(done.errors) == 1
    assert done.errors[0].startswith(str(workshop.folder / name) + ": ") or name == "."


def test_a_map_that_can_t_be_kept_is_an_error_of_map_build(workshop: Any) -> None:
    done = workshop.cli("map", "build", workshop.folder / "job.toml", "--out", workshop.folder / "slab.tif")
    assert done.code == 8
    assert len(done.errors) == 1


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("face", "face.bmp"),
        ("face", "face"),
        ("face", "slab.tif/face.tif"),
        ("face", "slab.tif/face.png"),
        ("wall", "wall.bmp"),
        ("wall", "slab.tif/wall.png"),
        ("report", "slab.tif/report.pdf"),
    ],
)
def test_a_result_that_can_t_be_written(finished: Any, snap: Callable[[Path], Any], command: str, name: str) -> None:
    before = snap(finished.folder)
    more = {"face": ["0"], "wall": ["--rows", "1", "--cols", "2"], "report": []}[command]
    done = finished.cli(command, finished.folder / "job.toml", *more, "-o", finished.folder / name)
    assert done.code == 8, (done.out, done.err)
    assert len(done.errors) == 1
    assert name in done.errors[0] or "slab.tif" in done.errors[0]
    assert snap(finished.folder) == before


def test_a_report_on_nothing(workshop: Any) -> None:
    done = workshop.cli("report", workshop.folder / "job.toml")
    assert done.code == 8
    assert "holds no finished faces to report on; run `tilefab run" in done.errors[0]
    assert not workshop.out.exists()


def test_a_report_on_another_job_s_folder(finished: Any, snap: Callable[[Path], Any]) -> None:
    job = finished.job(("seed = 7", "seed = 8"), name="other.toml")
    before = snap(finished.folder)
    done = finished.cli("report", job)
    assert done.code == 8
    assert "holds the faces of another job" in done.errors[0]
    assert snap(finished.folder) == before


def test_a_defect_says_that_it_is_one(workshop: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from tilefab.cli import common as module

    def defect(*_: object) -> None:
        raise ZeroDivisionError("a defect made by this test")

    monkeypatch.setattr(module, "load_job", defect)
    done = workshop.cli("run", workshop.folder / "job.toml")
    assert done.code == 70
    assert "a defect of tilefab, please report it" in done.errors[0]
    assert "a defect made by this test" in done.errors[0]
    assert "Traceback" in done.err

    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied", "/somewhere")

    monkeypatch.setattr(module, "load_job", refused)
    done = workshop.cli("run", workshop.folder / "job.toml")
    assert (done.code, len(done.errors)) == (1, 1)
    assert "Permission denied" in done.errors[0]
    assert "Traceback" not in done.err


def test_the_exit_codes_are_documented(workshop: Any) -> None:
    text = " ".join(workshop.cli("--help").out.split())
    start = text.index("Exit codes: ")
    for code in ("0 done", "2 wrong usage", "3 job file", "4 image", "5 profile", "8 output", "130 interrupted"):
        assert code in text[start:]


def test_the_entry_point_itself_ends_with_the_code(workshop: Any) -> None:
    shutil.move(workshop.folder / "slab.tif", workshop.folder / "moved.tif")
    done = workshop.process("run", workshop.folder / "job.toml")
    assert done.code == 3
    assert done.out == ""
    (line,) = done.err.splitlines()
    assert line.startswith("error: ")
