from __future__ import annotations

import pytest

from tilefab.control.tile_tracking import (
    Standstill,
    TileShape,
    calibrate,
    cross_check,
    print_start_counts,
)

WORD = 1 << 32
SHAPE = TileShape(length_counts=12000, pitch_counts=14000)


def still(**changes: int) -> Standstill:
    facts = {
        "printer_boot": 1,
        "encoder_counts": 100_000,
        "detect_seq": 40,
        "plc_boot": 2,
        "position_counts": 7_000,
        "tile_seq": 5,
    }
    return Standstill(**(facts | changes))


def test_counts_of_both_devices_are_matched() -> None:
    calibration = calibrate(still())
    assert calibration.tile_seq(41) == 6
    assert calibration.detect_seq_of(6) == 41
    assert calibration.tile_seq(40) == 5


def test_numbers_wrap() -> None:
    calibration = calibrate(still(tile_seq=WORD - 1, position_counts=WORD - 50))
    assert calibration.tile_seq(41) == 0
    assert calibration.detect_seq_of(0) == 41
    assert cross_check(calibration, {41: 100_100}, 0, 50, 2) == ""


@pytest.mark.parametrize(("slip", "agrees"), [(0, True), (60, True), (-60, True), (61, False), (-61, False)])
def test_an_edge_must_be_where_the_other_device_saw_it(slip: int, agrees: bool) -> None:
    calibration = calibrate(still())
    found = cross_check(calibration, {41: 105_000}, 6, 12_000 + slip, 60)
    assert (found == "") is agrees
    if not agrees:
        assert found is not None
        assert str(slip) in found


def test_an_edge_the_printer_has_not_told_of_is_not_judged() -> None:
    assert cross_check(calibrate(still()), {}, 6, 12_000, 60) is None


def test_the_tile_at_rest_is_matched_by_definition() -> None:
    assert cross_check(calibrate(still()), {}, 5, 12_345, 60) == ""


@pytest.mark.parametrize(
    ("distance", "bad"), [(14_000, False), (40_000, False), (13_000, False), (12_999, True), (300, True)]
)
def test_tiles_may_come_late_but_never_early(distance: int, bad: bool) -> None:
    assert bool(SHAPE.edge_problem(distance)) is bad


@pytest.mark.parametrize(
    ("length", "word"),
    [(12_000, ""), (12_480, ""), (11_520, ""), (12_481, "double feed"), (24_000, "double feed"), (11_519, "broken")],
)
def test_lengths(length: int, word: str) -> None:
    found = SHAPE.length_problem(length)
    assert bool(found) is bool(word)
    assert word in found


def test_bleed_begins_before_the_tile() -> None:
    assert print_start_counts(1_000, 50_000, 40) == 50_960
