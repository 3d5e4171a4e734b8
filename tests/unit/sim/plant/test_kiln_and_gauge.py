"""Zones of the kiln against small steps of their equations, and the gauge that sees their effect."""

from __future__ import annotations

import pytest

from sim.plant.physics.gauge import Gauge
from sim.plant.physics.kiln import KilnCommand, Zone
from tests.unit.sim.plant.physics_bench import Bench


def test_a_zone_follows_its_ramp_by_first_order():
    zone = Zone(20, 240)
    zone.head_for(0, 320, 0.1)
    heat, aim, t, step = 20.0, 20.0, 0.0, 0.05
    while t < 6000:
        if t == pytest.approx(1500):
            zone.head_for(t, 100, 0.2)
        goal, rate = (320, 0.1) if t < 1500 else (100, 0.2)
        aim += max(-rate * step, min(rate * step, goal - aim))
        heat += (aim - heat) / 240 * step
        t = round(t + step, 6)
        if round(t / step) % 2000 == 0:
            assert zone.temperature(t) == pytest.approx(heat, abs=0.05)
    assert zone.temperature(1e5) == pytest.approx(100)


def test_a_drift_comes_slowly_and_stays():
    zone = Zone(1000, 240)
    zone.drift(100, -30, 600)
    assert zone.temperature(100) == 1000
    assert zone.temperature(400) == pytest.approx(985)
    assert zone.temperature(9000) == pytest.approx(970)
    zone.drift(9000, 0, 30)
    assert zone.temperature(9010) == pytest.approx(980)
    assert zone.temperature(9060) == 1000
    zone.drift(9100, 5, 0)
    assert zone.temperature(9100) == 1005


def command(seq=1, degc=500.0, ramp=10.0, minutes=40.0):
    return KilnCommand(seq, (degc,) * 8, ramp, minutes)


def test_the_kiln_obeys_newer_commands_within_its_ramp():
    bench = Bench()
    kiln = bench.plant.kiln
    kiln.command(command())
    bench.after(600)
    assert kiln.view().temperatures_degc[0] == pytest.approx(20 + 100 - 40 * (1 - 2.718281828**-2.5), abs=0.1)
    assert not kiln.view().at_set_point
    bench.after(6000)
    assert kiln.view().at_set_point
    assert kiln.view().heating
    kiln.command(command(seq=1, degc=900))
    bench.after(6000)
    assert kiln.view().at_set_point
    assert kiln.view().cmd_ack == 1


def test_a_failed_burner_and_a_loss_of_power_cool_and_set_points_outlive_both():
    bench = Bench(kiln={"start_degc": 1180.0})
    kiln = bench.plant.kiln
    assert kiln.view().at_set_point
    kiln.fail_burner(True)
    bench.after(1200)
    assert kiln.view().burner_fault
    assert max(kiln.temperatures()) < 1100
    kiln.fail_burner(False)
    kiln.power_down()
    bench.after(1200)
    cold = kiln.temperatures()[0]
    old = kiln.boot_id
    kiln.power_up()
    bench.after(60000)
    assert cold < 900
    assert kiln.boot_id != old
    assert kiln.view().at_set_point
    kiln.power_down(forget=True)
    kiln.power_up()
    assert {zone.set_point for zone in kiln.zones} == {20}


def test_drifting_and_too_hot_show_in_the_flags():
    bench = Bench(kiln={"start_degc": 1200.0})
    bench.plant.kiln.drift(3, 80, 10)
    bench.after(300)
    view = bench.plant.kiln.view()
    assert (view.at_set_point, view.over_temp) == (False, False)
    assert view.temperatures_degc[3] == pytest.approx(1240)
    assert view.temperatures_degc[2] == pytest.approx(1200)
    bench.after(400)
    assert bench.plant.kiln.view().over_temp


def test_a_hung_kiln_acts_on_commands_once_it_goes_on():
    bench = Bench()
    kiln = bench.plant.kiln
    kiln.hang(True)
    kiln.command(command())
    assert kiln.zones[0].set_point == 20
    kiln.hang(False)
    assert (kiln.zones[0].set_point, kiln.view().cmd_ack) == (500, 1)


def test_the_gauge_sees_the_heat_and_counts():
    cool, hot = Gauge(1), Gauge(1)
    assert cool.measure() is None
    cool.see(5, [1180] * 8)
    hot.see(5, [1200] * 8)
    first, other = cool.measure(), hot.measure()
    assert first is not None
    assert other is not None
    assert other.lab[0] == pytest.approx(first.lab[0] - 0.2)
    assert (first.number, first.tile) == (1, 1)
    again = cool.measure()
    assert again is not None
    assert (again.number, again.lab) == (2, first.lab)
    cool.power_up()
    restarted = cool.measure()
    assert restarted is not None
    assert (restarted.number, restarted.tile) == (1, 1)
