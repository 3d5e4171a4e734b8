"""One face: its place, its pixels, its code, its files."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import OutputError
from tilefab.io.faces import PREVIEW_SUFFIXES, PrintTags, pixel_hash, write_preview, write_print_tiff
from tilefab.io.manifest import JOB_RECORD_NAME, MANIFEST_NAME, Manifest
from tilefab.pipeline.maps import JobMaps, proof_map
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.sampling import CropMap, CropPlan, Region, TextureMap, plan_region, render, render_plan
from tilefab.types import Array

_CODE = re.compile(r"^tilefab face=(\d{1,40}) .*\bjob=([0-9a-f]{32})\b")
_CODE_DIGITS = 32
FACES_FOLDER = "faces"
PROOFS_FOLDER = "proofs"
_TIFF_SUFFIXES = (".tif", ".tiff")


@dataclass(frozen=True)
class FaceCode:
    """What a face's code says: which face of which job."""

    index: int
    job: str


def face_region(plan: Plan, texture: TextureMap, index: int) -> Region:
    """Region of the plane that a face shows, bleed included."""
    return plan.layout(texture).face(index)


@dataclass(frozen=True, eq=False)
class PlannedFace:
    """A face's region, and for crops what shows where: made once, rendered from every map of the job.

    Attributes
    ----------
    region
        Of the plane.
    crops
        See `tilefab.sampling.plan_region`; ``None`` for other designs.
    """

    region: Region
    crops: CropPlan | None


def plan_face(
    plan: Plan, texture: TextureMap, index: int, *, threads: int | None = None, bleed: bool = True
) -> PlannedFace:
    """Find out what a face shows, from any of the job's maps."""
    whole = face_region(plan, texture, index)
    margin = 0 if bleed else plan.bleed_px
    region = Region(whole.row + margin, whole.col + margin, whole.rows - 2 * margin, whole.cols - 2 * margin)
    if not isinstance(texture, CropMap):
        return PlannedFace(region, None)
    workers = threads or os.cpu_count() or 1
    place = (region.row, region.col, region.rows, region.cols)
    return PlannedFace(region, plan_region(texture, *place, seed=plan.seed, threads=workers))


def render_planned(
    plan: Plan, texture: TextureMap, face: PlannedFace, *, threads: int | None = None, out: Array | None = None
) -> Array:
    """Pixels of a planned face from any of the job's maps."""
    if face.crops is not None and isinstance(texture, CropMap):
        return render_plan(texture, face.crops, out=out, threads=threads)
    region = face.region
    return render(texture, region.row, region.col, region.rows, region.cols, seed=plan.seed, out=out, threads=threads)


def render_strip(
    plan: Plan, texture: TextureMap, face: PlannedFace, first: int, out: Array, *, threads: int | None = None
) -> Array:
    """Rows ``first`` on of a planned face, as many as ``out`` has: the same pixels as in the whole face."""
    if face.crops is not None and isinstance(texture, CropMap):
        return render_plan(texture, face.crops, first=first, rows=out.shape[0], out=out, threads=threads)
    region = face.region
    return render(
        texture, region.row + first, region.col, out.shape[0], region.cols, seed=plan.seed, out=out, threads=threads
    )


def render_face(
    plan: Plan,
    texture: TextureMap,
    index: int,
    *,
    threads: int | None = None,
    out: Array | None = None,
    bleed: bool = True,
) -> Array:
    """Pixels of one face of a job from any of its maps."""
    face = plan_face(plan, texture, index, threads=threads, bleed=bleed)
    return render_planned(plan, texture, face, threads=threads, out=out)


def face_code(plan: Plan, press: TextureMap, index: int) -> str:
    """Everything that re-creates a face, in a line: index, seed, place, size, and hashes of map and job."""
    region = face_region(plan, press, index)
    return (
        f"tilefab face={index} seed={plan.seed} at={region.row},{region.col} size={region.rows}x{region.cols} "
        f"map={press.hash[:_CODE_DIGITS]} job={plan.job_hash[:_CODE_DIGITS]}"
    )


def parse_face_code(text: str) -> FaceCode | None:
    """Read a face's code back; ``None`` if it isn't one."""
    match = _CODE.match(text.strip())
    return FaceCode(int(match.group(1)), match.group(2)) if match else None


def code_is_of(plan: Plan, code: FaceCode) -> bool:
    """Whether a code was made by this job."""
    return plan.job_hash.startswith(code.job)


def check_face_code(plan: Plan, press: TextureMap, text: str) -> None:
    """Make sure that a code says just what this job and its map now say of that face.

    Raises
    ------
    OutputError
        If it doesn't: the face would be another than the one the code was printed beside.
    """
    code = parse_face_code(text)
    now = face_code(plan, press, code.index) if code is not None else ""
    if " ".join(text.split()) != now:
        raise OutputError(
            f"this code was printed beside another face than this job makes now (`{now}`): bring back the folder it "
            "was printed from, with its maps, and name it with --out"
        )


def check_target(plan: Plan, path: Path) -> None:
    """Refuse to write a result over a file that the job reads, or that its run records.

    Raises
    ------
    OutputError
        If ``path`` is such a file.
    """
    target = path.resolve()
    read = {path for scan in plan.scans for path in (scan.path, scan.mask, scan.weights) if path is not None}
    read |= {plan.job_file.path.resolve(), Path(plan.press_profile.path).resolve()}
    if plan.input_profile is not None:
        read.add(Path(plan.input_profile.path).resolve())
    if target in read:
        raise OutputError(f"{path}: the job reads this file; write to another", path=str(path))
    own = (plan.output / MANIFEST_NAME, plan.output / JOB_RECORD_NAME)
    folders = (plan.output / FACES_FOLDER, plan.output / PROOFS_FOLDER, plan.output / MAPS_FOLDER)
    if target in own or any(target.is_relative_to(folder) for folder in folders):
        raise OutputError(f"{path}: belongs to the run in {plan.output}; write to another file", path=str(path))


def check_face_record(plan: Plan, index: int, pixels: Array) -> None:
    """Make sure that a face made again is the one that the run recorded, if it did.

    Raises
    ------
    OutputError
        If the manifest of the job's folder holds other pixels for it.
    """
    record = Manifest(plan.output).records.get(index)
    if record is not None and record.job == plan.job_hash and record.sha256 != pixel_hash(pixels):
        raise OutputError(
            f"{plan.output / MANIFEST_NAME}: face {index} was printed with other pixels than the map gives now; bring "
            "back the map it was printed from",
            path=str(plan.output / MANIFEST_NAME),
        )


def print_tags(plan: Plan, press: TextureMap, index: int) -> PrintTags:
    """What the print file of a face says about itself."""
    return PrintTags(
        dpi=plan.job.tile.dpi,
        icc_profile=plan.press_profile.data,
        ink_names=plan.ink_names,
        description=face_code(plan, press, index),
        compression=plan.job.output.compression,
    )


def write_face(plan: Plan, maps: JobMaps, index: int, path: Path, threads: int | None = None) -> str:
    """Render one face into a file: print data if it ends in .tif, else its proof.

    Returns
    -------
    str
        ``"print"`` or ``"proof"``, whichever was written.

    Raises
    ------
    OutputError
        If the ending is unknown or the file can't be written.
    """
    suffix = path.suffix.lower()
    if suffix in _TIFF_SUFFIXES:
        pixels = render_face(plan, maps.press, index, threads=threads)
        check_face_record(plan, index, pixels)
        write_print_tiff(path, pixels, print_tags(plan, maps.press, index))
        return "print"
    if suffix not in PREVIEW_SUFFIXES:
        raise OutputError(
            f"{path}: unknown format {suffix or '(no ending)'}; use .tif for print data, .png or .jpg for a proof",
            path=str(path),
        )
    proof: NDArray[np.uint8] = render_face(plan, proof_map(plan, maps.press, threads), index, threads=threads)
    write_preview(path, proof, plan.job.tile.dpi)
    return "proof"
