"""Power is lost at every sync of the journal, and between: what was promised is there, and nothing half-done is."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from sqlalchemy import select

from tests.power_loss import WAYS, Event, Recorder, Unreachable
from tilefab.control.ledger import OPEN, TRANSITIONS, ArmState, FaceQueue
from tilefab.io.journal import ArmChange, Journal, RunFacts, sqlite_url
from tilefab.io.journal_schema import metadata

LINE = "line 1"
FACES = 40
Everything = dict[str, list[tuple[object, ...]]]


def ticking() -> Callable[[], datetime]:
    """A clock that goes on by a second whenever it is read."""
    moment = datetime(2026, 1, 1, tzinfo=UTC)

    def now() -> datetime:
        nonlocal moment
        moment += timedelta(seconds=1)
        return moment

    return now


def everything(journal: Journal) -> Everything:
    """Every row of a journal."""
    with journal._store.transaction("look") as connection:
        return {
            table.name: [tuple(row) for row in connection.execute(select(table).order_by(*table.primary_key))]
            for table in metadata.sorted_tables
        }


@dataclass(frozen=True)
class Promise:
    """What a journal held once a call had returned.

    Attributes
    ----------
    after
        How many events had been recorded by then.
    content
        All that it held.
    arm, session
        Highest that were handed out.
    """

    after: int
    content: Everything = field(repr=False)
    arm: int
    session: int


class Life:
    """A journal's life under a recorder, of random calls."""

    def __init__(self, folder: Path, seed: int, *, synchronous: str = "FULL") -> None:
        self._synchronous = synchronous
        self.path = folder / "journal.sqlite"
        self.chance = random.Random(seed)
        self.recorder = Recorder(folder)
        self.promises: list[Promise] = []
        self._now = ticking()
        self._jobs = self.session = 0

    def live(self, calls: int) -> None:
        """Open the journal, and use it."""
        with self.recorder.recording():
            self.journal = self._open()
            try:
                self._promise()
                for _ in range(calls):
                    self._call()
                    self._promise()
            finally:
                self.journal.close()

    def _open(self) -> Journal:
        journal = Journal.open(sqlite_url(self.path), line=LINE, now=self._now)
        if self.chance.random() < 0.7:
            # Checkpoints come within a few calls, not after thousands.
            journal._store._driver().execute("PRAGMA wal_autocheckpoint = 12").fetchall()
        if self._synchronous != "FULL":
            journal._store._driver().execute(f"PRAGMA synchronous = {self._synchronous}").fetchall()
        return journal

    def _promise(self) -> None:
        after = len(self.recorder.events)
        self.promises.append(Promise(after, everything(self.journal), self.journal.last_arm(), self.session))

    def _call(self) -> None:
        journal, chance = self.journal, self.chance
        run_id = journal.start_run(RunFacts(f"job {self._jobs}", "a job", "job.toml", FACES, 7, "map"))
        self._promise()
        states = journal.face_states(run_id)
        under_way = journal.arms(run_id, states=OPEN)
        kind = chance.choices(
            ["intend", "mark", "note", "session", "operator", "finish", "reopen"], [6, 9, 1, 1, 2, 1, 1]
        )[0]
        if kind == "intend" and len(under_way) < 12:
            journal.intend(run_id, FaceQueue(states).take(chance.randint(1, 8)))
        elif kind == "mark" and under_way:
            chosen = chance.sample(under_way, chance.randint(1, min(8, len(under_way))))
            changes = [
                ArmChange(arm.arm_id, chance.choice(sorted(TRANSITIONS[arm.state])), tile_seq=arm.arm_id, reason="why")
                for arm in chosen
            ]
            journal.mark(changes)
        elif kind == "note":
            journal.note("event", text="x" * chance.randint(0, 9000))
        elif kind == "session":
            self.session = journal.begin_session()
        elif kind == "operator":
            doubts = [face for face, _, state in states.unsettled if state is ArmState.IN_DOUBT]
            done = journal.arms(run_id, states=[ArmState.PASSED, ArmState.DIVERTED, ArmState.PARTIAL])
            settled = {arm.face for arm in journal.arms(run_id, last=1)} | {face for face, _, _ in states.unsettled}
            again = [arm.face for arm in done if arm.face not in settled | {face for face, _ in states.unprinted}]
            if doubts:
                journal.settle(run_id, doubts[0], chance.choice(sorted(TRANSITIONS[ArmState.IN_DOUBT])))
            elif again:
                journal.order_reprint(run_id, again[0])
        elif kind == "finish" and not under_way:
            journal.finish_run(run_id, abandoned=True)
            self._jobs += 1
        elif kind == "reopen":
            journal.close()
            self.journal = self._open()


def cuts(events: list[Event], chance: random.Random) -> Iterator[tuple[int, str]]:
    """How many events happen, and what is left of the rest: before each sync in each way, after it, and between."""
    for number, event in enumerate(events):
        if event.kind.startswith("sync"):
            yield from ((number, way) for way in WAYS)
            yield number + 1, "none"
        elif chance.random() < 0.1:
            yield number, chance.choice(WAYS)


@dataclass
class Tally:
    """What a proof went through."""

    cases: int = 0
    at_risk: int = 0
    kinds: Counter[str] = field(default_factory=Counter)


def lose_power(life: Life, image: Path, cut: tuple[int, str], seed: int, tally: Tally) -> None:
    """Lose power once, open what is left, and hold it against what was promised."""
    at, way = cut
    chance = random.Random(seed)
    disk = life.recorder.disk()
    for event in life.recorder.events[:at]:
        disk.apply(event)
    image.mkdir()
    for path, content in disk.after_power_loss(way, chance).items():
        (image / Path(path).name).write_bytes(content)
    if chance.random() < 0.3:
        # The shared memory is never synced: anything may stand there.
        (image / "journal.sqlite-shm").write_bytes(chance.randbytes(32768))
    kept = [promise for promise in life.promises if promise.after <= at]
    begun = life.promises[len(kept) : len(kept) + 1]
    allowed = [promise.content for promise in (kept[-1:] + begun)]
    with Journal.open(sqlite_url(image / "journal.sqlite"), line=LINE) as journal:
        journal.check()
        found = everything(journal)
        where = f"power lost at event {at} ({way}, seed {seed})"
        assert found in allowed, f"{where}: neither what was promised nor what was being done"
        if kept:
            assert journal.begin_session() > kept[-1].session, f"{where}: a session comes twice"
            run_id = journal.start_run(RunFacts("another", "another", "job.toml", 3, 7, "map"))
            faces = FaceQueue(journal.face_states(run_id)).take(2)
            assert journal.intend(run_id, faces)[0].arm_id > kept[-1].arm, f"{where}: an arm comes twice"
    tally.cases += 1
    tally.at_risk += disk.unsynced() > 0
    tally.kinds[way] += 1
    tally.kinds["kept what was promised" if kept and found == kept[-1].content else "also kept what was begun"] += 1


def prove(folder: Path, cases: int, *, seed: int, calls: int) -> Tally:
    """Lose power in ``cases`` ways, in as many lives as that takes; every other life goes on from what one left."""
    tally = Tally()
    left: Path | None = None
    number = 0
    while tally.cases < cases:
        home = folder / f"life{number}"
        if left is None:
            home.mkdir()
        else:
            left.rename(home)
            left = None
        life = Life(home, seed + number)
        life.live(calls)
        chance = random.Random(seed + number)
        wanted = list(cuts(life.recorder.events, chance))
        if len(wanted) > cases - tally.cases:
            wanted = sorted(chance.sample(wanted, cases - tally.cases))
        for case, cut in enumerate(wanted):
            image = folder / f"image{number}-{case}"
            lose_power(life, image, cut, chance.getrandbits(32), tally)
            if number % 2 == 0 and case == len(wanted) * 2 // 3:
                left = image
                continue
            for path in image.iterdir():
                path.unlink()
            image.rmdir()
        number += 1
    return tally


def test_power_lost_at_syncs_and_between(tmp_path: Path) -> None:
    try:
        tally = prove(tmp_path, 60, seed=5, calls=14)
    except Unreachable as reason:
        pytest.skip(f"power loss can't be tried: {reason}")
    assert tally.cases == 60
    assert tally.at_risk > 20
    assert set(WAYS) <= set(tally.kinds)


def test_the_proof_finds_a_journal_that_does_not_sync_its_commits(tmp_path: Path) -> None:
    home = tmp_path / "home"
    home.mkdir()
    life = Life(home, 5, synchronous="NORMAL")
    try:
        life.live(6)
    except Unreachable as reason:
        pytest.skip(f"power loss can't be tried: {reason}")
    # A checkpoint, or closing the journal, syncs what the commits before didn't: not every moment gives it away.

    def lose_all() -> None:
        for number, promise in enumerate(life.promises):
            lose_power(life, tmp_path / f"image{number}", (promise.after, "none"), 1, Tally())

    with pytest.raises(AssertionError, match="neither what was promised"):
        lose_all()
