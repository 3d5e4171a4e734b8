"""Recipes scattered evenly between those that a chart has already.

Best-candidate sampling (D. Mitchell, "Spectrally optimal sampling for distribution ray tracing", SIGGRAPH 1991,
section 4): of several random recipes, the one farthest from all that are there is taken. Unlike a plain search for the
emptiest place, it follows the density of its candidates and doesn't pile up in corners, which eight inks have many of.

Distances are measured where equal steps are about equally visible: amounts under a power below 1, for the same step is
plainer in highlights; and drawn together by the ink that is there already, black above all, for it hides what is under
it.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

_FULL = 255.0
_POWER = 0.65
_HIDING, _BLACK_HIDING = 0.15, 0.8
_CANDIDATES = 24
_AT_ONCE = 4
"""Inks at once, in most recipes of a set of more than this."""

_MANY_SHARE = 0.15
_LIKELY = {1: 0.06, 2: 0.24, 3: 0.38, 4: 0.32}
_NEAR_COUNTS = 3
_PATIENCE = 40


def _visible(frac: NDArray[np.float64], black: int | None) -> NDArray[np.float32]:
    """Place of recipes, (..., N) of 0 to 1, in the space where distances are measured."""
    bent = frac**_POWER
    hiding = np.full(frac.shape[-1], _HIDING)
    if black is not None:
        hiding[black] = _BLACK_HIDING
    return np.asarray(bent / (1.0 + (bent @ hiding)[..., np.newaxis]), dtype=np.float32)


def _groups(inks: int, wanted: int, random: np.random.Generator) -> list[tuple[int, ...]]:
    """Which inks each recipe uses: every group of a size about equally often."""
    if inks <= _AT_ONCE:
        return [tuple(range(inks))] * wanted
    sizes = {size: share * (1.0 - _MANY_SHARE) for size, share in _LIKELY.items()}
    for size in range(_AT_ONCE + 1, inks + 1):
        sizes[size] = _MANY_SHARE / (inks - _AT_ONCE)
    counts = {size: round(share * wanted) for size, share in sizes.items()}
    counts[3] += wanted - sum(counts.values())
    out: list[tuple[int, ...]] = []
    for size, count in counts.items():
        groups = list(itertools.combinations(range(inks), size))
        order = np.concatenate([random.permutation(len(groups)) for _ in range(count // len(groups) + 1)])
        out += [groups[place] for place in order[: max(0, count)]]
    return [out[place] for place in random.permutation(len(out))]


def spread_recipes(
    have: NDArray[np.int64],
    wanted: int,
    full: NDArray[np.int64],
    limit: int,
    black: int | None,
    random: np.random.Generator,
) -> NDArray[np.int64]:
    """Recipes far from those that are there and from each other.

    Parameters
    ----------
    have
        (P, N) counts of 255ths.
    wanted
        How many more.
    full
        (N,) most of each ink, in counts.
    limit
        Most ink in all, in counts.
    black
        Channel of black; None where no ink is.
    random
        Where chance comes from.

    Returns
    -------
    numpy.ndarray
        (wanted or fewer, N) int64; fewer where no more fit without being nearly alike.
    """
    inks = len(full)
    counts = np.empty((len(have) + wanted, inks), dtype=np.int64)
    places = np.empty((len(counts), inks), dtype=np.float32)
    counts[: len(have)], places[: len(have)] = have, _visible(have / _FULL, black)
    size, failed = len(have), 0
    groups = itertools.cycle(_groups(inks, wanted, random)) if wanted else iter(())
    while size < len(counts) and failed < _PATIENCE:
        group = next(groups)
        found = _candidates(group, full, limit, random)
        where = _visible(found / _FULL, black)
        squared = ((where[:, np.newaxis] - places[np.newaxis, :size]) ** 2).sum(axis=2)
        best = int(np.argmax(squared.min(axis=1)))
        if (np.abs(counts[:size] - found[best]).max(axis=1) < _NEAR_COUNTS).any():
            failed += 1
            continue
        failed = 0
        counts[size], places[size] = found[best], where[best]
        size += 1
    return counts[len(have) : size]


def _candidates(
    group: tuple[int, ...], full: NDArray[np.int64], limit: int, random: np.random.Generator
) -> NDArray[np.int64]:
    """Random recipes of a group of inks within the limits; those drawn beyond the total come back under it."""
    frac = np.zeros((_CANDIDATES, len(full)))
    frac[:, group] = random.random((_CANDIDATES, len(group))) ** (1.0 / _POWER)
    counts = frac * full
    total = counts.sum(axis=1)
    aim = limit * (0.7 + 0.3 * random.random(_CANDIDATES))
    counts *= np.where(total > limit, aim / np.maximum(total, 1.0), 1.0)[:, np.newaxis]
    return np.floor(counts).astype(np.int64)
