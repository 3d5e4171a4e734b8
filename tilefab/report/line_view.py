"""What the report of a line shows: frozen records of a job's or a shift's tiles, corrections, kiln, inks and stops.

Whoever makes them has read the journal, the inspections and every clock. Times ``*_s`` are seconds since 1970-01-01
UTC; ``utc_offset_min`` turns them into the wall clock of the factory. Pictures are uint8 sRGB arrays (rows, cols, 3).
Colour differences are CIEDE2000 unless their name says otherwise; Lab is CIELAB D50. Texts may hold any Unicode.
"""

from __future__ import annotations

from dataclasses import dataclass

from tilefab.inspection.records import ColourFigures, Defect, Grade, TileDimensions
from tilefab.report.view_model import Lab, Rgb, RgbImage


@dataclass(frozen=True)
class TileView:
    """One tile of the span: a face as it was printed once.

    Attributes
    ----------
    face, arm
        Which face, and the arm (number of the print) that put it on a tile.
    correction
        Number of the correction it was printed with; 0: as the job says.
    printed_s, fired_s
        When it was printed, and when it was photographed behind the kiln; None if it wasn't (yet), or not known.
    image
        Name of the photograph; "" without one.
    grade
        What it is sold as; None while not inspected.
    colour, dimensions
        What was measured; None where that could not be.
    defects
        The worst first.
    lot
        Name of its shade lot; "" without one.
    reasons
        Why it isn't first choice.
    """

    face: int
    arm: int
    correction: int = 0
    printed_s: float | None = None
    fired_s: float | None = None
    image: str = ""
    grade: Grade | None = None
    colour: ColourFigures | None = None
    dimensions: TileDimensions | None = None
    defects: tuple[Defect, ...] = ()
    lot: str = ""
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class CorrectionView:
    """A correction of the conversion in mid-run.

    Attributes
    ----------
    number
        Counted from 1 within the run.
    at_s
        When the daemon took it.
    reason
        Why, in words.
    sha256
        Of its drift state, in hex; "" if not known.
    drift_delta_e
        How far the press had drifted by its estimate: mean difference of this job's colours that the job's own
        conversion would have, uncorrected. None if not known.
    """

    number: int
    at_s: float
    reason: str
    sha256: str = ""
    drift_delta_e: float | None = None


@dataclass(frozen=True)
class KilnZoneView:
    """One zone's temperature over time: (T,) times rising and as many degrees Celsius; set point None if unknown."""

    name: str
    at_s: tuple[float, ...]
    temp_degc: tuple[float, ...]
    setpoint_degc: float | None = None


@dataclass(frozen=True)
class InnovationView:
    """What a tile told the drift controller that it had not expected.

    Attributes
    ----------
    at_s
        When the tile was photographed.
    value
        By how much its lightness was not as expected, over what the controller expects of that: about normal (0, 1)
        while all is well.
    accepted
        Whether the controller believed it.
    """

    at_s: float
    value: float
    accepted: bool = True


@dataclass(frozen=True)
class SpanView:
    """Something that lasted: a stop of the line, an alarm, a hold of the controller.

    Attributes
    ----------
    begun_s, ended_s
        From when to when; None: it still lasts at the end of the span.
    code
        The machine's word for it, as in the alarms of the line.
    text
        What it was, for people.
    """

    begun_s: float
    ended_s: float | None
    code: str
    text: str


@dataclass(frozen=True)
class LotView:
    """A shade lot: tiles that may be packed together.

    Attributes
    ----------
    name
        A, B, C ...
    tiles
        How many.
    difference_lab
        Mean of fired less predicted L*, a*, b* over its tiles.
    spread_delta_e
        Largest difference of a tile in it from its middle.
    first_s, last_s
        Photographs of its first and last tile.
    rgb
        For display: the job's mean colour as this lot shows it; None without.
    """

    name: str
    tiles: int
    difference_lab: Lab
    spread_delta_e: float
    first_s: float
    last_s: float
    rgb: Rgb | None = None


@dataclass(frozen=True)
class VariationView:
    """How much the faces differ by design, and from one another.

    Attributes
    ----------
    look
        V0 to V4: the look of the class that the index falls into; an aid, not the standard's own measure.
    index
        The objective variation index.
    between_delta_e, within_delta_e
        Between the means of tiles, and within tiles.
    plain
        Whether the tile is plain, so that ISO 10545-16 applies.
    cmc_plain
        CMC difference over the plain area as that standard has it; None where the tile isn't plain.
    note
        What these figures are, in a sentence or two.
    """

    look: str
    index: float
    between_delta_e: float
    within_delta_e: float
    plain: bool
    cmc_plain: float | None
    note: str


@dataclass(frozen=True)
class InkUseView:
    """One ink: how much was used, and how much the job's conversion saved against ``ink_saved_against``.

    Both in the view's ``ink_unit``; ``saved`` None if not known.
    """

    name: str
    used: float
    saved: float | None = None


@dataclass(frozen=True, eq=False)
class WorstTileView:
    """One of the worst tiles, with its pictures; None where there is none.

    ``difference`` is a picture of the colour difference region by region.
    """

    tile: TileView
    predicted: RgbImage | None
    fired: RgbImage | None
    difference: RgbImage | None = None


@dataclass(frozen=True)
class ShiftView:
    """One shift of a job: a name and its span. Its figures come from the tiles."""

    name: str
    begun_s: float
    ended_s: float


@dataclass(frozen=True)
class LimitsView:
    """What first choice may be at most; None: not judged.

    Attributes
    ----------
    delta_e_mean, delta_e_p95
        Of a tile.
    size_percent, straightness_percent, rectangularity_percent
        Deviations in the terms of ISO 10545-2, either way.
    """

    delta_e_mean: float | None = None
    delta_e_p95: float | None = None
    size_percent: float | None = None
    straightness_percent: float | None = None
    rectangularity_percent: float | None = None


@dataclass(frozen=True, eq=False)
class LineReportView:
    """Everything that the report of a job or of a shift shows.

    Attributes
    ----------
    title
        The job's name.
    scope
        "Job report" or "Shift report".
    line
        The line's name.
    run
        Number of the run in the journal.
    job_file
        Where the job file is.
    job_hash, map_hash, profile_hash
        Hashes in hex.
    created
        The date as it is to be shown.
    software_version
        Version that made the report.
    begun_s, ended_s
        The span.
    utc_offset_min
        Minutes that the factory's clock is ahead of UTC.
    facts
        Label and value pairs of the job.
    tile_size_mm
        Width and height of the finished tile.
    planned
        Faces of the job; None if not known.
    tiles
        All tiles of the span, in the order of printing.
    unreadable
        Photographs that no tile could be measured in: problem in words and how many.
    strangers
        Photographs of tiles that are none of this job's.
    corrections, kiln, innovations, holds, downtime, alarms, lots, inks, shifts
        As their classes say, in order of time; each may be empty.
    limits
        Tolerances.
    variation
        None if not measured.
    ink_unit, ink_saved_against
        Unit of the inks' amounts ("m² of full coverage"), and what savings are against ("the same colours without
        grey balance inks"); "" where not known.
    worst
        The worst tiles, the worst first, at most ten.
    tile_picture
        A typical face, which the map of defects is drawn over; None: drawn over an empty tile.
    warnings
        What the reader should know; may be empty.
    """

    title: str
    scope: str
    line: str
    run: int
    job_file: str
    job_hash: str
    map_hash: str
    profile_hash: str
    created: str
    software_version: str
    begun_s: float
    ended_s: float
    utc_offset_min: int
    facts: tuple[tuple[str, str], ...]
    tile_size_mm: tuple[float, float]
    planned: int | None
    tiles: tuple[TileView, ...]
    unreadable: tuple[tuple[str, int], ...] = ()
    strangers: int = 0
    corrections: tuple[CorrectionView, ...] = ()
    kiln: tuple[KilnZoneView, ...] = ()
    innovations: tuple[InnovationView, ...] = ()
    holds: tuple[SpanView, ...] = ()
    downtime: tuple[SpanView, ...] = ()
    alarms: tuple[SpanView, ...] = ()
    lots: tuple[LotView, ...] = ()
    inks: tuple[InkUseView, ...] = ()
    shifts: tuple[ShiftView, ...] = ()
    limits: LimitsView = LimitsView()
    variation: VariationView | None = None
    ink_unit: str = ""
    ink_saved_against: str = ""
    worst: tuple[WorstTileView, ...] = ()
    tile_picture: RgbImage | None = None
    warnings: tuple[str, ...] = ()
