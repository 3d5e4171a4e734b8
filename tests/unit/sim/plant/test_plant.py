"""The plant as a whole: tiles from the loader to the gauge, what goes wrong with them, and the truth about it."""

from __future__ import annotations

import json
import random
import tracemalloc
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.plant.physics.conveyor import Trouble
from sim.plant.physics.faces import ArmAnswer, State
from sim.plant.physics.tiles import NumberSet
from tests.unit.sim.plant.physics_bench import EYE_TO_HEAD, Bench

ALL = {"release_base": 1, "release_bits": 0xFFFFFFFF}
TO_KILN = 800 + EYE_TO_HEAD + 2000 + 3000


def print_on(bench, arm, seq, **changes):
    """Arm and stream a face for a tile."""
    assert bench.arm(arm, seq, **changes) is ArmAnswer.ACCEPTED
    bench.send(arm, 0, 600)


def test_a_tile_goes_all_the_way():
    bench = Bench(loader={"tiles": 3}, kiln={"cycle_minutes": 40.0})
    bench.start(**ALL)
    for seq in (1, 2, 3):
        bench.wait_for_tile(seq)
        print_on(bench, seq, seq)
    bench.until_travel(TO_KILN + 1400 + 1)
    assert [tile["fate"] for tile in bench.truth().values()] == ["in_kiln"] * 3
    assert bench.plant.kiln.view().tiles_inside == 3
    entered = bench.wall
    bench.command(run=False)
    bench.until(entered + 40 * 60 + 1)
    assert [tile["fate"] for tile in bench.truth().values()] == ["fired"] * 3
    reading = bench.plant.gauge.measure()
    assert (reading.number, reading.tile) == (1, 3)
    counts = bench.counts()
    assert (counts["tiles"], counts["passed"], counts["passed_good"], counts["fired"]) == (3, 3, 3, 3)
    assert (counts["faces_twice"], counts["prints_beside"], counts["faces"]) == (0, 0, [[101, 103]])


def test_the_loader_keeps_pitch_and_jitter_and_stops_when_told():
    bench = Bench(loader={"jitter_mm": 20.0, "length_jitter_mm": 2.0})
    bench.start()
    bench.until_travel(20000)
    tiles = bench.tiles()
    gaps = [b.lead_x - a.lead_x for a, b in pairwise(tiles)]
    assert all(680 <= gap <= 720 for gap in gaps)
    assert max(gaps) - min(gaps) > 10
    assert all(598 <= tile.length_mm <= 602 for tile in tiles)
    bench.command(feed=False)
    made = len(bench.tiles())
    bench.after(20)
    assert len(bench.tiles()) == made
    bench.command()
    bench.after(2)
    assert len(bench.tiles()) > made


def test_a_changed_length_comes_with_the_next_tile():
    bench = Bench()
    bench.start()
    bench.until_travel(1400)
    bench.command(feed=False)
    bench.until_travel(4000)
    bench.command(tile_length_mm=300.0, tile_pitch_mm=350.0)
    bench.until_travel(5000)
    assert [tile.length_mm for tile in bench.tiles()] == [600, 600, 600, 300, 300, 300]
    assert not bench.trouble


def test_tiles_longer_than_the_controller_was_told_are_taken_for_two():
    bench = Bench(loader={"tile_length_mm": 800.0})
    bench.start()
    bench.until_travel(1601)
    assert bench.trouble == Trouble.DOUBLE_FEED


def test_no_print_begins_where_no_tile_is():
    bench = Bench()
    bench.start(**ALL)
    bench.wait_for_tile()
    print_on(bench, 1, 1)
    bench.until_travel(800 + 700)
    bench.plant.missing_tile("belt")
    bench.until_travel(800 + EYE_TO_HEAD + 601)
    assert bench.truth()[1]["fate"] == "removed"
    assert [arm.state for arm in bench.head.outcomes(1)] == [State.MISSED]
    counts = bench.counts()
    assert (counts["missed"], counts["underruns"], counts["prints"]) == (1, 0, 0)
    bench.until_travel(800 + EYE_TO_HEAD + 2001)
    assert bench.conveyor.view().decided_seq == 1


def test_a_tile_taken_away_while_it_is_printed_leaves_its_print_beside_all_tiles():
    bench = Bench()
    bench.start(**ALL)
    bench.wait_for_tile()
    print_on(bench, 1, 1)
    bench.until_travel(800 + EYE_TO_HEAD + 300)
    bench.plant.jam()
    bench.plant.jam_clear(remove=True)
    bench.command(**ALL, ack_fault=1)
    bench.command(**ALL)
    bench.until_travel(800 + EYE_TO_HEAD + 601)
    (beside,) = bench.plant.truth.view()["beside"]
    assert (beside["arm"], beside["on_tile"], beside["offset_mm"]) == (1, False, None)
    assert bench.counts()["prints_beside"] == 1


def test_a_gap_of_the_loader_counts_as_fed_and_is_never_seen():
    bench = Bench()
    bench.plant.missing_tile()
    bench.start()
    bench.until_travel(800 + 1400)
    view = bench.conveyor.view()
    assert view.tile_seq == 2
    first, second = bench.tiles()[:2]
    assert (first.lead_x - 800) == pytest.approx(700, abs=1)
    assert second.lead_x - first.lead_x == pytest.approx(700)
    assert view.tiles_fed == len(bench.tiles()) + 1


def test_a_jam_stops_the_belt_and_a_slip_shows_in_the_registration():
    bench = Bench()
    bench.start(**ALL)
    bench.wait_for_tile()
    print_on(bench, 1, 1)
    bench.until_travel(1500)
    bench.plant.jam(slip_mm=3.0)
    bench.after(1)
    assert not bench.conveyor.view().belt_running
    bench.plant.jam_clear()
    bench.command(**ALL, ack_fault=1)
    bench.command(**ALL, ack_fault=1)
    bench.until_travel(800 + EYE_TO_HEAD + 700)
    assert bench.truth()[1]["prints"][0]["offset_mm"] == -3.0


def test_whoever_clears_a_jam_can_take_the_tile_off():
    bench = Bench()
    bench.start(**ALL)
    bench.until_travel(3000)
    bench.plant.jam()
    bench.plant.jam_clear(remove=True)
    assert bench.truth()[1]["fate"] == "removed"
    assert not bench.conveyor.causes & Trouble.JAM


def test_a_face_or_a_tile_printed_twice_is_told():
    bench = Bench()
    bench.start(**ALL)
    bench.wait_for_tile()
    start = bench.order(1).start_encoder
    for arm, face, at in ((1, 7, 0), (2, 7, 4000), (3, 8, 8000)):
        assert bench.arm(arm, 1, face=face, rows=200, start_encoder=start + at) is ArmAnswer.ACCEPTED
        bench.send(arm, 0, 200)
    bench.until_travel(800 + EYE_TO_HEAD + 601)
    counts = bench.counts()
    assert (counts["faces_twice"], counts["twice"], counts["tiles_twice"]) == (1, [7], 2)
    assert counts["faces"] == [[7, 8]]
    bench.plant.truth.forget_faces()
    assert bench.counts()["faces_twice"] == 0


def test_what_passes_is_told_apart_by_what_is_on_it():
    bench = Bench()
    bench.start(**ALL)
    bench.wait_for_tile(2)
    print_on(bench, 2, 2)
    bench.wait_for_tile(3)
    bench.arm(3, 3)
    bench.send(3, 0, 100)
    bench.until_travel(800 + EYE_TO_HEAD + 2000 + 1401)
    counts = bench.counts()
    assert (counts["passed_blank"], counts["passed_good"], counts["passed_spoilt"]) == (1, 1, 1)
    assert (counts["underruns"], counts["prints_partial"]) == (1, 1)


def test_tiles_come_out_of_the_kiln_in_another_order_and_some_break():
    bench = Bench(kiln={"shuffle_minutes": 10.0, "break_rate": 0.3}, loader={"tiles": 60})
    bench.command(release_base=1, release_bits=0xFFFFFFFF)
    bench.command(release_base=33, release_bits=0xFFFFFFFF)
    bench.until_travel(TO_KILN + 60 * 700)
    bench.until(bench.wall + 75 * 60)
    ended = sorted(bench.truth().values(), key=lambda tile: tile["ended_at"])
    assert {tile["fate"] for tile in ended} == {"fired", "broken"}
    assert [tile["id"] for tile in ended] != sorted(tile["id"] for tile in ended)
    stays = [tile["ended_at"] - tile["decided_at"] - 6 for tile in ended]
    assert min(stays) >= 35 * 60
    assert max(stays) <= 55.01 * 60
    assert 8 <= bench.counts()["broken"] <= 30


def test_a_blocked_kiln_keeps_its_tiles():
    bench = Bench(loader={"tiles": 1})
    bench.command(**ALL)
    bench.until_travel(TO_KILN + 1)
    bench.plant.kiln.blocked = True
    bench.after(75 * 60)
    assert bench.plant.kiln.view().tiles_inside == 1
    bench.plant.kiln.blocked = False
    bench.after(61)
    assert bench.plant.kiln.view().tiles_inside == 0


def test_the_truth_can_be_asked_for_in_increments():
    bench = Bench()
    bench.start(**ALL)
    bench.until_travel(3000)
    first = bench.plant.truth.view()
    assert sorted(tile["id"] for tile in first["tiles"]) == [1, 2, 3, 4, 5]
    assert bench.plant.truth.view(first["next"])["tiles"] == []
    bench.until_travel(800 + EYE_TO_HEAD + 2001)
    later = bench.plant.truth.view(first["next"])
    assert 1 in {tile["id"] for tile in later["tiles"]}
    parts, since = [], 0
    while tiles := (part := bench.plant.truth.view(since, limit=2))["tiles"]:
        parts += tiles
        since = part["next"]
    assert parts == bench.plant.truth.view()["tiles"]


def test_finished_tiles_go_to_the_file_and_leave_the_memory(tmp_path):
    path = tmp_path / "truth.jsonl"
    bench = Bench(truth_file=str(path), keep_tiles=3)
    bench.start()
    bench.wait_for_tile()
    print_on(bench, 1, 1)
    bench.until_travel(800 + EYE_TO_HEAD + 2000 + 9 * 700 + 1)
    bench.plant.close()
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert [line["id"] for line in lines] == list(range(1, 11))
    assert {line["fate"] for line in lines} == {"diverted"}
    assert lines[0]["prints"][0]["arm"] == 1
    ended = [tile for tile in bench.truth().values() if tile["ended_at"]]
    assert [tile["id"] for tile in ended] == [8, 9, 10]


def test_memory_stays_flat_over_many_tiles():
    bench = Bench(keep_tiles=50, kiln={"least_minutes": 1.0, "cycle_minutes": 2.0, "shuffle_minutes": 1.0})
    bench.open()

    def run(tiles):
        while bench.head.detect_seq < tiles:
            bench.command(release_base=bench.conveyor.view().decided_seq + 1, release_bits=0xFFFF)
            seq = bench.head.detect_seq
            if seq > bench.head.memory.last_accepted:
                print_on(bench, seq, seq)
            bench.after(0.7)

    tracemalloc.start()
    try:
        run(300)
        before = tracemalloc.get_traced_memory()[0]
        run(1500)
        assert tracemalloc.get_traced_memory()[0] - before < 60_000
    finally:
        tracemalloc.stop()
    assert bench.counts()["prints_complete"] > 1400


@given(st.lists(st.integers(0, 60), max_size=80))
def test_runs_of_numbers_are_a_set(numbers):
    kept, plain = NumberSet(), set()
    for number in numbers:
        assert kept.add(number) is (number not in plain)
        plain.add(number)
    runs = list(kept)
    assert {n for first, last in runs for n in range(first, last + 1)} == plain
    assert all(b[0] - a[1] > 1 for a, b in pairwise(runs))


def test_the_same_seed_makes_the_same_plant():
    def travel(seed):
        bench = Bench(loader={"jitter_mm": 30.0, "seed": seed})
        bench.start()
        bench.until_travel(9000)
        return [tile.lead_x for tile in bench.tiles()]

    random.seed(1)
    first = travel(5)
    random.seed(2)
    assert travel(5) == first != travel(6)
