from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from tilefab.control.ledger import ArmState, check_transition
from tilefab.control.reconcile import (
    ConveyorMemory,
    Known,
    OpenArm,
    PrintedArm,
    PrinterMemory,
    PrintState,
    Reconciliation,
    reconcile,
)
from tilefab.control.tile_tracking import Calibration

CALIBRATION = Calibration(printer_boot=1, plc_boot=2, seq_offset=100, position_offset_counts=0, detect_seq=3)
KNOWN = Known(CALIBRATION, highest_accepted_arm=9, trusted=True)
CONVEYOR = ConveyorMemory(boot_id=2, decided_seq=105, passed_bits=0b101)
"""Tile 105 passed, 104 was diverted, 103 passed."""


def printer(*outcomes: tuple[int, PrintedArm], last: int = 10, boot: int = 1) -> PrinterMemory:
    return PrinterMemory(boot, last, dict(outcomes))


def printed(state: PrintState, *, face: int = 7, detect: int = 5, rows: int = 50) -> PrintedArm:
    return PrintedArm(face, state, detect, rows, 0xABCD)


def settle(
    arm: OpenArm, memory: PrinterMemory, known: Known = KNOWN, conveyor: ConveyorMemory = CONVEYOR
) -> Reconciliation:
    return reconcile([arm], memory, conveyor, known)


def states(found: Reconciliation) -> list[ArmState]:
    return [verdict.state for verdict in found.verdicts]


INTENT = OpenArm(10, 7, ArmState.INTENT)
PRINTED = OpenArm(10, 7, ArmState.PRINTED, tile_seq=106, plc_boot=2)


def test_an_arm_the_printer_never_accepted_was_not_printed() -> None:
    found = settle(replace(INTENT, arm_id=11), printer(last=10))
    assert states(found) == [ArmState.UNPRINTED]


def test_an_arm_that_was_accepted_but_is_forgotten_is_in_doubt() -> None:
    assert states(settle(INTENT, printer(last=10))) == [ArmState.IN_DOUBT]


def test_a_printer_that_lost_its_memory_proves_nothing() -> None:
    lost = printer(last=0, boot=77)
    assert states(settle(replace(INTENT, arm_id=11), lost)) == [ArmState.IN_DOUBT]
    assert states(settle(replace(INTENT, arm_id=11), lost, replace(KNOWN, highest_accepted_arm=0))) == [
        ArmState.IN_DOUBT
    ]


def test_before_any_calibration_nothing_was_ever_sent() -> None:
    assert states(settle(replace(INTENT, arm_id=11), printer(last=0), Known(None, 0, trusted=False))) == [
        ArmState.UNPRINTED
    ]


@pytest.mark.parametrize("state", [PrintState.MISSED, PrintState.CANCELLED])
def test_no_row_printed_means_the_face_comes_again(state: PrintState) -> None:
    assert states(settle(INTENT, printer((10, printed(state, rows=0))))) == [ArmState.UNPRINTED]


def test_a_part_printed_is_told_with_its_rows() -> None:
    found = settle(INTENT, printer((10, printed(PrintState.PARTIAL, rows=12))))
    assert states(found) == [ArmState.PARTIAL]
    assert found.verdicts[0].rows_printed == 12


@pytest.mark.parametrize("state", [PrintState.QUEUED, PrintState.PRINTING])
def test_what_the_printer_still_holds_goes_on(state: PrintState) -> None:
    memory = printer((10, printed(state)))
    assert settle(INTENT, memory).continuing == {10: 105}
    assert settle(INTENT, memory, replace(KNOWN, trusted=False)).continuing == {10: None}
    assert not settle(INTENT, memory).verdicts


def test_printed_and_still_on_its_way_may_be_released() -> None:
    found = settle(INTENT, printer((10, printed(PrintState.PRINTED, detect=6))))
    assert states(found) == [ArmState.PRINTED]
    assert found.verdicts[0].tile_seq == 106
    assert found.waiting == {10: 106}


def test_printed_but_nobody_knows_which_tile_is_scrapped_by_the_diverter() -> None:
    memory = printer((10, printed(PrintState.PRINTED, detect=6)))
    found = settle(INTENT, memory, replace(KNOWN, trusted=False))
    assert states(found) == [ArmState.PRINTED, ArmState.DIVERTED]
    assert not found.waiting


def test_what_was_under_the_head_when_ink_failed_is_never_released() -> None:
    spoilt = replace(KNOWN, spoilt=True)
    found = settle(INTENT, printer((10, printed(PrintState.PRINTED, detect=6))), spoilt)
    assert states(found) == [ArmState.PRINTED, ArmState.DIVERTED]
    assert settle(INTENT, printer((10, printed(PrintState.PRINTING, detect=6))), spoilt).continuing == {10: None}
    # What comes after, or was recorded before, is as good as ever.
    assert settle(INTENT, printer((10, printed(PrintState.QUEUED, detect=6))), spoilt).continuing == {10: 106}
    assert settle(PRINTED, printer(), spoilt).waiting == {10: 106}


def test_what_was_barred_once_stays_so() -> None:
    barred = replace(INTENT, barred=True)
    assert settle(barred, printer((10, printed(PrintState.PRINTING)))).continuing == {10: None}
    found = settle(barred, printer((10, printed(PrintState.PRINTED, detect=6))))
    assert states(found) == [ArmState.PRINTED, ArmState.DIVERTED]


def test_a_face_of_another_number_is_never_guessed_at() -> None:
    assert states(settle(INTENT, printer((10, printed(PrintState.PRINTED, face=8))))) == [ArmState.IN_DOUBT]


@pytest.mark.parametrize(
    ("tile", "state"),
    [(105, ArmState.PASSED), (104, ArmState.DIVERTED), (103, ArmState.PASSED), (41, ArmState.IN_DOUBT)],
)
def test_the_conveyor_says_what_became_of_a_printed_tile(tile: int, state: ArmState) -> None:
    assert states(settle(replace(PRINTED, tile_seq=tile), printer())) == [state]


def test_a_printed_tile_on_its_way_is_waited_for() -> None:
    found = settle(PRINTED, printer())
    assert not found.verdicts
    assert found.waiting == {10: 106}


@pytest.mark.parametrize(
    ("released", "state"), [(False, ArmState.DIVERTED), (True, ArmState.IN_DOUBT), (None, ArmState.IN_DOUBT)]
)
def test_after_a_restart_of_the_conveyor_a_released_tile_is_in_doubt(released: bool | None, state: ArmState) -> None:
    moved = replace(PRINTED, released=released)
    assert states(settle(moved, printer(), conveyor=replace(CONVEYOR, boot_id=9))) == [state]
    assert states(settle(moved, printer(), replace(KNOWN, trusted=False))) == [state]


def test_every_verdict_is_a_way_that_the_ledger_knows() -> None:
    """Whatever the devices say: no face may pass on less than proof, and every verdict can be written."""
    memories = [
        printer(*([(10, printed(state, face=face, detect=detect))] if state else []), last=last, boot=boot)
        for state, face, detect, last, boot in itertools.product(
            [None, *PrintState], (7, 8), (4, 5, 6), (0, 9, 10, 12), (1, 77)
        )
    ]
    arms = [
        OpenArm(10, 7, state, tile, boot, released)
        for state, tile, boot, released in itertools.product(
            (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED),
            (None, 30, 104, 105, 106),
            (None, 2, 3),
            (None, False, True),
        )
        if state is ArmState.PRINTED or tile is None
    ]
    for arm, memory, trusted, calibration in itertools.product(arms, memories, (False, True), (None, CALIBRATION)):
        found = settle(arm, memory, Known(calibration, 9, trusted))
        now = arm.state
        for verdict in found.verdicts:
            check_transition(now, verdict.state)
            now = verdict.state
        decided = now not in (ArmState.INTENT, ArmState.ARMED, ArmState.PRINTED)
        assert decided + (10 in found.waiting) + (10 in found.continuing) == 1
        if not trusted:
            assert not found.waiting
            assert set(found.continuing.values()) <= {None}
        if now is ArmState.PASSED:
            assert CONVEYOR.fate(found.verdicts[-2].tile_seq if len(found.verdicts) > 1 else arm.tile_seq)
