"""What goes wrong under a journal: each failure explains itself, and leaves what was promised."""

from __future__ import annotations

import fcntl
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import event

from tilefab.control.ledger import OPEN, ArmState
from tilefab.errors import JournalError
from tilefab.io import journal_store
from tilefab.io.journal import ArmChange, Journal, RunFacts, sqlite_url
from tilefab.io.journal_store import Store

LINE = "line 1"
FACTS = RunFacts(job_hash="ab", name="a job", job_file="a.toml", faces=1 << 20, seed=7, map_hash="cd")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


def begun(path: Path, faces: int = 5) -> Journal:
    """An open journal with arms in it."""
    journal = Journal.open(sqlite_url(path), line=LINE)
    journal.intend(journal.start_run(FACTS), [(face, 1) for face in range(faces)])
    return journal


def pragma(journal: Journal, setting: str) -> Any:
    return journal._store._driver().execute(f"PRAGMA {setting}").fetchone()


def test_commits_are_durable_and_keys_checked(path: Path) -> None:
    with begun(path) as journal:
        told = {name: pragma(journal, name) for name in ("synchronous", "journal_mode", "foreign_keys", "busy_timeout")}
    assert told == {"synchronous": (2,), "journal_mode": ("wal",), "foreign_keys": (1,), "busy_timeout": (5000,)}


@pytest.mark.parametrize("name", ["ordinary", "a b?c#d%e&f=g", "Straße 1é", "line;1'\""])
def test_any_path_and_line_name_will_do(tmp_path: Path, name: str) -> None:
    path = tmp_path / f"{name}.sqlite"
    for session in (1, 2):
        with Journal.open(sqlite_url(path), line=name) as journal:
            assert journal.begin_session() == session
    assert path.exists()


@pytest.mark.parametrize("line", ["", "x" * 101, "two\nlines"])
def test_lines_without_a_proper_name_are_refused(path: Path, line: str) -> None:
    with pytest.raises(JournalError, match="printable"):
        Journal.open(sqlite_url(path), line=line)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("no url", "can't be read"),
        ("mysql://host/name", "isn't known here"),
        ("sqlite://", "must name a file"),
        ("sqlite:///:memory:", "must name a file"),
        ("sqlite:////tmp/x?mode=memory", "must name a file"),
    ],
)
def test_urls_that_name_no_journal_are_refused(url: str, message: str) -> None:
    with pytest.raises(JournalError, match=message):
        Journal.open(url, line=LINE)


def test_a_password_is_never_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(JournalError, match=r"tilefab\[postgres\]") as caught:
        Journal.open("postgresql://me:secret@127.0.0.1:1/journal", line=LINE)
    assert "secret" not in str(caught.value)


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(JournalError, match="folder doesn't exist"):
        Journal.open(sqlite_url(tmp_path / "none" / "journal.sqlite"), line=LINE)
    with pytest.raises(JournalError, match="is a folder"):
        Journal.open(sqlite_url(tmp_path), line=LINE)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_database_is_told_and_left_alone(path: Path) -> None:
    path.write_bytes(b"no database at all " * 500)
    before = path.read_bytes()
    with pytest.raises(JournalError, match="is no journal"):
        Journal.open(sqlite_url(path), line=LINE)
    assert path.read_bytes() == before


def test_the_database_of_something_else_is_left_alone(path: Path) -> None:
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE photographs (name TEXT)")
    other.close()
    before = path.read_bytes()
    for open_journal in (Journal.open, Journal.look):
        with pytest.raises(JournalError, match="something else"):
            open_journal(sqlite_url(path), line=LINE)
    assert path.read_bytes() == before


def test_a_damaged_file_is_told(path: Path) -> None:
    begun(path, 2000).close()
    content = bytearray(path.read_bytes())
    for page in range(30, len(content) // 4096, 2):
        content[4096 * page : 4096 * page + 64] = bytes(64)
    path.write_bytes(content)
    with pytest.raises(JournalError, match="damaged"):
        Journal.open(sqlite_url(path), line=LINE)


def test_a_truncated_file_is_told(path: Path) -> None:
    begun(path, 2000).close()
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)
    with pytest.raises(JournalError, match="damaged"):
        Journal.open(sqlite_url(path), line=LINE)


def test_damage_found_while_running_ends_all_trust(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun(path, 5000).close()
    content = bytearray(path.read_bytes())
    for page in range(30, len(content) // 4096):
        content[4096 * page : 4096 * page + 64] = bytes(64)
    path.write_bytes(content)
    monkeypatch.setattr(journal_store, "_CHECKED_BYTES", 0)
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        with pytest.raises(JournalError, match="damaged"):
            journal.arms()
        with pytest.raises(JournalError, match="open it again"):
            journal.begin_session()


def test_a_reference_to_nothing_fails_the_check(path: Path) -> None:
    begun(path).close()
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("DELETE FROM runs")
    other.close()
    with Journal.open(sqlite_url(path), line=LINE) as journal, pytest.raises(JournalError, match="isn't there"):
        journal.check()


def test_a_full_disk_undoes_the_call_and_no_more(path: Path) -> None:
    with begun(path) as journal:
        run_id = journal.start_run(FACTS)
        before = journal.arms(), journal.counts(run_id), journal.last_arm()
        (pages,) = pragma(journal, "page_count")
        pragma(journal, f"max_page_count = {pages}")
        with pytest.raises(JournalError, match="no space left: make room"):
            journal.intend(run_id, [(face, 1) for face in range(100, 3000)])
        assert (journal.arms(), journal.counts(run_id), journal.last_arm()) == before
        pragma(journal, "max_page_count = 1000000")
        assert journal.intend(run_id, [(100, 1)])[0].arm_id == 6


def test_a_database_that_cannot_be_written_is_told(path: Path) -> None:
    with begun(path) as journal:
        pragma(journal, "query_only = ON")
        with pytest.raises(JournalError, match="can't be written"):
            journal.begin_session()
        pragma(journal, "query_only = OFF")
        assert journal.begin_session() == 1


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anything")
def test_a_folder_that_cannot_be_written_is_told(path: Path) -> None:
    path.parent.chmod(0o500)
    try:
        with pytest.raises(JournalError, match="permissions"):
            Journal.open(sqlite_url(path), line=LINE)
    finally:
        path.parent.chmod(0o700)


def test_a_database_held_by_another_program_is_told(path: Path) -> None:
    with begun(path) as journal:
        pragma(journal, "busy_timeout = 10")
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        for _ in range(2):
            with pytest.raises(JournalError, match="another program holds it"):
                journal.begin_session()
        other.close()
        assert journal.begin_session() == 1


def test_a_file_system_without_shared_memory_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as one over a network: SQLite then can't keep a write-ahead log."""
    plain = sqlite3.connect

    def connect(name: str, **options: object) -> sqlite3.Connection:
        return plain(f"{name}&vfs=unix-dotfile", **options)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(sqlite3, "connect", connect)
    with pytest.raises(JournalError, match="journal_mode can't be set to WAL"):
        Journal.open(sqlite_url(path), line=LINE)


def test_a_file_system_without_locks_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(*_: object) -> None:
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", flock)
    with pytest.raises(JournalError, match="can't lock files"):
        Journal.open(sqlite_url(path), line=LINE)


def test_the_lock_goes_with_the_process(path: Path) -> None:
    code = (
        "import os, sys; from tilefab.io.journal import Journal\n"
        "journal = Journal.open(sys.argv[1], line=sys.argv[2]); print(journal.begin_session(), flush=True)\n"
        "sys.stdin.read()"
    )
    arguments = [sys.executable, "-c", code, sqlite_url(path), LINE]
    with subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            assert daemon.stdout.readline() == "1\n"
            with pytest.raises(JournalError, match=rf"another daemon \(process {daemon.pid}, line {LINE}\)"):
                Journal.open(sqlite_url(path), line=LINE)
        finally:
            daemon.kill()
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        assert journal.begin_session() == 2


def test_lookers_on_read_what_a_killed_daemon_left(path: Path, tmp_path: Path) -> None:
    left = tmp_path / "left" / path.name
    left.parent.mkdir()
    with begun(path):
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", f"{left}{suffix}")
    before = left.read_bytes(), Path(f"{left}-wal").read_bytes()
    with Journal.look(sqlite_url(left), line=LINE) as looker:
        assert len(looker.arms()) == 5
    assert (left.read_bytes(), Path(f"{left}-wal").read_bytes()) == before


def test_a_link_to_a_journal_is_the_same_journal(path: Path) -> None:
    link = path.with_name("link.sqlite")
    with begun(path):
        link.symlink_to(path)
        with pytest.raises(JournalError, match="another daemon"):
            Journal.open(sqlite_url(link), line=LINE)


def test_the_write_ahead_log_is_cut_once_lookers_on_let_go(path: Path) -> None:
    log = path.with_name(path.name + "-wal")
    with begun(path) as journal, Journal.look(sqlite_url(path), line=LINE) as looker:
        with looker._store.transaction("look for long") as connection:
            connection.exec_driver_sql("SELECT count(*) FROM arms").fetchall()
            for _ in range(1100):
                journal.note("event", text="x" * 15_000)
            assert log.stat().st_size > 16 << 20
            journal._store.tidy()
        journal._store.tidy()
        assert log.stat().st_size == 0
        assert journal.notes(1)[0].detail == {"text": "x" * 15_000}
        assert pragma(journal, "busy_timeout") == (5000,)


@pytest.mark.parametrize("open_journal", [Journal.open, Journal.look])
def test_failing_to_open_gives_everything_back(path: Path, open_journal: Callable[..., Journal]) -> None:
    """Descriptors and the lock; what is left open would be warned of."""
    before = len(list(Path("/proc/self/fd").iterdir())) if Path("/proc/self/fd").exists() else 0
    path.write_bytes(b"\1" * 8192)
    for _ in range(3):
        with pytest.raises(JournalError):
            open_journal(sqlite_url(path), line=LINE)
    if before:
        assert len(list(Path("/proc/self/fd").iterdir())) == before
    path.unlink()
    begun(path).close()


def test_a_store_is_undone_as_a_whole_when_the_work_fails(path: Path) -> None:
    with begun(path) as journal:
        journal.mark([ArmChange(1, ArmState.ARMED)])
    store = Store(sqlite_url(path), line=LINE, read_only=False)
    try:

        def fail() -> None:
            with store.transaction("try") as connection:
                connection.exec_driver_sql("DELETE FROM arms")
                raise KeyError

        with pytest.raises(KeyError):
            fail()
        with store.transaction("count") as connection:
            assert connection.exec_driver_sql("SELECT count(*) FROM arms").scalar() == 5
    finally:
        store.close()


def test_recent_prints_are_found_without_reading_the_others(path: Path) -> None:
    read: list[str] = []

    def explain(_: object, cursor: sqlite3.Cursor, statement: str, values: tuple[object, ...], *__: object) -> None:
        if statement.startswith("SELECT") and "printed_ms IS NOT NULL" in statement:
            plan = cursor.connection.execute(f"EXPLAIN QUERY PLAN {statement}", values)
            read.append(" ".join(row[3] for row in plan))

    with begun(path) as journal:
        run_id = journal.start_run(FACTS)
        assert journal._store._engine is not None
        event.listen(journal._store._engine, "after_cursor_execute", explain)
        journal.prints(since=datetime(2026, 3, 1, tzinfo=UTC))
        journal.prints(run_id, since=datetime(2026, 3, 1, tzinfo=UTC))
        journal.prints(run_id)
    assert len(read) == 3
    assert all("ix_arms_printed" in plan and "printed_ms>?" in plan for plan in read[:2]), read
    assert "ix_arms_attempt (run_id=?)" in read[2]


def test_arms_not_settled_are_found_without_reading_the_others(path: Path) -> None:
    read: list[str] = []

    def explain(_: object, cursor: sqlite3.Cursor, statement: str, values: tuple[object, ...], *__: object) -> None:
        if statement.startswith("SELECT") and "state IN" in statement:
            plan = cursor.connection.execute(f"EXPLAIN QUERY PLAN {statement}", values)
            read.append(" ".join(row[3] for row in plan))

    with begun(path) as journal:
        run_id = journal.start_run(FACTS)
        assert journal._store._engine is not None
        event.listen(journal._store._engine, "after_cursor_execute", explain)
        journal.arms(states=[ArmState.INTENT])
        journal.arms(run_id, states=OPEN, last=3)
        journal.face_states(run_id)
    assert len(read) == 3
    assert all("ix_arms_unsettled" in plan for plan in read)
