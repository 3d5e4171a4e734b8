"""What goes into the line's journal and comes out of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from tilefab.control.ledger import ArmState


@dataclass(frozen=True)
class RunFacts:
    """What a run prints.

    Attributes
    ----------
    job_hash
        Hex digest of all that decides what is printed.
    name
        For people.
    job_file
        Path of the job file.
    faces
        How many, 1 to 2**40.
    seed
        Job seed, 0 to 2**63 - 1.
    map_hash
        Hex digest of the texture map.
    """

    job_hash: str
    name: str
    job_file: str
    faces: int
    seed: int
    map_hash: str


@dataclass(frozen=True)
class RunRecord:
    """A run as the journal has it; ``correction`` is the number of its latest one, 0 without any."""

    run_id: int
    facts: RunFacts
    begun_at: datetime
    finished_at: datetime | None
    correction: int = 0


@dataclass(frozen=True)
class CorrectionRecord:
    """Other inks for the same colours, from some face of a run on.

    Attributes
    ----------
    run_id, number
        The run, and which of its corrections, 1 for the first; 0 stands for none: the job as its file says.
    press_key
        Hash of all that the corrected map in inks depends on, but for the texture map; see
        `tilefab.pipeline.corrected.corrected_plan`.
    drift
        How the press had drifted, as JSON; see `tilefab.io.drift_file.parse_drift`.
    reason
        Why, for people; at most 500 characters are kept.
    made_at
        When it was put down.
    """

    run_id: int
    number: int
    press_key: str
    drift: str
    reason: str
    made_at: datetime


@dataclass(frozen=True)
class Intent:
    """An arm put down before the printer hears of it; ``correction`` tells what inks its face is printed with."""

    arm_id: int
    run_id: int
    face: int
    attempt: int
    correction: int = 0


@dataclass(frozen=True)
class ArmChange:
    """A new state of an arm, or more facts about one that stays open; ``None`` leaves a fact as it was.

    Attributes
    ----------
    arm_id, state
        The arm and its state from now on.
    detect_seq, tile_seq
        Its tile, as the printer and the conveyor number it, u32.
    printer_boot, plc_boot
        Boots of the two that these numbers belong to.
    rows_printed
        Rows of the face on the tile.
    data_crc32
        Of the rows that the printer received.
    reason
        Why, for people; at most 500 characters are kept.
    """

    arm_id: int
    state: ArmState
    detect_seq: int | None = None
    tile_seq: int | None = None
    printer_boot: int | None = None
    plc_boot: int | None = None
    rows_printed: int | None = None
    data_crc32: int | None = None
    reason: str = ""


@dataclass(frozen=True)
class ArmRecord:
    """An arm as the journal has it.

    ``reprint`` is the number of the operator's order it serves, if any; ``correction`` that of the correction that its
    face is printed with. ``printed_at`` and ``passed_at`` are when the journal heard of that, which is later than it
    happened where the daemon was down; ``None`` where it never did, where an operator said so, and of arms from before
    the journal kept these times.
    """

    arm_id: int
    run_id: int
    face: int
    attempt: int
    reprint: int | None
    state: ArmState
    detect_seq: int | None
    tile_seq: int | None
    printer_boot: int | None
    plc_boot: int | None
    rows_printed: int | None
    data_crc32: int | None
    reason: str
    intended_at: datetime
    changed_at: datetime
    correction: int = 0
    printed_at: datetime | None = None
    passed_at: datetime | None = None


@dataclass(frozen=True, slots=True)
class PrintRecord:
    """An arm whose face was printed whole: what tells of a fired tile which it can be; fields as in `ArmRecord`."""

    run_id: int
    arm_id: int
    face: int
    attempt: int
    correction: int
    data_crc32: int | None
    state: ArmState
    printed_at: datetime
    passed_at: datetime | None


@dataclass(frozen=True)
class NoteRecord:
    """An event that the line put down: an alarm, an operator's command, a change of state."""

    note_id: int
    at: datetime
    kind: str
    detail: Mapping[str, object]
