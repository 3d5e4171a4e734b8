"""A run: every wanted face rendered, written, recorded; resumable; never two truths about one face."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import tilefab
from tilefab.errors import ImageError, OutputError
from tilefab.io.atomic import atomic_write_bytes, make_folder, remove_leftovers
from tilefab.io.faces import pixel_hash, read_print_pixels, write_preview, write_print_tiff
from tilefab.io.manifest import JOB_RECORD_NAME, FaceRecord, Manifest, locked_folder
from tilefab.pipeline.faces import (
    FACES_FOLDER,
    PROOFS_FOLDER,
    PlannedFace,
    face_region,
    plan_face,
    print_tags,
    render_planned,
)
from tilefab.pipeline.maps import JobMaps, check_owner, job_maps, proof_map
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.pipeline.progress import Progress
from tilefab.sampling import TextureMap
from tilefab.types import Array

STAGE = "Printing faces"


@dataclass(frozen=True)
class RunResult:
    """What a run did.

    Attributes
    ----------
    output
        The run's folder.
    faces
        Faces asked for.
    written, kept
        How many of them were written now, and were there already.
    maps
        The job's maps.
    """

    output: Path
    faces: int
    written: int
    kept: int
    maps: JobMaps


def run_job(
    plan: Plan,
    indices: Sequence[int],
    progress: Progress,
    *,
    threads: int | None = None,
    verify: bool = False,
) -> RunResult:
    """Make faces and record them.

    Parameters
    ----------
    plan
        The job.
    indices
        Faces to make, in this order.
    progress
        Told of the progress.
    threads
        For rendering; never changes a pixel.
    verify
        Also read faces that are there already and compare them with what they should be.

    Raises
    ------
    OutputError
        If the folder belongs to another job or run, can't be written, or holds a face with other pixels.
    ImageError, ProfileError, SynthesisError
        If the texture map can't be made.
    """
    with locked_folder(plan.output):
        manifest = Manifest(plan.output, repair=True)
        _check_folder(plan, manifest)
        maps = job_maps(plan, progress, threads, must_keep=True)
        # Only now: a folder in which nothing could be printed stays free for the job with its faults put right.
        claim_folder(plan)
        run = _Run(plan, maps, manifest, threads, verify)
        written = 0
        for done, index in enumerate(indices):
            progress.stage(STAGE, done / len(indices))
            written += run.make(index)
        progress.stage(STAGE, 1.0)
    return RunResult(plan.output, len(indices), written, len(indices) - written, maps)


def _check_folder(plan: Plan, manifest: Manifest) -> None:
    """Make sure that the folder is this job's or nobody's, and clear away what a killed run left."""
    check_owner(plan)
    if {record.job for record in manifest.records.values()} - {plan.job_hash}:
        raise OutputError(
            f"{manifest.path}: records faces of another job, or of this job with other settings; use another folder "
            "(--out DIR), or remove this one",
            path=str(manifest.path),
        )
    for name in ("", FACES_FOLDER, PROOFS_FOLDER, MAPS_FOLDER):
        if (plan.output / name).is_dir():
            remove_leftovers(plan.output / name)


def claim_folder(plan: Plan) -> None:
    """Say in the folder that it is this job's."""
    path = plan.output / JOB_RECORD_NAME
    if not path.exists():
        facts = {
            "job": plan.job_hash,
            "name": plan.name,
            "tilefab": tilefab.__version__,
            "settings": plan.job.model_dump(mode="json"),
        }
        atomic_write_bytes(path, (json.dumps(facts, indent=2, ensure_ascii=False) + "\n").encode())


class _Run:
    def __init__(self, plan: Plan, maps: JobMaps, manifest: Manifest, threads: int | None, verify: bool) -> None:
        self.plan, self.press, self.texture, self.manifest = plan, maps.press, maps.texture, manifest
        self.threads, self.verify = threads, verify
        self.buffer: Array | None = None
        self._proof: TextureMap | None = None
        self._last: tuple[int, PlannedFace] | None = None
        self.digits = max(6, len(str(plan.job.tile.count - 1)))
        make_folder(plan.output / FACES_FOLDER)
        if plan.job.output.proofs:
            make_folder(plan.output / PROOFS_FOLDER)

    def make(self, index: int) -> bool:
        """Make one face unless it is there; whether anything was written."""
        record = self.manifest.records.get(index)
        path = self.plan.output / FACES_FOLDER / f"face_{index:0{self.digits}d}.tif"
        if record is not None:
            path = self.plan.output / record.file
            if (record.texture_map, record.press_map) != (self.texture.hash, self.press.hash):
                raise OutputError(
                    f"{self.manifest.path}: face {index} was printed from another texture map; use another output "
                    "folder, or put the map it was printed from back into its maps folder",
                    path=str(self.manifest.path),
                )
        present = path.exists()
        wrote_proof = False
        if record is None or not present or self.verify:
            pixels = render_planned(self.plan, self.press, self._planned(index), threads=self.threads, out=self.buffer)
            self.buffer = pixels
            digest = pixel_hash(pixels)
            expected = self._record(index, path, pixels, digest)
            if record is not None and record.sha256 != digest:
                raise _contradiction(path, index, "the manifest records other pixels than the job now gives")
            if record is not None and replace(record, proof=expected.proof) != expected:
                raise _contradiction(path, index, "the manifest records other facts of it than the job now gives")
            if present and not _holds(path, pixels):
                raise _contradiction(path, index, "the file holds other pixels than the job gives")
            if not present:
                write_print_tiff(path, pixels, print_tags(self.plan, self.press, index))
            if record is None:
                if expected.proof is not None:
                    self._proof_file(index, self.plan.output / expected.proof)
                self.manifest.append(expected)
                return True
        if record is not None and record.proof is not None and self.plan.job.output.proofs:
            wrote_proof = self._proof_file(index, self.plan.output / record.proof)
        return not present or wrote_proof

    def _planned(self, index: int) -> PlannedFace:
        """What a face shows, found once for its print data and its proof."""
        if self._last is None or self._last[0] != index:
            self._last = index, plan_face(self.plan, self.press, index, threads=self.threads)
        return self._last[1]

    def _record(self, index: int, path: Path, pixels: Array, digest: str) -> FaceRecord:
        region = face_region(self.plan, self.press, index)
        rows, cols, channels = pixels.shape
        record = FaceRecord(
            face=index,
            file=path.relative_to(self.plan.output).as_posix(),
            rows=rows,
            cols=cols,
            channels=channels,
            dtype=str(pixels.dtype),
            dpi=self.plan.job.tile.dpi,
            origin=[region.row, region.col],
            sha256=digest,
            texture_map=self.texture.hash,
            press_map=self.press.hash,
            press_profile=self.plan.press_profile.sha256,
            job=self.plan.job_hash,
            seed=self.plan.seed,
        )
        if self.plan.job.output.proofs:
            record = replace(record, proof=f"{PROOFS_FOLDER}/{path.stem}.png")
        return record

    def _proof_file(self, index: int, path: Path) -> bool:
        """Make the proof of one face unless it is there; whether it was made."""
        if path.exists():
            return False
        if self._proof is None:
            self._proof = proof_map(self.plan, self.press, self.threads)
        rgb = render_planned(self.plan, self._proof, self._planned(index), threads=self.threads)
        write_preview(path, rgb, self.plan.job.tile.dpi)
        return True


def _holds(path: Path, pixels: Array) -> bool:
    try:
        return bool(np.array_equal(read_print_pixels(path), pixels))
    except ImageError:
        return False


def _contradiction(path: Path, index: int, what: str) -> OutputError:
    return OutputError(
        f"{path}: face {index}: {what}; nothing was overwritten: move the file away and run again, or use another "
        "output folder",
        path=str(path),
    )
