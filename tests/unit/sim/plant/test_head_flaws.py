"""What the head does wrong unnoticed, and prints that are kept until their tile has left the plant."""

from __future__ import annotations

from zlib import crc32

import pytest

from sim.plant.physics.faces import ArmAnswer, State, StripAnswer
from sim.plant.physics.flaws import Flaw, KeptPrint, Shelf
from tests.unit.sim.plant.physics_bench import EYE_TO_HEAD, Bench, face

KEEP = {"keep_prints": True}
ALL = {"release_base": 1, "release_bits": 0xFFFFFFFF}
NOZZLE = Flaw("nozzle", ink=1, at_mm=20.0, width_mm=0.2)


def bench_with(printer=KEEP, **tables):
    bench = Bench(printer=printer, **tables)
    bench.start(**ALL)
    return bench


def strip(bench, arm, row, rows):
    data = bytearray(face(arm)[row * 40 : (row + rows) * 40])
    return bench.head.take(arm, row, rows, len(data), crc32(data), None, data)


def print_on(bench, arm):
    bench.wait_for_tile(arm)
    assert bench.arm(arm, arm) is ArmAnswer.ACCEPTED
    for row in (0, 200, 400):
        assert strip(bench, arm, row, 200) is StripAnswer.TAKEN


def lead(bench, number):
    return bench.tiles()[number - 1].lead_x + EYE_TO_HEAD


def test_prints_are_kept_with_their_layout_until_the_tile_is_decided_or_fired():
    bench = bench_with(loader={"tiles": 2}, kiln={"cycle_minutes": 40.0})
    print_on(bench, 1)
    print_on(bench, 2)
    bench.until_travel(lead(bench, 2) + 601)
    one, two = (tile.prints[0].kept for tile in bench.tiles())
    assert one is not None
    assert two is not None
    assert (one.cols, one.channels, one.bits, one.pitch_mm) == (10, 4, 8, 1.0)
    assert (one.data, two.data) == (face(1)[:24000], face(2)[:24000])
    assert bench.head.shelf.used == 48000
    assert bench.outcome(1).data is None
    bench.command(release_bits=1)
    bench.until_travel(lead(bench, 2) + 2001)
    bench.after(60)
    assert [tile.fate for tile in bench.tiles()] == ["in_kiln", "in_kiln"]
    bench.after(40 * 60)
    assert [tile.fate for tile in bench.tiles()] == ["fired", "fired"]
    assert bench.head.shelf.used == 0
    assert [tile.prints[0].kept for tile in bench.tiles()] == [None, None]


def test_a_scrapped_tile_and_a_print_beside_tiles_keep_nothing():
    bench = Bench(printer=KEEP, loader={"tiles": 2})
    bench.start()
    print_on(bench, 1)
    bench.until_travel(lead(bench, 1) + 601)
    assert bench.head.shelf.used == 24000
    print_on(bench, 2)
    bench.until_travel(lead(bench, 2) + 300)
    bench.plant._remove(bench.tiles()[1])
    bench.until_travel(lead(bench, 2) + 601)
    assert bench.counts()["prints_beside"] == 1
    bench.until_travel(lead(bench, 1) + 2001)
    assert bench.tiles()[0].fate == "diverted"
    assert bench.head.shelf.used == 0


def test_of_a_partial_print_the_printed_rows_are_kept():
    bench = bench_with()
    bench.wait_for_tile()
    bench.arm(1)
    strip(bench, 1, 0, 300)
    bench.until_travel(lead(bench, 1) + 301)
    kept = bench.tiles()[0].prints[0].kept
    assert bench.outcome(1).state is State.PARTIAL
    assert kept is not None
    assert kept.data == face(1)[: 300 * 40]


def test_a_print_without_room_or_with_a_gap_is_not_kept():
    bench = bench_with(KEEP | {"keep_bytes": 30000})
    print_on(bench, 1)
    print_on(bench, 2)
    bench.wait_for_tile(3)
    bench.arm(3, 3)
    strip(bench, 3, 0, 200)
    bench.send(3, 200, 200)
    strip(bench, 3, 400, 200)
    bench.until_travel(lead(bench, 3) + 601)
    prints = [tile.prints[0] for tile in bench.tiles()[:3]]
    assert [print_.complete for print_ in prints] == [True] * 3
    assert [print_.kept is None for print_ in prints] == [False, True, True]
    assert bench.head.shelf.used == 24000


def test_nothing_is_kept_unless_asked_for():
    bench = bench_with({})
    bench.wait_for_tile()
    bench.arm(1)
    bench.send(1, 0, 600)
    bench.until_travel(lead(bench, 1) + 601)
    assert bench.tiles()[0].prints[0].kept is None
    assert "flaws" not in bench.truth()[1]["prints"][0]


def test_a_shelf_is_full_at_its_room():
    shelf = Shelf(10)
    six = KeptPrint(bytes(6), 1, 1, 8, 1.0)
    four = KeptPrint(bytes(4), 1, 1, 8, 1.0)
    assert shelf.put(six) is six
    assert shelf.put(six) is None
    assert shelf.put(four) is four
    shelf.take(six)
    shelf.take(None)
    assert shelf.used == 4


def test_an_unnoticed_nozzle_marks_prints_and_holds_nothing():
    bench = bench_with()
    print_on(bench, 1)
    bench.until_travel(lead(bench, 1) + 99.5)
    bench.head.set_nozzles(True, NOZZLE, noticed=False)
    assert not bench.head.held
    print_on(bench, 2)
    bench.until_travel(lead(bench, 2) + 601)
    assert bench.head.clear(bench.head.fault_counter) == 0
    bench.head.set_nozzles(False)
    print_on(bench, 3)
    bench.until_travel(lead(bench, 3) + 601)
    prints = [bench.truth()[tile]["prints"][0] for tile in (1, 2, 3)]
    assert [print_["nozzle_out"] for print_ in prints] == [True, True, False]
    assert prints[0]["flaws"] == [NOZZLE.view() | {"from_row": 100}]
    assert prints[1]["flaws"] == [NOZZLE.view()]
    assert "flaws" not in prints[2]


def test_a_noticed_nozzle_leaves_its_column_white_and_holds():
    bench = bench_with()
    print_on(bench, 1)
    bench.until_travel(lead(bench, 1) + 10.5)
    bench.head.set_nozzles(True, NOZZLE)
    assert (bench.head.held, bench.head.nozzle_out) == (True, True)
    bench.until_travel(lead(bench, 1) + 601)
    assert bench.truth()[1]["prints"][0]["flaws"][0]["from_row"] == 11
    assert bench.head.clear(bench.head.fault_counter) == 2


def test_banding_lasts_and_double_prints_are_counted():
    bench = bench_with()
    banding, double = Flaw("banding", strength=0.1, period_mm=20.0), Flaw("double_print", strength=0.5, shift_mm=2.0)
    bench.head.set_banding(banding)
    bench.head.print_twice(double, 2)
    for arm in (1, 2, 3):
        print_on(bench, arm)
        bench.until_travel(lead(bench, arm) + 601)
    bench.head.set_banding(None)
    print_on(bench, 4)
    bench.until_travel(lead(bench, 4) + 601)
    flaws = [[flaw.kind for flaw in tile.prints[0].flaws] for tile in bench.tiles()[:4]]
    assert flaws == [["banding", "double_print"], ["banding", "double_print"], ["banding"], []]


@pytest.mark.parametrize("kind", ["nozzle", "banding", "double_print"])
def test_a_flaw_tells_everything_of_itself(kind):
    flaw = Flaw(kind, 1, 2.0, 3.0, 4, 5.0, 6.0, 7.0)
    assert Flaw(**flaw.view()) == flaw
