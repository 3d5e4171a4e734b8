"""Occurrence-uniform synthesis by reversed nearest-neighbour fields.

Texture optimisation as in LazyFluids (Jamriška et al. 2015, "LazyFluids: appearance transfer for fluid animations",
4.1), as the first seed's 3.7.1 describes it: the energy of Eq. 3.3 alone lets a result show only the parts of an
exemplar that agree easily, the blurred ones above all. So patches of the exemplar look for places in the result, not
the other way about; those that found a good one take it, each at most once a round; and rounds go on over what is still
free, so that every part of the exemplar is shown about equally often.

At the finest scales, where nothing of the arrangement changes any more, places are searched for from the result's side,
at a price for uneven use.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.synthesis.edges import fill_holes
from tilefab.synthesis.levels import Levels
from tilefab.synthesis.patch_field import PatchField, Workers
from tilefab.synthesis.patch_kernels import PATCH_PX, search
from tilefab.synthesis.protocol import SynthesisRequest, SynthesisResult, Watch
from tilefab.synthesis.pyramid import Scale, features, scales
from tilefab.synthesis.usage import NO_SHIFTS, Usage, UsageOptions

_TURNS_APART, _ROUNDS_APART = 64, 1 << 16


@dataclass(frozen=True)
class UniformOptions:
    """Parameters of the method.

    Attributes
    ----------
    iterations
        At the finest scale, and at most at the coarsest; in between they grow by ``more`` a scale.
    more
        See ``iterations``.
    forward_scales
        How many of the finest scales are searched from the result's side.
    filled
        Share of the result at which rounds end; what is left is searched for from the result's side.
    passes, tries
        PatchMatch passes of a round, and random candidates in each.
    usage
        Prices where places are searched for from the result's side.
    settling, seam_weight
        As of `tilefab.synthesis.self_tuning.SelfTuningOptions`.
    """

    iterations: tuple[int, int] = (4, 10)
    more: float = 1.4
    forward_scales: int = 3
    filled: float = 0.95
    passes: int = 3
    tries: int = 8
    usage: UsageOptions = field(default_factory=lambda: UsageOptions(again=0.0))
    settling: int = 4
    seam_weight: int = 8


FAST = UniformOptions(iterations=(2, 6), passes=2, tries=6)
"""Less time for a little less quality."""


def uniform(
    request: SynthesisRequest, watch: Watch | None = None, options: UniformOptions | None = None
) -> SynthesisResult:
    """Grow a texture that shows every part of the exemplar about equally often.

    Parameters
    ----------
    request
        What to grow; as for `tilefab.synthesis.self_tuning.self_tuning`.
    watch
        Told after each iteration, with a draft after each scale.
    options
        ``None``: the defaults, or `FAST` if the request asks for it.

    Returns
    -------
    SynthesisResult

    Raises
    ------
    ValueError
        If no whole patch of 10 x 10 valid pixels exists, or a repeating result has less than 20 pixels a side.
    """
    chosen = options or (FAST if request.fast else UniformOptions())
    return _Uniform(request, chosen, watch).run()


class _Uniform:
    def __init__(self, request: SynthesisRequest, options: UniformOptions, watch: Watch | None) -> None:
        self._request, self._options = request, options
        filled = fill_holes(request.exemplar, request.valid).astype(np.float32)
        self._scales = scales(features(filled, None, 0.0), request.valid, request.weights, request.feature_px)
        self._levels = Levels(request, self._scales, watch)
        self._key = rng.stream_key(request.seed, "uniform")
        least, most = options.iterations
        self._turns = [min(most, max(least, round(least * options.more**k))) for k in range(len(self._scales))]
        # A reversed search looks at every patch of the result about three times as often.
        self._works = [
            turns * scale.factor**2 * (0.5 if self._is_forward(k) else 3.0)
            for k, (turns, scale) in enumerate(zip(self._turns, self._scales, strict=True))
        ]
        self._usage: Usage | None = None
        self._prices = options.usage.for_contrast(self._scales[0].image, request.valid)

    def run(self) -> SynthesisResult:
        """From the coarsest scale to the finest."""
        return self._levels.run(self._grown, sum(self._works))

    def _grown(self) -> NDArray[np.int32]:
        levels, options = self._levels, self._options
        source = levels.beginning(None, self._request.seed)
        for index in range(levels.coarsest, -1, -1):
            stride_px = 2 if self._is_forward(index) and index < levels.coarsest else 1
            patches = levels.patches(index, stride_px, source)
            target = self._optimise(patches, index)
            if index == 0:
                source = patches.chosen(target, options.settling, options.seam_weight)
            else:
                source = patches.shown_at(self._scales[index - 1], levels.size(index - 1))
                levels.show(patches)
        return source

    def _optimise(self, patches: PatchField, index: int) -> NDArray[np.int16]:
        usage = self._usage = Usage(patches.scale.allowed, self._prices, self._usage)
        target, turns = patches.vote(), self._turns[index]
        for turn in range(turns):
            counter = (index * _TURNS_APART + turn) * _ROUNDS_APART
            for colour in (0, 1):
                prices = usage.prices(patches.places, raise_prices=colour == 0)
                patches.search(target, prices, NO_SHIFTS, colour, self._word(counter + colour), self._options.tries)
            if not self._is_forward(index):
                patches.places = self._assigned(patches, target, counter + 2)
            target = patches.vote()
            self._levels.advance(self._works[index] / turns, tell=turn < turns - 1)
        return target

    def _assigned(self, patches: PatchField, target: NDArray[np.int16], counter: int) -> NDArray[np.int32]:
        """Places given out by the exemplar's patches, round by round; where none came, those there were."""
        scale = patches.scale
        finder = _ReversedSearch(scale, patches, target, self._levels.workers, self._options)
        places = patches.places.copy()
        free = np.ones(places.shape, dtype=bool)
        rounds = 4 + math.ceil(4.0 * free.size / max(1, int(np.count_nonzero(scale.allowed))))
        for number in range(rounds):
            if np.count_nonzero(free) <= (1.0 - self._options.filled) * free.size:
                break
            begins, ends, differences = finder.find(free, self._word(counter + number))
            order = np.lexsort((begins, differences))[: _knee(np.sort(differences))]
            # Of several that found one place, the one that fits best is first.
            taken, firsts = np.unique(ends[order], return_index=True)
            rows, cols = np.divmod(taken, places.shape[1])
            places[rows, cols] = begins[order][firsts]
            free[rows, cols] = False
        return places

    def _word(self, counter: int) -> np.uint64:
        word, _ = rng.philox_4x32(self._key, np.uint64(counter), np.uint64(0))
        return np.uint64(word)

    def _is_forward(self, index: int) -> bool:
        return index < self._options.forward_scales and index < len(self._scales) - 1


class _ReversedSearch:
    """Finds, for every patch of the exemplar, the most similar patch of the result that is still free."""

    def __init__(
        self, scale: Scale, patches: PatchField, target: NDArray[np.int16], workers: Workers, options: UniformOptions
    ) -> None:
        self._scale, self._patches, self._target = scale, patches, target
        self._workers, self._options = workers, options
        rows, cols = (side - PATCH_PX + 1 for side in scale.allowed.shape)
        self._rows_px, self._cols_px = np.arange(rows, dtype=np.int64), np.arange(cols, dtype=np.int64)
        self._usable = scale.allowed[:rows, :cols]

    def find(
        self, free: NDArray[np.bool_], key: np.uint64
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """Where each usable patch begins in the exemplar, which of the field it found (flat), and how far it is."""
        image, cols = self._target, self._target.shape[1]
        may = np.zeros(image.shape[:2], dtype=bool)
        may[np.ix_(self._patches.rows_px, self._patches.cols_px)] = free
        begins = np.flatnonzero(may)
        shape = self._usable.shape
        random = np.random.Generator(np.random.Philox(key=int(key)))
        found = begins[random.integers(len(begins), size=shape)].astype(np.int32)
        nothing = np.zeros(may.size, dtype=np.int64)
        difference = np.zeros(shape, dtype=np.int64)
        exemplar = self._scale.image.reshape(-1)
        for _ in range(self._options.passes):
            for colour in (0, 1):
                before, after = found, found.copy()
                word = np.uint64(random.integers(1 << 63))

                def work(
                    begin: int, end: int, before: NDArray[np.int32] = before, after: NDArray[np.int32] = after,
                    colour: int = colour, word: np.uint64 = word,
                ) -> None:  # fmt: skip
                    search(
                        exemplar, self._scale.image.shape[1], self._rows_px, self._cols_px, (0, 0),
                        image.reshape(-1), cols, may.reshape(-1), nothing, nothing, 0,
                        NO_SHIFTS.starts, NO_SHIFTS.order, NO_SHIFTS.price, before, after, difference, colour,
                        begin, end, word, self._options.tries,
                    )  # fmt: skip

                self._workers.over(shape[0], work)
                found = after
        rows, columns = np.divmod(found[self._usable].astype(np.int64), cols)
        field_rows = np.searchsorted(self._patches.rows_px, rows)
        field_cols = np.searchsorted(self._patches.cols_px, columns)
        starts = np.flatnonzero(self._usable)
        start_rows, start_cols = np.divmod(starts, shape[1])
        return (
            start_rows * self._scale.image.shape[1] + start_cols,
            field_rows * free.shape[1] + field_cols,
            difference[self._usable],
        )


def _knee(differences: NDArray[np.int64]) -> int:
    """How many of ascending differences lie before they begin to rise steeply: farthest below the chord."""
    count = len(differences)
    if count < 3:
        return count
    rise = differences - differences[0]
    below = rise[-1] // count * np.arange(count) - rise
    knee = int(below.argmax()) + 1
    # At least half of them, or rounds would never end.
    return max(knee, (count + 1) // 2)
