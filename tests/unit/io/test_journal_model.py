"""Random lives of a journal beside a plain model of it: killed, reopened, used by an operator."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tilefab.control.ledger import FINAL, OPEN, UNSETTLED, ArmState, FaceQueue
from tilefab.errors import JournalError
from tilefab.io.journal import ArmChange, Journal, RunFacts, sqlite_url

LINE = "line 1"
FACES = 6
JOBS = ("marble", "slate")
WAYS = {
    ArmState.INTENT: {"armed", "unprinted", "in_doubt", "printed", "partial"},
    ArmState.ARMED: {"printed", "partial", "unprinted", "in_doubt"},
    ArmState.PRINTED: {"passed", "diverted", "in_doubt"},
}
SETTLED = {"passed", "diverted", "unprinted"}


def facts(job: str) -> RunFacts:
    return RunFacts(job_hash=job, name=job, job_file=f"{job}.toml", faces=FACES, seed=1, map_hash="map")


@dataclass
class Arm:
    run: int
    face: int
    state: ArmState
    tile: int | None = None
    correction: int = 0


class JournalModel(RuleBasedStateMachine):
    """The model: arms by number, orders by face, and the last numbers given."""

    @initialize()
    def begin(self) -> None:
        self.home = Path(tempfile.mkdtemp(prefix="tilefab-model-"))
        self.generation = 0
        self.path = self.home / "0" / "journal.sqlite"
        self.path.parent.mkdir()
        self.journal = Journal.open(sqlite_url(self.path), line=LINE)
        self.arms: dict[int, Arm] = {}
        self.runs: dict[int, str] = {}
        self.finished: set[int] = set()
        self.orders: set[tuple[int, int]] = set()
        self.corrections: dict[int, int] = {}
        self.session = self.last_arm = 0
        self.notes: list[int] = []

    def teardown(self) -> None:
        if hasattr(self, "journal"):
            self.journal.close()
            shutil.rmtree(self.home)

    def attempts(self, run: int, face: int) -> list[Arm]:
        return [arm for arm in self.arms.values() if (arm.run, arm.face) == (run, face)]

    def wanted(self, run: int, face: int) -> bool:
        """Whether a face is to be printed: never printed, or an order is open."""
        attempts = self.attempts(run, face)
        if not attempts or attempts[-1].state is ArmState.UNPRINTED:
            return True
        return attempts[-1].state not in UNSETTLED and (run, face) in self.orders

    @rule(job=st.sampled_from(JOBS))
    def start(self, job: str) -> None:
        known = [number for number, name in self.runs.items() if name == job]
        over = bool(self.finished & set(known)) and not any(self.wanted(known[0], face) for face in range(FACES))
        try:
            run = self.journal.start_run(facts(job))
        except JournalError:
            assert over
            return
        assert not over
        assert [run] == known if known else run not in self.runs
        self.runs[run] = job
        self.finished.discard(run)

    @rule(data=st.data(), many=st.integers(1, 4))
    def intend_from_the_queue(self, data: st.DataObject, many: int) -> None:
        run = self.some_run(data)
        if run is None or run in self.finished:
            return
        faces = FaceQueue(self.journal.face_states(run)).take(many)
        assert all(self.wanted(run, face) for face, _ in faces)
        assert len(faces) == min(many, sum(self.wanted(run, face) for face in range(FACES)))
        correction = data.draw(st.integers(0, self.corrections.get(run, 0)))
        for intent in self.journal.intend(run, faces, correction=correction):
            assert intent.arm_id > self.last_arm
            assert intent.attempt == len(self.attempts(run, intent.face)) + 1
            self.last_arm = intent.arm_id
            self.arms[intent.arm_id] = Arm(run, intent.face, ArmState.INTENT, correction=correction)
            # An order is served from now on; only a face that wasn't printed keeps coming.
            self.orders.discard((run, intent.face))

    @rule(data=st.data())
    def correct(self, data: st.DataObject) -> None:
        run = self.some_run(data)
        if run is None:
            return
        try:
            record = self.journal.correct(run, press_key="key", drift="{}", reason="why")
        except JournalError:
            assert run in self.finished
            return
        assert run not in self.finished
        self.corrections[run] = self.corrections.get(run, 0) + 1
        assert (record.run_id, record.number) == (run, self.corrections[run])
        assert self.journal.latest_correction(run) == record

    @rule(data=st.data(), face=st.integers(-1, FACES), attempt=st.integers(1, 3), correction=st.integers(0, 2))
    def intend_anything(self, data: st.DataObject, face: int, attempt: int, correction: int) -> None:
        run = self.some_run(data)
        if run is None:
            return
        right = 0 <= face < FACES and run not in self.finished and self.wanted(run, face)
        right = right and attempt == len(self.attempts(run, face)) + 1
        right = right and correction <= self.corrections.get(run, 0)
        try:
            (intent,) = self.journal.intend(run, [(face, attempt)], correction=correction)
        except JournalError:
            assert not right
            return
        assert right
        assert intent.arm_id > self.last_arm
        self.last_arm = intent.arm_id
        self.arms[intent.arm_id] = Arm(run, face, ArmState.INTENT, correction=correction)
        self.orders.discard((run, face))

    @rule(data=st.data())
    def mark(self, data: st.DataObject) -> None:
        if not self.arms:
            return
        number = data.draw(st.sampled_from(sorted(self.arms)))
        chosen = data.draw(st.lists(st.tuples(st.just(number), st.sampled_from(ArmState)), min_size=1, max_size=3))
        after = self.arms[number].state
        right = True
        for _, new in chosen:
            right = right and (new.value in WAYS.get(after, ()) or (new is after and after in UNSETTLED))
            after = new
        changes = [ArmChange(arm, new, tile_seq=arm) for arm, new in chosen]
        if not right:
            with pytest.raises(JournalError):
                self.journal.mark(changes)
            return
        self.journal.mark(changes)
        self.arms[number].state, self.arms[number].tile = after, number

    @rule(data=st.data(), face=st.integers(0, FACES - 1))
    def order_reprint(self, data: st.DataObject, face: int) -> None:
        run = self.some_run(data)
        if run is None:
            return
        attempts = self.attempts(run, face)
        right = bool(attempts) and attempts[-1].state in FINAL - {ArmState.UNPRINTED}
        try:
            attempt = self.journal.order_reprint(run, face)
        except JournalError:
            assert not right
            return
        assert right
        assert attempt == len(attempts) + 1
        if (run, face) not in self.orders:
            self.finished.discard(run)
        self.orders.add((run, face))

    @rule(data=st.data(), face=st.integers(0, FACES - 1), state=st.sampled_from(ArmState))
    def settle(self, data: st.DataObject, face: int, state: ArmState) -> None:
        run = self.some_run(data)
        if run is None:
            return
        attempts = self.attempts(run, face)
        right = bool(attempts) and attempts[-1].state is ArmState.IN_DOUBT and state.value in SETTLED
        try:
            record = self.journal.settle(run, face, state)
        except JournalError:
            assert not right
            return
        assert right
        assert record.state is state
        attempts[-1].state = state
        if state is ArmState.UNPRINTED:
            self.finished.discard(run)

    @rule(data=st.data(), abandoned=st.booleans())
    def finish(self, data: st.DataObject, abandoned: bool) -> None:
        run = self.some_run(data)
        if run is None:
            return
        still_open = any(arm.run == run and arm.state in OPEN for arm in self.arms.values())
        left = any(self.wanted(run, face) for face in range(FACES))
        right = run in self.finished or (not still_open and (abandoned or not left))
        try:
            self.journal.finish_run(run, abandoned=abandoned)
        except JournalError:
            assert not right
            return
        assert right
        self.finished.add(run)

    @rule(number=st.integers())
    def note(self, number: int) -> None:
        self.journal.note("number", number=str(number))
        self.notes.append(number)

    @rule()
    def begin_session(self) -> None:
        session = self.journal.begin_session()
        assert session > self.session
        self.session = session

    @rule()
    def reopen(self) -> None:
        self.journal.close()
        self.journal = Journal.open(sqlite_url(self.path), line=LINE)

    @rule()
    def kill(self) -> None:
        """What a killed process leaves are its files as they stand: nothing is closed."""
        self.generation += 1
        after = self.home / str(self.generation) / "journal.sqlite"
        after.parent.mkdir()
        for suffix in ("", "-wal"):
            if self.path.with_name(self.path.name + suffix).exists():
                shutil.copy(self.path.with_name(self.path.name + suffix), after.with_name(after.name + suffix))
        self.journal.close()
        self.path = after
        self.journal = Journal.open(sqlite_url(self.path), line=LINE)

    @invariant()
    def same_as_the_model(self) -> None:
        if not hasattr(self, "journal"):
            return
        found = {record.arm_id: record for record in self.journal.arms()}
        assert {
            number: Arm(arm.run_id, arm.face, arm.state, arm.tile_seq, arm.correction) for number, arm in found.items()
        } == self.arms
        assert [run.run_id for run in self.journal.runs() if run.finished_at is not None] == sorted(self.finished)
        assert self.journal.last_arm() == self.last_arm
        assert [
            int(str(note.detail["number"])) for note in self.journal.notes() if note.kind == "number"
        ] == self.notes[-50:]
        assert [run.correction for run in self.journal.runs()] == [
            self.corrections.get(run, 0) for run in sorted(self.runs)
        ]
        for run in self.runs:
            states = self.journal.face_states(run)
            assert FaceQueue(states).remaining == sum(self.wanted(run, face) for face in range(FACES))
            of_run = [arm.state for arm in self.arms.values() if arm.run == run]
            assert self.journal.counts(run) == {state: of_run.count(state) for state in ArmState}

    @invariant()
    def no_face_is_printed_twice_by_itself(self) -> None:
        if not hasattr(self, "journal"):
            return
        served: set[tuple[int, int, int | None]] = set()
        for arm in self.journal.arms():
            if arm.state is not ArmState.UNPRINTED:
                assert (arm.run_id, arm.face, arm.reprint) not in served
                served.add((arm.run_id, arm.face, arm.reprint))

    def some_run(self, data: st.DataObject) -> int | None:
        return data.draw(st.sampled_from(sorted(self.runs))) if self.runs else None


JournalModel.TestCase.settings = settings(max_examples=40, stateful_step_count=30, deadline=None)
TestJournalModel = JournalModel.TestCase
