"""A face as few cells: gathered from an image of the tile, or from a small rendering, and freed of uneven light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.chart.finding import fit_homography
from tilefab.inspection.fingerprint_kernels import average_cells, gather_cells
from tilefab.types import Mask, SizeMm, SizePx

Plane = NDArray[np.float32]

_LEAST_SUB, _MOST_SUB = 3, 16
_PLACES_PER_PX = 1.0
_LEAST_SHARE = 0.5
_LEAST_AROUND = 0.02


@dataclass(frozen=True, eq=False)
class Cells:
    """A face on a grid of cells.

    Attributes
    ----------
    lightness
        float32 (rows, cols): L* of each cell's mean light.
    seen
        bool (rows, cols): cells of which at least half is seen.
    """

    lightness: Plane
    seen: Mask


def grid_of(size_mm: SizeMm, cells: int) -> SizePx:
    """Grid of nearly square cells over a tile, as many as wanted or a few less.

    >>> grid_of(SizeMm(600.0, 300.0), 1024)
    SizePx(rows=22, cols=45)
    """
    side = math.sqrt(cells * size_mm.width / size_mm.height)
    cols = max(1, min(cells, math.floor(side)))
    rows = max(1, min(cells // cols, round(cols * size_mm.height / size_mm.width)))
    return SizePx(rows, cols)


def face_corners(corners_px: NDArray[np.float64], quarter_turns: int) -> NDArray[np.float64]:
    """Corners (4, 2) of the face, from its own upper left one, of a tile turned clockwise by quarter turns.

    ``corners_px`` begin with the upper left one as the tile lies in the image; see `FoundTile`.
    """
    return np.asarray(np.roll(corners_px, -quarter_turns, axis=0), dtype=np.float64)


def matrix_of(corners_px: NDArray[np.float64], grid: SizePx) -> NDArray[np.float64]:
    """Homography (3, 3) that takes (x, y, 1) in cells of a face to pixels of an image, by the face's corners there."""
    square = np.array([[0, 0], [grid.cols, 0], [grid.cols, grid.rows], [0, grid.rows]], dtype=np.float64)
    return fit_homography(square, corners_px)


def cells_of_image(light: Plane, mask: Mask, matrix: NDArray[np.float64], grid: SizePx) -> Cells:
    """Cells of a face in an image.

    Parameters
    ----------
    light
        float32 (rows, cols) Y, linear.
    mask
        bool (rows, cols): pixels that show the tile.
    matrix
        From cells to pixels, see `matrix_of`.
    grid
        Rows and columns of cells.
    """
    pixels = math.sqrt(abs(float(np.linalg.det(matrix[:2, :2]))))
    sub = int(np.clip(math.ceil(_PLACES_PER_PX * pixels), _LEAST_SUB, _MOST_SUB))
    mean, share = np.empty((grid.rows, grid.cols), np.float32), np.empty((grid.rows, grid.cols), np.float32)
    gather_cells(light, mask, matrix, sub, mean, share)
    return Cells(lightness(mean), share >= _LEAST_SHARE)


def cells_of_view(view: Plane, grid: SizePx) -> Cells:
    """Cells of a face from a rendering of it (rows, cols), L*: means over each cell's area."""
    mean = np.empty((grid.rows, grid.cols), dtype=np.float32)
    average_cells(np.ascontiguousarray(view, dtype=np.float32), mean)
    return Cells(mean, np.ones((grid.rows, grid.cols), dtype=np.bool_))


def lightness(light: Plane) -> Plane:
    """CIE L* (CIE 15:2004) of linear Y; negative light counts as none."""
    ratio = np.maximum(light, np.float32(0.0))
    cube = np.where(ratio > 216 / 24389, np.cbrt(ratio), (np.float32(24389 / 27) * ratio + 16.0) / 116.0)
    return np.asarray(np.float32(116.0) * cube - np.float32(16.0), dtype=np.float32)


class Window:
    """Weighted means around each cell, over what is seen only.

    Parameters
    ----------
    weights
        float32 (rows, cols): 1 where seen, else 0.
    sigma
        Standard deviation of what is around, cells.
    """

    def __init__(self, weights: Plane, sigma: float) -> None:
        self.weights = weights
        self._sigma = sigma
        self._total = np.maximum(self._gathered(weights), np.float32(_LEAST_AROUND))

    def mean(self, values: Plane) -> Plane:
        """Means (rows, cols) of values around each cell."""
        return np.asarray(self._gathered(values * self.weights) / self._total, dtype=np.float32)

    def _gathered(self, values: Plane) -> Plane:
        out = ndimage.gaussian_filter(values, self._sigma, mode="constant", truncate=3.0)
        return np.asarray(out, dtype=np.float32)


def detail(cells: Cells, sigma: float) -> Plane:
    """Lightness less its mean around each cell, so that light that falls off slowly has no part in it; 0 if unseen."""
    weights = cells.seen.astype(np.float32)
    return np.asarray((cells.lightness - Window(weights, sigma).mean(cells.lightness)) * weights, dtype=np.float32)
