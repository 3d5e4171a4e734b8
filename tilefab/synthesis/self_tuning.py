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

import os
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.synthesis.edges import fill_holes
from tilefab.synthesis.guidance import guidance_channel
from tilefab.synthesis.lattice import Lattice, find_lattice
from tilefab.synthesis.layout import fit_note, initial_field
from tilefab.synthesis.patch_field import WEIGHT_UNIT, PatchField, Workers
from tilefab.synthesis.patch_kernels import CHANNELS, PATCH_PX
from tilefab.synthesis.protocol import Step, SynthesisRequest, SynthesisResult, Watch
from tilefab.synthesis.pyramid import STEPS_PER_UNIT, Scale, features, scaled_size, scales
from tilefab.synthesis.usage import NO_SHIFTS, Usage, UsageOptions
from tilefab.types import SizePx

_SMALLEST_PX = 2 * PATCH_PX
_HISTOGRAM_BINS = 32
_LEAST_SHARE = 0.001
_MOST_PASSES = 4
_MOST_ITERATIONS = 64


@dataclass(frozen=True)
class SelfTuningOptions:
    """Parameters of the method; all but ``guidance_weight`` are the same for every exemplar.

    Attributes
    ----------
    usage
        Prices of uneven use (3.2).
    guidance_weight
        Of the guidance channel; ``None`` finds it (3.1); 0 leaves the channel out.
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
    settling
        How often each pixel may join a neighbour's piece in the end.
    seam_weight
        Of seams against the mean of the votes, in the end.
    """

    usage: UsageOptions = field(default_factory=UsageOptions)
    guidance_weight: float | None = None
    iterations: tuple[int, int] = (4, 16)
    more: float = 1.6
    passes: tuple[int, int] = (2, 1)
    tries: tuple[int, int] = (16, 8)
    coarsest: int = 4
    stride_scales: int = 3
    histograms: bool = True
    smart_start: bool = True
    settling: int = 4
    seam_weight: int = 8


FAST = SelfTuningOptions(iterations=(2, 12), tries=(8, 4), more=1.5, settling=2)
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
    if request.toroidal and min(request.size.rows, request.size.cols) < _SMALLEST_PX:
        raise ValueError(
            f"a result that repeats needs {_SMALLEST_PX} pixels a side, not {request.size.cols} x {request.size.rows}"
        )
    workers = Workers(request.threads or os.cpu_count() or 1)
    try:
        return _Synthesis(request, chosen, watch, workers).run()
    finally:
        workers.close()


class _Synthesis:
    def __init__(
        self, request: SynthesisRequest, options: SelfTuningOptions, watch: Watch | None, workers: Workers
    ) -> None:
        self._request, self._options, self._watch, self._workers = request, options, watch, workers
        filled = fill_holes(request.exemplar, request.valid).astype(np.float32)
        channel, weight = None, 0.0
        if options.guidance_weight != 0.0:
            guidance = guidance_channel(request.exemplar, request.valid)
            channel = guidance.channel
            weight = guidance.weight if options.guidance_weight is None else options.guidance_weight
        self._lattice = find_lattice(request.exemplar, request.valid) if options.smart_start else None
        self._scales = scales(
            features(filled, channel, weight), request.valid, request.weights, request.feature_px
        )
        self._key = rng.stream_key(request.seed, "self-tuning")
        self._rounds = [self._iterations(index) for index in range(len(self._scales))]
        works = [
            rounds * self._passes(index) * scale.factor**2 / self._stride_px(index) ** 2
            for index, (rounds, scale) in enumerate(zip(self._rounds, self._scales, strict=True))
        ]
        self._shares = [work / sum(works) for work in works]

    def run(self) -> SynthesisResult:
        """From the coarsest scale to the finest."""
        notes = self._notes()
        size = self._request.size
        source, done = self._first(), 0.0
        finished = _draft_of(source, self._scales[-1], self._size(len(self._scales) - 1), self._scales[0], size)
        for index in reversed(range(len(self._scales))):
            scale = self._scales[index]
            patches = PatchField(
                scale, self._size(index), self._request.toroidal, self._stride_px(index), self._workers
            )
            patches.start_from(source)
            target = self._optimise(patches, index, done)
            if target is None:
                return SynthesisResult(finished, complete=False, notes=notes)
            done += self._shares[index]
            if index > 0:
                source = patches.shown_at(self._scales[index - 1], self._size(index - 1))
                finished = _cropped(patches.shown_at(self._scales[0], self._size(0)), size)
                if not self._tell(done, finished):
                    return SynthesisResult(finished, complete=False, notes=notes)
        chosen = patches.chosen(target, self._options.settling, self._options.seam_weight)
        finished = _cropped(chosen, size)
        self._tell(1.0, finished)
        return SynthesisResult(finished, notes=notes)

    def _optimise(self, patches: PatchField, index: int, done: float) -> NDArray[np.int16] | None:
        """The turns of one scale; the last mean, or ``None`` if whoever watches had enough."""
        options, scale = self._options, self._scales[index]
        coarse = self._is_coarse(index)
        usage = Usage(scale.allowed, options.usage)
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
                    key, _ = rng.philox_4x32(self._key, np.uint64(counter), np.uint64(0))
                    patches.search(target, prices, shifts, colour, np.uint64(key), tries)
            weights = ordinary
            if histograms is not None and turn < rounds - 1:
                weights = histograms.weights(target[: patches.size.rows, : patches.size.cols], ordinary)
            target = patches.vote(weights)
            if turn < rounds - 1 and not self._tell(done + self._shares[index] * (turn + 1) / rounds, None):
                return None
        return target

    def _first(self) -> NDArray[np.int32]:
        scale, size = self._scales[-1], self._size(len(self._scales) - 1)
        lattice = self._lattice
        if lattice is not None:
            sides = zip(scale.valid.shape, self._request.valid.shape, strict=True)
            down, across = (coarse / fine for coarse, fine in sides)
            lattice = lattice.scaled((down, across))
        colours = (scale.image / np.float32(STEPS_PER_UNIT)).astype(np.float32)
        return initial_field(colours, scale.valid, lattice, size, self._request.toroidal, self._request.seed)

    def _notes(self) -> tuple[str, ...]:
        note = fit_note(self._lattice, self._request.size) if self._lattice and self._request.toroidal else None
        return (note,) if note else ()

    def _size(self, index: int) -> SizePx:
        return scaled_size(self._request.size, self._scales[index].factor)

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

    def _tell(self, share: float, draft: NDArray[np.int32] | None) -> bool:
        if self._watch is None:
            return True
        return self._watch(Step(min(1.0, share), None if draft is None else lambda: draft))


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
        penalty = sum((excess[channel][self._bins[..., channel]] for channel in range(CHANNELS)), start=np.float64(0.0))
        base = np.full(self._bins.shape[:2], WEIGHT_UNIT, dtype=np.int64) if ordinary is None else ordinary
        return np.maximum(1, np.floor(base / (1.0 + penalty)).astype(np.int64))

    def _binned(self, image: NDArray[np.int16]) -> NDArray[np.int64]:
        bins = (image.astype(np.int64) - self._low) * _HISTOGRAM_BINS // self._range
        return np.clip(bins, 0, _HISTOGRAM_BINS - 1)

    def _shares(self, bins: NDArray[np.int64]) -> NDArray[np.float64]:
        counts = [np.bincount(bins[:, channel], minlength=_HISTOGRAM_BINS) for channel in range(CHANNELS)]
        return np.array(counts) / len(bins)


def _ordinary_weights(scale: Scale) -> NDArray[np.int64] | None:
    """Votes of what must stay whole count up to nine times."""
    if scale.weights is None:
        return None
    return np.asarray(WEIGHT_UNIT + 8 * WEIGHT_UNIT * scale.weights.astype(np.int64) // 255)


def _draft_of(
    source: NDArray[np.int32], coarse: Scale, coarse_size: SizePx, fine: Scale, size: SizePx
) -> NDArray[np.int32]:
    """The beginning at full size, for whoever stops before the first scale is done."""
    patches = PatchField(coarse, coarse_size, False, 1, Workers(1))
    patches.start_from(source)
    return _cropped(patches.shown_at(fine, scaled_size(size, 1.0)), size)


def _cropped(source: NDArray[np.int32], size: SizePx) -> NDArray[np.int32]:
    return np.ascontiguousarray(source[: size.rows, : size.cols])
