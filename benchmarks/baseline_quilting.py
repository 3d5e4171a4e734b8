"""Image quilting as Efros and Freeman published it, to compare the product's walls with: one block after the other.

Nothing of the product uses this. It writes source maps, so that the measures of `tilefab.texture` apply.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.texture.matching import TemplateSearch, matching_image


def quilt(
    exemplar_lab: NDArray[np.floating],
    out_rows: int,
    out_cols: int,
    block: int,
    overlap: int,
    seed: int,
    tolerance: float = 0.1,
    exact: bool = True,
) -> NDArray[np.int32]:
    """Source map of a wall by sequential quilting in raster order.

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB; blocks are matched in half units of it.
    out_rows, out_cols
        Size of the wall in pixels.
    block
        Side of a block in pixels; the blocks' pitch is ``block - overlap``.
    overlap
        Width of the overlap in pixels, 1 to ``block - 1``.
    seed
        Of the random choices.
    tolerance
        A block is drawn from all places whose sum of squared differences over the overlap is at most
        ``1 + tolerance`` times the smallest.
    exact
        Whether places that match exactly may be drawn. If so, as published, a block is followed by its own
        continuation wherever the exemplar has one. If not, places with a sum of zero count only where there is
        no other.

    Returns
    -------
    ndarray of int32
        (out_rows, out_cols), flat index into the exemplar of each pixel.

    Raises
    ------
    ValueError
        If the overlap isn't smaller than the block, or the block larger than the exemplar.

    References
    ----------
    Efros and Freeman 2001, "Image quilting for texture synthesis and transfer", section 2.
    """
    rows, cols = exemplar_lab.shape[:2]
    if not 1 <= overlap < block <= min(rows, cols):
        raise ValueError(f"blocks of {block} px with {overlap} px of overlap can't be cut from {rows} x {cols}")
    random = np.random.default_rng(seed)
    image = matching_image(exemplar_lab)
    search = TemplateSearch(image)
    pixels = image.reshape(-1, 3)
    index = np.arange(rows * cols, dtype=np.int32).reshape(rows, cols)
    pitch = block - overlap
    n_down, n_across = (max(1, -(-(n - overlap) // pitch)) for n in (out_rows, out_cols))
    wall = np.zeros((n_down * pitch + overlap, n_across * pitch + overlap), dtype=np.int32)
    for i in range(n_down):
        for j in range(n_across):
            there = wall[i * pitch : i * pitch + block, j * pitch : j * pitch + block]
            known = np.zeros((block, block), dtype=bool)
            known[:overlap] |= i > 0
            known[:, :overlap] |= j > 0
            before = pixels[there]
            if not known.any():
                row, col = random.integers(rows - block + 1), random.integers(cols - block + 1)
            else:
                sums = search.squared_differences(before, known)
                if not exact and (sums > 0).any():
                    sums[sums == 0] = sums.max() + 1
                candidates = np.flatnonzero(sums <= (1.0 + tolerance) * sums.min())
                row, col = divmod(int(random.choice(candidates)), sums.shape[1])
            error = ((image[row : row + block, col : col + block].astype(np.int64) - before) ** 2).sum(axis=2)
            take = np.ones((block, block), dtype=bool)
            if j > 0:
                cut = minimum_error_cut(error[:, :overlap])
                take[:, :overlap] &= np.arange(overlap) >= cut[:, None]
            if i > 0:
                cut = minimum_error_cut(np.ascontiguousarray(error[:overlap].T))
                take[:overlap] &= np.arange(overlap)[:, None] >= cut
            there[take] = index[row : row + block, col : col + block][take]
    return np.ascontiguousarray(wall[:out_rows, :out_cols])


@kernel
def minimum_error_cut(error: NDArray[np.int64]) -> NDArray[np.int64]:
    """The cheapest 8-connected path from the first to the last row: its column in each row, (rows,).

    By dynamic programming (Efros and Freeman 2001, section 2.1).
    """
    rows, cols = error.shape
    total = error.copy()
    for r in range(1, rows):
        for c in range(cols):
            best = total[r - 1, c]
            if c > 0:
                best = min(best, total[r - 1, c - 1])
            if c + 1 < cols:
                best = min(best, total[r - 1, c + 1])
            total[r, c] += best
    path = np.empty(rows, dtype=np.int64)
    path[-1] = np.argmin(total[-1])
    for r in range(rows - 2, -1, -1):
        begin = max(path[r + 1] - 1, 0)
        end = min(path[r + 1] + 2, cols)
        path[r] = begin + np.argmin(total[r, begin:end])
    return path
