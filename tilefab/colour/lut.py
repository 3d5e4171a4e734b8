"""The tables of a press profile: inks to colour and colour to inks, on grids, for an ICC profile to carry.

Colours in the tables are relative to the unprinted tile (its white is Lab 100, 0, 0), as ICC profiles want
them. Curves before the grids put more nodes where colours change fast or are judged most strictly; they are
computed in the 16-bit steps of the file, so nodes stand exactly where a reader of the file takes them to be.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.gamut import perceptual_map
from tilefab.colour.limits import limit_total_ink
from tilefab.colour.press_model import PressModel
from tilefab.colour.separation import Separator
from tilefab.colour.spaces import absolute_lab, delta_e_2000, relative_lab

Float64Array = NDArray[np.float64]

CURVE_ENTRIES = 256
_CROWDING = 5.0
_IN_GAMUT_DELTA_E = 1.0
_FAR_DELTA_E = 50.0
_NO_INK = 5e-4


@dataclass(frozen=True)
class ForwardTable:
    """Inks to colour.

    Attributes
    ----------
    curves
        (N, E) curve of each ink, 0 to 1: values at E even steps, 2 to 4096.
    grid
        (G, ..., G, 3) relative Lab, one axis for each of 1 to 8 inks.
    """

    curves: Float64Array = field(repr=False)
    grid: Float64Array = field(repr=False)


@dataclass(frozen=True)
class BackwardTables:
    """Colour to inks.

    Attributes
    ----------
    curves
        (3, E) curves of L*, a*, b* as ICC version 2 encodes them in 16 bits, 0 to 1: values at E even steps, 2 to
        4096. All tables share them.
    perceptual, relative, saturation
        (G, G, G, N) ink fractions of each rendering intent; axes L*, a*, b*.
    gamut
        (G, G, G): 0 where the press makes the colour, up to 1 with its distance where not.
    """

    curves: Float64Array = field(repr=False)
    perceptual: Float64Array = field(repr=False)
    relative: Float64Array = field(repr=False)
    saturation: Float64Array = field(repr=False)
    gamut: Float64Array = field(repr=False)


def _in_steps(curve: Float64Array) -> Float64Array:
    return np.round(np.clip(curve, 0.0, 1.0) * 65535.0) / 65535.0


def _nodes(curve: Float64Array, count: int) -> Float64Array:
    """Inputs, 0 to 1, that a curve sends to ``count`` even steps; the least where the curve is flat."""
    rising, first = np.unique(curve, return_index=True)
    return np.interp(np.linspace(0.0, 1.0, count), rising, first / (len(curve) - 1.0))


def build_forward(model: PressModel, grid: int) -> ForwardTable:
    """Tabulate a press model on ``grid`` nodes for each ink.

    Parameters
    ----------
    model
        The fitted press. Recipes with more ink than any patch had take the colour of the most that was
        measured.
    grid
        Nodes for each ink, 2 upwards; 11 to 17 for 4 inks.

    Raises
    ------
    ValueError
        If the grid is below 2.
    """
    if grid < 2:
        raise ValueError(f"grid {grid} must be 2 or more")
    inks = model.inks
    white = model.lab(np.zeros((1, inks)))[0]
    amounts = np.linspace(0.0, 1.0, CURVE_ENTRIES)
    curves = np.empty((inks, CURVE_ENTRIES))
    nodes = []
    for ink in range(inks):
        ramp = np.zeros((CURVE_ENTRIES, inks))
        ramp[:, ink] = amounts
        lengths = np.linalg.norm(np.diff(relative_lab(model.lab(ramp), white), axis=0), axis=1)
        way = np.concatenate([[0.0], np.cumsum(lengths)])
        curves[ink] = _in_steps(0.5 * amounts + 0.5 * way / max(way[-1], 1e-9))
        nodes.append(_nodes(curves[ink], grid))
    recipes = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, inks)
    black = 3 if inks == 4 else None
    measured = limit_total_ink(recipes, 100.0 * model.max_total, black)
    lab = relative_lab(model.lab(measured), white)
    return ForwardTable(curves, lab.reshape((grid,) * inks + (3,)))


def backward_axes(grid: int) -> tuple[Float64Array, tuple[Float64Array, Float64Array, Float64Array]]:
    """Curves (3, 256) for colours and the L*, a*, b* values at which ``grid`` nodes then stand.

    The top of the lightness axis is exactly 100, so white gets no ink; a* and b* are denser near neutral, and
    with an odd ``grid`` the neutral axis falls on nodes.
    """
    entries = np.arange(CURVE_ENTRIES)
    code = entries * 65535.0 / (CURVE_ENTRIES - 1)
    lightness = _in_steps(np.minimum(entries / (CURVE_ENTRIES - 2.0), 1.0))
    span = (code - 32768.0) / 32768.0
    crowded = _in_steps(0.5 + 0.5 * np.arcsinh(_CROWDING * span) / np.arcsinh(_CROWDING))
    curves = np.stack([lightness, crowded, crowded])
    at_l = _nodes(lightness, grid) * 65535.0 / 652.80
    at_ab = _nodes(crowded, grid) * 65535.0 / 256.0 - 128.0
    at_l[-1] = 100.0
    at_ab[np.abs(at_ab) < 0.02] = 0.0
    return curves, (at_l, at_ab, at_ab)


def build_backward(separator: Separator, grid: int) -> BackwardTables:
    """Tabulate inks for colours on ``grid`` nodes for each of L*, a*, b*.

    Parameters
    ----------
    separator
        The press model turned round, with its limits.
    grid
        Nodes on each axis, 3 upwards and best odd; 25 to 33.

    Raises
    ------
    ValueError
        If the grid is below 3.
    """
    if grid < 3:
        raise ValueError(f"grid {grid} must be 3 or more")
    curves, axes = backward_axes(grid)
    shape = (grid, grid, grid)
    wanted = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    model = separator.model
    white = model.lab(np.zeros((1, model.inks)))[0]

    absolute = absolute_lab(wanted, white)
    relative = separator.separate(absolute, shape)
    error = delta_e_2000(model.lab(relative), absolute)
    distance = np.clip(error / _FAR_DELTA_E, 0.0, 1.0)
    gamut = np.where(error < _IN_GAMUT_DELTA_E, 0.0, np.maximum(distance, 1.0 / 65535.0))

    perceptual = separator.separate(absolute_lab(perceptual_map(separator, white)(wanted), white), shape)
    is_white = (wanted[:, 0] == 100.0) & (wanted[:, 1] == 0.0) & (wanted[:, 2] == 0.0)
    for table in (relative, perceptual):
        table[table < _NO_INK] = 0.0
        table[is_white] = 0.0
    inks = (*shape, model.inks)
    pleasing = perceptual.reshape(inks)
    return BackwardTables(curves, pleasing, relative.reshape(inks), pleasing, gamut.reshape(shape))
