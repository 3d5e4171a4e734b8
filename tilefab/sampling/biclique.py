"""Dividing candidates into sets A and B that never overlap in neighbouring cells (first seed, Algorithm 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import Mask


@kernel
def overlap_matrix(
    top: NDArray[np.int64],
    left: NDArray[np.int64],
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    run_offset: NDArray[np.int64],
    runs: NDArray[np.int32],
    row_shift: int,
    col_shift: int,
) -> Mask:
    """Which patches overlap which when the second is moved by (row_shift, col_shift) pixels.

    Parameters
    ----------
    top, left, rows, cols
        (patches,) bounding boxes.
    run_offset, runs
        Masks as row runs, in reading order; see `tilefab.sampling.texture_map.Patches`.

    Returns
    -------
    ndarray of bool
        (patches, patches); element (i, j) is True if patch i and the moved patch j share a pixel.
    """
    n = len(top)
    result = np.zeros((n, n), dtype=np.bool_)
    for i in range(n):
        for j in range(n):
            dr = top[j] + row_shift - top[i]
            dc = left[j] + col_shift - left[i]
            if dr >= rows[i] or dc >= cols[i] or dr + rows[j] <= 0 or dc + cols[j] <= 0:
                continue
            a, b = run_offset[i], run_offset[j]
            while a < run_offset[i + 1] and b < run_offset[j + 1]:
                row_a, row_b = runs[a, 0], runs[b, 0] + dr
                begin_a, begin_b = runs[a, 1], runs[b, 1] + dc
                end_a, end_b = begin_a + runs[a, 2], begin_b + runs[b, 2]
                if row_a == row_b and begin_a < end_b and begin_b < end_a:
                    result[i, j] = True
                    break
                if row_a < row_b or (row_a == row_b and end_a <= end_b):
                    a += 1
                else:
                    b += 1
    return result


def pseudo_biclique(
    compatible: Mask, limit: int, random: np.random.Generator, tries: int = 16
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Divide candidates into two sets no member of which is incompatible with a member of the other.

    Parameters
    ----------
    compatible
        (n, n) symmetric: True where one may be in A and the other in B.
    limit
        Stop at this many members in all.
    random
        Where the choices come from.
    tries
        How many divisions to make; the one with the most members, most evenly divided, is taken.

    Returns
    -------
    tuple of ndarray
        Ascending numbers of the members of A and of B; both empty if no two candidates are compatible.

    Notes
    -----
    First seed, Algorithm 1. It also ends when neither set can grow, where the paper's would run for ever.
    """
    starts = np.argwhere(np.triu(compatible, 1))
    best: tuple[list[int], list[int]] = ([], [])
    if len(starts) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    for _ in range(tries):
        first = starts[int(random.integers(len(starts)))]
        sets: tuple[list[int], list[int]] = ([int(first[0])], [int(first[1])])
        free = np.ones(len(compatible), dtype=bool)
        free[first] = False
        fits = (compatible[sets[1][0]].copy(), compatible[sets[0][0]].copy())
        grew = True
        while grew and len(sets[0]) + len(sets[1]) < limit:
            grew = False
            for side in (0, 1):
                choices = np.flatnonzero(free & fits[side])
                if len(choices) == 0 or len(sets[0]) + len(sets[1]) >= limit:
                    continue
                chosen = int(choices[int(random.integers(len(choices)))])
                sets[side].append(chosen)
                free[chosen] = False
                fits[1 - side][:] &= compatible[chosen]
                grew = True
        if _division_quality(sets) > _division_quality(best):
            best = sets
    return np.array(sorted(best[0]), dtype=np.int64), np.array(sorted(best[1]), dtype=np.int64)


def _division_quality(sets: tuple[list[int], list[int]]) -> tuple[int, int]:
    return len(sets[0]) + len(sets[1]), min(len(sets[0]), len(sets[1]))
