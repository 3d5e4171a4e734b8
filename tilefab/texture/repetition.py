"""How much a wall copied from an exemplar repeats itself.

A wall copied from an exemplar is described by its *source map*: for each of its pixels the flat index,
``row * exemplar columns + column``, of the exemplar's pixel that it shows. A pixel's *offset* is its place in the
exemplar minus its place in the wall; where the offset is constant, a piece of the exemplar is shown whole.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.texture.matching import window_is_valid
from tilefab.types import Array, Mask

WALL_SIDE_EXEMPLARS = 10
"""Coverage is compared at walls of 10 x 10 exemplars."""


@dataclass(frozen=True)
class Usage:
    """How a wall uses its exemplar.

    Attributes
    ----------
    coverage
        Share of the exemplar's valid pixels shown at least once, 0 to 1.
    coverage_10x10
        The same for a wall of 10 x 10 exemplars: the mean over the disjoint windows of that size that the wall
        holds. None for a smaller wall. A larger wall covers more, so coverages compare only at one size.
    most_over_mean
        How often the most used valid pixel is shown, divided by the mean of all valid ones: >= 1.
    count
        (exemplar rows, exemplar cols) int64: how often each pixel is shown.
    """

    coverage: float
    coverage_10x10: float | None
    most_over_mean: float
    count: NDArray[np.int64]


@dataclass(frozen=True)
class Verbatim:
    """How often chunks of the exemplar come back whole, per exemplar area of wall.

    Attributes
    ----------
    mean, most
        Over all places of a chunk in the exemplar. The exemplar laid out side by side gives 1.0 for both.
    """

    mean: float
    most: float


def usage(source: NDArray[np.int32], exemplar_shape: tuple[int, int], valid: Mask | None = None) -> Usage:
    """How much of the exemplar a wall shows, and how evenly.

    Parameters
    ----------
    source
        (rows, cols) int32, the wall's source map.
    exemplar_shape
        Rows and columns of the exemplar.
    valid
        (exemplar rows, exemplar cols), True where the exemplar may be shown; all of it if None. Other pixels are
        counted, but don't enter the figures.

    Returns
    -------
    Usage
        Coverage, the most used pixel and the counts.

    Raises
    ------
    ValueError
        If a shape is wrong, the wall empty, no pixel valid, or the map points outside the exemplar.

    Examples
    --------
    >>> used = usage(np.array([[0, 1, 0, 1], [2, 3, 0, 1]], dtype=np.int32), (2, 3))
    >>> used.count.tolist(), round(used.coverage, 3), used.most_over_mean
    ([[3, 3, 1], [1, 0, 0]], 0.667, 2.25)
    """
    _check(source, exemplar_shape)
    usable = np.ones(exemplar_shape, dtype=bool) if valid is None else np.asarray(valid, dtype=bool)
    if usable.shape != tuple(exemplar_shape):
        raise ValueError(f"the mask {usable.shape} and the exemplar {tuple(exemplar_shape)} differ in shape")
    if not usable.any():
        raise ValueError("no pixel of the exemplar is valid")
    count = _counts(source, exemplar_shape)
    of_valid = count[usable]
    mean = of_valid.mean()
    rows, cols = (WALL_SIDE_EXEMPLARS * n for n in exemplar_shape)
    shares = [
        np.count_nonzero(_counts(source[r : r + rows, c : c + cols], exemplar_shape)[usable]) / of_valid.size
        for r in range(0, source.shape[0] - rows + 1, rows)
        for c in range(0, source.shape[1] - cols + 1, cols)
    ]
    return Usage(
        coverage=float(np.count_nonzero(of_valid) / of_valid.size),
        coverage_10x10=float(np.mean(shares)) if shares else None,
        most_over_mean=float(of_valid.max() / mean) if mean > 0 else 1.0,
        count=count,
    )


def verbatim(
    source: NDArray[np.int32],
    exemplar_shape: tuple[int, int],
    chunk_share: float = 1 / 16,
    valid: Mask | None = None,
) -> Verbatim:
    """How often a chunk of the exemplar comes back whole in a wall.

    Parameters
    ----------
    source
        (rows, cols) int32, the wall's source map.
    exemplar_shape
        Rows and columns of the exemplar.
    chunk_share
        Area of a chunk divided by that of the exemplar, over 0 to 1; a chunk has the exemplar's proportions.
    valid
        (exemplar rows, exemplar cols), True where the exemplar may be shown; only chunks that are valid throughout
        count. All if None.

    Returns
    -------
    Verbatim
        Mean and maximum over all chunks of the exemplar, exactly. Both are 0.0 if no chunk is valid.

    Raises
    ------
    ValueError
        If a shape or ``chunk_share`` is wrong, the wall empty, or the map points outside the exemplar.

    Examples
    --------
    >>> exemplar = np.arange(64, dtype=np.int32).reshape(8, 8)
    >>> verbatim(np.tile(exemplar, (2, 3)), (8, 8))
    Verbatim(mean=1.0, most=1.0)
    """
    _check(source, exemplar_shape)
    if not 0.0 < chunk_share <= 1.0:
        raise ValueError(f"a chunk is over 0 and at most 1 of the exemplar, not {chunk_share}")
    rows, cols = (max(1, round(n * math.sqrt(chunk_share))) for n in exemplar_shape)
    on_map = np.ascontiguousarray(source, dtype=np.int32)
    count = _whole_chunks(on_map, exemplar_shape[0], exemplar_shape[1], rows, cols)
    if valid is not None:
        if valid.shape != tuple(exemplar_shape):
            raise ValueError(f"the mask {valid.shape} and the exemplar {tuple(exemplar_shape)} differ in shape")
        count = count[window_is_valid(valid, rows, cols)]
    if count.size == 0:
        return Verbatim(0.0, 0.0)
    areas = source.size / (exemplar_shape[0] * exemplar_shape[1])
    return Verbatim(mean=float(count.mean() / areas), most=float(count.max() / areas))


def gather_cells(wall: Array, pitch_px: int | tuple[int, int], origin_px: tuple[int, int] = (0, 0)) -> Array:
    """The whole cells of a lattice over a wall, one after the other in reading order.

    Parameters
    ----------
    wall
        (rows, cols) or (rows, cols, channels): a source map or the wall itself.
    pitch_px
        Side of a cell, or its rows and columns.
    origin_px
        Row and column of a cell's corner, >= 0.

    Returns
    -------
    ndarray
        (cells, cell rows, cell cols) or (cells, cell rows, cell cols, channels), of the wall's dtype.

    Raises
    ------
    ValueError
        If a pitch is not positive, the origin negative, or no whole cell fits.
    """
    cell_rows, cell_cols = (pitch_px, pitch_px) if isinstance(pitch_px, int) else pitch_px
    if min(cell_rows, cell_cols) < 1 or min(origin_px) < 0:
        raise ValueError(f"cells of {cell_rows} x {cell_cols} from {origin_px} on make no lattice")
    down, across = (wall.shape[0] - origin_px[0]) // cell_rows, (wall.shape[1] - origin_px[1]) // cell_cols
    if min(down, across) < 1:
        raise ValueError(f"no cell of {cell_rows} x {cell_cols} fits into {wall.shape[:2]} from {origin_px} on")
    inside = wall[origin_px[0] :, origin_px[1] :][: down * cell_rows, : across * cell_cols]
    cells = inside.reshape(down, cell_rows, across, cell_cols, *wall.shape[2:]).swapaxes(1, 2)
    return np.ascontiguousarray(cells.reshape(down * across, cell_rows, cell_cols, *wall.shape[2:]))


def static_share(cells: NDArray[np.int32]) -> float:
    """Share of a cell's places at which more than half of all cells show the same pixel of the exemplar.

    Parameters
    ----------
    cells
        (cells, rows, cols) int32 from `gather_cells` of a source map.

    Returns
    -------
    float
        0 to 1. A wall whose seams all avoid a place of the lattice, and whose crops come from few places, is static
        there.

    Raises
    ------
    ValueError
        If there are no cells, or the shape is wrong.
    """
    if cells.ndim != 3 or cells.size == 0:
        raise ValueError(f"cells of a source map are (cells, rows, cols) and not empty, not {cells.shape}")
    return float(np.mean(_has_majority(np.ascontiguousarray(cells, dtype=np.int32))))


def lattice_ghost(cells_lab: NDArray[np.floating], exemplar_lab: NDArray[np.floating]) -> float:
    """How much of a picture is left when all cells of a lattice are averaged, compared with random crops.

    Parameters
    ----------
    cells_lab
        (cells, rows, cols) lightness or (cells, rows, cols, channels) CIELAB, from `gather_cells` of a wall.
    exemplar_lab
        The exemplar, (rows, cols) or (rows, cols, channels) to match, no smaller than a cell.

    Returns
    -------
    float
        Variance over the cell's places of the mean over N cells, summed over channels, divided by what N independent
        crops uniform over the exemplar would give on average: 1.0 = no ghost of the lattice, N = all cells alike
        (at most: an uneven exemplar leaves a mean of crops uneven too). 1.0 for an exemplar of one colour.

    Raises
    ------
    ValueError
        If the shapes don't match, or a cell is larger than the exemplar.

    Notes
    -----
    The expectation is exact, not drawn. With m(x) the mean over all crops of the pixel at the cell's place x, it is
    ``E[variance within a crop] / N + (1 - 1 / N) variance of m``.
    """
    if cells_lab.ndim not in (3, 4) or exemplar_lab.ndim != cells_lab.ndim - 1 or cells_lab.size == 0:
        raise ValueError(f"cells {cells_lab.shape} and exemplar {exemplar_lab.shape} don't match")
    if cells_lab.shape[3:] != exemplar_lab.shape[2:]:
        raise ValueError(f"cells {cells_lab.shape} and exemplar {exemplar_lab.shape} differ in channels")
    n_cells, rows, cols = cells_lab.shape[:3]
    if rows > exemplar_lab.shape[0] or cols > exemplar_lab.shape[1]:
        raise ValueError(f"cells of {rows} x {cols} are larger than an exemplar of {exemplar_lab.shape[:2]}")
    # Counted from one of its own colours, a flat exemplar is exactly zero.
    zero = exemplar_lab[0, 0].astype(np.float64)
    exemplar = (exemplar_lab.astype(np.float64) - zero).reshape(*exemplar_lab.shape[:2], -1)
    mean = (cells_lab.mean(axis=0, dtype=np.float64) - zero).reshape(rows, cols, -1)
    observed = float(mean.var(axis=(0, 1)).sum())
    expected = 0.0
    for channel in np.moveaxis(exemplar, 2, 0):
        of_crops = _window_means(channel**2, rows, cols) - _window_means(channel, rows, cols) ** 2
        crops_rows, crops_cols = channel.shape[0] - rows + 1, channel.shape[1] - cols + 1
        of_mean = _window_means(channel, crops_rows, crops_cols).var()
        expected += float(of_crops.mean() / n_cells + (1 - 1 / n_cells) * of_mean)
    if expected <= 0.0:
        return 1.0
    return observed / expected


def _check(source: Array, exemplar_shape: tuple[int, int]) -> None:
    if source.ndim != 2 or source.size == 0:
        raise ValueError(f"a source map is (rows, cols) and not empty, not {source.shape}")
    n_pixels = exemplar_shape[0] * exemplar_shape[1]
    if int(source.min()) < 0 or int(source.max()) >= n_pixels:
        raise ValueError(f"the source map points outside an exemplar of {tuple(exemplar_shape)}")


def _counts(source: NDArray[np.int32], exemplar_shape: tuple[int, int]) -> NDArray[np.int64]:
    n_pixels = exemplar_shape[0] * exemplar_shape[1]
    count: NDArray[np.int64] = np.bincount(source.ravel(), minlength=n_pixels).astype(np.int64)
    return count.reshape(exemplar_shape)


def _window_means(values: NDArray[np.float64], rows: int, cols: int) -> NDArray[np.float64]:
    """Mean over every window of ``rows`` x ``cols``, by the place of its top left corner."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(np.cumsum(values, axis=0), axis=1, out=total[1:, 1:])
    sums = total[rows:, cols:] - total[:-rows, cols:] - total[rows:, :-cols] + total[:-rows, :-cols]
    means: NDArray[np.float64] = sums / (rows * cols)
    return means


@kernel
def _whole_chunks(
    source: NDArray[np.int32], exemplar_rows: int, exemplar_cols: int, rows: int, cols: int
) -> NDArray[np.int64]:
    """How often each chunk of ``rows`` x ``cols`` stands whole in the wall, by the place of its top left corner.

    A window is whole if its rows are and its last column is: both are runs that grow by one pixel at a time.
    """
    count = np.zeros((exemplar_rows - rows + 1, exemplar_cols - cols + 1), dtype=np.int64)
    # For each column of the wall: over how many rows, up to this one, whole runs have ended there with one offset.
    height = np.zeros(source.shape[1], dtype=np.int64)
    for r in range(source.shape[0]):
        run = 0
        for c in range(source.shape[1]):
            here = source[r, c]
            # The next index is no neighbour where a row of the exemplar ends.
            goes_on = c > 0 and here == source[r, c - 1] + 1 and here % exemplar_cols != 0
            run = run + 1 if goes_on else 1
            if run < cols:
                height[c] = 0
            elif height[c] > 0 and here == source[r - 1, c] + exemplar_cols:
                height[c] += 1
            else:
                height[c] = 1
            if height[c] >= rows:
                count[here // exemplar_cols - rows + 1, here % exemplar_cols - cols + 1] += 1
    return count


@kernel
def _has_majority(cells: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Where more than half of all cells hold one value (Boyer and Moore 1981: a vote, then a count)."""
    n_cells, rows, cols = cells.shape
    candidate = cells[0].copy()
    lead = np.zeros((rows, cols), dtype=np.int64)
    for i in range(n_cells):
        for r in range(rows):
            for c in range(cols):
                if lead[r, c] == 0:
                    candidate[r, c] = cells[i, r, c]
                lead[r, c] += 1 if cells[i, r, c] == candidate[r, c] else -1
    votes = np.zeros((rows, cols), dtype=np.int64)
    for i in range(n_cells):
        for r in range(rows):
            for c in range(cols):
                votes[r, c] += cells[i, r, c] == candidate[r, c]
    majority: NDArray[np.bool_] = votes * 2 > n_cells
    return majority
