"""The journal's promises, in SQLite and in PostgreSQL: numbers, ledger, queue, notes."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import create_engine, text

from tests import postgres_server
from tilefab.control.ledger import MOST_FACES, OPEN, ArmState, FaceQueue, FaceStates
from tilefab.errors import JournalError
from tilefab.io import journal_base
from tilefab.io.journal import ArmChange, Intent, Journal, RunFacts, sqlite_url
from tilefab.io.journal_schema import metadata
from tilefab.io.journal_store import Store

NO_SERVER = postgres_server.missing()
LINE = "line 1"
FACTS = RunFacts(job_hash="ab" * 32, name="a job", job_file="/jobs/a.toml", faces=20, seed=7, map_hash="cd" * 32)
ROUTES = {
    ArmState.INTENT: (),
    ArmState.ARMED: (ArmState.ARMED,),
    ArmState.PRINTED: (ArmState.ARMED, ArmState.PRINTED),
    ArmState.PASSED: (ArmState.ARMED, ArmState.PRINTED, ArmState.PASSED),
    ArmState.DIVERTED: (ArmState.PRINTED, ArmState.DIVERTED),
    ArmState.PARTIAL: (ArmState.PARTIAL,),
    ArmState.UNPRINTED: (ArmState.UNPRINTED,),
    ArmState.IN_DOUBT: (ArmState.PRINTED, ArmState.IN_DOUBT),
}


@pytest.fixture(scope="module")
def postgres() -> Iterator[str]:
    with postgres_server.serving() as url:
        yield url


@pytest.fixture(params=["sqlite"] if NO_SERVER else ["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a database that is still empty."""
    if request.param == "sqlite":
        return sqlite_url(tmp_path / "journal.sqlite")
    server: str = request.getfixturevalue("postgres")
    name = f"journal_{uuid.uuid4().hex}"
    engine = create_engine(server.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    with engine.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    engine.dispose()
    return f"{server}&dbname={name}"


@pytest.fixture
def journal(url: str) -> Iterator[Journal]:
    with Journal.open(url, line=LINE) as opened:
        yield opened


def bring(journal: Journal, arm: Intent, state: ArmState) -> None:
    """Bring an arm from intent to a state."""
    journal.mark([ArmChange(arm.arm_id, step) for step in ROUTES[state]])


@pytest.mark.skipif(bool(NO_SERVER), reason=f"the journal is tried on SQLite only: {NO_SERVER}")
def test_all_of_this_is_tried_on_postgresql_too(postgres: str) -> None:
    assert postgres.startswith("postgresql://")


def test_sessions_rise_and_outlive_the_daemon(url: str) -> None:
    with Journal.open(url, line=LINE) as journal:
        assert [journal.begin_session(), journal.begin_session()] == [1, 2]
        assert journal.begin_session(above=40) == 41
    with Journal.open(url, line=LINE) as journal:
        assert journal.begin_session(above=3) == 42


def test_sessions_stay_within_32_bits(journal: Journal) -> None:
    assert journal.begin_session(above=(1 << 32) - 2) == (1 << 32) - 1
    with pytest.raises(JournalError, match="32 bits"):
        journal.begin_session()


def test_an_unfinished_run_is_gone_on_with(url: str) -> None:
    with Journal.open(url, line=LINE) as journal:
        run_id = journal.start_run(FACTS)
        other = journal.start_run(replace(FACTS, job_hash="other"))
        assert journal.start_run(replace(FACTS, job_file="/moved/a.toml")) == run_id != other
    with Journal.open(url, line=LINE) as journal:
        assert journal.start_run(FACTS) == run_id
        assert [run.run_id for run in journal.runs()] == [run_id, other]
        journal.finish_run(run_id, abandoned=True)
        journal.finish_run(run_id)
        assert journal.start_run(FACTS) == run_id
        assert [run.finished_at is None for run in journal.runs()] == [True, True]
        assert journal.runs()[0].facts == FACTS


def test_a_job_is_never_begun_a_second_time(journal: Journal) -> None:
    run_id = journal.start_run(replace(FACTS, faces=1))
    bring(journal, journal.intend(run_id, [(0, 1)])[0], ArmState.PASSED)
    journal.finish_run(run_id)
    with pytest.raises(JournalError, match="printed all 1 faces"):
        journal.start_run(replace(FACTS, faces=1))
    assert journal.runs()[0].finished_at is not None


def test_more_faces_go_on_behind_the_last(journal: Journal) -> None:
    run_id = journal.start_run(replace(FACTS, faces=1))
    bring(journal, journal.intend(run_id, [(0, 1)])[0], ArmState.PASSED)
    journal.finish_run(run_id)
    assert journal.start_run(replace(FACTS, faces=3)) == run_id
    assert FaceQueue(journal.face_states(run_id)).take(5) == [(1, 1), (2, 1)]


@pytest.mark.parametrize("change", [{"map_hash": "other"}, {"faces": 19}, {"seed": 8}])
def test_a_run_does_not_go_on_with_other_faces(journal: Journal, change: dict[str, Any]) -> None:
    journal.start_run(FACTS)
    with pytest.raises(JournalError, match=next(iter(change))):
        journal.start_run(replace(FACTS, **change))


@pytest.mark.parametrize("change", [{"faces": 0}, {"faces": MOST_FACES + 1}, {"seed": -1}, {"seed": 1 << 63}])
def test_runs_that_cannot_be_are_refused(journal: Journal, change: dict[str, Any]) -> None:
    with pytest.raises(JournalError, match="can't be"):
        journal.start_run(replace(FACTS, **change))


def test_arms_rise_over_all_runs_and_are_never_used_again(url: str) -> None:
    with Journal.open(url, line=LINE) as journal:
        first, second = journal.start_run(FACTS), journal.start_run(replace(FACTS, job_hash="other"))
        given = journal.intend(first, [(5, 1), (2, 1)]) + journal.intend(second, [(5, 1)])
        assert given == [Intent(1, first, 5, 1), Intent(2, first, 2, 1), Intent(3, second, 5, 1)]
        assert journal.last_arm() == 3
        with journal._store.transaction("forget") as connection:
            connection.execute(text("DELETE FROM arms"))
    with Journal.open(url, line=LINE) as journal:
        assert journal.intend(first, [(0, 1)])[0].arm_id == 4
        journal.skip_arms(99)
        journal.skip_arms(9)
        assert journal.intend(first, [(1, 1)])[0].arm_id == 100


def test_nothing_is_intended_where_nothing_is_asked(journal: Journal) -> None:
    assert journal.intend(journal.start_run(FACTS), []) == []
    journal.mark([])
    assert journal.last_arm() == 0


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([(3, 1), (0, 1)], "next attempt is 2, not 1"),
        ([(3, 1), (0, 2)], "no reprint was ordered"),
        ([(3, 2)], "next attempt is 1, not 2"),
        ([(3, 1), (3, 1)], "twice at once"),
        ([(20, 1)], "isn't one of its 20 faces"),
        ([(-1, 1)], "isn't one of its 20 faces"),
    ],
)
@pytest.mark.parametrize("state", sorted(set(ArmState) - {ArmState.UNPRINTED}))
def test_faces_that_are_not_to_be_printed_are_refused_as_a_whole(
    journal: Journal, faces: list[tuple[int, int]], message: str, state: ArmState
) -> None:
    run_id = journal.start_run(FACTS)
    bring(journal, journal.intend(run_id, [(0, 1)])[0], state)
    with pytest.raises(JournalError, match=message):
        journal.intend(run_id, faces)
    assert len(journal.arms()) == 1
    assert journal.last_arm() == 1
    assert sum(journal.counts(run_id).values()) == 1


def test_a_finished_or_unknown_run_intends_nothing(journal: Journal) -> None:
    run_id = journal.start_run(FACTS)
    journal.finish_run(run_id, abandoned=True)
    with pytest.raises(JournalError, match="is finished"):
        journal.intend(run_id, [(0, 1)])
    with pytest.raises(JournalError, match="has no run 77"):
        journal.intend(77, [(0, 1)])


def test_marks_keep_facts_and_take_effect_in_order(url: str) -> None:
    moments = iter(datetime(2026, 3, 1, second=second, tzinfo=UTC) for second in range(60))
    with Journal.open(url, line=LINE, now=lambda: next(moments)) as journal:
        run_id = journal.start_run(FACTS)
        (arm,) = journal.intend(run_id, [(4, 1)])
        journal.mark([ArmChange(arm.arm_id, ArmState.ARMED, detect_seq=9, printer_boot=(1 << 32) - 1, reason="sent")])
        journal.mark([ArmChange(arm.arm_id, ArmState.ARMED, tile_seq=8, plc_boot=3)])
        journal.mark(
            [
                ArmChange(arm.arm_id, ArmState.PRINTED, rows_printed=100, data_crc32=0xDEADBEEF),
                ArmChange(arm.arm_id, ArmState.DIVERTED, reason="x" * 900),
            ]
        )
        (record,) = journal.arms()
    assert record.state is ArmState.DIVERTED
    assert (record.detect_seq, record.tile_seq, record.printer_boot, record.plc_boot) == (9, 8, (1 << 32) - 1, 3)
    assert (record.rows_printed, record.data_crc32, record.reason) == (100, 0xDEADBEEF, "x" * 500)
    assert record.intended_at == datetime(2026, 3, 1, second=1, tzinfo=UTC)
    assert record.changed_at == datetime(2026, 3, 1, second=5, tzinfo=UTC)


@pytest.mark.parametrize("state", sorted(set(ArmState) - OPEN))
def test_a_mark_that_is_not_allowed_changes_nothing(journal: Journal, state: ArmState) -> None:
    run_id = journal.start_run(FACTS)
    other, arm = journal.intend(run_id, [(0, 1), (1, 1)])
    bring(journal, arm, state)
    before = journal.arms(), journal.counts(run_id)
    for new in ArmState:
        if (state, new) == (ArmState.IN_DOUBT, ArmState.IN_DOUBT):
            continue
        with pytest.raises(JournalError, match=f"arm {arm.arm_id}"):
            journal.mark([ArmChange(other.arm_id, ArmState.ARMED), ArmChange(arm.arm_id, new)])
    with pytest.raises(JournalError, match="arm 55 isn't in the journal"):
        journal.mark([ArmChange(other.arm_id, ArmState.ARMED), ArmChange(55, ArmState.ARMED)])
    assert (journal.arms(), journal.counts(run_id)) == before


def test_arms_are_found_by_run_state_and_age(journal: Journal) -> None:
    first, second = journal.start_run(FACTS), journal.start_run(replace(FACTS, job_hash="other"))
    arms = journal.intend(first, [(face, 1) for face in range(4)]) + journal.intend(second, [(0, 1)])
    bring(journal, arms[0], ArmState.PASSED)
    bring(journal, arms[1], ArmState.ARMED)
    bring(journal, arms[2], ArmState.IN_DOUBT)

    def found(*arguments: int, **choice: object) -> list[int]:
        return [record.arm_id for record in journal.arms(*arguments, **choice)]  # type: ignore[arg-type]

    assert found() == [1, 2, 3, 4, 5]
    assert found(first) == [1, 2, 3, 4]
    assert found(states=OPEN) == [2, 4, 5]
    assert found(first, states=[ArmState.IN_DOUBT, ArmState.PASSED]) == [1, 3]
    assert found(last=2) == [4, 5]
    assert found(first, states=OPEN, last=1) == [4]
    assert found(states=[]) == []
    assert journal.counts(first) == {
        **dict.fromkeys(ArmState, 0),
        ArmState.PASSED: 1,
        ArmState.ARMED: 1,
        ArmState.IN_DOUBT: 1,
        ArmState.INTENT: 1,
    }


def test_a_face_that_was_not_printed_comes_again(journal: Journal) -> None:
    run_id = journal.start_run(FACTS)
    for attempt in (1, 2, 3):
        assert FaceQueue(journal.face_states(run_id)).take() == [(0, attempt)]
        bring(journal, journal.intend(run_id, [(0, attempt)])[0], ArmState.UNPRINTED)
    assert journal.face_states(run_id) == FaceStates(20, 1, unprinted=((0, 3),))
    journal.intend(run_id, [(0, 4)])
    assert journal.face_states(run_id) == FaceStates(20, 1, unsettled=((0, 4, ArmState.INTENT),))


def test_faces_left_out_are_gaps(journal: Journal) -> None:
    run_id = journal.start_run(replace(FACTS, faces=MOST_FACES))
    assert journal.face_states(run_id) == FaceStates(MOST_FACES)
    journal.intend(run_id, [(2, 1), (3, 1), (6, 1), (MOST_FACES - 1, 1)])
    states = journal.face_states(run_id)
    assert (states.next_new, states.gaps) == (MOST_FACES, ((0, 2), (4, 6), (7, MOST_FACES - 1)))
    assert FaceQueue(states).remaining == MOST_FACES - 4


def test_corrections_are_counted_by_run_and_outlive_the_daemon(url: str) -> None:
    times = iter(range(1, 100))
    clock = lambda: datetime(2026, 3, 1, second=next(times), tzinfo=UTC)  # noqa: E731
    with Journal.open(url, line=LINE, now=clock) as journal:
        first, second = journal.start_run(FACTS), journal.start_run(replace(FACTS, job_hash="other"))
        assert journal.latest_correction(first) is None
        made = [
            journal.correct(run, press_key=key, drift=drift, reason=reason)
            for run, key, drift, reason in (
                (first, "aa", "{}", "fired darker"),
                (second, "bb", "[]", "x" * 900),
                (first, "cc", "{1}", ""),
            )
        ]
        assert [(record.run_id, record.number) for record in made] == [(first, 1), (second, 1), (first, 2)]
        assert made[1].reason == "x" * 500
    with Journal.look(url, line=LINE) as journal:
        assert journal.corrections(first) == [made[0], made[2]]
        assert journal.corrections(first, [2, 7]) == [made[2]]
        assert journal.corrections(second, []) == []
        assert journal.latest_correction(first) == made[2]
        assert made[2].made_at == datetime(2026, 3, 1, second=5, tzinfo=UTC)
        assert [run.correction for run in journal.runs()] == [2, 1]
        with pytest.raises(JournalError, match="has no run 77"):
            journal.corrections(77)


def test_a_finished_or_unknown_run_is_not_corrected(journal: Journal) -> None:
    run_id = journal.start_run(FACTS)
    journal.finish_run(run_id, abandoned=True)
    with pytest.raises(JournalError, match="is finished"):
        journal.correct(run_id, press_key="aa", drift="{}", reason="")
    with pytest.raises(JournalError, match="has no run 77"):
        journal.correct(77, press_key="aa", drift="{}", reason="")
    assert journal.corrections(run_id) == []


def test_an_arm_is_of_the_correction_it_was_put_down_with(journal: Journal) -> None:
    run_id, other = journal.start_run(FACTS), journal.start_run(replace(FACTS, job_hash="other"))
    journal.correct(other, press_key="aa", drift="{}", reason="of another run")
    (plain,) = journal.intend(run_id, [(0, 1)])
    for number in (1, 7):
        with pytest.raises(JournalError, match=f"has no correction {number}"):
            journal.intend(run_id, [(1, 1)], correction=number)
    journal.correct(run_id, press_key="aa", drift="{}", reason="")
    assert journal.intend(run_id, [(1, 1), (2, 1)], correction=1) == [
        Intent(2, run_id, 1, 1, 1),
        Intent(3, run_id, 2, 1, 1),
    ]
    bring(journal, plain, ArmState.UNPRINTED)
    # A face that comes again comes with what is in use by then.
    journal.intend(run_id, [(0, 2)], correction=1)
    assert [(arm.face, arm.correction) for arm in journal.arms(run_id)] == [(0, 0), (1, 1), (2, 1), (0, 1)]
    latest = journal.arm_of(run_id, 0)
    assert latest is not None
    assert (latest.attempt, latest.correction) == (2, 1)
    assert journal.arm_of(run_id, 9) is None


def test_it_is_kept_when_faces_were_printed_and_passed(url: str) -> None:
    times = iter(range(1, 100))
    clock = lambda: datetime(2026, 3, 1, second=next(times), tzinfo=UTC)  # noqa: E731
    with Journal.open(url, line=LINE, now=clock) as journal:
        run_id = journal.start_run(FACTS)
        arms = journal.intend(run_id, [(face, 1) for face in range(5)])
        journal.mark([ArmChange(arms[0].arm_id, ArmState.PRINTED)])
        journal.mark([ArmChange(arms[0].arm_id, ArmState.PRINTED, tile_seq=4)])  # more facts, no other time
        journal.mark([ArmChange(arms[0].arm_id, ArmState.PASSED)])
        journal.mark([ArmChange(arms[1].arm_id, ArmState.PRINTED), ArmChange(arms[1].arm_id, ArmState.DIVERTED)])
        journal.mark([ArmChange(arms[2].arm_id, ArmState.PARTIAL)])
        journal.mark([ArmChange(arms[3].arm_id, ArmState.IN_DOUBT)])
        journal.settle(run_id, 3, ArmState.PASSED)
        found = {arm.face: (arm.printed_at, arm.passed_at) for arm in journal.arms()}
        again = journal.prints(run_id)

    def at(second: int) -> datetime:
        return datetime(2026, 3, 1, second=second, tzinfo=UTC)

    assert found == {0: (at(3), at(5)), 1: (at(6), None), 2: (None, None), 3: (None, None), 4: (None, None)}
    assert [(print_.face, print_.state, print_.printed_at, print_.passed_at) for print_ in again] == [
        (0, ArmState.PASSED, at(3), at(5)),
        (1, ArmState.DIVERTED, at(6), None),
    ]


def test_prints_are_found_by_run_and_time(url: str) -> None:
    times = iter([*range(20), 5, *range(20, 60)])  # the clock is put back once
    clock = lambda: datetime(2026, 3, 1, second=next(times), tzinfo=UTC)  # noqa: E731
    with Journal.open(url, line=LINE, now=clock) as journal:
        first, second = journal.start_run(FACTS), journal.start_run(replace(FACTS, job_hash="other"))
        journal.correct(first, press_key="aa", drift="{}", reason="")
        arms = journal.intend(first, [(face, 1) for face in range(4)], correction=1) + journal.intend(second, [(0, 1)])
        for arm in (*arms[:3], arms[4]):
            bring(journal, arm, ArmState.PRINTED)
    with Journal.look(url, line=LINE) as journal:
        everything = journal.prints()
        assert [(found.run_id, found.face, found.attempt, found.correction) for found in everything] == [
            (first, 0, 1, 1),
            (first, 1, 1, 1),
            (first, 2, 1, 1),
            (second, 0, 1, 0),
        ]
        assert journal.prints(first) == everything[:3]
        assert journal.prints(since=everything[1].printed_at) == everything[1:]
        assert journal.prints(first, since=everything[1].printed_at) == everything[1:3]
        assert journal.prints(until=everything[1].printed_at) == everything[:1]
        assert journal.prints(first, since=everything[1].printed_at, until=everything[2].printed_at) == everything[1:2]
        assert journal.prints(second, since=datetime(2026, 3, 2, tzinfo=UTC)) == []


def test_an_operator_orders_a_reprint(journal: Journal) -> None:
    run_id = journal.start_run(FACTS)
    (arm,) = journal.intend(run_id, [(0, 1)])
    with pytest.raises(JournalError, match="wait until its tile is through"):
        journal.order_reprint(run_id, 0)
    bring(journal, arm, ArmState.PASSED)
    assert [journal.order_reprint(run_id, 0), journal.order_reprint(run_id, 0)] == [2, 2]
    assert journal.face_states(run_id).reprints == ((0, 1),)
    (again,) = journal.intend(run_id, [(0, 2)])
    bring(journal, again, ArmState.UNPRINTED)
    with pytest.raises(JournalError, match="still to be printed"):
        journal.order_reprint(run_id, 0)
    assert journal.face_states(run_id) == FaceStates(20, 1, unprinted=((0, 2),))
    (third,) = journal.intend(run_id, [(0, 3)])
    bring(journal, third, ArmState.PARTIAL)
    assert [(arm.attempt, arm.reprint) for arm in journal.arms()] == [(1, None), (2, 1), (3, 1)]
    with pytest.raises(JournalError, match="no reprint was ordered"):
        journal.intend(run_id, [(0, 4)])
    assert journal.order_reprint(run_id, 0) == 4
    assert journal.intend(run_id, [(0, 4)])[0].attempt == 4


@pytest.mark.parametrize(("face", "message"), [(3, "still to be printed"), (20, "isn't one of"), (-1, "isn't one of")])
def test_reprints_of_faces_never_printed_are_refused(journal: Journal, face: int, message: str) -> None:
    with pytest.raises(JournalError, match=message):
        journal.order_reprint(journal.start_run(FACTS), face)


@pytest.mark.parametrize("state", [ArmState.PASSED, ArmState.DIVERTED, ArmState.UNPRINTED])
def test_an_operator_settles_a_doubt(journal: Journal, state: ArmState) -> None:
    run_id = journal.start_run(FACTS)
    (arm,) = journal.intend(run_id, [(0, 1)])
    bring(journal, arm, ArmState.IN_DOUBT)
    with pytest.raises(JournalError, match="settle it first"):
        journal.order_reprint(run_id, 0)
    with pytest.raises(JournalError, match="can't become"):
        journal.settle(run_id, 0, ArmState.PRINTED)
    record = journal.settle(run_id, 0, state)
    assert (record.arm_id, record.state, record.reason) == (arm.arm_id, state, "settled by the operator")
    assert journal.counts(run_id)[state] == 1
    assert journal.notes()[-1].detail == {"run_id": run_id, "face": 0, "state": state.value}
    with pytest.raises(JournalError, match="isn't in doubt"):
        journal.settle(run_id, 0, state)
    taken = FaceQueue(journal.face_states(run_id)).take()
    assert taken == ([(0, 2)] if state is ArmState.UNPRINTED else [(1, 1)])


def test_a_run_is_finished_only_when_nothing_is_left(journal: Journal) -> None:
    run_id = journal.start_run(replace(FACTS, faces=2))
    arms = journal.intend(run_id, [(0, 1)])
    with pytest.raises(JournalError, match="1 arms are open"):
        journal.finish_run(run_id, abandoned=True)
    bring(journal, arms[0], ArmState.IN_DOUBT)
    with pytest.raises(JournalError, match="1 faces are to be printed"):
        journal.finish_run(run_id)
    bring(journal, journal.intend(run_id, [(1, 1)])[0], ArmState.PASSED)
    journal.finish_run(run_id)
    # What an operator finds later takes the run up again: nothing is skipped silently.
    journal.settle(run_id, 0, ArmState.UNPRINTED)
    assert journal.start_run(replace(FACTS, faces=2)) == run_id
    bring(journal, journal.intend(run_id, [(0, 2)])[0], ArmState.PASSED)
    journal.finish_run(run_id)
    assert journal.order_reprint(run_id, 1) == 2
    assert journal.start_run(replace(FACTS, faces=2)) == run_id


def test_notes_are_bounded_but_the_newest_of_each_kind_stays(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_base, "MOST_NOTES", 20)
    monkeypatch.setattr(journal_base, "_TIDY_EVERY", 10)
    journal.note("calibrated", offset=-3, where=Path("/x"))
    journal.note("state", state="running")
    for number in range(98):
        journal.note("tick", number=number)
    kept = journal.notes(last=1000)
    assert [note.kind for note in kept] == ["calibrated", "state", *["tick"] * 20]
    assert [note.detail["number"] for note in kept[2:]] == list(range(78, 98))
    found = journal.latest_note("calibrated")
    assert found is not None
    assert found.detail == {"offset": -3, "where": "/x"}
    assert journal.latest_note("unheard") is None
    assert journal.notes(last=1) == kept[-1:]


def test_frequent_notes_push_no_others_out(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_base, "MOST_NOTES", 20)
    monkeypatch.setattr(journal_base, "_TIDY_EVERY", 10)
    journal.note("alarm", code="jam")
    for number in range(59):
        journal.note("kiln", number=number)
        journal.note("gauged", number=number)
    journal.note("kiln", number=59)
    kept = journal.notes(last=1000)
    assert [note.kind for note in kept].count("kiln") == 20
    assert [note.kind for note in kept].count("gauged") == 20
    assert kept[0].kind == "alarm"


def test_notes_are_found_by_time_and_kind(url: str) -> None:
    times = iter(range(60))
    clock = lambda: datetime(2026, 3, 1, second=next(times), tzinfo=UTC)  # noqa: E731
    with Journal.open(url, line=LINE, now=clock) as journal:
        for kind in ("state", "kiln", "alarm", "kiln", "state"):
            journal.note(kind)
    with Journal.look(url, line=LINE) as journal:
        everything = journal.notes()
        since, until = everything[1].at, everything[4].at
        assert journal.notes_between(since) == everything[1:]
        assert journal.notes_between(since, until) == everything[1:4]
        assert journal.notes_between(since, until, kinds=("kiln",)) == [everything[1], everything[3]]
        assert journal.notes_between(since, kinds={"state", "alarm"}) == [everything[2], everything[4]]
        assert journal.notes_between(until, since) == []
        assert journal.notes_between(since, kinds=()) == []


def test_a_note_may_be_of_any_length_but_is_kept_short(journal: Journal) -> None:
    journal.note("long", text="\u0000é" * 100_000)
    (note,) = journal.notes()
    assert list(note.detail) == ["shortened"]


def test_lines_share_a_database_but_no_numbers(url: str) -> None:
    with Journal.open(url, line=LINE) as one:
        first = one.start_run(FACTS)
        assert one.intend(first, [(0, 1)])[0].arm_id == 1
        one.note("hello")
        assert one.begin_session() == 1
    with Journal.open(url, line="line 2") as two:
        second = two.start_run(FACTS)
        assert second != first
        assert two.intend(second, [(0, 1)])[0].arm_id == 1
        two.mark([ArmChange(1, ArmState.ARMED)])
        assert (two.notes(), two.begin_session()) == ([], 1)
        assert [run.run_id for run in two.runs()] == [second]
        with pytest.raises(JournalError, match="has no run"):
            two.face_states(first)
    with Journal.open(url, line=LINE) as one:
        assert [arm.state for arm in one.arms()] == [ArmState.INTENT]


def test_only_a_server_serves_many_lines_at_once(url: str) -> None:
    """Writers of one file could wait for each other's disk."""
    with Journal.open(url, line=LINE) as one:
        if url.startswith("sqlite"):
            with pytest.raises(JournalError, match="another daemon"):
                Journal.open(url, line="line 2")
            return
        with Journal.open(url, line="line 2") as two:
            assert [one.begin_session(), two.begin_session(), one.begin_session()] == [1, 1, 2]


def test_a_second_daemon_of_a_line_is_refused(url: str) -> None:
    with Journal.open(url, line=LINE), pytest.raises(JournalError, match="another daemon"):
        Journal.open(url, line=LINE)
    Journal.open(url, line=LINE).close()


def test_lookers_on_see_what_is_committed_and_change_nothing(url: str) -> None:
    with Journal.open(url, line=LINE) as journal:
        run_id = journal.start_run(FACTS)
        with Journal.look(url, line=LINE) as looker:
            assert looker.counts(run_id)[ArmState.INTENT] == 0
            journal.intend(run_id, [(0, 1)])
            assert looker.counts(run_id)[ArmState.INTENT] == 1
            assert looker.arms() == journal.arms()
            with pytest.raises(JournalError, match=r"read-only|can't be written"):
                looker.note("graffiti")
            journal.note("still writing")
        with pytest.raises(JournalError, match="knows no line"):
            Journal.look(url, line="line 9")
    with Journal.look(url, line=LINE) as looker:
        assert len(looker.arms()) == 1


def test_there_is_nothing_to_look_at_before_the_first_start(url: str) -> None:
    with pytest.raises(JournalError, match="start the line once"):
        Journal.look(url, line=LINE)


def test_only_the_thread_that_opened_it_may_use_it(journal: Journal) -> None:
    raised: list[str] = []

    def use() -> None:
        for call in (journal.begin_session, journal.close, journal.check):
            try:
                call()
            except JournalError as error:
                raised.append(error.message)

    thread = threading.Thread(target=use)
    thread.start()
    thread.join()
    assert len(raised) == 3
    assert all("another thread" in message for message in raised)
    assert journal.begin_session() == 1


def test_a_closed_journal_says_so(url: str) -> None:
    journal = Journal.open(url, line=LINE)
    journal.close()
    journal.close()
    with pytest.raises(JournalError, match="it is closed"):
        journal.note("late")


def test_what_is_whole_passes_the_check(journal: Journal) -> None:
    journal.intend(journal.start_run(FACTS), [(0, 1)])
    journal.check()


ARM = {
    "line_id": 1,
    "arm_id": 50,
    "run_id": 1,
    "face": 3,
    "attempt": 1,
    "state": "intent",
    "reason": "",
    "intended_ms": 0,
    "changed_ms": 0,
}


@pytest.mark.parametrize(
    "change",
    [
        {"face": 0, "attempt": 9},
        {"face": 1, "attempt": 9},
        {"face": 2, "attempt": 9},
        {"face": 2, "attempt": 9, "state": "passed"},
        {"face": 2, "attempt": 1, "state": "unprinted"},
        {"face": 4, "attempt": 9, "state": "passed", "reprint": 1},
        {"face": 3, "reprint": 1},
        {"arm_id": 1},
        {"arm_id": 0},
        {"run_id": 2},
        {"line_id": 2},
        {"face": -1},
        {"attempt": 0},
        {"state": "done"},
        {"data_crc32": 1 << 32},
        {"rows_printed": -1},
    ],
    ids=str,
)
def test_the_database_itself_refuses_what_the_ledger_forbids(journal: Journal, change: dict[str, object]) -> None:
    run_id = journal.start_run(FACTS)
    open_one, doubted, passed, again = journal.intend(run_id, [(0, 1), (1, 1), (2, 1), (4, 1)])
    assert open_one.arm_id == 1
    bring(journal, doubted, ArmState.IN_DOUBT)
    bring(journal, passed, ArmState.PASSED)
    bring(journal, again, ArmState.PASSED)
    journal.order_reprint(run_id, 4)
    bring(journal, journal.intend(run_id, [(4, 2)])[0], ArmState.PASSED)

    def insert(row: dict[str, object]) -> None:
        names = ", ".join(row)
        with journal._store.transaction("insert") as connection:
            connection.execute(text(f"INSERT INTO arms ({names}) VALUES (:{', :'.join(row)})"), row)

    with pytest.raises(JournalError, match="contradict"):
        insert({**ARM, **change})
    # The row itself is one that it takes.
    insert(ARM)


def test_migrations_lead_to_the_schema(journal: Journal) -> None:
    with journal._store.transaction("compare") as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_the_database_holds_one_unfinished_run_of_a_job(journal: Journal) -> None:
    journal.start_run(FACTS)
    columns = "line_id, job_hash, name, job_file, faces, seed, map_hash, begun_ms"
    with (
        pytest.raises(JournalError, match="contradict"),
        journal._store.transaction("insert") as connection,
    ):
        connection.execute(text(f"INSERT INTO runs ({columns}) SELECT {columns} FROM runs"))


def test_a_lost_connection_is_never_mended_silently(url: str) -> None:
    """Its lock may be another daemon's by now."""
    if not url.startswith("postgresql"):
        pytest.skip("SQLite has no connection to lose")
    with Journal.open(url, line=LINE) as journal:
        run_id = journal.start_run(FACTS)
        other = Store(url, line="line 2", read_only=False)
        try:
            with other.transaction("cut") as connection:
                connection.execute(
                    text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()")
                )
        finally:
            other.close()
        for _ in range(2):
            with pytest.raises(JournalError):
                journal.intend(run_id, [(0, 1)])
    with Journal.open(url, line=LINE) as journal:
        assert journal.arms() == []
