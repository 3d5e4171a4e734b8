"""From a printed chart back to measurements: out of scans of its tiles, or out of an instrument's files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from tilefab.chart.repeats import RepeatCheck, check_repeats
from tilefab.errors import ProfileError
from tilefab.io.atomic import atomic_write_bytes, refuse_overwriting
from tilefab.io.cgats_write import measurements_text
from tilefab.io.chart_list import ChartList, read_chart_list
from tilefab.pipeline.chart_colours import ChartColours, PatchNote, ScanNote, patch_note
from tilefab.pipeline.chart_instrument import colours_from_instrument
from tilefab.pipeline.chart_scans import colours_from_scans

_NOISE_TOO_FAR = 3.0
_DARKENING = -0.3
_SNIFFED_BYTES = 4096


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
        If the file can't be written, or is one of those to be read.
    """
    chart = read_chart_list(chart_file)
    if not sources:
        raise ProfileError(f"{chart_file}: no scan or measurement to read is named", path=str(chart_file))
    refuse_overwriting(output, (chart_file, *sources))
    texts = [_is_text(source) for source in sources]
    if any(texts) != all(texts):
        raise ProfileError(
            f"{sources[texts.index(False)]}: is a scan among measurement files: give one or the other",
            path=str(sources[texts.index(False)]),
        )
    read = (
        colours_from_instrument(chart, sources)
        if all(texts)
        else colours_from_scans(chart, sources, scan_profile, even_light, threads)
    )
    repeats = check_repeats(chart.layout.ink_counts[read.kept], read.lab_d50[read.kept])
    _judge(chart, read, repeats)
    kept = np.flatnonzero(read.kept)
    text = measurements_text(
        chart.layout.ink_counts[kept] / 255.0,
        read.lab_d50[kept],
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


def _judge(chart: ChartList, read: ChartColours, repeats: RepeatCheck) -> None:
    """Note what looks wrong with the colours as a whole."""
    kept = np.flatnonzero(read.kept)
    for place in np.flatnonzero(repeats.disagree):
        patch = int(kept[place])
        read.notes.append(patch_note(chart, patch, "differs from its repeats", float(repeats.delta_e[place])))
    if repeats.noise_delta_e is not None and repeats.noise_delta_e > _NOISE_TOO_FAR:
        read.warnings.append(
            f"repeats of a recipe differ by ΔE {repeats.noise_delta_e:.1f}: are these colours of this chart, in "
            "its order?"
        )
    total = chart.layout.ink_counts[kept].sum(axis=1)
    if len(kept) > 2 and np.ptp(total) and np.ptp(read.lab_d50[kept, 0]):
        darkening = float(stats.spearmanr(total, read.lab_d50[kept, 0]).statistic)
        if darkening > _DARKENING:
            read.warnings.append("more ink doesn't make it darker: are these colours of this chart, in its order?")
