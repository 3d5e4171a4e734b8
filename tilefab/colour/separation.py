"""From wanted colours to inks: the press model turned round, under ink limits.

Three inks or more make most colours in many ways. Which of them is taken is a matter of style: `standard` wishes for
black that grows towards dark and neutral colours, as printers are used to; `least_ink` takes the cheapest recipe at the
prices given. Both keep black out of the highlights, where its dots would show as grain, and both agree with their
neighbours in colour space, so that smooth stone stays smooth. Colours that the press can't make become the nearest
ones, hue before chroma.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour.press_model import PressModel
from tilefab.colour.separation_kernels import solve_rows
from tilefab.colour.spaces import delta_e_2000

Float64Array = NDArray[np.float64]

SeparationStyle = Literal["standard", "least_ink"]
"""How one of many recipes for a colour is chosen."""

_SLICE_COLOURS = 512
_DARK_NEUTRALITY = 4.0
_COARSEST_NODES = 17
_LEAST_INK_PRICE = 0.2
_TOLERANCE_ROUNDS = 4
_STANDARD_PRICE = 0.01
_SPARING = 0.02
_BLACK_RISE = 1.8
_SMOOTHING_ROUNDS = {"standard": 6, "least_ink": 3}
_AGREEMENT = {"standard": 5.0, "least_ink": 1.0}
_FOLLOWING = 0.1
_STRONG_WISH, _WISH = 30.0, 0.1


@dataclass(frozen=True)
class SeparationSettings:
    """How inks are chosen.

    Attributes
    ----------
    total_limit
        Largest ink sum, ink fractions; 2.8 is 280 %.
    ink_limits
        Largest fraction of each ink; None is 1 for all.
    black_channel
        Index of the black ink; None where there is none.
    style
        ``"standard"`` or ``"least_ink"``.
    prices
        What each ink costs, in any unit; None is the same for all. Only their ratios matter.
    tolerance
        The most that a colour may move for cheaper inks, CIEDE2000; 0 keeps colours exact. Only `Separator.follow`
        heeds it (least_ink).
    thrift
        How readily colours move within the tolerance: the square of the difference worth taking for a whole ink of mean
        price, half.
    black_start
        Share of the way from white to the darkest colour, 0 to 1, at which black is first wished for (standard).
    black_most
        Black wished for in the darkest neutral, ink fraction (standard).
    black_chroma
        Chroma at which the wish for black has fallen to about a third (standard).
    grain_start, grain_end
        Shares of the way from white to the darkest colour at which black is first allowed, and at which it is allowed
        in full.
    hue_weight
        Weight of hue errors against chroma errors of colours out of gamut, above 1.
    """

    total_limit: float
    ink_limits: tuple[float, ...] | None = None
    black_channel: int | None = 3
    style: SeparationStyle = "standard"
    prices: tuple[float, ...] | None = None
    tolerance: float = 0.0
    thrift: float = 4.0
    black_start: float = 0.4
    black_most: float = 0.95
    black_chroma: float = 18.0
    grain_start: float = 0.15
    grain_end: float = 0.5
    hue_weight: float = 2.0


def error_metric(lab_d50: Float64Array, hue_weight: float) -> Float64Array:
    """Matrices (M, 3, 3) that turn small Lab errors at colours (M, 3) into those that CIEDE2000 weighs.

    Hue counts ``hue_weight`` times as much at high chroma, which only matters out of gamut: inside, errors are nil.

    References
    ----------
    G. Sharma, W. Wu, E. N. Dalal (2005), as `tilefab.colour.spaces.delta_e_2000`, without the rotation term.
    """
    lightness, a, b = lab_d50.T
    seventh = np.hypot(a, b) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(seventh / (seventh + 25.0**7))
    chroma = np.hypot(a * stretch, b)
    direction = np.column_stack([a * stretch, b]) / np.maximum(chroma, 1e-9)[:, np.newaxis]
    direction[chroma < 1e-9] = (1.0, 0.0)
    hue = np.degrees(np.arctan2(b, a * stretch))
    t = 1.0 - 0.17 * np.cos(np.radians(hue - 30.0)) + 0.24 * np.cos(np.radians(2.0 * hue))
    t += 0.32 * np.cos(np.radians(3.0 * hue + 6.0)) - 0.20 * np.cos(np.radians(4.0 * hue - 63.0))
    s_l = 1.0 + 0.015 * (lightness - 50.0) ** 2 / np.sqrt(20.0 + (lightness - 50.0) ** 2)
    s_c, s_h = 1.0 + 0.045 * chroma, 1.0 + 0.015 * chroma * t
    # Near the neutral axis hue means nothing: the extra weight fades in.
    extra = 1.0 + (hue_weight - 1.0) * chroma / (chroma + 10.0)
    metric = np.zeros((len(lab_d50), 3, 3))
    metric[:, 0, 0] = 1.0 / s_l
    metric[:, 1, 1] = direction[:, 0] * stretch / s_c
    metric[:, 1, 2] = direction[:, 1] / s_c
    metric[:, 2, 1] = -direction[:, 1] * stretch * extra / s_h
    metric[:, 2, 2] = direction[:, 0] * extra / s_h
    return metric


def black_wish(depth: Float64Array, chroma: Float64Array, settings: SeparationSettings) -> Float64Array:
    """Black wished for, (M,) ink fractions: most in the dark neutrals.

    Parameters
    ----------
    depth, chroma
        (M,) share of the way from white to the darkest colour, and chroma.
    """
    way = np.clip((depth - settings.black_start) / (1.0 - settings.black_start), 0.0, 1.0)
    fade = np.exp(-((chroma / settings.black_chroma) ** 2))
    return np.asarray(settings.black_most * way**_BLACK_RISE * fade, dtype=np.float64)


def black_cap(depth: Float64Array, settings: SeparationSettings) -> Float64Array:
    """Black allowed, (M,) ink fractions, at a share ``depth`` (M,) of the way from white to the darkest colour."""
    way = np.clip((depth - settings.grain_start) / (settings.grain_end - settings.grain_start), 0.0, 1.0)
    return np.asarray(way * way * (3.0 - 2.0 * way), dtype=np.float64)


class Separator:
    """Inks for colours, by turning a press model round.

    Parameters
    ----------
    model
        The fitted press.
    settings
        Limits and style.
    threads
        Number of threads, 1 or more; never changes a result.

    Raises
    ------
    ValueError
        If a limit or price is not above zero, or does not fit the model's inks.
    """

    def __init__(self, model: PressModel, settings: SeparationSettings, *, threads: int = 1) -> None:
        limits = settings.ink_limits or (1.0,) * model.inks
        if len(limits) != model.inks or not all(0.0 < limit <= 1.0 for limit in limits):
            raise ValueError(f"ink_limits {limits} must be {model.inks} fractions above 0, up to 1")
        prices = settings.prices or (1.0,) * model.inks
        if len(prices) != model.inks or not all(0.0 < price < np.inf for price in prices):
            raise ValueError(f"prices {prices} must be {model.inks} numbers above 0")
        if not settings.total_limit > 0.0:
            raise ValueError(f"total_limit {settings.total_limit} must be above 0")
        if settings.black_channel is not None and not 0 <= settings.black_channel < model.inks:
            raise ValueError(f"black_channel {settings.black_channel} is outside 0 .. {model.inks - 1}")
        self.model = model
        self.settings = settings
        self.threads = max(threads, 1)
        self.upper = np.array(limits, dtype=np.float64)
        self.prices = np.array(prices, dtype=np.float64) / np.mean(prices)
        self.white_lab = model.white_lab
        # The darkest print that is still near neutral: colour counts more than lightness.
        metric = np.diag([1.0, _DARK_NEUTRALITY, _DARK_NEUTRALITY])[np.newaxis]
        middle = np.full((1, model.inks), min(0.5, settings.total_limit / model.inks / 2.0)) * self.upper
        self.dark_ink = self.solve(
            np.zeros((1, 3)), start=middle, anchor=middle, pull=np.full_like(middle, 1e-3), metric=metric
        )[0]
        self.dark_lab = np.asarray(model.lab(self.dark_ink[np.newaxis])[0])

    def solve(
        self,
        lab_d50: Float64Array,
        *,
        start: Float64Array,
        anchor: Float64Array,
        pull: Float64Array,
        price: Float64Array | None = None,
        upper: Float64Array | None = None,
        metric: Float64Array | None = None,
        iterations: int = 40,
    ) -> Float64Array:
        """Inks (M, N) nearest to absolute Lab (M, 3), drawn to ``anchor`` with weight ``pull``; see `solve_rows`."""
        colours = np.ascontiguousarray(lab_d50, dtype=np.float64)
        errors = error_metric(colours, self.settings.hue_weight) if metric is None else metric
        most = np.broadcast_to(self.upper, start.shape).copy() if upper is None else upper
        first = self.feasible(start, most)
        costs = np.zeros_like(first) if price is None else price
        out = np.empty_like(first)

        def one(part: slice) -> None:
            solve_rows(
                colours[part],
                errors[part],
                first[part],
                anchor[part],
                pull[part],
                costs[part],
                most[part],
                self.settings.total_limit,
                self.model.arrays,
                iterations,
                out[part],
            )

        parts = list(_slices(len(colours)))
        if self.threads == 1 or len(parts) < 2:
            for part in parts:
                one(part)
        else:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(one, parts))
        return out

    def feasible(self, ink_frac: Float64Array, upper: Float64Array | None = None) -> Float64Array:
        """Recipes (M, N) brought within the limits by clipping, then scaling down."""
        clipped = np.clip(ink_frac, 0.0, self.upper if upper is None else upper)
        total = clipped.sum(axis=1, keepdims=True)
        limit = self.settings.total_limit
        return np.asarray(clipped * np.minimum(1.0, limit / np.maximum(total, limit)), dtype=np.float64)

    def depth(self, lab_d50: Float64Array) -> Float64Array:
        """Share (M,) of the way from white to the darkest colour, by L*."""
        white, dark = float(self.white_lab[0]), float(self.dark_lab[0])
        return np.clip((white - lab_d50[:, 0]) / max(white - dark, 1e-6), 0.0, 1.0)

    def limits_at(self, lab_d50: Float64Array) -> Float64Array:
        """Largest fraction (M, N) of each ink for colours (M, 3): black is kept out of highlights."""
        upper = np.broadcast_to(self.upper, (len(lab_d50), self.model.inks)).copy()
        black = self.settings.black_channel
        if black is not None:
            upper[:, black] *= black_cap(self.depth(lab_d50), self.settings)
        return upper

    def separate(self, lab_d50: Float64Array) -> Float64Array:
        """Inks for colours, each solved alone.

        Parameters
        ----------
        lab_d50
            (M, 3) absolute Lab under D50.

        Returns
        -------
        numpy.ndarray
            (M, N) float64 ink fractions within the limits.

        Raises
        ------
        ValueError
            If the shape of ``lab_d50`` doesn't fit.
        """
        colours = np.asarray(lab_d50, dtype=np.float64)
        if colours.ndim != 2 or colours.shape[1] != 3:
            raise ValueError(f"lab_d50 must be (M, 3), but its shape is {colours.shape}")
        depth = self.depth(colours)
        upper = self.limits_at(colours)
        first = np.repeat((0.5 * depth)[:, np.newaxis], self.model.inks, axis=1)
        anchor, pull, price = self._objective(colours)
        black = self.settings.black_channel
        if black is not None:
            first[:, black] = anchor[:, black] if self.settings.style == "standard" else 0.5 * upper[:, black]
        if self.settings.style == "standard" and black is not None:
            # First with a strong wish, which decides among the many recipes; then it weakens until it no longer costs
            # accuracy.
            strong = pull.copy()
            strong[:, black] = _STRONG_WISH
            first = self.solve(
                colours, start=first, anchor=anchor, pull=strong, price=price, upper=upper, iterations=25
            )
        return self.solve(colours, start=first, anchor=anchor, pull=pull, price=price, upper=upper, iterations=30)

    def _objective(self, lab_d50: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """What a style wants of recipes for colours (M, 3): anchors, their weights, and prices, all (M, N)."""
        anchor = np.zeros((len(lab_d50), self.model.inks))
        if self.settings.style == "least_ink":
            price = np.broadcast_to(_LEAST_INK_PRICE * self.prices, anchor.shape)
            return anchor, np.full_like(anchor, _SPARING), price
        pull = np.full_like(anchor, 1e-3)
        black = self.settings.black_channel
        if black is not None:
            chroma = np.hypot(lab_d50[:, 1], lab_d50[:, 2])
            anchor[:, black] = black_wish(self.depth(lab_d50), chroma, self.settings)
            pull[:, black] = _WISH
        return anchor, pull, np.broadcast_to(_STANDARD_PRICE * self.prices, anchor.shape)

    def _agree(self, lab_d50: Float64Array, near: Float64Array, iterations: int) -> Float64Array:
        """Recipes (M, N) that the style wants for colours (M, 3), as far as they agree with ``near`` (M, N)."""
        anchor, pull, price = self._objective(lab_d50)
        agreement = _AGREEMENT[self.settings.style]
        together = pull + agreement
        return self.solve(
            lab_d50,
            start=near,
            anchor=(pull * anchor + agreement * near) / together,
            pull=together,
            price=price,
            upper=self.limits_at(lab_d50),
            iterations=iterations,
        )

    def follow(self, lab_d50: Float64Array, near: Float64Array, *, iterations: int = 8) -> Float64Array:
        """Inks (M, N) for colours (M, 3) that stay as near as can be to recipes (M, N) of about those colours.

        With a tolerance, colours then move as far as it allows for cheaper inks.
        """
        colours = np.asarray(lab_d50, dtype=np.float64)
        upper = self.limits_at(colours)
        pull = np.full_like(near, _FOLLOWING)
        exact = self.solve(colours, start=near, anchor=near, pull=pull, upper=upper, iterations=iterations)
        tolerance = self.settings.tolerance
        if tolerance == 0.0:
            return exact
        # The error that a price buys is nearly in proportion to it: a few rounds bring it under the most allowed.
        reached = self.model.lab(exact)
        share = np.ones(len(colours))
        cheaper = exact
        for _ in range(_TOLERANCE_ROUNDS):
            price = (self.settings.thrift * share)[:, np.newaxis] * self.prices
            cheaper = self.solve(
                reached,
                start=cheaper,
                anchor=exact,
                pull=np.full_like(near, _SPARING),
                price=price,
                upper=upper,
                iterations=iterations,
            )
            moved = np.asarray(delta_e_2000(self.model.lab(cheaper), reached))
            share *= np.minimum(1.0, tolerance / np.maximum(moved, 1e-9))
        return cheaper

    def separate_grid(self, colours_at: Callable[[int], Float64Array], nodes: int) -> Float64Array:
        """Inks for a grid of colours, smooth from node to node.

        The choice among recipes is made on a coarse grid and smoothed there; finer ones agree with it, each making its
        own colours exactly.

        Parameters
        ----------
        colours_at
            Gives the colours of the same box on ``n`` nodes an axis: (n**3, 3) absolute Lab in C order.
        nodes
            Nodes on each axis, 2 upwards.

        Returns
        -------
        numpy.ndarray
            (nodes, nodes, nodes, N) float64 ink fractions within the limits.
        """
        sizes = [nodes]
        while sizes[0] > _COARSEST_NODES:
            sizes.insert(0, (sizes[0] + 1) // 2)
        inks = self.model.inks
        size = sizes[0]
        colours = colours_at(size)
        result = self.separate(colours)
        for _ in range(_SMOOTHING_ROUNDS[self.settings.style]):
            near = neighbour_mean(result.reshape(size, size, size, inks)).reshape(-1, inks)
            result = self._agree(colours, near, 15)
        for finer in sizes[1:]:
            near = refined(result.reshape(size, size, size, inks), finer).reshape(-1, inks)
            size, colours = finer, colours_at(finer)
            result = self._agree(colours, near, 8)
        return result.reshape(size, size, size, inks)


def _slices(count: int) -> Iterator[slice]:
    for begin in range(0, count, _SLICE_COLOURS):
        yield slice(begin, min(begin + _SLICE_COLOURS, count))


def refined(grid: Float64Array, nodes: int) -> Float64Array:
    """A grid (A, A, A, N) on ``nodes`` nodes an axis, by cubic splines between its own."""
    places = np.meshgrid(*[np.linspace(0.0, size - 1.0, nodes) for size in grid.shape[:3]], indexing="ij")
    order = 3 if min(grid.shape[:3]) > 3 else 1
    return np.stack(
        [ndimage.map_coordinates(grid[..., ink], places, order=order, mode="nearest") for ink in range(grid.shape[3])],
        axis=-1,
    )


def neighbour_mean(grid: Float64Array) -> Float64Array:
    """Mean of the up to six neighbours of every node of a grid (A, B, C, N)."""
    total = np.zeros_like(grid)
    count = np.zeros(grid.shape[:3])
    for axis in range(3):
        ahead = [slice(None)] * 4
        behind = [slice(None)] * 4
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        total[tuple(behind)] += grid[tuple(ahead)]
        total[tuple(ahead)] += grid[tuple(behind)]
        count[tuple(behind[:3])] += 1.0
        count[tuple(ahead[:3])] += 1.0
    return np.asarray(total / np.maximum(count, 1.0)[..., np.newaxis], dtype=np.float64)
