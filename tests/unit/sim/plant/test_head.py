"""The print head: what it accepts, when it prints, and what becomes of faces whose rows or power fail."""

from __future__ import annotations

from zlib import crc32

import pytest

from sim.plant.physics.faces import ArmAnswer, State, StripAnswer
from tests.unit.sim.plant.physics_bench import EYE_TO_HEAD, Bench, face


def armed_bench(**tables):
    bench = Bench(**tables)
    bench.start(release_base=1, release_bits=0xFFFFFFFF)
    bench.wait_for_tile()
    assert bench.arm(1) is ArmAnswer.ACCEPTED
    return bench


def lead(bench, number=1):
    """Travel at which a tile's leading edge is at the head."""
    return bench.tiles()[number - 1].lead_x + EYE_TO_HEAD


def test_a_face_whose_rows_are_there_is_printed_whole_and_in_its_place():
    bench = armed_bench()
    assert bench.send(1, 0, 600) is StripAnswer.TAKEN
    bench.until_travel(lead(bench) + 599.9)
    assert bench.outcome(1).state is State.PRINTING
    bench.until_travel(lead(bench) + 600)
    outcome = bench.outcome(1)
    assert (outcome.state, outcome.rows_printed, outcome.rows_received) == (State.PRINTED, 600, 600)
    assert outcome.crc32 == crc32(face(1)[: 600 * 40])
    (print_,) = bench.truth()[1]["prints"]
    assert print_ | {"at": 0, "margin_mm": 0, "armed_ahead_mm": 0} == {
        **{"arm": 1, "face": 101, "detect_seq": 1, "rows": 600, "rows_ordered": 600, "complete": True},
        **{"crc32": outcome.crc32, "sha256": None, "nozzle_out": False, "on_tile": True},
        **{"offset_mm": 0.0, "centre_mm": 0.0, "at": 0, "margin_mm": 0, "armed_ahead_mm": 0},
    }
    assert print_["armed_ahead_mm"] == pytest.approx(EYE_TO_HEAD, abs=50)


def test_the_registration_is_what_the_order_made_of_it():
    bench = Bench()
    bench.start()
    bench.wait_for_tile()
    order = bench.order(1)
    bench.arm(1, start_encoder=order.start_encoder + 30, rows=300, row_pitch_millicounts=30000)
    bench.send(1, 0, 300)
    bench.until_travel(lead(bench) + 600)
    (print_,) = bench.truth()[1]["prints"]
    assert print_["offset_mm"] == 1.5
    assert print_["centre_mm"] == 1.5 + (450 - 600) / 2


def test_a_strip_that_arrives_an_instant_before_its_first_row_is_due_is_in_time():
    bench = armed_bench()
    bench.send(1, 0, 200)
    bench.until_travel(lead(bench) + 199.99)
    assert bench.send(1, 200, 400) is StripAnswer.TAKEN
    bench.until_travel(lead(bench) + 601)
    assert bench.outcome(1).state is State.PRINTED
    assert bench.truth()[1]["prints"][0]["margin_mm"] == pytest.approx(0.01, abs=1e-3)


def test_a_strip_that_arrives_an_instant_after_its_first_row_is_due_is_an_underrun():
    bench = armed_bench()
    bench.send(1, 0, 200)
    bench.until_travel(lead(bench) + 200.01)
    outcome = bench.outcome(1)
    assert (outcome.state, outcome.rows_printed, outcome.rows_received) == (State.PARTIAL, 200, 200)
    assert outcome.crc32 == crc32(face(1)[: 200 * 40])
    assert bench.send(1, 200, 400) is StripAnswer.UNKNOWN_ARM
    assert bench.head.underrun
    assert bench.head.held
    (print_,) = bench.truth()[1]["prints"]
    assert (print_["complete"], print_["rows"], print_["rows_ordered"]) == (False, 200, 600)


def test_a_face_without_any_rows_is_missed_and_holds_the_printer():
    bench = armed_bench()
    bench.until_travel(lead(bench) + 1)
    assert bench.outcome(1).state is State.MISSED
    assert (bench.head.held, bench.head.underrun, bench.head.fault_counter) == (True, True, 1)
    assert bench.truth()[1]["prints"] == []


def test_a_held_printer_finishes_what_it_has_begun_and_starts_nothing():
    bench = armed_bench()
    bench.wait_for_tile(2)
    bench.arm(2, 2)
    bench.send(1, 0, 600)
    bench.send(2, 0, 600)
    bench.until_travel(lead(bench) + 10)
    bench.head.hold()
    bench.until_travel(lead(bench, 2) + 700)
    assert bench.outcome(1).state is State.PRINTED
    assert bench.outcome(2).state is State.MISSED
    assert bench.head.underrun is False


def test_an_e_stop_ends_what_is_printed_with_the_rows_that_were_begun():
    bench = armed_bench()
    bench.send(1, 0, 600)
    bench.until_travel(lead(bench) + 99.5)
    bench.plant.e_stop(True)
    outcome = bench.outcome(1)
    assert (outcome.state, outcome.rows_printed) == (State.PARTIAL, 100)
    assert bench.head.clear(bench.head.fault_counter) == 2
    bench.plant.e_stop(False)
    assert bench.head.e_stop
    assert bench.head.clear(bench.head.fault_counter + 1) == 1
    assert bench.head.clear(bench.head.fault_counter) == 0
    assert not bench.head.held


def test_without_status_the_dead_man_holds_half_a_second_later():
    bench = armed_bench()
    bench.alive = False
    bench.after(0.499)
    assert not bench.head.held
    bench.after(0.002)
    assert (bench.head.held, bench.head.deadman) == (True, True)


def test_a_printer_without_a_session_has_no_dead_man():
    bench = Bench()
    bench.after(10)
    assert (bench.head.held, bench.head.deadman) == (True, False)


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        ({}, ArmAnswer.ACCEPTED),
        ({"detect_seq": 9}, ArmAnswer.UNKNOWN_DETECTION),
        ({"detect_seq": 0}, ArmAnswer.UNKNOWN_DETECTION),
        ({"rows": 0}, ArmAnswer.BAD_GEOMETRY),
        ({"cols": 0}, ArmAnswer.BAD_GEOMETRY),
        ({"row_pitch_millicounts": 0}, ArmAnswer.BAD_GEOMETRY),
        ({"channels": 5}, ArmAnswer.BAD_GEOMETRY),
        ({"channels": 0}, ArmAnswer.BAD_GEOMETRY),
        ({"bits": 16}, ArmAnswer.BAD_GEOMETRY),
        ({"start_encoder": 0}, ArmAnswer.TOO_LATE),
        ({"arm": 0}, ArmAnswer.NOT_ABOVE),
    ],
)
def test_an_order_is_accepted_or_refused_for_its_reason(changes, answer):
    bench = Bench()
    bench.start()
    bench.wait_for_tile()
    assert bench.arm(**({"arm": 1} | changes)) is answer
    assert bench.head.memory.last_accepted == (1 if answer is ArmAnswer.ACCEPTED else 0)


def test_the_lead_that_an_order_needs_is_exact():
    bench = Bench()
    bench.start()
    bench.wait_for_tile()
    now = bench.head.encoder
    assert bench.arm(1, start_encoder=now + 999) is ArmAnswer.TOO_LATE
    assert bench.arm(1, start_encoder=now + 1000) is ArmAnswer.ACCEPTED


def test_an_order_given_again_is_a_duplicate_even_when_held_and_anything_else_of_its_number_is_refused():
    bench = armed_bench()
    bench.head.hold()
    assert bench.arm(1) is ArmAnswer.DUPLICATE
    assert bench.arm(1, cols=11) is ArmAnswer.NOT_ABOVE
    assert bench.arm(2) is ArmAnswer.NOT_READY
    assert bench.head.queued == 1
    bench.open(2)
    bench.wait_for_tile(2)
    assert bench.arm(5, 2) is ArmAnswer.ACCEPTED
    assert bench.arm(4, 2) is ArmAnswer.NOT_ABOVE


def test_faces_can_not_overlap_and_the_queue_is_limited():
    bench = Bench(printer={"queue_len": 2})
    bench.start()
    bench.wait_for_tile()
    start = bench.order(1).start_encoder
    assert bench.arm(1, rows=50) is ArmAnswer.ACCEPTED
    assert bench.arm(2, rows=50, start_encoder=start + 999) is ArmAnswer.BAD_GEOMETRY
    assert bench.arm(2, rows=50, start_encoder=start + 1000) is ArmAnswer.ACCEPTED
    assert bench.arm(3, rows=50, start_encoder=start + 2000) is ArmAnswer.QUEUE_FULL


def test_a_face_is_cancelled_until_its_first_row():
    bench = armed_bench()
    bench.send(1, 0, 600)
    assert bench.head.disarm(2) == 2
    assert bench.head.disarm(1) == 0
    assert bench.head.disarm(1) == 0
    bench.until_travel(lead(bench) + 700)
    assert bench.outcome(1).state is State.CANCELLED
    assert bench.truth()[1]["prints"] == []
    bench.wait_for_tile(3)
    bench.arm(2, 3)
    bench.send(2, 0, 600)
    bench.until_travel(lead(bench, 3) + 1)
    assert bench.head.disarm(2) == 1


def test_strips_are_taken_in_order_whole_and_within_the_credit():
    bench = armed_bench(printer={"buffer_bytes": 10000})
    assert bench.send(2, 0, 10) is StripAnswer.UNKNOWN_ARM
    assert bench.send(1, 10, 10) is StripAnswer.OUT_OF_ORDER
    assert bench.send(1, 0, 10, good=False) is StripAnswer.BAD_CRC
    assert bench.send(1, 0, 10, row_bytes=41) is StripAnswer.OUT_OF_ORDER
    assert bench.send(1, 0, 251) is StripAnswer.NO_CREDIT
    assert bench.send(1, 0, 250) is StripAnswer.TAKEN
    assert bench.head.credit == 0
    bench.until_travel(lead(bench) + 100.5)
    assert bench.head.credit == 100 * 40
    assert bench.send(1, 250, 101) is StripAnswer.NO_CREDIT
    assert bench.send(1, 250, 100) is StripAnswer.TAKEN
    bench.until_travel(lead(bench) + 360)
    assert bench.head.credit == 10000


def test_without_power_queued_faces_are_missed_begun_ones_partial_and_the_memory_stays():
    bench = armed_bench()
    bench.wait_for_tile(2)
    bench.arm(2, 2)
    bench.send(1, 0, 600)
    bench.until_travel(lead(bench) + 50.5)
    old = bench.head.boot_id
    bench.head.power_down()
    bench.head.power_up()
    assert bench.head.boot_id != old
    assert (bench.head.encoder, bench.head.detect_seq, bench.head.held, bench.head.session) == (0, 0, True, None)
    assert [(a.order.arm_id, a.state, a.rows_printed) for a in bench.head.outcomes(0)] == [
        (1, State.PARTIAL, 51),
        (2, State.MISSED, 0),
    ]
    assert bench.head.memory.last_accepted == 2
    assert bench.head.hello(0) is False
    bench.head.power_down(forget=True)
    bench.head.power_up()
    assert (bench.head.memory.last_accepted, bench.head.outcomes(0)) == (0, [])
    assert bench.head.hello(0) is True


def test_a_face_armed_before_a_reboot_prints_nothing_after_it():
    bench = armed_bench()
    bench.send(1, 0, 600)
    bench.head.power_down()
    bench.head.power_up()
    bench.open(2)
    bench.until_travel(lead(bench) + 700)
    assert bench.outcome(1).state is State.MISSED
    assert bench.counts()["prints"] == 0


def test_the_last_64_faces_and_tiles_are_remembered():
    bench = Bench(printer={"queue_len": 32})
    bench.start(tile_length_mm=60.0, tile_pitch_mm=100.0)
    for number in range(1, 71):
        bench.wait_for_tile(number)
        assert bench.arm(number, number, rows=50) is ArmAnswer.ACCEPTED
        bench.send(number, 0, 50)
    assert [a.order.arm_id for a in bench.head.outcomes(0)] == list(range(7, 71))
    assert len(bench.head.seen(0)) == 64


def test_lengths_of_tiles_are_0_while_they_cover_the_eye():
    bench = Bench()
    bench.start()
    bench.wait_for_tile()
    (seen,) = bench.head.seen(1)
    assert (seen.encoder, seen.length_counts) == (800 * 20, 0)
    bench.until_travel(1400.1)
    assert bench.head.seen(1)[0].length_counts == 600 * 20
    assert bench.head.seen(2) == []


def test_ink_runs_out_and_is_filled_up():
    bench = armed_bench(printer={"ink_faces": 2})
    bench.wait_for_tile(2)
    bench.arm(2, 2)
    bench.send(1, 0, 600)
    bench.send(2, 0, 600)
    bench.until_travel(lead(bench, 2) + 600)
    assert bench.outcome(2).state is State.PRINTED
    assert (bench.head.ink_out, bench.head.held) == (True, True)
    assert bench.head.clear(bench.head.fault_counter) == 2
    for ink in range(4):
        bench.head.set_ink(ink, 1000)
    assert bench.head.clear(bench.head.fault_counter) == 0


def test_a_failed_nozzle_holds_and_marks_the_print_under_way():
    bench = armed_bench()
    bench.send(1, 0, 600)
    bench.until_travel(lead(bench) + 10)
    bench.head.set_nozzles(True)
    bench.until_travel(lead(bench) + 600)
    assert bench.truth()[1]["prints"][0]["nozzle_out"] is True
    assert bench.head.held
