"""A run, through the real command line: the same faces however it is done, and never two truths about one."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from tilefab.io import load_texture_map, locked_folder
from tilefab.pipeline.plan import shipped_profiles
from tilefab.sampling import render

FIELDS = [
    *("face", "file", "rows", "cols", "channels", "dtype", "dpi", "origin", "sha256"),
    *("texture_map", "press_map", "press_profile", "job", "seed", "proof"),
]


def test_a_whole_run(finished_once: Any) -> None:
    out = finished_once.out
    names = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    maps = {name for name in names if name.startswith("maps/")}
    assert names - maps == {
        ".lock",
        "job.json",
        "manifest.jsonl",
        "report.pdf",
        *(f"faces/face_{face:06d}.tif" for face in range(8)),
        *(f"proofs/face_{face:06d}.png" for face in range(8)),
    }
    assert sorted(name.partition(".")[2] for name in maps) == ["press.tfmap", "texture.tfmap"]
    assert (out / "report.pdf").read_bytes().startswith(b"%PDF-")
    result = json.loads((finished_once.folder / "result.json").read_text())
    assert set(result) == {
        *("output", "faces", "written", "kept", "texture_map", "press_map", "report", "preparation", "warnings"),
        "colour",
    }
    assert (result["faces"], result["written"], result["kept"]) == (8, 8, 0)
    assert result["output"] == str(out)
    assert result["report"] == str(out / "report.pdf")
    assert isinstance(result["warnings"], list)
    record = json.loads((out / "job.json").read_text())
    assert set(record) == {"job", "name", "tilefab", "settings"}
    assert record["settings"]["texture"]["seed"] == 7


def test_every_face_is_another_and_has_its_file(finished_once: Any) -> None:
    hashes = finished_once.hashes()
    assert list(hashes) == list(range(8))
    assert len(set(hashes.values())) == 8


def test_lines_of_the_manifest_hold_just_what_is_documented(finished_once: Any) -> None:
    job = json.loads((finished_once.out / "job.json").read_text())["job"]
    profile = hashlib.sha256((shipped_profiles() / "demo_ceramic.icc").read_bytes()).hexdigest()
    for face, line in enumerate(finished_once.lines()):
        assert list(line) == FIELDS
        assert line["face"] == face
        assert line["file"] == f"faces/face_{face:06d}.tif"
        assert line["proof"] == f"proofs/face_{face:06d}.png"
        assert (line["rows"], line["cols"], line["channels"], line["dtype"]) == (61, 51, 4, "uint8")
        assert (line["dpi"], line["seed"], line["job"], line["press_profile"]) == (60.0, 7, job, profile)


def test_a_line_can_be_verified_from_outside(finished_once: Any) -> None:
    (press_file,) = finished_once.out.glob("maps/*.press.tfmap")
    (texture_file,) = finished_once.out.glob("maps/*.texture.tfmap")
    press, texture = load_texture_map(press_file), load_texture_map(texture_file)
    assert (press.space, texture.space) == ("ink8", "lab16")
    for line in finished_once.lines():
        assert line["press_map"] == press.hash
        assert line["texture_map"] == texture.hash
        pixels = render(press, *line["origin"], line["rows"], line["cols"], seed=line["seed"])
        assert hashlib.sha256(pixels.tobytes()).hexdigest() == line["sha256"]


def test_a_face_s_file_says_what_it_is(finished_once: Any) -> None:
    job = json.loads((finished_once.out / "job.json").read_text())["job"]
    for line in finished_once.lines():
        with tifffile.TiffFile(finished_once.out / line["file"]) as file:
            page = file.pages[0]
            row, col = line["origin"]
            assert page.description == (
                f"tilefab face={line['face']} seed=7 at={row},{col} size=61x51 "
                f"map={line['press_map'][:32]} job={job[:32]}"
            )
            assert page.tags["XResolution"].value == (60, 1)
            assert hashlib.sha256(page.tags["InterColorProfile"].value).hexdigest() == line["press_profile"]
        with Image.open(finished_once.out / line["proof"]) as proof:
            assert (proof.mode, proof.size) == ("RGB", (51, 61))


def test_a_second_run_touches_no_face(finished: Any, snap: Callable[[Path], dict[str, Any]]) -> None:
    before = snap(finished.out)
    done = finished.cli("run", finished.folder / "job.toml", "--verify", "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], done.json["kept"]) == (0, 8)
    after = snap(finished.out)
    assert {name: after[name] for name in after if name != "report.pdf"} == {
        name: before[name] for name in before if name != "report.pdf"
    }


# --- the same faces, however the run is done

BIG = (
    ("size_mm = [20, 24]", "size_mm = [250, 320]"),
    ("count = 8", "count = 12"),
    ("[output]", "[output]\nbits = 16\nproofs = false"),
)


@pytest.fixture(scope="module")
def big(tmp_path_factory: pytest.TempPathFactory, new_workshop: Any) -> Any:
    """A run of 12 faces of 3.6 MB, each rendered in several strips, done in one go by one thread."""
    workshop = new_workshop(tmp_path_factory.mktemp("big") / "work")
    done = workshop.process("run", workshop.job(*BIG), "--threads", 1)
    assert done.code == 0, done.err
    # The same faces and 400 more: a run of these is never over before it is killed.
    workshop.job(*BIG[:1], ("count = 8", "count = 412"), BIG[2], name="long.toml")
    return workshop


def contents(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (folder / "faces").iterdir()}


def test_threads_and_order_change_nothing(big: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for arguments in (("--threads", 4, "--faces", "5,3,0:3"), ("--threads", 2, "--faces", "11,4:9"), ()):
        done = big.process("run", big.folder / "job.toml", "--out", out, *arguments)
        assert done.code == 0, done.err
    assert [line["face"] for line in big.lines(out)] == [5, 3, 0, 1, 2, 11, 4, 6, 7, 8, 9, 10]
    assert big.hashes(out) == big.hashes()
    assert contents(out) == contents(big.out)


def recorded(out: Path) -> int:
    try:
        return (out / "manifest.jsonl").read_bytes().count(b"\n")
    except FileNotFoundError:
        return 0


def until(process: subprocess.Popen[str], reached: Callable[[], bool]) -> None:
    """Wait until something is so; fail if the process ends before, or after very many looks."""
    for _ in range(5_000_000):
        if reached():
            return
        if process.poll() is not None:
            break
        os.sched_yield()
    process.kill()
    raise AssertionError(f"the run ended too early: {process.communicate()}")


MOMENTS: dict[str, Callable[[Path], bool]] = {
    "as the folder is taken": lambda out: (out / ".lock").exists(),
    "as a map is written": lambda out: any((out / "maps").glob(".tilefab-*")),
    "as the folder is claimed": lambda out: (out / "job.json").exists(),
    "as a face is written": lambda out: recorded(out) > 0 and any((out / "faces").glob(".tilefab-*")),
    "after a face's file": lambda out: (out / "faces" / "face_000002.tif").exists(),
    "after one line": lambda out: recorded(out) >= 1,
    "after four lines": lambda out: recorded(out) >= 4,
    "after nine lines": lambda out: recorded(out) >= 9,
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_run_killed_goes_on_to_the_same_faces(big: Any, tmp_path: Path, moment: str) -> None:
    out = tmp_path / "out"
    with big.start("run", big.folder / "long.toml", "--out", out) as process:
        until(process, lambda: MOMENTS[moment](out))
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert process.returncode == -signal.SIGKILL
    lines = (out / "manifest.jsonl").read_bytes() if recorded(out) else b""
    stamps = {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in out.glob("faces/face_*.tif")}
    kept = min(12, recorded(out))
    again = big.cli("run", big.folder / "job.toml", "--out", out, "--threads", 3, "--json")
    assert again.code == 0, again.err
    assert (again.json["kept"], again.json["written"]) == (kept, 12 - kept)
    assert same_faces(big, out)
    assert (out / "manifest.jsonl").read_bytes().startswith(lines[: lines.rfind(b"\n") + 1])
    assert not list(out.rglob(".tilefab-*"))
    for path, stamp in stamps.items():
        assert (path.stat().st_ino, path.stat().st_mtime_ns) == stamp, f"{path} was written again"


def same_faces(big: Any, out: Path) -> bool:
    """Whether a folder holds the faces of the undisturbed run, to the byte."""
    hashes, files = big.hashes(out), contents(out)
    wanted = contents(big.out)
    return {face: hashes.get(face) for face in range(12)} == big.hashes() and {
        n: files.get(n) for n in wanted
    } == wanted


def test_a_run_killed_again_and_again_goes_on_to_the_same_faces(big: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for wanted in (2, 5, 8):
        with big.start("run", big.folder / "long.toml", "--out", out) as process:
            until(process, lambda least=wanted: recorded(out) >= least)
            process.kill()
            process.communicate()
        assert process.returncode == -signal.SIGKILL
    assert big.cli("run", big.folder / "job.toml", "--out", out).code == 0
    assert same_faces(big, out)


def test_an_interrupted_run_says_how_to_go_on(big: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with big.start("run", big.folder / "long.toml", "--out", out) as process:
        until(process, lambda: recorded(out) >= 2)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    assert "interrupted: finished faces are kept; run the same command again to go on" in err.splitlines()
    assert "Traceback" not in err
    assert not list(out.rglob(".tilefab-*"))
    assert big.cli("run", big.folder / "job.toml", "--out", out).code == 0
    assert same_faces(big, out)


# --- what the folder of a run bears, and what it doesn't


def run(workshop: Any, *arguments: object) -> Any:
    return workshop.cli("run", workshop.folder / "job.toml", *arguments)


def refused(done: Any, *words: str) -> str:
    assert done.code == 8, (done.out, done.err)
    assert len(done.errors) == 1, done.err
    assert "Traceback" not in done.err
    for word in words:
        assert word in done.errors[0], done.err
    return done.errors[0]


@pytest.mark.parametrize("cut", [1, 50, 500])
def test_a_torn_line_is_mended_from_its_face(finished: Any, snap: Callable[[Path], dict[str, Any]], cut: int) -> None:
    path = finished.out / "manifest.jsonl"
    whole, before = path.read_bytes(), snap(finished.out / "faces")
    path.write_bytes(whole[:-cut])
    done = run(finished, "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], done.json["kept"]) == (1, 7)
    assert path.read_bytes() == whole
    assert snap(finished.out / "faces") == before


def test_a_lost_manifest_is_made_again_from_the_faces(finished: Any, snap: Callable[[Path], dict[str, Any]]) -> None:
    path = finished.out / "manifest.jsonl"
    whole, before = path.read_bytes(), snap(finished.out / "faces")
    path.unlink()
    assert run(finished).code == 0
    assert path.read_bytes() == whole
    assert snap(finished.out / "faces") == before


@pytest.mark.parametrize("what", ["faces/face_000003.tif", "proofs/face_000003.png"])
def test_a_file_lost_is_made_again_the_same(finished: Any, snap: Callable[[Path], dict[str, Any]], what: str) -> None:
    before = snap(finished.out)
    (finished.out / what).unlink()
    done = run(finished, "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], done.json["kept"]) == (1, 7)
    after = snap(finished.out)
    assert after[what][2] == before[what][2]
    others = set(before) - {what, "report.pdf"}
    assert {name: after[name] for name in others} == {name: before[name] for name in others}


def test_a_lost_folder_of_maps_is_made_again_the_same(finished: Any, snap: Callable[[Path], dict[str, Any]]) -> None:
    before = snap(finished.out)
    shutil.rmtree(finished.out / "maps")
    (finished.out / "faces" / "face_000005.tif").unlink()
    assert run(finished).code == 0
    after = snap(finished.out)
    assert {name: after[name][2] for name in after if name.startswith(("maps", "faces"))} == {
        name: before[name][2] for name in before if name.startswith(("maps", "faces"))
    }


@pytest.mark.parametrize("kind", ["texture", "press"])
@pytest.mark.parametrize("damage", ["flipped", "truncated", "empty"])
def test_a_damaged_map_is_made_again_with_a_note(finished: Any, kind: str, damage: str) -> None:
    (path,) = finished.out.glob(f"maps/*.{kind}.tfmap")
    whole = path.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 4
    path.write_bytes({"flipped": bytes(flipped), "truncated": whole[:-500], "empty": b""}[damage])
    (finished.out / "faces" / "face_000001.tif").unlink()
    done = run(finished)
    assert done.code == 0, done.err
    assert f"note: {path}: " in done.err
    assert "It is made anew" in done.err
    assert path.read_bytes() == whole
    assert len(finished.hashes()) == 8


def tamper_pixel(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        raw[file.pages[0].dataoffsets[0] + 17] ^= 1
    path.write_bytes(raw)


def tamper_other(path: Path) -> None:
    shutil.copy(path.with_name("face_000004.tif"), path)


@pytest.mark.parametrize(
    "tamper",
    [
        tamper_pixel,
        tamper_other,
        lambda path: path.write_bytes(path.read_bytes()[:-9000]),
        lambda path: path.write_bytes(b""),
        lambda path: path.write_text("not a picture"),
        lambda path: (path.unlink(), path.mkdir()),
    ],
)
def test_a_tampered_face_is_refused_and_left(
    finished: Any, snap: Callable[[Path], dict[str, Any]], tamper: Callable[[Path], object]
) -> None:
    tamper(finished.out / "faces" / "face_000003.tif")
    before = snap(finished.out)
    refused(
        run(finished, "--verify"), "face_000003.tif: face 3: the file holds other pixels", "nothing was overwritten"
    )
    assert snap(finished.out) == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sha256", "0" * 64),
        ("face", 77),
        ("rows", 62),
        ("channels", 3),
        ("dtype", "uint16"),
        ("dpi", 61.0),
        ("origin", [0, 0]),
        ("texture_map", "0" * 64),
        ("press_map", "0" * 64),
        ("press_profile", "0" * 64),
        ("job", "0" * 64),
        ("seed", 8),
        ("file", "faces/face_000004.tif"),
        ("file", "../../face_000003.tif"),
    ],
)
def test_a_tampered_manifest_is_refused_and_left(
    finished: Any, snap: Callable[[Path], dict[str, Any]], field: str, value: object
) -> None:
    lines = finished.lines()
    lines[3][field] = value
    (finished.out / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    before = snap(finished.out)
    done = run(finished, "--verify")
    if field == "face":
        # Face 3 is then a face without a line, beside a line of a face that nobody asks for: nothing contradicts it.
        assert done.code == 0
        return
    refused(done, str(finished.out))
    assert snap(finished.out) == before


def test_garbage_in_the_manifest_is_refused_with_its_line(
    finished: Any, snap: Callable[[Path], dict[str, Any]]
) -> None:
    path = finished.out / "manifest.jsonl"
    path.write_bytes(path.read_bytes() + b"garbage\n")
    before = snap(finished.out)
    refused(run(finished), f"{path}:9: not a line of a manifest")
    assert snap(finished.out) == before


def test_an_unreadable_record_of_the_job_is_refused(finished: Any, snap: Callable[[Path], dict[str, Any]]) -> None:
    for text in ("", "[]", "{}", "\xff"):
        (finished.out / "job.json").write_text(text)
        before = snap(finished.out)
        refused(run(finished), "job.json: can't be read, so it isn't known whose folder this is")
        assert snap(finished.out) == before


OTHERS = [
    ("seed = 7", "seed = 8"),
    ("[20, 24]", "[20, 25]"),
    ("ink_limit_percent = 260", "ink_limit_percent = 261"),
    ("bleed_mm = 1", "bleed_mm = 2"),
    ("[output]", "[output]\nbits = 16"),
    ("crops = 64", "crops = 65"),
]


@pytest.mark.parametrize("change", OTHERS)
@pytest.mark.parametrize("lost", [None, "job.json", "manifest.jsonl"])
def test_the_folder_of_another_job_is_refused_and_left(
    finished: Any, snap: Callable[[Path], dict[str, Any]], change: tuple[str, str], lost: str | None
) -> None:
    if lost:
        (finished.out / lost).unlink()
    before = snap(finished.out)
    done = finished.cli("run", finished.job(change))
    refused(done, str(finished.out), "faces of another job, or of this job with other settings", "--out DIR")
    assert snap(finished.out) == before


@pytest.mark.parametrize(
    "change",
    [
        ("count = 8", "count = 9"),
        ('name = "Workshop"', 'name = "Night shift"'),
        ("[output]", '[output]\ncompression = "lzw"'),
        ("[output]", "[output]\nproofs = false"),
    ],
)
def test_what_decides_no_pixel_may_change(
    finished: Any, snap: Callable[[Path], dict[str, Any]], change: tuple[str, str]
) -> None:
    before = snap(finished.out / "faces")
    done = finished.cli("run", finished.job(change), "--json")
    assert done.code == 0, done.err
    assert done.json["kept"] == 8
    after = snap(finished.out / "faces")
    assert {name: after[name] for name in before} == before


def test_a_count_with_more_digits_makes_nothing_twice(finished: Any) -> None:
    job = finished.job(("count = 8", "count = 12345678"))
    done = finished.cli("run", job, "--faces", "0:3,12345677", "--json")
    assert done.code == 0, done.err
    assert (done.json["written"], done.json["kept"]) == (1, 3)
    for folder, ending in (("faces", "tif"), ("proofs", "png")):
        names = sorted(path.name for path in (finished.out / folder).iterdir())
        assert names == sorted([*(f"face_{face:06d}.{ending}" for face in range(8)), f"face_12345677.{ending}"])


def test_two_runs_never_write_one_folder(finished: Any, snap: Callable[[Path], dict[str, Any]]) -> None:
    (finished.out / "faces" / "face_000003.tif").unlink()
    before = snap(finished.out)
    with locked_folder(finished.out):
        refused(run(finished), f"{finished.out}: another run is writing to this folder")
    assert snap(finished.out) == before
    assert run(finished).code == 0


def test_leftovers_of_a_killed_run_go(finished: Any) -> None:
    for folder in (".", "faces", "proofs", "maps"):
        (finished.out / folder / ".tilefab-abcdef.tif").write_bytes(b"half")
    assert run(finished).code == 0
    assert not list(finished.out.rglob(".tilefab-*"))


def test_a_run_that_fails_before_its_first_face_claims_no_folder(workshop: Any) -> None:
    scan = workshop.folder / "slab.tif"
    whole = scan.read_bytes()
    scan.write_bytes(whole[:-2000])
    assert run(workshop).code == 4
    scan.write_bytes(whole)
    assert run(workshop, "--faces", "0:1").code == 0


def limit_files(size: int) -> Callable[[], None]:
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_a_full_disk_stops_a_run_that_then_goes_on(workshop: Any, finished_once: Any) -> None:
    # No file may grow beyond 400 kB: the maps fit, the first face doesn't.
    done = workshop.process("run", workshop.folder / "job.toml", preexec_fn=limit_files(400_000))
    message = refused(done, "faces/face_000000.tif: can't write")
    assert "disk" in message or "larger than is allowed" in message
    assert not list(workshop.out.rglob(".tilefab-*"))
    assert not list((workshop.out / "faces").iterdir())
    assert not (workshop.out / "manifest.jsonl").exists()
    assert run(workshop).code == 0
    assert workshop.hashes() == finished_once.hashes()


def test_a_disk_too_full_for_the_maps_stops_a_run_too(workshop: Any) -> None:
    done = workshop.process("run", workshop.folder / "job.toml", preexec_fn=limit_files(20_000))
    refused(done, ".texture.tfmap: can't write")
    assert [path.name for path in workshop.out.rglob("*") if path.is_file()] == [".lock"]


@pytest.mark.parametrize("where", ["slab.tif/out", "slab.tif", "/proc/tilefab-out"])
def test_a_place_that_can_t_be_written_is_refused(workshop: Any, snap: Any, where: str) -> None:
    before = snap(workshop.folder)
    refused(run(workshop, "--out", workshop.folder / where), "can't make this folder")
    assert snap(workshop.folder) == before


def test_faces_don_t_depend_on_the_place(finished_once: Any, new_workshop: Any, tmp_path: Path) -> None:
    other = new_workshop(tmp_path / "another place" / "[1] ünïcödé")
    assert run(other).code == 0
    assert other.hashes() == finished_once.hashes()


def test_another_seed_gives_other_faces(finished_once: Any, workshop: Any) -> None:
    done = workshop.cli("run", workshop.job(("seed = 7", "seed = 8")))
    assert done.code == 0, done.err
    assert not set(workshop.hashes().values()) & set(finished_once.hashes().values())


def test_proofs_show_the_same_stone_as_the_faces(finished_once: Any) -> None:
    # Where a face repeats an ink mixture, its proof repeats the colour: the proof is a function of the inks.
    colours: dict[bytes, bytes] = {}
    for line in finished_once.lines():
        inks = tifffile.imread(finished_once.out / line["file"]).reshape(-1, 4)
        with Image.open(finished_once.out / line["proof"]) as image:
            proof = np.asarray(image).reshape(-1, 3)
        for mixture, colour in zip(inks, proof, strict=True):
            assert colours.setdefault(mixture.tobytes(), colour.tobytes()) == colour.tobytes()
    assert len(set(colours.values())) > 100
