"""Kernels of recognition: a face's cells gathered from an image, and codes compared bit by bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel

_PAIRS = np.uint64(0x5555555555555555)
_FOURS = np.uint64(0x3333333333333333)
_EIGHTS = np.uint64(0x0F0F0F0F0F0F0F0F)
_SUM = np.uint64(0x0101010101010101)
_S1, _S2, _S4, _S56 = np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)


@kernel
def gather_cells(
    light: NDArray[np.float32],
    mask: NDArray[np.bool_],
    matrix: NDArray[np.float64],
    sub: int,
    mean: NDArray[np.float32],
    share: NDArray[np.float32],
) -> None:
    """Mean light of each cell of a grid over a face, and which share of the cell is seen.

    ``matrix`` takes (x, y, 1) in cells to pixels of the image, pixel centres at +0.5. ``sub`` x ``sub`` places of each
    cell are looked up, each at the pixel it falls into; within a cell the matrix is taken as affine. A cell of which
    nothing is seen has a mean of 0.
    """
    rows, cols = mean.shape
    high, wide = light.shape
    step = 1.0 / sub
    for row in range(rows):
        for col in range(cols):
            x, y = col + 0.5, row + 0.5
            depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
            over = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth
            down = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth
            over_x, over_y = (matrix[0, 0] - over * matrix[2, 0]) / depth, (matrix[0, 1] - over * matrix[2, 1]) / depth
            down_x, down_y = (matrix[1, 0] - down * matrix[2, 0]) / depth, (matrix[1, 1] - down * matrix[2, 1]) / depth
            total, count = np.float32(0.0), 0
            for i in range(sub):
                dy = (i + 0.5) * step - 0.5
                for j in range(sub):
                    dx = (j + 0.5) * step - 0.5
                    p, q = down + down_x * dx + down_y * dy, over + over_x * dx + over_y * dy
                    if p >= 0.0 and q >= 0.0 and p < high and q < wide:
                        k, m = int(p), int(q)
                        if mask[k, m]:
                            total += light[k, m]
                            count += 1
            mean[row, col] = total / np.float32(max(count, 1))
            share[row, col] = count * step * step


@kernel
def average_cells(view: NDArray[np.float32], mean: NDArray[np.float32]) -> None:
    """Means of a picture over even cells (rows, cols), pixels that lie in several cells being shared out by area."""
    rows, cols = mean.shape
    down, across = view.shape[0] / rows, view.shape[1] / cols
    for row in range(rows):
        top, bottom = row * down, (row + 1) * down
        for col in range(cols):
            left, right = col * across, (col + 1) * across
            total = 0.0
            for i in range(int(top), min(int(np.ceil(bottom)), view.shape[0])):
                high = min(bottom, i + 1.0) - max(top, float(i))
                line = 0.0
                for j in range(int(left), min(int(np.ceil(right)), view.shape[1])):
                    line += view[i, j] * (min(right, j + 1.0) - max(left, float(j)))
                total += line * high
            mean[row, col] = total / (down * across)


@kernel
def count_differing(
    codes: NDArray[np.uint64], wanted: NDArray[np.uint64], masks: NDArray[np.uint64], out: NDArray[np.int32]
) -> None:
    """For each of the codes (F, W), in how many bits of masks (T, W) it differs from T codes (T, W); (T, F)."""
    turns, words = wanted.shape
    for face in range(len(codes)):
        for turn in range(turns):
            total = np.uint64(0)
            for word in range(words):
                bits = (codes[face, word] ^ wanted[turn, word]) & masks[turn, word]
                bits = bits - ((bits >> _S1) & _PAIRS)
                bits = (bits & _FOURS) + ((bits >> _S2) & _FOURS)
                bits = (bits + (bits >> _S4)) & _EIGHTS
                total += (bits * _SUM) >> _S56
            out[turn, face] = np.int32(total)
