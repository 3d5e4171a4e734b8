"""The first layout of a synthesis: blocks of the exemplar, in step with its lattice if it has one.

Kaspar et al. 2015, section 3.3: optimisation only ever improves what is near, so a regular order must be there from
the start. Blocks are laid in reading order, each from a place that shows the same phase of the lattice, a random
number of cells away. Where on the lattice a block lies is computed from its own place, never from its neighbour's, so
that errors can't add up. Without a lattice the exemplar is cut into blocks that are dealt out like cards.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from tilefab import rng
from tilefab.synthesis.edges import fill_holes
from tilefab.synthesis.lattice import Lattice
from tilefab.texture.matching import window_is_valid
from tilefab.types import Mask, SizePx

_BLOCKS_A_SIDE = 8
_LEAST_BLOCK_PX = 3
_LATTICE_BLOCK_SHARE = 1 / 4
_OVERLAP_SHARE = 6
_CANDIDATES = 6
_FARTHEST_OFF_PHASE_PX = 1.0
_SHIFT_PAYS = 0.7
_STEPS_PER_UNIT = 4
_CLOSES_PX = 1.0
_UNSET = -1


def initial_field(
    exemplar: NDArray[np.float32],
    valid: Mask,
    lattice: Lattice | None,
    size: SizePx,
    toroidal: bool,
    seed: int,
) -> NDArray[np.int32]:
    """Lay blocks of the exemplar over the result.

    Parameters
    ----------
    exemplar
        (rows, cols, channels) CIELAB, or other channels scaled alike; finite where ``valid``.
    valid
        (rows, cols), True where the exemplar may be used.
    lattice
        The exemplar's, at its resolution, or ``None``.
    size
        Of the result.
    toroidal
        Whether it repeats seamlessly: the lattice is then stretched a little so that it closes; `fit_note` says
        whether by how much.
    seed
        0 <= seed < 2**63.

    Returns
    -------
    numpy.ndarray
        (rows, cols) int32, flat index into the exemplar of each pixel; always a valid one.

    Raises
    ------
    ValueError
        If the shapes don't fit, nothing is valid, a valid pixel isn't finite, or size or seed are out of range.
    """
    filled = fill_holes(exemplar, valid)
    if size.rows < 1 or size.cols < 1:
        raise ValueError(f"size {size} must be at least 1 x 1")
    random = rng.generator(seed, "layout")
    if lattice is None:
        return _dealt(valid, size, random)
    return _LatticeLayout(filled, valid, lattice, size, toroidal, random).lay()


def fit_note(lattice: Lattice, size: SizePx) -> str | None:
    """What the user should know of a repeating result whose size doesn't fit the lattice; ``None`` if it does."""
    misfit = max(_misfit_px(lattice.matrix, size.rows, 0), _misfit_px(lattice.matrix, size.cols, 1))
    if misfit <= _CLOSES_PX:
        return None
    rows, cols = (_nearest_fits(lattice.matrix, length, axis) for axis, length in enumerate((size.rows, size.cols)))
    return (
        f"a result of {size.cols} x {size.rows} pixels misses the exemplar's pattern by {misfit:.0f} px where "
        f"it repeats: {_either(cols)} columns and {_either(rows)} rows fit it best"
    )


def fitting_sizes(lattice: Lattice, size: SizePx) -> tuple[SizePx, ...]:
    """Sizes near the one asked for with which a repeating result keeps its lattice, the nearest first.

    Parameters
    ----------
    lattice
        At the resolution of ``size``.
    size
        Asked for.

    Returns
    -------
    tuple of SizePx
        At most 4: the next fitting number of rows below and above with the same for columns. What can't fit better,
        as with a lattice turned by some odd angle, is within 2 cells the best there is.
    """
    rows, cols = (_nearest_fits(lattice.matrix, length, axis) for axis, length in enumerate((size.rows, size.cols)))
    pairs = sorted(product(rows, cols), key=lambda pair: (abs(pair[0] - size.rows) + abs(pair[1] - size.cols), pair))
    return tuple(SizePx(*pair) for pair in pairs)


def _either(lengths: tuple[int, ...]) -> str:
    return " or ".join(str(length) for length in lengths)


def _misfit_px(matrix: NDArray[np.float64], length: int, axis: int) -> float:
    """Distance of the vector that repeats the result to the nearest point of the lattice."""
    vector = np.zeros(2)
    vector[axis] = length
    near = np.floor(np.linalg.solve(matrix, vector))
    return min(float(np.hypot(*(vector - matrix @ (near + corner)))) for corner in np.ndindex(2, 2))


def _nearest_fits(matrix: NDArray[np.float64], length: int, axis: int) -> tuple[int, ...]:
    """The nearest length below and above that fits, or ``length`` alone if it does."""
    if _misfit_px(matrix, length, axis) <= _CLOSES_PX:
        return (length,)
    reach = 2 * int(np.ceil(np.abs(matrix[axis]).sum())) + 1
    found = []
    for lengths in (range(length - 1, max(0, length - reach), -1), range(length + 1, length + reach + 1)):
        misfits = [_misfit_px(matrix, other, axis) for other in lengths]
        if misfits:
            limit = max(_CLOSES_PX, min(misfits))
            first = next(place for place, misfit in enumerate(misfits) if misfit <= limit)
            # Next to the first that does there may be one that does better.
            first = min(range(first, min(first + 3, len(misfits))), key=lambda place: misfits[place])
            found.append(lengths[first])
    return tuple(found)


def _dealt(valid: Mask, size: SizePx, random: np.random.Generator) -> NDArray[np.int32]:
    """Blocks of an eighth of the exemplar; every one is dealt once before any is dealt again."""
    block = [max(_LEAST_BLOCK_PX, -(-side // _BLOCKS_A_SIDE)) for side in valid.shape]
    block = [min(height, side) for height, side in zip(block, valid.shape, strict=True)]
    deck = _deck(valid, block[0], block[1])
    while not len(deck):
        block = [max(1, side // 2) for side in block]
        deck = _deck(valid, block[0], block[1])
    rows, cols = -(-size.rows // block[0]), -(-size.cols // block[1])
    rounds = -(-rows * cols // len(deck))
    places = np.concatenate([deck[random.permutation(len(deck))] for _ in range(rounds)])[: rows * cols]
    starts = (places[:, 0] * valid.shape[1] + places[:, 1]).reshape(rows, cols)
    within = np.arange(block[0])[:, None] * valid.shape[1] + np.arange(block[1])
    field = starts[:, None, :, None] + within[:, None, :]
    field = field.reshape(rows * block[0], cols * block[1])
    # A first row and column of whole blocks would be the same in every result.
    down, across = (
        int(random.integers(side * count - length + 1))
        for side, count, length in zip(block, (rows, cols), (size.rows, size.cols), strict=True)
    )
    return np.ascontiguousarray(field[down : down + size.rows, across : across + size.cols], dtype=np.int32)


def _deck(valid: Mask, rows: int, cols: int) -> NDArray[np.int64]:
    """Top left corners (n, 2) of blocks that cover the exemplar evenly and hold valid pixels only."""
    allowed = window_is_valid(valid, rows, cols)
    starts = []
    for side, length in zip(valid.shape, (rows, cols), strict=True):
        count = max(1, round(side / length))
        starts.append([round(i * (side - length) / max(1, count - 1)) for i in range(count)])
    kept = []
    for row, col in product(*starts):
        reach = [slice(max(0, at - side // 2), at + side // 2 + 1) for at, side in ((row, rows), (col, cols))]
        near = np.argwhere(allowed[reach[0], reach[1]])
        if len(near):
            near += [reach[0].start, reach[1].start]
            kept.append(near[int(((near - [row, col]) ** 2).sum(axis=1).argmin())])
    if not kept and allowed.any():
        kept = list(np.argwhere(allowed))
    return np.array(kept, dtype=np.int64).reshape(-1, 2)


class _LatticeLayout:
    def __init__(
        self,
        filled: NDArray[np.float64],
        valid: Mask,
        lattice: Lattice,
        size: SizePx,
        toroidal: bool,
        random: np.random.Generator,
    ) -> None:
        self.colours = np.rint(filled * _STEPS_PER_UNIT).astype(np.int64)
        self.valid, self.random = valid, random
        self.matrix = lattice.matrix
        target = closing_lattice(self.matrix, size) if toroidal else self.matrix
        self.to_exemplar = self.matrix @ np.linalg.inv(target)
        self.source = np.full((size.rows, size.cols), _UNSET, dtype=np.int32)
        self.usage = np.zeros(valid.shape, dtype=np.int64)
        self.block = tuple(
            max(_LEAST_BLOCK_PX, min(side // 2, round(cell * max(1.0, np.floor(side * _LATTICE_BLOCK_SHARE / cell)))))
            for cell, side in zip(lattice.cell_px, valid.shape, strict=True)
        )
        self.overlap = max(2, min(self.block) // _OVERLAP_SHARE)
        self._allowed: dict[tuple[int, int], Mask] = {}
        self._origin = np.array([random.integers(side) for side in valid.shape], dtype=np.float64)

    def lay(self) -> NDArray[np.int32]:
        rows, cols = self.block
        for row in range(0, self.source.shape[0], rows):
            for col in range(0, self.source.shape[1], cols):
                self._lay_block(row, col, min(rows, self.source.shape[0] - row), min(cols, self.source.shape[1] - col))
        return self.source

    def _lay_block(self, row: int, col: int, rows: int, cols: int) -> None:
        # The phase is right in the block's middle, also where the lattice is stretched to close.
        middle = np.array([rows, cols]) / 2
        phase = self._origin + self.to_exemplar @ (np.array([row, col]) + middle) - middle
        exact = self._in_phase(phase, rows, cols)
        if not len(exact):
            if rows > 1 or cols > 1:
                self._lay_parts(row, col, rows, cols)
                return
            # No valid pixel has this phase: the nearest to one that would.
            valid = np.argwhere(self.valid)
            off = valid - phase
            off -= (self.matrix @ np.rint(np.linalg.solve(self.matrix, off.T))).T
            exact = valid[[int(np.round((off**2).sum(axis=1), 6).argmin())]].astype(np.float64)
        start = self._best(exact, row, col, rows, cols)
        self.usage[start[0] : start[0] + rows, start[1] : start[1] + cols] += 1
        flat = (start[0] + np.arange(rows))[:, None] * self.valid.shape[1] + start[1] + np.arange(cols)
        self.source[row : row + rows, col : col + cols] = flat

    def _lay_parts(self, row: int, col: int, rows: int, cols: int) -> None:
        down, across = -(-rows // 2), -(-cols // 2)
        for part_row, part_rows in ((row, down), (row + down, rows - down)):
            for part_col, part_cols in ((col, across), (col + across, cols - across)):
                if part_rows and part_cols:
                    self._lay_block(part_row, part_col, part_rows, part_cols)

    def _in_phase(self, phase: NDArray[np.float64], rows: int, cols: int) -> NDArray[np.float64]:
        """Top left corners (n, 2) of all blocks that show the exemplar in this phase and hold valid pixels only.

        To fractions of a pixel; the nearest whole ones are allowed.
        """
        allowed = self._allowed_starts(rows, cols)
        if not allowed.size:
            return np.empty((0, 2))
        limit = np.array(allowed.shape) - 1
        corners = np.array([[0, 0, limit[0], limit[0]], [0, limit[1], 0, limit[1]]]) - phase[:, None]
        times = np.linalg.solve(self.matrix, corners)
        first, last = np.floor(times.min(axis=1)).astype(np.int64), np.ceil(times.max(axis=1)).astype(np.int64)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)), indexing="ij"))
        exact = np.round((phase[:, None] + self.matrix @ grid.reshape(2, -1)).T, 6)
        starts = np.rint(exact).astype(np.int64)
        inside = ((starts >= 0) & (starts <= limit)).all(axis=1)
        starts, exact = starts[inside], exact[inside]
        return np.asarray(exact[allowed[starts[:, 0], starts[:, 1]]])

    def _allowed_starts(self, rows: int, cols: int) -> Mask:
        if (rows, cols) not in self._allowed:
            fits = rows <= self.valid.shape[0] and cols <= self.valid.shape[1]
            self._allowed[rows, cols] = (
                window_is_valid(self.valid, rows, cols) if fits else np.empty((0, 0), dtype=bool)
            )
        return self._allowed[rows, cols]

    def _best(self, exact: NDArray[np.float64], row: int, col: int, rows: int, cols: int) -> tuple[int, int]:
        """Of the starts least used, at random, that which fits best what lies there; moved slightly if that pays."""
        exact = exact[self.random.permutation(len(exact))]
        starts = np.rint(exact).astype(np.int64)
        used = [int(self.usage[at[0] : at[0] + rows, at[1] : at[1] + cols].sum()) for at in starts]
        chosen = np.argsort(used, kind="stable")[:_CANDIDATES]
        costs = [self._cost(int(starts[i, 0]), int(starts[i, 1]), row, col, rows, cols) for i in chosen]
        best = int(chosen[int(np.argmin(costs))])
        moved, found = (int(starts[best, 0]), int(starts[best, 1])), _SHIFT_PAYS * min(costs)
        allowed = self._allowed_starts(rows, cols)
        for down, across in product((-1, 0, 1), repeat=2):
            place = int(starts[best, 0]) + down, int(starts[best, 1]) + across
            # A block that followed its neighbours farther would lead the next ones astray.
            if float(np.hypot(*(place - exact[best]))) > _FARTHEST_OFF_PHASE_PX:
                continue
            if all(0 <= x < side for x, side in zip(place, allowed.shape, strict=True)) and allowed[place]:
                cost = self._cost(*place, row, col, rows, cols)
                if cost < found:
                    moved, found = place, cost
        return moved

    def _cost(self, at_row: int, at_col: int, row: int, col: int, rows: int, cols: int) -> float:
        """Mean squared step to what lies above and to the left, over a small overlap; 0 where nothing lies yet."""
        total = count = 0
        up, left = min(self.overlap, row, at_row), min(self.overlap, col, at_col)
        strips = ((-up, 0, 0, cols), (0, rows, -left, 0))
        flat = self.colours.reshape(-1, self.colours.shape[2])
        for top, bottom, start, end in strips:
            there = self.source[row + top : row + bottom, col + start : col + end]
            if there.size and there.min() >= 0:
                wanted = self.colours[at_row + top : at_row + bottom, at_col + start : at_col + end]
                total += int(((wanted - flat[there]) ** 2).sum())
                count += there.size
        return total / count if count else 0.0


def closing_lattice(matrix: NDArray[np.float64], size: SizePx) -> NDArray[np.float64]:
    """The lattice most like this one of which the result's sides are whole vectors; itself if there is none near."""
    sides = np.diag([float(size.rows), float(size.cols)])
    near = np.floor(np.linalg.solve(matrix, sides)).astype(np.int64)
    best, least = matrix, np.inf
    for steps in product((0, 1), repeat=4):
        times = near + np.array(steps).reshape(2, 2)
        if round(float(np.linalg.det(times))) == 0:
            continue
        target = sides @ np.linalg.inv(times)
        strain = round(float(np.abs(target @ np.linalg.inv(matrix) - np.eye(2)).max()), 9)
        if strain < least:
            best, least = target, strain
    return best
