"""Registers of conveyor and kiln: every address, the word order, what may be written, and its limits."""

from __future__ import annotations

import struct
from zlib import crc32

import pytest

from sim.plant.physics.conveyor import Trouble
from sim.plant.wire.window import KilnWindow, PlcWindow, RefusedError
from tests.unit.sim.plant.physics_bench import TO_DIVERTER, Bench


def words(*values, fmt):
    data = struct.pack(">" + fmt, *values)
    return list(struct.unpack(f">{len(data) // 2}H", data))


def check(values):
    return words(crc32(struct.pack(f">{len(values)}H", *values)), fmt="I")


def code(call, *arguments):
    with pytest.raises(RefusedError) as refused:
        call(*arguments)
    return refused.value.code


@pytest.fixture
def plc():
    bench = Bench()
    return bench, PlcWindow(bench.conveyor)


@pytest.fixture
def kiln():
    bench = Bench(kiln={"start_degc": 500.0})
    return bench, KilnWindow(bench.plant.kiln)


BLOCK = words(7, 3, 5000, 6000, 7000, 1, 0b1011, 0, fmt="5H2IH")


def test_the_whole_plc_window(plc):
    bench, window = plc
    window.write(32, BLOCK)
    window.write(0, [0xABCD])
    bench.after(0.02)
    bench.until_travel(800 + TO_DIVERTER + 700 * 2 + 40)
    view = bench.conveyor.view()
    seen = window.read(0, 64)
    assert seen[0] == 0xABCD
    assert abs(seen[1] - bench.wall / 0.01) <= 1
    assert seen[2] == view.boot_id
    assert seen[3:5] == [0x0102, 0x0304]
    assert seen[5] == 1 | 32 | 64
    assert seen[6] == 5000
    assert seen[7:9] == words(view.position, fmt="I")
    assert seen[9:11] == words(view.tile_seq, fmt="I")
    assert seen[11:13] == words(view.tile_position, fmt="I")
    assert view.position > 65536
    assert seen[13:15] == [0, 3]
    assert seen[15:19] == [0, 0, 0, 0b110]
    assert seen[19] == 7
    assert seen[20] == 0
    assert seen[21:23] == words(view.tiles_fed, fmt="I")
    assert seen[23:32] == [0] * 9
    assert seen[32:42] == BLOCK
    assert seen[42:62] == [0] * 20
    assert seen[62:] == check(seen[:62])


@pytest.mark.parametrize(
    ("cause", "bit"), [(Trouble.E_STOP, 1), (Trouble.JAM, 2), (Trouble.DIVERTER, 7)], ids=lambda v: str(v)
)
def test_faults_have_their_bits(plc, cause, bit):
    bench, window = plc
    bench.conveyor.set_cause(cause, True)
    assert window.read(5, 1) == [1 << bit]
    assert window.read(20, 1) == [1]


def test_the_other_flags_have_their_bits(plc):
    bench, window = plc
    bench.conveyor.kiln_fills(True)
    assert window.read(5, 1) == [1 << 8 | 1 << 6]
    bench.command()
    bench.alive = False
    bench.after(2)
    assert window.read(5, 1) == [1 << 8 | 1 << 3]
    double = Bench()
    double.plant.double_feed()
    double.command()
    double.until_travel(2000)
    double.after(1)
    assert PlcWindow(double.conveyor).read(5, 1) == [1 << 4]


@pytest.mark.parametrize("address", [1, 2, 3, 5, 20, 22, 23, 31, 42, 63])
def test_what_is_read_only_can_not_be_written(plc, address):
    assert code(plc[1].write, address, [1]) == 2


def test_a_write_is_done_whole_or_not_at_all(plc):
    _, window = plc
    assert code(window.write, 41, [1, 2]) == 2
    assert code(window.write, 33, [1, 30001]) == 3
    assert window.read(32, 10) == [0] * 10


@pytest.mark.parametrize(
    ("address", "least", "most"), [(33, 0, 3), (34, 0, 30000), (35, 500, 30000), (36, 600, 40000), (41, 0, 65535)]
)
def test_limits_of_what_the_plc_takes(plc, address, least, most):
    _, window = plc
    window.write(address, [least])
    window.write(address, [most])
    assert window.read(address, 1) == [most]
    if least:
        assert code(window.write, address, [least - 1]) == 3
    if most < 65535:
        assert code(window.write, address, [most + 1]) == 3


@pytest.mark.parametrize(("address", "count", "refusal"), [(63, 2, 2), (64, 1, 2), (0, 0, 3), (0, 126, 3), (60, 60, 2)])
def test_reads_outside_the_window_are_refused(plc, address, count, refusal):
    assert code(plc[1].read, address, count) == refusal


def test_only_another_seq_is_a_heartbeat(plc):
    bench, window = plc
    window.write(32, BLOCK)
    bench.alive = False
    for seq in (1, 2, 3):
        bench.after(0.4)
        window.write(0, [seq])
    assert not bench.trouble
    for _ in range(2):
        bench.after(0.3)
        window.write(0, [3])
    assert bench.trouble == Trouble.DEAD_MAN


def test_registers_written_one_by_one_act_with_the_number_of_the_command(plc):
    bench, window = plc
    for address, value in ((33, 1), (34, 1234), (35, 6000), (36, 7000)):
        window.write(address, [value])
    bench.after(1)
    assert bench.plant.timeline.target_speed == 0
    window.write(32, [1])
    bench.after(0.1)
    assert bench.plant.timeline.target_speed == 123.4


def test_a_frozen_window_shows_what_was_and_echoes_what_is_written(plc):
    bench, window = plc
    bench.after(1)
    before = window.read(0, 32)
    window.freeze(True)
    bench.after(1)
    window.write(0, [9])
    assert window.read(0, 32) == [9, *before[1:]]
    window.freeze(False)
    assert window.read(1, 1) != before[1:2]


def test_a_wrong_word_order_swaps_every_wide_value(plc):
    bench, window = plc
    window.write(32, BLOCK)
    bench.after(0.02)
    bench.until_travel(3000)
    right = window.read(0, 64)
    window.word_order_wrong = True
    wrong = window.read(0, 64)
    assert wrong[3:5] == [0x0304, 0x0102]
    assert (wrong[7:9], wrong[11:13]) == (right[8:6:-1], right[12:10:-1])
    assert wrong[0:3] == right[0:3]


def test_check_words_fit_what_an_answer_shows_however_wrong_that_is(plc):
    bench, window = plc
    window.write(32, BLOCK)
    for freeze, swap in ((False, False), (True, False), (True, True), (False, True)):
        window.freeze(freeze)
        window.word_order_wrong = swap
        bench.after(0.3)
        window.write(0, [int(bench.wall * 100) & 0xFFFF])
        seen = window.read(0, 64)
        assert seen[62:] == check(seen[:62])


def test_a_part_of_the_window_shows_the_check_words_of_the_whole_at_that_moment(plc):
    _, window = plc
    assert window.read(60, 4) == window.read(0, 64)[60:]
    before = window.read(62, 2)
    window.write(0, [1])
    assert window.read(62, 2) != before


def test_a_sum_of_0_is_shown_as_all_ones(plc, monkeypatch):
    monkeypatch.setattr("sim.plant.wire.window.crc32", lambda _: 0)
    assert plc[1].read(62, 2) == [0xFFFF, 0xFFFF]


def test_controllers_without_check_words_show_0():
    bench = Bench()
    assert PlcWindow(bench.conveyor, check_words=False).read(62, 2) == [0, 0]
    assert KilnWindow(bench.plant.kiln, check_words=False).read(78, 2) == [0, 0]


def test_what_was_written_is_forgotten_at_a_boot(plc):
    _, window = plc
    window.write(32, BLOCK)
    window.write(0, [5])
    window.reset()
    assert window.read(0, 1) == [0]
    assert window.read(32, 10) == [0] * 10


KILN_BLOCK = words(3, 0, *(900.5 + zone for zone in range(8)), 7.5, 400, fmt="2H8ffH")


def test_the_whole_kiln_window(kiln):
    bench, window = kiln
    window.write(34, KILN_BLOCK[2:])
    window.write(32, [3])
    window.write(0, [77])
    bench.until(12.345)
    bench.plant.kiln.inside = 70
    seen = window.read(0, 80)
    assert seen[0] == 77
    assert seen[1] == 1234
    assert seen[2] == bench.plant.kiln.boot_id
    assert seen[3:5] == words(1234.5, fmt="f") == [0x449A, 0x5000]
    assert seen[5] == 1
    assert seen[6:9] == [70, 400, 8]
    assert seen[9] == 0
    assert seen[10:26] == words(*bench.plant.kiln.temperatures(), fmt="8f")
    assert seen[26] == 3
    assert seen[27:32] == [0] * 5
    assert seen[32:34] == [3, 0]
    assert seen[34:53] == KILN_BLOCK[2:]
    assert seen[53:78] == [0] * 25
    assert seen[78:] == check(seen[:78])
    assert [zone.set_point for zone in bench.plant.kiln.zones] == [900.5 + zone for zone in range(8)]
    assert (bench.plant.kiln.ramp_degc_min, bench.plant.kiln.cycle_minutes) == (7.5, 40)


@pytest.mark.parametrize(
    ("address", "values"),
    [
        (34, words(19.9, fmt="f")),
        (48, words(1250.5, fmt="f")),
        (50, words(0.05, fmt="f")),
        (50, words(15.1, fmt="f")),
        (52, [349]),
        (52, [751]),
        (36, words(float("nan"), fmt="f")),
    ],
)
def test_limits_of_what_the_kiln_takes(kiln, address, values):
    assert code(kiln[1].write, address, values) == 3


@pytest.mark.parametrize(
    ("address", "values"),
    [(34, words(20, fmt="f")), (48, words(1250, fmt="f")), (50, words(0.1, fmt="f")), (50, words(15, fmt="f"))],
)
def test_limits_themselves_are_taken(kiln, address, values):
    kiln[1].write(address, values)
    assert kiln[1].read(address, 2) == values


def test_flags_of_the_kiln(kiln):
    bench, window = kiln
    assert window.read(5, 1) == [1 | 8]
    bench.plant.kiln.fail_burner(True)
    bench.plant.kiln.blocked = True
    bench.after(600)
    assert window.read(5, 1) == [2 | 16]
    hot = Bench(kiln={"start_degc": 1240.0})
    hot.plant.kiln.drift(0, 60, 1)
    hot.after(61)
    assert KilnWindow(hot.plant.kiln).read(5, 1) == [1 | 4]


def test_the_kiln_shows_its_remembered_set_points_after_a_boot(kiln):
    _, window = kiln
    window.write(34, KILN_BLOCK[2:])
    window.write(32, [3])
    window.reset()
    assert window.read(32, 21) == [0, 0, *KILN_BLOCK[2:]]
