"""What patches that were printed twice say about each other."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.spaces import delta_e_2000

_APART = 4.0
_LEAST_DELTA_E = 1.0


@dataclass(frozen=True, eq=False)
class RepeatCheck:
    """How well repeated patches agree; colour differences are CIEDE2000 from the median of their like.

    Attributes
    ----------
    groups
        How many recipes are there more than once.
    noise_delta_e
        Typical difference, the median over all repeated patches, scaled so that a group of two counts as one of many;
        None where nothing is repeated.
    delta_e
        (P,) each patch's difference; NaN where it isn't repeated.
    disagree
        (P,) True where a patch's difference stands far above the noise.
    """

    groups: int
    noise_delta_e: float | None
    delta_e: NDArray[np.float64] = field(repr=False)
    disagree: NDArray[np.bool_] = field(repr=False)


def check_repeats(ink: NDArray[np.floating] | NDArray[np.uint8], lab_d50: NDArray[np.float64]) -> RepeatCheck:
    """Compare patches of one recipe with each other.

    Parameters
    ----------
    ink
        (P, N) recipes, in any unit; equal rows are repeats.
    lab_d50
        (P, 3) their colours.
    """
    groups, counts = np.unique(ink, axis=0, return_inverse=True, return_counts=True)[1:]
    groups = groups.reshape(-1)
    delta_e = np.full(len(ink), np.nan)
    scaled: list[float] = []
    for group in np.flatnonzero(counts > 1):
        members = np.flatnonzero(groups == group)
        delta_e[members] = delta_e_2000(lab_d50[members], np.median(lab_d50[members], axis=0))
        scaled += list(delta_e[members] / np.sqrt(1.0 - 1.0 / len(members)))
    if not scaled:
        return RepeatCheck(0, None, delta_e, np.zeros(len(ink), dtype=bool))
    noise = float(np.median(scaled))
    bad = np.nan_to_num(delta_e) > max(_LEAST_DELTA_E, _APART * noise)
    return RepeatCheck(int((counts > 1).sum()), noise, delta_e, bad)
