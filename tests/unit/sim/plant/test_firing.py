"""What a firing owes to drifts, zones and time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sim.instrument import delta_e_2000
from sim.kiln import Firing, random_recipes
from sim.plant.physics.firing import QUANTITIES, FiringDrift
from sim.spectral_press import SpectralPress
from tests.unit.sim.plant.physics_bench import EYE_TO_HEAD, Bench
from tests.unit.sim.plant.test_plant import ALL, print_on

TO_KILN = 800 + EYE_TO_HEAD + 2000 + 3000


def firing_of(fired):
    facts = fired.view()
    del facts["at"]
    return Firing(**facts)


def test_without_drift_a_firing_is_normal():
    drift = FiringDrift(4, 0.0, 1)
    fired = drift.fired(1e6, drift.laid(9e5), 0.0, 0.0)
    assert firing_of(fired) == Firing(ink_offset_frac=(0.0,) * 4)
    assert fired.at == 1e6


def test_drifts_come_evenly_from_where_they_are_and_go_again():
    drift = FiringDrift(2, 0.0, 1)
    drift.aim(100, {QUANTITIES["oxygen"]: 2.0, QUANTITIES["peak"]: 8.0, drift.ink_name(1): 0.1}, 200)

    def now(t):
        fired = drift.fired(t, drift.laid(t), 1.0, 0.5)
        return fired.oxygen_offset_percent, fired.peak_offset_degc, fired.ink_offset_frac, fired.soak_offset_min

    assert now(100) == (0.0, 1.0, (0.0, 0.0), 0.5)
    assert now(200) == (1.0, 5.0, (0.0, 0.05), 0.5)
    drift.aim(200, {QUANTITIES["oxygen"]: 0.0}, 0)
    assert now(200) == (0.0, 5.0, (0.0, 0.05), 0.5)
    assert now(900) == (0.0, 9.0, (0.0, 0.1), 0.5)
    with pytest.raises(ValueError, match="no ink 2"):
        drift.ink_name(2)


def test_the_walk_goes_as_far_as_it_says_and_has_no_steps():
    press = SpectralPress("ceramic4")
    recipes = random_recipes(4, 200, np.random.default_rng(1))
    normal = press.lab(recipes)
    far = []
    for seed in range(40):
        drift = FiringDrift(4, 0.5, seed)
        firing = firing_of(drift.fired(3600, drift.laid(3600), 0.0, 0.0))
        far.append(float(delta_e_2000(normal, press.lab(recipes, firing)).mean()))
    assert np.mean(far) == pytest.approx(0.5, rel=0.2)
    drift = FiringDrift(4, 0.5, 7)
    peaks = [drift.fired(t, drift.laid(t), 0.0, 0.0).peak_offset_degc for t in range(0, 40000, 10)]
    assert np.abs(np.diff(peaks)).max() < 0.2
    assert np.std(peaks) > 1.0
    again = FiringDrift(4, 0.5, 7)
    assert again.fired(20000, again.laid(20000), 0.0, 0.0).peak_offset_degc == peaks[2000]


def fired_bench(**kiln):
    bench = Bench(loader={"tiles": 3}, kiln={"press": "ceramic4", "start_degc": 1180.0, "cycle_minutes": 40.0} | kiln)
    bench.start(**ALL)
    return bench


def test_a_tile_brings_what_it_was_printed_with_and_meets_the_heat_of_its_way():
    bench = fired_bench()
    drift = bench.plant.drift
    assert drift is not None
    drift.aim(0.0, {QUANTITIES["moisture"]: 0.5, drift.ink_name(3): -0.1}, 0)
    for seq in (1, 2, 3):
        bench.wait_for_tile(seq)
        print_on(bench, seq, seq)
    bench.until_travel(TO_KILN + 1400 + 1)
    entered = bench.wall
    drift.aim(bench.plant.timeline.t, {QUANTITIES["moisture"]: 9.0, QUANTITIES["oxygen"]: 1.0}, 0)
    bench.plant.kiln.drift(5, 20.0, 10)
    bench.until(entered + 40 * 60 + 1)
    fired = [tile["fired"] for tile in bench.truth().values()]
    assert [fact["moisture_offset_percent"] for fact in fired] == [0.5] * 3
    assert [fact["ink_offset_frac"] for fact in fired] == [(0.0, 0.0, 0.0, -0.1)] * 3
    assert [fact["oxygen_offset_percent"] for fact in fired] == [1.0] * 3
    assert [fact["peak_offset_degc"] for fact in fired] == pytest.approx([10.0] * 3, abs=1e-3)
    assert [fact["soak_offset_min"] for fact in fired] == [0.0] * 3
    assert fired[2]["at"] == pytest.approx(entered + 30 * 60, abs=0.5)


def test_normal_firing_may_be_told_and_longer_firing_soaks():
    zones = [450.0, 780.0, 960.0, 1080.0, 1160.0, 1195.0, 1191.0, 1150.0]
    bench = fired_bench(zones_degc=zones, peak_degc=1190.0, normal_minutes=50.0)
    assert bench.plant.kiln.temperatures() == zones
    bench.until_travel(TO_KILN + 1)
    bench.after(40 * 60 + 1)
    fired = bench.truth()[1]["fired"]
    assert fired["peak_offset_degc"] == pytest.approx(3.0)
    assert fired["soak_offset_min"] == pytest.approx(-1.0)


def test_a_plant_whose_colours_nobody_looks_at_has_none():
    bench = Bench(loader={"tiles": 1})
    bench.start(**ALL)
    bench.until_travel(TO_KILN + 1)
    bench.after(50 * 60)
    (tile,) = bench.truth().values()
    assert tile["fate"] == "fired"
    assert not {"fired", "photo"} & tile.keys()
    assert bench.plant.drift is None
    assert bench.plant.camera is None


def test_a_firing_is_the_same_as_that_of_the_press():
    names = {entry.name for entry in dataclasses.fields(Firing)}
    drift = FiringDrift(4, 0.0, 1)
    assert set(drift.fired(0, drift.laid(0), 0.0, 0.0).view()) == names | {"at"}
    assert set(QUANTITIES.values()) | {"ink_offset_frac"} == names
