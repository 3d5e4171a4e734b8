"""Fingerprints of faces: a bit for each of some thousand cells, lighter or darker than around it.

A face's fingerprint is made from a small rendering of it. The tile in an image is brought to the same cells; bits that
aren't seen, or where it is nearly as light as around, are left out, and the fingerprints that differ in the fewest of
the others are found by counting bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tilefab.inspection.fingerprint_kernels import count_differing
from tilefab.inspection.views import Cells, Plane, cells_of_view, detail, grid_of
from tilefab.types import Array, Mask, SizeMm, SizePx

FINGERPRINT_VERSION = 1
"""Raised whenever the same faces would get other fingerprints."""

CODE_CELLS = 1024
VIEW_PX = 64
_AROUND_CELLS = 3.0
_LEFT_OUT = 0.3
_WORD = 64


class FaceView(Protocol):
    """Small renderings of faces."""

    def __call__(self, face: int, long_px: int) -> Plane:
        """L* (rows, cols) float32, 0 to 100, of a face without bleed; its longer side ``long_px`` to twice that."""


@dataclass(frozen=True, eq=False)
class FingerprintIndex:
    """Fingerprints of faces.

    Attributes
    ----------
    faces
        int64 (F,): their indices.
    codes
        uint64 (F, W): bit k of a row, from the lowest of its first word on, is that of cell k, row by row.
    grid
        Rows and columns of cells.
    """

    faces: NDArray[np.int64]
    codes: NDArray[np.uint64]
    grid: SizePx

    def __post_init__(self) -> None:
        words = -(-self.grid.rows * self.grid.cols // _WORD)
        if self.faces.ndim != 1 or self.codes.shape != (len(self.faces), words):
            raise ValueError(
                f"{self.faces.shape} faces with codes {self.codes.shape}: must be (F,) and (F, {words}) on a grid of "
                f"{self.grid.rows} x {self.grid.cols} cells"
            )

    def __len__(self) -> int:
        return len(self.faces)

    def arrays(self) -> dict[str, Array]:
        """All of it as arrays by name, to be stored."""
        about = np.array([FINGERPRINT_VERSION, self.grid.rows, self.grid.cols], dtype=np.int64)
        return {"about": about, "faces": self.faces, "codes": self.codes}

    @staticmethod
    def from_arrays(arrays: Mapping[str, Array]) -> FingerprintIndex:
        """The index that `arrays` was taken from.

        Raises
        ------
        ValueError
            If arrays are missing, don't fit together, or are of another version of fingerprints.
        """
        missing = {"about", "faces", "codes"} - set(arrays)
        if missing:
            raise ValueError(f"fingerprints without {', '.join(sorted(missing))}: make them anew")
        version, rows, cols = (int(value) for value in arrays["about"])
        if version != FINGERPRINT_VERSION:
            raise ValueError(f"fingerprints of version {version}, not {FINGERPRINT_VERSION}: make them anew")
        faces = np.ascontiguousarray(arrays["faces"], dtype=np.int64)
        return FingerprintIndex(faces, np.ascontiguousarray(arrays["codes"], dtype=np.uint64), SizePx(rows, cols))

    def narrowed(self, faces: Sequence[int] | NDArray[np.int64]) -> FingerprintIndex:
        """The part of it that is of some faces; those it doesn't know are left out."""
        keep = np.isin(self.faces, np.asarray(faces, dtype=np.int64))
        return FingerprintIndex(self.faces[keep], self.codes[keep], self.grid)

    def joined(self, other: FingerprintIndex) -> FingerprintIndex:
        """Both together.

        Raises
        ------
        ValueError
            If they are of tiles of another shape.
        """
        if other.grid != self.grid:
            raise ValueError(f"fingerprints on {other.grid} cells can't join those on {self.grid}")
        faces = np.concatenate([self.faces, other.faces])
        return FingerprintIndex(faces, np.concatenate([self.codes, other.codes]), self.grid)

    def differing(self, bits: Mask, known: Mask) -> NDArray[np.int32]:
        """For each of T sets of bits (T, rows, cols), in how many of the cells known each face differs; (T, F)."""
        out = np.empty((len(bits), len(self.faces)), dtype=np.int32)
        count_differing(self.codes, packed(bits), packed(known), out)
        return out


def fingerprints(view: FaceView, faces: Sequence[int], size_mm: SizeMm) -> FingerprintIndex:
    """Fingerprints of faces, each from a rendering of some 64 pixels: some milliseconds a face.

    Parameters
    ----------
    view
        Renders faces.
    faces
        Their indices.
    size_mm
        Size of the finished tile.
    """
    grid = grid_of(size_mm, CODE_CELLS)
    long_px = max(VIEW_PX, grid.rows, grid.cols)
    codes = np.empty((len(faces), -(-grid.rows * grid.cols // _WORD)), dtype=np.uint64)
    for place, face in enumerate(faces):
        codes[place] = packed(code_bits(cells_of_view(view(face, long_px), grid))[0][np.newaxis])[0]
    return FingerprintIndex(np.array(faces, dtype=np.int64), codes, grid)


def code_bits(cells: Cells) -> tuple[Mask, Mask]:
    """Bits (rows, cols) of a face's cells, and which of them can be relied on."""
    own = detail(cells, _AROUND_CELLS)
    size = np.abs(own)
    least = float(np.quantile(size[cells.seen], _LEFT_OUT)) if cells.seen.any() else 0.0
    return own > 0.0, cells.seen & (size > least)


def packed(bits: Mask) -> NDArray[np.uint64]:
    """Bits (F, rows, cols) as words (F, W)."""
    flat = bits.reshape(len(bits), -1)
    short = -flat.shape[1] % _WORD
    padded = np.pad(flat, ((0, 0), (0, short)))
    return np.packbits(padded, axis=1, bitorder="little").view("<u8").astype(np.uint64)
