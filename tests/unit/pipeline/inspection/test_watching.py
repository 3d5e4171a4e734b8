"""New images are told of once they are whole, in the order they were taken, and nothing else is."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tilefab.pipeline.inspection import watching as module
from tilefab.pipeline.inspection.watching import CameraFolder, ImageFile, thinned, time_in_name

WHEN = datetime(2026, 11, 24, 8, 30, 15, 250_000, tzinfo=UTC)


def name_of(number: int) -> str:
    at = WHEN + timedelta(seconds=number)
    return f"{at:%Y%m%dT%H%M%S}.250Z_{number}.png"


def put(folder: Path, name: str, data: bytes = b"image") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def nothing_done(names: Sequence[str]) -> frozenset[str]:
    return frozenset()


def names(images: Sequence[ImageFile]) -> list[str]:
    return [image.name for image in images]


def settled(camera: CameraFolder) -> list[str]:
    camera.look()
    return names(camera.look())


@pytest.mark.parametrize(
    ("name", "at"),
    [
        ("20261124T083015.250Z_1.png", WHEN),
        ("20261124T083015Z.tif", WHEN.replace(microsecond=0)),
        ("20261124T083015.250Z.jpeg", WHEN),
        ("20261124T083015.250Zulu.png", None),
        ("20261324T083015.250Z_1.png", None),
        ("20261124T083015.250.png", None),
        ("tile 20261124T083015Z.png", None),
        ("", None),
    ],
)
def test_names_tell_when_an_image_was_taken(name: str, at: datetime | None) -> None:
    assert time_in_name(name) == at


def test_images_come_in_the_order_they_were_taken(tmp_path: Path) -> None:
    for number in (3, 1, 2):
        put(tmp_path, name_of(number))
    camera = CameraFolder(tmp_path, nothing_done)
    assert camera.look() == []
    assert names(camera.look()) == [name_of(1), name_of(2), name_of(3)]


def test_without_a_time_in_its_name_the_files_own_counts(tmp_path: Path) -> None:
    path = put(tmp_path, "tile.png")
    os.utime(path, (WHEN.timestamp(), WHEN.timestamp()))
    camera = CameraFolder(tmp_path, nothing_done)
    camera.look()
    assert camera.look() == [ImageFile("tile.png", path, WHEN)]


def test_an_image_that_is_being_written_is_waited_for(tmp_path: Path) -> None:
    camera = CameraFolder(tmp_path, nothing_done)
    for length in range(1, 5):
        path = put(tmp_path, name_of(1), b"x" * length)
        os.utime(path, ns=(length, length))
        assert camera.look() == []
    assert names(camera.look()) == [name_of(1)]


def test_an_empty_file_is_given_long_to_fill(tmp_path: Path) -> None:
    camera = CameraFolder(tmp_path, nothing_done)
    put(tmp_path, name_of(1), b"")
    looks = [names(camera.look()) for _ in range(20)]
    assert looks[:19] == [[]] * 19
    assert looks[19] == [name_of(1)]


def test_rubbish_is_let_be(tmp_path: Path) -> None:
    for name in (".hidden.png", "notes.txt", "image.png.part", "x" * 201 + ".png", "Thumbs.db"):
        put(tmp_path, name)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "nowhere.png").symlink_to(tmp_path / "gone")
    os.mkfifo(tmp_path / "pipe.png")
    put(tmp_path, name_of(1))
    put(tmp_path, "UPPER.PNG")
    camera = CameraFolder(tmp_path, nothing_done)
    assert set(settled(camera)) == {name_of(1), "UPPER.PNG"}


def test_what_is_done_is_asked_once_and_never_told_of(tmp_path: Path) -> None:
    asked: list[str] = []

    def done(names: Sequence[str]) -> frozenset[str]:
        asked.extend(names)
        return frozenset({name_of(1)}) & set(names)

    put(tmp_path, name_of(1))
    put(tmp_path, name_of(2))
    camera = CameraFolder(tmp_path, done)
    assert settled(camera) == [name_of(2)]
    camera.finish([name_of(2)])
    put(tmp_path, name_of(3))
    assert settled(camera) == [name_of(3)]
    assert sorted(asked) == [name_of(1), name_of(2), name_of(3)]


def test_a_name_that_comes_again_after_it_was_removed_is_asked_about_again(tmp_path: Path) -> None:
    camera = CameraFolder(tmp_path, nothing_done)
    path = put(tmp_path, name_of(1))
    assert settled(camera) == [name_of(1)]
    camera.finish([name_of(1)])
    path.unlink()
    assert settled(camera) == []
    put(tmp_path, name_of(1))
    assert settled(camera) == [name_of(1)]


def test_a_folder_that_is_missing_is_told_and_may_come(tmp_path: Path) -> None:
    camera = CameraFolder(tmp_path / "camera", nothing_done)
    assert camera.look() == []
    assert "camera: No such file" in camera.problem
    (tmp_path / "camera").mkdir()
    put(tmp_path / "camera", name_of(1))
    assert settled(camera) == [name_of(1)]
    assert camera.problem == ""
    (tmp_path / "file").touch()
    camera = CameraFolder(tmp_path / "file", nothing_done)
    assert camera.look() == []
    assert "Not a directory" in camera.problem


def test_an_image_that_cant_be_read_is_tried_less_and_less_often_then_given_up(tmp_path: Path) -> None:
    put(tmp_path, name_of(1))
    camera = CameraFolder(tmp_path, nothing_done)
    tried: list[int] = []
    for look in range(60):
        if names(camera.look()):
            tried.append(look)
            if not camera.retry(name_of(1)):
                break
    gaps = [after - before for before, after in itertools.pairwise(tried)]
    assert len(tried) == 4
    assert gaps == sorted(gaps)
    assert gaps[-1] >= 8
    assert not camera.retry("unknown.png")


def test_a_full_folder_is_listed_when_it_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MANY_NAMES", 3)
    scandir, listed = os.scandir, 0

    def counted(folder: Path) -> object:
        nonlocal listed
        listed += 1
        return scandir(folder)

    for number in range(5):
        put(tmp_path, name_of(number))
    os.utime(tmp_path, ns=(1, 1))
    camera = CameraFolder(tmp_path, nothing_done)
    camera.finish(settled(camera))
    monkeypatch.setattr(os, "scandir", counted)
    for _ in range(21):
        assert camera.look() == []
    assert listed == 1
    put(tmp_path, name_of(9))
    os.utime(tmp_path, ns=(2, 2))
    assert settled(camera) == [name_of(9)]
    camera.finish([name_of(9)])
    camera.look()
    put(tmp_path, name_of(10))
    os.utime(tmp_path, ns=(2, 2))
    assert any(names(camera.look()) == [name_of(10)] for _ in range(25))


def test_an_image_written_anew_is_waited_for_again(tmp_path: Path) -> None:
    path = put(tmp_path, name_of(1))
    camera = CameraFolder(tmp_path, nothing_done)
    assert settled(camera) == [name_of(1)]
    path.write_bytes(b"another image")
    assert camera.look() == []
    assert names(camera.look()) == [name_of(1)]


@given(many=st.integers(0, 300), most=st.integers(1, 60))
def test_thinning_is_even_keeps_the_newest_and_loses_nothing(many: int, most: int) -> None:
    images = [ImageFile(str(number), Path(str(number)), WHEN) for number in range(many)]
    kept, left = thinned(images, most)
    assert len(kept) <= most
    assert sorted(int(image.name) for image in [*kept, *left]) == list(range(many))
    places = [int(image.name) for image in kept]
    assert places == sorted(places)
    if many:
        assert places[-1] == many - 1
        steps = {after - before for before, after in itertools.pairwise(places)}
        assert len(steps) <= 1
