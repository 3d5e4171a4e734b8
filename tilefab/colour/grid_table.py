"""Images through colour tables, fast: 8 and 16 bit counts in integers, and floating point.

A `ColourTable` that is one grid with curves before and behind is compiled as it stands; any other chain is sampled
into such a grid first (`bake`). Grids are interpolated over simplices, which for three inputs are tetrahedra
(Kasson, Nin, Plouffe and Hafner 1995, "Performing color space conversions with three-dimensional linear
interpolation"). Results of counts are integers throughout: they don't depend on machine, threads or strips.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from tilefab.colour.grid_bake import bake
from tilefab.colour.grid_kernels import CURVE_COUNT_BITS, apply_grid, shape_bytes, shape_words
from tilefab.colour.grid_layout import (
    BLOCK_PIXELS,
    channels_in,
    check_grid,
    each_strip,
    from_unit_stage,
    lanes_of,
    padded_nodes,
    strides_of,
    unit_stage,
)
from tilefab.colour.stages import ColourTable, Curves, Float64Array, Grid, Matrix, Stage
from tilefab.jit import FRACTION_BITS

_MOST_KNOTS = 1 << 16
_FAR = 8.0


@dataclass(frozen=True)
class CompiledTable:
    """A conversion of counts, made by `compile_table`.

    Attributes
    ----------
    inputs, outputs
        Channels, 1 to 8.
    dtype_in, dtype_out
        uint8 or uint16.
    """

    inputs: int
    outputs: int
    dtype_in: np.dtype[Any]
    dtype_out: np.dtype[Any]
    _positions: NDArray[np.uint32] = field(repr=False)
    _strides: tuple[int, ...] = field(repr=False)
    _nodes: NDArray[Any] = field(repr=False)
    _lanes: tuple[int, ...] = field(repr=False)
    _bytes: NDArray[np.uint8] | None = field(repr=False, default=None)
    _words: tuple[NDArray[np.int64], NDArray[np.uint64], NDArray[np.uint64]] | None = field(repr=False, default=None)

    def apply(
        self, image: NDArray[np.integer[Any]], *, threads: int = 1, out: NDArray[np.integer[Any]] | None = None
    ) -> NDArray[Any]:
        """Convert an image.

        Parameters
        ----------
        image
            (rows, cols, inputs) of ``dtype_in``; 0 to the largest count is 0 to 1, CIELAB and XYZ as in `unit_stage`.
        threads
            Number of threads, 1 or more; never changes the result.
        out
            Where to write: (rows, cols, outputs) of ``dtype_out``, C-contiguous, sharing no memory with the image.
            None makes a new array.

        Returns
        -------
        numpy.ndarray
            (rows, cols, outputs) of ``dtype_out``: within one count of the rounded `ColourTable`.

        Raises
        ------
        ValueError
            If shape, dtype, layout or the number of threads are none of the above.
        """
        if image.ndim != 3 or image.shape[2] != self.inputs or image.dtype != self.dtype_in:
            raise ValueError(
                f"the image must be (rows, cols, {self.inputs}) {self.dtype_in}, but is {image.shape} {image.dtype}"
            )
        shape = (*image.shape[:2], self.outputs)
        if out is None:
            out = np.empty(shape, self.dtype_out)
        elif out.shape != shape or out.dtype != self.dtype_out or not (out.flags.carray and out.flags.writeable):
            raise ValueError(f"out must be {shape} {self.dtype_out}, C-contiguous, but is {out.shape} {out.dtype}")
        elif np.may_share_memory(image, out):
            raise ValueError("out must share no memory with the image")
        flat = out.reshape(-1)

        def convert(strip: NDArray[Any], to: int) -> None:
            self._convert(strip.reshape(-1), len(strip) * strip.shape[1], flat, to)

        each_strip(image, convert, threads)
        return out

    def _convert(self, flat: NDArray[Any], pixels: int, out: NDArray[Any], to: int) -> None:
        grid = (self._positions, self._strides, self._nodes, self._lanes, self.outputs)
        if self._bytes is None and self._words is None:
            apply_grid(flat, 0, pixels, *grid, out, to)
            return
        middle = np.empty(min(pixels, BLOCK_PIXELS) * self.outputs, self._nodes.dtype)
        for begin in range(0, pixels, BLOCK_PIXELS):
            count = min(BLOCK_PIXELS, pixels - begin)
            apply_grid(flat, begin, count, *grid, middle, 0)
            if self._bytes is not None:
                shape_bytes(middle, count, self.outputs, self._bytes, out, to + begin)
            elif self._words is not None:
                shape_words(middle, count, self.outputs, *self._words, out, to + begin)


def _each_alone(stage: Stage) -> bool:
    """Whether a stage treats every channel by itself."""
    if isinstance(stage, Matrix):
        matrix = stage.matrix
        return matrix.shape[0] == matrix.shape[1] and bool(np.all(matrix == np.diag(np.diag(matrix))))
    return isinstance(stage, Curves)


def is_one_grid(table: ColourTable) -> bool:
    """Whether `compile_table` takes a table exactly: one grid, other stages treating every channel by itself."""
    others = [stage for stage in table.stages if not _each_alone(stage)]
    return len(others) == 1 and isinstance(others[0], Grid)


def _straight(stage: Stage, values: Float64Array) -> bool:
    """Whether a stage that treats every channel by itself is a straight line where the values (M, O) lie."""
    if isinstance(stage, Matrix):
        return True
    if not isinstance(stage, Curves) or values.min() < 0.0 or values.max() > 1.0:
        return False
    return all(
        np.allclose(curve, np.linspace(curve[0], curve[-1], len(curve)), rtol=0.0, atol=1e-9) for curve in stage.curves
    )


def _counts_dtype(dtype: DTypeLike) -> np.dtype[Any]:
    if np.dtype(dtype) not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise ValueError(f"counts must be uint8 or uint16, not {np.dtype(dtype)}")
    return np.dtype(dtype)


def compile_table(
    table: ColourTable, dtype_in: DTypeLike, dtype_out: DTypeLike, *, grid_nodes: int | None = None
) -> CompiledTable:
    """Make a table ready for images of counts.

    Parameters
    ----------
    table
        1 to 8 channels in and out. Curves and scalings, one grid, curves and scalings are taken exactly; any other
        chain is sampled into a grid (`bake`).
    dtype_in, dtype_out
        uint8 or uint16, of the images to convert and of the results.
    grid_nodes
        Nodes on each axis where the chain has to be sampled, 2 to 255; None for `DEFAULT_NODES`.

    Returns
    -------
    CompiledTable
        Its results are within one count of the rounded float64 table (of the baked one where it was sampled).

    Raises
    ------
    ValueError
        If the table, a dtype or the number of nodes are none of the above, or a node is not a finite number.

    Examples
    --------
    >>> nodes = np.array([0.0, 1.0, 0.5])[:, np.newaxis]
    >>> table = compile_table(ColourTable("gray", "ink", (Grid(nodes),)), np.uint8, np.uint8)
    >>> table.apply(np.array([[[0], [51], [255]]], np.uint8)).tolist()
    [[[0], [102], [128]]]
    """
    into, target_dtype = _counts_dtype(dtype_in), _counts_dtype(dtype_out)
    if not table.stages:
        raise ValueError("a table without stages converts nothing")
    if not is_one_grid(table):
        table = bake(table, table.source, table.target, channels_in(table.stages[0]), nodes=grid_nodes)
    middle, grid = next((place, stage) for place, stage in enumerate(table.stages) if isinstance(stage, Grid))
    check_grid(grid)
    axes, outputs = grid.values.shape[:-1], grid.values.shape[-1]
    node_dtype: DTypeLike = np.uint16 if target_dtype == np.uint8 else np.uint32
    positions = _positions(table, table.stages[:middle], axes, into, FRACTION_BITS[8 * np.dtype(node_dtype).itemsize])
    after = (*table.stages[middle + 1 :], unit_stage(table.target, outputs))
    values, rest = _fold(grid.values.reshape(-1, outputs), after)
    fields = (len(axes), outputs, into, target_dtype, positions, strides_of(axes, lanes_of(outputs)))
    lanes = (0,) * lanes_of(outputs)
    if not rest and values.min() >= 0.0 and values.max() <= 1.0:
        scale = 65280.0 if target_dtype == np.uint8 else 65535.0 * 2**15
        return CompiledTable(*fields, padded_nodes(values * scale, node_dtype), lanes)
    low, high = np.minimum(values.min(axis=0), 0.0), np.maximum(values.max(axis=0), 1.0)
    nodes = (values - low) / (high - low)
    if target_dtype == np.uint8:
        found = _finish(rest, low, high, _MOST_KNOTS)
        table_bytes = np.rint(255.0 * np.clip(found, 0.0, 1.0)).astype(np.uint8)
        return CompiledTable(*fields, padded_nodes(65535.0 * nodes, node_dtype), lanes, table_bytes.T.reshape(-1))
    return CompiledTable(*fields, padded_nodes(2.0**31 * nodes, node_dtype), lanes, None, _knots(rest, low, high))


def _positions(
    table: ColourTable, before: Sequence[Stage], axes: tuple[int, ...], dtype: np.dtype[Any], bits: int
) -> NDArray[np.uint32]:
    """For each channel the position of every count on its axis, as `tilefab.jit.blend_simplex` wants it."""
    top = int(np.iinfo(dtype).max)
    values = np.repeat((np.arange(top + 1) / top)[:, np.newaxis], len(axes), axis=1)
    for stage in (from_unit_stage(table.source, len(axes)), *before):
        values = stage(values)
    if not np.isfinite(values).all():
        raise ValueError("the curves before the grid give values that are no numbers")
    cells = np.array(axes) - 1
    place = np.rint(np.clip(values, 0.0, 1.0) * cells * 2.0**bits).astype(np.int64)
    cell = np.minimum(place >> bits, cells - 1)
    packed: NDArray[np.uint32] = ((cell << (bits + 1)) | (place - (cell << bits))).astype(np.uint32).T.reshape(-1)
    return packed


def _fold(values: Float64Array, after: Sequence[Stage]) -> tuple[Float64Array, list[Stage]]:
    """Nodes (M, O) with all straight stages behind the grid applied, and the stages that are left."""
    rest = list(after)
    while rest and _straight(rest[0], values):
        values = rest.pop(0)(values)
    if not rest:
        # Rounding of a scale's inverse may leave a node a hair outside.
        values = np.where(np.abs(values - np.clip(values, 0.0, 1.0)) < 1e-9, np.clip(values, 0.0, 1.0), values)
    return values, rest


def _finish(rest: Sequence[Stage], low: Float64Array, high: Float64Array, knots: int) -> Float64Array:
    """What the last stages make of even steps from ``low`` to ``high``: (knots, O), not clipped."""
    values = low + (high - low) * np.linspace(0.0, 1.0, knots)[:, np.newaxis]
    for stage in rest:
        values = stage(values)
    if not np.isfinite(values).all() or np.abs(values).max() > _FAR:
        raise ValueError("the curves behind the grid lead far out of the range of their results")
    return values


def _knots(
    rest: Sequence[Stage], low: Float64Array, high: Float64Array
) -> tuple[NDArray[np.int64], NDArray[np.uint64], NDArray[np.uint64]]:
    """Knots of the output curves, where each channel's begin, and how many segments it has.

    The curve's own knots where one curve is all there is, so that nothing is lost; else as many as a table may have.
    """
    curved = [stage for stage in rest if isinstance(stage, Curves)]
    knots: list[Float64Array] = []
    starts, segments = [], []
    for channel in range(len(low)):
        count = 2 if not curved else _MOST_KNOTS
        if len(curved) == 1 and low[channel] == 0.0 and high[channel] == 1.0:
            count = min(count, len(curved[0].curves[channel]))
        found = _finish(rest, low, high, count)[:, channel]
        starts.append(sum(len(part) for part in knots))
        segments.append(count - 1)
        knots.append(np.append(found, found[-1]))
    counts = np.rint(np.concatenate(knots) * 65535.0 * 2**CURVE_COUNT_BITS).astype(np.int64)
    return counts, np.array(starts, dtype=np.uint64), np.array(segments, dtype=np.uint64)
