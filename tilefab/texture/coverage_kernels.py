"""Where the patches of one image lie in another: a search that spreads what it finds to the neighbours.

PatchMatch (Barnes et al. 2009, "PatchMatch: a randomized correspondence algorithm for structural image editing",
section 3), whose random numbers are hashes of place and round, so that a search always ends the same.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import Mask

FRESH_DRAWS = 2
"""Places anywhere in the exemplar that each patch tries in a round, besides those around the best so far."""
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_STEP = np.uint64(0x9E3779B97F4A7C15)


@kernel
def hashed(place: int, round_: int, draw: int) -> np.uint64:
    """64 bits that look random: the finaliser of SplitMix64 (Steele et al. 2014), over three numbers.

    Parameters
    ----------
    place, round_, draw
        Integers from 0; the last two below 2**16.
    """
    x = (np.uint64(place) << np.uint64(32)) | (np.uint64(round_) << np.uint64(16)) | np.uint64(draw)
    x = (x + np.uint64(1)) * _STEP
    x = (x ^ (x >> np.uint64(30))) * _MIX_1
    x = (x ^ (x >> np.uint64(27))) * _MIX_2
    return x ^ (x >> np.uint64(31))


@kernel
def squares_between(
    image: NDArray[np.int16],
    exemplar: NDArray[np.int16],
    image_row: int,
    image_col: int,
    row: int,
    col: int,
    side: int,
    enough: int,
) -> int:
    """Sum of squared differences of two patches by their upper left corners, given up once it reaches ``enough``."""
    total = 0
    for r in range(side):
        for c in range(side):
            for k in range(image.shape[2]):
                d = int(image[image_row + r, image_col + c, k]) - int(exemplar[row + r, col + c, k])
                total += d * d
        if total >= enough:
            return total
    return total


@kernel
def match_patches(
    image: NDArray[np.int16],
    exemplar: NDArray[np.int16],
    usable: Mask,
    listed: NDArray[np.int32],
    side: int,
    rounds: int,
    places: NDArray[np.int32],
    squares: NDArray[np.int64],
) -> None:
    """Find for each patch of an image a patch of the exemplar that is like it. Twin: in the tests.

    Parameters
    ----------
    image, exemplar
        (rows, cols, channels) int16, no smaller than a patch.
    usable
        (exemplar rows - side + 1, exemplar cols - side + 1), True where a patch may be.
    listed
        Those places, flat indices into ``usable``; at least one.
    side
        Of a patch, in pixels.
    rounds
        Passes over the image, by turns forwards and backwards.
    places, squares
        (image rows - side + 1, image cols - side + 1), filled: flat index into ``usable`` of the best patch found, and
        its sum of squared differences.
    """
    rows, cols = places.shape
    exemplar_rows, exemplar_cols = usable.shape
    for r in range(rows):
        for c in range(cols):
            flat = listed[hashed(r * cols + c, 0, 0) % np.uint64(len(listed))]
            places[r, c] = flat
            squares[r, c] = squares_between(
                image, exemplar, r, c, flat // exemplar_cols, flat % exemplar_cols, side, 1 << 62
            )
    for round_ in range(1, rounds + 1):
        step = 1 if round_ % 2 == 1 else -1
        for i in range(rows):
            r = i if step == 1 else rows - 1 - i
            for j in range(cols):
                c = j if step == 1 else cols - 1 - j
                if squares[r, c] == 0:
                    continue
                # What the neighbours found, carried on.
                for down in range(2):
                    r2, c2 = r - step * down, c - step * (1 - down)
                    if not (0 <= r2 < rows and 0 <= c2 < cols):
                        continue
                    row = places[r2, c2] // exemplar_cols + step * down
                    col = places[r2, c2] % exemplar_cols + step * (1 - down)
                    if 0 <= row < exemplar_rows and 0 <= col < exemplar_cols and usable[row, col]:
                        found = squares_between(image, exemplar, r, c, row, col, side, squares[r, c])
                        if found < squares[r, c]:
                            squares[r, c], places[r, c] = found, row * exemplar_cols + col
                for draw in range(FRESH_DRAWS):
                    flat = listed[hashed(r * cols + c, round_, draw) % np.uint64(len(listed))]
                    found = squares_between(
                        image, exemplar, r, c, flat // exemplar_cols, flat % exemplar_cols, side, squares[r, c]
                    )
                    if found < squares[r, c]:
                        squares[r, c], places[r, c] = found, flat
                reach = max(exemplar_rows, exemplar_cols) // 2
                draw = FRESH_DRAWS
                while reach >= 1:
                    bits = hashed(r * cols + c, round_, draw)
                    width = np.uint64(2 * reach + 1)
                    row = places[r, c] // exemplar_cols + np.int64(bits % width) - reach
                    col = places[r, c] % exemplar_cols + np.int64((bits >> np.uint64(32)) % width) - reach
                    if 0 <= row < exemplar_rows and 0 <= col < exemplar_cols and usable[row, col]:
                        found = squares_between(image, exemplar, r, c, row, col, side, squares[r, c])
                        if found < squares[r, c]:
                            squares[r, c], places[r, c] = found, row * exemplar_cols + col
                    reach //= 2
                    draw += 1


@kernel
def extend_pieces(
    image: NDArray[np.int16],
    exemplar: NDArray[np.int16],
    valid: Mask,
    most_square: int,
    source: NDArray[np.int32],
    known: Mask,
) -> None:
    """Let pieces whose place is known grow over neighbours that go on as the exemplar does. Twin: in the tests.

    Parameters
    ----------
    image, exemplar
        (rows, cols, channels) int16.
    valid
        (exemplar rows, exemplar cols), True where a piece may lie.
    most_square
        The greatest squared difference of a pixel that still counts as the exemplar's.
    source, known
        (rows, cols) source map, and where it holds for certain; both are changed.
    """
    rows, cols = source.shape
    exemplar_rows, exemplar_cols = valid.shape
    changed, forwards = True, True
    while changed:
        changed = False
        for i in range(rows):
            r = i if forwards else rows - 1 - i
            for j in range(cols):
                c = j if forwards else cols - 1 - j
                if known[r, c]:
                    continue
                best, place = most_square + 1, -1
                for side in range(4):
                    down = (side == 0) - (side == 1)
                    right = (side == 2) - (side == 3)
                    r2, c2 = r + down, c + right
                    if not (0 <= r2 < rows and 0 <= c2 < cols and known[r2, c2]):
                        continue
                    row, col = source[r2, c2] // exemplar_cols - down, source[r2, c2] % exemplar_cols - right
                    if not (0 <= row < exemplar_rows and 0 <= col < exemplar_cols and valid[row, col]):
                        continue
                    square = squares_between(image, exemplar, r, c, row, col, 1, best)
                    if square < best:
                        best, place = square, row * exemplar_cols + col
                if place >= 0:
                    source[r, c], known[r, c], changed = place, True, True
        forwards = not forwards
