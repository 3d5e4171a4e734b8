"""Several prepared slabs laid side by side in one base image, each pixel traceable to its slab."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tilefab.slab.checks import check_pair
from tilefab.slab.match import slab_colour
from tilefab.types import FloatImage, Mask, SizePx


@dataclass(frozen=True)
class SlabPlacement:
    """Where one slab lies in the atlas: its top left pixel and its size, in pixels."""

    slab_index: int
    row: int
    col: int
    rows: int
    cols: int


@dataclass(frozen=True)
class AtlasRecord:
    """What building the atlas did.

    Attributes
    ----------
    size
        Size of the atlas in pixels.
    placements
        One for each slab, in the order of the slabs.
    padding_frac
        Share of the atlas that belongs to no slab, 0 to 1.
    summary
        One sentence for the report.
    """

    size: SizePx
    placements: tuple[SlabPlacement, ...]
    padding_frac: float
    summary: str


def build_atlas(
    labs: Sequence[FloatImage], valids: Sequence[Mask], gap_px: int = 1
) -> tuple[FloatImage, Mask, AtlasRecord]:
    """Lay slabs side by side, upright, unscaled and unchanged.

    Parameters
    ----------
    labs
        One or more float32 images (rows, cols, 3); sizes may differ.
    valids
        Their masks.
    gap_px
        Invalid pixels kept between neighbours, >= 1.

    Returns
    -------
    lab
        float32; one slab alone is returned as it was given. Padding has the mean colour of the slabs, so that a filter
        reaching into it meets no edge of note.
    valid
        False in padding and wherever a slab's mask was.
    record

    Raises
    ------
    ValueError
        If the counts differ or are zero, an image breaks the conventions, or the gap is below 1.
    """
    if len(labs) != len(valids) or not labs:
        raise ValueError(f"{len(labs)} images with {len(valids)} masks: wanted one mask an image, at least one")
    if gap_px < 1:
        raise ValueError(f"gap of {gap_px} px: slabs must be at least 1 px apart")
    for lab, mask in zip(labs, valids, strict=True):
        check_pair(lab, mask)
    if len(labs) == 1:
        size = SizePx(*valids[0].shape)
        alone = AtlasRecord(
            size, (SlabPlacement(0, 0, 0, size.rows, size.cols),), 0.0, "nothing, because there is one slab only"
        )
        return labs[0], valids[0], alone
    size, placements = pack([SizePx(*mask.shape) for mask in valids], gap_px)
    means = np.array([slab_colour(lab, mask).mean for lab, mask in zip(labs, valids, strict=True)])
    out = np.empty((size.rows, size.cols, 3), np.float32)
    out[:] = means.mean(axis=0)
    out_valid = np.zeros((size.rows, size.cols), np.bool_)
    for place in placements:
        rows = slice(place.row, place.row + place.rows)
        cols = slice(place.col, place.col + place.cols)
        out[rows, cols] = labs[place.slab_index]
        out_valid[rows, cols] = valids[place.slab_index]
    used = sum(place.rows * place.cols for place in placements)
    padding = 1.0 - used / (size.rows * size.cols)
    summary = f"{len(labs)} slabs laid into {size.cols} x {size.rows} px, {100 * padding:.1f} % of it padding"
    return out, out_valid, AtlasRecord(size, placements, padding, summary)


def locate(placements: Sequence[SlabPlacement], row: int, col: int) -> tuple[int, int, int] | None:
    """Slab index, row and column in that slab of an atlas pixel; None in padding.

    >>> locate([SlabPlacement(0, 0, 0, 4, 4), SlabPlacement(1, 0, 5, 3, 2)], 2, 6)
    (1, 2, 1)
    """
    for place in placements:
        if place.row <= row < place.row + place.rows and place.col <= col < place.col + place.cols:
            return place.slab_index, row - place.row, col - place.col
    return None


def pack(sizes: Sequence[SizePx], gap_px: int) -> tuple[SizePx, tuple[SlabPlacement, ...]]:
    """Place rectangles on shelves, tallest first, at the width that wastes least.

    Every width at which some shelf would just fill is tried; the smallest area wins, then the shape nearest
    to a square, then the smaller width. Depends on nothing but its arguments.

    Parameters
    ----------
    sizes
        Sizes in pixels, in slab order.
    gap_px
        Free pixels between neighbours, >= 0.

    Returns
    -------
    size, placements
        Placements in slab order.
    """
    order = sorted(range(len(sizes)), key=lambda index: (-sizes[index].rows, -sizes[index].cols, index))
    widest = max(size.cols for size in sizes)
    widths = {widest}
    for start in range(len(order)):
        total = -gap_px
        for index in order[start:]:
            total += sizes[index].cols + gap_px
            widths.add(max(total, widest))
    best: tuple[tuple[int, int, int], SizePx, list[SlabPlacement]] | None = None
    for width in sorted(widths):
        size, places = _shelves(sizes, order, width, gap_px)
        score = (size.rows * size.cols, max(size.rows, size.cols), size.cols)
        if best is None or score < best[0]:
            best = (score, size, places)
    assert best is not None
    return best[1], tuple(sorted(best[2], key=lambda place: place.slab_index))


def _shelves(
    sizes: Sequence[SizePx], order: Sequence[int], width: int, gap_px: int
) -> tuple[SizePx, list[SlabPlacement]]:
    """First fit on shelves: each slab goes to the first shelf with room, else opens one below."""
    tops: list[int] = []
    ends: list[int] = []
    places: list[SlabPlacement] = []
    next_top = 0
    for index in order:
        size = sizes[index]
        for shelf, end in enumerate(ends):
            if end + gap_px + size.cols <= width:
                places.append(SlabPlacement(index, tops[shelf], end + gap_px, size.rows, size.cols))
                ends[shelf] = end + gap_px + size.cols
                break
        else:
            places.append(SlabPlacement(index, next_top, 0, size.rows, size.cols))
            tops.append(next_top)
            ends.append(size.cols)
            next_top += size.rows + gap_px
    return SizePx(rows=next_top - gap_px, cols=max(ends)), places
