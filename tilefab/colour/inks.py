"""Which of a press's inks is its black."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

_WORDS = frozenset({"black", "schwarz", "nero", "negro", "noir"})
_SHORT_NAMES = frozenset({"k", "key"})
_MOST_CHROMA = 12.0
_LIGHTEST = 45.0


def black_channel(ink_names: Sequence[str], solids_lab: ArrayLike | None = None) -> int | None:
    """The channel of the black ink: by its name, else by its colour.

    Parameters
    ----------
    ink_names
        One for each channel. One that is, or has as a word, black, schwarz, nero, negro or noir names a black; so do k
        and key alone. Capitals don't matter; the first that is found counts.
    solids_lab
        (inks, 3) CIELAB of each ink in full, against the unprinted tile's white; None: names alone decide.

    Returns
    -------
    int or None
        The channel; else of those whose solids have a chroma of 12 at most and an L* of 45 at most, the darkest; None
        where there is none.

    Raises
    ------
    ValueError
        If there are not as many solids as names.

    Examples
    --------
    >>> black_channel(("Blue", "Process Black", "Brown"))
    1
    >>> black_channel(("Ink 1", "Ink 2"), [[20.0, 10.0, -40.0], [27.0, 1.0, 2.0]])
    1
    """
    names = [name.strip().casefold() for name in ink_names]
    for channel, name in enumerate(names):
        if name in _SHORT_NAMES or _WORDS & set(re.split(r"[\W\d_]+", name)):
            return channel
    if solids_lab is None:
        return None
    solids = np.asarray(solids_lab, dtype=np.float64)
    if solids.shape != (len(names), 3):
        raise ValueError(f"{len(names)} names need solids of shape ({len(names)}, 3), not {solids.shape}")
    neutral = (np.hypot(solids[:, 1], solids[:, 2]) <= _MOST_CHROMA) & (solids[:, 0] <= _LIGHTEST)
    if not neutral.any():
        return None
    return int(np.argmin(np.where(neutral, solids[:, 0], np.inf)))
