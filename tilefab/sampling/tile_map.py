"""The thesis's own design: a repeatable tile with interchangeable patches (first seed, chapter 5)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilefab.sampling.texture_map import TextureMap
from tilefab.types import Array, Mask


@dataclass(frozen=True, eq=False)
class Patches:
    """Interchangeable patches, those of set A first, then those of set B.

    A patch is a mask, kept as row runs, with the place of its bounding box in a cell of the plane and in the base.

    Attributes
    ----------
    count_a
        How many patches belong to set A; the others belong to B.
    cell_row, cell_col
        (patches,) int32, top left corner of the bounding box, relative to the cell's; may be negative.
    base_row, base_col
        (patches,) int32, top left corner of the bounding box in the base.
    rows, cols
        (patches,) int32, size of the bounding box.
    run_offset
        (patches + 1,) int64, where each patch's runs begin in ``runs``.
    runs
        (runs, 3) int32: row and first column within the bounding box, and length; in reading order.
    overlaps
        (patches, patches) bool, True where two patches of the same set overlap in their cell. Patches of different
        sets never do.
    worst_delta_e, mean_delta_e
        (patches,) float32, CIE76 difference between patch and tile along the cut: largest and mean.
    """

    count_a: int
    cell_row: NDArray[np.int32]
    cell_col: NDArray[np.int32]
    base_row: NDArray[np.int32]
    base_col: NDArray[np.int32]
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    run_offset: NDArray[np.int64]
    runs: NDArray[np.int32]
    overlaps: Mask
    worst_delta_e: NDArray[np.float32]
    mean_delta_e: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.cell_row)

    def mask(self, index: int) -> Mask:
        """Mask of one patch, (rows, cols) of its bounding box."""
        mask = np.zeros((int(self.rows[index]), int(self.cols[index])), dtype=bool)
        for row, col, length in self.runs[self.run_offset[index] : self.run_offset[index + 1]]:
            mask[row, col : col + length] = True
        return mask

    @property
    def area_px(self) -> NDArray[np.int64]:
        """(patches,) number of pixels of each patch."""
        total = np.concatenate([[0], np.cumsum(self.runs[:, 2], dtype=np.int64)])
        area: NDArray[np.int64] = total[self.run_offset[1:]] - total[self.run_offset[:-1]]
        return area


class PatchTables(NamedTuple):
    """What kernels need of the patches, in a form that they take as one argument; see `Patches`."""

    count_a: int
    cell_row: NDArray[np.int32]
    cell_col: NDArray[np.int32]
    base_row: NDArray[np.int32]
    base_col: NDArray[np.int32]
    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    run_offset: NDArray[np.int64]
    runs: NDArray[np.int32]
    overlaps: Mask
    threshold: np.uint64


@dataclass(frozen=True, eq=False, kw_only=True)
class TileMap(TextureMap):
    """A texture map whose plane repeats one tile, with interchangeable patches over it.

    Attributes
    ----------
    tile_source
        (tile rows, tile cols) int32: flat index into the base of each pixel of the repeatable tile.
    patches
        The interchangeable patches.
    activation_threshold
        A patch is active in a cell where its 32-bit hash is below this; 0 .. 2**32 - 1.

    Raises
    ------
    ValueError
        If the parts don't fit together.
    """

    design: ClassVar[str] = "tile"

    tile_source: NDArray[np.int32]
    patches: Patches
    activation_threshold: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tile_source.ndim != 2 or min(self.tile_source.shape) < 1:
            raise ValueError(f"tile must be (rows, cols), not {self.tile_source.shape}")
        size = self.base.shape[0] * self.base.shape[1]
        if int(self.tile_source.min()) < 0 or int(self.tile_source.max()) >= size:
            raise ValueError("the tile refers to pixels outside the base")
        if not 0 <= self.activation_threshold < 1 << 32:
            raise ValueError(f"activation threshold {self.activation_threshold} is not a 32-bit number")
        self._check_patches()

    def _check_patches(self) -> None:
        p = self.patches
        n = len(p)
        columns = (p.cell_col, p.base_row, p.base_col, p.rows, p.cols, p.worst_delta_e, p.mean_delta_e)
        lengths = {len(x) for x in columns}
        if lengths - {n} or len(p.run_offset) != n + 1 or p.overlaps.shape != (n, n) or not 0 <= p.count_a <= n:
            raise ValueError("the tables of the patches differ in length")
        if int(p.run_offset[0]) != 0 or int(p.run_offset[-1]) != len(p.runs) or (np.diff(p.run_offset) < 1).any():
            raise ValueError("the run table of the patches is out of order")
        if n == 0:
            return
        outside = (p.base_row < 0) | (p.base_col < 0)
        outside |= (p.base_row + p.rows > self.base.shape[0]) | (p.base_col + p.cols > self.base.shape[1])
        of_patch = np.repeat(np.arange(n), np.diff(p.run_offset))
        row, col, length = p.runs.T.astype(np.int64)
        bad_run = (row < 0) | (col < 0) | (length < 1)
        bad_run |= (row >= p.rows[of_patch]) | (col + length > p.cols[of_patch])
        if outside.any() or bad_run.any():
            raise ValueError("a patch refers to pixels outside the base")
        follows = (row[1:] > row[:-1]) | ((row[1:] == row[:-1]) & (col[1:] >= col[:-1] + length[:-1]))
        if not (follows | (of_patch[1:] != of_patch[:-1])).all():
            raise ValueError("the runs of a patch are not in reading order")

    @property
    def tile_shape(self) -> tuple[int, int]:
        """Rows and columns of the repeatable tile, which is also a cell of the plane."""
        return self.tile_source.shape[0], self.tile_source.shape[1]

    @cached_property
    def tile(self) -> Array:
        """(tile rows, tile cols, channels) pixels of the repeatable tile."""
        flat = self.base.reshape(-1, self.base.shape[2])
        tile = np.ascontiguousarray(flat[self.tile_source])
        tile.flags.writeable = False
        return tile

    @cached_property
    def patch_tables(self) -> PatchTables:
        """The patches, and the threshold below which they are active, for kernels."""
        p = self.patches
        return PatchTables(
            p.count_a,
            p.cell_row,
            p.cell_col,
            p.base_row,
            p.base_col,
            p.rows,
            p.cols,
            p.run_offset,
            p.runs,
            p.overlaps,
            np.uint64(self.activation_threshold),
        )

    @property
    def cell_shape(self) -> tuple[int, int]:
        """Rows and columns of a cell of the plane: the tile's."""
        return self.tile_shape

    @property
    def reach_cells(self) -> int:
        """How many cells from its own a decision can change pixels, beyond those of a region: none."""
        return 0

    def parameters(self) -> dict[str, int]:
        """Numbers of the design, by name."""
        return {"activation_threshold": int(self.activation_threshold), "count_a": int(self.patches.count_a)}

    def design_arrays(self) -> dict[str, Array]:
        """Arrays of the design, by name."""
        of_patches = {
            f"patch_{f.name}": getattr(self.patches, f.name) for f in fields(self.patches) if f.name != "count_a"
        }
        return {"tile_source": self.tile_source, **of_patches}

    @classmethod
    def design_fields(cls, parameters: dict[str, int], arrays: dict[str, Array]) -> dict[str, object]:
        """What the constructor takes, from what `parameters` and `design_arrays` gave."""
        of_patches = {name.removeprefix("patch_"): a for name, a in arrays.items() if name.startswith("patch_")}
        return {
            "tile_source": arrays["tile_source"],
            "patches": Patches(count_a=int(parameters["count_a"]), **of_patches),
            "activation_threshold": int(parameters["activation_threshold"]),
        }
