"""What the drift controller makes of tiles, and what its control charts say to that.

One controller serves all runs printed on a press, so that a new run begins with what was learnt from the one before. It
tells corrections apart by one number over all runs: that of the run times `RUN_NUMBERS`, plus that of the correction.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tilefab.control.drift_control import step
from tilefab.control.drift_control_state import ControlSettings
from tilefab.control.drift_events import (
    CorrectionApplied,
    Event,
    Hold,
    Ignored,
    Innovation,
    Propose,
    Release,
    StepSeen,
)
from tilefab.inspection.watch import watch
from tilefab.pipeline.inspection.remembering import ChartState, PressState

Float64Array = NDArray[np.float64]

RUN_NUMBERS = 1_000_000
_TOLD_AT_ONCE = 20
"""More corrections than any run has."""

WATCHED = ("L", "a", "b")
"""Names of the values that the charts watch."""

REPEATED_WITHIN = 30
"""Tiles within which a chart must signal a second time, to the same side, to be believed.

By chance one chart of the twelve (EWMA and CUSUM, up and down, of three values) signals every 80 tiles or so, and so
soon again every few thousand; what goes on signals again within a dozen.
"""

_SIDES = {1: "+", -1: "-"}
_USUAL_DRIFT_PER_HOUR = 0.25
"""The drift, CIEDE2000 of tiles' mean colour in an hour, that the controller's own settings stand for."""


@dataclass(frozen=True)
class ChartedInnovation:
    """A tile's innovation, and what the charts said.

    Attributes
    ----------
    innovation
        The controller's.
    signals
        As `tilefab.io.inspection_records.InnovationRecord` has them.
    """

    innovation: Innovation
    signals: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Learnt:
    """What came of telling the controller something.

    Attributes
    ----------
    state
        The press from now on.
    innovations
        Of tiles.
    proposal
        A correction that it wants; ``None``: none.
    holds, releases
        Reasons to withhold corrections, new and gone.
    steps, ignored
        What else it has to say, for the log.
    drifting
        Of each value whose chart signalled repeatedly its place among `WATCHED`, with a sentence about it.
    """

    state: PressState
    innovations: tuple[ChartedInnovation, ...] = ()
    proposal: Propose | None = None
    holds: tuple[Hold, ...] = ()
    releases: tuple[Release, ...] = ()
    steps: tuple[StepSeen, ...] = ()
    ignored: tuple[Ignored, ...] = ()
    drifting: tuple[tuple[int, str], ...] = ()


def control_number(run_id: int, correction: int) -> int:
    """A correction's number over all runs; that of 0 is the job as its file says."""
    if not 0 <= correction < RUN_NUMBERS:
        raise ValueError(f"correction {correction} of run {run_id}: a run has fewer than {RUN_NUMBERS}")
    return run_id * RUN_NUMBERS + correction


def control_settings(correction_interval_min: float, drift_per_hour: float) -> ControlSettings:
    """The controller's settings, from what the line's file says."""
    usual = ControlSettings()
    return replace(
        usual,
        least_interval_s=60.0 * correction_interval_min,
        walk_per_hour=usual.walk_per_hour * (drift_per_hour / _USUAL_DRIFT_PER_HOUR) ** 2,
    )


def learn(state: PressState, events: Iterable[Event]) -> Learnt:
    """Tell the controller of events, in order, and the charts of what it makes of them."""
    control, charts = state.control, list(state.charts)
    innovations: list[ChartedInnovation] = []
    proposal: Propose | None = None
    holds: list[Hold] = []
    releases: list[Release] = []
    steps: list[StepSeen] = []
    ignored: list[Ignored] = []
    drifting: list[tuple[int, str]] = []
    for event in events:
        control, actions = step(control, event)
        for action in actions:
            match action:
                case Innovation():
                    signals, repeated = _chart(charts, action)
                    innovations.append(ChartedInnovation(action, signals))
                    drifting += repeated
                case Propose():
                    proposal = action
                case Hold():
                    holds.append(action)
                case Release():
                    releases.append(action)
                case StepSeen():
                    steps.append(action)
                case Ignored():
                    ignored.append(action)
    return Learnt(
        PressState(control, (charts[0], charts[1], charts[2])),
        tuple(innovations),
        proposal,
        tuple(holds),
        tuple(releases),
        tuple(steps),
        tuple(ignored),
        tuple(drifting),
    )


def _chart(charts: list[ChartState], innovation: Innovation) -> tuple[tuple[str, ...], list[tuple[int, str]]]:
    """Bring charts up to date; signals of this tile, and values whose charts signal repeatedly."""
    if not innovation.accepted:
        # A tile that is not believed, a broken one say, tells nothing of the process.
        return (), []
    signals: list[str] = []
    repeated: list[tuple[int, str]] = []
    for place, value in enumerate(innovation.values):
        before = charts[place]
        now, said = watch(before.watch, value)
        found = [f"{kind}{_SIDES[side]}" for kind, side in (("ewma", said.ewma), ("cusum", said.cusum)) if side]
        again = [name for name in found if now.seen - before.signals.get(name, -now.seen) <= REPEATED_WITHIN]
        if again:
            way = "higher" if again[0].endswith("+") else "lower"
            repeated.append((place, f"{WATCHED[place]}* of tiles comes out {way} than the controller expects, again"))
        charts[place] = ChartState(now, {**before.signals, **dict.fromkeys(found, now.seen)})
        signals += [f"{WATCHED[place]}:{name}" for name in found]
        signals += [f"{WATCHED[place]}:rule{rule}" for rule in said.rules]
    return tuple(signals), repeated


def quiet(state: PressState, place: int) -> bool:
    """Whether a value's charts have been without a signal for long enough to call it in order."""
    chart = state.charts[place]
    return all(chart.watch.seen - at > REPEATED_WITHIN for at in chart.signals.values())


def follow_corrections(
    state: PressState,
    run_id: int,
    made: Sequence[tuple[int, Float64Array]],
    begun: Float64Array,
    *,
    now_s: float,
    in_use: bool,
) -> PressState | None:
    """Tell the controller of corrections of a run that it doesn't know, in order.

    Parameters
    ----------
    state
        The press.
    run_id
        The run.
    made
        Its corrections, rising: number, and the state of the press that it was made for.
    begun
        The state that the job's own conversion was made for.
    now_s
        The time, by the controller's clock.
    in_use
        Whether it is this run that is being printed: then the last correction told of must be its last.

    Returns
    -------
    PressState or None
        The press from now on; ``None`` if there is nothing new.
    """
    known = [number for number, _ in state.control.corrections]
    wanted = [(control_number(run_id, number), mean) for number, mean in ((0, begun), *made)]
    # The controller forgets the oldest: what comes before the newest that it knows of a run was told, and is let be.
    newest = max((number for number in known if number // RUN_NUMBERS == run_id), default=-1)
    missing = [(number, mean) for number, mean in wanted if number > newest][-_TOLD_AT_ONCE:]
    if not missing and in_use and known[-1] != wanted[-1][0]:
        missing = wanted[-1:]
    if not missing:
        return None
    control = state.control
    for number, mean in missing:
        control, _ = step(control, CorrectionApplied(number, now_s, mean))
    if known[-1] // RUN_NUMBERS != run_id:
        # Another run's conversion is no correction: what is known of the press already need not wait for its turn.
        control = replace(control, corrected_s=state.control.corrected_s, tiles_since=min(control.tiles, 1))
    return replace(state, control=control)
