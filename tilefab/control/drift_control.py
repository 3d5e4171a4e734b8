"""The drift controller: which state of the press the next faces are to be printed for.

Every fired tile tells what state the press was in when it was fired; it is held against the correction that this very
tile was printed with, so no delay is ever assumed. A Kalman filter follows the state as it wanders. Tiles that don't
fit are not believed by themselves; when several agree with each other, the press has made a step. How fast the press
wanders, how noisy tiles are and how strongly the press answers to corrections are learnt slowly and within bounds.
Corrections are rate-limited, and withheld while there is a reason to doubt what is known.

Pure functions: `step` takes what is known and an event, and gives what is known then and what is to be done. Nothing
here knows of colour: the state is any vector, and a scalar process is a state of one value.

References
----------
R. E. Kalman, "A new approach to linear filtering and prediction problems", Journal of Basic Engineering 82 (1960).
R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Transactions on Automatic Control
15 (1970): innovations of an optimal filter are white. R. Good, S. J. Qin, "On the stability of MIMO EWMA run-to-run
controllers with metrology delay", IEEE Transactions on Semiconductor Manufacturing 19 (2006).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilefab.control.drift_control_state import (
    ControlSettings,
    DriftControl,
    Rival,
    control_from_record,
    control_record,
)
from tilefab.control.drift_events import (
    Action,
    CorrectionApplied,
    Event,
    Hold,
    HoldCode,
    Ignored,
    Innovation,
    Propose,
    Rejected,
    Release,
    StepSeen,
    TileMeasured,
)
from tilefab.control.drift_filter import Estimate, Reading, Surprise, aged_estimate, judge, reading_of

__all__ = [
    "ControlSettings",
    "DriftControl",
    "control_from_record",
    "control_record",
    "expected",
    "start_control",
    "step",
]

Float64Array = NDArray[np.float64]

_H = 3600.0
_BACK_S = 120.0
_LEAP_S = 12 * _H
_MOST_AGE_S = 4 * _H
_MOST_TICK_S = 300.0

_KEPT_CORRECTIONS = 80
_KEPT_TILES = 512

_TREND_KEPT = 0.8
_MOST_PULL = 3.0
_WALK_BOUNDS = (0.1, 10.0)
_NOISE_BOUNDS = (0.25, 25.0)
_FIRST_TILES = 20
_EFFECT_SHARE = 0.05

_MOST_EVIDENCE = 8.0
"""Most that one tile says for or against a step, as a natural logarithm: one that is wildly wrong says no more."""

_HEALTH_SHARE = 0.1
_HOLD_SHARES = {HoldCode.UNREADABLE: 0.6, HoldCode.MISFIT: 0.5, HoldCode.SCATTERED: 0.5}
_RELEASED = 0.5
"""A hold ends when its share has fallen to this part of what began it."""


def start_control(
    covariance: Float64Array,
    *,
    now_s: float,
    mean: Float64Array | None = None,
    applied: Float64Array | None = None,
    settings: ControlSettings | None = None,
) -> DriftControl:
    """A controller that hasn't seen a tile.

    Parameters
    ----------
    covariance
        (Q, Q) of a fresh state: how far the press usually is from zero.
    now_s
        The clock.
    mean
        (Q,) what is known of the state beforehand; None: zero.
    applied
        (Q,) the state for which faces without a correction are printed (number 0); None: zero.
    settings
        What it goes by; None: as usual.

    Raises
    ------
    ValueError
        If shapes don't fit or the covariance isn't positive.
    """
    chosen = settings or ControlSettings()
    prior = np.array(covariance, dtype=np.float64)
    size = len(prior)
    first = np.zeros(size) if mean is None else np.array(mean, dtype=np.float64)
    printed = np.zeros(size) if applied is None else np.array(applied, dtype=np.float64)
    if prior.shape != (size, size) or first.shape != (size,) or printed.shape != (size,):
        raise ValueError(f"states {first.shape} and {printed.shape} don't fit a covariance {prior.shape}")
    try:
        np.linalg.cholesky(prior)
    except np.linalg.LinAlgError:
        raise ValueError("the covariance of a fresh state must be positive") from None
    whole = np.zeros((size + 1, size + 1))
    whole[:-1, :-1] = prior
    whole[-1, -1] = chosen.excess_spread**2
    return DriftControl(
        settings=chosen,
        prior=prior,
        estimate=Estimate(np.append(first, 0.0), whole),
        estimate_s=0.0,
        rival=None,
        clock_s=now_s,
        time_s=0.0,
        walk_scale=1.0,
        noise_scale=1.0,
        trend=np.zeros(size),
        corrections=((0, printed),),
        effect=np.zeros((size, size)),
        corrected_s=-chosen.least_interval_s,
    )


def expected(control: DriftControl, correction: int) -> Float64Array:
    """The state (Q,) that a tile printed with a correction is expected to show: there its evidence is made straight.

    Of a correction that nobody knows it is the press's own state.
    """
    mean = control.estimate.mean
    applied = dict(control.corrections).get(correction)
    return mean[:-1].copy() if applied is None else np.asarray(mean[:-1] + mean[-1] * applied)


def step(control: DriftControl, event: Event) -> tuple[DriftControl, tuple[Action, ...]]:
    """Take notice of an event.

    Parameters
    ----------
    control
        What is known.
    event
        What has happened, in whatever order it is told of. Times are those of one clock; it may jump.

    Returns
    -------
    tuple
        What is known then, and what is to be done. A proposal need not be carried out; what is printed with is told by
        `CorrectionApplied`. One made by hand is taken for what it is, and corrected further as any.

    Raises
    ------
    ValueError
        If a state or evidence is of another size than the controller's.
    """
    actions: list[Action] = []
    if isinstance(event, TileMeasured):
        control, actions = _measured(_at(control, event.measured_at_s), event)
    elif isinstance(event, CorrectionApplied):
        control = _applied(_at(control, event.at_s), event)
    elif isinstance(event, Rejected):
        control = _at(control, event.at_s)
        control = replace(control, unread_share=_leaned(control.unread_share, True))
    else:
        before = control.time_s
        control = _at(control, event.now_s)
        if event.firing:
            control = replace(control, silent_s=control.silent_s + min(control.time_s - before, _MOST_TICK_S))
    control, told = _holds(control)
    control, proposed = _proposal(control)
    return control, (*actions, *told, *proposed)


def _at(control: DriftControl, clock_s: float) -> DriftControl:
    """Let time pass. Own time never runs backwards, and a leap of the clock passes as half a day at most."""
    passed = clock_s - control.clock_s
    if not math.isfinite(passed) or -_BACK_S <= passed < 0.0:
        return control
    return replace(control, clock_s=clock_s, time_s=control.time_s + min(max(passed, 0.0), _LEAP_S))


def _leaned(share: float, so: bool) -> float:
    return share + _HEALTH_SHARE * (float(so) - share)


def _applied(control: DriftControl, event: CorrectionApplied) -> DriftControl:
    mean = np.array(event.mean, dtype=np.float64)
    if mean.shape != (control.size,):
        raise ValueError(f"a correction of {mean.shape} values for a state of {control.size}")
    if not np.isfinite(mean).all():
        raise ValueError(f"correction {event.number} holds values that are no numbers")
    others = tuple(one for one in control.corrections if one[0] != event.number)
    kept = (*others, (event.number, mean))[-_KEPT_CORRECTIONS:]
    return replace(control, corrections=kept, corrected_s=control.time_s, tiles_since=0)


def _measured(control: DriftControl, event: TileMeasured) -> tuple[DriftControl, list[Action]]:
    size = control.size
    shapes = (event.at.shape, event.vector.shape, event.information.shape, event.effect.shape, event.watch.shape[1:])
    if shapes != ((size,), (size,), (size, size), (size, size), (size,)):
        raise ValueError(f"evidence of shapes {shapes} for a state of {size}")
    if event.tile in control.seen:
        return control, [Ignored(f"tile {event.tile} was told of before")]
    applied = dict(control.corrections).get(event.correction)
    if applied is None:
        return control, [Ignored(f"tile {event.tile}: correction {event.correction}, which it has, is not known")]
    if not event.information.any():
        return control, [Ignored(f"tile {event.tile} says nothing of the drift")]
    parts = (event.at, event.vector, event.information, event.effect, event.watch)
    senseless = not (event.misfit <= control.settings.most_misfit and all(np.isfinite(part).all() for part in parts))
    control = replace(
        control,
        seen=(*control.seen, event.tile)[-_KEPT_TILES:],
        silent_s=0.0,
        unread_share=_leaned(control.unread_share, False),
        misfit_share=_leaned(control.misfit_share, senseless),
    )
    if senseless:
        return control, [Ignored(f"tile {event.tile} differs from all that a drift can say: misfit {event.misfit:.1f}")]
    control, moved = _brought_to(control, event)
    share = max(_EFFECT_SHARE, 1.0 / (control.tiles + 1))
    control = replace(
        control,
        tiles=control.tiles + 1,
        tiles_since=control.tiles_since + 1,
        effect=control.effect + share * (event.effect - control.effect),
    )
    root = np.asarray(np.linalg.cholesky(control.prior), dtype=np.float64)
    reading = reading_of(event.information, event.vector, event.at, root)
    return _judged(control, event, _Tile(reading, applied, control.noise_scale, moved))


@dataclass(frozen=True, eq=False)
class _Tile:
    """A tile as the filter takes it."""

    reading: Reading
    applied: Float64Array
    noise: float
    moved: Float64Array | None

    def judge(self, estimate: Estimate) -> tuple[Surprise, Estimate]:
        return judge(estimate, self.reading, self.applied, self.noise, self.moved)


def _brought_to(control: DriftControl, event: TileMeasured) -> tuple[DriftControl, Float64Array | None]:
    """Bring the estimate to when a tile was fired; if it is past that already, say how far the press has moved since.

    A late tile is taken as one of now that is the noisier, which is nearly as good while it is late by less than the
    filter remembers.
    """
    age_s = min(max(event.measured_at_s - event.fired_at_s, 0.0), _MOST_AGE_S)
    hours = (control.time_s - age_s - control.estimate_s) / _H
    settings = control.settings
    if not math.isfinite(hours):
        hours = 0.0
    if hours < 0.0:
        return control, control.walk_scale * -math.expm1(settings.walk_per_hour * hours) * control.prior
    share, wandered = settings.walk_per_hour * hours, settings.excess_walk_per_hour**2 * hours

    def older(estimate: Estimate) -> Estimate:
        return aged_estimate(estimate, control.prior, share, control.walk_scale, wandered)

    rival = None if control.rival is None else replace(control.rival, estimate=older(control.rival.estimate))
    later_s = control.estimate_s + hours * _H
    return replace(control, estimate=older(control.estimate), estimate_s=later_s, rival=rival), None


def _judged(control: DriftControl, event: TileMeasured, tile: _Tile) -> tuple[DriftControl, list[Action]]:
    """Learn from a tile that fits; of one that doesn't, see whether the press has made a step."""
    settings = control.settings
    surprise, learnt = tile.judge(control.estimate)
    accepted = surprise.standard <= settings.gate
    values = _watched(control.estimate, surprise, event.watch)
    actions: list[Action] = [Innovation(event.tile, values, surprise.standard, accepted)]
    rival = _challenged(control, tile, surprise, accepted)
    if rival is not None and rival.agreeing >= settings.step_tiles and rival.score >= settings.step_evidence:
        change = _shown(control, rival.estimate.mean[:-1] - control.estimate.mean[:-1])
        actions.append(
            StepSeen(change, f"{rival.agreeing} tiles agree that the press has moved by {change:.1f} at once")
        )
        estimate = _bounded(rival.estimate, settings)
        return replace(
            control, estimate=estimate, rival=None, trend=np.zeros(control.size), scattered_share=0.0
        ), actions
    control = replace(
        control,
        rival=rival,
        scattered_share=_leaned(control.scattered_share, not accepted),
        noise_scale=_learnt_noise(control, surprise),
    )
    if accepted:
        control = _learnt_walk(control, surprise)
        control = replace(control, estimate=_bounded(learnt, settings))
    return control, actions


def _challenged(control: DriftControl, tile: _Tile, surprise: Surprise, accepted: bool) -> Rival | None:
    """The rival after a tile: one comes up with a tile that doesn't fit, and goes if later ones speak against it."""
    settings = control.settings
    rival = control.rival
    if rival is not None:
        other, taught = tile.judge(rival.estimate)
        agrees = other.standard <= settings.gate
        likelier = min(max(other.log_likelihood - surprise.log_likelihood, -_MOST_EVIDENCE), _MOST_EVIDENCE)
        rival = Rival(
            taught if agrees else rival.estimate,
            rival.score + likelier,
            rival.agreeing + agrees,
            rival.judged + 1,
        )
        gone = rival.score < 0.0 or rival.judged > 2 * settings.step_tiles
        if gone if accepted else not agrees:
            rival = None
    if rival is None and not accepted:
        covariance = control.estimate.covariance.copy()
        covariance[:-1, :-1] += settings.step_share * control.prior
        _, begun = tile.judge(Estimate(control.estimate.mean, covariance))
        rival = Rival(begun, 0.0, 1, 1)
    return rival


def _bounded(estimate: Estimate, settings: ControlSettings) -> Estimate:
    """The same with an excess that is believed; the state moves with it, as far as it was learnt together."""
    excess = float(estimate.mean[-1])
    allowed = min(max(excess, -settings.most_excess), settings.most_excess)
    if allowed == excess:
        return estimate
    mean = estimate.mean + estimate.covariance[:, -1] / estimate.covariance[-1, -1] * (allowed - excess)
    mean[-1] = allowed
    return Estimate(mean, estimate.covariance)


def _watched(estimate: Estimate, surprise: Surprise, watch: Float64Array) -> tuple[float, ...]:
    """By how much a tile moves the estimate of what is watched, in standard deviations of that."""
    lean = watch @ estimate.covariance[:-1]
    variance = np.einsum("dq,qr,dr->d", lean, surprise.weight, lean)
    moved = lean @ surprise.score
    return tuple(float(by / math.sqrt(size)) if size > 0.0 else 0.0 for by, size in zip(moved, variance, strict=True))


def _learnt_noise(control: DriftControl, surprise: Surprise) -> float:
    """Half of all tiles are to surprise more than the median, whatever the worst ones do."""
    rate = max(control.settings.adaptation, 1.0 / (control.tiles + _FIRST_TILES)) * bool(control.settings.adaptation)
    nudged = control.noise_scale * math.exp(rate * (0.5 if surprise.standard > 0.0 else -0.5))
    return min(max(nudged, _NOISE_BOUNDS[0]), _NOISE_BOUNDS[1])


def _learnt_walk(control: DriftControl, surprise: Surprise) -> DriftControl:
    """Tiles that go on pulling the way that the last ones did say that the press wanders faster than is thought."""
    score, weight = surprise.score[:-1], surprise.weight[:-1, :-1]
    lean = control.estimate.covariance[:-1, :-1] @ control.trend
    spread = math.sqrt(max(float(lean @ weight @ lean), 0.0))
    pull = float(lean @ score) / spread if spread > 0.0 else 0.0
    nudge = control.settings.adaptation * min(max(pull, -_MOST_PULL), _MOST_PULL)
    walk = min(max(control.walk_scale * math.exp(nudge), _WALK_BOUNDS[0]), _WALK_BOUNDS[1])
    return replace(control, walk_scale=walk, trend=_TREND_KEPT * control.trend + (1.0 - _TREND_KEPT) * score)


def _shown(control: DriftControl, change: Float64Array) -> float:
    """By how much tiles change with a change (Q,) of the state, root mean square."""
    return math.sqrt(max(float(change @ control.effect @ change), 0.0))


def _holds(control: DriftControl) -> tuple[DriftControl, list[Action]]:
    """Begin and end holds."""
    shares = {
        HoldCode.UNREADABLE: control.unread_share,
        HoldCode.MISFIT: control.misfit_share,
        HoldCode.SCATTERED: control.scattered_share,
    }
    minutes = control.settings.stale_after_s / 60.0
    begun = {
        HoldCode.STALE: f"tiles have been fired for {minutes:.0f} minutes and none was measured: look at the camera, "
        "its light, and whether the job on the line is the one that is inspected",
        HoldCode.UNREADABLE: "most images show no tile of this run that can be measured: look at the camera, its "
        "light and its lens",
        HoldCode.MISFIT: "most tiles differ from all that a drift of the press can explain: look at the latest images; "
        "if the tiles are so, the press has to be profiled anew",
        HoldCode.SCATTERED: "most tiles contradict what is known and each other: look at the kiln, and at the camera's "
        "light",
    }
    holds = list(control.holds)
    actions: list[Action] = []
    for code, text in begun.items():
        if code is HoldCode.STALE:
            begins = control.silent_s >= control.settings.stale_after_s
            ends = not begins
        else:
            begins = shares[code] > _HOLD_SHARES[code]
            ends = shares[code] <= _RELEASED * _HOLD_SHARES[code]
        if begins and code not in holds:
            holds.append(code)
            actions.append(Hold(code, f"corrections are withheld: {text}"))
        elif ends and code in holds:
            holds.remove(code)
            actions.append(Release(code, "corrections go on: tiles can be measured and make sense again"))
    return replace(control, holds=tuple(holds)), actions


def _proposal(control: DriftControl) -> tuple[DriftControl, list[Action]]:
    """A correction, if it is time for one and it is worth it."""
    settings = control.settings
    # While a step is in question, waiting for the answer costs a tile or two; a correction would cost the interval.
    if control.holds or control.rival is not None or control.tiles < settings.fewest_tiles or not control.tiles_since:
        return control, []
    since_s = control.time_s - control.corrected_s
    if since_s < settings.least_interval_s:
        return control, []
    mean = control.estimate.mean
    change = mean[:-1] / (1.0 - mean[-1]) - control.applied
    shown = _shown(control, change)
    if shown < settings.least_change:
        return control, []
    reason = f"{control.tiles_since} tiles since the last correction: tiles are off by {shown:.2f}"
    if shown > settings.largest_step:
        change = change * (settings.largest_step / shown)
        shown = settings.largest_step
        reason += f"; no more than {shown:g} is corrected at once"
    proposal = Propose(control.applied + change, control.estimate.covariance[:-1, :-1].copy(), shown, reason)
    return replace(control, corrected_s=control.time_s), [proposal]
