"""Walls: many faces side by side, as people will see them, at a size that fits a page.

A wall of crops is never rendered whole: its crops are halved until they are just larger than the picture wants, joined
at that size, and shrunk the rest of the way, all in linear light.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import reduce_srgb
from tilefab.colour.spaces import rgb_lin_from_srgb, srgb_from_rgb_lin
from tilefab.errors import OutputError
from tilefab.pipeline.faces import face_region, render_face
from tilefab.pipeline.plan import Plan
from tilefab.sampling import CropMap, TextureMap, render_reduced

GROUT_RGB = 205
LINEAR_SPACE = "linear srgb16"
_LINEAR_FULL = 65535
_MOST_AT_ONCE_PX = 1 << 25


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
    small = _Reduced(plan, proof, factor, threads) if isinstance(proof, CropMap) and factor > 1 else None
    for row in range(rows):
        shown = [wall_index(plan, row, col, cols, first) for col in range(cols)]
        shown = [index for index in shown if end is None or index < end]
        if small is not None and columns is not None and shown and row % (at_once := small.rows_at_once(cols)) == 0:
            last = min(row + at_once, rows) - 1
            small.prepare(shown[0], wall_index(plan, last, cols - 1, cols, first))
        for col, index in enumerate(shown):
            if small is not None:
                face = small.face(index, face_rows, face_cols)
            else:
                face = reduce_srgb(render_face(plan, proof, index, threads=threads, bleed=False), factor)
            top, left = row * (face_rows + grout_px), col * (face_cols + grout_px)
            wall[top : top + face_rows, left : left + face_cols] = face[:face_rows, :face_cols]
            if progress is not None:
                progress((row * cols + col + 1) / (rows * cols))
    if progress is not None:
        progress(1.0)
    return wall


class _Reduced:
    """Faces of a map of crops at a fraction of their size, without rendering them whole."""

    def __init__(self, plan: Plan, proof: CropMap, factor: int, threads: int | None) -> None:
        self.plan, self.factor, self.threads = plan, factor, threads
        self.level = min(factor.bit_length() - 1, proof.coarsest_level)
        linear = np.rint(rgb_lin_from_srgb(np.arange(256) / 255) * _LINEAR_FULL).astype(np.uint16)
        light = np.arange(_LINEAR_FULL + 1) / _LINEAR_FULL
        self.srgb = np.rint(255 * np.clip(srgb_from_rgb_lin(light), 0, 1)).astype(np.uint8)
        self.linear = proof.with_base(linear[proof.base], LINEAR_SPACE, proof.channels)
        self.window: NDArray[np.uint16] | None = None
        self.top = self.left = 0

    def rows_at_once(self, cols: int) -> int:
        """How many rows of so many faces to prepare together."""
        tile = self.plan.tile_px
        return max(1, _MOST_AT_ONCE_PX // ((cols * tile.cols * tile.rows) >> 2 * self.level or 1))

    def prepare(self, first: int, last: int) -> None:
        """Render a rectangle of faces that run on, from its upper left one to its lower right one, at once."""
        begin, end = (face_region(self.plan, self.linear, index) for index in (first, last))
        self._render(begin.row, begin.col, end.row + end.rows - begin.row, end.col + end.cols - begin.col)

    def face(self, index: int, rows: int, cols: int) -> NDArray[np.uint8]:
        """One face without bleed, (rows, cols, 3) sRGB."""
        region = face_region(self.plan, self.linear, index)
        bleed = self.plan.bleed_px
        if self.plan.job.tile.columns is None:
            self._render(region.row, region.col, region.rows, region.cols)
        assert self.window is not None
        scale = 1 << self.level
        step = self.factor / scale
        down, right = (region.row + bleed) / scale - self.top, (region.col + bleed) / scale - self.left
        top, left = int(down), int(right)
        part = self.window[top : top + int(rows * step) + 2, left : left + int(cols * step) + 2]
        picture = box_shrink(part.astype(np.float32), down - top, step, rows)
        picture = box_shrink(picture.transpose(1, 0, 2), right - left, step, cols).transpose(1, 0, 2)
        face: NDArray[np.uint8] = self.srgb[np.rint(picture).astype(np.int64)]
        return face

    def _render(self, row: int, col: int, rows: int, cols: int) -> None:
        scale = 1 << self.level
        self.top, self.left = row // scale, col // scale
        size = (-(-(row + rows) // scale) - self.top, -(-(col + cols) // scale) - self.left)
        self.window = np.asarray(
            render_reduced(
                self.linear,
                self.top,
                self.left,
                *size,
                level=self.level,
                seed=self.plan.seed,
                threads=self.threads,
            )
        )


def box_shrink(image: NDArray[np.float32], begin: float, step: float, count: int) -> NDArray[np.float32]:
    """Means over ``count`` boxes of ``step`` rows each from row ``begin`` on, parts of rows counted as parts.

    >>> box_shrink(np.arange(6, dtype=np.float32).reshape(6, 1, 1), 0.5, 1.5, 2).ravel().tolist()
    [0.6666666865348816, 2.1666667461395264]
    """
    low = begin + step * np.arange(count)
    first = np.floor(low).astype(np.int64)
    total = np.zeros((count, *image.shape[1:]), dtype=np.float32)
    for k in range(int(np.ceil(step)) + 1):
        inside = np.minimum(first + k + 1, low + step) - np.maximum(first + k, low)
        share = (np.clip(inside, 0, 1) / step).astype(np.float32)
        total += image[np.clip(first + k, 0, len(image) - 1)] * share[:, None, None]
    return total


def wall_index(plan: Plan, row: int, col: int, cols: int, first: int) -> int:
    """Face shown at one place of a wall; a continuous layout keeps its own columns, so that neighbours join."""
    columns = plan.job.tile.columns
    return first + row * (columns if columns is not None else cols) + col
