"""Tracing a point of a face back to the stone: which scan shows it, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tilefab.errors import ConfigError, Problem
from tilefab.pipeline.faces import face_region
from tilefab.pipeline.growing_slab import before_growing
from tilefab.pipeline.plan import MAPS_FOLDER, Plan
from tilefab.sampling import CropMap, SlabArea, TextureMap
from tilefab.sampling.crop_plan import plan_region
from tilefab.sampling.tracing import slab_at, trace_points
from tilefab.units import MM_PER_INCH, mm_from_px


@dataclass(frozen=True)
class TracedPoint:
    """Where a pixel of a face comes from. All places are (x, y) from the top left, pixels counted from 0.

    Attributes
    ----------
    face
        Index of the face.
    face_px
        The pixel, from the corner of the finished tile; negative in the bleed.
    plane_px
        The same on the endless plane.
    base_px
        In the map's base image.
    slab
        Which slab that is; ``None`` if the map doesn't say.
    slab_px, slab_mm
        On the prepared slab: squared, trimmed, at print resolution; millimetres at the middle of the pixel. If the job
        grows the slab, before it was grown, as long as the map of places lies beside the texture map.
    crop
        The crop that shows it; ``None`` for another design.
    """

    face: int
    face_px: tuple[int, int]
    plane_px: tuple[int, int]
    base_px: tuple[int, int]
    slab: SlabArea | None
    slab_px: tuple[int, int] | None
    slab_mm: tuple[float, float] | None
    crop: int | None


def point_px(plan: Plan, text: str, *, in_mm: bool) -> tuple[int, int]:
    """Pixel of a face, (x, y), from ``X,Y`` as an operator writes it.

    Raises
    ------
    ConfigError
        If that isn't two numbers, or lies beyond the face and its bleed.
    """
    option = "--at" if in_mm else "--px"
    try:
        first, second = (float(part) if in_mm else int(part) for part in text.split(","))
    except ValueError as error:
        raise _error(option, text, "is not X,Y: two numbers with a comma between") from error
    scale = plan.job.tile.dpi / MM_PER_INCH if in_mm else 1.0
    size, bleed = plan.tile_px, plan.bleed_px
    x, y = first * scale, second * scale
    if not (-bleed <= x < size.cols + bleed and -bleed <= y < size.rows + bleed):
        unit = f"{plan.tile_mm.width:g} x {plan.tile_mm.height:g} mm" if in_mm else f"{size.cols} x {size.rows} pixels"
        raise _error(option, text, f"is not on the face: a tile has {unit}, counted from its upper left corner")
    return int(np.floor(x)), int(np.floor(y))


def trace_face(plan: Plan, texture: TextureMap, index: int, x_px: int, y_px: int) -> TracedPoint:
    """Trace one pixel of a face.

    Parameters
    ----------
    plan
        The job.
    texture
        Any of its maps.
    index
        The face.
    x_px, y_px
        The pixel, counted from the corner of the finished tile.
    """
    region = face_region(plan, texture, index)
    row, col = region.row + plan.bleed_px + y_px, region.col + plan.bleed_px + x_px
    ((base_row, base_col),) = trace_points(
        texture, np.array([row], dtype=np.int64), np.array([col], dtype=np.int64), seed=plan.seed
    ).tolist()
    before = before_growing(plan, texture, plan.output / MAPS_FOLDER, base_row, base_col)
    slab = slab_at(texture, base_row, base_col)
    slab_px = slab_mm = None
    if before is not None:
        slab, slab_px = before[0], (before[2], before[1])
    elif slab is not None:
        slab_px = base_col - slab.base_col, base_row - slab.base_row
    if slab_px is not None:
        x_mm, y_mm = (round(mm_from_px(place + 0.5, texture.dpi), 2) for place in slab_px)
        slab_mm = x_mm, y_mm
    crop = _crop_at(plan, texture, (row, col), (base_row, base_col)) if isinstance(texture, CropMap) else None
    return TracedPoint(index, (x_px, y_px), (col, row), (base_col, base_row), slab, slab_px, slab_mm, crop)


def _crop_at(plan: Plan, texture: CropMap, at: tuple[int, int], base: tuple[int, int]) -> int | None:
    """Crop that shows a pixel of the plane: of those around, the one that has it in this place of the base."""
    region = plan_region(texture, at[0], at[1], 1, 1, seed=plan.seed)
    half = texture.overlap_px // 2
    for (i, j), crop in np.ndenumerate(region.crops):
        in_row = at[0] - (region.first_row + i) * texture.pitch_px + half
        in_col = at[1] - (region.first_col + j) * texture.pitch_px + half
        inside = 0 <= in_row < texture.crop_px and 0 <= in_col < texture.crop_px
        if inside and (int(texture.crop_row[crop]) + in_row, int(texture.crop_col[crop]) + in_col) == base:
            return int(crop)
    return None


def _error(option: str, text: str, message: str) -> ConfigError:
    return ConfigError([Problem(f"{option} {text}", None, "", message)])
