"""Shade lots (tono): which fired tiles may lie in one box.

Every face differs from every other, so it isn't colours that are sorted but what the kiln made of them: a tile's mean
fired less its *own face's* mean predicted L*, a*, b*. Tiles get their lot when they come, and keep it.

A lot is a ball of fixed middle: the difference of the tile that opened it. What lies within half the agreed match of
that middle may join, so any two tiles of a lot match as they were measured (nearly: CIEDE2000 keeps the triangle
inequality only for small differences). Balls of neighbouring lots overlap, and a tile that fits the lot of the tile
before stays in it: so noise near a border doesn't make lots take turns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import delta_e_2000
from tilefab.inspection.records import Lab

Float64Array = NDArray[np.float64]

_LETTERS = 26


@dataclass(frozen=True)
class ShadeSettings:
    """How lots are made.

    Attributes
    ----------
    match_delta_e
        CIEDE2000 that two tiles of one lot may differ by, above 0.
    reference_lab
        A colour typical of the job, about which differences are judged: the eye stands more of them in strong colours.
    """

    match_delta_e: float = 1.0
    reference_lab: Lab = (60.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.match_delta_e) and self.match_delta_e > 0.0):
            raise ValueError(f"match of {self.match_delta_e} must be above 0")
        if not all(math.isfinite(value) for value in self.reference_lab):
            raise ValueError(f"reference colour {self.reference_lab} must be finite")


@dataclass(frozen=True)
class ShadeLot:
    """One lot so far.

    Attributes
    ----------
    name
        A, B, ... Z, AA, AB ...
    middle_lab
        Difference that the lot is about; never moves.
    tiles
        How many it has.
    mean_lab
        Mean difference of its tiles.
    spread_delta_e
        Largest CIEDE2000 of a tile in it from its middle.
    """

    name: str
    middle_lab: Lab
    tiles: int
    mean_lab: Lab
    spread_delta_e: float


@dataclass(frozen=True)
class ShadeState:
    """All lots so far, in the order of opening, and which of them the last tile went to (-1: none yet)."""

    lots: tuple[ShadeLot, ...] = ()
    last: int = -1

    def plain(self) -> dict[str, Any]:
        """As plain JSON values."""
        lots = [
            {
                "name": lot.name,
                "middle_lab": list(lot.middle_lab),
                "tiles": lot.tiles,
                "mean_lab": list(lot.mean_lab),
                "spread_delta_e": lot.spread_delta_e,
            }
            for lot in self.lots
        ]
        return {"lots": lots, "last": self.last}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> ShadeState:
        """Undo `plain`."""
        lots = tuple(
            ShadeLot(
                str(lot["name"]),
                _lab(lot["middle_lab"]),
                int(lot["tiles"]),
                _lab(lot["mean_lab"]),
                float(lot["spread_delta_e"]),
            )
            for lot in plain["lots"]
        )
        return cls(lots, int(plain["last"]))


def assign_lot(state: ShadeState, difference_lab: Lab, settings: ShadeSettings) -> tuple[ShadeState, str]:
    """Give the next tile its lot.

    Parameters
    ----------
    state
        What earlier tiles left; begin with ``ShadeState()``.
    difference_lab
        The tile's mean fired less its own face's mean predicted L*, a*, b*.
    settings
        The same for all tiles of a job.

    Returns
    -------
    tuple
        The new state, and the lot's name.

    Raises
    ------
    ValueError
        If the difference is not finite.
    """
    if not all(math.isfinite(value) for value in difference_lab):
        raise ValueError(f"difference {difference_lab} must be finite: a tile that wasn't measured has no lot")
    reach = settings.match_delta_e / 2.0
    place, away = _fitting(state, difference_lab, settings, reach)
    if place < 0:
        lot = ShadeLot(lot_name(len(state.lots)), difference_lab, 1, difference_lab, 0.0)
        return ShadeState((*state.lots, lot), len(state.lots)), lot.name
    old = state.lots[place]
    share = 1.0 / (old.tiles + 1)
    l_star, a_star, b_star = (
        mean + share * (value - mean) for mean, value in zip(old.mean_lab, difference_lab, strict=True)
    )
    lot = replace(
        old,
        tiles=old.tiles + 1,
        mean_lab=(l_star, a_star, b_star),
        spread_delta_e=max(old.spread_delta_e, away),
    )
    return ShadeState((*state.lots[:place], lot, *state.lots[place + 1 :]), place), lot.name


def _fitting(state: ShadeState, difference: Lab, settings: ShadeSettings, reach: float) -> tuple[int, float]:
    """Lot for a tile and its CIEDE2000 from there: the last tile's if that fits, else the nearest; -1 if none fits."""
    if not state.lots:
        return -1, math.inf
    reference = np.array(settings.reference_lab)
    middles = reference + np.array([lot.middle_lab for lot in state.lots])
    away = np.asarray(delta_e_2000(middles, reference + np.array(difference)), dtype=np.float64)
    place = state.last if 0 <= state.last < len(state.lots) and away[state.last] <= reach else int(away.argmin())
    return (place, float(away[place])) if away[place] <= reach else (-1, math.inf)


def lot_name(number: int) -> str:
    """Name of the ``number``-th lot, from 0.

    >>> [lot_name(number) for number in (0, 25, 26, 27, 701, 702)]
    ['A', 'Z', 'AA', 'AB', 'ZZ', 'AAA']
    """
    if number < 0:
        raise ValueError(f"lot {number} has no name; lots are counted from 0")
    name, rest = "", number + 1
    while rest:
        rest, letter = divmod(rest - 1, _LETTERS)
        name = chr(ord("A") + letter) + name
    return name


def _lab(values: Any) -> Lab:
    l_star, a_star, b_star = (float(value) for value in values)
    return l_star, a_star, b_star
