"""Fingerprints of a job's faces: made when they are first asked for, and kept beside the job's maps."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from tilefab.errors import OutputError
from tilefab.inspection.fingerprint import FINGERPRINT_VERSION, FingerprintIndex, fingerprints
from tilefab.io.fingerprint_file import SUFFIX, load_fingerprints, save_fingerprints
from tilefab.io.manifest import folder_owner
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.plan import MAPS_FOLDER
from tilefab.pipeline.progress import Progress

_STAGE = "Fingerprints of faces"
_AT_ONCE = 64
_KEPT_EVERY = 2000
"""A file is written once so many are new: writing it takes longer than making a few again."""


class KnownFaces:
    """Fingerprints of one job.

    Parameters
    ----------
    faces
        What its faces look like.
    progress
        Who watches.
    """

    def __init__(self, faces: PredictedFaces, progress: Progress) -> None:
        self._faces, self._progress = faces, progress
        self._index: FingerprintIndex | None = None
        self._rows: dict[int, int] = {}
        self._new = 0

    def index(self, faces: Sequence[int]) -> FingerprintIndex:
        """Fingerprints of some faces, in rising order; those not known yet are made, some milliseconds each.

        Parameters
        ----------
        faces
            Indices; each counts once.
        """
        wanted = np.unique(np.asarray(faces, dtype=np.int64))
        if self._index is None:
            self._load()
        self._make([face for face in wanted.tolist() if face not in self._rows])
        index = self._whole()
        rows = np.array([self._rows[face] for face in wanted.tolist()], dtype=np.int64)
        return FingerprintIndex(wanted, np.ascontiguousarray(index.codes[rows]), index.grid)

    def _whole(self) -> FingerprintIndex:
        if self._index is None:
            self._index = fingerprints(self._faces.lightness, [], self._faces.plan.tile_mm)
        return self._index

    def _make(self, missing: Sequence[int]) -> None:
        parts: list[FingerprintIndex] = []
        for first in range(0, len(missing), _AT_ONCE):
            if len(missing) > _AT_ONCE:
                self._progress.stage(_STAGE, first / len(missing))
            some = missing[first : first + _AT_ONCE]
            parts.append(fingerprints(self._faces.lightness, some, self._faces.plan.tile_mm))
        if not parts:
            return
        before = self._whole()
        codes = np.concatenate([before.codes, *(part.codes for part in parts)])
        numbers = np.concatenate([before.faces, *(part.faces for part in parts)])
        self._index = FingerprintIndex(numbers, codes, before.grid)
        for row in range(len(before), len(numbers)):
            self._rows[int(numbers[row])] = row
        self._new += len(missing)
        if len(missing) > _AT_ONCE:
            self._progress.stage(_STAGE, 1.0)
        if self._new >= _KEPT_EVERY:
            self._save()

    def _load(self) -> None:
        found = load_fingerprints(self._path, self._key)
        if found is not None:
            self._index = found
            self._rows = {face: row for row, face in enumerate(found.faces.tolist())}

    def _save(self) -> None:
        plan = self._faces.plan
        if self._index is None or not self._path.parent.is_dir():
            return
        # Whoever can't write there, or looks on at another's folder, makes them again next time.
        with suppress(OutputError):
            if folder_owner(plan.output) in (None, plan.job_hash):
                save_fingerprints(self._path, self._index, self._key)
                self._new = 0

    @property
    def _key(self) -> str:
        plan = self._faces.plan
        tile = plan.job.tile
        facts = (FINGERPRINT_VERSION, self._faces.maps.texture.hash, plan.seed, *tile.size_mm, tile.dpi, tile.bleed_mm)
        return f"{facts} {tile.layout} {tile.columns}"

    @property
    def _path(self) -> Path:
        plan = self._faces.plan
        digest = hashlib.sha256(self._key.encode()).hexdigest()
        return plan.output / MAPS_FOLDER / f"{digest[:16]}{SUFFIX}"
