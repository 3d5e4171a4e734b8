"""Colours of a chart from scans of its tiles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tilefab.chart.reading import TileReading, read_tiles
from tilefab.colour import Intent, delta_e_2000, lab_from_xyz, scan_to_xyz
from tilefab.errors import ImageError, ProfileError
from tilefab.io.chart_list import ChartList
from tilefab.io.icc import read_icc_profile
from tilefab.io.scans import Scan, read_scan
from tilefab.pipeline.chart_colours import ChartColours, ScanNote, patch_note
from tilefab.types import Array
from tilefab.units import mm_from_px

_SPOILED = 0.4
_CLIPPED = 0.998
_TILES_DIFFER = 1.0


def colours_from_scans(
    chart: ChartList, sources: Sequence[Path], profile: Path | None, even_light: bool, threads: int
) -> ChartColours:
    """Colours of a chart from scans that show every tile once.

    Raises
    ------
    ProfileError
        If a tile is missing or shown twice, a scan shows no tile, or a profile can't be used.
    ImageError
        If a scan can't be read, or is CMYK.
    """
    layout = chart.layout
    patches = len(layout.ink_counts)
    out = ChartColours(np.full((patches, 3), np.nan), np.zeros(patches, dtype=bool))
    given = None if profile is None else read_icc_profile(profile).data
    shown: dict[int, Path] = {}
    for source in sources:
        scan = read_scan(source)
        if scan.pixels.shape[2] == 4:
            raise ImageError(f"{source}: is a CMYK image, which no scanner sees: scan as RGB", path=str(source))
        for reading in _tiles_of(scan, source, chart, given, even_light, threads, out.warnings):
            tile = reading.pose.tile
            if tile in shown:
                raise ProfileError(
                    f"{source}: shows tile {tile + 1}, as {shown[tile]} does: give every tile once", path=str(source)
                )
            shown[tile] = source
            _take(chart, source, reading, out)
    missing = [str(tile + 1) for tile in range(layout.tiles) if tile not in shown]
    if missing:
        raise ProfileError(
            f"{sources[-1]}: no scan shows tile {', '.join(missing)} of {layout.tiles}: scan the whole chart",
            path=str(sources[-1]),
        )
    _compare_whites(chart, out)
    return out


def _tiles_of(
    scan: Scan,
    source: Path,
    chart: ChartList,
    profile: bytes | None,
    even_light: bool,
    threads: int,
    warnings: list[str],
) -> tuple[TileReading, ...]:
    used = scan.icc_profile if profile is None else profile
    if used is None:
        warnings.append(f"{source.name} has no profile: its colours are taken as sRGB, and are only as good as that")
    # A scanner's profile knows its target's white; a working space that a scan was converted to has none but its own.
    intent: Intent = "absolute" if used is not None and used[12:16] == b"scnr" else "relative"

    def to_xyz(pixels: Array) -> Array:
        try:
            return scan_to_xyz(np.ascontiguousarray(pixels), used, intent=intent, threads=threads)
        except ProfileError as error:
            raise ProfileError(f"{source}: {error.message}", path=str(source)) from error

    return read_tiles(scan.pixels, chart.layout, to_xyz, even_light=even_light, name=str(source))


def _take(chart: ChartList, source: Path, reading: TileReading, out: ChartColours) -> None:
    pose, layout = reading.pose, chart.layout
    out.lab_d50[reading.patches] = lab_from_xyz(reading.xyz_d50)
    out.kept[reading.patches] = reading.left_out <= _SPOILED
    scan_dpi = layout.dpi * pose.scale
    out.scans.append(
        ScanNote(
            file=str(source),
            tile=pose.tile + 1,
            marks=pose.marks,
            turn_degrees=round(pose.turn_degrees, 2),
            scan_dpi=round(scan_dpi, 1),
            residual_mm=round(mm_from_px(pose.residual_px, scan_dpi), 4),
            lighting_percent=None if reading.lighting_percent is None else round(reading.lighting_percent, 2),
        )
    )
    for place in np.flatnonzero(reading.defect):
        share = 100.0 * reading.left_out[place]
        what = f"defect, {share:.0f} % left out" if share else "uneven"
        out.notes.append(patch_note(chart, int(reading.patches[place]), what, float(reading.spread_delta_e[place])))
    if pose.marks < 4:
        out.warnings.append(f"{source.name}: {pose.marks} of the 4 marks of tile {pose.tile + 1} were found")
    clipped = int((reading.xyz_d50[:, 1] > _CLIPPED).sum())
    if clipped:
        out.warnings.append(f"{source.name}: {clipped} patches are as light as the scan can show: scan darker")


def _compare_whites(chart: ChartList, out: ChartColours) -> None:
    bare = (chart.layout.ink_counts == 0).all(axis=1) & out.kept
    tiles = chart.layout.places[:, 0]
    whites = {int(tile): out.lab_d50[bare & (tiles == tile)].mean(axis=0) for tile in np.unique(tiles[bare])}
    first = next(iter(whites), None)
    for tile, white in whites.items():
        away = float(delta_e_2000(white, whites[first])) if first is not None else 0.0
        if away > _TILES_DIFFER:
            out.warnings.append(
                f"bare patches of tiles {(first or 0) + 1} and {tile + 1} differ by ΔE {away:.1f}: scan all tiles "
                "alike, and print on tiles of one shade"
            )
