"""What a tile is sold as: first choice, second choice, or scrap, with the reasons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tilefab.inspection.records import ColourFigures, Defect, DefectKind, Grade, TileDimensions

_WORST = {Grade.FIRST: 0, Grade.SECOND: 1, Grade.SCRAP: 2}
_MOST_REASONS = 6
_SCRAP_TIMES = 2.0
_SAID = {
    DefectKind.NOZZLE_LINE: "nozzle line at x {x:.1f} mm",
    DefectKind.BANDING: "band at y {y:.1f} mm",
    DefectKind.MISREGISTRATION: "an ink out of register",
    DefectKind.MISSING_INK: "an ink is missing",
    DefectKind.DOUBLE_PRINT: "printed twice",
}


@dataclass(frozen=True)
class Tolerances:
    """What a tile of first choice may show.

    Size, straightness and rectangularity by default as ISO 13006:2018 allows dry-pressed tiles of group BIa (annex G)
    in percent of the work size; measured as ISO 10545-2:2018 says.

    Attributes
    ----------
    delta_e_mean, delta_e_p95
        CIEDE2000 of a tile's regions from its own predicted face: mean, and what 5 % of them exceed.
    size_percent
        Mean side from the work size.
    straightness_percent, rectangularity_percent
        Of the sides, and of the corners.
    shift_mm
        Print off the middle of the tile, along either axis.
    """

    delta_e_mean: float = 3.0
    delta_e_p95: float = 6.0
    size_percent: float = 0.6
    straightness_percent: float = 0.5
    rectangularity_percent: float = 0.5
    shift_mm: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise ValueError(f"tolerance {name} must be above 0, not {value}")


def grade_tile(
    colour: ColourFigures | None,
    dimensions: TileDimensions | None,
    defects: Sequence[Defect],
    shift_mm: tuple[float, float],
    tolerances: Tolerances,
) -> tuple[Grade, tuple[str, ...]]:
    """Grade of a tile, and why it isn't first choice.

    Parameters
    ----------
    colour, dimensions
        ``None`` where they couldn't be measured: then they don't count.
    defects
        The worst first.
    shift_mm
        How far the print lies off the middle of the tile, (x, y).
    tolerances
        What a tile of first choice may show. Beyond, it is second choice; beyond twice of any, scrap. Straightness and
        rectangularity that aren't known in millimetres count all the same, for they are ratios; the size doesn't.

    Returns
    -------
    grade, reasons
        The worst that any of it makes; and reasons for people, the gravest first, at most seven.
    """
    found: list[tuple[Grade, str]] = []

    def hold(value: float, most: float, text: str) -> None:
        if abs(value) > most:
            found.append((Grade.SCRAP if abs(value) > _SCRAP_TIMES * most else Grade.SECOND, text))

    if colour is not None:
        mean, p95 = tolerances.delta_e_mean, tolerances.delta_e_p95
        hold(colour.delta_e_mean, mean, f"mean ΔE2000 {colour.delta_e_mean:.1f} from its face, above {mean:g}")
        hold(colour.delta_e_p95, p95, f"ΔE2000 above {colour.delta_e_p95:.1f} on 5 % of it, more than {p95:g}")
    if dimensions is not None:
        size, straight, square = (
            dimensions.size_deviation_percent,
            dimensions.straightness_percent,
            dimensions.rectangularity_percent,
        )
        if dimensions.scale_known:
            most = tolerances.size_percent
            hold(size, most, f"size {size:+.2f} % off the work size, more than {most:g} %")
        most = tolerances.straightness_percent
        hold(straight, most, f"a side {straight:+.2f} % off straight, more than {most:g} %")
        most = tolerances.rectangularity_percent
        hold(square, most, f"a corner {square:+.2f} % off square, more than {most:g} %")
    off = max(shift_mm, key=abs)
    hold(off, tolerances.shift_mm, f"print {off:+.1f} mm off the middle, more than {tolerances.shift_mm:g} mm")
    found += [(defect.grade, _said(defect)) for defect in defects if defect.grade is not Grade.FIRST]
    found.sort(key=lambda reason: -_WORST[reason[0]])
    grade = found[0][0] if found else Grade.FIRST
    texts = [text for _, text in found[:_MOST_REASONS]]
    if len(found) > _MOST_REASONS:
        texts.append(f"{len(found) - _MOST_REASONS} more")
    return grade, tuple(texts)


def _said(defect: Defect) -> str:
    """A defect in words."""
    if defect.kind is DefectKind.CHIP:
        # What isn't there has no colour.
        return f"chip of {defect.width_mm:.0f} x {defect.height_mm:.0f} mm at ({defect.x_mm:.1f}, {defect.y_mm:.1f}) mm"
    said = _SAID.get(defect.kind, defect.kind.value + " at ({x:.1f}, {y:.1f}) mm")
    return f"{said.format(x=defect.x_mm, y=defect.y_mm)}, ΔE2000 {defect.delta_e:.1f}"
