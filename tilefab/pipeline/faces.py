"""One face: its place, its pixels, its code, its files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.errors import OutputError
from tilefab.io.faces import PREVIEW_SUFFIXES, PrintTags, write_preview, write_print_tiff
from tilefab.pipeline.maps import JobMaps, proof_map
from tilefab.pipeline.plan import Plan
from tilefab.sampling import Region, TextureMap, render
from tilefab.types import Array

_CODE = re.compile(r"^tilefab face=(\d{1,40}) .*\bjob=([0-9a-f]{32})\b")
_CODE_DIGITS = 32
_TIFF_SUFFIXES = (".tif", ".tiff")


@dataclass(frozen=True)
class FaceCode:
    """What a face's code says: which face of which job."""

    index: int
    job: str


def face_region(plan: Plan, texture: TextureMap, index: int) -> Region:
    """Region of the plane that a face shows, bleed included."""
    return plan.layout(texture.tile_shape).face(index)


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
    region = face_region(plan, texture, index)
    margin = 0 if bleed else plan.bleed_px
    return render(
        texture,
        region.row + margin,
        region.col + margin,
        region.rows - 2 * margin,
        region.cols - 2 * margin,
        seed=plan.seed,
        threads=threads,
        out=out,
    )


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


def print_tags(plan: Plan, press: TextureMap, index: int) -> PrintTags:
    """What the print file of a face says about itself."""
    return PrintTags(
        dpi=plan.job.tile.dpi,
        icc_profile=plan.press_profile.data,
        ink_names=press.channels,
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
