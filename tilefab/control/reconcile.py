"""After a restart the devices are the authority: what became of faces that the journal left open.

Everything here follows from three facts about the devices. The printer accepts an arm at most once and remembers the
last 64 through a loss of power. A session opened since fences off whatever an earlier one sent. The diverter scraps
every tile that wasn't released, and a tile is released only after its face was recorded as printed. What doesn't follow
is in doubt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from tilefab.control.ledger import ArmState
from tilefab.control.tile_tracking import Calibration

LOG_LENGTH = 64
"""Tiles whose fate the conveyor remembers."""


class PrintState(StrEnum):
    """What the printer says of an arm."""

    QUEUED = "queued"
    PRINTING = "printing"
    PRINTED = "printed"
    MISSED = "missed"
    PARTIAL = "partial"
    CANCELLED = "cancelled"


UNFINISHED = (PrintState.QUEUED, PrintState.PRINTING)
"""States that an arm leaves by itself."""


@dataclass(frozen=True)
class OpenArm:
    """An arm that the journal holds open.

    Attributes
    ----------
    arm_id, face
        Its numbers.
    state
        Intent, armed or printed.
    tile_seq
        The conveyor's number of its tile, if the journal has it.
    plc_boot
        Boot of the conveyor's controller when it was recorded last.
    released
        Whether its tile may have been released: ``None`` if that isn't known, as after a restart.
    barred
        Whether it was found before that its tile must never be released.
    """

    arm_id: int
    face: int
    state: ArmState
    tile_seq: int | None = None
    plc_boot: int | None = None
    released: bool | None = None
    barred: bool = False


@dataclass(frozen=True)
class PrinterMemory:
    """What the printer remembers.

    Attributes
    ----------
    boot_id
        Changes at each boot.
    last_accepted_arm
        Highest arm it ever accepted; 0 if none, or if it lost its memory.
    outcomes
        State, face, detect_seq and rows printed of its latest arms.
    """

    boot_id: int
    last_accepted_arm: int
    outcomes: Mapping[int, PrintedArm]


@dataclass(frozen=True)
class PrintedArm:
    """What the printer remembers of one arm."""

    face: int
    state: PrintState
    detect_seq: int
    rows_printed: int
    data_crc32: int


@dataclass(frozen=True)
class ConveyorMemory:
    """Which of the latest tiles passed the diverter; see `LOG_LENGTH`."""

    boot_id: int
    decided_seq: int
    passed_bits: int

    def fate(self, tile_seq: int) -> bool | None:
        """Whether a tile passed (True) or was diverted; ``None`` if it isn't decided yet.

        Raises
        ------
        LookupError
            If the conveyor no longer knows.
        """
        age = (self.decided_seq - tile_seq + (1 << 31)) % (1 << 32) - (1 << 31)
        if age < 0:
            return None
        if age >= LOG_LENGTH:
            raise LookupError(f"tile {tile_seq} is {age} tiles back, the conveyor remembers {LOG_LENGTH}")
        return bool(self.passed_bits >> age & 1)


@dataclass(frozen=True)
class Known:
    """What earlier sessions put down about the devices, and whether it still holds.

    Attributes
    ----------
    calibration
        The last match of the two counts, or ``None``.
    highest_accepted_arm
        Highest arm that the journal knows the printer to have accepted; 0 if none.
    trusted
        Whether tiles are where they were: both counts still match as they did, and nothing happened that moves tiles by
        other means than the belt.
    spoilt
        Whether ink or a nozzle failed since: then whatever was begun or finished since may lack ink.
    """

    calibration: Calibration | None
    highest_accepted_arm: int
    trusted: bool
    spoilt: bool = False


@dataclass(frozen=True)
class Verdict:
    """What became of an arm.

    Attributes
    ----------
    arm_id, state
        The arm and its new state.
    reason
        For the journal.
    tile_seq
        The tile, where it is known and wasn't before.
    rows_printed, data_crc32, detect_seq
        From the printer, where it knows.
    """

    arm_id: int
    state: ArmState
    reason: str
    tile_seq: int | None = None
    rows_printed: int | None = None
    data_crc32: int | None = None
    detect_seq: int | None = None


def printer_forgot(printer: PrinterMemory, known: Known) -> bool:
    """Whether the printer may have lost its memory of arms: then absence there proves nothing."""
    if printer.last_accepted_arm < known.highest_accepted_arm:
        return True
    same_boot = known.calibration is not None and known.calibration.printer_boot == printer.boot_id
    return not same_boot and printer.last_accepted_arm == 0 and known.calibration is not None


@dataclass(frozen=True)
class Reconciliation:
    """What is to be done about open arms.

    Attributes
    ----------
    verdicts
        In the order of their making; an arm found printed may get a second one, on its tile.
    waiting
        Arms that are printed, with the number of the tile that is still on its way to the diverter and may be released.
    continuing
        Arms that the printer still holds, with the number of their tile: ``None`` where that can't be known, so that
        the tile must never be released.
    """

    verdicts: tuple[Verdict, ...]
    waiting: Mapping[int, int]
    continuing: Mapping[int, int | None]


def reconcile(
    arms: Sequence[OpenArm], printer: PrinterMemory, conveyor: ConveyorMemory, known: Known
) -> Reconciliation:
    """Decide what became of open arms, with the belt standing still.

    Parameters
    ----------
    arms
        Open in the journal.
    printer, conveyor
        What the devices say now, read after a new session was opened.
    known
        From the journal.
    """
    verdicts: list[Verdict] = []
    waiting: dict[int, int] = {}
    continuing: dict[int, int | None] = {}
    forgot = printer_forgot(printer, known)
    for arm in arms:
        state, tile_seq, released = arm.state, arm.tile_seq, arm.released
        if state in (ArmState.INTENT, ArmState.ARMED):
            found = printer.outcomes.get(arm.arm_id)
            if found is not None and found.face == arm.face and found.state in UNFINISHED:
                continuing[arm.arm_id] = _tile_of(arm, found, known)
                continue
            verdict = _of_printing(arm, printer, forgot, known)
            verdicts.append(verdict)
            # A tile is released only once its face stands in the journal as printed.
            state, tile_seq, released = verdict.state, verdict.tile_seq, False
        if state != ArmState.PRINTED:
            continue
        fate = _of_tile(arm, tile_seq, released, conveyor, known.trusted)
        if fate is not None:
            verdicts.append(fate)
        elif tile_seq is not None:
            waiting[arm.arm_id] = tile_seq
    return Reconciliation(tuple(verdicts), waiting, continuing)


def _tile_of(arm: OpenArm, found: PrintedArm, known: Known) -> int | None:
    begun = found.state is not PrintState.QUEUED
    if known.calibration is None or not known.trusted or arm.barred or (known.spoilt and begun):
        return None
    return known.calibration.tile_seq(found.detect_seq)


def _of_printing(arm: OpenArm, printer: PrinterMemory, forgot: bool, known: Known) -> Verdict:
    found = printer.outcomes.get(arm.arm_id)
    if found is None:
        if arm.arm_id > printer.last_accepted_arm and not forgot:
            return Verdict(arm.arm_id, ArmState.UNPRINTED, "the printer never accepted it")
        why = "the printer lost its memory" if forgot else "the printer no longer remembers it"
        return Verdict(arm.arm_id, ArmState.IN_DOUBT, f"{why}: it may have been printed")
    rows = found.rows_printed
    if found.face != arm.face:
        reason = f"the printer knows it as face {found.face}, the journal as face {arm.face}"
        return Verdict(arm.arm_id, ArmState.IN_DOUBT, reason, rows_printed=rows)
    if found.state in (PrintState.MISSED, PrintState.CANCELLED):
        return Verdict(arm.arm_id, ArmState.UNPRINTED, f"{found.state}: no row was printed", rows_printed=0)
    if found.state is PrintState.PARTIAL:
        return Verdict(arm.arm_id, ArmState.PARTIAL, f"printed to row {rows}", rows_printed=rows)
    return Verdict(
        arm.arm_id,
        ArmState.PRINTED,
        "printed, found when the line was brought up",
        tile_seq=_tile_of(arm, found, known),
        rows_printed=rows,
        data_crc32=found.data_crc32,
        detect_seq=found.detect_seq,
    )


def _of_tile(
    arm: OpenArm, tile_seq: int | None, released: bool | None, conveyor: ConveyorMemory, trusted: bool
) -> Verdict | None:
    """What became of a printed tile; ``None`` if it is still on its way and may be released."""
    scrapped = Verdict(arm.arm_id, ArmState.DIVERTED, "its tile was never released, the diverter scraps it")
    if tile_seq is None or (arm.plc_boot is not None and arm.plc_boot != conveyor.boot_id):
        if released is False:
            return scrapped
        return Verdict(arm.arm_id, ArmState.IN_DOUBT, "the conveyor was restarted: its tile may have passed or not")
    try:
        passed = conveyor.fate(tile_seq)
    except LookupError as error:
        return scrapped if released is False else Verdict(arm.arm_id, ArmState.IN_DOUBT, str(error))
    if passed is not None:
        state = ArmState.PASSED if passed else ArmState.DIVERTED
        return Verdict(arm.arm_id, state, "the conveyor let it pass" if passed else "the conveyor diverted it")
    if trusted:
        return None
    if released is False:
        return scrapped
    return Verdict(arm.arm_id, ArmState.IN_DOUBT, "tiles were moved: which one was released isn't known")
