"""What methods from coarse scales to fine ones have in common: sizes, beginning, progress, drafts, stopping."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tilefab.synthesis.lattice import Lattice
from tilefab.synthesis.layout import initial_field
from tilefab.synthesis.patch_field import PatchField, Workers
from tilefab.synthesis.patch_kernels import PATCH_PX
from tilefab.synthesis.protocol import Step, SynthesisRequest, SynthesisResult, Watch
from tilefab.synthesis.pyramid import STEPS_PER_UNIT, Scale, scaled_size
from tilefab.types import SizePx

_SMALLEST_PX = 2 * PATCH_PX


class _StoppedError(Exception):
    """Whoever watches had enough."""


class Levels:
    """A synthesis from the coarsest scale to the finest, as whoever watches sees it.

    Parameters
    ----------
    request
        What to grow.
    scales
        Of its exemplar, the finest first.
    watch
        Told of what is done, and asked whether to go on.

    Raises
    ------
    ValueError
        If a result that repeats has less than 20 pixels a side.
    """

    def __init__(self, request: SynthesisRequest, scales: Sequence[Scale], watch: Watch | None) -> None:
        size = request.size
        if request.toroidal and min(size.rows, size.cols) < _SMALLEST_PX:
            raise ValueError(f"a result that repeats needs {_SMALLEST_PX} pixels a side, not {size.cols} x {size.rows}")
        self.scales = scales
        self._request, self._watch = request, watch
        self._workers = Workers(request.threads or os.cpu_count() or 1)
        self._done, self._all_work = 0.0, 1.0
        self._draft: Callable[[], NDArray[np.int32]] | None = None

    @property
    def coarsest(self) -> int:
        """Index of the coarsest scale."""
        return len(self.scales) - 1

    @property
    def workers(self) -> Workers:
        """Threads for whatever is worked on by rows."""
        return self._workers

    def size(self, index: int) -> SizePx:
        """Of the result at a scale; at the finest, no smaller than two patches."""
        return scaled_size(self._request.size, self.scales[index].factor)

    def run(
        self, grow: Callable[[], NDArray[np.int32]], all_work: float, notes: tuple[str, ...] = ()
    ) -> SynthesisResult:
        """Grow, until it is done or whoever watches has enough.

        Parameters
        ----------
        grow
            Gives the map of the finest scale, telling of its work by `advance` and `show`.
        all_work
            What it will have told of in the end, in any unit.
        notes
            For the user.
        """
        self._all_work = all_work
        try:
            source = self._cropped(grow())
        except _StoppedError:
            assert self._draft is not None
            return SynthesisResult(self._draft(), complete=False, notes=notes)
        finally:
            self._workers.close()
        self._done = all_work
        # All is done: there is nothing left to stop.
        self._tell(lambda: source)
        return SynthesisResult(source, notes=notes)

    def beginning(self, lattice: Lattice | None, seed: int) -> NDArray[np.int32]:
        """A map of the coarsest scale to start from, along a lattice if there is one."""
        scale = self.scales[-1]
        colours = (scale.image / np.float32(STEPS_PER_UNIT)).astype(np.float32)
        return initial_field(colours, scale.valid, lattice, self.size(self.coarsest), self._request.toroidal, seed)

    def patches(self, index: int, stride_px: int, source: NDArray[np.int32]) -> PatchField:
        """The patches of a scale, as a map of that scale shows them."""
        patches = PatchField(self.scales[index], self.size(index), self._request.toroidal, stride_px, self._workers)
        patches.start_from(source)
        if self._draft is None:
            # For whoever stops before the first scale is done.
            self._draft = self._drawn_later(patches)
        return patches

    def advance(self, work: float, *, tell: bool = True) -> None:
        """So much more is done. Ends the run if whoever watches says so."""
        self._done += work
        if tell:
            self._tell(None)

    def show(self, patches: PatchField) -> None:
        """A scale is done: from now on this is what a stopped run gives."""
        # Drawn only if somebody asks: at full size it costs as much as a turn of a fine scale.
        self._draft = self._drawn_later(patches)
        self._tell(self._draft)

    def _drawn_later(self, patches: PatchField) -> Callable[[], NDArray[np.int32]]:
        return lambda: self._cropped(patches.shown_at(self.scales[0], self.size(0)))

    def _tell(self, draft: Callable[[], NDArray[np.int32]] | None) -> None:
        if self._watch is None:
            return
        share = min(1.0, self._done / self._all_work)
        goes_on = self._watch(Step(share, draft))
        if not goes_on and (draft is None or share < 1.0):
            raise _StoppedError

    def _cropped(self, source: NDArray[np.int32]) -> NDArray[np.int32]:
        return np.ascontiguousarray(source[: self._request.size.rows, : self._request.size.cols])
