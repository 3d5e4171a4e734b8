"""From a printed chart back to measurements: out of scans of its tiles, or out of an instrument's files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tilefab.chart.reading import TileReading, read_tiles
from tilefab.chart.repeats import RepeatCheck, check_repeats
from tilefab.colour import Intent, delta_e_2000, lab_from_xyz, scan_to_xyz, xyz_from_lab
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes
from tilefab.io.cgats import Readings, read_readings
from tilefab.io.cgats_write import measurements_text
from tilefab.io.chart_list import ChartList, read_chart_list
from tilefab.io.icc import read_icc_profile
from tilefab.io.scans import Scan, read_scan
from tilefab.types import Array

Float64Array = NDArray[np.float64]

_SPOILED = 0.4
_CLIPPED = 0.998
_TILES_DIFFER = 1.0
_NOISE_TOO_FAR = 3.0
_DARKENING = -0.3
_INK_SLACK = 0.006
_SNIFFED_BYTES = 4096


@dataclass(frozen=True)
class PatchNote:
    """Something about one patch.

    Attributes
    ----------
    sample, location
        Its name and place.
    what
        What is wrong with it.
    delta_e
        By how much: its unevenness (CIE76) or difference from its repeats (CIEDE2000).
    """

    sample: str
    location: str
    what: str
    delta_e: float


@dataclass(frozen=True)
class ScanNote:
    """How one tile lay in a scan.

    Attributes
    ----------
    file, tile
        The scan, and which tile it shows, from 1.
    marks
        How many of the four marks were found.
    turn_degrees
        How far it was turned clockwise.
    scan_dpi
        Resolution of the scan on the tile, if the tile kept its size in the kiln.
    residual_mm
        How far the marks lie from where they should, root mean square.
    lighting_percent
        Range of the light that was taken out; None where it was left.
    """

    file: str
    tile: int
    marks: int
    turn_degrees: float
    scan_dpi: float
    residual_mm: float
    lighting_percent: float | None


@dataclass(frozen=True)
class ReadingReport:
    """What was read of a chart, and what the operator should know.

    Attributes
    ----------
    output
        The measurement file.
    patches
        How many it holds.
    ink_names
        Inks in channel order.
    bands
        Bands of its spectra, 0 for none.
    repeated, noise_delta_e
        How many recipes are there more than once, and how much patches of one recipe typically differ (CIEDE2000 from
        their median).
    notes
        Patches with a defect, or that disagree with their repeats.
    left_out
        Samples that are not in the file, for nothing sound was left of them.
    scans
        How the tiles lay.
    warnings
        A sentence each.
    """

    output: str
    patches: int
    ink_names: tuple[str, ...]
    bands: int
    repeated: int
    noise_delta_e: float | None
    notes: tuple[PatchNote, ...]
    left_out: tuple[str, ...]
    scans: tuple[ScanNote, ...]
    warnings: tuple[str, ...]


@dataclass
class _Read:
    """Colours of a chart's patches while they come in."""

    lab: Float64Array
    reflectance: Float64Array | None
    wavelengths_nm: Float64Array | None
    kept: NDArray[np.bool_]
    notes: list[PatchNote]
    scans: list[ScanNote]
    warnings: list[str]


def read_chart(
    chart_file: Path,
    sources: Sequence[Path],
    output: Path,
    *,
    created: str,
    scan_profile: Path | None = None,
    even_light: bool = True,
    threads: int = 2,
) -> ReadingReport:
    """Make a measurement file of a chart's scans, or of what an instrument measured on it.

    Parameters
    ----------
    chart_file
        The chart's list, as `tilefab.pipeline.charts.make_chart` wrote it.
    sources
        Scans that show every tile once, or CGATS files that hold every patch.
    output
        ``.ti3`` file to write.
    created
        The day, as ``2026-11-24``.
    scan_profile
        ICC profile of the scanner; None takes what each scan embeds, or sRGB.
    even_light
        Whether to take the scanner's uneven light out.
    threads
        Changes nothing but the time.

    Raises
    ------
    ProfileError
        If the list, a measurement or a profile can't be used, or tiles or patches are missing, shown twice or unknown.
    ImageError
        If a scan can't be read.
    OutputError
        If the file can't be written.
    """
    chart = read_chart_list(chart_file)
    if not sources:
        raise ProfileError(f"{chart_file}: no scan or measurement to read is named", path=str(chart_file))
    texts = [_is_text(source) for source in sources]
    if any(texts) != all(texts):
        raise ProfileError(
            f"{sources[texts.index(False)]}: is a scan among measurement files: give one or the other",
            path=str(sources[texts.index(False)]),
        )
    read = (
        _from_instrument(chart, sources)
        if all(texts)
        else _from_scans(chart, sources, scan_profile, even_light, threads)
    )
    repeats = check_repeats(chart.layout.ink_counts[read.kept], read.lab[read.kept])
    _judge(chart, read, repeats)
    kept = np.flatnonzero(read.kept)
    text = measurements_text(
        chart.layout.ink_counts[kept] / 255.0,
        read.lab[kept],
        ink_names=chart.ink_names,
        description=f"{chart.description}, from {', '.join(source.name for source in sources)}",
        created=created,
        reflectance=None if read.reflectance is None else read.reflectance[kept],
        wavelengths_nm=read.wavelengths_nm,
        sample_ids=[chart.sample_ids[patch] for patch in kept],
        locations=[chart.locations[patch] for patch in kept],
    )
    atomic_write_bytes(output, text.encode("utf-8"))
    return ReadingReport(
        output=str(output),
        patches=len(kept),
        ink_names=chart.ink_names,
        bands=0 if read.wavelengths_nm is None else len(read.wavelengths_nm),
        repeated=repeats.groups,
        noise_delta_e=repeats.noise_delta_e,
        notes=tuple(read.notes),
        left_out=tuple(chart.sample_ids[patch] for patch in np.flatnonzero(~read.kept)),
        scans=tuple(read.scans),
        warnings=tuple(read.warnings),
    )


def _is_text(path: Path) -> bool:
    """Whether a file is text rather than an image."""
    try:
        with path.open("rb") as stream:
            return b"\0" not in stream.read(_SNIFFED_BYTES)
    except OSError as error:
        raise ProfileError(f"{path}: can't be read: {error.strerror}: check the path", path=str(path)) from error


def _judge(chart: ChartList, read: _Read, repeats: RepeatCheck) -> None:
    """Note what looks wrong with the colours as a whole."""
    kept = np.flatnonzero(read.kept)
    for place in np.flatnonzero(repeats.disagree):
        patch = int(kept[place])
        read.notes.append(_note(chart, patch, "differs from its repeats", float(repeats.delta_e[place])))
    if repeats.noise_delta_e is not None and repeats.noise_delta_e > _NOISE_TOO_FAR:
        read.warnings.append(
            f"repeats of a recipe differ by ΔE {repeats.noise_delta_e:.1f}: are these colours of this chart, in "
            "its order?"
        )
    total = chart.layout.ink_counts[kept].sum(axis=1)
    if len(kept) > 2 and np.ptp(total) and np.ptp(read.lab[kept, 0]):
        darkening = float(stats.spearmanr(total, read.lab[kept, 0]).statistic)
        if darkening > _DARKENING:
            read.warnings.append("more ink doesn't make it darker: are these colours of this chart, in its order?")


def _note(chart: ChartList, patch: int, what: str, delta_e: float) -> PatchNote:
    return PatchNote(chart.sample_ids[patch], chart.locations[patch], what, round(delta_e, 2))


def _from_scans(
    chart: ChartList, sources: Sequence[Path], profile: Path | None, even_light: bool, threads: int
) -> _Read:
    layout = chart.layout
    patches = len(layout.ink_counts)
    out = _Read(np.full((patches, 3), np.nan), None, None, np.zeros(patches, dtype=bool), [], [], [])
    given = None if profile is None else read_icc_profile(profile).data
    shown: dict[int, Path] = {}
    for source in sources:
        scan = read_scan(source)
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


def _take(chart: ChartList, source: Path, reading: TileReading, out: _Read) -> None:
    pose, layout = reading.pose, chart.layout
    out.lab[reading.patches] = lab_from_xyz(reading.xyz_d50)
    out.kept[reading.patches] = reading.left_out <= _SPOILED
    scan_dpi = layout.dpi * pose.scale
    out.scans.append(
        ScanNote(
            file=str(source),
            tile=pose.tile + 1,
            marks=pose.marks,
            turn_degrees=round(pose.turn_degrees, 2),
            scan_dpi=round(scan_dpi, 1),
            residual_mm=round(25.4 * pose.residual_px / scan_dpi, 4),
            lighting_percent=None if reading.lighting_percent is None else round(reading.lighting_percent, 2),
        )
    )
    for place in np.flatnonzero(reading.defect):
        share = 100.0 * reading.left_out[place]
        what = f"defect, {share:.0f} % left out" if share else "uneven"
        out.notes.append(_note(chart, int(reading.patches[place]), what, float(reading.spread_delta_e[place])))
    if pose.marks < 4:
        out.warnings.append(f"{source.name}: {pose.marks} of the 4 marks of tile {pose.tile + 1} were found")
    clipped = int((reading.xyz_d50[:, 1] > _CLIPPED).sum())
    if clipped:
        out.warnings.append(f"{source.name}: {clipped} patches are as light as the scan can show: scan darker")


def _compare_whites(chart: ChartList, out: _Read) -> None:
    bare = (chart.layout.ink_counts == 0).all(axis=1) & out.kept
    tiles = chart.layout.places[:, 0]
    whites = {int(tile): out.lab[bare & (tiles == tile)].mean(axis=0) for tile in np.unique(tiles[bare])}
    first = next(iter(whites), None)
    for tile, white in whites.items():
        away = float(delta_e_2000(white, whites[first])) if first is not None else 0.0
        if away > _TILES_DIFFER:
            out.warnings.append(
                f"bare patches of tiles {(first or 0) + 1} and {tile + 1} differ by ΔE {away:.1f}: scan all tiles "
                "alike, and print on tiles of one shade"
            )


def _from_instrument(chart: ChartList, sources: Sequence[Path]) -> _Read:
    patches = len(chart.sample_ids)
    xyz, times = np.zeros((patches, 3)), np.zeros(patches)
    warnings: list[str] = []
    reads = [(source, read_readings(source)) for source in sources]
    first = reads[0][1].wavelengths_nm
    spectral = first is not None and all(
        read.wavelengths_nm is not None and np.array_equal(read.wavelengths_nm, first) for _, read in reads
    )
    if not spectral and any(read.wavelengths_nm is not None for _, read in reads):
        warnings.append("the files don't have spectra of the same bands: only Lab is kept")
    reflectance = np.zeros((patches, len(first))) if spectral and first is not None else None
    for source, read in reads:
        which = _match(chart, read, source)
        if read.ink_frac is not None:
            _check_ink(chart, read.ink_frac, which, source)
        xyz[which] += xyz_from_lab(read.lab_d50)
        times[which] += 1
        if reflectance is not None and read.reflectance is not None:
            reflectance[which] += read.reflectance
    missing = np.flatnonzero(times == 0)
    if len(missing):
        names = ", ".join(chart.sample_ids[patch] for patch in missing[:5])
        raise ProfileError(
            f"{sources[-1]}: {len(missing)} of the chart's {patches} patches are not measured ({names}"
            f"{', …' if len(missing) > 5 else ''}): measure them too",
            path=str(sources[-1]),
        )
    return _Read(
        lab=lab_from_xyz(xyz / times[:, np.newaxis]),
        reflectance=None if reflectance is None else reflectance / times[:, np.newaxis],
        wavelengths_nm=first if spectral else None,
        kept=np.ones(patches, dtype=bool),
        notes=[],
        scans=[],
        warnings=warnings,
    )


def _match(chart: ChartList, read: Readings, source: Path) -> NDArray[np.int64]:
    """Patch of the chart for each reading of a file."""
    by_id = {sample.casefold(): patch for patch, sample in enumerate(chart.sample_ids)}
    by_place = {place.casefold(): patch for patch, place in enumerate(chart.locations)}
    ways = [(read.sample_ids, by_id), (read.locations, by_place), (read.sample_ids, by_place)]
    ways = [(names, known) for names, known in ways if names]
    if not ways:
        raise ProfileError(
            f"{source}: has neither SAMPLE_ID nor SAMPLE_LOC, so nobody knows which patch is which: export it with one",
            path=str(source),
        )
    for names, known in ways:
        if all(name.casefold() in known for name in names):
            which = np.array([known[name.casefold()] for name in names], dtype=np.int64)
            found, times = np.unique(which, return_counts=True)
            if times.max() > 1:
                twice = chart.sample_ids[int(found[int(np.argmax(times))])]
                raise ProfileError(f"{source}: patch {twice} is there twice: keep one of them", path=str(source))
            return which
    names, known = ways[0]
    strange = [name for name in names if name.casefold() not in known]
    raise ProfileError(
        f"{source}: {len(strange)} of its {len(names)} patches are not on the chart of {len(chart.sample_ids)}, the "
        f"first is {strange[0][:40]!r}: give the list that its chart came with",
        path=str(source),
    )


def _check_ink(chart: ChartList, ink_frac: Float64Array, which: NDArray[np.int64], source: Path) -> None:
    printed = chart.layout.ink_counts[which] / 255.0
    if ink_frac.shape != printed.shape:
        raise ProfileError(
            f"{source}: has {ink_frac.shape[1]} inks, but the chart {printed.shape[1]}: it is another chart's",
            path=str(source),
        )
    wrong = np.flatnonzero((np.abs(ink_frac - printed) > _INK_SLACK).any(axis=1))
    if len(wrong):
        raise ProfileError(
            f"{source}: {len(wrong)} patches have other ink than on the chart, the first is "
            f"{chart.sample_ids[int(which[wrong[0]])]}: it is another chart's, or in another order",
            path=str(source),
        )
