"""The loop of colour: what tiles say goes to the controller of their press, what that proposes to the line's daemon."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from tilefab.control.drift_control_state import ControlSettings
from tilefab.control.drift_events import Event, Tick
from tilefab.errors import TilefabError
from tilefab.io.inspection_records import InnovationRecord
from tilefab.io.inspection_store import InspectionStore
from tilefab.io.journal import RunRecord
from tilefab.pipeline.inspection.alarm_desk import AlarmDesk
from tilefab.pipeline.inspection.benches import OPEN_AT_ONCE, Bench, Benches
from tilefab.pipeline.inspection.correcting import Learnt, follow_corrections, learn, quiet
from tilefab.pipeline.inspection.line_journal import LineJournal
from tilefab.pipeline.inspection.messages import Answer, Daemon, Messages
from tilefab.pipeline.inspection.remembering import PressState, press_name, press_state

TOPIC = "correction"

_TICK_S = 30.0
"""Of the line's clock."""

_REFUSALS = 3
_OVER = "the run is over"
_ONLY_TOLD = "it is only told: [inspection] says correct = false"


@dataclass(frozen=True)
class LoopSettings:
    """How the loop is closed.

    Attributes
    ----------
    control
        The controller's settings.
    correct
        Whether proposals go to the daemon.
    clock_rate
        Seconds of the controller's clock to one on the wall.
    """

    control: ControlSettings
    correct: bool = True
    clock_rate: float = 1.0


class ColourLoop:
    """Keeps the state of every press, and what came of proposals.

    Parameters
    ----------
    settings
        How.
    store
        Where states and proposals are kept.
    journal
        Tells what is being printed, and with which corrections.
    benches
        Of the runs.
    daemon, messages
        Who corrects, and how he is asked.
    alarms, log
        Who is told.
    """

    def __init__(
        self,
        settings: LoopSettings,
        store: InspectionStore,
        journal: LineJournal,
        benches: Benches,
        daemon: Daemon,
        messages: Messages,
        alarms: AlarmDesk,
        log: Callable[..., None],
    ) -> None:
        self._settings, self._store, self._journal, self._benches = settings, store, journal, benches
        self._daemon, self._messages, self._alarms, self._log = daemon, messages, alarms, log
        self._presses: dict[str, PressState] = {}
        self._ticked_s: float | None = None
        self._ticked_at: datetime | None = None
        self._refused = 0

    def seconds(self, at: datetime) -> float:
        """A time by the controller's clock."""
        return at.timestamp() * self._settings.clock_rate

    def press(self, bench: Bench, now: datetime) -> PressState:
        """How a press drifts, as far as is known."""
        found = self._presses.get(bench.press)
        if found is not None:
            return found
        text = self._store.remembered(press_name(bench.press))
        state: PressState | None = None
        if text is not None:
            try:
                state = press_state(text, self._settings.control)
            except ValueError as error:
                self._log("press forgotten", press=bench.press, why=str(error))
        if state is None:
            state = PressState(bench.start(self.seconds(now), self._settings.control))
        self._presses[bench.press] = state
        return state

    def learnt(self, bench: Bench, events: Sequence[Event], now: datetime) -> Learnt:
        """What the controller makes of events; nothing is changed before `keep`."""
        return learn(self.press(bench, now), events)

    def keep(self, bench: Bench, run_id: int, learnt: Learnt, at: datetime, inspection_id: int | None = None) -> None:
        """Put down what the controller made of events, within the caller's transaction.

        Parameters
        ----------
        bench, run_id
            Of the tile, or of the run that is being printed.
        learnt
            What came of them.
        at
            When the tile was fired.
        inspection_id
            The tile's.
        """
        for charted in learnt.innovations:
            found = charted.innovation
            lightness, redness, yellowness = found.values
            values = (lightness, redness, yellowness)
            record = InnovationRecord(
                run_id, at, found.surprise, values, found.accepted, charted.signals, inspection_id
            )
            self._store.add_innovation(record)
        for hold in learnt.holds:
            text = f"colours are not corrected at present: {hold.text}"
            self._alarms.raise_alarm("colour_held", text, subject=hold.code.value, run_id=run_id)
        for release in learnt.releases:
            self._alarms.clear("colour_held", release.code.value)
        for place, text in learnt.drifting:
            self._alarms.raise_alarm("colour_signal", text, subject=str(place), run_id=run_id)
        for subject in self._alarms.subjects("colour_signal"):
            if quiet(learnt.state, int(subject)):
                self._alarms.clear("colour_signal", subject)
        for step in learnt.steps:
            self._log("step", run=run_id, text=step.text, change=round(step.change, 2))
        for ignored in learnt.ignored:
            self._log("not learnt from", run=run_id, text=ignored.text)
        if learnt.proposal is not None:
            self._propose(bench, learnt)
        self._remember(bench, learnt.state)

    def _remember(self, bench: Bench, state: PressState) -> None:
        self._presses[bench.press] = state
        self._store.remember(press_name(bench.press), state.text())

    def _propose(self, bench: Bench, learnt: Learnt) -> None:
        run, proposal = self._journal.present, learnt.proposal
        if run is None or proposal is None or run.finished_at is not None:
            # After the last face tiles go on leaving the kiln: learnt from for the next run, but nothing is printed.
            return
        present = self._benches.opened(run.run_id)
        if present is None or present.press != bench.press:
            # Tiles of a press that prints nothing at present.
            return
        note = f"run {run.run_id} of {run.facts.name:.200}: {proposal.reason}"
        number = self._store.propose(
            run.run_id, proposal.reason, bench.drift(proposal, learnt.state.control.tiles, note)
        )
        if not self._settings.correct:
            self._store.answer(number, number=None, answer=_ONLY_TOLD)
        self._log("proposal", run=run.run_id, number=number, reason=proposal.reason, change=round(proposal.change, 3))

    def follow(self, now: datetime, now_s: float) -> None:
        """Tell the controllers which corrections are in use, now that the journal was read; ``now_s`` never jumps."""
        present = self._journal.present
        if self._refused and (present is None or present.finished_at is not None):
            self._refused = 0
            self._alarms.clear("correction_refused")
        for run_id in self._journal.expected.runs[-OPEN_AT_ONCE:]:
            run = self._journal.runs.get(run_id)
            bench = None if run is None else self._benches.of(run, now_s)
            if run is None or bench is None or not bench.press:
                continue
            try:
                made = [(record.number, bench.state(record)) for record in self._journal.corrections(run_id)]
            except TilefabError as error:
                self._log("correction unknown", run=run_id, why=error.message)
                continue
            state = follow_corrections(
                self.press(bench, now),
                run_id,
                made,
                bench.begun,
                now_s=self.seconds(now),
                in_use=run == present,
            )
            if state is not None:
                self._remember(bench, state)
                self._log("corrections in use", run=run_id, number=made[-1][0] if made else 0)

    def tick(self, now: datetime, now_s: float) -> None:
        """Let time pass for the press that is being printed on."""
        period_s = _TICK_S / self._settings.clock_rate
        if self._ticked_s is not None and now_s - self._ticked_s < period_s:
            return
        before, self._ticked_at, self._ticked_s = self._ticked_at, now, now_s
        found = self.present_bench(now_s)
        if found is None or before is None:
            return
        run, bench = found
        firing = self._journal.expected.leaving(before, now) > 0
        learnt = self.learnt(bench, [Tick(self.seconds(now), firing)], now)
        with self._store.together("tick"):
            self.keep(bench, run.run_id, learnt, now)

    def send(self) -> None:
        """Post the newest proposal without an answer; those before it were overtaken."""
        if self._messages.busy(TOPIC):
            return
        waiting = self._store.proposals(unanswered=True)
        if not waiting:
            return
        for old in waiting[:-1]:
            self._store.answer(old.proposal_id, number=None, answer="it was overtaken by the next")
        newest, daemon = waiting[-1], self._daemon
        run = self._journal.runs.get(newest.run_id)
        if run is not None and run.finished_at is not None:
            self._store.answer(newest.proposal_id, number=None, answer=_OVER)
            return
        drift = json.loads(newest.drift)

        def correct() -> int:
            return daemon.correct(newest.run_id, drift, newest.reason)

        self._messages.send(TOPIC, newest.proposal_id, correct)

    def answered(self, answer: Answer) -> None:
        """Take in what the daemon said to a proposal. That it is in use is learnt from the journal."""
        self._store.answer(answer.number, number=answer.result, answer=answer.error)
        self._log("correction", proposal=answer.number, number=answer.result, why=answer.error)
        if not answer.error:
            self._refused = 0
            self._alarms.clear("correction_refused")
            for old in self._store.proposals(unanswered=True):
                # Made while the map was made, of what was known before this correction.
                self._store.answer(old.proposal_id, number=None, answer=f"overtaken by correction {answer.result}")
            return
        present = self._journal.present
        if present is None or present.finished_at is not None:
            # The run came to its end meanwhile: there was nothing left to correct.
            return
        self._refused += 1
        if self._refused >= _REFUSALS:
            text = f"{self._refused} corrections in a row were not taken; the last one: {answer.error}"
            self._alarms.raise_alarm("correction_refused", text)

    def present_bench(self, now_s: float) -> tuple[RunRecord, Bench] | None:
        """The run that is being printed, with its bench, if it has one whose press can be followed."""
        run = self._journal.present
        bench = None if run is None else self._benches.of(run, now_s)
        return None if run is None or bench is None or not bench.press else (run, bench)
