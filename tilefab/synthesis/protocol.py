"""What every synthesis method takes and gives.

The result of every method is a map of places: for each pixel, which pixel of the exemplar it shows. So one result
serves layers of any depth and any number of channels, and every pixel of them is an exact copy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilefab.rng import SEED_LIMIT
from tilefab.types import Array, Mask, SizePx

LARGEST_SIDE_PX = 1 << 15
"""Longest side that a result can have."""


@dataclass(frozen=True, eq=False)
class SynthesisRequest:
    """What is to be grown.

    Attributes
    ----------
    exemplar
        (rows, cols, channels) float32: what is compared. Colours are CIELAB (D50); anything else is scaled like
        lightness, 0 to 100.
    valid
        (rows, cols), True where the exemplar may be used.
    size
        Of the result, 1 to 32,768 pixels a side.
    seed
        0 <= seed < 2**63.
    toroidal
        Whether the result repeats seamlessly in both directions.
    weights
        (rows, cols) uint8: 255 where no seam should pass, 0 where any may. ``None``: any may anywhere.
    feature_px
        Size of the largest thing that should stay whole, in pixels; ``None`` lets the method choose.
    threads
        Never changes the result. ``None``: one per processor.
    fast
        Less time for a little less quality, where a method has a faster way.

    Raises
    ------
    ValueError
        If a shape, a dtype or a number is none of these, no pixel is valid, or the exemplar isn't finite.
    """

    exemplar: NDArray[np.float32]
    valid: Mask
    size: SizePx
    seed: int
    toroidal: bool = True
    weights: NDArray[np.uint8] | None = None
    feature_px: int | None = None
    threads: int | None = None
    fast: bool = False

    def __post_init__(self) -> None:
        shape = self.exemplar.shape
        if len(shape) != 3 or shape[2] < 1 or self.exemplar.dtype != np.float32:
            raise ValueError(f"an exemplar is (rows, cols, channels) float32, not {shape} {self.exemplar.dtype}")
        if shape[0] * shape[1] > np.iinfo(np.int32).max:
            raise ValueError(f"an exemplar of {shape[1]} x {shape[0]} pixels has more than places can be counted for")
        if self.valid.shape != shape[:2] or self.valid.dtype != np.bool_:
            raise ValueError(f"the mask of an exemplar {shape} is bool of its size, not {self.valid.shape}")
        if not self.valid.any():
            raise ValueError("no pixel of the exemplar may be used")
        if not np.isfinite(self.exemplar).all():
            raise ValueError("the exemplar holds NaN or infinity")
        if self.weights is not None and (self.weights.shape != shape[:2] or self.weights.dtype != np.uint8):
            raise ValueError(f"the weights of an exemplar {shape} are uint8 of its size, not {self.weights.shape}")
        if not 1 <= min(self.size.rows, self.size.cols) <= max(self.size.rows, self.size.cols) <= LARGEST_SIDE_PX:
            raise ValueError(
                f"a result has 1 to {LARGEST_SIDE_PX:,} pixels a side, not {self.size.cols} x {self.size.rows}"
            )
        if not 0 <= self.seed < SEED_LIMIT:
            raise ValueError(f"seed {self.seed} is outside 0 .. 2**63 - 1")
        if self.feature_px is not None and self.feature_px < 1:
            raise ValueError(f"feature_px must be 1 or more, not {self.feature_px}")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads must be 1 or more, not {self.threads}")


@dataclass(frozen=True, eq=False)
class Step:
    """A moment of a synthesis, told to whoever watches.

    Attributes
    ----------
    share
        What is done, 0 to 1, in proportion to the time expected.
    draft
        Gives the map so far, at full size, as `SynthesisResult.source`; to be called before the watch returns, if at
        all. ``None`` where there is nothing new to be seen.
    """

    share: float
    draft: Callable[[], NDArray[np.int32]] | None = None


Watch = Callable[[Step], bool]
"""Called now and then by a method. True: go on. False: stop, and give what there is."""


@dataclass(frozen=True, eq=False)
class SynthesisResult:
    """A synthesised texture, as the places in the exemplar that its pixels come from.

    Attributes
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel: row * exemplar columns + column.
    complete
        False if it was stopped: then ``source`` is the last finished level, at full size.
    notes
        What the user should know, a sentence each.
    """

    source: NDArray[np.int32]
    complete: bool = True
    notes: tuple[str, ...] = ()


class SynthesisMethod(Protocol):
    """A method: the same request always gives the same result, with any number of threads."""

    def __call__(self, request: SynthesisRequest, watch: Watch | None = None) -> SynthesisResult:
        """Grow a texture.

        Raises
        ------
        ValueError
            If nothing can be grown of this exemplar; the message says why, without a full stop.
        """
        ...


def render(layer: Array, source: NDArray[np.int32]) -> Array:
    """A layer of the exemplar at the places of a map: exact copies of its pixels.

    Parameters
    ----------
    layer
        (rows, cols) or (rows, cols, channels), any dtype, of the exemplar's size: its colours, heights, gloss.
    source
        (result rows, result cols) int32, see `SynthesisResult`.

    Returns
    -------
    ndarray
        (result rows, result cols) or (result rows, result cols, channels), of the layer's dtype.

    Raises
    ------
    ValueError
        If a shape is none of these, or the map points outside the layer.

    Examples
    --------
    >>> render(np.array([[10, 20], [30, 40]]), np.array([[3, 0, 3]], dtype=np.int32))
    array([[40, 10, 40]])
    """
    if layer.ndim not in (2, 3) or source.ndim != 2:
        raise ValueError(f"a layer {layer.shape} or a map {source.shape} has no such shape")
    pixels = layer.shape[0] * layer.shape[1]
    if source.size and not (int(source.min()) >= 0 and int(source.max()) < pixels):
        raise ValueError(f"the map points outside a layer of {layer.shape[1]} x {layer.shape[0]} pixels")
    rendered: Array = layer.reshape(pixels, *layer.shape[2:])[source]
    return rendered
