"""Pieces of the exemplar that an image shows whole, and how often it shows the same place in one.

Small pieces may come back as often as they like: nobody knows them again. Large ones are known again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilefab.jit import kernel
from tilefab.types import Mask

LEAST_SHARE = 1 / 16
"""Area of a piece that is known again, over that of the exemplar."""
MAX_COPIES_OVER_RATIO = 1.5
"""How often a place may be shown in such pieces, over how many times larger the image is than the exemplar."""
_LEAST_COPIES = 2


@dataclass(frozen=True)
class Copies:
    """Large pieces of the exemplar in an image.

    Attributes
    ----------
    most
        How often the place shown most often is shown in pieces larger than the limit.
    over_ratio
        The same over the ratio of the image's area to the exemplar's: 1 if each place is shown once for each exemplar
        that the image could hold.
    largest_share
        Area of the largest piece over the exemplar's.
    place
        Row and column of the exemplar of the place shown most often.
    """

    most: int
    over_ratio: float
    largest_share: float
    place: tuple[int, int]

    @property
    def too_many(self) -> bool:
        """Whether a large piece comes back more often than its share, and is seen at least twice."""
        return self.most >= _LEAST_COPIES and self.over_ratio > MAX_COPIES_OVER_RATIO


def large_copies(
    source: NDArray[np.int32],
    exemplar_shape: tuple[int, int],
    *,
    least_share: float = LEAST_SHARE,
    known: Mask | None = None,
) -> Copies:
    """How often an image shows the same place of its exemplar in large pieces.

    Parameters
    ----------
    source
        (rows, cols) int32, flat index into the exemplar of each pixel.
    exemplar_shape
        Rows and columns of the exemplar.
    least_share
        Over 0: only pieces of a larger area, over the exemplar's, count.
    known
        (rows, cols), True where the map holds; other pixels belong to no piece. By default everywhere.

    Returns
    -------
    Copies
        A piece is what hangs together, by neighbours, at one offset into the exemplar, of any shape.

    Raises
    ------
    ValueError
        If a shape is wrong, the map empty or points outside the exemplar, or ``least_share`` isn't over 0.

    Examples
    --------
    >>> exemplar = np.arange(64, dtype=np.int32).reshape(8, 8)
    >>> twice = np.concatenate([exemplar[:, 4:], exemplar[:, 4:], exemplar[:, :1]], axis=1)
    >>> found = large_copies(twice, (8, 8))
    >>> found.most, round(found.over_ratio, 2), found.place
    (2, 1.78, (0, 4))
    """
    if source.ndim != 2 or source.size == 0:
        raise ValueError(f"a source map is (rows, cols) and not empty, not {source.shape}")
    if not least_share > 0:
        raise ValueError(f"a large piece is over 0 of the exemplar, not {least_share}")
    area = exemplar_shape[0] * exemplar_shape[1]
    if int(source.min()) < 0 or int(source.max()) >= area:
        raise ValueError(f"the source map points outside an exemplar of {tuple(exemplar_shape)}")
    on_map = np.ascontiguousarray(source, dtype=np.int32)
    holds = np.ones(source.shape, dtype=bool) if known is None else np.ascontiguousarray(known, dtype=bool)
    if holds.shape != source.shape:
        raise ValueError(f"the source map {source.shape} and what is known of it {holds.shape} differ in shape")
    count = np.zeros(area, dtype=np.int64)
    largest = _count_pieces(on_map, holds, exemplar_shape[1], int(least_share * area), count)
    place = int(count.argmax())
    return Copies(
        most=int(count[place]),
        over_ratio=float(count[place]) * area / source.size,
        largest_share=largest / area,
        place=(place // exemplar_shape[1], place % exemplar_shape[1]),
    )


@kernel
def _count_pieces(
    source: NDArray[np.int32], known: Mask, exemplar_cols: int, most_small: int, count: NDArray[np.int64]
) -> int:
    """Add 1 to each place for each piece of more pixels than ``most_small`` that shows it; returns the largest area.

    A piece holds no place twice, for all of it lies at one offset.
    """
    rows, cols = source.shape
    done = ~known
    stack = np.empty(source.size, dtype=np.int64)
    largest = 0
    for start in range(source.size):
        if done[start // cols, start % cols]:
            continue
        done[start // cols, start % cols] = True
        stack[0] = start
        # What is taken off stays below ``head`` as the list of the piece's pixels.
        head, size = 0, 1
        while head < size:
            r, c = stack[head] // cols, stack[head] % cols
            here = source[r, c]
            head += 1
            for side in range(4):
                down = (side == 0) - (side == 1)
                right = (side == 2) - (side == 3)
                r2, c2 = r + down, c + right
                if not (0 <= r2 < rows and 0 <= c2 < cols) or done[r2, c2]:
                    continue
                there = source[r2, c2]
                # The next index is no neighbour where a row of the exemplar ends.
                if (
                    there != here + down * exemplar_cols + right
                    or there // exemplar_cols != here // exemplar_cols + down
                ):
                    continue
                done[r2, c2] = True
                stack[size] = r2 * cols + c2
                size += 1
        largest = max(largest, size)
        if size > most_small:
            for k in range(size):
                count[source[stack[k] // cols, stack[k] % cols]] += 1
    return largest
