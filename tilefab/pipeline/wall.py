"""Walls: many faces side by side, as people will see them, at a size that fits a page."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import reduce_srgb
from tilefab.errors import OutputError
from tilefab.pipeline.faces import render_face
from tilefab.pipeline.plan import Plan
from tilefab.sampling import TextureMap

GROUT_RGB = 205


def render_wall(
    plan: Plan,
    proof: TextureMap,
    rows: int,
    cols: int,
    *,
    first: int = 0,
    end: int | None = None,
    largest_side_px: int = 4000,
    grout_mm: float = 2.0,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> NDArray[np.uint8]:
    """Picture of a wall of rows x cols faces, without bleed, laid in reading order from face ``first``.

    Parameters
    ----------
    plan
        The job. With its ``continuous`` layout and as many columns as it has, the veins run on.
    proof
        Its map in 8-bit sRGB, from `tilefab.pipeline.maps.proof_map`.
    rows, cols
        Size of the wall in faces, >= 1.
    first
        Index of the top left face.
    end
        Faces from this index on stay blank; ``None``: none do.
    largest_side_px
        The picture is reduced by a whole number so that its longer side isn't much larger.
    grout_mm
        Width of the joints; 0 for none.
    threads
        For rendering.
    progress
        Called with the share done.

    Returns
    -------
    ndarray of uint8
        (rows, cols, 3) sRGB.

    Raises
    ------
    OutputError
        If a continuous wall has no such columns side by side.
    """
    tile = plan.tile_px
    factor = max(1, -(-max(rows * tile.rows, cols * tile.cols) // largest_side_px))
    face_rows, face_cols = max(1, tile.rows // factor), max(1, tile.cols // factor)
    grout_px = 0
    if grout_mm > 0:
        grout_px = max(1, round(face_cols * grout_mm / plan.tile_mm.width))
    columns = plan.job.tile.columns
    if columns is not None and first % columns + cols > columns:
        raise OutputError(
            f"the job's wall has {columns} columns: {cols} from column {first % columns} on don't hang side by side; "
            "ask for fewer columns, or begin at the first"
        )
    wall = np.full(
        (rows * (face_rows + grout_px) - grout_px, cols * (face_cols + grout_px) - grout_px, 3),
        GROUT_RGB,
        dtype=np.uint8,
    )
    for row in range(rows):
        for col in range(cols):
            index = wall_index(plan, row, col, cols, first)
            if end is None or index < end:
                face = reduce_srgb(render_face(plan, proof, index, threads=threads, bleed=False), factor)
                top, left = row * (face_rows + grout_px), col * (face_cols + grout_px)
                wall[top : top + face_rows, left : left + face_cols] = face[:face_rows, :face_cols]
            if progress is not None:
                progress((row * cols + col + 1) / (rows * cols))
    return wall


def wall_index(plan: Plan, row: int, col: int, cols: int, first: int) -> int:
    """Face shown at one place of a wall; a continuous layout keeps its own columns, so that neighbours join."""
    columns = plan.job.tile.columns
    return first + row * (columns if columns is not None else cols) + col
