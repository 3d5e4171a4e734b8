"""How near two images are patch by patch: whether each shows what the other shows, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tilefab.texture.gradients import check_labs
from tilefab.types import Array

Matrix: TypeAlias = NDArray[np.float64]

PATCH_PX = 7
SHRINK = 4
"""Patches of 7 pixels at a quarter of the scale see 28: motifs, which is what people compare, not grain."""
MIN_SIDE_PX = SHRINK * (PATCH_PX + 1)
_BLOCK_VALUES = 2**19
"""Distances worked on at a time: few enough to stay in the processor's cache."""
DEFAULT_MAX_PATCHES = 1_024


@dataclass(frozen=True)
class Bidirectional:
    """Both halves of the bidirectional similarity, in CIE76 units per pixel.

    Attributes
    ----------
    completeness_de76
        How badly the image's patches render those of the exemplar: what the image leaves out.
    coherence_de76
        How badly the exemplar's patches explain those of the image: what the image made up.
    """

    completeness_de76: float
    coherence_de76: float

    @property
    def distance_de76(self) -> float:
        """The mean of both."""
        return (self.completeness_de76 + self.coherence_de76) / 2


def bidirectional_similarity(
    exemplar_lab: Array, image_lab: Array, *, max_patches: int = DEFAULT_MAX_PATCHES
) -> Bidirectional:
    """Bidirectional patch similarity (Simakov et al. 2008, "Summarizing visual data", section 3, equation 1).

    Parameters
    ----------
    exemplar_lab
        (rows, cols, 3) CIELAB, at least 32 a side; finite.
    image_lab
        (rows, cols, 3) CIELAB of the same resolution, at least 32 a side.
    max_patches
        The most patches of one image to look up in the other; where an image has more, those on a regular grid.

    Returns
    -------
    Bidirectional
        Means, over patches, of the root mean square colour difference to the nearest of all patches of the other
        image, wherever that begins: shrunken from every pixel, not only from every fourth. Else an image that was
        put together on the same grid of four pixels as it is measured on would seem three times as near.

    Raises
    ------
    ValueError
        If an image has the wrong shape, is too small or isn't finite, or ``max_patches`` is less than 1.
    """
    if max_patches < 1:
        raise ValueError(f"max_patches must be 1 or more, not {max_patches}")
    check_labs(exemplar_lab, image_lab, MIN_SIDE_PX, "bidirectional similarity")
    completeness = _nearest(_thinned(_patches(exemplar_lab), max_patches), image_lab)
    coherence = _nearest(_thinned(_patches(image_lab), max_patches), exemplar_lab)
    return Bidirectional(
        completeness_de76=float((np.sqrt(completeness) / PATCH_PX).mean()),
        coherence_de76=float((np.sqrt(coherence) / PATCH_PX).mean()),
    )


def nearest_squares(first: Matrix, second: Matrix) -> tuple[Matrix, Matrix]:
    """Squared Euclidean distance of each row to the nearest row of the other matrix, both ways in one pass.

    Parameters
    ----------
    first, second
        (n, values) and (m, values) float64.

    Returns
    -------
    of_first, of_second
        (n,) and (m,), exact but for rounding: equal rows may come out some 1e-15 of their squared length apart.
    """
    # Centred, so that little cancels in |a|^2 + |b|^2 - 2 a.b, which a matrix product does ten times as fast as a loop.
    centre = second.mean(axis=0)
    first, columns = first - centre, np.ascontiguousarray((second - centre).T)
    lengths_first, lengths_second = (first**2).sum(axis=1), (columns**2).sum(axis=0)
    of_first, of_second = np.empty(len(first)), np.full(len(second), np.inf)
    block = max(1, _BLOCK_VALUES // len(second))
    buffer = np.empty((block, len(second)))
    for begin in range(0, len(first), block):
        rows = first[begin : begin + block]
        squares = np.matmul(rows, columns, out=buffer[: len(rows)])
        squares *= -2
        squares += lengths_second
        squares += lengths_first[begin : begin + block, None]
        of_first[begin : begin + block] = squares.min(axis=1)
        np.minimum(of_second, squares.min(axis=0), out=of_second)
    return np.maximum(of_first, 0), np.maximum(of_second, 0)


def _nearest(patches: Matrix, lab: Array) -> Matrix:
    """Squared distance of each of some patches to the nearest of an image, shrunken from any pixel on."""
    squares = np.full(len(patches), np.inf)
    for row in range(min(SHRINK, lab.shape[0] - MIN_SIDE_PX + SHRINK)):
        for col in range(min(SHRINK, lab.shape[1] - MIN_SIDE_PX + SHRINK)):
            of_patches, _ = nearest_squares(patches, _listed(_patches(lab[row:, col:])))
            np.minimum(squares, of_patches, out=squares)
    return squares


def _patches(lab: Array) -> Matrix:
    """All patches of the shrunken image: (patch rows, patch cols, values)."""
    rows, cols = lab.shape[0] // SHRINK, lab.shape[1] // SHRINK
    blocks = lab[: rows * SHRINK, : cols * SHRINK].reshape(rows, SHRINK, cols, SHRINK, 3)
    small = blocks.mean(axis=(1, 3), dtype=np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(small, (PATCH_PX, PATCH_PX), axis=(0, 1))
    return windows.reshape(rows - PATCH_PX + 1, cols - PATCH_PX + 1, -1)


def _listed(patches: Matrix) -> Matrix:
    return patches.reshape(-1, patches.shape[2])


def _thinned(patches: Matrix, max_patches: int) -> Matrix:
    """At most so many patches, on the finest regular grid that keeps to it."""
    stride = 1
    while -(-patches.shape[0] // stride) * -(-patches.shape[1] // stride) > max_patches:
        stride += 1
    return _listed(patches[::stride, ::stride])
