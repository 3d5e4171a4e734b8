"""Colours of a chart's patches while they come in, and what is noted beside them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.io.chart_list import ChartList

Float64Array = NDArray[np.float64]


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


@dataclass(eq=False)
class ChartColours:
    """Colours of a chart's P patches; filled in by whoever reads them.

    Attributes
    ----------
    lab_d50
        (P, 3) absolute Lab under D50; NaN where there is none yet.
    kept
        (P,) True where a patch was read and something sound is left of it.
    reflectance, wavelengths_nm
        (P, B) reflectance and (B,) bands in nm; None where there are no spectra.
    notes, scans, warnings
        What the operator should know.
    """

    lab_d50: Float64Array
    kept: NDArray[np.bool_]
    reflectance: Float64Array | None = None
    wavelengths_nm: Float64Array | None = None
    notes: list[PatchNote] = field(default_factory=list)
    scans: list[ScanNote] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def patch_note(chart: ChartList, patch: int, what: str, delta_e: float) -> PatchNote:
    """Note about a patch by its number from 0."""
    return PatchNote(chart.sample_ids[patch], chart.locations[patch], what, round(delta_e, 2))
