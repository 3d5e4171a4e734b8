"""The tables of a press profile: inks to colour and colour to inks, on grids, for an ICC profile to carry.

Colours in the tables are relative to the unprinted tile (its white is Lab 100, 0, 0), as ICC profiles want them. Curves
before the grids put nodes where the press has colours; they are computed in the 16-bit steps of the file, so nodes
stand exactly where a reader of the file takes them to be. Nodes are then moved so that readers, who interpolate between
them, come out right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, vstack

from tilefab import rng
from tilefab.colour.gamut import GamutBoundary, perceptual_map, press_boundary
from tilefab.colour.limits import limit_total_ink, quantise_inks
from tilefab.colour.node_fit import fit_nodes, multilinear_weights
from tilefab.colour.press_model import PressModel
from tilefab.colour.separation import Separator
from tilefab.colour.spaces import absolute_lab, delta_e_2000, relative_lab
from tilefab.colour.stages import Curves, grid_points

Float64Array = NDArray[np.float64]

TabulatedIntent = Literal["perceptual", "relative", "saturation"]
"""Intents that have a table of their own."""

CURVE_ENTRIES = 256
BACKWARD_ENTRIES = 4096
_NEUTRAL_CROWDING = 1.5
_OUTER_NODES = 2
_MARGIN_LAB = 4.0
_IN_GAMUT_DELTA_E = 1.0
_FAR_DELTA_E = 50.0
_NO_INK = 5e-4
_RANGE_RECIPES = 3000
_PLACES_IN_CELL = np.array(
    [[0.25, 0.25, 0.25], [0.75, 0.75, 0.25], [0.75, 0.25, 0.75], [0.25, 0.75, 0.75], [0.5, 0.5, 0.5]]
)
_REACHED_DELTA_E = 0.2
_SAME_WAY = 0.04
_STIFF, _NODE_IMPORTANCE = 0.05, 0.5
_NEAR_DELTA_E = 6.0
_NEUTRAL_LAB = 0.05
_FORWARD_PLACES = 80_000
_FORWARD_STIFF = 0.1


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


def _random_recipes(inks: int, count: int, purpose: str) -> Float64Array:
    return np.asarray(rng.generator(0, purpose).random((count, inks)), dtype=np.float64)


def tone_curves(model: PressModel) -> Float64Array:
    """Curves (N, 256) that put nodes of an ink's axis where its colour changes fast, half by way and half by amount."""
    amounts = np.linspace(0.0, 1.0, CURVE_ENTRIES)
    curves = np.empty((model.inks, CURVE_ENTRIES))
    for ink in range(model.inks):
        ramp = np.zeros((CURVE_ENTRIES, model.inks))
        ramp[:, ink] = amounts
        lengths = np.linalg.norm(np.diff(relative_lab(model.lab(ramp), model.white_lab), axis=0), axis=1)
        way = np.concatenate([[0.0], np.cumsum(lengths)])
        curves[ink] = _in_steps(0.5 * amounts + 0.5 * way / max(way[-1], 1e-9))
    return curves


def build_forward(
    model: PressModel, grid: int, *, black_channel: int | None = None, white_lab: Float64Array | None = None
) -> ForwardTable:
    """Tabulate a press model on ``grid`` nodes for each ink.

    Parameters
    ----------
    model
        The fitted press. Recipes with more ink than any patch had take the colour of the most that was
        measured.
    grid
        Nodes for each ink, 2 upwards; 11 to 17 for 4 inks.
    black_channel
        The ink that is kept where a recipe has more ink than was measured; None: all alike.
    white_lab
        (3,) absolute Lab that colours are relative to; None: the press's own unprinted tile.

    Raises
    ------
    ValueError
        If the grid is below 2.
    """
    if grid < 2:
        raise ValueError(f"grid {grid} must be 2 or more")
    inks = model.inks
    white = model.white_lab if white_lab is None else white_lab
    curves = tone_curves(model)
    nodes = [_nodes(curve, grid) for curve in curves]

    def colour(recipes: Float64Array) -> Float64Array:
        measured = limit_total_ink(recipes, 100.0 * model.max_total, black_channel)
        return relative_lab(model.lab(measured), white)

    shape = (grid,) * inks
    table = colour(grid_points(tuple(nodes))).reshape((*shape, 3))
    between = _random_recipes(inks, _FORWARD_PLACES, "places between the nodes of a forward table")
    between[::2] **= 2.0
    between = between[between.sum(axis=1) <= model.max_total]
    place = Curves(tuple(curves))(between) * (grid - 1)
    importance = np.ones(len(between))
    fitted = fit_nodes(table, multilinear_weights(place, shape), colour(between), importance, stiffness=_FORWARD_STIFF)
    fitted[(0,) * inks] = table[(0,) * inks]
    return ForwardTable(curves, fitted)


@dataclass(frozen=True)
class BackwardAxes:
    """Where the nodes of a backward table stand.

    Attributes
    ----------
    curves
        (3, 4096) as in `BackwardTables`.
    """

    curves: Float64Array = field(repr=False)

    def values(self, nodes: int) -> tuple[Float64Array, Float64Array, Float64Array]:
        """L*, a* and b* at ``nodes`` nodes on each axis."""
        at_l = _nodes(self.curves[0], nodes) * 65535.0 / 652.80
        at_l[-1] = 100.0
        at_a, at_b = (_nodes(curve, nodes) * 65535.0 / 256.0 - 128.0 for curve in self.curves[1:])
        for axis in (at_a, at_b):
            axis[np.abs(axis) < _NEUTRAL_LAB] = 0.0
        return at_l, at_a, at_b

    def colours(self, nodes: int) -> Float64Array:
        """Relative Lab (nodes**3, 3) of all nodes."""
        return grid_points(self.values(nodes))

    def places(self, lab_relative: Float64Array, nodes: int) -> Float64Array:
        """Where colours (M, 3) lie, counted in nodes."""
        code = np.column_stack([lab_relative[:, 0] * 652.80, (lab_relative[:, 1:] + 128.0) * 256.0]) / 65535.0
        return Curves(tuple(self.curves))(code) * (nodes - 1)


def backward_axes(grid: int, reach: NDArray[np.floating] | None = None) -> BackwardAxes:
    """Curves that put most nodes where a press has colours.

    Parameters
    ----------
    grid
        Nodes on each axis, 3 upwards.
    reach
        (2, 3): least and largest relative L*, a*, b* of the press; None covers all of Lab evenly.

    Notes
    -----
    The top of the lightness axis is exactly 100, so white gets no ink. Neutral stands on a node of its own, and nodes
    are closer near it, where eyes are most critical. Beyond the reach two nodes or so carry on to the ends.
    """
    code = np.linspace(0.0, 65535.0, BACKWARD_ENTRIES)
    lightness = code / 652.80
    ends = np.array([[0.0, -128.0, -128.0], [100.0, 127.99, 127.99]]) if reach is None else np.array(reach, dtype=float)
    outer = 0.0 if reach is None or grid <= 4 * _OUTER_NODES else _OUTER_NODES / (grid - 1.0)
    low = float(np.clip(ends[0, 0] - _MARGIN_LAB, 0.0, 90.0))
    share = outer * min(low / 10.0, 1.0) if low > 0.0 else 0.0
    # White is reached on an entry of the curve, so that a reader of either version finds it on the top node.
    white = lightness[lightness <= 100.0 + 1e-9][-1]
    rows = [np.interp(lightness, [0.0, max(low, 1e-9), white], [0.0, share, 1.0])]
    for axis in (1, 2):
        values = code / 256.0 - 128.0
        below = min(float(ends[0, axis]) - _MARGIN_LAB, -1.5 * _MARGIN_LAB)
        above = max(float(ends[1, axis]) + _MARGIN_LAB, 1.5 * _MARGIN_LAB)
        below, above = max(below, -127.9), min(above, 127.9)
        # Neutral on a whole node, each side with nodes in proportion to how far it reaches.
        inner = (1.0 - 2.0 * outer) * (grid - 1)
        neutral = np.clip(np.rint(outer * (grid - 1) + inner * -below / (above - below)), 1, grid - 2) / (grid - 1)
        left, right = np.clip(values / below, 0.0, 1.0), np.clip(values / above, 0.0, 1.0)
        crowd = np.arcsinh(_NEUTRAL_CROWDING)
        curve = neutral + (1.0 - outer - neutral) * np.arcsinh(_NEUTRAL_CROWDING * right) / crowd
        curve -= (neutral - outer) * np.arcsinh(_NEUTRAL_CROWDING * left) / crowd
        curve += outer * np.clip((values - above) / max(127.996 - above, 1e-9), 0.0, 1.0)
        curve -= outer * np.clip((below - values) / max(below + 128.0, 1e-9), 0.0, 1.0)
        rows.append(curve)
    return BackwardAxes(_in_steps(np.stack(rows)))


def press_reach(model: PressModel, total_limit: float, white_lab: Float64Array | None = None) -> Float64Array:
    """Least and largest relative L*, a*, b* (2, 3) of what a press prints within a total limit.

    ``white_lab`` (3,) is what colours are relative to; None: the press's own unprinted tile.
    """
    recipes = _random_recipes(model.inks, _RANGE_RECIPES, "recipes that show a press's reach")
    rare = _random_recipes(model.inks, _RANGE_RECIPES, "inks that a recipe has") < min(2.0 / model.inks, 1.0)
    recipes = np.concatenate([recipes, np.sqrt(recipes) * rare, np.eye(model.inks)])
    recipes *= np.minimum(1.0, total_limit / np.maximum(recipes.sum(axis=1, keepdims=True), 1e-9))
    lab = relative_lab(model.lab(recipes), model.white_lab if white_lab is None else white_lab)
    return np.stack([lab.min(axis=0), lab.max(axis=0)])


@dataclass(frozen=True)
class BackwardNodes:
    """Inks at the nodes of a backward table, from which the table of each intent is made.

    Attributes
    ----------
    separator
        The press model turned round, with its limits.
    axes
        Where the nodes stand.
    white_lab
        (3,) absolute Lab that colours are relative to.
    inks
        (G, G, G, N) ink fractions that make the nodes' own colours, or the nearest.
    """

    separator: Separator
    axes: BackwardAxes
    white_lab: Float64Array = field(repr=False)
    inks: Float64Array = field(repr=False)


def backward_nodes(separator: Separator, grid: int, *, white_lab: Float64Array | None = None) -> BackwardNodes:
    """Inks for colours on ``grid`` nodes for each of L*, a*, b*.

    Parameters
    ----------
    separator
        The press model turned round, with its limits.
    grid
        Nodes on each axis, 3 upwards and best odd; 25 to 49.
    white_lab
        (3,) absolute Lab that colours are relative to; None: the press's own unprinted tile. A press that has drifted
        keeps the white it had, so that it prints the same colours as before.

    Raises
    ------
    ValueError
        If the grid is below 3.
    """
    if grid < 3:
        raise ValueError(f"grid {grid} must be 3 or more")
    white = separator.model.white_lab if white_lab is None else white_lab
    axes = backward_axes(grid, press_reach(separator.model, separator.settings.total_limit, white))
    inks = separator.separate_grid(lambda nodes: absolute_lab(axes.colours(nodes), white), grid)
    return BackwardNodes(separator, axes, white, inks)


def backward_table(
    nodes: BackwardNodes, intent: TabulatedIntent, *, image: GamutBoundary | None = None
) -> Float64Array:
    """The table (G, G, G, N) of one intent, ink fractions within the limits.

    Parameters
    ----------
    nodes
        Inks at the nodes.
    intent
        ``"perceptual"``, ``"relative"`` or ``"saturation"``.
    image
        What the perceptual table has to make room for; None: any colour.
    """
    separator, axes, white, relative = nodes.separator, nodes.axes, nodes.white_lab, nodes.inks
    grid, inks = relative.shape[0], relative.shape[-1]
    if intent == "relative":
        table = _between_nodes(nodes, relative, lambda lab: lab)
    else:
        room = image if intent == "perceptual" else None
        fit = perceptual_map(press_boundary(separator, white), room, vivid=intent == "saturation")
        mapped = fit(axes.colours(grid))
        near = multilinear_weights(axes.places(mapped, grid), (grid,) * 3) @ relative.reshape(-1, inks)
        fitted = separator.follow(absolute_lab(mapped, white), np.asarray(near)).reshape(relative.shape)
        table = _between_nodes(nodes, fitted, fit)
    at_white = tuple(
        int(np.flatnonzero(axis == value)[0]) for axis, value in zip(axes.values(grid), (100.0, 0.0, 0.0), strict=True)
    )
    table[table < _NO_INK] = 0.0
    table[at_white] = 0.0
    within = separator.feasible(table.reshape(-1, inks))
    counts = quantise_inks(within, np.uint16, 100.0 * separator.settings.total_limit)
    return np.asarray(counts / 65535.0, dtype=np.float64).reshape(relative.shape)


def build_backward(
    separator: Separator,
    grid: int,
    *,
    image: GamutBoundary | None = None,
    tell: Callable[[float], None] | None = None,
) -> BackwardTables:
    """Tabulate inks for colours on ``grid`` nodes for each of L*, a*, b*.

    Parameters
    ----------
    separator
        The press model turned round, with its limits.
    grid
        Nodes on each axis, 3 upwards and best odd; 25 to 49.
    image
        What the perceptual table has to make room for; None: any colour.
    tell
        Told the share that is done.

    Raises
    ------
    ValueError
        If the grid is below 3.
    """
    report = tell or (lambda _share: None)
    report(0.0)
    nodes = backward_nodes(separator, grid)
    report(0.4)
    wanted = absolute_lab(nodes.axes.colours(grid), nodes.white_lab)
    error = delta_e_2000(separator.model.lab(nodes.inks.reshape(-1, separator.model.inks)), wanted)
    distance = np.clip(error / _FAR_DELTA_E, 0.0, 1.0)
    gamut = np.where(error < _IN_GAMUT_DELTA_E, 0.0, np.maximum(distance, 1.0 / 65535.0))
    relative = backward_table(nodes, "relative")
    report(0.6)
    perceptual = backward_table(nodes, "perceptual", image=image)
    report(0.8)
    saturation = backward_table(nodes, "saturation")
    report(1.0)
    return BackwardTables(nodes.axes.curves, perceptual, relative, saturation, gamut.reshape((grid,) * 3))


def _between_nodes(
    given: BackwardNodes, inks: Float64Array, fit: Callable[[Float64Array], Float64Array]
) -> Float64Array:
    """Nodes moved so that colours between them come out right, where the press can make them.

    Parameters
    ----------
    given
        The press, and where the nodes stand.
    inks
        (G, G, G, N) on the nodes.
    fit
        What the table makes of relative Lab before it is separated.
    """
    separator, axes = given.separator, given.axes
    nodes = inks.shape[0]
    flat = inks.reshape(-1, inks.shape[-1])
    model = separator.model
    cells = grid_points((np.arange(nodes - 1.0),) * 3)
    values = axes.values(nodes)

    def wanted(places: Float64Array) -> tuple[Float64Array, csr_matrix, Float64Array]:
        """Colours wanted at places, the weights of the nodes there, and the recipes between the nodes."""
        lab = np.column_stack([np.interp(places[:, k], np.arange(nodes), values[k]) for k in range(3)])
        weights = multilinear_weights(places, (nodes,) * 3)
        return absolute_lab(fit(lab), given.white_lab), weights, np.asarray(weights @ flat)

    def error(recipe: Float64Array, colour: Float64Array) -> Float64Array:
        return np.asarray(delta_e_2000(model.lab(recipe), colour))

    # Cells that lie near enough to the gamut to hold something of it.
    colour, _, recipe = wanted(cells + 0.5)
    cells = cells[error(recipe, colour) < _NEAR_DELTA_E]
    colour, weights, recipe = wanted((cells[:, np.newaxis] + _PLACES_IN_CELL).reshape(-1, 3))
    right = separator.follow(colour, recipe, iterations=5)
    # A recipe far from the one between the nodes is another way to the same colour; nodes drawn to both fit neither.
    same_way = np.abs(right - recipe).max(axis=1) < _SAME_WAY
    made = (error(right, colour) < _REACHED_DELTA_E) & same_way
    node_colour, node_weights, node_recipe = wanted(grid_points((np.arange(float(nodes)),) * 3))
    on_node = error(node_recipe, node_colour) < _REACHED_DELTA_E
    return fit_nodes(
        inks,
        vstack([weights, node_weights]).tocsr(),
        np.concatenate([right, node_recipe]),
        np.concatenate([made.astype(np.float64), _NODE_IMPORTANCE * on_node]),
        stiffness=_STIFF,
    )
