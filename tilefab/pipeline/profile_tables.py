"""The tables of a profile under check, evaluated in bulk, and colours that its press can print."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.colour.grid_float import apply_float
from tilefab.colour.spaces import absolute_lab, lab_from_xyz, srgb_from_xyz, xyz_from_lab
from tilefab.colour.stages import ColourTable, Grid
from tilefab.errors import ProfileError
from tilefab.io.icc import IccProfile, tag_bytes
from tilefab.io.icc_tables import TableIntent, device_to_pcs, pcs_to_device, read_table

Float64Array = NDArray[np.float64]

INTENTS: tuple[TableIntent, ...] = ("relative", "perceptual", "saturation")
_TAG_NUMBERS = {"perceptual": 0, "relative": 1, "saturation": 2}
_MOST_INKS = 8
_RECIPES = 400_000
_SHARES_MIXED = np.array([0.05, 0.30, 0.80, 1.0])
_CELLS = (4.0, 3.0, 2.0, 1.5, 1.0)
_SAMPLED_LEVELS = 33


@dataclass(frozen=True)
class CheckedTables:
    """A press profile's conversions.

    Attributes
    ----------
    profile
        The profile.
    forward
        Inks to colour, relative to the medium.
    backward
        Colour to inks by intent; an intent without a table is absent.
    same
        Intents whose table is the relative one, byte for byte.
    missing
        What a complete profile would have, in words.
    most_frac
        (N,) largest amount of each ink in the tables from colour to inks; ones where there are none.
    limits_frac
        Largest total ink of each table from colour to inks.
    """

    profile: IccProfile
    forward: ColourTable = field(repr=False)
    backward: dict[str, ColourTable] = field(repr=False)
    same: tuple[str, ...]
    missing: tuple[str, ...]
    most_frac: Float64Array = field(repr=False)
    limits_frac: dict[str, float] = field(repr=False)

    @property
    def inks(self) -> int:
        """Number of inks."""
        return self.profile.channels

    @property
    def limit_frac(self) -> float:
        """Total ink that the relative tables stay within; all inks in full where none tells."""
        return self.limits_frac.get("relative", float(self.inks))

    @property
    def white_lab(self) -> Float64Array:
        """Absolute Lab of the medium as the profile's white point has it."""
        return lab_from_xyz(self.profile.white_xyz)

    def lab(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Relative Lab (M, 3) of ink fractions (M, N)."""
        out = _apply(self.forward, ink_frac)
        return lab_from_xyz(out) if self.forward.target == "xyz" else out

    def absolute(self, ink_frac: NDArray[np.floating]) -> Float64Array:
        """Absolute Lab (M, 3) of ink fractions (M, N)."""
        return absolute_lab(self.lab(ink_frac), self.white_lab)

    def ink_frac(self, lab: NDArray[np.floating], intent: str = "relative") -> Float64Array:
        """Ink fractions (M, N) of relative Lab (M, 3).

        Raises
        ------
        KeyError
            If the intent has no table.
        """
        table = self.backward[intent]
        return _apply(table, xyz_from_lab(lab) if table.source == "xyz" else lab)

    def printed(self, lab: NDArray[np.floating], intent: str = "relative") -> Float64Array:
        """Relative Lab (M, 3) that is printed for relative Lab (M, 3)."""
        return self.lab(self.ink_frac(lab, intent))


def check_tables(profile: IccProfile) -> CheckedTables:
    """Read the tables of a press profile, as far as it has them.

    Raises
    ------
    ProfileError
        If it is no output profile for 1 to 8 inks, has no table from inks to colour, or a table is damaged.
    """
    name = profile.path
    if profile.device_class != "prtr" or not profile.ink_names:
        raise ProfileError(
            f"{name}: is of class {profile.device_class!r} for {profile.colour_space}, but only output profiles of "
            "presses (class 'prtr', ink channels) can be checked: choose the profile made for the press",
            path=name,
        )
    if profile.channels > _MOST_INKS:
        raise ProfileError(
            f"{name}: drives {profile.channels} inks, but profiles of 1 to {_MOST_INKS} can be checked: choose another",
            path=name,
        )
    forward = device_to_pcs(profile, "relative")
    missing = []
    if "A2B1" not in profile.tags and forward.source == "ink" and "A2B0" in profile.tags:
        missing.append("no A2B1: the perceptual table from inks to colour stands for the relative one")
    backward: dict[str, ColourTable] = {}
    same = []
    for intent in INTENTS:
        tag = f"B2A{_TAG_NUMBERS[intent]}"
        if tag in profile.tags:
            backward[intent] = read_table(profile, tag)
            if intent != "relative" and tag_bytes(profile, tag) == tag_bytes(profile, "B2A1"):
                same.append(intent)
        else:
            missing.append(f"no {tag}: no {intent} separation")
    if "relative" not in backward and ("B2A0" in profile.tags or "kTRC" in profile.tags):
        backward["relative"] = pcs_to_device(profile, "relative")
        missing.append("no relative separation of its own: the perceptual table or gray curve stands for it")
    missing += [f"no {tag}: {what}" for tag, what in _WANTED_TAGS.items() if tag not in profile.tags]
    most, limits = np.ones(profile.channels), {}
    if backward:
        nodes = {intent: _nodes(table) for intent, table in backward.items()}
        limits = {intent: float(found.sum(axis=1).max()) for intent, found in nodes.items()}
        most = nodes.get("relative", next(iter(nodes.values()))).max(axis=0)
    return CheckedTables(profile, forward, backward, tuple(same), tuple(missing), most, limits)


_WANTED_TAGS = {
    "wtpt": "the medium counts as ideal white, so absolute colours are unknown",
    "gamt": "programs can't mark colours out of gamut",
}


def _nodes(table: ColourTable) -> Float64Array:
    """Inks (M, N) at all nodes of a table to inks; at even steps of colour where it has no grid."""
    for place, stage in enumerate(table.stages):
        if isinstance(stage, Grid):
            values = stage.values.reshape(-1, stage.values.shape[-1])
            for after in table.stages[place + 1 :]:
                values = after(values)
            return np.clip(values, 0.0, 1.0)
    lab = np.zeros((_SAMPLED_LEVELS, 3))
    lab[:, 0] = np.linspace(0.0, 100.0, _SAMPLED_LEVELS)
    out: Float64Array = table(xyz_from_lab(lab) if table.source == "xyz" else lab)
    return out


def _apply(table: ColourTable, values: NDArray[np.floating]) -> Float64Array:
    data = np.ascontiguousarray(values, dtype=np.float32)
    return np.asarray(apply_float(table, data[np.newaxis])[0], dtype=np.float64)


def printable_colours(tables: CheckedTables, count: int) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Colours within the profile's own ink limits, spread evenly over the solid that they fill; always the same ones.

    Mixtures of few inks are drawn, for they make the gamut's surface, and cut to the total limit; of those that fall
    into one cell of Lab one is kept. Cells are 4 units wide, and less where that gives too few colours.

    Parameters
    ----------
    tables
        The profile.
    count
        How many to keep at most.

    Returns
    -------
    tuple of numpy.ndarray
        Relative Lab (K, 3) of those kept, their inks (K, N), and the Lab (M, 3) of all that were drawn.
    """
    random = rng.generator(0, "printable colours")
    inks = tables.inks
    mixed = np.minimum(1 + np.searchsorted(_SHARES_MIXED, random.random(_RECIPES)), inks)
    rank = np.argsort(np.argsort(random.random((_RECIPES, inks)), axis=1), axis=1)
    amount = np.where(random.random((_RECIPES, inks)) < 0.25, 1.0, random.random((_RECIPES, inks)))
    recipes = np.where(rank < mixed[:, np.newaxis], amount * tables.most_frac, 0.0)
    total = recipes.sum(axis=1, keepdims=True)
    recipes *= np.minimum(1.0, tables.limit_frac / np.maximum(total, 1e-9))
    lab = tables.lab(recipes)
    for side in _CELLS:
        cells = np.floor(lab / side).astype(np.int64) + 1000
        _, first = np.unique(cells @ np.array([4_000_000, 2_000, 1]), return_index=True)
        if len(first) >= count:
            break
    kept = random.permutation(first)[:count]
    return lab[kept], recipes[kept], lab


def srgb8(lab: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Relative Lab (..., 3) for display: sRGB (..., 3) uint8."""
    return np.asarray(np.rint(np.clip(srgb_from_xyz(xyz_from_lab(lab)), 0.0, 1.0) * 255.0), dtype=np.uint8)
