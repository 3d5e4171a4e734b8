"""What a tile says of the drift: enough to find it, no more than a tile can know, and untouched by stray regions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.kiln import Firing, drift_of_size, random_recipes
from sim.spectral_press import SpectralPress
from tilefab.colour.drift import DriftState, drifted, no_drift
from tilefab.colour.drift_evidence import DriftEvidence, EvidenceSettings, drift_evidence, ink_cells
from tilefab.colour.press_model import PressModel, fit_press_model
from tilefab.colour.spaces import delta_e_2000
from tilefab.control.drift_control import DriftControl, expected, start_control, step
from tilefab.control.drift_events import TileMeasured

INKS = 4
REGIONS = 1500
PRESS = SpectralPress("ceramic4")


@pytest.fixture(scope="module")
def model() -> PressModel:
    recipes = random_recipes(INKS, 140, np.random.default_rng(1), 2.8)
    recipes[: INKS + 1] = np.vstack([np.zeros((1, INKS)), np.eye(INKS)])
    return fit_press_model(recipes, PRESS.lab(recipes))


@pytest.fixture(scope="module")
def inks() -> np.ndarray:
    """A stone: mixtures of four colours."""
    random = np.random.default_rng(2)
    colours = 0.8 * random_recipes(INKS, 4, random, 2.0)
    return np.clip(
        random.dirichlet(np.full(4, 0.7), REGIONS) @ colours + random.normal(0.0, 0.02, (REGIONS, INKS)), 0.0, 1.0
    )


@pytest.fixture(scope="module")
def firing() -> Firing:
    return drift_of_size(PRESS, np.random.default_rng(3), 3.0)


def learnt(state: DriftState, evidence: DriftEvidence) -> DriftState:
    """Bayes, in one go."""
    known = np.linalg.inv(state.covariance)
    covariance = np.linalg.inv(evidence.information + known)
    pulled = evidence.vector + evidence.information @ evidence.at + known @ state.mean
    return DriftState(covariance @ pulled, covariance, state.inks)


def read(inks: np.ndarray, firing: Firing | None, seed: int) -> np.ndarray:
    return PRESS.lab(inks, firing) + np.random.default_rng(seed).normal(0.0, 0.4, (len(inks), 3))


def test_one_tile_shows_most_of_a_drift(model: PressModel, inks: np.ndarray, firing: Firing) -> None:
    state = no_drift(INKS)
    evidence = drift_evidence(model, state, inks, read(inks, firing, 4), 0.3)
    after = drifted(model, learnt(state, evidence)).lab(inks)
    fired = PRESS.lab(inks, firing)
    assert delta_e_2000(model.lab(inks), fired).mean() > 2.0
    assert delta_e_2000(after, fired).mean() < 0.6
    assert evidence.regions == evidence.used == REGIONS
    assert evidence.misfit < 1.2
    np.testing.assert_allclose(evidence.residual_lab, (fired - model.lab(inks)).mean(axis=0), atol=0.15)


def test_stray_regions_are_left_aside(model: PressModel, inks: np.ndarray, firing: Firing) -> None:
    state, random = no_drift(INKS), np.random.default_rng(5)
    clean = read(inks, firing, 4)
    spotted = clean.copy()
    stray = random.random(REGIONS) < 0.1
    spotted[stray] += [-20.0, 5.0, 5.0]
    spotted[0], spotted[1, 2] = np.nan, np.inf
    evidence = drift_evidence(model, state, inks, spotted, 0.3)
    without = drift_evidence(model, state, inks[~stray], clean[~stray], 0.3)
    assert evidence.regions == REGIONS - 2
    assert evidence.used == pytest.approx(REGIONS - stray.sum(), abs=5)
    apart = delta_e_2000(
        drifted(model, learnt(state, evidence)).lab(inks), drifted(model, learnt(state, without)).lab(inks)
    )
    assert apart.mean() < 0.1


def test_a_tile_is_never_surer_of_its_cast_than_tiles_are_alike(model: PressModel, inks: np.ndarray) -> None:
    state, many = no_drift(INKS), np.repeat(inks, 3, axis=0)
    spreads = []
    for cast in (0.2, 0.4):
        evidence = drift_evidence(
            model, state, many, model.lab(many), 0.0, settings=EvidenceSettings(tile_noise_lab=cast)
        )
        covariance = learnt(state, evidence).covariance
        spreads.append(np.sqrt(np.diag(evidence.watch @ covariance @ evidence.watch.T)))
        assert (spreads[-1] > 0.85 * cast).all()
    assert (spreads[0] < 1.2 * 0.2).all()
    assert (spreads[1] > 1.5 * spreads[0]).all()


def test_ten_times_the_regions_say_little_more(model: PressModel, inks: np.ndarray) -> None:
    state = no_drift(INKS)
    few, many = inks[:300], np.repeat(inks[:300], 10, axis=0)
    one, ten = (drift_evidence(model, state, some, model.lab(some), 0.3).information for some in (few, many))
    assert np.trace(one) < np.trace(ten) < 2.0 * np.trace(one)


def test_where_it_is_made_straight_does_not_matter(model: PressModel, inks: np.ndarray) -> None:
    fresh = no_drift(INKS)
    truth = replace(fresh, mean=0.6 * fresh.spread() * np.random.default_rng(6).standard_normal(len(fresh.mean)))
    fired = drifted(model, truth).lab(inks)
    near = replace(fresh, mean=0.9 * truth.mean)
    for start in (fresh, near):
        evidence = drift_evidence(model, start, inks, fired, 0.3)
        found = drifted(model, learnt(fresh, evidence)).lab(inks)
        assert delta_e_2000(found, fired).mean() < 0.25


def test_effect_and_watch_are_what_changes_show(model: PressModel, inks: np.ndarray) -> None:
    state, random = no_drift(INKS), np.random.default_rng(7)
    evidence = drift_evidence(model, state, inks, model.lab(inks), 0.3)
    change = 0.2 * state.spread() * random.standard_normal(len(state.mean))
    moved = drifted(model, replace(state, mean=change)).lab(inks) - model.lab(inks)
    assert np.sqrt(change @ evidence.effect @ change) == pytest.approx(np.sqrt((moved**2).sum(axis=1).mean()), rel=0.1)
    np.testing.assert_allclose(evidence.watch @ change, moved.mean(axis=0), atol=0.1)


def test_another_stone_is_a_misfit(model: PressModel, inks: np.ndarray) -> None:
    other = read(inks[np.random.default_rng(8).permutation(REGIONS)], None, 9)
    assert drift_evidence(model, no_drift(INKS), inks, other, 0.3).misfit > 4.0


def test_shares_and_noise_count(model: PressModel, inks: np.ndarray, firing: Firing) -> None:
    state = no_drift(INKS)
    fired = read(inks, firing, 10)
    doubled = np.where(np.arange(REGIONS) < 700, 2.0, 0.0)
    part = drift_evidence(model, state, inks, fired, 0.3, share=doubled)
    alone = drift_evidence(model, state, inks[:700], fired[:700], 0.3)
    np.testing.assert_allclose(part.information, alone.information, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(part.vector, alone.vector, rtol=1e-9, atol=1e-9)
    noisy = drift_evidence(model, state, inks, fired, np.full(REGIONS, 30.0))
    assert np.trace(noisy.information) < 0.2 * np.trace(alone.information)


def test_a_tile_without_regions_says_nothing(model: PressModel) -> None:
    evidence = drift_evidence(model, no_drift(INKS), np.zeros((0, INKS)), np.zeros((0, 3)), 0.3)
    assert evidence.regions == 0
    assert not evidence.information.any()
    blank = drift_evidence(model, no_drift(INKS), np.zeros((3, INKS)), np.full((3, 3), np.nan), 0.3)
    assert not blank.vector.any()


def test_cells_gather_like_inks() -> None:
    random = np.random.default_rng(11)
    inks = random.random((800, 3))
    cell = ink_cells(inks, 20)
    assert sorted(set(cell.tolist())) == list(range(20))
    within = sum(inks[cell == one].var(axis=0).sum() * (cell == one).sum() for one in range(20)) / 800
    assert within < 0.25 * inks.var(axis=0).sum()
    assert ink_cells(np.full((5, 2), 0.3), 8).tolist() == [0] * 5
    np.testing.assert_array_equal(ink_cells(inks, 20), cell)


def test_misuse_is_refused(model: PressModel, inks: np.ndarray) -> None:
    fired = model.lab(inks)
    with pytest.raises(ValueError, match="don't fit a press of 4 inks"):
        drift_evidence(model, no_drift(3), inks, fired, 0.3)
    with pytest.raises(ValueError, match="don't fit a press of 4 inks"):
        drift_evidence(model, no_drift(INKS), inks, fired[:5], 0.3)
    with pytest.raises(ValueError, match="must not be negative"):
        drift_evidence(model, no_drift(INKS), inks, fired, -0.1)


def told(control: DriftControl, model: PressModel, inks: np.ndarray, lab: np.ndarray, number: int) -> DriftControl:
    """The controller after a tile, one a minute, without any correction."""
    state = replace(no_drift(INKS), mean=expected(control, 0))
    evidence = drift_evidence(model, state, inks, lab, 0.3)
    event = TileMeasured(
        number,
        0,
        60.0 * number,
        60.0 * number,
        evidence.at,
        evidence.information,
        evidence.vector,
        evidence.effect,
        evidence.watch,
        evidence.misfit,
    )
    return step(control, event)[0]


def test_the_controller_learns_a_press_from_tiles_and_its_step(
    model: PressModel, inks: np.ndarray, firing: Firing
) -> None:
    control = start_control(no_drift(INKS).covariance, now_s=0.0)
    random = np.random.default_rng(12)
    for number in range(16):
        now = None if number < 10 else firing
        part = random.choice(REGIONS, 500, replace=False)
        lab = read(inks[part], now, number) + random.normal(0.0, 0.2, 3)
        control = told(control, model, inks[part], lab, number)
        if number in (9, 15):
            state = replace(no_drift(INKS), mean=expected(control, 0))
            assert delta_e_2000(drifted(model, state).lab(inks), PRESS.lab(inks, now)).mean() < 0.5
    assert control.rival is None
    assert not control.holds


def test_an_ink_that_no_tile_shows_stays_as_it_was(model: PressModel, inks: np.ndarray) -> None:
    control = start_control(no_drift(INKS).covariance, now_s=0.0)
    without = inks * np.array([1.0, 1.0, 1.0, 0.0])
    hot = Firing(peak_offset_degc=8.0)
    for number in range(30):
        control = told(control, model, without, read(without, hot, number), number)
    names = no_drift(INKS)
    last = np.zeros(len(names.mean), dtype=bool)
    for place in (INKS - 1, 2 * INKS - 1):
        last[place] = True
    state = replace(names, mean=control.estimate.mean[:-1], covariance=control.estimate.covariance[:-1, :-1])
    assert np.abs(state.mean[last]).max() < 1e-9
    np.testing.assert_allclose(state.spread()[last], names.spread()[last], rtol=1e-3)
    assert (state.spread() < 1.001 * names.spread()).all()
