"""What the operator marked as not to be cut, taken through the same steps as the slab that it lies on.

Weights are (rows, cols) uint8: 0 where seams may pass as they like, 255 where they should not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tilefab.slab.atlas import AtlasRecord
from tilefab.slab.bands import over_bands
from tilefab.slab.kernels import warp_weights
from tilefab.slab.resampling import resampled_size
from tilefab.slab.squaring import SquaringRecord
from tilefab.types import SizePx

Weights = NDArray[np.uint8]

_BAND_ROWS = 256
_TOUCHING_PX = 1e-6


def square_weights(weights: Weights, record: SquaringRecord, threads: int = 1) -> Weights:
    """Weights of a scan, made upright and trimmed as its slab was.

    Parameters
    ----------
    weights
        (rows, cols) uint8, of the scan.
    record
        What `square_slab` did to it.
    threads
        Never changes the result.

    Returns
    -------
    numpy.ndarray
        uint8, of the squared slab's size; bilinear where the slab was turned.

    Raises
    ------
    ValueError
        If the weights are not of the scan's size.
    """
    _check(weights, record.size_before)
    after, trim = record.size_after, record.trim_px
    if record.matrix is None:
        return np.ascontiguousarray(weights[trim : trim + after.rows, trim : trim + after.cols])
    matrix = np.array(record.matrix)
    out = np.empty((after.rows, after.cols), np.uint8)
    over_bands(
        lambda band: warp_weights(weights, matrix, trim + band.start, trim, out[band]), after.rows, _BAND_ROWS, threads
    )
    return out


def resample_weights(weights: Weights, scale: float) -> Weights:
    """Weights brought to another resolution: a pixel weighs as much as the heaviest that it overlaps.

    So a stroke survives however thin it is.

    Parameters
    ----------
    weights
        (rows, cols) uint8.
    scale
        As for `resample`.

    Returns
    -------
    numpy.ndarray
        uint8, size as `resampled_size` tells; the weights themselves where the scale is 1.

    Examples
    --------
    >>> resample_weights(np.array([[0, 9, 0, 0, 0, 0]], np.uint8), 0.5).tolist()
    [[9, 0, 0]]
    """
    if scale == 1.0:
        return weights
    size = resampled_size(SizePx(*weights.shape), scale)
    out = np.empty((size.rows, size.cols), np.uint8)
    first_row, last_row = _overlapped(weights.shape[0], size.rows, scale)
    first_col, last_col = _overlapped(weights.shape[1], size.cols, scale)
    for top in range(0, size.rows, _BAND_ROWS):
        band = slice(top, min(top + _BAND_ROWS, size.rows))
        tall = _heaviest(weights, first_row[band], last_row[band], 0)
        out[band] = _heaviest(tall, first_col, last_col, 1)
    return out


def join_weights(weights: Sequence[Weights | None], record: AtlasRecord) -> Weights:
    """Weights of several slabs laid out as their slabs were, 0 in between and where a slab has none.

    Parameters
    ----------
    weights
        One for each slab.
    record
        What `build_atlas` did.

    Raises
    ------
    ValueError
        If weights and slabs differ in number or size.
    """
    if len(weights) != len(record.placements):
        raise ValueError(f"{len(weights)} weights for {len(record.placements)} slabs")
    out = np.zeros((record.size.rows, record.size.cols), np.uint8)
    for place in record.placements:
        own = weights[place.slab_index]
        if own is not None:
            _check(own, SizePx(place.rows, place.cols))
            out[place.row : place.row + place.rows, place.col : place.col + place.cols] = own
    return out


def _check(weights: Weights, size: SizePx) -> None:
    if weights.shape != (size.rows, size.cols) or weights.dtype != np.uint8:
        raise ValueError(f"weights are {weights.dtype} {weights.shape}, wanted uint8 ({size.rows}, {size.cols})")


def _overlapped(in_px: int, out_px: int, scale: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last input pixel that each output pixel overlaps by more than a touch."""
    edges = np.arange(out_px + 1) / scale
    first = np.floor(edges[:-1] + _TOUCHING_PX).astype(np.int64)
    last = np.ceil(edges[1:] - _TOUCHING_PX).astype(np.int64) - 1
    return np.minimum(first, in_px - 1), np.clip(last, 0, in_px - 1)


def _heaviest(weights: Weights, first: NDArray[np.int64], last: NDArray[np.int64], axis: int) -> Weights:
    out = np.take(weights, first, axis=axis)
    for step in range(1, int((last - first).max()) + 1):
        np.maximum(out, np.take(weights, np.minimum(first + step, last), axis=axis), out=out)
    return out
