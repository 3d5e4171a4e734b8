"""From scans to one clean base image: read, square, even out the light, bring to print resolution, match, join."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import lab_from_xyz, scan_to_xyz
from tilefab.colour.encoding import decode_lab16, encode_lab16
from tilefab.errors import ImageError, ProfileError
from tilefab.io.scans import read_mask, read_scan, read_weights
from tilefab.pipeline.plan import Plan, SlabScan
from tilefab.pipeline.progress import Progress
from tilefab.sampling.texture_map import SlabArea
from tilefab.slab import (
    SlabColour,
    SquaringOptions,
    build_atlas,
    estimate_lighting,
    join_weights,
    match_slabs,
    over_bands,
    remove_lighting,
    resample,
    resample_weights,
    resampled_size,
    square_slab,
    square_weights,
)
from tilefab.types import Array, FloatImage, Mask, SizePx
from tilefab.units import px_from_mm

STAGE = "Preparing the slab"
_BAND_PX = 1 << 17
_ENLARGED_TOO_FAR = 1.5
_BRIGHTER_THAN_WHITE = np.float32(1.05)
_BRIGHT_SHARE_TOO_FAR = 0.2
_MOST_PIXELS = 1 << 29


@dataclass(frozen=True, eq=False)
class PreparedSlab:
    """The stone, ready to be sampled.

    Attributes
    ----------
    lab16
        (rows, cols, 3) CIELAB (D50) at print resolution, all slabs in one image, as `tilefab.colour.encoding` has it.
    valid
        (rows, cols), True where it may be used.
    slabs
        Where each slab lies.
    log
        What each step did: (step, sentence).
    warnings
        What the operator should know.
    weights
        (rows, cols), 255 where no seam should pass, 0 where any may; ``None`` if the job marks nothing.
    grown_from
        Where each slab lay before they were grown; empty if they weren't.
    """

    lab16: NDArray[np.uint16]
    valid: Mask
    slabs: tuple[SlabArea, ...]
    log: tuple[tuple[str, str], ...]
    warnings: tuple[str, ...]
    weights: NDArray[np.uint8] | None = None
    grown_from: tuple[SlabArea, ...] = ()

    @property
    def lab_d50(self) -> NDArray[np.float32]:
        """The colours decoded, float32, anew each time."""
        return decode_lab16(self.lab16)


def prepare_slab(plan: Plan, progress: Progress, threads: int | None = None) -> PreparedSlab:
    """Read and clean the scans of a job.

    Works in place wherever it can: of the largest image, a float for each pixel and channel, there are never more than
    two at a time.

    Parameters
    ----------
    plan, progress
        The job, and who watches.
    threads
        Changes nothing else; ``None``: one per processor.

    Raises
    ------
    ImageError
        If a scan can't be read, or nothing usable is left of it.
    ProfileError
        If its colours can't be converted.
    """
    slab = plan.job.slab
    workers = threads or os.cpu_count() or 1
    log: list[tuple[str, str]] = []
    warnings: list[str] = []
    images: list[FloatImage] = []
    valids: list[Mask] = []
    weights: list[NDArray[np.uint8] | None] = []
    for number, scan in enumerate(plan.scans):
        progress.stage(STAGE, 0.6 * number / len(plan.scans))
        image, valid = _read_linear(plan, scan, workers, log)
        held = _read_weights(scan, valid.shape, log)
        trim_px = px_from_mm(slab.trim_mm, scan.dpi)
        if 2 * trim_px >= min(valid.shape):
            raise ImageError(
                f"{scan.path}: trim_mm = {slab.trim_mm:g} leaves nothing of {valid.shape[1]} x {valid.shape[0]} pixels "
                f"at {scan.dpi:g} dpi; trim less, or check dpi",
                path=str(scan.path),
            )
        if slab.square:
            image, valid, squared = square_slab(image, valid, SquaringOptions(trim_px=trim_px), workers)
            held = None if held is None else square_weights(held, squared, workers)
            log.append(_entry("Squaring", scan.path, squared.summary))
        elif trim_px:
            inner = slice(trim_px, -trim_px)
            image, valid = np.ascontiguousarray(image[inner, inner]), np.ascontiguousarray(valid[inner, inner])
            held = None if held is None else np.ascontiguousarray(held[inner, inner])
            log.append(_entry("Trimming", scan.path, f"{trim_px} pixels off each edge"))
        if not valid.any():
            raise ImageError(f"{scan.path}: nothing usable is left of this scan; check its mask", path=str(scan.path))
        images.append(image)
        valids.append(valid)
        weights.append(held)
        del image, valid, held
    if slab.lighting:
        _even_lighting(plan, images, valids, workers, log)
    progress.stage(STAGE, 0.7)
    for number, scan in enumerate(plan.scans):
        scale = plan.job.tile.dpi / scan.dpi
        size = resampled_size(SizePx(*valids[number].shape), scale)
        if size.rows * size.cols > _MOST_PIXELS:
            raise ImageError(
                f"{scan.path}: {scan.dpi:g} dpi printed at {plan.job.tile.dpi:g} dpi makes {size.cols} x {size.rows} "
                "pixels, more than a slab can have; check both dpi",
                path=str(scan.path),
            )
        images[number], valids[number], record = resample(images[number], valids[number], scale, workers)
        held = weights[number]
        weights[number] = None if held is None else resample_weights(held, scale)
        log.append(_entry("Resolution", scan.path, record.summary))
        if scale > _ENLARGED_TOO_FAR:
            warnings.append(
                f"{scan.path.name} was scanned at {scan.dpi:g} dpi and is printed at {plan.job.tile.dpi:g} dpi: "
                f"it is enlarged {scale:.1f} times and will look soft"
            )
        if not valids[number].any():
            raise ImageError(
                f"{scan.path}: nothing usable is left at print resolution; check mask and dpi", path=str(scan.path)
            )
        lab_in_place(images[number], workers)
    progress.stage(STAGE, 0.85)
    if slab.match and (len(images) > 1 or slab.target_lab is not None):
        target = None
        if slab.target_lab is not None:
            target = SlabColour(mean=(slab.target_lab[0], slab.target_lab[1], slab.target_lab[2]))
        images, matched = match_slabs(images, valids, target, in_place=True, threads=workers)
        log += [_entry("Colour", scan.path, record.summary) for scan, record in zip(plan.scans, matched, strict=True)]
    lab, valid, atlas = build_atlas(images, valids)
    images.clear()
    if len(plan.scans) > 1:
        log.append(("Joining", atlas.summary))
    areas = tuple(
        SlabArea(plan.scans[place.slab_index].path.name, place.row, place.col, place.rows, place.cols)
        for place in atlas.placements
    )
    lab16 = _encoded(lab, workers)
    progress.stage(STAGE, 1.0)
    return PreparedSlab(
        lab16,
        valid,
        areas,
        tuple(log),
        tuple(warnings),
        join_weights(weights, atlas) if any(held is not None for held in weights) else None,
    )


def _read_linear(plan: Plan, planned: SlabScan, threads: int, log: list[tuple[str, str]]) -> tuple[FloatImage, Mask]:
    scan = read_scan(planned.path)
    log += [("Scan", note) for note in scan.notes]
    valid = np.ascontiguousarray(scan.valid)
    if planned.mask is not None:
        valid &= read_mask(planned.mask, (valid.shape[0], valid.shape[1]))
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
        xyz = scan_to_xyz(scan.pixels, profile, threads=threads)
    except ProfileError as error:
        raise ProfileError(f"{planned.path}: {error.message}", path=str(planned.path)) from error
    del scan

    def limit(band: slice) -> int:
        np.maximum(xyz[band], 0, out=xyz[band])
        return int(np.count_nonzero((xyz[band, :, 1] > _BRIGHTER_THAN_WHITE) & valid[band]))

    bright = sum(over_bands(limit, len(xyz), _band_rows(xyz), threads)) / int(np.count_nonzero(valid))
    if bright > _BRIGHT_SHARE_TOO_FAR:
        raise ImageError(
            f"{planned.path}: {100 * bright:.0f} % of the stone is brighter than white; scale the image so that white "
            "is 1, and export it again",
            path=str(planned.path),
        )
    if bright > 0:
        log.append(_entry("Brightness", planned.path, f"{100 * bright:.2f} % is brighter than white and becomes white"))
        np.minimum(xyz, _BRIGHTER_THAN_WHITE, out=xyz)
    return xyz, valid


def _read_weights(planned: SlabScan, shape: tuple[int, ...], log: list[tuple[str, str]]) -> NDArray[np.uint8] | None:
    if planned.weights is None:
        return None
    weights = read_weights(planned.weights, (shape[0], shape[1]))
    share = 100 * np.count_nonzero(weights) / weights.size
    log.append(_entry("Weights", planned.path, f"{share:.1f} % marked as not to be cut"))
    return weights


def _even_lighting(
    plan: Plan, images: list[FloatImage], valids: list[Mask], threads: int, log: list[tuple[str, str]]
) -> None:
    # Only scans of about one size show the same part of the scanner's light; where they don't, or don't agree on it,
    # each is judged alone.
    sizes = np.array([valid.shape for valid in valids])
    together = bool((sizes.max(axis=0) <= 1.1 * sizes.min(axis=0)).all())
    common = estimate_lighting(images, valids) if together else None
    if common is not None and not any(common.coefficients):
        common = None
    for number, scan in enumerate(plan.scans):
        image, valid = images[number], valids[number]
        model = common or estimate_lighting([image], [valid])
        _, _, record = remove_lighting(image, valid, model, out=image, threads=threads)
        log.append(_entry("Lighting", scan.path, record.summary))


def lab_in_place(xyz_d50: FloatImage, threads: int) -> None:
    """Make CIELAB of an image, in place."""

    def one_band(band: slice) -> None:
        xyz_d50[band] = lab_from_xyz(xyz_d50[band])

    over_bands(one_band, len(xyz_d50), _band_rows(xyz_d50), threads)


def _encoded(lab_d50: FloatImage, threads: int) -> NDArray[np.uint16]:
    out = np.empty(lab_d50.shape, dtype=np.uint16)

    def one_band(band: slice) -> None:
        out[band] = encode_lab16(lab_d50[band])

    over_bands(one_band, len(out), _band_rows(out), threads)
    return out


def _band_rows(image: Array) -> int:
    return max(1, _BAND_PX // int(image.shape[1]))


def _entry(step: str, path: Path, sentence: str) -> tuple[str, str]:
    return step, f"{path.name}: {sentence}"
