"""Colours of a chart from what an instrument measured on it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilefab.colour import lab_from_xyz, xyz_from_lab
from tilefab.errors import ProfileError
from tilefab.io.cgats import Readings, read_readings
from tilefab.io.chart_list import ChartList
from tilefab.pipeline.chart_colours import ChartColours, Float64Array

_INK_SLACK = 0.006


def colours_from_instrument(chart: ChartList, sources: Sequence[Path]) -> ChartColours:
    """Colours of a chart from an instrument's files; what is in several of them is averaged.

    Raises
    ------
    ProfileError
        If a file can't be read, or patches are missing, unknown, twice in one file, or of other ink.
    """
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
    return ChartColours(
        lab_d50=lab_from_xyz(xyz / times[:, np.newaxis]),
        kept=np.ones(patches, dtype=bool),
        reflectance=None if reflectance is None else reflectance / times[:, np.newaxis],
        wavelengths_nm=first if spectral else None,
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
