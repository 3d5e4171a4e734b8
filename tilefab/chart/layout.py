"""Where a chart's patches lie: dealt over tiles, shuffled, in a grid between four marks.

Everything is in whole pixels of the print, so that what is drawn and what is looked for in a scan are the same.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.chart.design import FULL, ChartDesign
from tilefab.chart.lettering import GLYPH_ROWS, letter_dots, row_name
from tilefab.chart.marks import CHARTS, MODULES, MOST_TILES, Mark, draw_mark
from tilefab.rng import generator
from tilefab.types import PrintImage, SizeMm, SizePx
from tilefab.units import px_from_mm, size_px_from_mm

LEAST_MARK_MM = 10.0
_MARK_SHARE = 0.025
_MARK_TOTAL = 2.4
"""Inks in a mark, at most: more would bleed and blur its edges."""

_LABEL_MM = 3.0
_LEAST_PATCH_PX = 12
_APART_CELLS = 3.0
_TRIES = 400


@dataclass(frozen=True, eq=False)
class ChartLayout:
    """A chart on its tiles.

    Attributes
    ----------
    dpi
        Resolution of the print.
    tile
        Size of a tile in pixels.
    patch_px, gap_px
        Side of a patch, and what is bare between two.
    margin_px
        What is bare along a tile's edges.
    module_px
        Side of a module of the marks.
    label_px
        Height of the bands for row and column names; 0 for none.
    tiles
        How many tiles.
    chart
        Number that tells this chart's marks from another's, 0 to 15.
    ink_counts
        (P, N) uint8 recipes, 255 = full ink.
    mark_counts
        (N,) uint8: the ink that marks and names are printed with.
    places
        (P, 3) int64: tile, row and column of each patch, from 0.
    """

    dpi: float
    tile: SizePx
    patch_px: int
    gap_px: int
    margin_px: int
    module_px: int
    label_px: int
    tiles: int
    chart: int
    ink_counts: NDArray[np.uint8] = field(repr=False)
    mark_counts: NDArray[np.uint8] = field(repr=False)
    places: NDArray[np.int64] = field(repr=False)

    @property
    def mark_px(self) -> int:
        """Side of a mark."""
        return MODULES * self.module_px

    @property
    def grid(self) -> SizePx:
        """Rows and columns of cells on a tile, those that the marks hide included."""
        pitch = self.patch_px + self.gap_px
        rows = (self.tile.rows - 2 * self.margin_px - 2 * self.label_px + self.gap_px) // pitch
        cols = (self.tile.cols - 2 * self.margin_px - self.label_px + self.gap_px) // pitch
        return SizePx(max(0, rows), max(0, cols))

    @property
    def origin(self) -> tuple[int, int]:
        """Row and column of the first cell's top left pixel."""
        pitch, grid = self.patch_px + self.gap_px, self.grid
        spare_rows = self.tile.rows - 2 * self.margin_px - 2 * self.label_px - grid.rows * pitch + self.gap_px
        spare_cols = self.tile.cols - 2 * self.margin_px - self.label_px - grid.cols * pitch + self.gap_px
        return self.margin_px + self.label_px + spare_rows // 2, self.margin_px + self.label_px + spare_cols // 2

    def cell_corner(self, row: int, col: int) -> tuple[int, int]:
        """Row and column of the top left pixel of a cell."""
        top, left = self.origin
        pitch = self.patch_px + self.gap_px
        return top + row * pitch, left + col * pitch

    def mark_corner(self, corner: int) -> tuple[int, int]:
        """Row and column of the top left pixel of the mark in a corner (0 top left, then clockwise)."""
        far_row = self.tile.rows - self.margin_px - self.mark_px
        far_col = self.tile.cols - self.margin_px - self.mark_px
        return (far_row if corner in (2, 3) else self.margin_px), (far_col if corner in (1, 2) else self.margin_px)

    def cells(self) -> NDArray[np.int64]:
        """(cells, 2) row and column of the cells that no mark hides, in reading order."""
        # Beside a mark, a module stays bare; names of rows and columns stand beyond that.
        clear = self.module_px + self.label_px
        out = []
        for row in range(self.grid.rows):
            for col in range(self.grid.cols):
                top, left = self.cell_corner(row, col)
                hidden = False
                for corner in range(4):
                    mark_top, mark_left = self.mark_corner(corner)
                    hidden |= (
                        top < mark_top + self.mark_px + clear
                        and top + self.patch_px > mark_top - clear
                        and left < mark_left + self.mark_px + clear
                        and left + self.patch_px > mark_left - clear
                    )
                if not hidden:
                    out.append((row, col))
        return np.array(out, dtype=np.int64).reshape(-1, 2)

    def on_tile(self, tile: int) -> NDArray[np.int64]:
        """Numbers of the patches on a tile, from 0."""
        return np.flatnonzero(self.places[:, 0] == tile)

    def location(self, patch: int) -> str:
        """Place of a patch as people say it: tile, row and column, say ``2-C7``."""
        tile, row, col = (int(value) for value in self.places[patch])
        return f"{tile + 1}-{row_name(row)}{col + 1}"


def mark_recipe(
    inks: int, full: NDArray[np.uint8], total_limit_percent: float, black_channel: int | None
) -> NDArray[np.uint8]:
    """The darkest mixture that is sure to be dark without knowing the press: black, and the others in equal parts.

    Parameters
    ----------
    inks
        How many.
    full
        (N,) counts of the most of each ink.
    total_limit_percent
        Most ink in all.
    black_channel
        Black, if any.

    Returns
    -------
    numpy.ndarray
        (N,) uint8 counts, within both limits.
    """
    limit = min(total_limit_percent / 100.0, _MARK_TOTAL) * FULL
    recipe = np.zeros(inks)
    rest = np.ones(inks, dtype=bool)
    if black_channel is not None:
        recipe[black_channel] = min(float(full[black_channel]), limit)
        rest[black_channel] = False
    if rest.any():
        recipe[rest] = np.minimum(full[rest], (limit - recipe.sum()) / int(rest.sum()))
    return np.floor(recipe).astype(np.uint8)


def lay_out_chart(
    design: ChartDesign,
    *,
    tile_mm: SizeMm,
    dpi: float,
    patch_mm: float,
    gap_mm: float = 1.0,
    margin_mm: float = 5.0,
    mark_mm: float | None = None,
    labels: bool = True,
    seed: int = 0,
) -> ChartLayout:
    """Deal a chart's recipes over tiles and shuffle them there; the same arguments give the same layout.

    Repeats of a recipe go to different tiles in turn, and on one tile to places apart.

    Parameters
    ----------
    design
        The recipes.
    tile_mm, dpi
        Size of a tile, and resolution of the print.
    patch_mm, gap_mm, margin_mm
        Side of a patch, what is bare between patches and along the edges.
    mark_mm
        Side of a mark; None: 10 mm, or 2.5 % of a longer side.
    labels
        Whether rows, columns and tiles are named in print.
    seed
        Of the order.

    Raises
    ------
    ValueError
        If patches are too small, a tile holds none, or too many tiles are needed.
    """
    tile = size_px_from_mm(tile_mm, dpi)
    mark = max(LEAST_MARK_MM, _MARK_SHARE * max(tile_mm.width, tile_mm.height)) if mark_mm is None else mark_mm
    module_px = max(1, round(px_from_mm(mark, dpi) / MODULES))
    patch_px, gap_px = px_from_mm(patch_mm, dpi), px_from_mm(gap_mm, dpi)
    if patch_px < _LEAST_PATCH_PX:
        raise ValueError(
            f"a patch of {patch_mm:g} mm has {patch_px} pixels at {dpi:g} dpi, but needs {_LEAST_PATCH_PX}"
        )
    if gap_px < 1:
        raise ValueError(f"a gap of {gap_mm:g} mm is less than a pixel at {dpi:g} dpi: patches would touch")
    full = design.ink_counts.max(axis=0)
    digest = hashlib.blake2b(design.ink_counts.tobytes() + f"{seed}".encode(), digest_size=1).digest()
    empty = ChartLayout(
        dpi=dpi,
        tile=tile,
        patch_px=patch_px,
        gap_px=gap_px,
        # A mark needs light on every side, and a scanner's lid may be dark.
        margin_px=max(module_px, px_from_mm(margin_mm, dpi)),
        module_px=module_px,
        label_px=px_from_mm(_LABEL_MM, dpi) if labels else 0,
        tiles=0,
        chart=digest[0] % CHARTS,
        ink_counts=design.ink_counts,
        mark_counts=mark_recipe(len(full), full, design.total_limit_percent, design.black_channel),
        places=np.empty((0, 3), dtype=np.int64),
    )
    crowded = 2 * (empty.mark_px + empty.margin_px + module_px) > min(tile.rows, tile.cols)
    cells = empty.cells()
    if crowded or len(cells) == 0:
        raise ValueError(
            f"a tile of {tile_mm.width:g} x {tile_mm.height:g} mm holds no patch of {patch_mm:g} mm beside its marks"
        )
    patches = len(design.ink_counts)
    tiles = -(-patches // len(cells))
    if tiles > MOST_TILES:
        raise ValueError(f"{patches} patches need {tiles} tiles, but {MOST_TILES} are the most: make patches smaller")
    return ChartLayout(**{**empty.__dict__, "tiles": tiles, "places": _deal(design, cells, tiles, seed)})


def _deal(design: ChartDesign, cells: NDArray[np.int64], tiles: int, seed: int) -> NDArray[np.int64]:
    random = generator(seed, "chart order")
    patches = len(design.ink_counts)
    group = np.where(design.repeat_of < 0, np.arange(patches), design.repeat_of)
    order = random.permutation(patches)
    # Members of a group come one after another, and are dealt to one tile after another.
    rank = np.empty(patches, dtype=np.int64)
    rank[order] = np.arange(patches)
    order = order[np.argsort(rank[group[order]], kind="stable")]
    places = np.empty((patches, 3), dtype=np.int64)
    for tile in range(tiles):
        dealt = order[tile::tiles]
        dealt = dealt[random.permutation(len(dealt))]
        for _ in range(_TRIES):
            near = _too_near(group[dealt], cells)
            if near is None:
                break
            other = int(random.integers(len(dealt)))
            dealt[[near, other]] = dealt[[other, near]]
        places[dealt, 0] = tile
        places[dealt, 1:] = cells[: len(dealt)]
    return places


def _too_near(group: NDArray[np.int64], cells: NDArray[np.int64]) -> int | None:
    """Place of a patch whose like lies within a few cells of it; None if there is none."""
    numbers, counts = np.unique(group, return_counts=True)
    for number in numbers[counts > 1]:
        members = np.flatnonzero(group == number)
        apart = np.linalg.norm(cells[members][:, np.newaxis] - cells[members][np.newaxis], axis=2)
        np.fill_diagonal(apart, np.inf)
        if apart.min() < _APART_CELLS:
            return int(members[int(np.argmin(apart.min(axis=1)))])
    return None


def render_tile(layout: ChartLayout, tile: int, *, bits: int = 8) -> PrintImage:
    """Print data of one tile of a chart.

    Parameters
    ----------
    layout
        The chart.
    tile
        Which tile, from 0.
    bits
        8 or 16.

    Returns
    -------
    numpy.ndarray
        (rows, cols, N) uint8 or uint16, 0 = no ink. At 16 bits a count of 255ths becomes 257 counts: the same amount.

    Raises
    ------
    ValueError
        If there is no such tile, or ``bits`` is another number.
    """
    if not 0 <= tile < layout.tiles:
        raise ValueError(f"tile {tile} is not one of {layout.tiles}")
    if bits not in (8, 16):
        raise ValueError(f"{bits} bits are not 8 or 16")
    inks = layout.ink_counts.shape[1]
    image = np.zeros((layout.tile.rows, layout.tile.cols, inks), dtype=np.uint8)
    for patch in layout.on_tile(tile):
        top, left = layout.cell_corner(int(layout.places[patch, 1]), int(layout.places[patch, 2]))
        image[top : top + layout.patch_px, left : left + layout.patch_px] = layout.ink_counts[patch]
    for corner in range(4):
        top, left = layout.mark_corner(corner)
        modules = draw_mark(Mark(corner, tile, layout.chart))
        _stamp(image, top, left, modules, layout.module_px, layout.mark_counts)
    if layout.label_px:
        _draw_names(layout, tile, image)
    return image if bits == 8 else image.astype(np.uint16) * np.uint16(257)


def _stamp(
    image: NDArray[np.uint8], top: int, left: int, dots: NDArray[np.bool_], dot_px: int, counts: NDArray[np.uint8]
) -> None:
    """Print dots, each a square of ``dot_px``; what is beyond the image is left out."""
    large = np.kron(dots, np.ones((dot_px, dot_px), dtype=bool))
    part = image[max(0, top) : top + large.shape[0], max(0, left) : left + large.shape[1]]
    part[large[: part.shape[0], : part.shape[1]]] = counts


def _draw_names(layout: ChartLayout, tile: int, image: NDArray[np.uint8]) -> None:
    dot = max(1, layout.label_px // (GLYPH_ROWS + 3))
    cells = layout.cells()
    used = layout.places[layout.on_tile(tile), 1:]
    half = layout.patch_px // 2
    for row in np.unique(used[:, 0]):
        dots = letter_dots(row_name(int(row)))
        col = int(cells[cells[:, 0] == row, 1].min())
        top, left = layout.cell_corner(int(row), col)
        fits = dot if dots.shape[1] * dot <= layout.label_px - dot else max(1, (layout.label_px - dot) // dots.shape[1])
        where = top + half - GLYPH_ROWS * fits // 2, left - (dots.shape[1] + 1) * fits - layout.gap_px // 2
        _stamp(image, *where, dots, fits, layout.mark_counts)
    for col in np.unique(used[:, 1]):
        dots = letter_dots(str(int(col) + 1))
        row = int(cells[cells[:, 1] == col, 0].min())
        top, left = layout.cell_corner(row, int(col))
        where = top - (GLYPH_ROWS + 1) * dot - layout.gap_px // 2, left + half - dots.shape[1] * dot // 2
        _stamp(image, *where, dots, dot, layout.mark_counts)
    title = letter_dots(f"TILE {tile + 1}/{layout.tiles} CHART {row_name(layout.chart)}")
    _, mark_left = layout.mark_corner(3)
    left = mark_left + layout.mark_px + 2 * layout.module_px
    room = layout.tile.cols - 2 * left
    dot = min(dot, room // title.shape[1])
    if dot >= 1:
        top = layout.cell_corner(layout.grid.rows - 1, 0)[0] + layout.patch_px + layout.gap_px
        _stamp(
            image,
            max(top, layout.tile.rows - layout.margin_px - GLYPH_ROWS * dot),
            left,
            title,
            dot,
            layout.mark_counts,
        )
