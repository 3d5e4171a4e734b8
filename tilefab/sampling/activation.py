"""Which patches are active in a cell of the plane: integer hashing, then Algorithm 2 of the first seed.

The plane is a lattice of cells the size of the repeatable tile. Cells whose row and column numbers add up to an even
number take patches of set A, the others of set B. A patch of A may reach beyond its cell but stays within the rhombus
whose corners are the centres of the four neighbouring cells; those rhombi don't overlap, so neither do patches of two
A cells; and the sets are chosen so that no patch of A overlaps one of B. What remains are overlaps within a cell,
which Algorithm 2 resolves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.rng import philox_4x32
from tilefab.types import Mask

_LOW_32 = np.uint64(0xFFFFFFFF)
_32 = np.uint64(32)


@kernel
def active_patches(
    key: np.uint64,
    cell_row: int,
    cell_col: int,
    count_a: int,
    overlaps: Mask,
    threshold: np.uint64,
    active: NDArray[np.int64],
    clashes: NDArray[np.int64],
) -> int:
    """Find the patches shown by one cell.

    Parameters
    ----------
    key
        Stream key of the job seed for the purpose "activation".
    cell_row, cell_col
        Number of the cell; any 64-bit integers.
    count_a, overlaps, threshold
        From the texture map.
    active, clashes
        Work space of (patches,) each; the result stands in the first elements of ``active``.

    Returns
    -------
    int
        How many patches are shown; their numbers are in ascending order.

    Notes
    -----
    First seed, 5.5.2. Its Eq. 5.1 is replaced by Philox, keyed per cell and counted by patch. Algorithm 2 removes,
    while any two active patches overlap, the first of those that overlap the most others.
    """
    first, last = 0, count_a
    if (cell_row + cell_col) & 1:
        first, last = count_a, len(overlaps)
    cell_key, _ = philox_4x32(key, np.uint64(cell_row), np.uint64(cell_col))
    n = 0
    for block in range((last - first + 3) // 4):
        low, high = philox_4x32(cell_key, np.uint64(block), np.uint64(0))
        for lane in range(4):
            patch = first + 4 * block + lane
            if patch >= last:
                break
            pair = low if lane < 2 else high
            word = (pair >> _32) if lane & 1 else (pair & _LOW_32)
            if word < threshold:
                active[n] = patch
                n += 1
    for i in range(n):
        clashes[i] = 0
        for j in range(n):
            if overlaps[active[i], active[j]] and i != j:
                clashes[i] += 1
    while True:
        worst = 0
        for i in range(1, n):
            if clashes[i] > clashes[worst]:
                worst = i
        if n == 0 or clashes[worst] == 0:
            return n
        removed = active[worst]
        n -= 1
        for i in range(worst, n):
            active[i] = active[i + 1]
            clashes[i] = clashes[i + 1]
        for i in range(n):
            if overlaps[active[i], removed]:
                clashes[i] -= 1


def active_patches_reference(
    key: int, cell_row: int, cell_col: int, count_a: int, overlaps: Mask, threshold: int
) -> list[int]:
    """Twin of `active_patches` in plain Python, to be read beside the first seed's 5.5.2."""
    wrap = (1 << 64) - 1
    odd = (cell_row + cell_col) % 2 == 1
    group = range(count_a, len(overlaps)) if odd else range(count_a)
    cell_key, _ = _philox_reference(key, cell_row & wrap, cell_col & wrap)
    active = []
    for number, patch in enumerate(group):
        words = _philox_reference(cell_key, number // 4, 0)
        word = (words[number % 4 // 2] >> (32 * (number % 2))) & 0xFFFFFFFF
        if word < threshold:
            active.append(patch)
    while True:
        matrix = overlaps[np.ix_(active, active)] & ~np.eye(len(active), dtype=bool)
        if not matrix.any():
            return active
        del active[int(matrix.sum(axis=1).argmax())]


def _philox_reference(key: int, counter_0: int, counter_1: int) -> tuple[int, int]:
    c = [counter_0 & 0xFFFFFFFF, counter_0 >> 32, counter_1 & 0xFFFFFFFF, counter_1 >> 32]
    k = [key & 0xFFFFFFFF, key >> 32]
    for _ in range(10):
        high_0, low_0 = divmod(0xD2511F53 * c[0], 1 << 32)
        high_1, low_1 = divmod(0xCD9E8D57 * c[2], 1 << 32)
        c = [high_1 ^ c[1] ^ k[0], low_1, high_0 ^ c[3] ^ k[1], low_0]
        k = [(k[0] + 0x9E3779B9) % (1 << 32), (k[1] + 0xBB67AE85) % (1 << 32)]
    return c[0] | c[1] << 32, c[2] | c[3] << 32
