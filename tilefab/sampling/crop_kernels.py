"""The crop design's inner loops: pixels from a plan. Arrays in, pixels out; see `tilefab.sampling.crop_plan`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import copy_elements, kernel, settle, stream_elements
from tilefab.types import Array


@kernel
def _cell_at(
    upright: NDArray[np.int16], seam_shift: int, pitch: int, half: int, i: int, in_row: int, from_left: int
) -> int:
    """Column of cells that a pixel shows: of row i of cells, row ``in_row`` of its crops.

    ``from_left`` counts pixels from the left edge of the first cell.
    """
    j = (from_left + half) // pitch
    x = from_left + half - j * pitch
    if x < 2 * half and j >= 1 and x < np.int64(upright[i, j, in_row >> seam_shift]) << seam_shift:
        j -= 1
    return j


@kernel
def render_plan_rows_into(
    base: Array,
    base_cols: int,
    channels: int,
    level: int,
    crop_row: NDArray[np.int32],
    crop_col: NDArray[np.int32],
    pitch: int,
    overlap: int,
    from_top: int,
    from_left: int,
    crops: NDArray[np.int32],
    upright: NDArray[np.int16],
    seam_shift: int,
    turn_begin: NDArray[np.int64],
    turns: NDArray[np.int32],
    starts_above: NDArray[np.bool_],
    begin_row: int,
    rows: int,
    cols: int,
    streaming: bool,
    out: Array,
) -> None:
    """Render ``rows`` rows of a plan from its row ``begin_row`` on.

    ``base`` and ``out`` are flat arrays of interleaved pixels; ``from_top`` and ``from_left`` is where the plan's
    region begins, from the top left corner of its first cell. ``streaming``: past the cache, for large outputs.
    """
    half = overlap // 2
    for r in range(rows):
        down = from_top + begin_row + r
        i = (down + half) // pitch
        d = down + half - i * pitch
        turn = end_turn = np.int64(0)
        above = False
        if d < overlap and i >= 1:
            turn, end_turn = turn_begin[i, d], turn_begin[i, d + 1]
            above = starts_above[i, d]
        c = 0
        while c < cols:
            stop = int(np.int64(turns[turn])) if turn < end_turn else cols
            turn += 1
            own = i - 1 if above else i
            in_row = down + half - own * pitch
            j = _cell_at(upright, seam_shift, pitch, half, own, in_row, from_left + c)
            while c < stop:
                end = (j + 1) * pitch - half - from_left
                if j + 1 < crops.shape[1]:
                    end += int(np.int64(upright[own, j + 1, in_row >> seam_shift]) << seam_shift)
                end = min(end, stop)
                crop = crops[own, j]
                at_row = (crop_row[crop] >> level) + in_row
                at_col = (crop_col[crop] >> level) + from_left + c + half - j * pitch
                begin = (at_row * base_cols + at_col) * channels
                if streaming:
                    stream_elements(out, (r * cols + c) * channels, base, begin, (end - c) * channels)
                else:
                    copy_elements(out, (r * cols + c) * channels, base, begin, (end - c) * channels)
                c = end
                j += 1
            above = not above
    if streaming:
        settle()


@kernel
def render_plan_points_into(
    base: Array,
    level: int,
    crop_row: NDArray[np.int32],
    crop_col: NDArray[np.int32],
    pitch: int,
    overlap: int,
    first_row: int,
    first_col: int,
    crops: NDArray[np.int32],
    upright: NDArray[np.int16],
    across: NDArray[np.int16],
    seam_shift: int,
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    which: NDArray[np.int64],
    out: Array,
) -> None:
    """Render the pixels (rows[k], cols[k]) into ``out[k]`` for every k in ``which``; all lie within the plan."""
    half = overlap // 2
    for n in range(len(which)):
        k = which[n]
        down, right = rows[k] - first_row * pitch, cols[k] - first_col * pitch
        i = (down + half) // pitch
        d = down + half - i * pitch
        if d < overlap and i >= 1:
            from_middle = right - pitch // 2
            j = from_middle // pitch
            if d < np.int64(across[i, j + 1, (from_middle - j * pitch) >> seam_shift]) << seam_shift:
                i -= 1
        in_row = down + half - i * pitch
        j = _cell_at(upright, seam_shift, pitch, half, i, in_row, right)
        crop = crops[i, j]
        at_row = (crop_row[crop] >> level) + in_row
        at_col = (crop_col[crop] >> level) + right + half - j * pitch
        for channel in range(base.shape[2]):
            out[k, channel] = base[at_row, at_col, channel]
