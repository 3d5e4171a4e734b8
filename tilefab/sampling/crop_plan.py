"""A region of the crop design's plane, planned: which crops show there, and where they meet."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.rng import stream_key
from tilefab.sampling.crop_choice import choose_crops
from tilefab.sampling.crop_kernels import render_plan_points_into
from tilefab.sampling.crop_map import CropMap
from tilefab.sampling.crop_seams import level_seams_into, pins_into, upright_seams_into
from tilefab.types import Array


@dataclass(frozen=True, eq=False)
class CropPlan:
    """All that decides the pixels of a region, but for the pixels.

    Attributes
    ----------
    row, col, rows, cols
        The region, in pixels of its level.
    level
        How many times the plane is halved.
    first_row, first_col
        Top left cell of ``crops``.
    crops
        (cells, cells) int32: crop of each cell.
    upright, across
        Seams between cells side by side and between rows of cells, see `tilefab.sampling.crop_seams`.
    seam_shift
        A seam's pixel is 2**seam_shift pixels of the region.
    turn_begin, turns
        By row of pixels: where upper and lower cells take turns. In a row within the overlap of rows of cells i - 1
        and i, ``turns[turn_begin[i, d] : turn_begin[i, d + 1]]`` are the columns of the region at which they change.
    starts_above
        (lines, overlap) whether such a row begins with the upper cells.
    """

    row: int
    col: int
    rows: int
    cols: int
    level: int
    first_row: int
    first_col: int
    crops: NDArray[np.int32]
    upright: NDArray[np.int16]
    across: NDArray[np.int16]
    seam_shift: int
    turn_begin: NDArray[np.int64]
    turns: NDArray[np.int32]
    starts_above: NDArray[np.bool_]


def plan_region(
    crop_map: CropMap, row: int, col: int, rows: int, cols: int, *, seed: int, level: int = 0, threads: int = 1
) -> CropPlan:
    """Choose the crops of a region and find their seams.

    Parameters
    ----------
    crop_map
        The map.
    row, col, rows, cols
        The region in pixels of its level, rows and cols >= 1.
    seed
        Job seed.
    level
        Halvings, 0 .. ``crop_map.coarsest_level``.
    threads
        How many threads share the work; the plan doesn't depend on it.

    Returns
    -------
    CropPlan
    """
    if not 0 <= level <= crop_map.coarsest_level:
        raise ValueError(f"level {level} is not within 0 .. {crop_map.coarsest_level}")
    pitch, overlap = crop_map.pitch_px >> level, crop_map.overlap_px >> level
    half = overlap // 2
    first_row, last_row = (row - half) // pitch, (row + rows - 1 + half) // pitch
    # A seam between rows of cells runs from the middle of one cell to the middle of the next.
    first_col = (col + pitch // 2) // pitch - 1
    last_col = (col + cols - 1 + pitch // 2) // pitch
    cells = (last_row - first_row + 1, last_col - first_col + 1)
    crops = choose_crops(crop_map, stream_key(seed, "crops"), first_row, first_col, *cells)
    shift = crop_map.guide_shift
    finest = max(level - shift, 0)
    seam_shift = max(shift - level, 0)
    guide = crop_map.guide_levels
    crop_row = crop_map.crop_row.astype(np.int64) >> shift
    crop_col = crop_map.crop_col.astype(np.int64) >> shift
    pitch_guide, overlap_guide = crop_map.pitch_px >> shift, crop_map.overlap_px >> shift
    upright = np.zeros((*cells, (pitch_guide + overlap_guide) >> finest), dtype=np.int16)
    across = np.zeros((*cells, pitch_guide >> finest), dtype=np.int16)
    pins = np.zeros(cells, dtype=np.int64)
    common = (guide, crop_row, crop_col, pitch_guide, overlap_guide, crop_map.seam_levels, finest)

    def find_pins_and_upright(begin: int, end: int) -> None:
        upright_seams_into(upright, crops, begin, end, *common)
        pins_into(pins, crops, max(begin, 1), end, *common)

    share_rows(cells[0], threads, find_pins_and_upright)
    share_rows(
        cells[0],
        threads,
        lambda begin, end: level_seams_into(across, crops, upright, pins, max(begin, 1), end, *common),
    )
    turn_begin, turns, starts_above = find_turns(
        across, seam_shift, overlap, col - (first_col * pitch + pitch // 2), cols
    )
    return CropPlan(
        row,
        col,
        rows,
        cols,
        level,
        first_row,
        first_col,
        crops,
        upright,
        across,
        seam_shift,
        turn_begin,
        turns,
        starts_above,
    )


def plan_points_into(
    base: Array,
    crop_map: CropMap,
    plan: CropPlan,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    which: NDArray[np.int64],
    out: Array,
) -> None:
    """Copy from ``base``, an image of the plan's level, what points of a planned region show.

    ``out[k]`` becomes the pixel at (rows[k], cols[k]) for every k in ``which``.
    """
    render_plan_points_into(
        base,
        plan.level,
        crop_map.crop_row,
        crop_map.crop_col,
        crop_map.pitch_px >> plan.level,
        crop_map.overlap_px >> plan.level,
        plan.first_row,
        plan.first_col,
        plan.crops,
        plan.upright,
        plan.across,
        plan.seam_shift,
        rows,
        cols,
        which,
        out,
    )


def share_rows(rows: int, threads: int, work: Callable[[int, int], None]) -> None:
    """Call ``work(begin, end)`` for parts of 0 .. rows in as many threads."""
    parts = max(1, min(threads, rows))
    if parts == 1:
        work(0, rows)
        return
    bounds = [rows * k // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(parts) as pool:
        list(pool.map(work, bounds[:-1], bounds[1:]))


@kernel
def find_turns(
    across: NDArray[np.int16], seam_shift: int, overlap: int, begin: int, cols: int
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_]]:
    """Where upper and lower cells take turns along each row of pixels; see `CropPlan`.

    ``begin`` is the region's first column, counted from the middle of the first cell.
    """
    lines = across.shape[0]
    pitch = across.shape[2] << seam_shift
    turn_begin = np.zeros((lines, overlap + 1), dtype=np.int64)
    starts_above = np.zeros((lines, overlap), dtype=np.bool_)
    count = np.int64(0)
    for filling in range(2):
        turns = np.empty(count if filling else 0, dtype=np.int32)
        place = np.zeros(overlap, dtype=np.int64)
        for i in range(1, lines):
            if filling:
                place[:] = turn_begin[i, :overlap]
            else:
                place[:] = 0
            before = np.int64(-1)
            c = np.int64(0)
            while c < cols:
                from_middle = begin + c
                j = from_middle // pitch
                t = (from_middle - j * pitch) >> seam_shift
                now = np.int64(across[i, j + 1, t]) << seam_shift
                if before < 0:
                    if not filling:
                        for d in range(overlap):
                            starts_above[i, d] = d < now
                elif now != before:
                    for d in range(min(now, before), max(now, before)):
                        if filling:
                            turns[place[d]] = c
                        place[d] += 1
                before = now
                # The seam is the same up to the next of its own pixels.
                c = min(((t + 1) << seam_shift) + j * pitch - begin, np.int64(cols))
            if not filling:
                for d in range(overlap):
                    turn_begin[i, d] = count
                    count += place[d]
                turn_begin[i, overlap] = count
    return turn_begin, turns, starts_above
