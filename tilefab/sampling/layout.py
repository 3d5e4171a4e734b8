"""Where on the endless plane each face lies.

``scatter`` sends face numbers to places far apart: no cell of the plane shows on two faces, and faces of neighbouring
numbers, which end up in one box, lie at well-separated shifts to the cells. ``continuous`` cuts a wall of a given
number of columns into faces that join seamlessly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tilefab.rng import random_words, stream_key

FACE_LIMIT = 1 << 40
_SLOT_BITS = 20
_ROUNDS = 6
# Fractions of the plastic number's sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom
# sequences"): successive multiples spread evenly over the square. 1/p and 1/p**2 in 64-bit fixed point.
_STEP_ROW = 0xC13FA9A902A6328F
_STEP_COL = 0x91E10DA5C79E7B1D
_WRAP_64 = (1 << 64) - 1


@dataclass(frozen=True)
class Region:
    """A rectangle of the endless plane, in pixels."""

    row: int
    col: int
    rows: int
    cols: int


@dataclass(frozen=True)
class PlaneLayout:
    """How the faces of a job lie on the plane.

    Attributes
    ----------
    kind
        ``"scatter"`` or ``"continuous"``.
    seed
        Job seed.
    face_rows, face_cols
        Size of a finished tile, without bleed.
    bleed_px
        Margin rendered around the tile on every side.
    cell_rows, cell_cols
        Size of a cell of the plane, see `TextureMap.cell_shape`.
    columns
        Faces in a row of the wall; continuous only.
    reach_px
        How far beyond its cell what a cell shows can reach.
    """

    kind: Literal["scatter", "continuous"]
    seed: int
    face_rows: int
    face_cols: int
    bleed_px: int
    cell_rows: int
    cell_cols: int
    columns: int = 1
    reach_px: int = 0

    def __post_init__(self) -> None:
        sizes = (self.face_rows, self.face_cols, self.cell_rows, self.cell_cols, self.columns)
        if min(sizes) < 1 or self.bleed_px < 0 or self.reach_px < 0:
            raise ValueError(
                f"sizes {sizes} must be at least 1, a bleed of {self.bleed_px} px and a reach of {self.reach_px} px "
                "not negative"
            )

    def face(self, index: int) -> Region:
        """Region that face ``index`` shows, bleed included.

        Raises
        ------
        ValueError
            If the index is not within 0 .. 2**40 - 1.
        """
        if not 0 <= index < FACE_LIMIT:
            raise ValueError(f"face {index} is outside 0 .. 2**40 - 1")
        rows, cols = self.face_rows + 2 * self.bleed_px, self.face_cols + 2 * self.bleed_px
        if self.kind == "continuous":
            row = (index // self.columns) * self.face_rows - self.bleed_px
            col = (index % self.columns) * self.face_cols - self.bleed_px
            return Region(row, col, rows, cols)
        slot_row, slot_col = self._slot(index)
        start_row, start_col = random_words(stream_key(self.seed, "phase"), 0)
        phase_row = ((start_row + index * _STEP_ROW) & _WRAP_64) * self.cell_rows >> 64
        phase_col = ((start_col + index * _STEP_COL) & _WRAP_64) * self.cell_cols >> 64
        # A slot is a whole number of cells, large enough for a face at any phase with all that reaches into it.
        reach = self.reach_px
        pitch_row = (-(-(rows + 2 * reach) // self.cell_rows) + 1) * self.cell_rows
        pitch_col = (-(-(cols + 2 * reach) // self.cell_cols) + 1) * self.cell_cols
        return Region(slot_row * pitch_row + phase_row + reach, slot_col * pitch_col + phase_col + reach, rows, cols)

    def _slot(self, index: int) -> tuple[int, int]:
        """Pseudo-random, one-to-one: 40-bit face number to a slot of a 2**20 x 2**20 lattice around the origin.

        A Feistel network (Luby and Rackoff 1988) whose rounds are Philox.
        """
        half = (1 << _SLOT_BITS) - 1
        left, right = index >> _SLOT_BITS, index & half
        key = stream_key(self.seed, "slot")
        for round_number in range(_ROUNDS):
            word, _ = random_words(key, round_number << _SLOT_BITS | right)
            left, right = right, left ^ (word & half)
        return left - (1 << _SLOT_BITS - 1), right - (1 << _SLOT_BITS - 1)
