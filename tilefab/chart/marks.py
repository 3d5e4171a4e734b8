"""The marks in a chart tile's corners: squares of 7 x 7 modules that say which corner, tile and chart they are.

A dark ring, one module wide, is what a search finds: it has a clean outer edge on all four sides. Within it are
5 x 5 modules. Three of their corners are dark and the fourth is light, which tells how far the tile is turned; the
other 21 carry the corner (2 bits), the tile (7), the chart (4) and a check of 8 bits. They are flipped in a chequered
pattern, so that no mark is nearly all light or all dark.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MODULES = 7
MOST_TILES = 128
CHARTS = 16

_INNER = MODULES - 2
_CORNER_CELLS = ((0, 0), (0, _INNER - 1), (_INNER - 1, 0), (_INNER - 1, _INNER - 1))
_TURNING = (True, True, True, False)
_DATA_CELLS = tuple((row, col) for row in range(_INNER) for col in range(_INNER) if (row, col) not in _CORNER_CELLS)
_CHEQUERED = np.array([(row + col) % 2 == 0 for row, col in _DATA_CELLS])
_DATA_BITS, _CHECK_BITS = 13, 8
_POLYNOMIAL = 0x2F  # finds any three wrong bits in words as short as these


class Mark(NamedTuple):
    """What a mark says: its corner (0 top left, then clockwise), its tile and its chart, all counted from 0."""

    corner: int
    tile: int
    chart: int


def _check(value: int) -> int:
    remainder = value << _CHECK_BITS
    for place in range(_DATA_BITS - 1, -1, -1):
        if remainder >> (place + _CHECK_BITS) & 1:
            remainder ^= (0x100 | _POLYNOMIAL) << place
    return remainder ^ 0xFF


def draw_mark(mark: Mark) -> NDArray[np.bool_]:
    """Modules of a mark, (7, 7), True = dark.

    Raises
    ------
    ValueError
        If a number is out of range.
    """
    if not (0 <= mark.corner < 4 and 0 <= mark.tile < MOST_TILES and 0 <= mark.chart < CHARTS):
        raise ValueError(f"{mark} can't be drawn")
    value = mark.corner << 11 | mark.tile << 4 | mark.chart
    word = value << _CHECK_BITS | _check(value)
    bits = np.array([word >> place & 1 for place in range(_DATA_BITS + _CHECK_BITS - 1, -1, -1)], dtype=bool)
    modules = np.ones((MODULES, MODULES), dtype=bool)
    inner = modules[1:-1, 1:-1]
    for cell, dark in zip(_CORNER_CELLS, _TURNING, strict=True):
        inner[cell] = dark
    for cell, dark in zip(_DATA_CELLS, bits ^ _CHEQUERED, strict=True):
        inner[cell] = dark
    return modules


def read_mark(modules: NDArray[np.bool_]) -> tuple[Mark, int] | None:
    """What a mark's modules say, and how many quarter turns counter-clockwise make them upright; None if it is none.

    Parameters
    ----------
    modules
        (7, 7), True = dark, turned by any number of quarters.
    """
    ring = np.ones((MODULES, MODULES), dtype=bool)
    ring[1:-1, 1:-1] = False
    if not modules[ring].all():
        return None
    for turns in range(4):
        inner = np.rot90(modules, turns)[1:-1, 1:-1]
        if tuple(bool(inner[cell]) for cell in _CORNER_CELLS) != _TURNING:
            continue
        word = 0
        for bit in np.array([inner[cell] for cell in _DATA_CELLS]) ^ _CHEQUERED:
            word = word << 1 | int(bit)
        value = word >> _CHECK_BITS
        if _check(value) != word & 0xFF:
            return None
        return Mark(value >> 11, value >> 4 & 0x7F, value & 0xF), turns
    return None
