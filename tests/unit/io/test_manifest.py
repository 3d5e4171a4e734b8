"""The record of a run: never half a line, never two truths, never two writers."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tilefab.errors import OutputError
from tilefab.io import manifest as module
from tilefab.io.manifest import LOCK_NAME, MANIFEST_NAME, FaceRecord, Manifest, locked_folder

FIELDS = [
    *("face", "file", "rows", "cols", "channels", "dtype", "dpi", "origin", "sha256"),
    *("texture_map", "press_map", "press_profile", "job", "seed", "proof"),
]


def record(face: int = 0, **changes: object) -> FaceRecord:
    made = FaceRecord(
        face=face,
        file=f"faces/face_{face:06d}.tif",
        rows=61,
        cols=51,
        channels=4,
        dtype="uint8",
        dpi=60.0,
        origin=[-76741258, 5],
        sha256=f"{face:064x}",
        texture_map="a" * 64,
        press_map="b" * 64,
        press_profile="c" * 64,
        job="d" * 64,
        seed=7,
        proof=f"proofs/face_{face:06d}.png",
    )
    return replace(made, **changes)


def filled(folder: Path, count: int = 3) -> bytes:
    manifest = Manifest(folder)
    for face in range(count):
        manifest.append(record(face))
    return manifest.path.read_bytes()


def test_records_come_back(tmp_path: Path) -> None:
    filled(tmp_path)
    assert Manifest(tmp_path).records == {face: record(face) for face in range(3)}


def test_a_folder_without_a_manifest_has_no_records_and_gets_none(tmp_path: Path) -> None:
    assert Manifest(tmp_path, repair=True).records == {}
    assert list(tmp_path.iterdir()) == []


def test_a_line_holds_exactly_the_documented_fields(tmp_path: Path) -> None:
    lines = filled(tmp_path, 2).decode().splitlines()
    assert len(lines) == 2
    for line in lines:
        assert list(json.loads(line)) == FIELDS
    assert json.loads(lines[1])["origin"] == [-76741258, 5]


def test_fields_of_a_later_version_are_passed_over(tmp_path: Path) -> None:
    line = json.loads(filled(tmp_path, 1)) | {"kiln": 3}
    (tmp_path / MANIFEST_NAME).write_text(json.dumps(line) + "\n")
    assert Manifest(tmp_path).records == {0: record(0)}


def test_a_torn_last_line_is_dropped_at_every_length(tmp_path: Path) -> None:
    whole = filled(tmp_path, 2)
    path = tmp_path / MANIFEST_NAME
    first = whole[: whole.index(b"\n") + 1]
    for size in range(len(first), len(whole), 13):
        path.write_bytes(whole[:size])
        assert set(Manifest(tmp_path).records) == {0}
        assert path.read_bytes() == whole[:size], "only who holds the folder may change it"
        held = Manifest(tmp_path, repair=True)
        assert path.read_bytes() == first
        held.append(record(1))
        assert path.read_bytes() == whole


def test_a_manifest_of_only_half_a_line_is_empty(tmp_path: Path) -> None:
    whole = filled(tmp_path, 1)
    (tmp_path / MANIFEST_NAME).write_bytes(whole[:40])
    assert Manifest(tmp_path, repair=True).records == {}
    assert (tmp_path / MANIFEST_NAME).read_bytes() == b""


def changed(**changes: object) -> bytes:
    return json.dumps({name: getattr(record(5), name) for name in FIELDS} | changes).encode()


@pytest.mark.parametrize(
    "garbage",
    [
        b"",
        b"garbage",
        b"{}",
        b"[]",
        b"7",
        b"null",
        b'"face"',
        b"\xff\xfe\x00",
        b'{"face": 1}',
        b"[" * 50_000,
        changed(face="5"),
        changed(face=[5]),
        changed(face=True),
        changed(face=5.0),
        changed(face=None),
        changed(file=5),
        changed(file="/etc/face_000000.tif"),
        changed(file="../other/face_000000.tif"),
        changed(proof="faces/../../face.png"),
        changed(proof=7),
        changed(origin="0, 0"),
        changed(sha256=None),
        changed(dpi="60"),
    ],
)
@pytest.mark.parametrize("position", [0, 1, 3])
def test_garbage_is_refused_with_its_line_and_kept(tmp_path: Path, garbage: bytes, position: int) -> None:
    lines = filled(tmp_path).splitlines(keepends=True)
    lines.insert(position, garbage + b"\n")
    path = tmp_path / MANIFEST_NAME
    path.write_bytes(b"".join(lines))
    with pytest.raises(OutputError) as caught:
        Manifest(tmp_path, repair=True)
    assert caught.value.message.startswith(f"{path}:{position + 1}: not a line of a manifest")
    assert caught.value.exit_code == 8
    assert path.read_bytes() == b"".join(lines)


def test_two_truths_about_a_face_are_refused(tmp_path: Path) -> None:
    whole = filled(tmp_path)
    path = tmp_path / MANIFEST_NAME
    path.write_bytes(whole + json.dumps(record(1, sha256="f" * 64).__dict__).encode() + b"\n")
    with pytest.raises(OutputError, match=r"jsonl:4: face 1 is recorded twice with different pixels"):
        Manifest(tmp_path)


def test_the_same_truth_twice_is_one(tmp_path: Path) -> None:
    whole = filled(tmp_path)
    (tmp_path / MANIFEST_NAME).write_bytes(whole + whole)
    assert len(Manifest(tmp_path).records) == 3


def test_a_manifest_that_is_a_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / MANIFEST_NAME).mkdir()
    with pytest.raises(OutputError, match="can't be read"):
        Manifest(tmp_path)


@pytest.mark.parametrize(("number", "advice"), [(errno.ENOSPC, "disk is full"), (errno.EIO, os.strerror(errno.EIO))])
def test_a_line_that_can_t_be_synced_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, advice: str
) -> None:
    whole = filled(tmp_path)
    manifest = Manifest(tmp_path)

    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    with monkeypatch.context() as patch:
        patch.setattr(module.os, "fsync", refuse)
        with pytest.raises(OutputError, match=f"can't record a face: .*{advice}"):
            manifest.append(record(3))
    assert manifest.path.read_bytes() == whole
    assert 3 not in manifest.records
    manifest.append(record(3))
    assert set(Manifest(tmp_path).records) == {0, 1, 2, 3}


def test_a_disk_that_fills_up_within_a_line_leaves_nothing_of_it(tmp_path: Path) -> None:
    whole = filled(tmp_path)
    program = (
        "import resource, sys\n"
        "from dataclasses import replace\n"
        "from pathlib import Path\n"
        "from tilefab.errors import OutputError\n"
        "from tilefab.io.manifest import Manifest\n"
        "folder = Path(sys.argv[1])\n"
        "manifest = Manifest(folder)\n"
        "size = manifest.path.stat().st_size + 100\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))\n"
        "try:\n"
        "    manifest.append(replace(manifest.records[0], face=9))\n"
        "except OutputError as error:\n"
        "    print(error.message, 9 in manifest.records)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=True)
    assert "can't record a face" in done.stdout
    assert "False" in done.stdout
    assert (tmp_path / MANIFEST_NAME).read_bytes() == whole


def test_a_line_that_goes_out_in_pieces_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.open

    class Slow:
        """A file of which each write takes 10 bytes at most, as a signal or a pipe may have it."""

        def __init__(self, file: object) -> None:
            self.file = file

        def __enter__(self) -> Slow:
            return self

        def __exit__(self, *_: object) -> None:
            self.file.close()

        def __getattr__(self, name: str) -> object:
            return getattr(self.file, name)

        def write(self, data: bytes) -> int:
            return self.file.write(data[:10])

    manifest = Manifest(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", lambda self, *args, **kwargs: Slow(real(self, *args, **kwargs)))
        manifest.append(record(0))
        manifest.append(record(1))
    assert Manifest(tmp_path).records == {0: record(0), 1: record(1)}


def test_only_one_run_holds_a_folder(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "out"
    with locked_folder(folder):
        assert (folder / LOCK_NAME).exists()
        with pytest.raises(OutputError, match="another run is writing to this folder"), locked_folder(folder):
            pass
        program = (
            "import sys\n"
            "from pathlib import Path\n"
            "from tilefab.errors import OutputError\n"
            "from tilefab.io.manifest import locked_folder\n"
            "try:\n"
            "    with locked_folder(Path(sys.argv[1])):\n"
            "        print('held twice')\n"
            "except OutputError as error:\n"
            "    print(error.message)\n"
        )
        other = subprocess.run([sys.executable, "-c", program, str(folder)], capture_output=True, text=True, check=True)
        assert "another run is writing to this folder" in other.stdout
    with locked_folder(folder):
        pass


def test_a_killed_holder_lets_go(tmp_path: Path) -> None:
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from tilefab.io.manifest import locked_folder\n"
        "with locked_folder(Path(sys.argv[1])):\n"
        "    print('held', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(OutputError), locked_folder(tmp_path):
            pass
        holder.kill()
    with locked_folder(tmp_path):
        pass


def test_a_folder_that_can_t_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="a file, not a folder"), locked_folder(tmp_path / "file" / "out"):
        pass
    (tmp_path / "out" / LOCK_NAME).mkdir(parents=True)
    with pytest.raises(OutputError, match="can't write to this folder"), locked_folder(tmp_path / "out"):
        pass
