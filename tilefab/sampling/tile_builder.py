"""Building a texture map from a slab and a repeatable tile (first seed, 5.5.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.sampling.biclique import overlap_matrix, pseudo_biclique
from tilefab.sampling.candidates import Candidate, CandidateFinder, largest_valid_square, patch_radii
from tilefab.sampling.texture_map import SlabArea
from tilefab.sampling.tile_map import Patches, TileMap
from tilefab.texture.matching import matching_image
from tilefab.types import Array, Mask

_CANDIDATES_PER_PATCH = 1.7
_CUTS_PER_CANDIDATE = 1.8


@dataclass(frozen=True)
class TileOptions:
    """How a map is built.

    Attributes
    ----------
    patches
        How many interchangeable patches to aim for, both sets together; the first seed uses 600.
    active_per_cell
        How many patches a cell activates on average before overlaps are resolved. The first seed uses 10, of which
        few large ones remain; with 40 half as much of the tile stays the same in most cells.
    seed
        Job seed.
    threads
        For the cuts; doesn't change the result. ``None``: one per processor.
    """

    patches: int = 600
    active_per_cell: float = 40.0
    seed: int = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        if self.patches < 0 or not self.active_per_cell >= 0:
            raise ValueError(f"{self.patches} patches, {self.active_per_cell} active a cell: neither can be negative")
        if self.threads is not None and self.threads < 1:
            raise ValueError(f"threads must be at least 1, not {self.threads}")


def build_tile_map(
    base_lab_d50: NDArray[np.float32],
    valid: Mask,
    tile_source: NDArray[np.int32],
    options: TileOptions,
    *,
    stored: Array,
    space: str,
    channels: tuple[str, ...],
    dpi: float,
    slabs: tuple[SlabArea, ...] = (),
    provenance: dict[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> TileMap:
    """Build a texture map.

    Parameters
    ----------
    base_lab_d50
        (rows, cols, 3) float32 CIELAB (D50) of the slab: what cuts are judged by.
    valid
        (rows, cols), True where the slab may be used.
    tile_source
        (tile rows, tile cols) int32 flat index into the base: the repeatable tile, from any synthesis method.
    options
        How to build.
    stored
        (rows, cols, channels): the image the map keeps and renders from, in ``space``.
    space, channels, dpi, slabs, provenance
        See `TileMap`.
    progress
        Called with the share done, 0 to 1.

    Returns
    -------
    TileMap
        Without patches if no cut is possible, so that it renders the bare tile; the caller may want to warn.

    Raises
    ------
    ValueError
        If the images or the mask differ in size.
    """
    if not base_lab_d50.shape[:2] == valid.shape == stored.shape[:2]:
        raise ValueError(f"base {base_lab_d50.shape}, valid {valid.shape} and stored {stored.shape} differ in size")
    base = matching_image(base_lab_d50)
    finder = CandidateFinder(base, valid, tile_source, options.seed)
    radii = patch_radii((tile_source.shape[0], tile_source.shape[1]), largest_valid_square(valid))
    candidates: list[Candidate] = []
    if radii and options.patches >= 2:
        keep = int(np.ceil(options.patches * _CANDIDATES_PER_PATCH / len(radii)))
        cuts = int(np.ceil(keep * _CUTS_PER_CANDIDATE))
        counter = _Counter(len(radii) * cuts, progress)
        for radius_px in radii:
            found = finder.find(radius_px, cuts, threads=options.threads, progress=counter)
            # Each size has its share of the patches: judged together, small ones would crowd out large ones.
            order = sorted(range(len(found)), key=lambda k: (found[k].worst_delta_e, k))
            candidates += [found[k] for k in sorted(order[:keep])]
    patches, count = _divide(candidates, (tile_source.shape[0], tile_source.shape[1]), options)
    share = min(1.0, 2.0 * options.active_per_cell / max(count, 1))
    return TileMap(
        base=np.ascontiguousarray(stored),
        tile_source=np.ascontiguousarray(tile_source, dtype=np.int32),
        patches=patches,
        activation_threshold=min(int(share * (1 << 32)), (1 << 32) - 1),
        space=space,
        channels=channels,
        dpi=dpi,
        slabs=slabs,
        provenance=dict(provenance or {}),
    )


class _Counter:
    """Turns finished cuts, reported from several threads, into the share done."""

    def __init__(self, total: int, progress: Callable[[float], None] | None) -> None:
        self._total, self._done, self._progress = max(total, 1), 0, progress

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(min(1.0, self._done / self._total))


def _divide(candidates: list[Candidate], tile_shape: tuple[int, int], options: TileOptions) -> tuple[Patches, int]:
    table = _table(candidates, 0, np.zeros((len(candidates), len(candidates)), dtype=bool))
    geometry = (
        table.cell_row.astype(np.int64),
        table.cell_col.astype(np.int64),
        table.rows.astype(np.int64),
        table.cols.astype(np.int64),
        table.run_offset,
        table.runs,
    )
    compatible = np.ones((len(candidates), len(candidates)), dtype=bool)
    for row_shift, col_shift in (
        (tile_shape[0], 0),
        (-tile_shape[0], 0),
        (0, tile_shape[1]),
        (0, -tile_shape[1]),
    ):
        compatible &= ~overlap_matrix(*geometry, row_shift, col_shift)
    np.fill_diagonal(compatible, False)
    random = rng.generator(options.seed, "pseudo-biclique")
    in_a, in_b = pseudo_biclique(compatible, options.patches, random)
    chosen = np.concatenate([in_a, in_b])
    same_cell = overlap_matrix(*geometry, 0, 0)[np.ix_(chosen, chosen)]
    np.fill_diagonal(same_cell, False)
    same_cell[: len(in_a), len(in_a) :] = False
    same_cell[len(in_a) :, : len(in_a)] = False
    return _table([candidates[k] for k in chosen], len(in_a), same_cell), len(chosen)


def _table(candidates: list[Candidate], count_a: int, overlaps: Mask) -> Patches:
    runs = [_runs(c.mask) for c in candidates]
    counts = np.array([len(r) for r in runs], dtype=np.int64)

    def column(name: str, dtype: type) -> NDArray[np.int32]:
        return np.array([getattr(c, name) for c in candidates], dtype=dtype)

    return Patches(
        count_a=count_a,
        cell_row=column("cell_row", np.int32),
        cell_col=column("cell_col", np.int32),
        base_row=column("base_row", np.int32),
        base_col=column("base_col", np.int32),
        rows=np.array([c.mask.shape[0] for c in candidates], dtype=np.int32),
        cols=np.array([c.mask.shape[1] for c in candidates], dtype=np.int32),
        run_offset=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        runs=np.concatenate(runs) if runs else np.zeros((0, 3), dtype=np.int32),
        overlaps=overlaps,
        worst_delta_e=np.array([c.worst_delta_e for c in candidates], dtype=np.float32),
        mean_delta_e=np.array([c.mean_delta_e for c in candidates], dtype=np.float32),
    )


def _runs(mask: Mask) -> NDArray[np.int32]:
    """Row runs of a mask in reading order: (runs, 3) of row, first column, length."""
    edges = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, begin = np.nonzero(edges == 1)
    _, end = np.nonzero(edges == -1)
    return np.stack([row, begin, end - begin], axis=1).astype(np.int32)
