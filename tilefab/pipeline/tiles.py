"""Building a job's map of a repeatable tile with patches: the first seed's design."""

from __future__ import annotations

import json
from collections.abc import Sequence

from tilefab.colour.encoding import LAB16_CHANNELS, LAB16_SPACE
from tilefab.errors import SynthesisError
from tilefab.pipeline.plan import Plan
from tilefab.pipeline.prepare import PreparedSlab
from tilefab.pipeline.progress import Progress
from tilefab.sampling import TileMap, TileOptions, build_tile_map
from tilefab.synthesis import METHODS, Step, SynthesisRequest
from tilefab.synthesis.seam_jumps import seam_delta_e
from tilefab.texture.matching import matching_image
from tilefab.types import SizeMm, SizePx
from tilefab.units import size_px_from_mm

STAGE_TILE = "Growing the tile"
STAGE_PATCHES = "Cutting patches"
_DEFAULT_MAP_SCALE = 1.5
_LARGEST_DEFAULT_MAP_PX = 4096
_SMALLEST_MAP_PX = 16
_LARGEST_MAP_PX = 1 << 15


def build_tile(
    plan: Plan, slab: PreparedSlab, notes: Sequence[str], progress: Progress, threads: int | None
) -> TileMap:
    """Grow a tile from a prepared slab and cut its patches.

    Raises
    ------
    SynthesisError
        If no tile can be grown from it.
    """
    texture = plan.job.texture
    # The stored numbers count, so that a map can be rebuilt from its own base.
    lab = slab.lab_d50

    def watch(step: Step) -> bool:
        progress.stage(STAGE_TILE, step.share)
        return True

    size = _map_size(plan, slab)
    try:
        request = SynthesisRequest(lab, slab.valid, size, plan.seed, feature_px=plan.feature_px, threads=threads)
        grown = METHODS[texture.method](request, watch)
    except ValueError as error:
        raise SynthesisError(
            f"no tile can be grown from this slab at {plan.job.tile.dpi:g} dpi: {error}; use a larger scan, "
            "or check dpi"
        ) from error
    progress.stage(STAGE_TILE, 1.0)
    worst, mean = seam_delta_e(matching_image(lab), grown.source)
    provenance = {
        "map_key": plan.map_key,
        "build_key": plan.build_key,
        "method": texture.method,
        "tile_worst_seam_delta_e": f"{worst:.2f}",
        "tile_mean_seam_delta_e": f"{mean:.2f}",
        "patches_wanted": str(texture.patches),
        "preparation": json.dumps(slab.log, ensure_ascii=False),
        "warnings": json.dumps([*slab.warnings, *notes, *grown.notes], ensure_ascii=False),
    }
    built = build_tile_map(
        lab,
        slab.valid,
        grown.source,
        TileOptions(texture.patches, texture.active_per_cell, plan.seed, threads),
        stored=slab.lab16,
        space=LAB16_SPACE,
        channels=LAB16_CHANNELS,
        dpi=plan.job.tile.dpi,
        slabs=slab.slabs,
        provenance=provenance,
        progress=lambda share: progress.stage(STAGE_PATCHES, share),
    )
    progress.stage(STAGE_PATCHES, 1.0)
    return built


def _map_size(plan: Plan, slab: PreparedSlab) -> SizePx:
    dpi = plan.job.tile.dpi
    if plan.job.texture.map_size_mm is None:
        return SizePx(
            *(
                min(_LARGEST_DEFAULT_MAP_PX, max(_SMALLEST_MAP_PX, round(_DEFAULT_MAP_SCALE * n)))
                for n in slab.valid.shape
            )
        )
    width, height = plan.job.texture.map_size_mm
    size = size_px_from_mm(SizeMm(width, height), dpi)
    if min(size.rows, size.cols) < _SMALLEST_MAP_PX or max(size.rows, size.cols) > _LARGEST_MAP_PX:
        raise SynthesisError(
            f"map_size_mm {width:g} x {height:g} is {size.cols} x {size.rows} pixels at {dpi:g} dpi; a map has "
            f"{_SMALLEST_MAP_PX} to 32,768 pixels a side"
        )
    return size
