"""The crop design: a lattice of cells, each showing one of many crops of the slab, joined along seams.

No part of the plane is fixed and none repeats. What a cell shows depends on the cells around it, but only on those
within a bounded reach, so any region can be had without any other (`tilefab.sampling.crop_choice`). Costs of joining
any two crops are tabulated when the map is built; seams are found while rendering, coarse to fine
(`tilefab.sampling.crop_seams`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilefab.sampling.texture_map import TextureMap
from tilefab.types import Array

STEPS_OF_ORDER = 4
"""The cells decide in four turns, those of one turn never touching; a sweep repeats all four."""

TYPICAL_COST = 2000
"""Median of the joining costs in a map: what prices and penalties are measured against."""

RATION_PERIOD = 5
"""Rationed crops may show in one of so many blocks of cells."""

RATION_PENALTY = 1 << 24
"""What a rationed crop costs where it may not show: more than all else together, yet not forbidden."""

BARRED = 1 << 28
"""Price of a crop that must not be shown."""

CONTINUING_COST = TYPICAL_COST // 4
"""Cost of a crop that goes on where its neighbour ends: less than a good seam, for there is none to see, but not
nothing, or the plane would show the slab as it is."""

_NEAR_WEIGHT = TYPICAL_COST // 2
_DIAGONAL_COST = 3 * TYPICAL_COST
_COLOUR_COSTS = 1 << 14
_COST_STEPS = 4


class ChoiceTables(NamedTuple):
    """What choosing crops needs, for kernels; see `CropMap`.

    ``side[a, b]``: cost of ``b`` to the right of ``a``, ``side_back`` its transpose; ``below[a, b]``: of ``b`` below
    ``a``, ``below_back`` its transpose; ``corner[a, b]``: of both showing in cells that touch at a corner;
    ``follows[a]``: the crops that continue ``a`` to the right, to the left, below and above, or -1; ``ration[p, a]``:
    cost of crop ``a`` in a block of turn ``p``.
    """

    side: NDArray[np.uint16]
    side_back: NDArray[np.uint16]
    below: NDArray[np.uint16]
    below_back: NDArray[np.uint16]
    corner: NDArray[np.uint16]
    follows: NDArray[np.int32]
    price: NDArray[np.int32]
    ration: NDArray[np.int32]
    rationed: bool
    candidates: int
    sweeps: int


class GuideLevels(NamedTuple):
    """The guide at every scale for kernels: flat pixels, and by level where they begin and how long a row is.

    ``cost`` turns a squared colour difference, in quarters of squared CIE76, into what a seam pays there.
    """

    pixels: NDArray[np.uint8]
    begin: NDArray[np.int64]
    cols: NDArray[np.int64]
    channels: int
    cost: NDArray[np.int64]


@dataclass(frozen=True, eq=False, kw_only=True)
class CropMap(TextureMap):
    """A texture map whose cells show crops chosen to join well.

    Attributes
    ----------
    guide
        (guide rows, guide cols, 3 or 4) uint8: the slab as seams see it, 2**guide_shift base pixels a pixel: L* in
        half units, a* and b* in half units + 128, and optionally a weight: a seam through a pixel of weight v costs
        1 + v / 16 times as much.
    guide_shift
        See ``guide``.
    crop_row, crop_col
        (crops,) int32: top left pixel of each crop in the base, multiples of 2**guide_shift.
    pitch_px
        Side of a cell.
    overlap_px
        How much wider than a cell a crop is; neighbours overlap by so much. Even, at most ``pitch_px``.
    seam_levels
        How many times the guide is halved for the first, coarsest search for a seam.
    side_cost, below_cost
        (crops, crops) uint16: what it costs to join the column's crop to the right of, or below, the row's.
    price
        (crops,) int32: added to a crop's cost, so that all parts of the slab are used about equally.
    ration
        (crops,) int8: -1, or which of `RATION_PERIOD` turns a crop with a striking feature has.
    candidates
        How many crops each choice tries, 1 .. crops.
    sweeps
        How many times all choices are gone over again.

    Raises
    ------
    ValueError
        If the parts don't fit together.

    Notes
    -----
    After Lefebvre and Hoppe 2005, "Parallel controllable texture synthesis", sections 3 and 4: bounded
    neighbourhoods and passes over sub-lattices make synthesis local and any window exact. They correct pixels; here
    whole crops are chosen, and Kwatra et al. 2003 ("Graphcut textures") join them.
    """

    design: ClassVar[str] = "crops"

    guide: NDArray[np.uint8]
    guide_shift: int
    crop_row: NDArray[np.int32]
    crop_col: NDArray[np.int32]
    pitch_px: int
    overlap_px: int
    seam_levels: int
    side_cost: NDArray[np.uint16]
    below_cost: NDArray[np.uint16]
    price: NDArray[np.int32]
    ration: NDArray[np.int8]
    candidates: int
    sweeps: int

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.crop_row)
        if n < 1 or {self.crop_col.shape, self.price.shape, self.ration.shape} != {(n,)}:
            raise ValueError("the tables of the crops differ in length")
        if self.side_cost.shape != (n, n) or self.below_cost.shape != (n, n):
            raise ValueError(f"joining costs must be ({n}, {n}), not {self.side_cost.shape}, {self.below_cost.shape}")
        if not 0 <= self.guide_shift < 16 or not 0 <= self.seam_levels < 16:
            raise ValueError(f"{self.guide_shift} and {self.seam_levels} halvings are out of range")
        quantum = 2 << (self.guide_shift + self.seam_levels)
        if not 0 < self.overlap_px <= self.pitch_px < 1 << 15 or self.overlap_px % quantum or self.pitch_px % quantum:
            raise ValueError(
                f"a pitch of {self.pitch_px} px with an overlap of {self.overlap_px} px isn't possible; both must be "
                f"multiples of {quantum}"
            )
        shape = tuple(-(-side // (1 << self.guide_shift)) for side in self.base.shape[:2])
        if self.guide.ndim != 3 or self.guide.shape[:2] != shape or self.guide.shape[2] not in (3, 4):
            raise ValueError(f"the guide must be {shape} with 3 or 4 channels, not {self.guide.shape}")
        for name, place, side in (("row", self.crop_row, shape[0]), ("col", self.crop_col, shape[1])):
            end = (place.astype(np.int64) + self.crop_px) >> self.guide_shift
            if int(place.min()) < 0 or int(end.max()) > side or (place % (1 << self.guide_shift)).any():
                raise ValueError(f"a crop refers to pixels outside the base: {name}s {place.min()} to {place.max()}")
        # Kernels trust every reference: a crop must lie in the base itself, not only in the rounded-up guide.
        over_row = int(self.crop_row.max()) + self.crop_px > self.base.shape[0]
        if over_row or int(self.crop_col.max()) + self.crop_px > self.base.shape[1]:
            raise ValueError("a crop refers to pixels outside the base")
        if not 1 <= self.candidates <= n or not 0 <= self.sweeps <= 8:
            raise ValueError(f"{self.candidates} candidates of {n} crops in {self.sweeps} sweeps is not possible")
        if int(self.ration.min()) < -1 or int(self.ration.max()) >= RATION_PERIOD:
            raise ValueError(f"rations must be -1 .. {RATION_PERIOD - 1}")
        if abs(self.price.astype(np.int64)).max() > BARRED:
            raise ValueError(f"a price is beyond ± {BARRED}")

    @property
    def cell_shape(self) -> tuple[int, int]:
        """Rows and columns of a cell of the plane."""
        return self.pitch_px, self.pitch_px

    @property
    def reach_cells(self) -> int:
        """How many cells beyond a region a choice can be that still decides what the region shows."""
        return STEPS_OF_ORDER * (self.sweeps + 1) + 1

    @property
    def crop_px(self) -> int:
        """Side of a crop."""
        return self.pitch_px + self.overlap_px

    @property
    def coarsest_level(self) -> int:
        """Most halvings at which the plane can be rendered by itself."""
        return self.guide_shift + self.seam_levels

    def parameters(self) -> dict[str, int]:
        """Numbers of the design, by name."""
        names = ("guide_shift", "pitch_px", "overlap_px", "seam_levels", "candidates", "sweeps")
        return {name: int(getattr(self, name)) for name in names}

    def design_arrays(self) -> dict[str, Array]:
        """Arrays of the design, by name."""
        names = ("guide", "crop_row", "crop_col", "side_cost", "below_cost", "price", "ration")
        return {name: getattr(self, name) for name in names}

    @classmethod
    def design_fields(cls, parameters: dict[str, int], arrays: dict[str, Array]) -> dict[str, object]:
        """What the constructor takes, from what `parameters` and `design_arrays` gave."""
        return {**parameters, **{name: array for name, array in arrays.items() if name != "base"}}

    @cached_property
    def choice_tables(self) -> ChoiceTables:
        """What choosing needs, for kernels."""
        near = overlap_penalty(self.crop_row, self.crop_col, self.pitch_px)
        follows = continuations(self.crop_row, self.crop_col, self.pitch_px)
        corner = near.copy()
        # Crops in a row may continue each other, and with them a vein; a square of four would be recognised.
        apart = [np.abs(place[:, None].astype(np.int64) - place) for place in (self.crop_row, self.crop_col)]
        corner[(apart[0] == self.pitch_px) & (apart[1] == self.pitch_px)] = _DIAGONAL_COST
        turns = np.arange(RATION_PERIOD)[:, None]
        ration = np.where((self.ration >= 0) & (self.ration != turns), RATION_PENALTY, 0).astype(np.int32)
        return ChoiceTables(
            _joined(self.side_cost, near),
            _joined(self.side_cost, near).T.copy(),
            _joined(self.below_cost, near),
            _joined(self.below_cost, near).T.copy(),
            corner,
            follows,
            np.ascontiguousarray(self.price),
            ration,
            bool((self.ration >= 0).any()),
            self.candidates,
            self.sweeps,
        )

    @cached_property
    def guide_levels(self) -> GuideLevels:
        """The guide at every scale that seams are searched at."""
        levels = [np.ascontiguousarray(self.guide)]
        for _ in range(self.seam_levels):
            levels.append(halved_guide(levels[-1]))
        sizes = np.array([level.size for level in levels], dtype=np.int64)
        return GuideLevels(
            np.concatenate([level.ravel() for level in levels]),
            np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64),
            np.array([level.shape[1] for level in levels], dtype=np.int64),
            self.guide.shape[2],
            seam_cost_table(),
        )

    @cached_property
    def _base_levels(self) -> dict[int, Array]:
        return {0: self.base}

    def base_level(self, level: int) -> Array:
        """The base after ``level`` halvings (means of 2 x 2 pixels, rounded), kept for the next call."""
        for step in range(1, level + 1):
            if step not in self._base_levels:
                self._base_levels[step] = halved(self._base_levels[step - 1])
        return self._base_levels[level]


def continuations(crop_row: NDArray[np.int32], crop_col: NDArray[np.int32], pitch_px: int) -> NDArray[np.int32]:
    """(crops, 4): the crop that continues each one to the right, to the left, below and above, or -1."""
    places = list(zip(crop_row.tolist(), crop_col.tolist(), strict=True))
    at = {place: k for k, place in enumerate(places)}
    steps = ((0, pitch_px), (0, -pitch_px), (pitch_px, 0), (-pitch_px, 0))
    return np.array(
        [[at.get((row + down, col + right), -1) for down, right in steps] for row, col in places], dtype=np.int32
    )


def overlap_penalty(crop_row: NDArray[np.int32], crop_col: NDArray[np.int32], pitch_px: int) -> NDArray[np.uint16]:
    """(crops, crops): what it costs that cells that touch show the same part of the slab, by its share of a cell."""

    def along(place: NDArray[np.int32]) -> NDArray[np.int64]:
        apart = np.abs(place[:, None].astype(np.int64) - place[None, :])
        shared: NDArray[np.int64] = np.maximum(pitch_px - apart, 0)
        return shared

    shared = along(crop_row) * along(crop_col)
    penalty: NDArray[np.uint16] = (shared * _NEAR_WEIGHT // pitch_px**2).astype(np.uint16)
    return penalty


def _joined(cost: NDArray[np.uint16], near: NDArray[np.uint16]) -> NDArray[np.uint16]:
    total: NDArray[np.uint16] = np.minimum(cost.astype(np.uint32) + near, np.iinfo(np.uint16).max).astype(np.uint16)
    return total


def seam_cost_table() -> NDArray[np.int64]:
    """What a seam pays at a pixel, by squared CIE76 difference.

    Its power 3/4, so that one strong step costs more than several weak ones, in `_COST_STEPS` to the unit; never 0,
    so that of equal seams the shortest wins.
    """
    squared = np.arange(_COLOUR_COSTS, dtype=np.float64)
    return 1 + np.rint(_COST_STEPS * squared**0.75).astype(np.int64)


def halved_guide(guide: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The guide at half the size: means of 2 x 2 pixels, but of weights the largest: what must not be cut stays so."""
    half = halved(guide)
    if guide.shape[2] == 4:
        rows, cols = half.shape[:2]
        weights = [guide[r : r + 2 * rows : 2, c : c + 2 * cols : 2, 3] for r in (0, 1) for c in (0, 1)]
        for part in weights:
            if part.shape == (rows, cols):
                np.maximum(half[..., 3], part, out=half[..., 3])
    return half


def halved(image: Array) -> Array:
    """Means of 2 x 2 pixels, rounded half up for integers; an odd last row or column is dropped.

    An image only one pixel wide or high stays so.
    """
    rows, cols = max(image.shape[0] // 2, 1), max(image.shape[1] // 2, 1)
    parts = [image[r : r + 2 * rows : 2, c : c + 2 * cols : 2] for r in (0, 1) for c in (0, 1)]
    parts = [part if part.shape[:2] == (rows, cols) else parts[0] for part in parts]
    out = np.empty((rows, cols, image.shape[2]), dtype=image.dtype)
    for top in range(0, rows, 256):
        strip = slice(top, top + 256)
        if image.dtype.kind in "ui":
            wide = np.dtype(np.uint32 if image.dtype.kind == "u" and image.dtype.itemsize <= 2 else np.int64)
            total: Array = np.full((), 2, dtype=wide)
            for part in parts:
                total = total + part[strip].astype(wide)
            out[strip] = total >> 2
        else:
            out[strip] = sum(part[strip] / 4 for part in parts)
    return out
