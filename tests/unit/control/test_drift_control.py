"""The drift controller on scalar presses with a delay: it follows, doubts, believes, waits, holds, and restarts."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
import pytest

from tilefab.control.drift_control import (
    ControlSettings,
    DriftControl,
    control_from_record,
    control_record,
    expected,
    start_control,
    step,
)
from tilefab.control.drift_events import (
    Action,
    CorrectionApplied,
    Hold,
    HoldCode,
    Ignored,
    Innovation,
    Propose,
    Rejected,
    Release,
    StepSeen,
    Tick,
    TileMeasured,
)

Kind = TypeVar("Kind")

NOISE = 0.3
DELAY = 55
ONE = np.eye(1)
PRIOR = 9.0 * ONE


def tile(
    control: DriftControl, number: int, value: float, minute: float, correction: int = 0, late_min: float = 0.0
) -> TileMeasured:
    """A tile that shows a state, as sure as the noise lets it be."""
    at = expected(control, correction)
    information = ONE / NOISE**2
    return TileMeasured(
        tile=number,
        correction=correction,
        fired_at_s=60.0 * (minute - late_min),
        measured_at_s=60.0 * minute,
        at=at,
        information=information,
        vector=information @ (np.array([value]) - at),
        effect=ONE,
        watch=ONE,
    )


def settled(value: float = 0.0, tiles: int = 40, settings: ControlSettings | None = None) -> DriftControl:
    """A controller that has seen a steady press, and corrected it once."""
    control = start_control(PRIOR, now_s=0.0, settings=settings)
    noise = np.random.default_rng(5).normal(0.0, NOISE, tiles)
    for number in range(tiles):
        control, _ = step(control, tile(control, number, value + noise[number], number))
    control, _ = step(control, CorrectionApplied(1, 60.0 * tiles, np.array([value])))
    return control


def of_kind(actions: tuple[Action, ...], kind: type[Kind]) -> list[Kind]:
    return [action for action in actions if isinstance(action, kind)]


@dataclass
class Line:
    """A press with one number that drifts; tiles are measured a delay after they were printed, one a minute."""

    drift: np.ndarray
    gain: float = 1.0
    delay: Callable[[int], int] = lambda _: DELAY
    missing: np.ndarray | None = None
    wrong: np.ndarray | None = None
    late: np.ndarray | None = None
    seed: int = 0
    settings: ControlSettings = field(default_factory=ControlSettings)

    def run(self) -> np.ndarray:
        """Errors of all tiles."""
        minutes = len(self.drift)
        noise = np.random.default_rng(self.seed).normal(0.0, NOISE, minutes)
        if self.wrong is not None:
            noise = noise + self.wrong
        self.control = start_control(PRIOR, now_s=0.0, settings=self.settings)
        self.actions: list[tuple[int, Action]] = []
        used, states = [0] * minutes, [0.0]
        errors = np.empty(minutes)
        due: list[list[int]] = [[] for _ in range(minutes)]
        for minute in range(minutes):
            at = minute + (0 if self.late is None else int(self.late[minute]))
            if at < minutes and (self.missing is None or not self.missing[minute]):
                due[at].append(minute)
        for minute in range(minutes):
            used[minute] = len(states) - 1
            printed = minute - self.delay(minute)
            errors[minute] = self.drift[minute] - self.gain * states[used[printed] if printed >= 0 else 0]
            for fired in due[minute]:
                printed = fired - self.delay(fired)
                number = used[printed] if printed >= 0 else 0
                value = errors[fired] + states[number] + noise[fired]
                event = tile(self.control, fired, value, minute, number, minute - fired)
                self.control, actions = step(self.control, event)
                self.actions += [(minute, action) for action in actions]
                for proposal in of_kind(actions, Propose):
                    states.append(float(proposal.mean[0]))
                    applied = CorrectionApplied(len(states) - 1, 60.0 * minute, proposal.mean)
                    self.control, _ = step(self.control, applied)
        return errors


def wandering(minutes: int, seed: int, per_minute: float = 0.067) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).normal(0.0, per_minute, minutes))


def open_to_least(drift: np.ndarray, errors: np.ndarray, first: int = 600) -> float:
    """Mean square over that of a controller which knows the press exactly a delay ago."""
    blind = drift[first:] - drift[first - DELAY : -DELAY]
    return float((errors[first:] ** 2).mean() / (blind**2).mean())


@pytest.mark.parametrize("gain", [0.6, 1.0, 1.5])
def test_a_wandering_press_is_followed_whatever_its_gain(gain: float) -> None:
    drift = wandering(3000, 1)
    line = Line(drift, gain=gain)
    errors = line.run()
    assert open_to_least(drift, errors) < 1.25
    assert (drift[600:] ** 2).mean() > 2.0 * (errors[600:] ** 2).mean()
    assert line.control.excess == pytest.approx(1.0 - gain, abs=0.2)
    assert not line.control.holds


def test_missing_late_and_wrong_tiles_hardly_matter() -> None:
    drift, random = wandering(3000, 2), np.random.default_rng(3)
    missing = random.random(3000) < 0.3
    wrong = np.where(
        random.random(3000) < 0.02, random.choice([-1.0, 1.0], 3000) * random.uniform(2.0, 12.0, 3000), 0.0
    )
    late = np.where(random.random(3000) < 0.2, random.integers(1, 20, 3000), 0)
    line = Line(
        drift, missing=missing, wrong=wrong, late=late, delay=lambda minute: DELAY + round(20 * math.sin(minute / 200))
    )
    assert open_to_least(drift, line.run()) < 1.3
    innovations = [action for _, action in line.actions if isinstance(action, Innovation)]
    rejected = sum(not one.accepted for one in innovations) / len(innovations)
    assert 0.01 < rejected < 0.06
    assert not any(isinstance(action, Hold | StepSeen) for _, action in line.actions)


def test_a_step_is_believed_after_three_tiles_and_corrected_at_once() -> None:
    drift = np.zeros(500)
    drift[300:] = 3.0
    line = Line(drift)
    errors = line.run()
    seen = [(minute, action) for minute, action in line.actions if isinstance(action, StepSeen)]
    assert len(seen) == 1
    assert seen[0][0] == 302
    assert isinstance(seen[0][1], StepSeen)
    assert seen[0][1].change == pytest.approx(3.0, abs=0.6)
    recovered = 300 + round(1.25 * DELAY)
    assert np.abs(errors[recovered:]).max() < 0.3 + 0.1
    assert np.abs(errors[recovered:].mean()) < 0.1
    assert errors[recovered:].min() > -0.3


def test_a_wrong_tile_moves_nothing() -> None:
    control = settled()
    before = control.estimate
    control, actions = step(control, tile(control, 100, 9.0, 41))
    (innovation,) = of_kind(actions, Innovation)
    assert not innovation.accepted
    assert innovation.surprise > 10.0
    assert not of_kind(actions, Propose)
    # Only time has passed.
    np.testing.assert_allclose(control.estimate.mean, before.mean, rtol=1e-3)
    control, actions = step(control, tile(control, 101, 0.1, 42))
    assert of_kind(actions, Innovation)[0].accepted
    control, _ = step(control, tile(control, 102, -0.1, 43))
    assert control.rival is None


def test_wrong_tiles_that_contradict_each_other_end_in_a_hold_and_good_ones_in_its_release() -> None:
    control = settled()
    codes: list[object] = []
    for number in range(20):
        control, actions = step(control, tile(control, 200 + number, 9.0 * (-1) ** number * (1 + number), 41 + number))
        codes += [action.code for action in actions if isinstance(action, Hold)]
        assert not of_kind(actions, Propose)
        assert not of_kind(actions, StepSeen)
    assert codes == [HoldCode.SCATTERED]
    released: list[object] = []
    for number in range(20):
        control, actions = step(control, tile(control, 300 + number, 0.0, 61 + number))
        released += [action.code for action in actions if isinstance(action, Release)]
    assert released == [HoldCode.SCATTERED]
    assert control.holds == ()


def test_a_tile_told_of_twice_counts_once() -> None:
    control = settled()
    event = tile(control, 50, 0.4, 41)
    once, _ = step(control, event)
    twice, actions = step(once, event)
    assert [type(action) for action in actions] == [Ignored]
    np.testing.assert_array_equal(twice.estimate.mean, once.estimate.mean)


def test_a_tile_of_an_unknown_correction_is_left_aside() -> None:
    control = settled()
    later, actions = step(control, tile(control, 50, 0.4, 41, correction=7))
    assert isinstance(actions[0], Ignored)
    assert "correction 7" in actions[0].text
    np.testing.assert_array_equal(later.estimate.mean, control.estimate.mean)
    np.testing.assert_array_equal(expected(control, 7), control.estimate.mean[:-1])


def test_a_misfit_is_left_aside_and_many_are_a_hold() -> None:
    control = settled()
    held = []
    for number in range(10):
        event = replace(tile(control, 60 + number, 0.4, 41 + number), misfit=9.0)
        if number == 3:
            event = replace(event, misfit=1.0, vector=np.array([math.nan]))
        control, actions = step(control, event)
        held += [action.code for action in actions if isinstance(action, Hold)]
        assert isinstance(actions[0], Ignored)
    assert held == [HoldCode.MISFIT]


def test_images_without_a_tile_are_a_hold_until_tiles_are_seen_again() -> None:
    control = settled()
    codes: list[tuple[str, object]] = []
    for number in range(15):
        control, actions = step(control, Rejected(60.0 * (41 + number), "black"))
        codes += [(type(action).__name__, action.code) for action in actions if isinstance(action, Hold | Release)]
    for number in range(15):
        control, actions = step(control, tile(control, 60 + number, 0.0, 56 + number))
        codes += [(type(action).__name__, action.code) for action in actions if isinstance(action, Hold | Release)]
    assert codes == [("Hold", HoldCode.UNREADABLE), ("Release", HoldCode.UNREADABLE)]


def test_silence_is_a_hold_only_while_tiles_are_fired() -> None:
    control = settled()
    for minute in range(41, 141):
        control, actions = step(control, Tick(60.0 * minute, firing=False))
        assert actions == ()
    held = []
    for minute in range(141, 171):
        control, actions = step(control, Tick(60.0 * minute))
        held += [(minute, action.code) for action in actions if isinstance(action, Hold)]
    assert held == [(160, HoldCode.STALE)]
    control, actions = step(control, tile(control, 900, 1.5, 172))
    assert [action.code for action in actions if isinstance(action, Release)] == [HoldCode.STALE]


def test_corrections_keep_their_interval_their_least_and_their_largest_change() -> None:
    settings = ControlSettings(least_interval_s=600.0, largest_step=1.0, least_change=0.2)
    line = Line(np.concatenate([np.zeros(100), np.full(200, 3.0)]), settings=settings)
    line.run()
    proposals = [(minute, action) for minute, action in line.actions if isinstance(action, Propose)]
    minutes = np.array([minute for minute, _ in proposals])
    assert (np.diff(minutes) >= 10).all()
    states = np.concatenate([[0.0], [action.mean[0] for _, action in proposals]])
    assert np.abs(np.diff(states)).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(states)).min() >= 0.2
    assert states[-1] == pytest.approx(3.0, abs=0.3)
    assert any("at once" in action.reason for _, action in proposals)


def test_a_refused_proposal_is_made_again_after_its_interval() -> None:
    control = settled(settings=ControlSettings(least_interval_s=300.0))
    proposed = []
    for number in range(20):
        control, actions = step(control, tile(control, 60 + number, 1.0, 46 + number))
        proposed += [46 + number for _ in of_kind(actions, Propose)]
    assert len(proposed) == 4
    assert set(np.diff(proposed)) == {5}


def test_the_clock_may_jump() -> None:
    control = settled()
    mean = control.estimate.mean[0]
    for jump_min in (-1e6, 1e7, -5e5):
        control, actions = step(control, Tick(60.0 * jump_min, firing=True))
        assert not of_kind(actions, Hold)
        assert control.time_s >= 0.0
    later = control.time_s
    control, actions = step(control, replace(tile(control, 70, 0.1, 0), measured_at_s=-3e7, fired_at_s=math.inf))
    assert of_kind(actions, Innovation)[0].accepted
    assert control.time_s >= later
    assert control.estimate.mean[0] == pytest.approx(mean, abs=0.5)
    control, _ = step(control, Tick(math.nan))
    assert math.isfinite(control.time_s)


def test_small_steps_back_of_the_clock_do_not_add_up() -> None:
    control = settled()
    start_s, base = control.time_s, control.clock_s
    for number in range(50):
        control, _ = step(control, Tick(base + 60.0 * number, firing=False))
        control, _ = step(control, Tick(base + 60.0 * number - 40.0, firing=False))
    assert control.time_s - start_s == pytest.approx(49 * 60.0)


def test_after_a_restart_it_goes_on_as_if_nothing_had_been() -> None:
    control = settled()
    control, _ = step(control, tile(control, 99, 5.0, 41))  # with a rival
    again = control_from_record(json.loads(json.dumps(control_record(control), allow_nan=False)))
    assert again.rival is not None
    for number in range(8):
        event = tile(control, 100 + number, 0.3 * number, 42 + number)
        control, actions = step(control, event)
        again, same = step(again, event)
        assert [type(action) for action in actions] == [type(action) for action in same]
        np.testing.assert_array_equal(again.estimate.mean, control.estimate.mean)
        np.testing.assert_array_equal(again.estimate.covariance, control.estimate.covariance)
    assert control_record(again) == control_record(control)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("schema_version", 2),
        ("size", 0),
        ("estimate", None),
        ("trend", "AAAA"),
        ("prior", "no base64!"),
        ("walk_scale", math.nan),
        ("clock_s", True),
        ("holds", ["tired"]),
        ("corrections", []),
        ("rival", {"estimate": {}}),
        ("seen", 3),
    ],
)
def test_what_is_no_record_is_refused(name: str, value: object) -> None:
    record = control_record(settled())
    record[name] = value
    with pytest.raises(ValueError, match="no record of the drift controller"):
        control_from_record(record)
    del record[name]
    with pytest.raises(ValueError, match="no record of the drift controller"):
        control_from_record(record)


def test_what_no_tile_shows_goes_back_to_what_is_usual() -> None:
    prior = np.diag([9.0, 4.0])
    control = start_control(prior, now_s=0.0, mean=np.array([0.0, 1.5]))
    information = np.diag([1.0 / NOISE**2, 0.0])
    random = np.random.default_rng(7)
    for number in range(1500):
        at = expected(control, 0)
        vector = information @ (np.array([random.normal(1.0, NOISE), 0.0]) - at)
        control, _ = step(
            control,
            TileMeasured(number, 0, 600.0 * number, 600.0 * number, at, information, vector, information, np.eye(2)),
        )
    mean, covariance = control.estimate.mean, control.estimate.covariance
    assert mean[0] == pytest.approx(1.0, abs=0.3)
    assert abs(mean[1]) < 0.1
    # Never less sure than of a fresh press, but for a wandering that tiles show to be quick.
    assert covariance[1, 1] <= 4.0 * max(1.0, control.walk_scale) + 1e-9
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_innovations_are_white_and_of_unit_spread() -> None:
    line = Line(wandering(2500, 8), seed=9)
    line.run()
    values = np.array([action.values[0] for _, action in line.actions if isinstance(action, Innovation)])[300:]
    assert values.std() == pytest.approx(1.0, abs=0.1)
    assert abs(values.mean()) < 0.1
    for lag in (1, 2, 5):
        assert abs(np.corrcoef(values[lag:], values[:-lag])[0, 1]) < 0.08


@pytest.mark.parametrize("told", [0.5, 2.0])
def test_noise_that_is_told_wrong_is_learnt(told: float) -> None:
    control = start_control(PRIOR, now_s=0.0)
    noise = np.random.default_rng(11).normal(0.0, NOISE / told, 1500)
    for number in range(1500):
        control, _ = step(control, tile(control, number, noise[number], number))
    assert control.noise_scale == pytest.approx(told**-2, rel=0.35)


def test_misuse_is_refused() -> None:
    control = start_control(PRIOR, now_s=0.0)
    with pytest.raises(ValueError, match="must be positive"):
        start_control(np.zeros((1, 1)), now_s=0.0)
    with pytest.raises(ValueError, match="don't fit a covariance"):
        start_control(PRIOR, now_s=0.0, mean=np.zeros(2))
    with pytest.raises(ValueError, match="for a state of 1"):
        step(control, CorrectionApplied(1, 0.0, np.zeros(2)))
    with pytest.raises(ValueError, match="for a state of 1"):
        step(control, replace(tile(control, 1, 0.0, 0), effect=np.eye(2)))
    with pytest.raises(ValueError, match="must be above 0"):
        ControlSettings(gate=0.0)
    with pytest.raises(ValueError, match="must not be negative"):
        ControlSettings(least_change=-1.0)
    with pytest.raises(ValueError, match="most_excess 0 to below 1"):
        ControlSettings(most_excess=1.0)
    with pytest.raises(ValueError, match="a step takes 2 tiles"):
        ControlSettings(step_tiles=1)
