"""A prepared slab, grown to a larger one before crops are taken from it.

The map of places is kept beside the texture map: an interrupted build needn't grow the slab again, and a point of a
face can be traced back to the scan.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from tilefab.errors import OutputError, SynthesisError, TextureMapError
from tilefab.io.source_map_file import SUFFIX, SourceMap, load_source_map, save_source_map
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.prepare import PreparedSlab
from tilefab.pipeline.progress import Progress
from tilefab.sampling import SlabArea, TextureMap
from tilefab.synthesis import LARGEST_SIDE_PX, METHODS, Step, SynthesisRequest, SynthesisResult, render
from tilefab.types import SizeMm, SizePx
from tilefab.units import size_px_from_mm

STAGE = "Growing the slab"
_SMALLEST_SIDE_PX = 16
_TIMES_LARGER = 2
_LARGEST_DEFAULT_PX = 4096
_KEY_DIGITS = 16


def grow_slab(
    plan: Plan, slab: PreparedSlab, progress: Progress, threads: int | None, keep_in: Path | None = None
) -> PreparedSlab:
    """Grow a slab as the job says, out of exact copies of its pixels.

    Parameters
    ----------
    plan
        A job whose texture says how to grow the slab.
    slab
        The slab as prepared. What it marks as not to be cut is kept whole, and marked again.
    progress
        Told of the progress.
    threads
        Changes nothing else.
    keep_in
        Folder of the maps, where its map of places is kept, and looked for; ``None``: nothing is kept.

    Raises
    ------
    SynthesisError
        If it can't be grown, or the size wanted can't be had.
    """
    name = str(plan.job.texture.grow)
    size = _grown_size(plan, slab)
    path = None if keep_in is None else grown_path(plan, keep_in)
    grown = None if path is None else _kept(path, slab, size, progress)
    if grown is None:
        grown = _grown(plan, slab, size, progress, threads)
        if path is not None:
            size_before = SizePx(*slab.valid.shape)
            kept = SourceMap(grown.source, size_before, name, plan.seed, toroidal=False, notes=grown.notes)
            _keep(path, kept, progress)
    shown = np.zeros(slab.valid.size, dtype=bool)
    shown[grown.source.ravel()] = True
    share = 100 * np.count_nonzero(shown) / np.count_nonzero(slab.valid)
    rows, cols = slab.valid.shape
    summary = f"from {cols} x {rows} to {size.cols} x {size.rows} pixels by {name}; {share:.1f} % of the slab is shown"
    smaller = size.rows * size.cols < slab.valid.size
    warning = (
        f"The grown slab is smaller than the slab itself ({summary}): make grown_size_mm larger, or leave grow out"
    )
    return replace(
        slab,
        lab16=render(slab.lab16, grown.source),
        valid=np.ones((size.rows, size.cols), dtype=bool),
        slabs=(SlabArea(f"{' + '.join(area.name for area in slab.slabs)}, grown", 0, 0, size.rows, size.cols),),
        log=(*slab.log, ("Growing", summary)),
        warnings=(*slab.warnings, *grown.notes, *((warning,) if smaller else ())),
        weights=None if slab.weights is None else render(slab.weights, grown.source),
        grown_from=slab.slabs,
    )


def grown_path(plan: Plan, folder: Path) -> Path:
    """Where the map of places of a job's grown slab is kept."""
    return folder / f"{plan.build_key[:_KEY_DIGITS]}.grown{SUFFIX}"


def before_growing(
    plan: Plan, texture: TextureMap, folder: Path, row: int, col: int
) -> tuple[SlabArea, int, int] | None:
    """Slab that a pixel of a map's base came from before it was grown, and the pixel's row and column on that slab.

    ``None`` if the map wasn't made of a grown slab, or its map of places isn't in ``folder``.
    """
    if "grown_from" not in texture.provenance:
        return None
    try:
        kept = load_source_map(grown_path(plan, folder))
    except TextureMapError:
        return None
    if row >= kept.source.shape[0] or col >= kept.source.shape[1]:
        return None
    at_row, at_col = divmod(int(kept.source[row, col]), kept.exemplar.cols)
    for name, *place in json.loads(texture.provenance["grown_from"]):
        area = SlabArea(str(name), *(int(n) for n in place))
        if 0 <= at_row - area.base_row < area.rows and 0 <= at_col - area.base_col < area.cols:
            return area, at_row - area.base_row, at_col - area.base_col
    return None


def _kept(path: Path, slab: PreparedSlab, size: SizePx, progress: Progress) -> SynthesisResult | None:
    if not path.exists():
        return None
    try:
        kept = load_source_map(path)
    except TextureMapError as error:
        progress.note(f"{error.message}. The slab is grown anew")
        return None
    if kept.exemplar != SizePx(*slab.valid.shape) or kept.source.shape != (size.rows, size.cols):
        return None
    progress.note("The slab that an earlier build has grown is used")
    return SynthesisResult(kept.source, notes=kept.notes)


def _keep(path: Path, grown: SourceMap, progress: Progress) -> None:
    try:
        save_source_map(path, grown)
    except OutputError as error:
        progress.note(f"The map of the grown slab was not kept: {error.message}")


def _grown(plan: Plan, slab: PreparedSlab, size: SizePx, progress: Progress, threads: int | None) -> SynthesisResult:
    name = str(plan.job.texture.grow)

    def watch(step: Step) -> bool:
        progress.stage(STAGE, step.share)
        return True

    progress.stage(STAGE, 0.0)
    try:
        request = SynthesisRequest(
            slab.lab_d50,
            slab.valid,
            size,
            plan.seed,
            toroidal=False,
            weights=slab.weights,
            feature_px=plan.feature_px,
            threads=threads,
        )
        grown = METHODS[name](request, watch)
    except ValueError as error:
        raise SynthesisError(
            f"the slab can't be grown by {name} at {plan.job.tile.dpi:g} dpi: {error}; use a larger scan, another "
            "method, or leave grow out"
        ) from error
    progress.stage(STAGE, 1.0)
    return grown


def _grown_size(plan: Plan, slab: PreparedSlab) -> SizePx:
    wanted = plan.job.texture.grown_size_mm
    if wanted is None:
        rows, cols = (max(n, min(_LARGEST_DEFAULT_PX, _TIMES_LARGER * n)) for n in slab.valid.shape)
        return SizePx(rows, cols)
    dpi = plan.job.tile.dpi
    size = size_px_from_mm(SizeMm(wanted[0], wanted[1]), dpi)
    if min(size.rows, size.cols) < _SMALLEST_SIDE_PX or max(size.rows, size.cols) > LARGEST_SIDE_PX:
        raise SynthesisError(
            f"grown_size_mm {wanted[0]:g} x {wanted[1]:g} is {size.cols} x {size.rows} pixels at {dpi:g} dpi; a grown "
            f"slab has {_SMALLEST_SIDE_PX} to {LARGEST_SIDE_PX:,} pixels a side"
        )
    return size
