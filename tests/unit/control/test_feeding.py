from __future__ import annotations

from tilefab.control.feeding import Feeding, watch_feed

WAY = 1000
WORD = 1 << 32


def look(before: Feeding, fed: int, seen: int, position: int, boot: int = 1) -> Feeding:
    return watch_feed(
        before,
        plc_boot=boot,
        tiles_fed=fed % WORD,
        tile_seq=seen % WORD,
        position_counts=position % WORD,
        way_counts=WAY,
    )


def test_tiles_on_their_way_are_counted() -> None:
    now = look(Feeding(), 5, 3, 0)
    assert now.coming == 2
    now = look(now, 6, 4, 200)
    assert (now.coming, now.overdue) == (2, False)


def test_a_tile_taken_off_is_given_up_after_the_whole_way() -> None:
    now = look(Feeding(), 5, 3, 0)
    now = look(now, 5, 3, WAY)
    assert (now.coming, now.overdue) == (2, False)
    now = look(now, 5, 3, WAY + 1)
    assert (now.coming, now.overdue) == (0, True)
    # The next ones count as before.
    now = look(now, 7, 3, WAY + 50)
    assert now.coming == 2
    now = look(now, 7, 5, WAY + 90)
    assert (now.coming, now.overdue) == (0, False)


def test_an_empty_loader_is_told_of_and_again_when_tiles_stop_again() -> None:
    now = look(Feeding(), 3, 3, 0)
    now = look(now, 3, 3, WAY + 1)
    assert now.overdue
    now = look(now, 4, 3, WAY + 2)
    now = look(now, 4, 4, WAY + 10)
    assert not now.overdue
    assert look(now, 4, 4, 2 * WAY + 20).overdue


def test_a_belt_at_rest_keeps_what_lies_on_it() -> None:
    now = look(Feeding(), 5, 3, 70)
    for _ in range(100):
        now = look(now, 5, 3, 70)
    assert now.coming == 2


def test_tiles_put_on_by_hand_do_not_feed_others_for_ever() -> None:
    now = look(Feeding(), 5, 9, 0)
    assert now.coming == 0
    assert look(now, 7, 9, 10).coming == 2


def test_counts_wrap() -> None:
    now = look(Feeding(), WORD + 1, WORD - 1, WORD - 10)
    assert now.coming == 2
    assert look(now, WORD + 1, WORD - 1, WORD + WAY - 10).coming == 2
    assert look(now, WORD + 1, WORD - 1, WORD + WAY - 9).coming == 0


def test_a_restart_begins_anew() -> None:
    now = look(Feeding(), 500, 3, 0)
    now = look(now, 2, 1, 0, boot=2)
    assert (now.coming, now.gone) == (1, 0)
