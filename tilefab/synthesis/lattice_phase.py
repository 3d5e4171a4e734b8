"""Keeping a result in step with its lattice from scale to scale.

At a coarse scale a piece can only lie at whole coarse pixels, which is whole fine pixels off; finer scales see nothing
wrong within a piece and leave it there. So at each finer scale pieces that are nearly in step are put in step again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.synthesis.lattice import Lattice
from tilefab.synthesis.layout import closing_lattice
from tilefab.types import Mask, SizePx

_REACH_PX = 2.5
_REACH_CELLS = 0.25
_PHASE_DIGITS = 3


def in_step(
    source: NDArray[np.int32], valid: Mask, lattice: Lattice, size: SizePx, *, toroidal: bool
) -> NDArray[np.int32]:
    """A map whose pieces all show the lattice in one phase, where they nearly did.

    Parameters
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    valid
        (exemplar rows, exemplar cols), True where it may be shown.
    lattice
        The exemplar's, at this scale.
    size
        After which the result repeats.
    toroidal
        Whether it does: the lattice is then stretched so that it closes, as in `layout.initial_field`.

    Returns
    -------
    ndarray
        (rows, cols) int32. Pixels that would leave the exemplar or show a hole stay as they are.
    """
    matrix = lattice.matrix
    stretch = np.eye(2)
    if toroidal:
        stretch = matrix @ np.linalg.inv(closing_lattice(matrix, size))
    rows, cols = np.indices(source.shape)
    place_rows, place_cols = np.divmod(source.astype(np.int64), valid.shape[1])
    # Where each pixel lies in the exemplar, seen from where the lattice alone would have put it; in cells.
    expected = stretch @ np.stack([rows.ravel(), cols.ravel()]).astype(np.float64)
    places = np.stack([place_rows.ravel(), place_cols.ravel()])
    cells = np.linalg.solve(matrix, places - expected)
    turns = np.exp(2j * np.pi * cells).mean(axis=1)
    phase = np.round(np.angle(turns) / (2 * np.pi), _PHASE_DIGITS)[:, np.newaxis]
    wanted = expected + matrix @ (np.rint(cells - phase) + phase)
    moved = np.rint(np.round(wanted, 6)).astype(np.int64)
    # What rounding may have come to over some scales. What is farther off is meant to be.
    reach = min(_REACH_PX, _REACH_CELLS * float(np.hypot(*matrix).min()))
    near = np.hypot(*(wanted - places)) <= reach
    inside = ((moved >= 0) & (moved < np.array(valid.shape)[:, np.newaxis])).all(axis=0)
    moved = np.where(near & inside, moved, places)
    moved = np.where(valid[moved[0], moved[1]], moved, places)
    return np.asarray((moved[0] * valid.shape[1] + moved[1]).reshape(source.shape), dtype=np.int32)
