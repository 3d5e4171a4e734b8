"""From patches of pixels that differ to classed, measured, graded defects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tilefab.colour import delta_e_2000
from tilefab.inspection.records import Defect, DefectKind, Grade
from tilefab.types import FloatImage, Mask

Float64Array = NDArray[np.float64]

_PEAK_SHARE, _PEAK_PX = 0.03, 4


@dataclass(frozen=True)
class ShapeLimits:
    """How patches are told apart.

    Attributes
    ----------
    spot_delta_e, line_delta_e
        Least mean CIEDE2000 of a spot or a chip, and of a line, from what should be there, as the camera blurs them.
    line_length_mm, line_slimness
        From what length on, and from how many times as long as wide, a patch is a line: a crack if it is darker than
        the face, a scratch if lighter.
    pinhole_mm
        Diameter up to which a dark spot is a pinhole.
    chip_delta_e, chip_mm2, chip_width_mm
        Least mean CIEDE2000, area and mean width of a patch at the face's edge that is a chip.
    """

    spot_delta_e: float = 2.2
    line_delta_e: float = 1.8
    line_length_mm: float = 2.0
    line_slimness: float = 4.0
    pinhole_mm: float = 0.46
    chip_delta_e: float = 4.0
    chip_mm2: float = 0.6
    chip_width_mm: float = 0.6


@dataclass(frozen=True)
class GradeLimits:
    """From what on a defect makes a tile scrap; less makes it second choice.

    Attributes
    ----------
    spot_mm
        Diameter of a spot or a pinhole.
    crack_mm
        Length of a crack.
    scratch_mm
        Length of a scratch.
    chip_mm2
        Area of a chip.
    stripe_delta_e
        Mean difference of a nozzle line or a band.
    misregistration_mm
        How far an ink lies off its place.
    """

    spot_mm: float = 2.0
    crack_mm: float = 4.0
    scratch_mm: float = 30.0
    chip_mm2: float = 6.0
    stripe_delta_e: float = 5.0
    misregistration_mm: float = 0.5

    def of(self, kind: DefectKind, *, size: float) -> Grade:
        """Grade for a defect's decisive size: millimetres, square millimetres or CIEDE2000, as its limit is stated."""
        limits = {
            DefectKind.SPOT: self.spot_mm,
            DefectKind.PINHOLE: self.spot_mm,
            DefectKind.CRACK: self.crack_mm,
            DefectKind.SCRATCH: self.scratch_mm,
            DefectKind.CHIP: self.chip_mm2,
            DefectKind.NOZZLE_LINE: self.stripe_delta_e,
            DefectKind.BANDING: self.stripe_delta_e,
            DefectKind.MISREGISTRATION: self.misregistration_mm,
        }
        # Without an ink, or printed twice, no tile is sold.
        return Grade.SCRAP if size >= limits.get(kind, 0.0) else Grade.SECOND


def core_of(patch: Mask, rest: FloatImage, strength: FloatImage) -> tuple[Mask, Float64Array]:
    """What stands out of a patch, and how.

    Parameters
    ----------
    patch
        (h, w) bool, the pixels.
    rest
        (h, w, 3) CIELAB, the residual without its slow part.
    strength
        (h, w) how far each pixel stands out, over the least that is reported; 0 for pixels that only lie around.

    Returns
    -------
    core, mean
        (h, w) bool, pixels of at least half its height: what blur adds on either side, it takes from the height. It
        may be empty. (3,) their mean residual.
    """
    mean = np.average(rest[patch].astype(np.float64), axis=0, weights=strength[patch])
    along = np.where(patch, rest.astype(np.float64) @ mean, 0.0)
    values = along[patch]
    # Nearly its peak: not of a few pixels only, so that noise doesn't say how high it is.
    most = min(max(round(_PEAK_SHARE * len(values)), _PEAK_PX), len(values))
    high = float(np.partition(values, -most)[-most])
    core = patch & (along > 0.5 * high) & (along > 0.0)
    return core, rest[core].mean(axis=0, dtype=np.float64) if core.any() else np.zeros(3)


def classed(
    core: Mask,
    mean: Float64Array,
    top: int,
    left: int,
    expected: FloatImage,
    px_per_mm: float,
    at_edge: bool,
    severity: float,
    shapes: ShapeLimits,
    grades: GradeLimits,
) -> Defect | None:
    """What a patch of pixels that differ is.

    Parameters
    ----------
    core, mean
        See `core_of`; at least one pixel.
    top, left
        Where the upper left pixel lies.
    expected
        (h, w, 3) CIELAB: the prediction as fired.
    px_per_mm
        Resolution.
    at_edge
        Whether it reaches the strip along the face's edges.
    severity
        How far it stands out, over the least that is reported.
    shapes, grades
        How patches are told apart and graded.

    Returns
    -------
    Defect or None
        None if it is too faint to be seen.
    """
    rows, cols = np.nonzero(core)
    area = len(rows) / px_per_mm**2
    length, width = _extent(rows, cols, px_per_mm)
    diameter = 2.0 * np.sqrt(area / np.pi)
    slim = length >= shapes.line_length_mm and length >= shapes.line_slimness * width
    before = expected[core].mean(axis=0, dtype=np.float64)
    difference = float(delta_e_2000(before, before + mean))
    if difference < (shapes.line_delta_e if slim else shapes.spot_delta_e):
        return None
    darker = mean[0] < 0.0
    size: float
    if at_edge and difference >= shapes.chip_delta_e and area >= shapes.chip_mm2 and width >= shapes.chip_width_mm:
        kind, size = DefectKind.CHIP, area
    elif slim:
        kind, size = (DefectKind.CRACK if darker else DefectKind.SCRATCH), length
    elif darker and diameter <= shapes.pinhole_mm:
        kind, size = DefectKind.PINHOLE, diameter
    else:
        kind, size = DefectKind.SPOT, diameter
    return Defect(
        kind,
        (left + float(cols.mean()) + 0.5) / px_per_mm,
        (top + float(rows.mean()) + 0.5) / px_per_mm,
        (int(cols.max()) - int(cols.min()) + 1) / px_per_mm,
        (int(rows.max()) - int(rows.min()) + 1) / px_per_mm,
        area,
        difference,
        max(severity, 1.0),
        grades.of(kind, size=size),
    )


def _extent(rows: NDArray[np.int64], cols: NDArray[np.int64], px_per_mm: float) -> tuple[float, float]:
    """Length and mean width of pixels, mm: as long as a bar of the same second moment, as wide as the area says."""
    if len(rows) < 3:
        return np.sqrt(len(rows)) / px_per_mm, np.sqrt(len(rows)) / px_per_mm
    spread = np.linalg.eigvalsh(np.cov(np.stack([rows, cols]).astype(np.float64)) + np.eye(2) / 12.0)
    length = np.sqrt(12.0 * float(spread[1]))
    return length / px_per_mm, len(rows) / length / px_per_mm


def chips_of(
    tile: Mask, px_per_mm: float, margin_mm: float, shapes: ShapeLimits, grades: GradeLimits
) -> tuple[Defect, ...]:
    """Places at the edges where there is no tile.

    Parameters
    ----------
    tile
        (rows, cols), True where the face grid shows tile.
    px_per_mm
        Resolution.
    margin_mm
        As far in as registration may misplace an edge: what isn't deeper is no chip.
    shapes, grades
        From what area on; and the grades.
    """
    # A print that lies off the middle leaves a strip without tile along a whole side: that is no chip.
    tile = tile.copy()
    for turned in (tile, tile[::-1], tile.T, tile.T[::-1]):
        strip = int(np.median(np.where(turned.any(axis=0), turned.argmax(axis=0), 0)))
        turned[:strip] = True
    # What goes on beyond the face's edge counts as missing there, too; what is narrow is taken away by opening.
    margin = max(round(margin_mm * px_per_mm), 1)
    missing = np.pad(~tile, margin, mode="edge")
    side = 2 * margin + 1
    deep = ndimage.binary_opening(missing, np.ones((side, side), dtype=bool))[margin:-margin, margin:-margin]
    labels, count = ndimage.label(deep)
    found = []
    rows, cols = tile.shape
    for number, box in enumerate(ndimage.find_objects(labels, max_label=count), 1):
        area = float((labels[box] == number).sum()) / px_per_mm**2
        touches = box[0].start == 0 or box[1].start == 0 or box[0].stop == rows or box[1].stop == cols
        if not touches or area < shapes.chip_mm2:
            continue
        high, wide = box[0].stop - box[0].start, box[1].stop - box[1].start
        found.append(
            Defect(
                DefectKind.CHIP,
                (box[1].start + wide / 2.0) / px_per_mm,
                (box[0].start + high / 2.0) / px_per_mm,
                wide / px_per_mm,
                high / px_per_mm,
                area,
                0.0,
                area / shapes.chip_mm2,
                grades.of(DefectKind.CHIP, size=area),
            )
        )
    return tuple(found)
