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
    """A run as the journal has it."""

    run_id: int
    facts: RunFacts
    begun_at: datetime
    finished_at: datetime | None


@dataclass(frozen=True)
class Intent:
    """An arm put down before the printer hears of it."""

    arm_id: int
    run_id: int
    face: int
    attempt: int


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
    """An arm as the journal has it; ``reprint`` is the number of the operator's order it serves, if any."""

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


@dataclass(frozen=True)
class NoteRecord:
    """An event that the line put down: an alarm, an operator's command, a change of state."""

    note_id: int
    at: datetime
    kind: str
    detail: Mapping[str, object]
