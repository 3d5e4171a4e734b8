"""Which recipes a characterisation chart holds.

Nothing is known of the press yet, so the design leans on what is true of every press: tone curves bend most in
highlights and shadows; the eye is most critical where there is little ink; full overprints bound the gamut; a dark
mixture changes little with more ink; separations of many inks use few of them at once. What is left is filled evenly.

Amounts are whole 255ths, so that 8 and 16 bit files print the very same recipes.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.chart.spread import spread_recipes
from tilefab.rng import generator

FULL = 255
"""Counts of a full ink."""

MOST_INKS = 8
NEAR_COUNTS = 3
"""Recipes that differ by fewer counts in every ink are nearly alike: one of them is enough."""

KINDS = ("white", "corner", "ramp", "mixture", "neutral", "dark", "spread", "repeat")
"""Why a recipe is in the chart."""

_SHARES = {"corner": 0.15, "ramp": 0.14, "mixture": 0.16, "neutral": 0.07, "dark": 0.06}
_REPEAT_SHARE = 0.04
_BLACK_STEPS = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True, eq=False)
class ChartDesign:
    """Recipes of a chart, in the order in which they were thought of.

    Attributes
    ----------
    ink_counts
        (P, N) uint8, 255 = full ink.
    kinds
        P of `KINDS`: why each is there.
    repeat_of
        (P,) int64: the recipe that this one repeats, -1 for none. Whites after the first repeat the first.
    total_limit_percent
        No recipe has more ink than this in all.
    black_channel
        The channel of black; None where no ink is black.
    """

    ink_counts: NDArray[np.uint8] = field(repr=False)
    kinds: tuple[str, ...] = field(repr=False)
    repeat_of: NDArray[np.int64] = field(repr=False)
    total_limit_percent: float
    black_channel: int | None

    @property
    def ink_percent(self) -> NDArray[np.float64]:
        """(P, N) ink percentages, 0 to 100."""
        return self.ink_counts.astype(np.float64) * (100.0 / FULL)


class _Recipes:
    """Recipes collected so far: none twice, none nearly alike, all within the limits."""

    def __init__(self, room: int, full: NDArray[np.int64], limit: int) -> None:
        self.counts = np.zeros((room, len(full)), dtype=np.int64)
        self.kinds: list[str] = []
        self.full, self.limit = full, limit

    def __len__(self) -> int:
        return len(self.kinds)

    def within(self, frac: Sequence[float] | NDArray[np.float64]) -> NDArray[np.int64]:
        """A recipe of fractions of each ink's limit, drawn back to the total limit where it is beyond."""
        counts = np.asarray(frac, dtype=np.float64) * self.full
        total = counts.sum()
        if total > self.limit:
            counts *= self.limit / total
        whole = np.floor(counts + 0.5).astype(np.int64)
        while whole.sum() > self.limit:
            whole[int(np.argmax(whole - counts))] -= 1
        return whole

    def add(self, counts: NDArray[np.int64], kind: str) -> bool:
        """Take a recipe, unless it is nearly there or there is no room; tell whether it was taken."""
        have = self.counts[: len(self)]
        if len(self) == len(self.counts) or (np.abs(have - counts).max(axis=1, initial=0) < NEAR_COUNTS).any():
            return False
        self.counts[len(self)] = counts
        self.kinds.append(kind)
        return True

    def add_some(self, recipes: Iterable[Sequence[float]], kind: str, most: int) -> int:
        """Take recipes of fractions in order, ``most`` at most; how many were."""
        taken = 0
        for recipe in recipes:
            if taken >= most:
                break
            taken += self.add(self.within(recipe), kind)
        return taken


def design_chart(
    inks: int,
    patches: int,
    *,
    total_limit_percent: float,
    ink_limits_percent: tuple[float, ...] | None = None,
    black_channel: int | None = None,
    seed: int = 0,
    repeats: int | None = None,
    whites: int | None = None,
) -> ChartDesign:
    """Recipes of a characterisation chart; the same arguments give the same recipes.

    Parameters
    ----------
    inks
        1 to 8.
    patches
        How many in all, 20 or more.
    total_limit_percent
        Most ink in all, 100 to 100 x inks (25 or more for a single ink).
    ink_limits_percent
        Most of each ink, 5 to 100; None allows 100 of each.
    black_channel
        The channel of black, if any: neutrals are then laid out at several amounts of it.
    seed
        Of the scattered recipes.
    repeats
        How many recipes besides whites are printed again to estimate noise; None: 4 % of the patches.
    whites
        How many patches are bare; None: 3 to 16, more in larger charts.

    Returns
    -------
    ChartDesign
        Where so many patches have no distinct recipes (a single ink has some 85), the rest are repeats.

    Raises
    ------
    ValueError
        If an argument is out of range.
    """
    limits = (100.0,) * inks if ink_limits_percent is None else ink_limits_percent
    if not 1 <= inks <= MOST_INKS:
        raise ValueError(f"{inks} inks are not 1 to {MOST_INKS}")
    if patches < 20:
        raise ValueError(f"{patches} patches are too few: 20 are the least")
    if len(limits) != inks or not all(5.0 <= limit <= 100.0 for limit in limits):
        raise ValueError("ink limits must be one number of 5 to 100 for each ink")
    if not min(100.0, 25.0 * inks) <= total_limit_percent <= 100.0 * inks:
        raise ValueError(f"a total limit of {total_limit_percent:g} % is not {min(100, 25 * inks)} to {100 * inks} %")
    if black_channel is not None and not 0 <= black_channel < inks:
        raise ValueError(f"black channel {black_channel} is not 0 to {inks - 1}")
    white_count = max(3, min(16, round(patches**0.5 / 3))) if whites is None else whites
    repeat_count = max(2, round(_REPEAT_SHARE * patches)) if repeats is None else repeats
    room = patches - max(0, white_count - 1) - repeat_count
    if white_count < 1 or repeat_count < 0 or room < 10:
        raise ValueError(f"{white_count} whites and {repeat_count} repeats leave no room in {patches} patches")

    full = np.floor(np.array(limits) * FULL / 100.0 + 1e-9).astype(np.int64)
    recipes = _Recipes(room, full, int(total_limit_percent * FULL / 100.0 + 1e-9))
    recipes.add(np.zeros(inks, dtype=np.int64), "white")
    budget = {kind: max(inks, round(share * room)) for kind, share in _SHARES.items()}
    random = generator(seed, "chart design")
    recipes.add_some(_corners(inks), "corner", max(budget["corner"], 16 if inks <= 4 else 2 * inks))
    recipes.add_some(_ramps(inks, budget["ramp"]), "ramp", max(budget["ramp"], 3 * inks))
    recipes.add_some(_neutrals(inks, black_channel, budget["neutral"]), "neutral", budget["neutral"])
    recipes.add_some(_darks(recipes, black_channel, budget["dark"]), "dark", budget["dark"])
    recipes.add_some(_mixtures(inks, random), "mixture", budget["mixture"])
    missing = room - len(recipes)
    if missing:
        for counts in spread_recipes(
            recipes.counts[: len(recipes)], missing, full, recipes.limit, black_channel, random
        ):
            recipes.add(counts, "spread")
    return _with_repeats(recipes, patches, white_count, total_limit_percent, black_channel, random)


def _with_repeats(
    recipes: _Recipes,
    patches: int,
    white_count: int,
    total_limit_percent: float,
    black_channel: int | None,
    random: np.random.Generator,
) -> ChartDesign:
    distinct = len(recipes)
    counts = recipes.counts[:distinct]
    originals = [0] * (white_count - 1)
    # Noise differs with the amount of ink: what is repeated is spread from light to dark.
    by_total = np.argsort(counts[1:].sum(axis=1), kind="stable") + 1
    while len(originals) < patches - distinct:
        wanted = min(patches - distinct - len(originals), len(by_total))
        edges = np.linspace(0, len(by_total), wanted + 1).astype(np.int64)
        originals += [int(by_total[random.integers(low, high)]) for low, high in itertools.pairwise(edges)]
    kinds = [*recipes.kinds, *("white" if original == 0 else "repeat" for original in originals)]
    return ChartDesign(
        ink_counts=np.concatenate([counts, counts[originals]]).astype(np.uint8),
        kinds=tuple(kinds),
        repeat_of=np.array([-1] * distinct + originals, dtype=np.int64),
        total_limit_percent=total_limit_percent,
        black_channel=black_channel,
    )


def _corners(inks: int) -> Iterable[tuple[float, ...]]:
    """Full inks: alone, in pairs, in threes, in fours, and all; what is beyond the limit comes back to it."""
    for count in {*range(1, min(inks, 4) + 1), inks}:
        for group in itertools.combinations(range(inks), count):
            yield tuple(float(ink in group) for ink in range(inks))


def _tones(steps: int) -> NDArray[np.float64]:
    """Amounts strictly between 0 and 1, close together at both ends and closest in the highlights."""
    along = np.arange(1, steps + 1) / (steps + 1.0)
    return np.asarray((1.0 - np.cos(np.pi * along**1.15)) / 2.0, dtype=np.float64)


def _ramps(inks: int, budget: int) -> Iterable[tuple[float, ...]]:
    for tone in _tones(int(np.clip(round(budget / inks), 3, 40))):
        for ink in range(inks):
            yield tuple(float(tone) if other == ink else 0.0 for other in range(inks))


def _neutrals(inks: int, black: int | None, budget: int) -> Iterable[tuple[float, ...]]:
    """Equal amounts of the coloured inks, without and with black, and the same a little to each side."""
    coloured = [ink for ink in range(inks) if ink != black]
    if len(coloured) < 2:
        return
    amounts = _BLACK_STEPS if black is not None else (0.0,)
    sides = len(coloured) if len(coloured) <= 4 else 0
    steps = max(2, round(budget / (len(amounts) * (1 + sides / 2))))
    for tone in _tones(steps):
        for amount in amounts:
            recipe = np.full(inks, float(tone))
            if black is not None:
                recipe[black] = amount
            yield tuple(recipe)
    for tone in _tones(steps)[:: 2 if sides else 1]:
        for ink in coloured[:sides]:
            for amount in amounts:
                recipe = np.full(inks, float(tone))
                recipe[ink] *= 0.75
                if black is not None:
                    recipe[black] = amount
                yield tuple(recipe)


def _darks(recipes: _Recipes, black: int | None, budget: int) -> Iterable[tuple[float, ...]]:
    """As much ink as is allowed, with more and more black; without black, with each ink in turn left out in part."""
    inks = len(recipes.full)
    if inks < 2:
        return
    limit = recipes.limit / FULL
    if black is None:
        for tone in (1.0, *_tones(max(2, budget // inks))[::-1]):
            for ink in range(inks):
                yield tuple(float(tone) if other == ink else 1.0 for other in range(inks))
        return
    steps = max(2, budget // 4)
    for share in (1.0, 0.85, 0.7, 0.55):
        for amount in np.linspace(1.0, 0.0, steps):
            rest = min(1.0, max(0.0, (share * limit - amount) / (inks - 1)))
            yield tuple(float(amount) if ink == black else float(rest) for ink in range(inks))


def _mixtures(inks: int, random: np.random.Generator) -> Iterable[tuple[float, ...]]:
    """Two and three inks at a time, medium and light amounts, group after group so that none is forgotten."""
    pairs = list(itertools.combinations(range(inks), 2))
    threes = list(itertools.combinations(range(inks), 3))
    shapes: list[tuple[float, ...]] = [
        (0.5, 0.5), (0.2, 0.2, 0.2), (0.25, 0.25), (0.5, 0.5, 0.5), (1.0, 0.4), (0.4, 1.0), (0.12, 0.12, 0.12),
        (0.75, 0.75), (0.6, 0.15), (0.15, 0.6), (0.1, 0.1), (0.75, 0.75, 0.75), (0.7, 0.35, 0.35), (0.35, 0.7, 0.35),
        (0.35, 0.35, 0.7), (1.0, 0.7), (0.7, 1.0), (0.3, 0.08), (0.08, 0.3),
    ]  # fmt: skip
    for shape in shapes:
        groups: Sequence[tuple[int, ...]] = pairs if len(shape) == 2 else threes
        for place in random.permutation(len(groups)):
            recipe = [0.0] * inks
            for ink, amount in zip(groups[place], shape, strict=True):
                recipe[ink] = amount
            yield tuple(recipe)
