"""The solid of colours that a press's inks can mix within the profile's limits, as a field over Lab."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_erosion, binary_fill_holes, gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull, QhullError

from tilefab.pipeline.profile_tables import Float64Array

EDGE = 0.5
"""Occupancy on the solid's surface."""

_CELLS_WANTED = 50_000
_PITCHES = (0.75, 2.5)
_BORDER = 7
_SOFTENING_CELLS = 0.8
_LIGHT_SOFTENING_CELLS = 1.6
_CLOSED = 5


@dataclass(frozen=True)
class Solid:
    """Which colours can be mixed.

    Attributes
    ----------
    occupancy
        (L, A, B) softened occupancy of cells: 1 deep inside, `EDGE` on the surface, 0 far outside.
    slopes
        (3, L, A, B) its slope, softened more, for light and shade.
    first
        (3,) L*, a*, b* of the centre of the first cell.
    pitch
        Side of a cell, in units of Lab.
    hull_volume
        Volume of the convex hull of the colours, in cubic units of Lab.
    """

    occupancy: Float64Array = field(repr=False)
    slopes: Float64Array = field(repr=False)
    first: Float64Array
    pitch: float
    hull_volume: float

    @property
    def volume(self) -> float:
        """Cubic units of Lab inside the surface."""
        return float((self.occupancy >= EDGE).sum()) * self.pitch**3

    def at(self, lab: NDArray[np.floating]) -> Float64Array:
        """The occupancy at colours (..., 3): (...)."""
        place = np.moveaxis((np.asarray(lab, dtype=np.float64) - self.first) / self.pitch, -1, 0)
        return np.asarray(map_coordinates(self.occupancy, place, order=1, mode="constant"), dtype=np.float64)

    def normals(self, lab: NDArray[np.floating]) -> Float64Array:
        """Unit vectors out of the solid at colours (M, 3)."""
        place = ((np.asarray(lab, dtype=np.float64) - self.first) / self.pitch).T
        out = -np.stack([map_coordinates(slope, place, order=1, mode="nearest") for slope in self.slopes], axis=1)
        return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9), dtype=np.float64)

    def cells(self) -> Float64Array:
        """Centres (K, 3) of the cells inside the surface."""
        return np.asarray(np.argwhere(self.occupancy >= EDGE) * self.pitch + self.first, dtype=np.float64)


def fill_solid(mixed: Float64Array) -> Solid:
    """The solid that many mixed colours (M, 3) fill: cells that hold one, small gaps closed, hollows filled.

    Cells are as small as leaves most of them with several colours: a small gamut is shown as sharply as a large one.
    """
    hull = _hull_volume(mixed)
    pitch = float(np.clip((hull / _CELLS_WANTED) ** (1.0 / 3.0), *_PITCHES))
    cell = np.floor(mixed / pitch).astype(np.int64)
    low = cell.min(axis=0) - _BORDER
    size = cell.max(axis=0) + _BORDER + 1 - low
    held = np.zeros(size, dtype=np.bool_)
    held[tuple((cell - low).T)] = True
    held = binary_fill_holes(binary_closing(held, iterations=_CLOSED))
    # A cell on the surface holds a colour wherever the surface cuts it: half of it is inside in the mean.
    filled = 0.5 * (held.astype(np.float64) + binary_erosion(held))
    slopes = np.stack(np.gradient(gaussian_filter(filled, _LIGHT_SOFTENING_CELLS)))
    return Solid(gaussian_filter(filled, _SOFTENING_CELLS), slopes, (low + 0.5) * pitch, pitch, hull)


def _hull_volume(points: Float64Array) -> float:
    try:
        return float(ConvexHull(points).volume)
    except (QhullError, ValueError):
        return 0.0
