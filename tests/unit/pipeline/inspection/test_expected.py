"""Which faces a tile can show, and which arm put its face on it."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from tilefab.control.ledger import ArmState
from tilefab.io.journal import PrintRecord
from tilefab.pipeline.inspection.expected import ExpectedTiles, chosen_print

NOW = datetime(2026, 11, 24, 12, 0, tzinfo=UTC)
MINUTE = timedelta(minutes=1)


def printed(
    arm_id: int, minutes_ago: float, *, face: int | None = None, run_id: int = 1, state: ArmState = ArmState.PASSED
) -> PrintRecord:
    at = NOW - minutes_ago * MINUTE
    return PrintRecord(
        run_id=run_id,
        arm_id=arm_id,
        face=arm_id if face is None else face,
        attempt=1,
        correction=0,
        state=state,
        printed_at=at,
        passed_at=at,
        data_crc32=None,
    )


class Prints:
    """A journal's prints."""

    def __init__(self, *records: PrintRecord) -> None:
        self.records = list(records)
        self.asked: list[datetime] = []

    def __call__(self, since: datetime) -> Sequence[PrintRecord]:
        self.asked.append(since)
        return sorted((r for r in self.records if r.printed_at >= since), key=lambda r: r.printed_at)


def none_seen(arm_ids: Sequence[int]) -> frozenset[int]:
    return frozenset()


def expected(*records: PrintRecord, seen: frozenset[int] = frozenset(), now: datetime = NOW) -> ExpectedTiles:
    tiles = ExpectedTiles(180 * MINUTE)
    tiles.update(now, Prints(*records), lambda arms: seen & set(arms))
    return tiles


def test_candidates_were_printed_within_the_window_and_not_seen_yet() -> None:
    tiles = expected(
        printed(1, 200), printed(2, 100), printed(3, 50), printed(4, 40, state=ArmState.DIVERTED), seen=frozenset({3})
    )
    assert tiles.candidates(NOW) == {1: [2]}
    assert tiles.candidates(NOW - 110 * MINUTE) == {1: [1]}


def test_runs_with_the_most_candidates_come_first() -> None:
    tiles = expected(printed(1, 60, run_id=1), printed(2, 50, run_id=2), printed(3, 40, run_id=2))
    assert list(tiles.candidates(NOW).items()) == [(2, [2, 3]), (1, [1])]
    assert tiles.runs == (1, 2)
    assert tiles.newest_run == 2
    assert expected().newest_run is None


def test_the_run_whose_tiles_are_due_comes_first() -> None:
    tiles = expected(
        printed(1, 100, run_id=1), printed(2, 55, run_id=1), printed(3, 40, run_id=2), printed(4, 39, run_id=2)
    )
    tiles.took(56 * MINUTE)
    assert list(tiles.candidates(NOW)) == [1, 2]
    tiles = expected(printed(1, 100, run_id=1), printed(2, 55, run_id=1), printed(3, 40, run_id=2))
    tiles.took(41 * MINUTE)
    assert list(tiles.candidates(NOW)) == [2, 1]


def test_a_tile_that_was_seen_is_no_candidate_any_more() -> None:
    tiles = expected(printed(1, 60), printed(2, 50))
    record, before = tiles.print_of(1, 1, NOW)
    assert record is not None
    assert not before
    tiles.saw(record, NOW)
    assert tiles.candidates(NOW) == {1: [2]}
    assert tiles.print_of(1, 1, NOW) == (record, True)
    assert tiles.transit == 60 * MINUTE


def test_the_journal_is_read_from_where_it_was_left() -> None:
    tiles, prints = ExpectedTiles(180 * MINUTE), Prints(printed(1, 30))
    asked: list[int] = []

    def seen(arm_ids: Sequence[int]) -> frozenset[int]:
        asked.extend(arm_ids)
        return frozenset()

    tiles.update(NOW, prints, seen)
    prints.records.append(printed(2, 10))
    tiles.update(NOW, prints, seen)
    assert prints.asked == [NOW - 360 * MINUTE, NOW - 32 * MINUTE]
    assert asked == [1, 2]
    prints.records = [printed(2, 10, state=ArmState.DIVERTED)]
    tiles.update(NOW, prints, seen)
    assert tiles.candidates(NOW) == {1: [1]}


def test_old_prints_are_forgotten_and_a_leap_of_the_clock_forgets_none() -> None:
    tiles, prints = ExpectedTiles(180 * MINUTE), Prints(printed(1, 10))
    tiles.update(NOW, prints, none_seen)
    tiles.update(NOW + timedelta(days=300), prints, none_seen)
    assert tiles.candidates(NOW) == {1: [1]}
    prints.records = [printed(2, -400)]
    tiles.update(NOW + 401 * MINUTE, prints, none_seen)
    assert tiles.candidates(NOW) == {}
    assert tiles.candidates(NOW + 401 * MINUTE) == {1: [2]}


def test_prints_of_a_clock_that_was_ahead_dont_hide_later_ones() -> None:
    tiles, prints = ExpectedTiles(180 * MINUTE), Prints(printed(1, -600))
    tiles.update(NOW, prints, none_seen)
    prints.records.append(printed(2, -1))
    tiles.update(NOW + 2 * MINUTE, prints, none_seen)
    assert tiles.candidates(NOW + 2 * MINUTE) == {1: [2]}


def test_of_a_face_printed_twice_the_arm_is_taken_whose_time_fits() -> None:
    first, second = printed(1, 100, face=7), printed(2, 55, face=7)
    assert chosen_print([first, second], set(), NOW, None) == (first, False)
    assert chosen_print([first, second], set(), NOW, 54 * MINUTE) == (second, False)
    assert chosen_print([first, second], {1}, NOW, 101 * MINUTE) == (second, False)
    assert chosen_print([first, second], {1, 2}, NOW, 54 * MINUTE) == (second, True)
    assert chosen_print([], set(), NOW, None) == (None, False)
    diverted = printed(3, 55, face=7, state=ArmState.DIVERTED)
    assert chosen_print([diverted], set(), NOW, None) == (None, False)


def test_a_tile_is_never_of_an_arm_that_printed_later_if_another_can_be_it() -> None:
    early, late = printed(1, 100), printed(2, 10)
    assert chosen_print([early, late], set(), NOW - 20 * MINUTE, 5 * MINUTE) == (early, False)
    assert chosen_print([late], set(), NOW - 20 * MINUTE, 5 * MINUTE) == (late, False)


def test_tiles_leave_the_kiln_after_their_usual_way() -> None:
    tiles = expected(*(printed(arm, 100 - arm) for arm in range(1, 91)))
    assert tiles.leaving(NOW - 5 * MINUTE, NOW) == 5
    for arm in range(1, 11):
        record, _ = tiles.print_of(1, arm, NOW)
        assert record is not None
        tiles.saw(record, record.printed_at + 40 * MINUTE)
    assert tiles.leaving(NOW - 5 * MINUTE, NOW) == 5
    assert tiles.leaving(NOW, NOW + 90 * MINUTE) == 30
    assert expected(printed(1, 100, state=ArmState.DIVERTED)).leaving(NOW - 300 * MINUTE, NOW) == 0


def test_a_simulated_line_may_go_faster_than_the_clock() -> None:
    tiles = ExpectedTiles(3 * MINUTE, clock_rate=60.0)
    tiles.update(NOW, Prints(printed(1, 1.25)), none_seen)
    assert tiles.leaving(NOW - MINUTE / 60, NOW) == 1
