"""How grids and images lie in memory for the kernels of `tilefab.colour.grid_kernels`."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tilefab.colour.stages import Curves, Float64Array, Grid, Matrix, Space, Stage

MOST_CHANNELS = 8
MOST_NODES = 255
"""Nodes on an axis, as in ICC profiles."""

BLOCK_PIXELS = 1 << 13
"""Pixels whose values between two steps fit the processor's cache."""

_STRIP_PIXELS = 1 << 17
_SCALES = {"lab": np.array([100.0, 255.0, 255.0]), "xyz": np.full(3, 65535.0 / 32768.0)}
_SHIFTS = {"lab": np.array([0.0, 128.0, 128.0])}


def unit_stage(space: Space, channels: int) -> Matrix:
    """What makes 0 to 1 of values in the units of a space: counts are this times their largest.

    CIELAB as in `tilefab.colour.encoding`, XYZ as ICC's u1Fixed15Number, all others as they are.
    """
    scale = _SCALES.get(space, np.ones(channels))
    if len(scale) != channels:
        raise ValueError(f"{space} has 3 channels, not {channels}")
    return Matrix(np.diag(1.0 / scale), _SHIFTS.get(space, np.zeros(channels)) / scale)


def from_unit_stage(space: Space, channels: int) -> Matrix:
    """The inverse of `unit_stage`."""
    forward = unit_stage(space, channels)
    scale = 1.0 / np.diag(forward.matrix)
    return Matrix(np.diag(scale), -forward.offset * scale)


def channels_in(stage: Stage) -> int:
    """How many channels a stage takes."""
    if isinstance(stage, Curves):
        return len(stage.curves)
    return stage.matrix.shape[1] if isinstance(stage, Matrix) else stage.values.ndim - 1


def check_grid(grid: Grid) -> None:
    """Refuse, with a ValueError, what the kernels have no room for."""
    axes, outputs = grid.values.shape[:-1], grid.values.shape[-1]
    if not 1 <= len(axes) <= MOST_CHANNELS or not 1 <= outputs <= MOST_CHANNELS:
        raise ValueError(f"a grid of {len(axes)} inputs and {outputs} outputs: both must be 1 to {MOST_CHANNELS}")
    if min(axes) < 2 or max(axes) > MOST_NODES:
        raise ValueError(f"a grid of {axes} nodes: each axis must have 2 to {MOST_NODES}")
    if not np.isfinite(grid.values).all():
        raise ValueError("a grid holds values that are no numbers")


def strides_of(axes: tuple[int, ...], width: int) -> tuple[int, ...]:
    """How far a step along each axis goes in flat nodes of ``width`` numbers."""
    return tuple(width * int(np.prod(axes[axis + 1 :])) for axis in range(len(axes)))


def lanes_of(outputs: int) -> int:
    """Numbers that a node takes: what processors load at once."""
    return 4 if outputs <= 4 else 8


def padded_nodes(nodes: Float64Array, dtype: DTypeLike) -> NDArray[Any]:
    """Nodes (M, O) as flat rows of 4 or 8."""
    wide = np.zeros((len(nodes), lanes_of(nodes.shape[1])), dtype)
    wide[:, : nodes.shape[1]] = np.rint(nodes) if np.dtype(dtype).kind == "u" else nodes
    return wide.reshape(-1)


def each_strip(image: NDArray[Any], convert: Callable[[NDArray[Any], int], None], threads: int) -> None:
    """Call ``convert`` with strips of rows, C-contiguous, and the number of the first pixel of each."""
    if threads < 1:
        raise ValueError(f"threads {threads} must be 1 or more")
    rows, cols = image.shape[:2]
    step = max(1, _STRIP_PIXELS // max(cols, 1))

    def one(start: int) -> None:
        convert(np.require(image[start : start + step], None, ["C", "A"]), start * cols)

    starts = range(0, rows if cols else 0, step)
    if threads == 1 or len(starts) < 2:
        for start in starts:
            one(start)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(one, starts))
