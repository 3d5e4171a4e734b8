"""The crop design in plain Python: the oracle for the fast sampler, cell by cell and pixel by pixel.

Slow on purpose: it shares nothing with the kernels but the map and the random streams, and can be read beside the
docstrings of `tilefab.sampling.crop_choice` and `tilefab.sampling.crop_seams`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from tilefab.rng import philox_4x32, stream_key
from tilefab.sampling.crop_map import CropMap
from tilefab.types import Array

_TURNS = 5
_BLOCK_CELLS = 2
_PENALTY = 1 << 24
_MAY_NOT_BE_SHOWN = 1 << 27
_OVERLAP_WEIGHT = 1000
_SQUARE = 6000
_MOST = 65535
_WORD = 1 << 64
_SWEEP_BIT = 59
_BAND = 2

Cell = tuple[int, int]
Place = tuple[int, int]
Cost = Callable[[int, int], int]


class CropReference:
    """The plane of one map and one job seed, at one scale; all that was found is kept.

    Parameters
    ----------
    crop_map
        The map.
    seed
        Job seed.
    level
        How many times the plane is halved, 0 .. ``crop_map.coarsest_level``.
    """

    def __init__(self, crop_map: CropMap, *, seed: int, level: int = 0) -> None:
        self.map = crop_map
        self.level = level
        self.key = stream_key(seed, "crops")
        self.crops = len(crop_map.crop_row)
        self.places: list[Place] = list(zip(crop_map.crop_row.tolist(), crop_map.crop_col.tolist(), strict=True))
        self.crop_of = {place: crop for crop, place in enumerate(self.places)}
        self.side: list[list[int]] = crop_map.side_cost.tolist()
        self.below: list[list[int]] = crop_map.below_cost.tolist()
        self.price: list[int] = crop_map.price.tolist()
        self.ration: list[int] = crop_map.ration.tolist()
        self.guides: list[list[list[list[int]]]] = [crop_map.guide.tolist()]
        for _ in range(crop_map.seam_levels):
            self.guides.append(_halved_guide(self.guides[-1]))
        # Seams are found down to this halving of the guide.
        self.finest = max(level - crop_map.guide_shift, 0)
        self.shown = cache(self._shown)
        self.upright_seam = cache(self._upright_seam)
        self.pin = cache(self._pin)
        self.level_seam = cache(self._level_seam)

    # Which crop a cell shows.

    def crop_at(self, cell: Cell) -> int:
        """Crop that a cell shows in the end."""
        return self.shown(cell, self.map.sweeps)

    def _shown(self, cell: Cell, sweep: int) -> int:
        """Crop that a cell shows after one sweep, the first being 0."""
        row, col = cell
        word = int(philox_4x32(self.key, np.uint64(row % _WORD), np.uint64((col % _WORD) ^ (sweep << _SWEEP_BIT)))[0])
        start = (word & (_WORD - 1)) % self.crops
        around = self._known_around(cell, sweep)
        everything = [(start + k) % self.crops for k in range(self.crops)]
        may_be_shown = [crop for crop in everything if self.price[crop] < _MAY_NOT_BE_SHOWN]
        if not around:
            in_turn = [crop for crop in may_be_shown if not self._out_of_turn(cell, crop)]
            return [*in_turn, *may_be_shown, start][0]
        tried = everything[: self.map.candidates]
        if not set(tried) & set(may_be_shown):
            tried = everything
        best = min(tried, key=lambda crop: self._cost(cell, crop, around))
        # The crops that go on where a neighbour's ends are tried as well.
        for down, right in ((0, -1), (0, 1), (-1, 0), (1, 0)):
            other = self._going_on(around.get((down, right)), -down, -right)
            if other is not None and self._cost(cell, other, around) < self._cost(cell, best, around):
                best = other
        if sweep > 0:
            before = self.shown(cell, sweep - 1)
            if self._cost(cell, best, around) >= self._cost(cell, before, around):
                return before
        return best

    def _known_around(self, cell: Cell, sweep: int) -> dict[tuple[int, int], int]:
        """Crops of the neighbours that have decided already, by where they lie."""
        known = {}
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                other = (cell[0] + down, cell[1] + right)
                if other == cell:
                    continue
                if _turn_of(other) < _turn_of(cell):
                    known[down, right] = self.shown(other, sweep)
                elif sweep > 0:
                    known[down, right] = self.shown(other, sweep - 1)
        return known

    def _cost(self, cell: Cell, crop: int, around: dict[tuple[int, int], int]) -> int:
        total = self.price[crop] + (_PENALTY if self._out_of_turn(cell, crop) else 0)
        for (down, right), other in around.items():
            joining = 0
            if down == 0:
                joining = self.side[other][crop] if right < 0 else self.side[crop][other]
            elif right == 0:
                joining = self.below[other][crop] if down < 0 else self.below[crop][other]
            elif self._a_pitch_apart(other, crop):
                joining = _SQUARE
            total += min(joining + self._overlapping(other, crop), _MOST)
        return total

    def _going_on(self, crop: int | None, down: int, right: int) -> int | None:
        """Crop that lies one pitch further on in the slab."""
        if crop is None:
            return None
        row, col = self.places[crop]
        return self.crop_of.get((row + down * self.map.pitch_px, col + right * self.map.pitch_px))

    def _a_pitch_apart(self, one: int, other: int) -> bool:
        """Whether two crops lie a pitch apart both ways, as corners of a square of four that continue each other."""
        return all(abs(a - b) == self.map.pitch_px for a, b in zip(self.places[one], self.places[other], strict=True))

    def _overlapping(self, one: int, other: int) -> int:
        """What it costs that neighbours show the same part of the slab."""
        size = self.map.pitch_px
        rows, cols = (max(size - abs(a - b), 0) for a, b in zip(self.places[one], self.places[other], strict=True))
        return rows * cols * _OVERLAP_WEIGHT // size**2

    def _out_of_turn(self, cell: Cell, crop: int) -> bool:
        block_row, block_col = cell[0] // _BLOCK_CELLS, cell[1] // _BLOCK_CELLS
        return self.ration[crop] >= 0 and self.ration[crop] != (block_row + 2 * block_col) % _TURNS

    # Where two cells, or two rows of cells, meet.

    def _sizes(self, level: int) -> tuple[int, int]:
        """Pitch and overlap in pixels of the guide after some halvings."""
        shift = self.map.guide_shift + level
        return self.map.pitch_px >> shift, self.map.overlap_px >> shift

    def _pixel(self, level: int, crop: int, row: int, col: int) -> list[int]:
        """Pixel of a crop in the guide after some halvings."""
        top, left = ((place >> self.map.guide_shift) >> level for place in self.places[crop])
        return self.guides[level][top + row][left + col]

    def _meeting(self, level: int, first: tuple[int, int, int], second: tuple[int, int, int]) -> int:
        """Cost of a seam at a place where a pixel (crop, row, col) of one crop meets one of another."""
        return seam_cost_reference(self._pixel(level, *first), self._pixel(level, *second))

    def _free_seam(self, first: int, second: int, upright: bool, finest: int) -> list[int]:
        """Seam between the overlaps of two crops after ``finest`` halvings, first found at the coarsest."""
        path: list[int] = []
        for level in range(self.map.seam_levels, finest - 1, -1):
            pitch, overlap = self._sizes(level)
            cost = self._pair_cost(first, second, upright, level)
            path = shortest_seam_reference(cost, _bands(path, pitch + overlap, overlap))
        return path

    def _pair_cost(self, first: int, second: int, upright: bool, level: int) -> Cost:
        """Cost within the overlap of two crops, by how far along it and how far across."""
        pitch, _ = self._sizes(level)

        def cost(t: int, x: int) -> int:
            if upright:
                return self._meeting(level, (first, t, pitch + x), (second, t, x))
            return self._meeting(level, (first, pitch + x, t), (second, x, t))

        return cost

    def _upright_seam(self, cell: Cell) -> list[int]:
        """Between a cell and the one to its left: by row of their crops, the first pixel that shows the right one."""
        left, right = self.crop_at((cell[0], cell[1] - 1)), self.crop_at(cell)
        return self._free_seam(left, right, True, self.finest)

    def _pin(self, cell: Cell) -> int:
        """Where the seam above a cell passes its middle."""
        above, below = self.crop_at((cell[0] - 1, cell[1])), self.crop_at(cell)
        seam = self._free_seam(above, below, False, self.map.seam_levels)
        pin = seam[len(seam) // 2]
        for level in range(self.map.seam_levels - 1, self.finest - 1, -1):
            pitch, overlap = self._sizes(level)
            middle = (pitch + overlap) // 2
            cost = self._pair_cost(above, below, False, level)
            # The six pixels around each place whose half is next to the coarser pin; of equal sums, the first.
            sums = [
                (sum(cost(t, y) for t in range(middle - 1, middle + 2) for y in (x - 1, x)), x)
                for x in range(max(2 * (pin - 1), 1), min(2 * (pin + 1) + 1, overlap - 1) + 1)
            ]
            pin = min(sums)[1]
        return pin

    def _level_seam(self, cell: Cell) -> list[int]:
        """Above a cell, from the middle of the one to its left on: by column, the first row that shows the lower."""
        row, col = cell
        path: list[int] = []
        for level in range(self.map.seam_levels, self.finest - 1, -1):
            pitch, overlap = self._sizes(level)
            begin, end = (
                min(max(self.pin(at) >> (level - self.finest), 1), overlap - 1) for at in ((row, col - 1), cell)
            )
            path = shortest_seam_reference(
                self._crossing_cost(cell, level), _bands(path, pitch + 1, overlap), begin, end
            )
        return path

    def _crossing_cost(self, cell: Cell, level: int) -> Cost:
        """Cost within the overlap of two rows of cells, from the middle of one cell to that of the next."""
        row, col = cell
        pitch, overlap = self._sizes(level)
        finer = level - self.finest

        def shown(cell_row: int, in_row: int, x: int) -> tuple[int, int, int]:
            """Pixel of a crop that one of both rows shows x right of the left edge of its upright overlap."""
            left = x < 0 or (x < overlap and x < self.upright_seam((cell_row, col))[in_row << finer] >> finer)
            if left:
                # A crop begins where the overlap to its left does.
                return self.crop_at((cell_row, col - 1)), in_row, x + pitch
            return self.crop_at((cell_row, col)), in_row, x

        def cost(t: int, y: int) -> int:
            x = t - pitch // 2 + overlap // 2
            return self._meeting(level, shown(row - 1, pitch + y, x), shown(row, y, x))

        return cost

    # What a pixel shows.

    def source(self, row: int, col: int) -> tuple[Place, Cell]:
        """Pixel of the halved base that a pixel of the plane shows, and the cell that it belongs to."""
        pitch, overlap = self.map.pitch_px >> self.level, self.map.overlap_px >> self.level
        half = overlap // 2
        # Of how many pixels of the plane a pixel of a seam is.
        shift = max(self.map.guide_shift - self.level, 0)
        cell_row = (row + half) // pitch
        below = row + half - cell_row * pitch
        if below < overlap:
            middle = (col - pitch // 2) // pitch
            seam = self.level_seam((cell_row, middle + 1))
            if below < seam[(col - pitch // 2 - middle * pitch) >> shift] << shift:
                cell_row -= 1
        in_row = row + half - cell_row * pitch
        cell_col = (col + half) // pitch
        right = col + half - cell_col * pitch
        if right < overlap and right < self.upright_seam((cell_row, cell_col))[in_row >> shift] << shift:
            cell_col -= 1
        top, left = self.places[self.crop_at((cell_row, cell_col))]
        in_col = col + half - cell_col * pitch
        return ((top >> self.level) + in_row, (left >> self.level) + in_col), (cell_row, cell_col)

    def pixel(self, row: int, col: int) -> Array:
        """Colour of one pixel of the plane, (channels,)."""
        place, _ = self.source(row, col)
        colour: Array = self.map.base_level(self.level)[place]
        return colour


def _turn_of(cell: Cell) -> int:
    """Turn in which a cell decides, 0 to 3."""
    return 2 * (cell[0] & 1) + (cell[1] & 1)


def _halved_guide(guide: list[list[list[int]]]) -> list[list[list[int]]]:
    return [
        [
            [
                # Of colours the mean, of weights (channel 3) the largest.
                (sum(values) + 2) >> 2 if channel < 3 else max(values)
                for channel, values in enumerate(
                    zip(
                        guide[2 * r][2 * s],
                        guide[2 * r][2 * s + 1],
                        guide[2 * r + 1][2 * s],
                        guide[2 * r + 1][2 * s + 1],
                        strict=True,
                    )
                )
            ]
            for s in range(len(guide[0]) // 2)
        ]
        for r in range(len(guide) // 2)
    ]


def seam_cost_reference(first: list[int], second: list[int]) -> int:
    """What a seam pays at a pixel where two pixels of the guide meet: CIE76**1.5, and more by the greater weight."""
    squared = min(sum((a - b) ** 2 for a, b in zip(first[:3], second[:3], strict=True)) >> 2, (1 << 14) - 1)
    cost = 1 + int(4 * squared**0.75 + 0.5)
    weight = max([*first[3:], *second[3:]], default=0)
    return cost + cost * weight // 16


def _bands(coarser: list[int], length: int, width: int) -> list[range]:
    """Where a seam may pass, row by row: anywhere, or near twice the coarser one."""
    if not coarser:
        return [range(1, width)] * length
    places = min(2 * _BAND + 1, width - 1)
    bands = []
    for t in range(length):
        low = 2 * coarser[min(t // 2, len(coarser) - 1)] - places // 2
        low = max(min(low, width - places), 1)
        bands.append(range(low, low + places))
    return bands


def shortest_seam_reference(
    cost: Cost, bands: list[range], begin: int | None = None, end: int | None = None
) -> list[int]:
    """Cheapest seam down a strip: for each row the place before which it passes.

    At place x of row t a seam pays ``cost`` of pixels x - 1 and x; where it steps aside, the pixel between both
    places is paid for again in both rows. Of equal seams, going straight comes first, then having come from the left.

    Parameters
    ----------
    cost
        Cost by row and pixel.
    bands
        By row, the places that a seam may take.
    begin, end
        Where it must begin and end; anywhere if not given.
    """
    totals: list[dict[int, int]] = []
    came_from: list[dict[int, int]] = []
    for t, band in enumerate(bands):
        totals.append({})
        came_from.append({})
        for x in band:
            own = cost(t, x - 1) + cost(t, x)
            if t == 0:
                if begin is None or x == begin:
                    totals[t][x] = own
                continue
            ways = []
            for before in (x, x - 1, x + 1):
                if before in totals[t - 1]:
                    between = min(before, x)
                    aside = 0 if before == x else cost(t - 1, between) + cost(t, between)
                    ways.append((totals[t - 1][before] + aside + own, before))
            if ways:
                totals[t][x], came_from[t][x] = min(ways, key=lambda way: way[0])
    path = [min(totals[-1], key=lambda x: (totals[-1][x], x)) if end is None else end]
    for t in range(len(bands) - 1, 0, -1):
        path.append(came_from[t][path[-1]])
    return path[::-1]


def crop_pixel_reference(crop_map: CropMap, row: int, col: int, *, seed: int, level: int = 0) -> Array:
    """Colour of one pixel of the endless plane, (channels,)."""
    return CropReference(crop_map, seed=seed, level=level).pixel(row, col)


def choose_crops_reference(crop_map: CropMap, row: int, col: int, rows: int, cols: int, *, seed: int) -> Array:
    """Crops shown by a window of cells: twin of `tilefab.sampling.crop_choice.choose_crops`."""
    plane = CropReference(crop_map, seed=seed)
    return np.array([[plane.crop_at((row + i, col + j)) for j in range(cols)] for i in range(rows)], dtype=np.int32)


def render_crop_reference(
    crop_map: CropMap, row: int, col: int, rows: int, cols: int, *, seed: int, level: int = 0
) -> Array:
    """Region of the endless plane, one pixel after the other: twin of `tilefab.sampling.render`.

    With a ``level`` up to ``crop_map.coarsest_level``, of `tilefab.sampling.render_reduced`.
    """
    plane = CropReference(crop_map, seed=seed, level=level)
    out = np.empty((rows, cols, crop_map.base.shape[2]), dtype=crop_map.base.dtype)
    for r in range(rows):
        for c in range(cols):
            out[r, c] = plane.pixel(row + r, col + c)
    return out
