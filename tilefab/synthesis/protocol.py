"""What every synthesis method takes and gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilefab.synthesis.quilting import quilt_torus
from tilefab.types import Mask, SizePx

Progress = Callable[[float], None]


@dataclass(frozen=True)
class SynthesisRequest:
    """What is to be grown.

    Attributes
    ----------
    exemplar_lab_d50
        (rows, cols, 3) float32 CIELAB (D50).
    valid
        (rows, cols), True where the exemplar may be used.
    size
        Size of the result; it repeats seamlessly in both directions.
    seed
        0 <= seed < 2**63.
    feature_px
        Size of the largest thing that should stay whole, in pixels; ``None`` lets the method choose.
    """

    exemplar_lab_d50: NDArray[np.float32]
    valid: Mask
    size: SizePx
    seed: int
    feature_px: int | None = None


@dataclass(frozen=True)
class SynthesisResult:
    """A synthesised tile, as the places in the exemplar its pixels come from.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar: row * exemplar columns + column.
    worst_seam_delta_e, mean_seam_delta_e
        Colour jump (CIE76) across the seams between pieces.
    """

    source: NDArray[np.int32]
    worst_seam_delta_e: float
    mean_seam_delta_e: float


class SynthesisMethod(Protocol):
    """A method: the same request always gives the same result, with any number of threads."""

    def __call__(self, request: SynthesisRequest, progress: Progress | None = None) -> SynthesisResult:
        """Grow a tile; ``progress`` is called with the share done, 0 to 1."""
        ...


def _quilting(request: SynthesisRequest, progress: Progress | None = None) -> SynthesisResult:
    quilt = quilt_torus(
        request.exemplar_lab_d50,
        request.valid,
        request.size,
        request.seed,
        block_px=request.feature_px,
        progress=progress,
    )
    return SynthesisResult(quilt.source, quilt.worst_seam_delta_e, quilt.mean_seam_delta_e)


METHODS: Mapping[str, SynthesisMethod] = {"quilting": _quilting}
"""Every synthesis method by the name used in job files."""
