"""Colour conversions as ICC profiles hold them: curves, matrices and grids, one after the other.

This is the plain form, evaluated in float64 with NumPy: what profiles are read into, and what the fast kernels of
`tilefab.colour.grid_table` are held against.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Float64Array = NDArray[np.float64]

Space = Literal["ink", "rgb", "gray", "lab", "xyz"]
"""What channels mean: ink fractions 0 to 1, RGB 0 to 1, gray 0 to 1, CIELAB (D50), or XYZ under D50 (Y = 1)."""


@dataclass(frozen=True)
class Curves:
    """A curve for each channel.

    Attributes
    ----------
    curves
        One (E,) array for each channel, E of its own and 2 upwards: values at even steps over 0 to 1, straight lines
        between.
    """

    curves: tuple[Float64Array, ...] = field(repr=False)

    def __call__(self, values: Float64Array) -> Float64Array:
        """Values (M, channels), clipped to 0 to 1, through the curves."""
        out = np.empty_like(values)
        for channel, curve in enumerate(self.curves):
            out[:, channel] = np.interp(values[:, channel], np.linspace(0.0, 1.0, len(curve)), curve)
        return out


@dataclass(frozen=True)
class Matrix:
    """``matrix @ value + offset``.

    Attributes
    ----------
    matrix
        (O, I).
    offset
        (O,).
    """

    matrix: Float64Array = field(repr=False)
    offset: Float64Array = field(repr=False)

    def __call__(self, values: Float64Array) -> Float64Array:
        """Values (M, I) to (M, O)."""
        return np.asarray(values @ self.matrix.T + self.offset, dtype=np.float64)


@dataclass(frozen=True)
class Grid:
    """A table on an even grid.

    Attributes
    ----------
    values
        (G_1, ..., G_I, O): each axis 2 nodes or more, the first one and the last one at 0 and 1. Interpolated over
        simplices: axes are walked in the order of their fractions, the largest first (three axes: tetrahedral).
    """

    values: Float64Array = field(repr=False)

    def __call__(self, values: Float64Array) -> Float64Array:
        """Values (M, I), clipped to 0 to 1, to (M, O)."""
        counts = np.array(self.values.shape[:-1])
        place = np.clip(values, 0.0, 1.0) * (counts - 1)
        cell = np.minimum(place.astype(np.int64), counts - 2)
        fraction = place - cell
        strides = np.array([int(np.prod(counts[axis + 1 :])) for axis in range(len(counts))])
        flat = self.values.reshape(-1, self.values.shape[-1])
        order = np.argsort(-fraction, axis=1, kind="stable")
        node = cell @ strides
        upper = np.ones(len(values))
        out = np.zeros((len(values), flat.shape[1]))
        for step in range(len(counts)):
            axis = order[:, step]
            lower = np.take_along_axis(fraction, axis[:, np.newaxis], axis=1)[:, 0]
            out += (upper - lower)[:, np.newaxis] * flat[node]
            node = node + strides[axis]
            upper = lower
        return np.asarray(out + upper[:, np.newaxis] * flat[node], dtype=np.float64)


Stage: TypeAlias = Curves | Matrix | Grid


@dataclass(frozen=True)
class ColourTable:
    """A conversion between two spaces.

    Attributes
    ----------
    source, target
        Spaces of what goes in and comes out, in their own units (`Space`).
    stages
        Applied in turn.
    """

    source: Space
    target: Space
    stages: tuple[Stage, ...] = field(repr=False)

    def __call__(self, values: NDArray[np.floating]) -> Float64Array:
        """Convert values (..., I) to (..., O), float64; ink, RGB and gray results are clipped to 0 to 1."""
        data = np.asarray(values, dtype=np.float64)
        out = data.reshape(-1, data.shape[-1])
        for stage in self.stages:
            out = stage(out)
        if self.target in ("ink", "rgb", "gray"):
            out = np.clip(out, 0.0, 1.0)
        return out.reshape(*data.shape[:-1], out.shape[-1])


def lab_to_unit(version: Literal[2, 4]) -> Matrix:
    """CIELAB to the 0 to 1 in which 16-bit ICC tables hold it: (ICC.1:2001-04 Annex A; ICC.1:2010 section 6.3.4.2)."""
    top = 65280.0 / 65535.0 if version == 2 else 1.0
    scale = np.array([top / 100.0, top / 255.0, top / 255.0])
    return Matrix(np.diag(scale), np.array([0.0, 128.0, 128.0]) * scale)


def lab_from_unit(version: Literal[2, 4]) -> Matrix:
    """The inverse of `lab_to_unit`."""
    forward = lab_to_unit(version)
    scale = 1.0 / np.diag(forward.matrix)
    return Matrix(np.diag(scale), -forward.offset * scale)


def grid_points(axes: tuple[Float64Array, ...]) -> Float64Array:
    """All combinations (M, I) of the values on each axis, the first axis slowest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
