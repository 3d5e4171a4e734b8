"""Smooth press profiles put together element by element, of a press that is a formula: its inks only add density."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.icc_samples import fixed, lut_mft, make_profile
from tilefab.colour.spaces import WHITE_XYZ_D50, absolute_lab, lab_from_xyz, xyz_from_lab
from tilefab.colour.stages import grid_points, lab_from_unit, lab_to_unit
from tilefab.io.cgats_write import measurements_text

Float64Array = NDArray[np.float64]

WHITE_XYZ = (0.80, 0.83, 0.66)
DENSITY = np.array(
    [
        [0.70, 0.45, 0.12],
        [0.25, 0.62, 0.30],
        [0.03, 0.06, 0.70],
        [0.85, 0.85, 0.80],
        [0.20, 0.40, 0.15],
        [0.10, 0.14, 0.30],
        [0.45, 0.20, 0.40],
        [0.15, 0.20, 0.25],
    ]
)
NAMES = {
    1: ("Black",),
    4: ("Cyan", "Magenta", "Yellow", "Black"),
    6: tuple(f"Ink {ink}" for ink in range(1, 7)),
}
SPACES = {1: "GRAY", 3: "CMY ", 4: "CMYK", 6: "6CLR", 8: "8CLR"}


def formula_lab(ink_frac: Float64Array) -> Float64Array:
    """Relative Lab of the press."""
    density = ink_frac @ DENSITY[: ink_frac.shape[1]]
    return lab_from_xyz(np.array(WHITE_XYZ_D50) * 10.0**-density)


def formula_inks(lab: Float64Array, inks: int, limit: float) -> Float64Array:
    """Inks of the press for relative Lab: the first three do it all, within a total limit."""
    density = -np.log10(np.maximum(xyz_from_lab(lab) / np.array(WHITE_XYZ_D50), 1e-3))
    used = min(inks, 3)
    out = np.zeros((len(lab), inks))
    out[:, :used] = np.clip(density @ np.linalg.pinv(DENSITY[:used]), 0.0, 1.0)
    return out * np.minimum(1.0, limit / np.maximum(out.sum(axis=1, keepdims=True), 1e-9))


def formula_patches(inks: int, count: int = 200) -> tuple[Float64Array, Float64Array]:
    """Recipes (count, inks), the first bare, and their absolute Lab."""
    recipes = np.random.default_rng(5).random((count, inks)) ** 2
    recipes[0] = 0.0
    return recipes, absolute_lab(formula_lab(recipes), lab_from_xyz(WHITE_XYZ))


def formula_data(inks: int, shift: float = 0.0) -> str:
    """The patches as a .ti3 file; ``shift`` is added to L*."""
    recipes, lab = formula_patches(inks)
    return measurements_text(
        recipes,
        lab + np.array([shift, 0.0, 0.0]),
        ink_names=NAMES.get(inks, tuple(f"Ink {ink}" for ink in range(1, inks + 1))),
        description="A formula",
        created="2026-01-15",
    )


def formula_profile(
    inks: int, *, leave_out: tuple[str, ...] = (), embed: bool = True, limit: float = 2.6, dent: float = 0.0
) -> bytes:
    """An output profile of the press: the perceptual tables are lighter, the saturation ones are the relative ones.

    ``dent`` lifts ink by so much at one node of the relative table, in the middle of the gamut.
    """
    nodes = {1: 33, 3: 13, 4: 9, 6: 4, 8: 3}[inks]
    before = np.tile(np.array([0, 65535]), (inks, 1))
    three = np.tile(np.array([0, 65535]), (3, 1))
    recipes = grid_points((np.linspace(0.0, 1.0, nodes),) * inks)
    forward = lab_to_unit(2)(formula_lab(recipes)).reshape(*(nodes,) * inks, 3)
    back_nodes = 17
    lab = lab_from_unit(2)(grid_points((np.linspace(0.0, 1.0, back_nodes),) * 3))
    backward = formula_inks(lab, inks, limit)
    if dent:
        backward[np.linalg.norm(lab - [60.0, 0.0, 10.0], axis=1).argmin(), 0] += dent
    lighter = formula_inks(lab * [0.8, 1.0, 1.0] + [20.0, 0.0, 0.0], inks, limit)

    def table(first: NDArray[np.integer], grid: Float64Array, after: NDArray[np.integer]) -> bytes:
        return lut_mft("mft2", first, np.rint(np.clip(grid, 0.0, 1.0) * 65535).astype(int), after, np.eye(3))

    shape = (back_nodes,) * 3 + (inks,)
    relative = table(three, backward.reshape(shape), before)
    tags = [
        ("wtpt", b"XYZ \0\0\0\0" + fixed(*WHITE_XYZ)),
        ("A2B0", table(before, forward, three)),
        ("A2B1", table(before, forward, three)),
        ("B2A0", table(three, lighter.reshape(shape), before)),
        ("B2A1", relative),
        ("B2A2", relative),
    ]
    if embed:
        tags.append(("targ", b"text\0\0\0\0" + formula_data(inks).encode() + b"\0"))
    kept = [(tag, body + bytes(-len(body) % 4)) for tag, body in tags if tag not in leave_out]
    return make_profile("prtr", SPACES[inks], "Lab ", kept)
