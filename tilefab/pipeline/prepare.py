"""From scans to one clean base image: read, square, even out the light, bring to print resolution, match, join."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.errors import ImageError, ProfileError
from tilefab.io.scans import read_mask, read_scan
from tilefab.pipeline.plan import Plan, SlabScan
from tilefab.pipeline.progress import Progress
from tilefab.sampling.texture_map import SlabArea
from tilefab.slab import (
    SlabColour,
    SquaringOptions,
    build_atlas,
    estimate_lighting,
    match_slabs,
    remove_lighting,
    resample,
    resampled_size,
    square_slab,
)
from tilefab.types import FloatImage, Mask, SizePx
from tilefab.units import px_from_mm

STAGE = "Preparing the slab"
_STRIP_ROWS = 512
_ENLARGED_TOO_FAR = 1.5
_BRIGHTER_THAN_WHITE = np.float32(1.05)
_BRIGHT_SHARE_TOO_FAR = 0.2
_MOST_PIXELS = 1 << 29


@dataclass(frozen=True, eq=False)
class PreparedSlab:
    """The stone, ready to be sampled.

    Attributes
    ----------
    lab_d50
        (rows, cols, 3) float32 CIELAB (D50) at print resolution, all slabs in one image.
    valid
        (rows, cols), True where it may be used.
    slabs
        Where each slab lies.
    log
        What each step did: (step, sentence).
    warnings
        What the operator should know.
    """

    lab_d50: NDArray[np.float32]
    valid: Mask
    slabs: tuple[SlabArea, ...]
    log: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]


def prepare_slab(plan: Plan, progress: Progress) -> PreparedSlab:
    """Read and clean the scans of a job.

    Raises
    ------
    ImageError
        If a scan can't be read, or nothing usable is left of it.
    ProfileError
        If its colours can't be converted.
    """
    slab = plan.job.slab
    log: list[tuple[str, str]] = []
    warnings: list[str] = []
    images: list[FloatImage] = []
    valids: list[Mask] = []
    for number, scan in enumerate(plan.scans):
        progress.stage(STAGE, 0.6 * number / len(plan.scans))
        image, valid = _read_linear(plan, scan, log)
        trim_px = px_from_mm(slab.trim_mm, scan.dpi)
        if 2 * trim_px >= min(valid.shape):
            raise ImageError(
                f"{scan.path}: trim_mm = {slab.trim_mm:g} leaves nothing of {valid.shape[1]} x {valid.shape[0]} pixels "
                f"at {scan.dpi:g} dpi; trim less, or check dpi",
                path=str(scan.path),
            )
        if slab.square:
            image, valid, squared = square_slab(image, valid, SquaringOptions(trim_px=trim_px))
            log.append(_entry("Squaring", scan.path, squared.summary))
        elif trim_px:
            inner = slice(trim_px, -trim_px)
            image, valid = np.ascontiguousarray(image[inner, inner]), np.ascontiguousarray(valid[inner, inner])
            log.append(_entry("Trimming", scan.path, f"{trim_px} pixels off each edge"))
        if not valid.any():
            raise ImageError(f"{scan.path}: nothing usable is left of this scan; check its mask", path=str(scan.path))
        images.append(image)
        valids.append(valid)
    if slab.lighting:
        _even_lighting(plan, images, valids, log)
    progress.stage(STAGE, 0.7)
    labs: list[FloatImage] = []
    for number, scan in enumerate(plan.scans):
        scale = plan.job.tile.dpi / scan.dpi
        size = resampled_size(SizePx(*valids[number].shape), scale)
        if size.rows * size.cols > _MOST_PIXELS:
            raise ImageError(
                f"{scan.path}: {scan.dpi:g} dpi printed at {plan.job.tile.dpi:g} dpi makes {size.cols} x {size.rows} "
                "pixels, more than a slab can have; check both dpi",
                path=str(scan.path),
            )
        image, valid, record = resample(images[number], valids[number], scale)
        images[number] = image[:0]
        log.append(_entry("Resolution", scan.path, record.summary))
        if scale > _ENLARGED_TOO_FAR:
            warnings.append(
                f"{scan.path.name} was scanned at {scan.dpi:g} dpi and is printed at {plan.job.tile.dpi:g} dpi: "
                f"it is enlarged {scale:.1f} times and will look soft"
            )
        if not valid.any():
            raise ImageError(
                f"{scan.path}: nothing usable is left at print resolution; check mask and dpi", path=str(scan.path)
            )
        valids[number] = valid
        labs.append(_lab(image))
    progress.stage(STAGE, 0.85)
    if slab.match and (len(labs) > 1 or slab.target_lab is not None):
        target = None
        if slab.target_lab is not None:
            target = SlabColour(mean=(slab.target_lab[0], slab.target_lab[1], slab.target_lab[2]))
        labs, matched = match_slabs(labs, valids, target)
        log += [_entry("Colour", scan.path, record.summary) for scan, record in zip(plan.scans, matched, strict=True)]
    lab, valid, atlas = build_atlas(labs, valids)
    if len(labs) > 1:
        log.append(("Joining", atlas.summary))
    areas = tuple(
        SlabArea(plan.scans[place.slab_index].path.name, place.row, place.col, place.rows, place.cols)
        for place in atlas.placements
    )
    progress.stage(STAGE, 1.0)
    return PreparedSlab(lab, valid, areas, tuple(log), tuple(warnings))


def _read_linear(plan: Plan, planned: SlabScan, log: list[tuple[str, str]]) -> tuple[FloatImage, Mask]:
    scan = read_scan(planned.path)
    log += [("Scan", note) for note in scan.notes]
    valid = scan.valid
    if planned.mask is not None:
        valid = valid & read_mask(planned.mask, (valid.shape[0], valid.shape[1]))
        log.append(_entry("Mask", planned.path, f"{100 * float((~valid).mean()):.1f} % not used"))
        if not valid.any():
            raise ImageError(f"{planned.path}: mask and transparency leave nothing of it", path=str(planned.path))
    if plan.input_profile is not None:
        profile, source = plan.input_profile.data, f"input profile {plan.input_profile.description}"
    elif scan.icc_profile is not None:
        profile, source = scan.icc_profile, "embedded profile"
    else:
        profile = None
        source = "linear sRGB, as a float image" if scan.pixels.dtype.kind == "f" else "sRGB, for it names no profile"
    log.append(
        _entry(
            "Colour space",
            planned.path,
            f"{scan.pixels.shape[1]} x {scan.pixels.shape[0]} pixels, {scan.pixels.dtype}, {planned.dpi:g} dpi; "
            f"{source}",
        )
    )
    try:
        xyz = np.maximum(scan_to_xyz(scan.pixels, profile, threads=os.cpu_count() or 1), 0)
    except ProfileError as error:
        raise ProfileError(f"{planned.path}: {error.message}", path=str(planned.path)) from error
    bright = float((xyz[..., 1] > _BRIGHTER_THAN_WHITE)[valid].mean())
    if bright > _BRIGHT_SHARE_TOO_FAR:
        raise ImageError(
            f"{planned.path}: {100 * bright:.0f} % of the stone is brighter than white; scale the image so that white "
            "is 1, and export it again",
            path=str(planned.path),
        )
    if bright > 0:
        log.append(_entry("Brightness", planned.path, f"{100 * bright:.2f} % is brighter than white and becomes white"))
        np.minimum(xyz, _BRIGHTER_THAN_WHITE, out=xyz)
    return xyz, np.ascontiguousarray(valid)


def _even_lighting(plan: Plan, images: list[FloatImage], valids: list[Mask], log: list[tuple[str, str]]) -> None:
    # Only scans of about one size show the same part of the scanner's light; where they don't, or don't agree on it,
    # each is judged alone.
    sizes = np.array([valid.shape for valid in valids])
    together = bool((sizes.max(axis=0) <= 1.1 * sizes.min(axis=0)).all())
    common = estimate_lighting(images, valids) if together else None
    if common is not None and not any(common.coefficients):
        common = None
    for number, scan in enumerate(plan.scans):
        model = common or estimate_lighting([images[number]], [valids[number]])
        images[number], valids[number], record = remove_lighting(images[number], valids[number], model)
        log.append(_entry("Lighting", scan.path, record.summary))


def _lab(xyz_d50: FloatImage) -> FloatImage:
    out = np.empty(xyz_d50.shape, dtype=np.float32)
    for top in range(0, len(xyz_d50), _STRIP_ROWS):
        out[top : top + _STRIP_ROWS] = lab_from_xyz(xyz_d50[top : top + _STRIP_ROWS])
    return out


def _entry(step: str, path: Path, sentence: str) -> tuple[str, str]:
    return step, f"{path.name}: {sentence}"
