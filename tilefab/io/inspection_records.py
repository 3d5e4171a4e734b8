"""What goes into the store of inspections and comes out of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime

from tilefab.inspection.records import ColourFigures, Defect, Grade, ImageProblem, Lab, TileInspection


@dataclass(frozen=True)
class SeenTile:
    """An image that was inspected, to be put down.

    Attributes
    ----------
    image
        Name of its file in the camera's folder.
    taken_at
        When it was taken.
    inspection
        What was found out.
    run_id
        Run in the journal that its face belongs to; ``None`` if it wasn't recognised.
    arm_id, correction, printed_at
        The arm that printed it, the number of the correction it was printed with (0: as the job says), and when;
        ``None`` where the journal doesn't say.
    repeat
        Whether an earlier image showed the same tile.
    shade_lot
        Its shade lot; empty if it has none.
    """

    image: str
    taken_at: datetime
    inspection: TileInspection
    run_id: int | None = None
    arm_id: int | None = None
    correction: int | None = None
    printed_at: datetime | None = None
    repeat: bool = False
    shade_lot: str = ""


@dataclass(frozen=True)
class Pictures:
    """Pictures of a tile that are kept, since it is among the worst of its run.

    Attributes
    ----------
    badness
        How bad it is: higher is worse.
    predicted, fired
        Names of PNG files, relative to the folder of pictures.
    """

    badness: float
    predicted: str
    fired: str


@dataclass(frozen=True)
class InspectionRecord:
    """An inspection as the store has it.

    Attributes
    ----------
    inspection_id
        Rising in the order in which images were inspected.
    image, taken_at, run_id, arm_id, correction, printed_at, repeat, shade_lot
        As for `SeenTile`.
    inspected_at
        When it was put down.
    face
        Its face; ``None`` if it wasn't recognised.
    problem
        Why the image can't be used; ``None`` if it can.
    grade
        What the tile is sold as.
    confidence, visible
        As for `tilefab.inspection.records.Recognition`.
    colour
        Fired against predicted colour; ``None`` if it couldn't be measured.
    sizes
        Width and height in mm, then deviation from the work size, straightness and rectangularity in percent; ``None``
        if they couldn't be measured.
    pictures
        If they are kept.
    """

    inspection_id: int
    image: str
    taken_at: datetime
    inspected_at: datetime
    run_id: int | None
    face: int | None
    arm_id: int | None
    correction: int | None
    printed_at: datetime | None
    repeat: bool
    problem: ImageProblem | None
    grade: Grade
    confidence: float
    visible: float
    shade_lot: str
    colour: ColourFigures | None
    sizes: tuple[float, float, float, float, float] | None
    pictures: Pictures | None


@dataclass(frozen=True)
class DefectRecord:
    """A defect, and the inspection that found it."""

    inspection_id: int
    run_id: int | None
    face: int | None
    taken_at: datetime
    defect: Defect


@dataclass(frozen=True)
class ShadeLotRecord:
    """Tiles of a shade lot.

    Attributes
    ----------
    name
        Of the lot.
    tiles
        How many.
    first_at, last_at
        When the first and the last of them were seen.
    offset_lab
        Mean difference of their colour from that of their own faces.
    """

    name: str
    tiles: int
    first_at: datetime
    last_at: datetime
    offset_lab: Lab


@dataclass(frozen=True)
class SkippedImage:
    """An image that wasn't inspected, and why."""

    image: str
    taken_at: datetime
    reason: str


@dataclass(frozen=True)
class InnovationRecord:
    """How far a tile was from what the controller expected of it, and what the control charts made of that.

    Attributes
    ----------
    run_id
        The run.
    at
        When the tile was fired.
    surprise
        How little the tile fits, in standard deviations, about normal (0, 1) while all is well.
    values
        Of L*, a* and b* apart, normal (0, 1) while all is well: what the charts watch.
    accepted
        Whether the controller believed it.
    signals
        What the charts say to it: ``L:ewma+`` for the average of L* beyond its upper limit, ``a:cusum-``,
        ``b:rule2`` for the second of Nelson's rules.
    inspection_id
        The tile; ``None`` if it isn't in the store.
    """

    run_id: int
    at: datetime
    surprise: float
    values: tuple[float, float, float]
    accepted: bool
    signals: tuple[str, ...] = ()
    inspection_id: int | None = None


@dataclass(frozen=True)
class ProposalRecord:
    """A correction that the controller proposed, and what the line's daemon answered.

    Attributes
    ----------
    proposal_id
        Rising.
    run_id
        The run it is for.
    made_at, reason
        When and why it was proposed.
    drift
        JSON of a drift state file.
    answered_at
        When the answer came; ``None`` as long as there is none.
    number
        Number of the correction in the journal; ``None`` if it wasn't taken.
    answer
        Why it wasn't taken; empty if it was.
    """

    proposal_id: int
    run_id: int
    made_at: datetime
    reason: str
    drift: str = field(repr=False)
    answered_at: datetime | None = None
    number: int | None = None
    answer: str = ""


@dataclass(frozen=True)
class InspectionAlarm:
    """An alarm of the inspector.

    Attributes
    ----------
    alarm_id
        Rising.
    run_id
        The run it is about; ``None`` if about none.
    code
        What kind it is.
    subject
        What it is about, if there may be several of a kind at a time.
    text
        What happened.
    raised_at, cleared_at
        From when till when it was up; ``cleared_at`` is ``None`` as long as it is.
    told
        Whether the line's daemon was told.
    """

    alarm_id: int
    run_id: int | None
    code: str
    subject: str
    text: str
    raised_at: datetime
    cleared_at: datetime | None
    told: bool
