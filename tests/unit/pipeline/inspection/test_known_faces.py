"""Fingerprints are made once, kept, and never those of another job."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tilefab.io.fingerprint_file import load_fingerprints, save_fingerprints
from tilefab.pipeline.inspection import known_faces
from tilefab.pipeline.inspection.known_faces import KnownFaces
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.progress import Silent
from tilefab.types import SizeMm


class Faces:
    """Faces of noise, and how often each was rendered."""

    def __init__(self, output: Path, seed: int = 1) -> None:
        tile = SimpleNamespace(size_mm=[60.0, 40.0], dpi=60.0, bleed_mm=0.0, layout="scatter", columns=None)
        self.plan = SimpleNamespace(
            tile_mm=SizeMm(60.0, 40.0), output=output, seed=seed, job_hash="j", job=SimpleNamespace(tile=tile)
        )
        self.maps = SimpleNamespace(texture=SimpleNamespace(hash="m"))
        self.rendered: list[int] = []

    def lightness(self, face: int, long_px: int) -> Any:
        self.rendered.append(face)
        noise = np.random.default_rng([self.plan.seed, face]).random((2 * long_px // 3, long_px))
        return (100.0 * noise).astype(np.float32)


def known(faces: Faces) -> KnownFaces:
    return KnownFaces(cast(PredictedFaces, faces), Silent())


def test_each_face_is_rendered_once(tmp_path: Path) -> None:
    faces = Faces(tmp_path)
    some = known(faces)
    first = some.index([5, 2, 9, 5])
    assert first.faces.tolist() == [2, 5, 9]
    again = some.index([9, 4, 2])
    assert again.faces.tolist() == [2, 4, 9]
    assert sorted(faces.rendered) == [2, 4, 5, 9]
    assert np.array_equal(again.codes[[0, 2]], first.codes[[0, 2]])
    assert len(some.index([])) == 0


def test_they_are_kept_beside_the_maps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "maps").mkdir()
    monkeypatch.setattr(known_faces, "_KEPT_EVERY", 3)
    made = known(Faces(tmp_path)).index(range(4))
    faces = Faces(tmp_path)
    assert np.array_equal(known(faces).index([3, 1]).codes, made.codes[[1, 3]])
    assert faces.rendered == []
    # Of another seed, other faces: what is kept isn't theirs.
    other = Faces(tmp_path, seed=2)
    known(other).index([3])
    assert other.rendered == [3]


def test_a_damaged_file_is_made_anew(tmp_path: Path) -> None:
    index = known(Faces(tmp_path)).index(range(3))
    path = tmp_path / "x.fingerprints.npz"
    save_fingerprints(path, index, "key")
    whole = path.read_bytes()
    found = load_fingerprints(path, "key")
    assert found is not None
    assert np.array_equal(found.codes, index.codes)
    assert load_fingerprints(path, "another") is None
    assert load_fingerprints(tmp_path / "none", "key") is None
    for damaged in (b"", whole[:40], whole[: len(whole) // 2], b"no archive", bytes(len(whole))):
        path.write_bytes(damaged)
        assert load_fingerprints(path, "key") is None
