"""How well the crops of a wall fit where they meet.

A wall copied from an exemplar is described by its *source map*: for each of its pixels the flat index,
``row * exemplar columns + column``, of the exemplar's pixel that it shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel


@dataclass(frozen=True)
class SeamCost:
    """What the seams of a wall cost.

    Attributes
    ----------
    mean_delta_e, p95_delta_e, worst_delta_e
        Mean, 95th percentile and greatest over all seams measured, CIE76. 0.0 if there are none.
    length_px
        Pairs of neighbours measured: the length of the seams in pixel edges.
    per_px_area
        Sum of all costs divided by the wall's pixels, CIE76: what many cheap seams and few dear ones are compared by.
    unmeasured_px
        Pairs on a seam left out because neither crop goes on in the exemplar.
    """

    mean_delta_e: float
    p95_delta_e: float
    worst_delta_e: float
    length_px: int
    per_px_area: float
    unmeasured_px: int


def seam_cost(source: NDArray[np.int32], exemplar_lab: NDArray[np.floating], *, toroidal: bool = False) -> SeamCost:
    """Cost of the seams of a wall, by how much the crops that meet there disagree.

    Parameters
    ----------
    source
        (rows, cols) int32, the wall's source map: flat index into the exemplar of each pixel.
    exemplar_lab
        (exemplar rows, exemplar cols, channels >= 1): CIELAB, or other channels scaled like it.
    toroidal
        Whether the wall repeats, so that its last row and column meet its first.

    Returns
    -------
    SeamCost
        Over all pairs of 4-neighbours whose offsets into the exemplar differ.

    Raises
    ------
    ValueError
        If a shape is wrong or the map points outside the exemplar.

    Notes
    -----
    A pair of neighbours p, q, where p is cut from crop A and q from crop B, costs
    ``(|A(p) - B(p)| + |A(q) - B(q)|) / 2``: both crops are continued across the seam (Kwatra et al. 2003, "Graphcut
    textures", equation 1, halved to be a colour difference). Where one crop would leave the exemplar, the other side
    alone counts.

    Examples
    --------
    >>> grey = np.zeros((1, 6, 3))
    >>> grey[0, :, 0] = [0, 1, 2, 10, 20, 30]
    >>> seam_cost(np.array([[0, 1, 4, 5]], dtype=np.int32), grey).mean_delta_e
    13.5
    """
    if exemplar_lab.ndim != 3 or exemplar_lab.shape[2] < 1:
        raise ValueError(f"an exemplar is (rows, cols, channels), not {exemplar_lab.shape}")
    if source.ndim != 2:
        raise ValueError(f"a source map is (rows, cols), not {source.shape}")
    n_pixels = exemplar_lab.shape[0] * exemplar_lab.shape[1]
    if source.size and (int(source.min()) < 0 or int(source.max()) >= n_pixels):
        raise ValueError(f"the source map points outside an exemplar of {n_pixels} pixels")
    lab = np.ascontiguousarray(exemplar_lab, dtype=np.float64)
    on_map = np.ascontiguousarray(source, dtype=np.int32)
    costs = np.empty(_count_seams(on_map, lab.shape[1], toroidal), dtype=np.float64)
    measured = _fill_costs(on_map, lab, toroidal, costs)
    costs, unmeasured = costs[:measured], len(costs) - measured
    if measured == 0:
        return SeamCost(0.0, 0.0, 0.0, 0, 0.0, unmeasured)
    return SeamCost(
        mean_delta_e=float(costs.mean()),
        p95_delta_e=float(np.percentile(costs, 95)),
        worst_delta_e=float(costs.max()),
        length_px=measured,
        per_px_area=float(costs.sum() / source.size),
        unmeasured_px=unmeasured,
    )


@kernel
def _count_seams(source: NDArray[np.int32], exemplar_cols: int, toroidal: bool) -> int:
    """Pairs of 4-neighbours whose offsets differ."""
    rows, cols = source.shape
    count = 0
    for r in range(rows):
        for c in range(cols):
            p = source[r, c]
            if toroidal or c + 1 < cols:
                # The next index is no neighbour where a row of the exemplar ends.
                count += source[r, (c + 1) % cols] != p + 1 or (p + 1) % exemplar_cols == 0
            if toroidal or r + 1 < rows:
                count += source[(r + 1) % rows, c] != p + exemplar_cols
    return count


@kernel
def _difference(lab: NDArray[np.float64], r: int, c: int, other: int) -> float:
    """CIE76 between (r, c) and a flat index."""
    r2, c2 = other // lab.shape[1], other % lab.shape[1]
    total = 0.0
    for k in range(lab.shape[2]):
        d = lab[r, c, k] - lab[r2, c2, k]
        total += d * d
    return float(np.sqrt(total))


@kernel
def _fill_costs(source: NDArray[np.int32], lab: NDArray[np.float64], toroidal: bool, costs: NDArray[np.float64]) -> int:
    """Cost of each seam that can be measured, in reading order; returns how many."""
    rows, cols = source.shape
    exemplar_rows, exemplar_cols = lab.shape[0], lab.shape[1]
    count = 0
    for r in range(rows):
        for c in range(cols):
            for down in range(2):
                across = 1 - down
                if not toroidal and (r + down >= rows or c + across >= cols):
                    continue
                p, q = source[r, c], source[(r + down) % rows, (c + across) % cols]
                # A goes on at q, B at p.
                a_row, a_col = p // exemplar_cols + down, p % exemplar_cols + across
                b_row, b_col = q // exemplar_cols - down, q % exemplar_cols - across
                if b_row == p // exemplar_cols and b_col == p % exemplar_cols:
                    continue
                total, sides = 0.0, 0
                if a_row < exemplar_rows and a_col < exemplar_cols:
                    total += _difference(lab, a_row, a_col, q)
                    sides += 1
                if b_row >= 0 and b_col >= 0:
                    total += _difference(lab, b_row, b_col, p)
                    sides += 1
                if sides > 0:
                    costs[count] = total / sides
                    count += 1
    return count
