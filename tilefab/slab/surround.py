"""Telling a slab from the scanner's bed on a reduced copy of the scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.slab.bands import over_bands
from tilefab.types import FloatImage, Mask

_REDUCED_SIDE_PX = 700
_RING_CELLS = 3
_SMOOTHING_CELLS = 1.5
_MIN_RING_SHARE = 0.9
_MAX_SCATTER_DE = 3.0
_MIN_TOLERANCE_DE = 4.0
_SCATTER_FACTOR = 5.0
_WHITE_D50 = np.array([0.9642, 1.0, 0.8249])


@dataclass(frozen=True)
class Surround:
    """The scanner's bed as seen on a copy reduced to cells of ``cell_px`` x ``cell_px`` pixels.

    Attributes
    ----------
    cell_px
        Side of a cell in pixels of the scan.
    bed
        bool, (cell rows, cell cols): cells that look like the bed and hang together with the scan's border.
    slab
        bool, same shape: the largest piece of everything else, its holes filled.
    scatter_de
        Median distance of the scan's border from a smooth bed, in CIELAB units.
    """

    cell_px: int
    bed: Mask
    slab: Mask
    scatter_de: float


def find_surround(image: FloatImage, valid: Mask, threads: int = 1) -> Surround | str:
    """Find the bed around a slab, or say in words why there is none to be relied on.

    The bed must be seen along nearly the whole border of the scan and follow one smooth surface of colour
    (a polynomial of degree 2 of the position, which takes up vignetting) with little scatter. A stone that
    fills the scan fails that, as does one with a dark vein along part of the border.

    Parameters
    ----------
    image
        float32, (rows, cols, 3), linear XYZ D50.
    valid
        bool, (rows, cols).
    threads
        Never changes the result.

    Returns
    -------
    Surround or str
    """
    cell_px = max(1, -(-max(valid.shape) // _REDUCED_SIDE_PX))
    cells, known = reduced_copy(image, valid, cell_px, threads)
    if min(known.shape) < 8 * _RING_CELLS:
        return "the scan is too small to tell a slab from its surround"
    lab = perceptual(cells)
    weights = ndimage.gaussian_filter(known.astype(np.float64), _SMOOTHING_CELLS)
    for channel in range(3):
        smooth = ndimage.gaussian_filter(np.where(known, lab[..., channel], 0.0), _SMOOTHING_CELLS)
        lab[..., channel] = smooth / np.maximum(weights, 1e-6)
    ring = np.ones(known.shape, np.bool_)
    ring[_RING_CELLS:-_RING_CELLS, _RING_CELLS:-_RING_CELLS] = False
    ring &= known
    if not ring.any():
        return "no pixel along the scan's border is valid"
    model = _fit_bed(lab, ring)
    distance = np.sqrt(((lab - model) ** 2).sum(axis=-1))
    scatter = float(np.median(distance[ring]))
    if scatter > _MAX_SCATTER_DE:
        return f"the scan's border is no uniform surround (it scatters by {scatter:.1f} dE)"
    tolerance = max(_MIN_TOLERANCE_DE, _SCATTER_FACTOR * scatter)
    like_bed = (distance < tolerance) | ~known
    share = float(like_bed[ring].mean())
    if share < _MIN_RING_SHARE:
        return f"only {100 * share:.0f} % of the scan's border looks like one surround"
    labels, _ = ndimage.label(like_bed)
    edge_labels = np.unique(labels[ring])
    bed = np.isin(labels, edge_labels[edge_labels > 0])
    pieces, count = ndimage.label(ndimage.binary_opening(~bed, np.ones((3, 3))))
    if count == 0:
        return "the scan shows one uniform surface"
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    slab = ndimage.binary_fill_holes(pieces == sizes.argmax())
    return Surround(cell_px, bed, np.asarray(slab, np.bool_), scatter)


def reduced_copy(image: FloatImage, valid: Mask, cell_px: int, threads: int = 1) -> tuple[NDArray[np.float64], Mask]:
    """Mean of the valid pixels of each cell; a rest at the right or bottom smaller than a cell is left out.

    Returns
    -------
    cells
        float64, (rows // cell_px, cols // cell_px, 3).
    known
        bool: cells with at least half of their pixels valid.
    """
    rows, cols = valid.shape[0] // cell_px, valid.shape[1] // cell_px
    cells = np.zeros((rows, cols, 3))
    known = np.zeros((rows, cols), np.bool_)

    def one_row(of_cells: slice) -> None:
        row = of_cells.start
        band = slice(row * cell_px, (row + 1) * cell_px)
        mask = valid[band, : cols * cell_px].reshape(cell_px, cols, cell_px)
        pixels = image[band, : cols * cell_px].reshape(cell_px, cols, cell_px, 3)
        weight = mask.sum(axis=(0, 2))
        if weight.min() < cell_px * cell_px:
            pixels = np.where(mask[..., None], pixels, np.float32(0.0))
        total = pixels.sum(axis=0, dtype=np.float32).sum(axis=1, dtype=np.float64)
        cells[row] = total / np.maximum(weight, 1)[:, None]
        known[row] = 2 * weight >= cell_px * cell_px

    over_bands(one_row, rows, 1, threads)
    return cells, known


def perceptual(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """CIELAB D50 (CIE 15:2004) of linear XYZ, for telling colours apart; negative light counts as none."""
    ratio = np.maximum(xyz, 0.0) / _WHITE_D50
    f = np.where(ratio > 216 / 24389, np.cbrt(ratio), (24389 / 27 * ratio + 16.0) / 116.0)
    return np.stack(
        [116.0 * f[..., 1] - 16.0, 500.0 * (f[..., 0] - f[..., 1]), 200.0 * (f[..., 1] - f[..., 2])], axis=-1
    )


def _fit_bed(lab: NDArray[np.float64], ring: Mask) -> NDArray[np.float64]:
    """Smooth colour of the bed over the whole scan: degree 2, reweighted from the median outward."""
    rows, cols = ring.shape
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    design, colours = basis[ring], lab[ring]
    fitted = np.broadcast_to(np.median(colours, axis=0), colours.shape)
    coefficients = np.zeros((6, 3))
    for _ in range(8):
        residual = np.sqrt(((colours - fitted) ** 2).sum(axis=-1))
        reach = 4.0 * max(float(np.median(residual)), 0.5)
        weight = np.maximum(1.0 - (residual / reach) ** 2, 0.0)
        coefficients = np.linalg.lstsq(design * weight[:, None], colours * weight[:, None], rcond=None)[0]
        fitted = design @ coefficients
    return np.asarray(basis @ coefficients)
