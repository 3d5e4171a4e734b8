"""Device links: from one press's inks straight to another's, or to the same press's with less ink."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.colour.limits import quantise_inks
from tilefab.colour.lut import BackwardAxes, backward_axes, press_reach
from tilefab.colour.node_fit import fit_nodes, multilinear_weights
from tilefab.colour.separation import Separator
from tilefab.colour.spaces import absolute_lab
from tilefab.colour.stages import Curves, grid_points

Float64Array = NDArray[np.float64]

_COLOUR_NODES = 33
_PLACES = 60_000
_STIFF = 0.1
_NO_INK = 5e-4


@dataclass(frozen=True)
class LinkTable:
    """Inks to inks.

    Attributes
    ----------
    curves
        (I, E) curve of each ink that comes in, 0 to 1.
    grid
        (G, ..., G, N) ink fractions that go out.
    """

    curves: Float64Array = field(repr=False)
    grid: Float64Array = field(repr=False)


@dataclass(frozen=True)
class ColourChoice:
    """The recipes that a separation takes for colours, tabulated: where a link begins its search.

    Attributes
    ----------
    axes
        Where the nodes stand.
    inks
        (G, G, G, N).
    """

    axes: BackwardAxes
    inks: Float64Array = field(repr=False)

    def near(self, lab_relative: Float64Array) -> Float64Array:
        """Recipes (M, N) for relative Lab (M, 3), between nodes linear."""
        nodes = len(self.inks)
        weights = multilinear_weights(self.axes.places(lab_relative, nodes), (nodes,) * 3)
        return np.asarray(weights @ self.inks.reshape(-1, self.inks.shape[-1]))


def colour_choice(separator: Separator, nodes: int) -> ColourChoice:
    """Tabulate a separation on ``nodes`` nodes an axis."""
    axes = backward_axes(nodes, press_reach(separator.model, separator.settings.total_limit))
    white = separator.white_lab
    return ColourChoice(axes, separator.separate_grid(lambda n: absolute_lab(axes.colours(n), white), nodes))


def build_link(
    colours_of: Callable[[Float64Array], Float64Array],
    curves: Float64Array,
    separator: Separator,
    nodes: int,
    *,
    source_limit: float,
) -> LinkTable:
    """Tabulate a link.

    Parameters
    ----------
    colours_of
        What the first press makes of recipes (M, I): colours (M, 3) relative to its unprinted tile.
    curves
        (I, E) curves before the grid: as in the first press's table of inks to colours.
    separator
        The second press turned round, with its style.
    nodes
        Nodes for each ink.
    source_limit
        Largest ink sum that comes in; recipes above it need no care.
    """
    inputs = len(curves)
    choice = colour_choice(separator, _COLOUR_NODES)
    white = separator.white_lab
    codes = np.linspace(0.0, 1.0, curves.shape[1])
    axes = tuple(np.interp(np.linspace(0.0, 1.0, nodes), curve, codes) for curve in curves)

    def inks_for(recipes: Float64Array) -> Float64Array:
        lab = colours_of(recipes)
        return separator.follow(absolute_lab(lab, white), choice.near(lab), iterations=6)

    shape = (nodes,) * inputs
    grid = inks_for(grid_points(axes)).reshape(*shape, separator.model.inks)
    random = rng.generator(0, "places between the nodes of a device link")
    recipes = random.random((_PLACES, inputs))
    recipes[::2] **= 2.0
    recipes = recipes[recipes.sum(axis=1) <= source_limit]
    weights = multilinear_weights(Curves(tuple(curves))(recipes) * (nodes - 1), shape)
    grid = fit_nodes(grid, weights, inks_for(recipes), np.ones(len(recipes)), stiffness=_STIFF)
    grid[grid < _NO_INK] = 0.0
    flat = separator.feasible(grid.reshape(-1, grid.shape[-1]))
    # The bare tile stays bare.
    flat[0] = 0.0
    counts = quantise_inks(flat, np.uint16, 100.0 * separator.settings.total_limit)
    return LinkTable(curves, (counts / 65535.0).reshape(grid.shape))
