"""What inspection finds out about a fired tile. A failing tile is a result, not an error."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

Lab = tuple[float, float, float]
"""CIE L*, a*, b* (D50)."""


class ImageProblem(StrEnum):
    """Why an image shows no tile that can be measured."""

    BLACK = "black"
    BLOWN_OUT = "blown_out"
    TORN = "torn"
    NO_TILE = "no_tile"
    TWO_TILES = "two_tiles"
    WRONG_SIZE = "wrong_size"


class DefectKind(StrEnum):
    """Classes of defects."""

    NOZZLE_LINE = "nozzle_line"
    BANDING = "banding"
    SPOT = "spot"
    PINHOLE = "pinhole"
    SCRATCH = "scratch"
    CRACK = "crack"
    CHIP = "chip"
    MISREGISTRATION = "misregistration"
    MISSING_INK = "missing_ink"
    DOUBLE_PRINT = "double_print"


class Grade(StrEnum):
    """How good a tile is: first choice, second choice, or scrap."""

    FIRST = "first"
    SECOND = "second"
    SCRAP = "scrap"


@dataclass(frozen=True)
class Recognition:
    """Which face a tile shows.

    Attributes
    ----------
    face
        Its index; ``None``: none of those looked among.
    quarter_turns
        How often the tile in the image is turned clockwise by 90 degrees against its face, 0 to 3.
    corners_px
        Image places (x, y), pixel centres at + 0.5, of the face's upper left, upper right, lower right and lower left
        corner; empty if no tile was found.
    confidence
        0 to 1: how sure the answer is, be it a face or none.
    likeness
        Correlation of the tile with the best face, -1 to 1, over what of the tile is seen.
    runner_up
        Likeness of the second best face.
    visible
        Share of the face that the image shows, 0 to 1.
    problem
        Why the image can't be used; ``None`` if it can.
    reason
        The same, or why no face fits, for people.
    """

    face: int | None
    quarter_turns: int
    corners_px: tuple[tuple[float, float], ...]
    confidence: float
    likeness: float
    runner_up: float
    visible: float
    problem: ImageProblem | None
    reason: str


@dataclass(frozen=True)
class ColourFigures:
    """Fired colour against the face's predicted colour, over the regions of a tile.

    Attributes
    ----------
    delta_e_mean, delta_e_p95, delta_e_worst
        CIEDE2000 of regions.
    worst_at_mm
        Middle (x, y) of the worst region, from the tile's upper left corner.
    cmc_mean, cmc_p95
        CMC(2:1), the prediction being the standard. For patterned tile not the method of ISO 10545-16, which is for
        plain colours.
    lightness, chroma, hue
        Mean differences fired less predicted: L*, C* and H* (signed).
    fired_lab, predicted_lab
        Means.
    """

    delta_e_mean: float
    delta_e_p95: float
    delta_e_worst: float
    worst_at_mm: tuple[float, float]
    cmc_mean: float
    cmc_p95: float
    lightness: float
    chroma: float
    hue: float
    fired_lab: Lab
    predicted_lab: Lab


@dataclass(frozen=True)
class TileDimensions:
    """Size and shape, in the terms of ISO 10545-2:2018; percentages are of the work size.

    Attributes
    ----------
    sides_mm
        Lengths of the upper, right, lower and left side.
    width_mm, height_mm
        Means of opposite sides.
    size_deviation_percent
        Of the mean of all four sides from the work size, the larger of width's and height's by absolute value, signed.
    straightness_mm, straightness_percent
        Largest deviation from straight of the middle of a side, signed: + outwards.
    rectangularity_mm, rectangularity_percent
        Largest deviation of a corner from the right angle, signed.
    scale_known
        Whether millimetres are known from the camera's calibration; if not, sizes are relative to the work size.
    """

    sides_mm: tuple[float, float, float, float]
    width_mm: float
    height_mm: float
    size_deviation_percent: float
    straightness_mm: float
    straightness_percent: float
    rectangularity_mm: float
    rectangularity_percent: float
    scale_known: bool


@dataclass(frozen=True)
class Defect:
    """A defect on a tile.

    Attributes
    ----------
    kind
        Its class.
    x_mm, y_mm
        Its middle, from the face's upper left corner, y downwards.
    width_mm, height_mm
        Of the box around it.
    area_mm2
        Its area.
    delta_e
        Mean CIEDE2000 over it from what it should look like.
    severity
        Its strength over the least that is reported, 1 upwards.
    grade
        What it makes of the tile by itself.
    """

    kind: DefectKind
    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float
    area_mm2: float
    delta_e: float
    severity: float
    grade: Grade


@dataclass(frozen=True)
class TileInspection:
    """All that was found out about a tile.

    Attributes
    ----------
    recognition
        Which face it is.
    colour, dimensions
        ``None`` where they couldn't be measured.
    defects
        The worst first.
    grade
        What it is sold as.
    reasons
        Why it isn't first choice, for people.
    shift_mm, turn_deg
        How far the print lies off the middle of the tile (x, y), and how far it is turned, clockwise.
    """

    recognition: Recognition
    colour: ColourFigures | None
    dimensions: TileDimensions | None
    defects: tuple[Defect, ...]
    grade: Grade
    reasons: tuple[str, ...]
    shift_mm: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
