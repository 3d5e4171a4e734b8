"""Looking at a single image of a tile, for whoever holds it in their hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tilefab.config.line import LineFile
from tilefab.config.line import Tolerances as LineTolerances
from tilefab.errors import ConfigError, Problem
from tilefab.inspection.grading import Tolerances
from tilefab.io.icc import read_icc_profile
from tilefab.io.manifest import Manifest
from tilefab.pipeline.inspection.images import CameraImage, read_camera_image
from tilefab.pipeline.inspection.job_prints import JobPrints
from tilefab.pipeline.inspection.known_faces import KnownFaces
from tilefab.pipeline.inspection.one_tile import InspectedTile, TileInspector
from tilefab.pipeline.inspection.predicting import PredictedFaces
from tilefab.pipeline.maps import JobMaps, job_maps
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.selection import parse_faces

MOST_CANDIDATES = 200_000
"""More faces than these are looked among only if they are named: each takes milliseconds once."""

DEFAULT_REGION_MM = 4.0


@dataclass(frozen=True)
class Looking:
    """How to look at an image.

    Attributes
    ----------
    faces
        Faces that it may show, as `tilefab.pipeline.selection.parse_faces` reads them; ``None``: those that are on
        record as printed, and if it is none of them, all of the job.
    px_per_mm
        Calibration of the image; ``None``: that of the line's camera, if a line is named.
    camera_profile
        ICC profile of the camera, which overrides the image's and the line's.
    """

    faces: str | None = None
    px_per_mm: float | None = None
    camera_profile: Path | None = None


@dataclass(frozen=True, eq=False)
class LookedAt:
    """A tile that was looked at.

    Attributes
    ----------
    image
        Its image.
    maps
        The job's.
    tile
        What was found out.
    prints
        Prints of the job on the line, if one was named.
    candidates
        How many faces it was looked for among.
    """

    image: CameraImage
    maps: JobMaps
    tile: InspectedTile
    prints: JobPrints | None
    candidates: int


def look_at(
    path: Path,
    plan: Plan,
    looking: Looking,
    line_file: LineFile | None,
    progress: Progress,
    threads: int | None = None,
) -> LookedAt:
    """Recognise and measure the tile in an image.

    Parameters
    ----------
    path
        The image.
    plan
        The job that it may be of.
    looking
        How to look.
    line_file
        The line that printed it, whose journal narrows down what it can be; ``None``: not asked.
    progress, threads
        Who watches, and for making maps.

    Raises
    ------
    ImageError, ProfileError
        If the image can't be read.
    ConfigError
        If faces are named that the job doesn't have, or there are too many to look among.
    JournalError
        If the line's journal can't be read or knows nothing of the job.
    """
    image = read_image(path, looking, line_file)
    prints = None if line_file is None else JobPrints(plan, line_file, progress)
    candidates = candidate_faces(plan, looking.faces, prints)
    maps = job_maps(plan, progress, threads)
    faces = PredictedFaces(plan, maps)
    known = KnownFaces(faces, progress)
    region_mm = DEFAULT_REGION_MM if line_file is None else line_file.line.inspection.region_mm
    inspector = TileInspector(faces, tolerances_of(None if line_file is None else line_file.line.tolerances), region_mm)
    printed_with = None if prints is None else prints.printed_with
    tile = inspector.inspect(image, known.index(candidates), printed_with)
    count = plan.job.tile.count
    seen = tile.inspection.recognition
    if seen.face is None and seen.problem is None and looking.faces is None and len(candidates) < count:
        # Not every print is on record: proofs alone may be, or a journal was lost for a while.
        if count > MOST_CANDIDATES:
            reason = f"{seen.reason}; of {count:,} faces those {len(candidates):,} on record: name others with --faces"
            noted = replace(tile.inspection, recognition=replace(seen, reason=reason), reasons=(reason,))
            return LookedAt(image, maps, replace(tile, inspection=noted), prints, len(candidates))
        candidates = range(count)
        tile = inspector.inspect(image, known.index(candidates), printed_with)
    return LookedAt(image, maps, tile, prints, len(candidates))


def read_image(path: Path, looking: Looking, line_file: LineFile | None) -> CameraImage:
    """Read an image, with the calibration that is named, or the line's."""
    camera = None if line_file is None else line_file.line.camera
    profile_path = looking.camera_profile or (None if line_file is None else line_file.camera_profile)
    profile = None if profile_path is None else read_icc_profile(profile_path).data
    px_per_mm = looking.px_per_mm or (None if camera is None else camera.px_per_mm)
    return read_camera_image(path, profile=profile, px_per_mm=px_per_mm)


def candidate_faces(plan: Plan, text: str | None, prints: JobPrints | None) -> Sequence[int]:
    """Faces that a tile may show: those named, else those printed on the line or into files, else all of the job."""
    count = plan.job.tile.count
    if text is not None:
        chosen = parse_faces(text, count)
    elif prints is not None:
        chosen = prints.faces
    else:
        recorded = Manifest(plan.output).records
        chosen = sorted(recorded) if recorded else range(count)
    if len(chosen) > MOST_CANDIDATES:
        message = f"{len(chosen):,} faces are too many to look among at once: name up to {MOST_CANDIDATES:,} of them"
        raise ConfigError([Problem("--faces", None, "", message)])
    return chosen


def tolerances_of(stated: LineTolerances | None) -> Tolerances:
    """Tolerances of a line's file, or those that hold without one."""
    return Tolerances() if stated is None else Tolerances(**stated.model_dump())
