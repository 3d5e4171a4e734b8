"""Graphcut textures (Kwatra et al. 2003, "Graphcut textures: image and video synthesis using graph cuts").

Patches of the exemplar are laid one over the other, each chosen among those that agree best with what already lies
there, and shown only where the cheapest seam says so. Old seams keep their cost, so a later patch hides a bad one. When
all is filled, the worst seam left is covered again and again, until that helps no more.

From the second seed-thesis: colours are compared in CIELAB (3.3.1), the output may repeat seamlessly (3.3.2), seams
across what the user marks are dearer (3.3.3), and seams are cheaper where the stone is rough (3.1.6). From here:
differences are squared, of several patches that agree well the one is laid whose seam turns out cheapest, and the more
often a place of the exemplar is shown already, the dearer it is, so that no part of a stone recurs more than it must.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.synthesis.graphcut_canvas import Canvas, Exemplar, Placement
from tilefab.synthesis.graphcut_kernels import UNSET
from tilefab.synthesis.graphcut_places import EntirePatches, Strategy, SubPatches
from tilefab.synthesis.protocol import Step, SynthesisRequest, SynthesisResult, Watch
from tilefab.texture.matching import largest_square, matching_image, window_sums

_PATCH_SHARE = 4
_MIN_PATCH_PX = 16
_MAX_PATCH_PX = 512
_GRAIN_SHARE = 8
_MENDS_PER_PATCH = 4
_WATCHED_EVERY = 8


@dataclass(frozen=True)
class GraphcutOptions:
    """Parameters of the method.

    Attributes
    ----------
    placement
        ``"sub-patch"``: square parts of the exemplar are looked for, the most general. ``"entire-patch"``: all of it
        is laid wherever it agrees best, good for regular textures. ``"random"``: anywhere, the fastest.
    candidates
        Patches tried before one is laid.
    mends_per_patch
        The search for better seams ends at the latest when as many patches per patch of the first layer were tried.
    """

    placement: Literal["sub-patch", "entire-patch", "random"] = "sub-patch"
    candidates: int = 2
    mends_per_patch: int = _MENDS_PER_PATCH


def graphcut(
    request: SynthesisRequest, watch: Watch | None = None, options: GraphcutOptions | None = None
) -> SynthesisResult:
    """Grow a texture by graph cuts.

    Parameters
    ----------
    request
        What is to be grown. ``feature_px`` is the side of a patch (default: a quarter of the exemplar's shorter side,
        16 to 512). ``fast`` tries one patch at a time, and mends less.
    watch
        Told of every eighth patch; there is a draft from the first.
    options
        Default: `GraphcutOptions()`.

    Returns
    -------
    SynthesisResult
        The same for the same request and options, on every machine.
    """
    options = options or GraphcutOptions()
    if request.fast:
        options = GraphcutOptions(options.placement, 1, max(1, options.mends_per_patch // 4))
    return _Grower(request, options).grow(watch or (lambda _: True))


class _Grower:
    def __init__(self, request: SynthesisRequest, options: GraphcutOptions) -> None:
        base = matching_image(request.exemplar)
        self.options, self.toroidal = options, request.toroidal
        self.canvas = Canvas(Exemplar.of(base, request.valid, request.weights), request.size, request.toroidal)
        random = rng.generator(request.seed, "graphcut")
        # A window with the pixels around it may not meet itself around the torus.
        rim = 2 if request.toroidal and min(request.size.rows, request.size.cols) >= _MIN_PATCH_PX else 0
        limits = [*request.valid.shape, request.size.rows - rim, request.size.cols - rim]
        wanted = request.feature_px or min(_MAX_PATCH_PX, max(_MIN_PATCH_PX, min(request.valid.shape) // _PATCH_SHARE))
        side = min(wanted, largest_square(request.valid), *limits)
        self.notes = (
            (f"Patches have {side} pixels a side, not {wanted}: the mask leaves no larger square",)
            if side < min(wanted, *limits)
            else ()
        )
        self.squares = SubPatches(self.canvas, base, side, random)
        self.strategy: Strategy = self.squares
        if options.placement != "sub-patch":
            self.strategy = EntirePatches(self.canvas, base, random, matched=options.placement == "entire-patch")
        # Bad places are looked for, and given up, on a grid of this many pixels.
        self.grain = max(1, side // _GRAIN_SHARE)
        self.cells = np.zeros([-(-n // self.grain) for n in self.canvas.source.shape], dtype=np.int64)
        self.hopeless = np.zeros(self.cells.shape, dtype=bool)

    def grow(self, watch: Watch) -> SynthesisResult:
        source, first = self.canvas.source, 0
        pitch = [max(1, n - n // 3) for n in self.strategy.shape]
        expected = -(-source.shape[0] // pitch[0]) * -(-source.shape[1] // pitch[1])
        mends = expected * self.options.mends_per_patch
        laid = 0
        while first < source.size:
            row, col = divmod(first, source.shape[1])
            self._fill(row, col)
            laid += 1
            rest = source.ravel()[first:] == UNSET
            first += int(rest.argmax()) if rest.any() else rest.size
            if laid % _WATCHED_EVERY == 1 and not watch(self._step(min(laid, expected) / (expected + mends))):
                return SynthesisResult(self._draft(), False, self.notes)
        self.cells = self._cell_costs(*map(np.arange, self.hopeless.shape))
        for k in range(mends):
            if not self._mend():
                break
            if k % _WATCHED_EVERY == 0 and not watch(self._step((expected + k) / (expected + mends))):
                return SynthesisResult(source, False, self.notes)
        watch(self._step(1.0))
        return SynthesisResult(source, True, self.notes)

    def _fill(self, row: int, col: int) -> None:
        self._lay_best(self.strategy.to_fill(row, col, self.options.candidates), always=True)
        while self.canvas.source[row, col] == UNSET:
            # A patch with holes may have had one just there.
            self._lay_best(self.squares.to_fill(row, col, self.options.candidates), always=True)

    def _mend(self) -> bool:
        """Lay one more patch over the worst seams if they get better by it; False if no place is left to try.

        Kwatra et al. 2003, section 3.2; the second seed-thesis calls the place the error region. A place tried in vain
        isn't tried again before something near it changes.
        """
        canvas, grain = self.canvas, self.grain
        near = _GRAIN_SHARE // 4
        padded = np.pad(self.cells, near, mode="wrap" if self.toroidal else "constant")
        regions = window_sums(padded, 2 * near + 1, 2 * near + 1)
        regions[self.hopeless] = 0
        worst = int(regions.argmax())
        cell = divmod(worst, regions.shape[1])
        if regions[cell] == 0:
            return False
        self.hopeless[cell] = True
        row, col = (min(k * grain + grain // 2, n - 1) for k, n in zip(cell, canvas.source.shape, strict=True))
        at = self._lay_best(self.strategy.to_mend(row, col, self.options.candidates), always=False)
        if at is not None:
            # A pixel's cost is also that of the seam to the next: what lies just before the window changed as well.
            changed = [
                np.unique(index.ravel() // grain)
                for index in canvas.window(at.row - 1, at.col - 1, at.rows + 1, at.cols + 1)
            ]
            self.cells[np.ix_(*changed)] = self._cell_costs(*changed)
            self.hopeless[np.ix_(*changed)] = False
        return True

    def _cell_costs(self, *cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Seam cost in each cell of some rows and some columns of the grid, in rising order."""
        costs = self.canvas.costs
        pixels = [(k[:, None] * self.grain + np.arange(self.grain)).ravel() for k in cells]
        pixels = [at[at < n] for at, n in zip(pixels, costs.shape, strict=True)]
        costs = costs[np.ix_(*pixels)]
        for axis, (at, k) in enumerate(zip(pixels, cells, strict=True)):
            costs = np.add.reduceat(costs, np.searchsorted(at, k * self.grain), axis=axis)
        return costs

    def _lay_best(self, placements: list[Placement], *, always: bool) -> Placement | None:
        """Lay the patch that gains most, and tell which; unless ``always``, only one that gains anything."""
        trials = [self.canvas.try_patch(at) for at in placements]
        gains = [self.canvas.cost_around(trial.placement) - trial.price for trial in trials]
        best = max(range(len(trials)), key=lambda k: gains[k])
        if not always and gains[best] <= 0:
            return None
        self.canvas.lay(trials[best])
        return placements[best]

    def _step(self, share: float) -> Step:
        return Step(share, self._draft)

    def _draft(self) -> NDArray[np.int32]:
        return self.canvas.with_rest(self.squares.anywhere())
