"""Fired colour against predicted colour, region by region: each tile is its own colour chart.

Colours of a region are means of its light, as an instrument with its aperture there would measure them. Where the
print is uneven within a region, its mean ink would not give its mean colour; such regions say so by their noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tilefab.colour.differences import delta_e_cmc
from tilefab.colour.spaces import WHITE_XYZ_D50, delta_e_2000, lab_from_xyz
from tilefab.inspection.light import check_pair, worn
from tilefab.inspection.measurement_kernels import pair_sums, region_sums
from tilefab.inspection.records import ColourFigures, Lab
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]

REGION_MM = 2.5
"""Usual side of a region: the size of an instrument's smaller apertures, and thousands of them on a tile."""

EDGE_MM = 0.8
"""What is left out along the tile's edge, and along what hides it: the camera's blur mixes the two there."""

_LEAST_SHARE = 0.5
_ALIKE_PX = 6.0
_FLOOR_LAB = 0.1
_DARKEST = 1e-3


@dataclass(frozen=True, eq=False)
class RegionColours:
    """Colours of M regions of a tile.

    Attributes
    ----------
    at_mm
        (M, 2) float64: middles (x, y), from the face's upper left corner.
    ink_frac
        (M, N) float64: mean ink, 0 to 1.
    fired_lab, predicted_lab
        (M, 3) float64: absolute Lab (D50) of the mean light.
    noise_lab
        (M,) float64: standard deviation to be expected of each of L*, a*, b*: from the scatter within the region, and
        from how far its mean colour is from the colour of its mean.
    share
        (M,) float64: share of the region that was seen, 0.5 to 1.
    place
        (M, 2) int64: row and column among the regions.
    grid
        Rows and columns of regions that the face has.
    region_mm
        Side of a region.
    """

    at_mm: Float64Array = field(repr=False)
    ink_frac: Float64Array = field(repr=False)
    fired_lab: Float64Array = field(repr=False)
    predicted_lab: Float64Array = field(repr=False)
    noise_lab: Float64Array = field(repr=False)
    share: Float64Array = field(repr=False)
    place: NDArray[np.int64] = field(repr=False)
    grid: tuple[int, int]
    region_mm: float

    def __len__(self) -> int:
        return len(self.share)


@dataclass(frozen=True, eq=False)
class DifferenceMaps:
    """Colour differences as pictures, a pixel a region; NaN where the tile isn't seen.

    Attributes
    ----------
    delta_e
        (rows, cols) float32 CIEDE2000.
    cmc
        (rows, cols) float32 CMC(l:c), the prediction being the standard.
    lab
        (rows, cols, 3) float32: fired less predicted L*, a*, b*.
    region_mm
        Side of a region.
    """

    delta_e: NDArray[np.float32] = field(repr=False)
    cmc: NDArray[np.float32] = field(repr=False)
    lab: NDArray[np.float32] = field(repr=False)
    region_mm: float


def region_colours(
    predicted_xyz: FloatImage,
    fired_xyz: FloatImage,
    inks: NDArray[np.float32],
    valid: Mask,
    px_per_mm: float,
    *,
    region_mm: float = REGION_MM,
    edge_mm: float = EDGE_MM,
) -> RegionColours:
    """Mean colours and inks of a tile's regions.

    Parameters
    ----------
    predicted_xyz, fired_xyz
        (rows, cols, 3) float32: XYZ (D50, Y = 1 for the perfect white) on the face grid, the light evened.
    inks
        (rows, cols, N) float32: ink fractions, 0 to 1.
    valid
        (rows, cols) bool: where the tile is seen.
    px_per_mm
        Resolution of the grid.
    region_mm
        Side of a region; rounded so that whole regions of whole pixels, nearly alike, cover the face.
    edge_mm
        Width left out along the face's border and along what isn't valid.

    Returns
    -------
    RegionColours
        Of regions at least half of which is valid; may be none.

    Raises
    ------
    ValueError
        If shapes differ, images aren't float32, or a size isn't more than 0.
    """
    check_pair(predicted_xyz, fired_xyz, valid)
    if inks.ndim != 3 or inks.shape[:2] != valid.shape or inks.dtype != np.float32:
        raise ValueError(f"inks must be float32 {valid.shape} by inks, not {inks.dtype} {inks.shape}")
    if not (px_per_mm > 0.0 and region_mm > 0.0 and edge_mm >= 0.0):
        raise ValueError(
            f"{px_per_mm} pixels a mm and regions of {region_mm} mm must be more than 0, {edge_mm} not less"
        )
    rows, cols = valid.shape
    seen = worn(valid, math.ceil(edge_mm * px_per_mm))
    row_cuts, col_cuts = (_cuts(length, region_mm * px_per_mm) for length in (rows, cols))
    grid = (len(row_cuts) - 1, len(col_cuts) - 1)
    sums, ink_sums = np.empty((*grid, 16)), np.empty((*grid, inks.shape[2]))
    pair_sums(predicted_xyz, fired_xyz, seen, row_cuts, col_cuts, sums)
    region_sums(inks, seen, row_cuts, col_cuts, ink_sums)
    share = sums[:, :, 0] / np.outer(np.diff(row_cuts), np.diff(col_cuts))
    kept = share >= _LEAST_SHARE
    place = np.argwhere(kept)
    count = sums[kept][:, :1]
    moments = sums[kept][:, 1:].reshape(-1, 5, 3) / count[:, np.newaxis]
    predicted, fired = moments[:, 0], moments[:, 1]
    middle_y, middle_x = (row_cuts[:-1] + row_cuts[1:]) / 2.0, (col_cuts[:-1] + col_cuts[1:]) / 2.0
    return RegionColours(
        np.column_stack([middle_x[place[:, 1]], middle_y[place[:, 0]]]) / px_per_mm,
        ink_sums[kept] / count,
        lab_from_xyz(fired),
        lab_from_xyz(predicted),
        _noise(moments, count),
        share[kept],
        place.astype(np.int64),
        grid,
        region_mm,
    )


def _cuts(length: int, region_px: float) -> NDArray[np.int64]:
    count = min(max(1, round(length / region_px)), length)
    return np.linspace(0, length, count + 1).round().astype(np.int64)


def _noise(moments: Float64Array, count: Float64Array) -> Float64Array:
    """Standard deviation (M,) of a region's Lab, from moments (M, 5, 3) of its ``count`` (M, 1) pixels."""
    predicted, fired, predicted_square, fired_square, product = moments.transpose(1, 0, 2)
    gain = fired / np.maximum(predicted, _DARKEST)
    own = np.maximum(predicted_square - predicted**2, 0.0)
    scatter = fired_square - fired**2 - 2.0 * gain * (product - fired * predicted) + gain**2 * own
    # Blur, resampling and grain make neighbouring pixels alike, so a mean is of fewer values than there are pixels.
    variance = np.maximum(scatter, 0.0) / np.maximum(count / _ALIKE_PX, 1.0)
    white = np.array(WHITE_XYZ_D50)
    level = np.maximum(fired / white, _DARKEST)
    root_variance = (np.cbrt(level) / (3.0 * level)) ** 2 * variance / white**2
    x, y, z = root_variance.T
    total = (116.0**2 * y + 500.0**2 * (x + y) + 200.0**2 * (y + z)) / 3.0
    # Mean of cube roots against cube root of the mean, to the second order.
    level = np.maximum(predicted / white, _DARKEST)
    bend = -np.cbrt(level) * (own / white**2) / (9.0 * level**2)
    uneven = np.stack([116.0 * bend[:, 1], 500.0 * (bend[:, 0] - bend[:, 1]), 200.0 * (bend[:, 1] - bend[:, 2])])
    return np.asarray(np.sqrt(total + (uneven**2).mean(axis=0) + _FLOOR_LAB**2), dtype=np.float64)


def colour_figures(regions: RegionColours) -> ColourFigures | None:
    """Figures of a tile's colour, over its regions by how much of each was seen; None if there is none.

    References
    ----------
    CIE 15:2018, section 8.2.1 (hue difference); for the differences see `tilefab.colour.delta_e_2000` and
    `tilefab.colour.delta_e_cmc`.
    """
    if not len(regions):
        return None
    predicted, fired, share = regions.predicted_lab, regions.fired_lab, regions.share
    delta_e, cmc = delta_e_2000(predicted, fired), delta_e_cmc(predicted, fired)
    worst = int(np.argmax(delta_e))
    chroma, fired_chroma = (np.hypot(lab[:, 1], lab[:, 2]) for lab in (predicted, fired))
    turn = np.arctan2(fired[:, 2], fired[:, 1]) - np.arctan2(predicted[:, 2], predicted[:, 1])
    hue = 2.0 * np.sqrt(chroma * fired_chroma) * np.sin((turn + np.pi) % (2.0 * np.pi) / 2.0 - np.pi / 2.0)

    def mean(values: Float64Array) -> float:
        return float(np.average(values, weights=share))

    return ColourFigures(
        delta_e_mean=mean(delta_e),
        delta_e_p95=float(np.percentile(delta_e, 95)),
        delta_e_worst=float(delta_e[worst]),
        worst_at_mm=(float(regions.at_mm[worst, 0]), float(regions.at_mm[worst, 1])),
        cmc_mean=mean(cmc),
        cmc_p95=float(np.percentile(cmc, 95)),
        lightness=mean(fired[:, 0] - predicted[:, 0]),
        chroma=mean(fired_chroma - chroma),
        hue=mean(hue),
        fired_lab=_lab(np.average(fired, axis=0, weights=share)),
        predicted_lab=_lab(np.average(predicted, axis=0, weights=share)),
    )


def _lab(values: Float64Array) -> Lab:
    return float(values[0]), float(values[1]), float(values[2])


def difference_maps(regions: RegionColours, *, lightness: float = 2.0, chroma: float = 1.0) -> DifferenceMaps:
    """Maps of colour differences for pictures; ``lightness`` and ``chroma`` are l and c of CMC."""
    predicted, fired = regions.predicted_lab, regions.fired_lab

    def map_of(values: Float64Array) -> NDArray[np.float32]:
        out = np.full((*regions.grid, *values.shape[1:]), np.nan, dtype=np.float32)
        out[regions.place[:, 0], regions.place[:, 1]] = values
        return out

    return DifferenceMaps(
        map_of(delta_e_2000(predicted, fired)),
        map_of(delta_e_cmc(predicted, fired, lightness=lightness, chroma=chroma)),
        map_of(fired - predicted),
        regions.region_mm,
    )
