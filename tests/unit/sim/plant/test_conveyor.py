"""The conveyor's controller: commands, dead-man, e-stop, releases and the diverter that fails safe."""

from __future__ import annotations

import pytest

from sim.plant.physics.conveyor import Trouble
from tests.unit.sim.plant.physics_bench import TO_DIVERTER, Bench


def test_a_command_starts_belt_and_loader_and_is_acknowledged_with_the_next_scan():
    bench = Bench()
    bench.cmd_seq = 41
    bench.command()
    assert bench.conveyor.view().cmd_ack == 42
    bench.after(3)
    view = bench.conveyor.view()
    assert (view.belt_speed_mm_s, view.feed_enabled, view.tiles_fed) == (500, True, 3)
    assert (view.tile_seq, view.tile_position) == (1, 800 * 20)
    assert view.position == pytest.approx(bench.x * 20, abs=1)


@pytest.mark.parametrize(("seq", "acts"), [(10, False), (9, False), (11, True), (32777, True), (32778, False)])
def test_only_a_newer_command_is_acted_on(seq, acts):
    bench = Bench()
    bench.cmd_seq = 9
    bench.command(speed_mm_s=100.0)
    bench.command(cmd_seq=seq % 65536, speed_mm_s=300.0)
    assert bench.plant.timeline.target_speed == (300 if acts else 100)
    assert bench.conveyor.view().cmd_ack == (seq % 65536 if acts else 10)


def test_numbers_of_commands_wrap():
    bench = Bench()
    bench.command(cmd_seq=65535)
    bench.command(cmd_seq=0, speed_mm_s=200.0)
    assert bench.conveyor.view().cmd_ack == 0
    assert bench.plant.timeline.target_speed == 200


def test_without_heartbeats_the_belt_stops_half_a_second_after_the_last():
    bench = Bench()
    bench.command()
    bench.until(2)
    bench.alive = False
    bench.until(2.499)
    assert bench.conveyor.view().belt_speed_mm_s == 500
    bench.until(2.501)
    view = bench.conveyor.view()
    assert view.trouble == Trouble.DEAD_MAN
    assert 0 < view.belt_speed_mm_s < 500
    bench.until(3)
    assert bench.conveyor.view().belt_running is False


def test_the_dead_man_counts_wall_time_at_any_rate():
    bench = Bench(clock={"rate": 1000.0})
    bench.command(speed_mm_s=1.0)
    bench.until(2)
    bench.alive = False
    bench.until(2.4999)
    assert not bench.trouble
    bench.until(2.5001)
    assert bench.trouble == Trouble.DEAD_MAN


def test_a_stopped_belt_needs_no_heartbeat():
    bench = Bench()
    bench.alive = False
    bench.until(100)
    assert not bench.trouble


def test_after_an_e_stop_nothing_runs_before_release_acknowledgement_and_a_new_command():
    bench = Bench()
    bench.command()
    bench.until(3)
    before = bench.x
    bench.plant.e_stop(True)
    bench.after(1)
    assert bench.x - before == pytest.approx(500**2 / 2 / 6000)
    assert bench.trouble == Trouble.E_STOP
    assert bench.conveyor.view().fault_counter == 1
    bench.command(ack_fault=1)
    assert bench.trouble, "the button is still in"
    bench.plant.e_stop(False)
    bench.after(1)
    assert bench.trouble == Trouble.E_STOP, "nobody has acknowledged"
    bench.command(ack_fault=0)
    assert bench.trouble, "that acknowledges another fault"
    bench.command(ack_fault=1)
    assert not bench.trouble
    bench.after(1)
    assert not bench.conveyor.view().belt_running, "the acknowledgement itself moves nothing"
    bench.command(run=False, ack_fault=1)
    bench.after(1)
    assert not bench.conveyor.view().belt_running
    bench.command(ack_fault=1)
    bench.after(1)
    assert bench.conveyor.view().belt_running


def test_each_newly_latched_fault_counts_once():
    bench = Bench()
    bench.command()
    for _ in range(2):
        bench.plant.jam()
        bench.plant.e_stop(True)
    view = bench.conveyor.view()
    assert (view.trouble, view.fault_counter) == (Trouble.JAM | Trouble.E_STOP, 2)
    bench.plant.jam_clear()
    bench.command(ack_fault=2)
    assert bench.trouble == Trouble.E_STOP


def test_a_tile_passes_only_if_it_was_released_before_its_decision():
    bench = Bench()
    bench.command(release_base=2, release_bits=0b101)
    bench.until_travel(800 + TO_DIVERTER + 3 * 700)
    view = bench.conveyor.view()
    assert view.decided_seq == 4
    assert view.passed_bits == 0b0101
    bench.command(release_base=3, release_bits=0b111)
    bench.until_travel(800 + TO_DIVERTER + 4 * 700)
    assert bench.conveyor.view().passed_bits == 0b01011
    fates = [tile["fate"] for _, tile in sorted(bench.truth().items())][:5]
    assert fates == ["diverted", "passed", "diverted", "passed", "passed"]


def test_a_release_an_instant_too_late_diverts():
    bench = Bench()
    bench.command()
    bench.until_travel(800 + TO_DIVERTER - 0.01)
    bench.command(release_base=1, release_bits=1)
    bench.after(0.1)
    assert bench.conveyor.view().decided_seq == 1
    assert bench.conveyor.view().passed_bits == 0


def test_a_reboot_forgets_releases_and_everything_on_the_belt_goes_to_scrap():
    bench = Bench()
    bench.command(release_base=1, release_bits=0xFFFFFFFF)
    bench.until_travel(4000)
    old = bench.conveyor.view()
    bench.conveyor.power_down()
    bench.after(2)
    assert bench.plant.timeline.speed == 0
    bench.conveyor.power_up()
    view = bench.conveyor.view()
    assert view.boot_id not in (0, old.boot_id)
    assert (view.position, view.tile_seq, view.decided_seq, view.cmd_ack, view.tiles_fed) == (0, 0, 0, 0, 0)
    bench.after(1)
    assert not bench.conveyor.view().belt_running
    bench.cmd_seq = 3
    bench.command()
    bench.after(12)
    assert bench.conveyor.view().passed_bits == 0
    fates = {tile["fate"] for tile in bench.truth().values() if tile["decided_at"]}
    assert fates == {"diverted"}


def test_two_tiles_in_one_are_one_passage_and_stop_the_belt():
    bench = Bench()
    bench.plant.double_feed()
    bench.command(release_base=1, release_bits=0xFF)
    bench.until_travel(800 + 1200)
    assert bench.trouble == Trouble.DOUBLE_FEED
    first, second = bench.tiles()[:2]
    assert (first.tile_seq, second.tile_seq) == (1, 1)
    assert second.lead_x == first.lead_x + 600
    assert bench.plant.head.detect_seq == 1


def test_a_broken_diverter_diverts_and_stops_the_belt():
    bench = Bench()
    bench.command(release_base=1, release_bits=1)
    bench.until_travel(800 + TO_DIVERTER - 10)
    bench.plant.conveyor.set_cause(Trouble.DIVERTER, True)
    bench.after(1)
    assert bench.conveyor.view().passed_bits == 0
    assert bench.truth()[1]["fate"] == "diverted"
    assert not bench.conveyor.view().belt_running


def test_a_full_kiln_stops_the_loader_only():
    bench = Bench(kiln={"capacity": 2}, belt={"diverter_to_kiln_mm": 100.0})
    bench.command(release_base=1, release_bits=0xFFFF)
    bench.until_travel(800 + TO_DIVERTER + 100 + 700 + 1)
    view = bench.conveyor.view()
    assert (view.kiln_full, view.feed_enabled, view.belt_running) == (True, False, True)


def test_a_hung_program_goes_on_as_it_was_and_acts_on_commands_later():
    bench = Bench()
    bench.command()
    bench.after(1)
    bench.conveyor.hang(True)
    bench.command(speed_mm_s=100.0)
    bench.alive = False
    bench.after(2)
    assert bench.plant.timeline.speed == 500
    assert not bench.trouble
    bench.conveyor.hang(False)
    bench.alive = True
    bench.after(1)
    assert bench.plant.timeline.speed == 100
