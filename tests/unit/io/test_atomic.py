"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from tilefab.errors import OutputError
from tilefab.io import atomic
from tilefab.io.atomic import TEMPORARY_PREFIX, atomic_path, atomic_write_bytes, make_folder, remove_leftovers


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_file_is_written_and_nothing_else_stays(tmp_path: Path) -> None:
    atomic_write_bytes(tmp_path / "new" / "folder" / "a.bin", b"stone")
    assert (tmp_path / "new" / "folder" / "a.bin").read_bytes() == b"stone"
    assert names(tmp_path / "new" / "folder") == {"a.bin"}


def test_the_umask_decides_who_may_read_it(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        atomic_write_bytes(tmp_path / "a.bin", b"x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.bin").stat().st_mode) == 0o640


def test_the_temporary_file_lies_beside_with_the_same_ending(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a.tif") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".tif"
        assert temporary.name.startswith(TEMPORARY_PREFIX)
        assert not (tmp_path / "a.tif").exists()
        temporary.write_bytes(b"1")
    assert names(tmp_path) == {"a.tif"}


@pytest.mark.parametrize("error", [ValueError("a defect"), KeyboardInterrupt(), MemoryError()])
def test_an_exception_leaves_the_earlier_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"earlier")

    def fail() -> None:
        with atomic_path(path) as temporary:
            temporary.write_bytes(b"half")
            raise error

    with pytest.raises(type(error)):
        fail()
    assert path.read_bytes() == b"earlier"
    assert names(tmp_path) == {"a.bin"}


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "disk is full"),
        (errno.EDQUOT, "quota"),
        (errno.EROFS, "read-only"),
        (errno.EIO, os.strerror(errno.EIO)),
    ],
)
def test_a_write_that_fails_on_sync_leaves_the_earlier_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, advice: str
) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"earlier")

    def refuse(_: int) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(atomic.os, "fsync", refuse)
    with pytest.raises(OutputError) as caught:
        atomic_write_bytes(path, b"later")
    assert advice in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.path == str(path)
    assert caught.value.exit_code == 8
    assert path.read_bytes() == b"earlier"
    assert names(tmp_path) == {"a.bin"}


def test_a_write_cut_short_without_a_reason_asks_about_the_disk(tmp_path: Path) -> None:
    # NumPy's tofile raises such an error when a disk is full.
    def fail() -> None:
        with atomic_path(tmp_path / "a.tif"):
            raise OSError("12444 requested and 0 written")

    with pytest.raises(OutputError, match="is the disk full"):
        fail()
    assert names(tmp_path) == set()


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    program = (
        "import resource, sys\n"
        "from pathlib import Path\n"
        "from tilefab.io.atomic import atomic_write_bytes\n"
        "from tilefab.errors import OutputError\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    atomic_write_bytes(Path(sys.argv[1]), bytes(5000))\n"
        "except OutputError as error:\n"
        "    print(error.message)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "a.bin")], capture_output=True, text=True, check=True
    )
    assert "larger than is allowed" in done.stdout
    assert names(tmp_path) == set()


def test_a_folder_below_a_file_can_t_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="a file, not a folder"):
        make_folder(tmp_path / "file" / "folder")
    with pytest.raises(OutputError, match="a file, not a folder"):
        atomic_write_bytes(tmp_path / "file" / "folder" / "a.bin", b"x")


def test_a_folder_in_the_way_stays(tmp_path: Path) -> None:
    (tmp_path / "a.bin").mkdir()
    with pytest.raises(OutputError, match=r"a\.bin: can't write: .* is in the way"):
        atomic_write_bytes(tmp_path / "a.bin", b"x")
    assert names(tmp_path) == {"a.bin"}


def test_leftovers_of_a_killed_process_are_removed_and_nothing_else(tmp_path: Path) -> None:
    for name in (f"{TEMPORARY_PREFIX}abc.tif", f"{TEMPORARY_PREFIX}def", "face_000000.tif", ".lock"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / f"{TEMPORARY_PREFIX}folder").mkdir()
    remove_leftovers(tmp_path)
    assert names(tmp_path) == {"face_000000.tif", ".lock", f"{TEMPORARY_PREFIX}folder"}
