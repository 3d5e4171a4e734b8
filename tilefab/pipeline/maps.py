"""The texture map of a job: built once, kept in the run's folder, converted to inks as a whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import (
    PressTransform,
    absolute_lab,
    black_channel,
    srgb_from_xyz,
    xyz_from_lab,
)
from tilefab.colour.grid_bake import bake
from tilefab.colour.grid_table import compile_table
from tilefab.colour.press_counts import limit_counts
from tilefab.errors import OutputError, SynthesisError, TextureMapError
from tilefab.io.atomic import make_folder
from tilefab.io.manifest import folder_owner
from tilefab.io.texture_map_file import SUFFIX, load_texture_map, save_texture_map
from tilefab.pipeline.crops import build_crops, rebuilt_crops
from tilefab.pipeline.growing_slab import grow_slab
from tilefab.pipeline.kept_slab import forget_slabs, kept_or_prepared
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.pipeline.prepare import PreparedSlab
from tilefab.pipeline.press_tables import fired_colours, job_press
from tilefab.pipeline.progress import Progress
from tilefab.pipeline.tiles import build_tile
from tilefab.sampling import TextureMap
from tilefab.types import Array

RGB_SPACE = "srgb8"
MIN_SLAB_PX = 16
_STRIP_PIXELS = 1 << 21
_SCREEN_NODES = 65
_KEY_DIGITS = 16


@dataclass(frozen=True, eq=False)
class JobMaps:
    """The maps of a job.

    Attributes
    ----------
    texture
        In the working space (`tilefab.colour.encoding`).
    press
        The same in inks: what faces are rendered from.
    """

    texture: TextureMap
    press: TextureMap


def job_maps(plan: Plan, progress: Progress, threads: int | None = None, *, must_keep: bool = False) -> JobMaps:
    """Texture map and press map of a job, from the run's folder if they are there, else made and kept there.

    Parameters
    ----------
    plan, progress
        The job, and who watches.
    threads
        For making them; changes nothing else.
    must_keep
        Whether it is an error if they can't be kept. If not, they are made in memory with a note where the folder can't
        be written to or is another job's.

    Raises
    ------
    ImageError, ProfileError, SynthesisError
        If the map can't be made.
    OutputError
        If it must be kept and can't be.
    """
    texture = texture_map(plan, progress, threads, must_keep=must_keep)
    path = press_map_path(plan)
    press = _load(path, "press_key", f"{plan.press_key} {texture.hash}", progress)
    if press is None:
        press = convert_map(plan, texture, progress, threads)
        _save(plan, path, press, progress, must_keep)
    return JobMaps(texture, press)


def texture_map(plan: Plan, progress: Progress, threads: int | None = None, *, must_keep: bool = False) -> TextureMap:
    """Texture map of a job; see `job_maps`."""
    path = texture_map_path(plan)
    texture = _load(path, "map_key", plan.map_key, progress)
    if texture is None:
        if must_keep:
            # Before minutes of work, not after.
            check_owner(plan)
            make_folder(path.parent)
        texture = rebuilt_crops(plan, path.parent, progress) if plan.job.texture.design == "crops" else None
        if texture is None:
            texture = build_map(plan, progress, threads, path.parent if must_keep else None)
        _save(plan, path, texture, progress, must_keep)
        if must_keep:
            forget_slabs(path.parent)
    return texture


def check_owner(plan: Plan) -> None:
    """Make sure that the run's folder is this job's or nobody's.

    Raises
    ------
    OutputError
        If it is another job's, or its record can't be read.
    """
    owner = folder_owner(plan.output)
    if owner is not None and owner != plan.job_hash:
        raise OutputError(
            f"{plan.output}: holds the faces of another job, or of this job with other settings; use another folder "
            "(--out DIR), or remove this one",
            path=str(plan.output),
        )


def texture_map_path(plan: Plan) -> Path:
    """Where a job's texture map is kept."""
    return plan.output / MAPS_FOLDER / f"{plan.map_key[:_KEY_DIGITS]}.texture{SUFFIX}"


def press_map_path(plan: Plan) -> Path:
    """Where a job's map in inks is kept; each correction of its colours has another."""
    return plan.output / MAPS_FOLDER / f"{plan.map_key[:_KEY_DIGITS]}-{plan.press_key[:_KEY_DIGITS]}.press{SUFFIX}"


def kept_press_maps(plan: Plan) -> list[Path]:
    """Files of all maps in inks that are kept of a job: its own, and those of its corrections."""
    return sorted((plan.output / MAPS_FOLDER).glob(f"{plan.map_key[:_KEY_DIGITS]}-*.press{SUFFIX}"))


def load_press_map(plan: Plan, texture_hash: str) -> TextureMap:
    """A job's map in inks as it is kept; it is not made.

    Parameters
    ----------
    plan
        The job.
    texture_hash
        Hash of the texture map that it must be of.

    Raises
    ------
    TextureMapError
        If it isn't there, is damaged, or is of another texture map.
    """
    path = press_map_path(plan)
    loaded = load_texture_map(path)
    if loaded.provenance.get("press_key") != f"{plan.press_key} {texture_hash}":
        raise TextureMapError(
            f"{path}: isn't of the texture map that {plan.name} is printed from: put that one back, or remove this",
            path=str(path),
        )
    return loaded


def build_map(plan: Plan, progress: Progress, threads: int | None = None, keep_in: Path | None = None) -> TextureMap:
    """Prepare the slab and build its texture map.

    Parameters
    ----------
    plan, progress, threads
        See `job_maps`.
    keep_in
        Folder of the maps, where the prepared slab waits until the map is saved; ``None``: nothing is kept.

    Raises
    ------
    ImageError, ProfileError
        If the scans can't be used.
    SynthesisError
        If no map can be made of them.
    """
    slab = kept_or_prepared(plan, progress, threads, keep_in)
    try:
        if min(slab.valid.shape) < MIN_SLAB_PX:
            raise SynthesisError(
                f"the stone is {slab.valid.shape[1]} x {slab.valid.shape[0]} pixels at {plan.job.tile.dpi:g} dpi; a "
                f"texture needs {MIN_SLAB_PX} at least: use a larger scan, or check dpi"
            )
        notes = _notes(plan, slab)
        if plan.job.texture.grow is not None:
            slab = grow_slab(plan, slab, progress, threads, keep_in)
        build = build_tile if plan.job.texture.design == "tile" else build_crops
        return build(plan, slab, notes, progress, threads)
    except SynthesisError:
        if keep_in is not None:
            forget_slabs(keep_in)
        raise


def _notes(plan: Plan, slab: PreparedSlab) -> list[str]:
    """What the operator should know of a slab, whichever design is built from it."""
    usable = int(np.count_nonzero(slab.valid))
    share = usable / (plan.tile_px.rows * plan.tile_px.cols)
    if share >= 1:
        return []
    return [
        f"The stone scanned is {share:.2f} times as large as a tile: its features recur within each face. "
        "Scan more of it"
    ]


def convert_map(plan: Plan, texture: TextureMap, progress: Progress, threads: int | None = None) -> TextureMap:
    """Convert a texture map to the inks of the job's press, total ink never above the job's limit."""
    stage = "Converting to inks"
    colour = plan.job.colour
    transform = job_press(plan, colour.intent, texture, progress)
    black = press_black(plan, transform)
    dtype = np.dtype(np.uint8 if plan.job.output.bits == 8 else np.uint16)
    convert = transform.counts_from_lab16(dtype)
    base = np.empty((*texture.base.shape[:2], transform.inks), dtype=dtype)
    workers = threads or os.cpu_count() or 1
    for rows in _strips(base):
        progress.stage(stage, rows.start / len(base))
        base[rows] = convert(texture.base[rows], threads=workers)
        limit_counts(base[rows], colour.ink_limit_percent, black, threads=workers)
    progress.stage(stage, 1.0)
    return texture.with_base(
        base,
        space=f"ink{plan.job.output.bits}",
        channels=plan.press_profile.ink_names,
        press_key=f"{plan.press_key} {texture.hash}",
        press_profile=plan.press_profile.sha256,
    )


def press_black(plan: Plan, transform: PressTransform) -> int | None:
    """The channel of the press's black, by the names that the job or the profile give, else by its colour."""
    solids = transform.lab_from_inks(np.eye(transform.inks, dtype=np.float32)[np.newaxis])[0]
    return black_channel(plan.ink_names, solids)


def proof_map(plan: Plan, press: TextureMap, threads: int | None = None) -> TextureMap:
    """Return the press map as it will look fired, in 8-bit sRGB: the profile backwards, absolute colorimetric.

    Proofs are rendered from it, so a proof shows the same pixels of the stone as the face.
    """
    colours, white_lab = fired_colours(plan, press.base.dtype)

    def screen(lab: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(srgb_from_xyz(xyz_from_lab(absolute_lab(lab, white_lab))), dtype=np.float64)

    shown = compile_table(bake(screen, "lab", "rgb", 3, nodes=_SCREEN_NODES), np.uint16, np.uint8)
    base = np.empty((*press.base.shape[:2], 3), dtype=np.uint8)
    workers = threads or os.cpu_count() or 1
    for rows in _strips(base):
        shown.apply(colours(press.base[rows], threads=workers), threads=workers, out=base[rows])
    return press.with_base(base, space=RGB_SPACE, channels=("R", "G", "B"))


def _strips(base: Array) -> Iterator[slice]:
    """Rows of a map that are in memory as floating point at a time."""
    step = max(1, _STRIP_PIXELS // max(1, base.shape[1]))
    return (slice(top, top + step) for top in range(0, len(base), step))


def _load(path: Path, key: str, expected: str, progress: Progress) -> TextureMap | None:
    if not path.exists():
        return None
    try:
        loaded = load_texture_map(path)
    except TextureMapError as error:
        progress.note(f"{error.message}. It is made anew")
        return None
    return loaded if loaded.provenance.get(key) == expected else None


def _save(plan: Plan, path: Path, texture: TextureMap, progress: Progress, must_keep: bool) -> None:
    try:
        check_owner(plan)
        save_texture_map(path, texture)
    except OutputError as error:
        if must_keep:
            raise
        progress.note(f"The map was not kept: {error.message}")
