"""Candidate patches: pieces of the exemplar that could replace a part of the repeatable tile unnoticed.

First seed, 5.5.1: associate places of the tile and of the exemplar, cut by minimum cut in CIELAB under a Gaussian
weight whose width sets the patch's size, keep those whose worst cost along the boundary is smallest. The seed tries
tens of millions of random pairs in four hours; here each place of the tile is compared with some thousand random
places of the exemplar along a ring where the cut may be expected, and only the best pair is cut.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab import rng
from tilefab.jit import kernel
from tilefab.texture.matching import LAB_STEPS_PER_UNIT, largest_square, window_is_valid
from tilefab.texture.seams import FREE, KEEP, TAKE, boundary_cost, cut
from tilefab.types import Mask

_CORE_SHARE = 0.4
_REACH_SHARE = 1.5
_BELL_SHARE = 0.35
_BELL_WEIGHT = 3.0
_RING_SAMPLES = 48
_TRIES_PER_PLACE = 3000
_SAME_PLACE_SHARE = 0.1
_SAME_PLACE_RADII = 0.5
_SMALLEST_TILE_SHARE = 0.05
_LARGEST_TILE_SHARE = 0.3
_LARGEST_RADIUS_PX = 400.0
_SMALLEST_RADIUS_PX = 3.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """A patch before it is known whether it will be used.

    Attributes
    ----------
    cell_row, cell_col
        Top left corner of the mask relative to a cell of the plane; may be negative.
    base_row, base_col
        Top left corner of the mask in the base.
    mask
        (rows, cols), True inside; no empty row or column at its edges.
    worst_delta_e, mean_delta_e
        CIE76 difference from the tile along the cut.
    """

    cell_row: int
    cell_col: int
    base_row: int
    base_col: int
    mask: Mask
    worst_delta_e: float
    mean_delta_e: float


def patch_radii(tile_shape: tuple[int, int], valid_px: int, count: int = 5) -> list[int]:
    """Typical radius of each class of patches, geometrically from a small to a large part of the tile.

    Patches much smaller than a twentieth of the tile change nothing that an eye would notice, yet Algorithm 2 favours
    them, for they overlap the fewest others: with them the tile shows through most. ``valid_px`` is the side of the
    largest usable square of the base, which bounds the largest patch.
    """
    side = min(tile_shape)
    largest = min(_LARGEST_TILE_SHARE * side, _LARGEST_RADIUS_PX, (valid_px - 3) / (2 * _REACH_SHARE))
    smallest = max(_SMALLEST_RADIUS_PX, min(_SMALLEST_TILE_SHARE * side, largest / 2))
    if largest < _SMALLEST_RADIUS_PX:
        return []
    ratio = (largest / smallest) ** (1 / max(count - 1, 1))
    return sorted({int(smallest * ratio**k) for k in range(count)})


def largest_valid_square(valid: Mask) -> int:
    """Side in pixels of the largest square that is valid throughout."""
    return int(largest_square(valid))


class CandidateFinder:
    """Finds and cuts candidates for one tile over one base.

    Parameters
    ----------
    base
        (rows, cols, 3) int16, from `tilefab.texture.matching.matching_image`.
    valid
        (rows, cols), True where the base may be used.
    tile_source
        (tile rows, tile cols) int32 flat index into the base.
    seed
        Job seed.
    """

    def __init__(self, base: NDArray[np.int16], valid: Mask, tile_source: NDArray[np.int32], seed: int) -> None:
        self.base, self.valid, self.tile_source = base, valid, tile_source
        self.tile = base.reshape(-1, base.shape[2])[tile_source]
        self.seed = seed

    def find(
        self,
        radius_px: int,
        count: int,
        *,
        threads: int | None = None,
        progress: Callable[[], None] | None = None,
    ) -> list[Candidate]:
        """Cut candidates of about ``radius_px`` at ``count`` places spread evenly over the tile.

        Places where no cut is possible give none. The result doesn't depend on ``threads``.
        """
        reach = int(_REACH_SHARE * radius_px) + 1
        side = 2 * reach + 1
        allowed = np.argwhere(window_is_valid(self.valid, side, side))
        if len(allowed) == 0:
            return []
        random = rng.generator(self.seed, f"candidates of radius {radius_px}")
        tile_rows, tile_cols = self.tile_source.shape
        start = random.random(2)
        steps = (start + np.arange(count)[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0
        places = (steps * [tile_rows, tile_cols]).astype(np.int64)
        tries = allowed[random.integers(len(allowed), size=(count, _TRIES_PER_PLACE))] + reach
        angle = np.arange(_RING_SAMPLES) * (2 * np.pi / _RING_SAMPLES)
        radius = radius_px * np.array([0.8, 1.0, 1.2])[np.arange(_RING_SAMPLES) % 3]
        ring = np.rint(np.stack([np.sin(angle) * radius, np.cos(angle) * radius], axis=1)).astype(np.int64)
        same_px = max(2, int(_SAME_PLACE_RADII * radius_px))
        chosen = choose_places(
            self.base,
            self.tile,
            self.tile_source,
            places,
            tries,
            ring,
            same_px,
            int(_SAME_PLACE_SHARE * _RING_SAMPLES),
        )

        window = _Window.of_radius(radius_px, reach)

        def one(k: int) -> Candidate | None:
            found = None if chosen[k] < 0 else self._cut(window, places[k], tries[k, chosen[k]])
            if progress is not None:
                progress()
            return found

        with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
            return [candidate for candidate in pool.map(one, range(count)) if candidate is not None]

    def _cut(self, window: _Window, place: NDArray[np.int64], source: NDArray[np.int64]) -> Candidate | None:
        reach = window.reach
        tile_rows, tile_cols = self.tile_source.shape
        rows, cols = place[0] + window.offset, place[1] + window.offset
        patch = self.base[source[0] - reach : source[0] + reach + 1, source[1] - reach : source[1] + reach + 1]
        squared = squared_differences_on_torus(self.tile, patch, int(rows[0]), int(cols[0]))
        labels = window.labels.copy()
        must_keep = ~_in_rhombus(rows, cols, tile_rows, tile_cols)
        if (must_keep & (labels == TAKE)).any():
            return None
        labels[must_keep] = KEEP
        mask = cut(squared * window.weight // 256, labels)
        pieces, _ = ndimage.label(mask)
        mask = pieces == pieces[reach, reach]
        worst, mean = boundary_cost_delta_e(squared, mask)
        inside_rows, inside_cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        top, left = int(inside_rows[0]), int(inside_cols[0])
        return Candidate(
            cell_row=int(rows[top]),
            cell_col=int(cols[left]),
            base_row=int(source[0]) - reach + top,
            base_col=int(source[1]) - reach + left,
            mask=np.ascontiguousarray(mask[top : inside_rows[-1] + 1, left : inside_cols[-1] + 1]),
            worst_delta_e=worst,
            mean_delta_e=mean,
        )


@dataclass(frozen=True, eq=False)
class _Window:
    """What all cuts of one radius share: a square around the middle with the cut's weights and forced pixels."""

    reach: int
    offset: NDArray[np.int64]
    weight: NDArray[np.int64]
    labels: NDArray[np.uint8]

    @staticmethod
    def of_radius(radius_px: int, reach: int) -> _Window:
        offset = np.arange(-reach, reach + 1)
        distance = np.sqrt(offset[:, None] ** 2.0 + offset[None, :] ** 2.0)
        bell = np.exp(-((distance - radius_px) ** 2) / (2.0 * (_BELL_SHARE * radius_px) ** 2))
        # In 256ths, so that the cost stays an integer whatever the last bit of the exponential is.
        weight = np.rint(256 * (1 + _BELL_WEIGHT * (1 - bell))).astype(np.int64)
        labels = np.full(distance.shape, FREE, dtype=np.uint8)
        labels[distance <= _CORE_SHARE * radius_px] = TAKE
        labels[distance > _REACH_SHARE * radius_px] = KEEP
        return _Window(reach, offset, weight, labels)


@kernel
def squared_differences_on_torus(
    tile: NDArray[np.int16], patch: NDArray[np.int16], row: int, col: int
) -> NDArray[np.int64]:
    """Squared colour differences, (rows, cols), of a patch laid on a repeating tile with its corner at (row, col)."""
    rows, cols, channels = patch.shape
    out = np.empty((rows, cols), dtype=np.int64)
    for r in range(rows):
        tile_row = (row + r) % tile.shape[0]
        for c in range(cols):
            tile_col = (col + c) % tile.shape[1]
            total = np.int64(0)
            for k in range(channels):
                d = np.int64(patch[r, c, k]) - np.int64(tile[tile_row, tile_col, k])
                total += d * d
            out[r, c] = total
    return out


def boundary_cost_delta_e(squared: NDArray[np.int64], mask: Mask) -> tuple[float, float]:
    """Worst and mean CIE76 difference along the boundary of a mask, from squared differences in half units."""
    delta_e: NDArray[np.float64] = np.sqrt(squared) / LAB_STEPS_PER_UNIT
    return boundary_cost(delta_e, mask)


def _in_rhombus(rows: NDArray[np.int64], cols: NDArray[np.int64], tile_rows: int, tile_cols: int) -> Mask:
    """Which pixels of a window, in cell coordinates, lie strictly within the cell's rhombus (first seed, Fig. 5.8).

    Its corners are the centres of the four neighbouring cells; in integers, so that it is exact.
    """
    down = np.abs(2 * rows + 1 - tile_rows) * tile_cols
    right = np.abs(2 * cols + 1 - tile_cols) * tile_rows
    result: Mask = down[:, None] + right[None, :] < 2 * tile_rows * tile_cols
    return result


@kernel
def choose_places(
    base: NDArray[np.int16],
    tile: NDArray[np.int16],
    tile_source: NDArray[np.int32],
    places: NDArray[np.int64],
    tries: NDArray[np.int64],
    ring: NDArray[np.int64],
    same_px: int,
    max_same: int,
) -> NDArray[np.int64]:
    """For each place of the tile, which of its tries fits best along the ring.

    Parameters
    ----------
    places
        (places, 2) row and column in the tile.
    tries
        (places, tries, 2) row and column in the base.
    ring
        (samples, 2) offsets at which the two are compared.
    same_px, max_same
        A try is out if at more than ``max_same`` samples it shows what the tile shows already, shifted by less than
        ``same_px``: swapping those would change nothing.

    Returns
    -------
    ndarray of int64
        (places,) index of the best try, the first on a tie; -1 if all are out.
    """
    result = np.full(len(places), -1, dtype=np.int64)
    base_cols = base.shape[1]
    for i in range(len(places)):
        best = np.int64(-1)
        for j in range(tries.shape[1]):
            total = np.int64(0)
            same = 0
            for k in range(len(ring)):
                tile_row = (places[i, 0] + ring[k, 0]) % tile.shape[0]
                tile_col = (places[i, 1] + ring[k, 1]) % tile.shape[1]
                row, col = tries[i, j, 0] + ring[k, 0], tries[i, j, 1] + ring[k, 1]
                origin = tile_source[tile_row, tile_col]
                if abs(origin // base_cols - row) < same_px and abs(origin % base_cols - col) < same_px:
                    same += 1
                    if same > max_same:
                        break
                for channel in range(base.shape[2]):
                    d = np.int64(base[row, col, channel]) - np.int64(tile[tile_row, tile_col, channel])
                    total += d * d
                if 0 <= best <= total:
                    break
            if same <= max_same and (best < 0 or total < best):
                best = total
                result[i] = j
    return result
