"""Kernels that take images through colour tables: `tilefab.colour.grid_table` prepares what they get.

Integers only where counts are wanted: results are the same on every machine. ``simplex_plain`` and ``shape_plain`` are
the plain twins.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import FINISH_SHIFTS, FRACTION_BITS, blend_simplex, kernel

CURVE_UNIT_BITS = 31
"""What goes into a curve of `shape_words`: 0 to 1 as 0 to 2**31."""

CURVE_COUNT_BITS = 12
"""What comes out: a count has this many bits below the point."""


@kernel
def apply_grid(
    image: NDArray[Any],
    begin: int,
    pixels: int,
    positions: NDArray[np.uint32],
    strides: tuple[int, ...],
    nodes: NDArray[Any],
    lanes: tuple[int, ...],
    outputs: int,
    out: NDArray[Any],
    to: int,
) -> None:
    """Pixels of a flat image, from pixel ``begin``, into the flat ``out``, from its pixel ``to`` (see `blend_simplex`).

    Lanes beyond the outputs overwrite what the next pixel then replaces; the last pixels take a detour, so that
    nothing outside the run is touched.
    """
    inputs = len(strides)
    width = len(lanes)
    done = 0
    while done * outputs + width <= pixels * outputs:
        blend_simplex(image, (begin + done) * inputs, positions, strides, nodes, lanes, out, (to + done) * outputs)
        done += 1
    spare = np.empty(width, out.dtype)
    while done < pixels:
        blend_simplex(image, (begin + done) * inputs, positions, strides, nodes, lanes, spare, 0)
        for channel in range(outputs):
            out[(to + done) * outputs + channel] = spare[channel]
        done += 1


@kernel
def shape_bytes(
    middle: NDArray[np.uint16],
    pixels: int,
    outputs: int,
    tables: NDArray[np.uint8],
    out: NDArray[np.uint8],
    to: int,
) -> None:
    """Output curves in 8 bits: every count of 16 bits has its result in ``tables``, (outputs * 65536,)."""
    for pixel in range(np.uint64(pixels)):
        for channel in range(np.uint64(outputs)):
            at = pixel * np.uint64(outputs) + channel
            out[np.uint64(to) * np.uint64(outputs) + at] = tables[(channel << np.uint64(16)) | np.uint64(middle[at])]


@kernel
def shape_words(
    middle: NDArray[np.uint32],
    pixels: int,
    outputs: int,
    knots: NDArray[np.int64],
    starts: NDArray[np.uint64],
    segments: NDArray[np.uint64],
    out: NDArray[np.uint16],
    to: int,
) -> None:
    """Output curves in 16 bits: straight lines between knots (`CURVE_COUNT_BITS`), the last one there twice."""
    for pixel in range(np.uint64(pixels)):
        for channel in range(np.uint64(outputs)):
            at = pixel * np.uint64(outputs) + channel
            place = np.uint64(middle[at]) * segments[channel]
            knot = starts[channel] + (place >> np.uint64(CURVE_UNIT_BITS))
            part = np.int64(place & np.uint64((1 << CURVE_UNIT_BITS) - 1))
            low = knots[knot]
            value = low + (((knots[knot + np.uint64(1)] - low) * part) >> CURVE_UNIT_BITS)
            count = (value + (1 << (CURVE_COUNT_BITS - 1))) >> CURVE_COUNT_BITS
            out[np.uint64(to) * np.uint64(outputs) + at] = np.uint16(min(max(count, 0), 65535))


@kernel
def curve_floats(values: NDArray[np.float64], pixels: int, channel: int, curve: NDArray[np.float64]) -> None:
    """A channel of values (pixels, channels), clipped to 0 to 1, through a curve, in place; NaN counts as 0."""
    segments = len(curve) - 1
    for pixel in range(pixels):
        value = values[pixel, channel]
        if not value > 0.0:
            values[pixel, channel] = curve[0]
        elif value >= 1.0:
            values[pixel, channel] = curve[segments]
        else:
            place = value * segments
            knot = min(int(place), segments - 1)
            values[pixel, channel] = curve[knot] + (place - knot) * (curve[knot + 1] - curve[knot])


@kernel
def matrix_floats(
    values: NDArray[np.float64],
    pixels: int,
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Values (pixels, I) through a matrix (O, I) and an offset, summed in the order of the channels."""
    for pixel in range(pixels):
        for row in range(len(offset)):
            total = 0.0
            for column in range(matrix.shape[1]):
                total += matrix[row, column] * values[pixel, column]
            out[pixel, row] = total + offset[row]


@kernel
def place_floats(
    values: NDArray[np.float64], pixels: int, counts: NDArray[np.int64], positions: NDArray[np.uint32]
) -> None:
    """Positions (`blend_simplex`) of values 0 to 1, clipped, on axes of ``counts`` nodes; not a number counts as 0."""
    for pixel in range(pixels):
        for channel in range(len(counts)):
            value = values[pixel, channel]
            cells = counts[channel] - 1
            place = 0.0
            if value >= 1.0:
                place = float(cells)
            elif value > 0.0:
                place = value * cells
            cell = min(int(place), cells - 1)
            fraction = int((place - cell) * 8388608.0 + 0.5)
            positions[pixel * len(counts) + channel] = (cell << 24) | fraction


def simplex_plain(
    counts: NDArray[np.integer[Any]],
    positions: NDArray[np.uint32],
    strides: tuple[int, ...],
    nodes: NDArray[Any],
    outputs: int,
    dtype: np.dtype[Any],
) -> NDArray[Any]:
    """Plain twin of `apply_grid`: counts (M, I) to results (M, outputs)."""
    node_bits = 8 * nodes.dtype.itemsize
    fraction_bits = FRACTION_BITS[node_bits]
    shift = FINISH_SHIFTS[node_bits, 8 * dtype.itemsize]
    table = positions.reshape(len(strides), -1).tolist()
    flat = nodes.tolist()
    out = np.empty((len(counts), outputs), dtype)
    for row, pixel in enumerate(counts.tolist()):
        places = [table[channel][count] for channel, count in enumerate(pixel)]
        cells = [place >> (fraction_bits + 1) for place in places]
        fractions = [place & ((2 << fraction_bits) - 1) for place in places]
        node = sum(cell * stride for cell, stride in zip(cells, strides, strict=True))
        sums = [flat[node + channel] << fraction_bits for channel in range(outputs)]
        for axis in sorted(range(len(strides)), key=lambda axis: -fractions[axis]):
            for channel in range(outputs):
                step = flat[node + strides[axis] + channel] - flat[node + channel]
                sums[channel] += step * fractions[axis]
            node += strides[axis]
        out[row] = [(total + (1 << (shift - 1))) >> shift for total in sums]
    return out


def shape_plain(middle: NDArray[np.uint32], curves: list[list[int]]) -> NDArray[np.uint16]:
    """Plain twin of `shape_words`: (M, O) through the knots of a curve for each channel."""
    out = np.empty(middle.shape, np.uint16)
    for channel, curve in enumerate(curves):
        for row, value in enumerate(middle[:, channel].tolist()):
            knot, part = divmod(value * (len(curve) - 1), 1 << CURVE_UNIT_BITS)
            high = curve[min(knot + 1, len(curve) - 1)]
            exact = curve[knot] + (((high - curve[knot]) * part) >> CURVE_UNIT_BITS)
            out[row, channel] = min(max((exact + (1 << (CURVE_COUNT_BITS - 1))) >> CURVE_COUNT_BITS, 0), 65535)
    return out
