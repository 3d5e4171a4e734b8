"""Self-Tuning Texture Optimization (Kaspar, Neubert, Lischinski, Pauly and Kopf 2015).

Texture optimisation from coarse to fine with PatchMatch in CIELAB, and what tunes itself: a guidance channel (3.1), the
uniform use of the exemplar and the histograms of its channels (3.2), and a beginning that keeps a lattice if there is
one (3.3). The steps live in modules of their own: `pyramid`, `guidance`, `lattice`, `layout`, `usage`, `patch_field`.

What differs from the paper: prices of overused places add up over the iterations, shifts at which the result repeats
itself are priced too (see `usage`), coarse scales are given more iterations, fine scales a patch at every second pixel,
and the last vote shows one of the exemplar's own pixels instead of a mean, on the cheapest seams. So the result is a
map of places.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.synthesis.edges import fill_holes
from tilefab.synthesis.guidance import guidance_channel
from tilefab.synthesis.lattice import Lattice, find_lattice
from tilefab.synthesis.lattice_phase import in_step
from tilefab.synthesis.layout import fit_note
from tilefab.synthesis.levels import Levels
from tilefab.synthesis.patch_field import WEIGHT_UNIT, PatchField
from tilefab.synthesis.patch_kernels import CHANNELS
from tilefab.synthesis.protocol import SynthesisRequest, SynthesisResult, Watch
from tilefab.synthesis.pyramid import Scale, features, scales
from tilefab.synthesis.usage import NO_SHIFTS, Usage, UsageOptions
from tilefab.texture.spectrum import radial_psd_distance

_HISTOGRAM_BINS = 32
_LEAST_SHARE = 0.001
_MOST_PASSES = 4
_MOST_ITERATIONS = 64
_BEGUN_EXEMPLARS = 24
_SETTLING_OF_MARKS = 16
_MARKED = 15.0


@dataclass(frozen=True)
class SelfTuningOptions:
    """Parameters of the method; all but ``guidance_weight`` are the same for every exemplar.

    Attributes
    ----------
    usage
        Prices of uneven use (3.2).
    guidance_weight
        Of the guidance channel; ``None`` finds it (3.1), 1 or 3; 0 leaves the channel out. 2 served most textures.
    iterations
        At the finest scale, and at most at the coarsest; in between they grow by ``more`` a scale.
    more
        See ``iterations``.
    passes
        PatchMatch passes per iteration at the coarsest scales, and elsewhere.
    tries
        Random candidates per patch and pass at the coarsest scales, and elsewhere.
    coarsest
        How many scales count as the coarsest, for passes, tries and histograms of shifts.
    stride_scales
        How many of the finest scales have patches at every second pixel only.
    histograms
        Whether votes are weighted to keep the histograms in the coarser half of the scales (3.2).
    smart_start
        Whether a lattice is looked for (3.3).
    starts, start_scales
        How often to begin anew at most (less often for results of many exemplars), and after how many of the
        coarsest scales the beginning whose spectrum is nearest the exemplar's goes on. With a lattice: once.
    settling
        How often each pixel may join a neighbour's piece in the end.
    seam_weight
        Of seams against the mean of the votes, in the end.
    """

    usage: UsageOptions = field(default_factory=UsageOptions)
    guidance_weight: float | None = 2.0
    iterations: tuple[int, int] = (4, 10)
    more: float = 1.6
    passes: tuple[int, int] = (2, 1)
    tries: tuple[int, int] = (16, 8)
    coarsest: int = 4
    stride_scales: int = 3
    histograms: bool = True
    smart_start: bool = True
    starts: int = 4
    start_scales: int = 2
    settling: int = 6
    seam_weight: int = 8


FAST = SelfTuningOptions(iterations=(2, 6), tries=(5, 3), more=1.4, starts=1, settling=2)
"""Less time for a little less quality."""


def self_tuning(
    request: SynthesisRequest, watch: Watch | None = None, options: SelfTuningOptions | None = None
) -> SynthesisResult:
    """Grow a texture by self-tuning texture optimisation.

    Parameters
    ----------
    request
        What to grow. ``weights`` make votes of marked pixels count more and seams across them dearer; ``feature_px``
        is the size of a patch at the coarsest scale.
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
    chosen = options or (FAST if request.fast else SelfTuningOptions())
    return _Synthesis(request, chosen, watch).run()


@dataclass(frozen=True, eq=False)
class _State:
    """Where a synthesis has come to: what the scale before ``index`` starts from, and how good it is so far."""

    source: NDArray[np.int32]
    key: np.uint64
    index: int
    distance: float
    usage: Usage | None


class _Synthesis:
    def __init__(self, request: SynthesisRequest, options: SelfTuningOptions, watch: Watch | None) -> None:
        self._request, self._options = request, options
        filled = fill_holes(request.exemplar, request.valid).astype(np.float32)
        channel, weight = None, 0.0
        if options.guidance_weight != 0.0:
            guidance = guidance_channel(request.exemplar, request.valid)
            channel = guidance.channel
            weight = guidance.weight if options.guidance_weight is None else options.guidance_weight
        if channel is not None and request.weights is not None:
            # What is marked is told from the rest, as labels are: so it keeps its outline.
            channel = channel + request.weights.astype(np.float32) * np.float32(_MARKED / 255)
        self._lattice = find_lattice(request.exemplar, request.valid) if options.smart_start else None
        self._scales = scales(features(filled, channel, weight), request.valid, request.weights, request.feature_px)
        self._levels = Levels(request, self._scales, watch)
        self._rounds = [self._iterations(index) for index in range(len(self._scales))]
        self._start_scales = min(options.start_scales, len(self._scales) - 1)
        self._starts = self._beginnings() if self._lattice is None and self._start_scales > 0 else 1
        self._works = [
            rounds * self._passes(index) * (4 + options.tries[0 if self._is_coarse(index) else 1])
            * (scale.factor / self._stride_px(index)) ** 2
            for index, (rounds, scale) in enumerate(zip(self._rounds, self._scales, strict=True))
        ]  # fmt: skip
        # An exemplar of a few patches can't be used evenly: its middle is in most of them.
        prices = options.usage.for_contrast(self._scales[0].image, request.valid)
        self._prices = replace(prices, barrier=0.0) if len(self._scales) == 1 else prices

    def run(self) -> SynthesisResult:
        """From the coarsest scale to the finest."""
        again = self._works[len(self._scales) - self._start_scales :]
        return self._levels.run(self._grown, sum(self._works) + (self._starts - 1) * sum(again), self._notes())

    def _grown(self) -> NDArray[np.int32]:
        state = self._begin(0)
        for start in range(1, self._starts):
            other = self._begin(start)
            if other.distance < state.distance:
                state = other
        while state.index > 0:
            state = self._next(state)
        return state.source

    def _beginnings(self) -> int:
        # The larger the result, the less one beginning differs from another.
        size = self._request.size
        exemplars = size.rows * size.cols / int(np.count_nonzero(self._request.valid))
        return max(1, min(self._options.starts, round(_BEGUN_EXEMPLARS / max(exemplars, 1.0))))

    def _begin(self, start: int) -> _State:
        """The coarsest scales, from a beginning of their own."""
        seed = int(rng.stream_key(self._request.seed, f"beginning {start}")) >> 1
        lattice = None if self._lattice is None else self._lattice_at(self._scales[-1])
        source = self._levels.beginning(lattice, seed)
        state = _State(source, rng.stream_key(seed, "self-tuning"), len(self._scales), 0.0, None)
        for _ in range(self._start_scales):
            state = self._next(state)
        return state

    def _next(self, state: _State) -> _State:
        """One scale further: optimised, and laid out for the one after."""
        index, options, levels = state.index - 1, self._options, self._levels
        scale, size = self._scales[index], levels.size(index)
        patches = levels.patches(index, self._stride_px(index), state.source)
        usage = Usage(scale.allowed, self._prices, state.usage)
        target = self._optimise(patches, index, state.key, usage)
        distance = 0.0
        if self._starts > 1 and len(self._scales) - index == self._start_scales:
            distance = _spectral_distance(scale, target[: size.rows, : size.cols])
        if index == 0:
            source = patches.chosen(target, self._settling(), options.seam_weight)
        else:
            source = self._laid_out(patches, index - 1)
            levels.show(patches)
        return _State(source, state.key, index, distance, usage)

    def _optimise(self, patches: PatchField, index: int, stream: np.uint64, usage: Usage) -> NDArray[np.int16]:
        """The turns of one scale; the last mean."""
        options, scale = self._options, self._scales[index]
        coarse = self._is_coarse(index)
        ordinary = _ordinary_weights(scale)
        histograms = None
        if options.histograms and index >= len(self._scales) / 2:
            histograms = _Histograms(scale)
        target = patches.vote(ordinary)
        rounds, passes, tries = self._rounds[index], self._passes(index), options.tries[0 if coarse else 1]
        # Where a lattice says at which shifts the exemplar repeats, the result should too.
        shifting = coarse and self._lattice is None and options.usage.again > 0
        for turn in range(rounds):
            for number in range(passes):
                shifts = usage.shifts(patches.places) if shifting else NO_SHIFTS
                for colour in (0, 1):
                    prices = usage.prices(patches.places, raise_prices=colour == 0)
                    counter = ((index * _MOST_ITERATIONS + turn) * _MOST_PASSES + number) * 2 + colour
                    key, _ = rng.philox_4x32(stream, np.uint64(counter), np.uint64(0))
                    patches.search(target, prices, shifts, colour, np.uint64(key), tries)
            weights = ordinary
            if histograms is not None and turn < rounds - 1:
                weights = histograms.weights(target[: patches.size.rows, : patches.size.cols], ordinary)
            target = patches.vote(weights)
            self._levels.advance(self._works[index] / rounds, tell=turn < rounds - 1)
        return target

    def _laid_out(self, patches: PatchField, index: int) -> NDArray[np.int32]:
        """What the patches show at a finer scale; with a lattice, in step with it again, which a coarse pixel isn't."""
        scale, size = self._scales[index], self._levels.size(index)
        source = patches.shown_at(scale, size)
        if self._lattice is None:
            return source
        return in_step(source, scale.valid, self._lattice_at(scale), size, toroidal=self._request.toroidal)

    def _lattice_at(self, scale: Scale) -> Lattice:
        assert self._lattice is not None
        sides = zip(scale.valid.shape, self._request.valid.shape, strict=True)
        down, across = (coarse / fine for coarse, fine in sides)
        return self._lattice.scaled((down, across))

    def _notes(self) -> tuple[str, ...]:
        note = fit_note(self._lattice, self._request.size) if self._lattice and self._request.toroidal else None
        return (note,) if note else ()

    def _is_coarse(self, index: int) -> bool:
        return len(self._scales) - 1 - index < self._options.coarsest

    def _stride_px(self, index: int) -> int:
        # The one scale of a small exemplar is searched whole.
        return 2 if index < self._options.stride_scales and index < len(self._scales) - 1 else 1

    def _passes(self, index: int) -> int:
        return self._options.passes[0 if self._is_coarse(index) else 1]

    def _iterations(self, index: int) -> int:
        least, most = self._options.iterations
        return min(most, max(least, round(least * self._options.more**index)))

    def _settling(self) -> int:
        # Seams that are to go farther, out of what is marked, take longer.
        return self._options.settling if self._request.weights is None else _SETTLING_OF_MARKS


class _Histograms:
    """Weights of votes that bring the result's histograms nearer to the exemplar's (Kopf et al. 2007)."""

    def __init__(self, scale: Scale) -> None:
        image = scale.image[scale.valid]
        self._low = image.min(axis=0).astype(np.int64)
        self._range = image.max(axis=0).astype(np.int64) - self._low + 1
        self._bins = self._binned(scale.image)
        self._wanted = self._shares(self._binned(image))

    def weights(self, target: NDArray[np.int16], ordinary: NDArray[np.int64] | None) -> NDArray[np.int64]:
        """Weight of each pixel of the exemplar, less where the result has too many of its colour."""
        excess = np.maximum(self._shares(self._binned(target.reshape(-1, CHANNELS))) - self._wanted, 0.0)
        excess /= np.maximum(self._wanted, _LEAST_SHARE)
        penalty = np.sum([excess[channel][self._bins[..., channel]] for channel in range(CHANNELS)], axis=0)
        base = np.full(self._bins.shape[:2], WEIGHT_UNIT, dtype=np.int64) if ordinary is None else ordinary
        return np.asarray(np.maximum(1, np.floor(base / (1.0 + penalty)).astype(np.int64)))

    def _binned(self, image: NDArray[np.int16]) -> NDArray[np.int64]:
        bins = (image.astype(np.int64) - self._low) * _HISTOGRAM_BINS // self._range
        return np.asarray(np.clip(bins, 0, _HISTOGRAM_BINS - 1))

    def _shares(self, bins: NDArray[np.int64]) -> NDArray[np.float64]:
        counts = [np.bincount(bins[:, channel], minlength=_HISTOGRAM_BINS) for channel in range(CHANNELS)]
        return np.array(counts) / len(bins)


def _ordinary_weights(scale: Scale) -> NDArray[np.int64] | None:
    """Votes of what must stay whole count up to 17 times."""
    if scale.weights is None:
        return None
    return np.asarray(WEIGHT_UNIT + 16 * WEIGHT_UNIT * scale.weights.astype(np.int64) // 255)


def _spectral_distance(scale: Scale, target: NDArray[np.int16]) -> float:
    """How far the colours' spectra are from the exemplar's, in thousandths: rounding must not choose."""
    colours = range(CHANNELS - 1)
    spreads = [float(scale.image[..., channel].std()) ** 2 for channel in colours]
    distances = [
        radial_psd_distance(scale.image[..., channel].astype(np.float64), target[..., channel].astype(np.float64))
        for channel in colours
    ]
    total = sum(spread * distance for spread, distance in zip(spreads, distances, strict=True))
    return round(total / max(sum(spreads), 1.0), 3)
