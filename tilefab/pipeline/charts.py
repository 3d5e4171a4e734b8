"""Characterisation charts as files: print files and list of a new one, and measurements from what came back."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from tilefab.chart import design_chart, lay_out_chart, render_tile
from tilefab.colour.inks import black_channel
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.chart_list import chart_text
from tilefab.io.faces import PrintTags, write_print_tiff
from tilefab.types import SizeMm

CMYK_NAMES = ("Cyan", "Magenta", "Yellow", "Black")


@dataclass(frozen=True)
class ChartSettings:
    """What a chart is to be.

    Attributes
    ----------
    ink_names
        1 to 8 names, in channel order; one called Black (or K) is laid out as black.
    patches
        How many in all.
    tile_mm, dpi
        Size of a tile, and resolution of the print.
    patch_mm, gap_mm, margin_mm
        Side of a patch, and what is bare between patches and along the edges.
    ink_limit_percent
        Most ink in all; None: 300, or all inks together if that is less.
    seed
        Of recipes and order.
    bits
        8 or 16 of the print files.
    labels
        Whether rows, columns and tiles are named in print.
    """

    ink_names: tuple[str, ...] = CMYK_NAMES
    patches: int = 800
    tile_mm: SizeMm = field(default_factory=lambda: SizeMm(300.0, 300.0))
    dpi: float = 360.0
    patch_mm: float = 8.0
    gap_mm: float = 1.0
    margin_mm: float = 5.0
    ink_limit_percent: float | None = None
    seed: int = 0
    bits: int = 8
    labels: bool = True


@dataclass(frozen=True)
class ChartReport:
    """What was made of a chart.

    Attributes
    ----------
    files
        Print files, one a tile.
    list_file
        The chart's CGATS list.
    patches, tiles
        How many.
    patches_per_tile
        How many on each tile.
    grid
        Rows and columns of cells on a tile.
    kinds
        How many patches there are of each kind.
    ink_names
        Inks in channel order.
    ink_limit_percent
        Most ink that any patch may have in all.
    most_ink_percent
        Most ink that any patch has.
    """

    files: tuple[str, ...]
    list_file: str
    patches: int
    tiles: int
    patches_per_tile: tuple[int, ...]
    grid: tuple[int, int]
    kinds: dict[str, int]
    ink_names: tuple[str, ...]
    ink_limit_percent: float
    most_ink_percent: float


def make_chart(stem: Path, settings: ChartSettings, *, created: str) -> ChartReport:
    """Write a chart: ``STEM_1.tif`` and on, a print file for each tile, and ``STEM.cgats``, its list.

    The list is written last: where there is one, the print files are whole.

    Parameters
    ----------
    stem
        Path and beginning of the names.
    settings
        What the chart is to be.
    created
        The day, as ``2026-11-24``.

    Raises
    ------
    ValueError
        If the settings can't be met; the message says which and why.
    OutputError
        If a file can't be written.
    """
    names = settings.ink_names
    if any("," in name or not name.strip() for name in names) or len(set(names)) != len(names):
        raise ValueError("inks need names that differ and have no commas")
    limit = min(300.0, 100.0 * len(names)) if settings.ink_limit_percent is None else settings.ink_limit_percent
    design = design_chart(
        len(names),
        settings.patches,
        total_limit_percent=limit,
        black_channel=black_channel(names),
        seed=settings.seed,
    )
    layout = lay_out_chart(
        design,
        tile_mm=settings.tile_mm,
        dpi=settings.dpi,
        patch_mm=settings.patch_mm,
        gap_mm=settings.gap_mm,
        margin_mm=settings.margin_mm,
        labels=settings.labels,
        seed=settings.seed,
    )
    files = []
    for tile in range(layout.tiles):
        path = stem.with_name(f"{stem.name}_{tile + 1}.tif")
        tags = PrintTags(
            dpi=settings.dpi,
            icc_profile=None,
            ink_names=names,
            description=f"tilefab chart tile={tile + 1}/{layout.tiles} number={layout.chart} seed={settings.seed}",
            compression="lzw",
        )
        write_print_tiff(path, render_tile(layout, tile, bits=settings.bits), tags)
        files.append(str(path))
    list_file = stem.with_name(f"{stem.name}.cgats")
    text = chart_text(
        layout,
        ink_names=names,
        kinds=design.kinds,
        description=f"chart of {settings.patches} patches, {len(names)} inks",
        created=created,
    )
    atomic_write_bytes(list_file, text.encode("utf-8"))
    return ChartReport(
        files=tuple(files),
        list_file=str(list_file),
        patches=settings.patches,
        tiles=layout.tiles,
        patches_per_tile=tuple(len(layout.on_tile(tile)) for tile in range(layout.tiles)),
        grid=(layout.grid.rows, layout.grid.cols),
        kinds=dict(Counter(design.kinds)),
        ink_names=names,
        ink_limit_percent=limit,
        most_ink_percent=float(design.ink_percent.sum(axis=1).max()),
    )
