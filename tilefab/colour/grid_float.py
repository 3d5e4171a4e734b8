"""Images through colour tables in floating point, where counts aren't wanted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.grid_bake import Conversion
from tilefab.colour.grid_kernels import apply_grid, curve_floats, matrix_floats, place_floats
from tilefab.colour.grid_layout import (
    BLOCK_PIXELS,
    channels_in,
    check_grid,
    each_strip,
    lanes_of,
    padded_nodes,
    strides_of,
)
from tilefab.colour.stages import ColourTable, Curves, Float64Array, Matrix, Stage


def apply_float(table: ColourTable, image: NDArray[np.float32], *, threads: int = 1) -> NDArray[np.float32]:
    """Convert an image in floating point, all stages as they are.

    Parameters
    ----------
    table
        1 to 8 channels in and out of its grids, each axis of 255 nodes at most.
    image
        (rows, cols, I) float32 in the units of ``table.source``. What is not a number counts as 0 in curves and grids.
    threads
        Number of threads, 1 or more; never changes the result.

    Returns
    -------
    numpy.ndarray
        (rows, cols, O) float32 in the units of ``table.target``: as `ColourTable`, with nodes and weights of 24 bits.

    Raises
    ------
    ValueError
        If the table, shape, dtype or the number of threads are none of the above.
    """
    if not table.stages:
        raise ValueError("a table without stages converts nothing")
    inputs = channels_in(table.stages[0])
    if image.ndim != 3 or image.shape[2] != inputs or image.dtype != np.float32:
        raise ValueError(f"the image must be (rows, cols, {inputs}) float32, but is {image.shape} {image.dtype}")
    steps = [_float_step(stage) for stage in table.stages]
    outputs = len(table(np.zeros(inputs)))
    out = np.empty((*image.shape[:2], outputs), np.float32)
    flat_out = out.reshape(-1, outputs)

    def convert(strip: NDArray[Any], to: int) -> None:
        flat = strip.reshape(-1, inputs)
        for begin in range(0, len(flat), BLOCK_PIXELS):
            values = flat[begin : begin + BLOCK_PIXELS].astype(np.float64)
            for step in steps:
                values = step(values)
            if table.target in ("ink", "rgb", "gray"):
                values = np.clip(values, 0.0, 1.0)
            flat_out[to + begin : to + begin + len(values)] = values

    each_strip(image, convert, threads)
    return out


def _float_step(stage: Stage) -> Conversion:
    """A stage as a function of values (M, I) that it may overwrite."""
    if isinstance(stage, Matrix):
        matrix, offset = np.ascontiguousarray(stage.matrix), np.ascontiguousarray(stage.offset)

        def through_matrix(values: Float64Array) -> Float64Array:
            out = np.empty((len(values), len(offset)))
            matrix_floats(values, len(values), matrix, offset, out)
            return out

        return through_matrix
    if isinstance(stage, Curves):
        curves = [np.ascontiguousarray(curve) for curve in stage.curves]

        def through_curves(values: Float64Array) -> Float64Array:
            for channel, curve in enumerate(curves):
                curve_floats(values, len(values), channel, curve)
            return values

        return through_curves
    check_grid(stage)
    axes, outputs = stage.values.shape[:-1], stage.values.shape[-1]
    counts = np.array(axes, dtype=np.int64)
    nodes = padded_nodes(stage.values.reshape(-1, outputs), np.float32)
    strides, lanes = strides_of(axes, lanes_of(outputs)), (0,) * lanes_of(outputs)

    def through_grid(values: Float64Array) -> Float64Array:
        places = np.empty(len(values) * len(axes), np.uint32)
        place_floats(values, len(values), counts, places)
        out = np.empty(len(values) * outputs, np.float32)
        apply_grid(places, 0, len(values), places, strides, nodes, lanes, outputs, out, 0)
        return out.reshape(-1, outputs).astype(np.float64)

    return through_grid
