"""Schema and migrations say the same, old databases are brought up to date, newer ones refused."""

from __future__ import annotations

import re
import shutil
import sqlite3
from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, create_engine, inspect

from tilefab.control.ledger import ArmState
from tilefab.errors import JournalError
from tilefab.io.journal import Journal, RunFacts, sqlite_url
from tilefab.io.journal_schema import HEAD, metadata
from tilefab.io.journal_store import _FOLDER, Store, migrate

LINE = "line 1"
FACTS = RunFacts(job_hash="ab", name="a job", job_file="a.toml", faces=9, seed=7, map_hash="cd")

LATER = '''
"""A column more."""

import sqlalchemy as sa
from alembic import op

revision = "9999"
down_revision = "{before}"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("arms", sa.Column("extra", sa.Integer(), nullable=False, server_default="5"))
    {then}
'''

OLDEST_ROWS = (
    "INSERT INTO lines VALUES (1, 'line 1', 7, 12)",
    "INSERT INTO runs VALUES (1, 1, 'ab', 'a job', 'a.toml', 9, 7, 'cd', 1767225600000, NULL)",
    "INSERT INTO arms VALUES (1, 11, 1, 0, 1, NULL, 'passed', 1, 1, 5, 6, 100, 77, 'why', 1, 2)",
    "INSERT INTO arms VALUES (1, 12, 1, 1, 1, NULL, 'armed', 2, NULL, 5, NULL, NULL, NULL, '', 1, 2)",
    "INSERT INTO reprints VALUES (1, 0, 1, 1767225600000)",
    "INSERT INTO notes VALUES (1, 1, 1767225600000, 'state', '{\"state\": \"running\"}')",
)


def scripts(connection: Connection, folder: Path = _FOLDER) -> Config:
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(folder))
    config.set_main_option("path_separator", "os")
    return config


def described(path: Path) -> dict[str, object]:
    """Everything that a database says of its schema."""
    engine = create_engine(sqlite_url(path))
    try:
        found = inspect(engine)
        names = [name for name in found.get_table_names() if name != "alembic_version"]
        described: dict[str, object] = {}
        for name in names:
            described[name] = (
                [(column["name"], repr(column["type"]), column["nullable"]) for column in found.get_columns(name)],
                found.get_pk_constraint(name),
                sorted(map(repr, found.get_foreign_keys(name))),
                sorted(map(repr, found.get_unique_constraints(name))),
                sorted(map(repr, found.get_check_constraints(name))),
            )
    finally:
        engine.dispose()
    plain = sqlite3.connect(path)
    indexes = plain.execute("SELECT name, sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL").fetchall()
    described |= {name: re.sub(r"\s+", " ", sql) for name, sql in indexes}
    tables = plain.execute("SELECT name, sql FROM sqlite_master WHERE type = 'table'").fetchall()
    described |= {
        f"kind of {name}": ("AUTOINCREMENT" in sql, "WITHOUT ROWID" in sql)
        for name, sql in tables
        if name != "alembic_version"
    }
    plain.close()
    return described


def test_migrations_lead_to_the_schema(tmp_path: Path) -> None:
    migrated, made = tmp_path / "migrated.sqlite", tmp_path / "made.sqlite"
    with Journal.open(sqlite_url(migrated), line=LINE) as journal:
        (head,) = ScriptDirectory.from_config(scripts(journal._store.connection)).get_heads()
        assert head == HEAD
    engine = create_engine(sqlite_url(made))
    metadata.create_all(engine)
    engine.dispose()
    assert described(migrated) == described(made)


def test_the_oldest_database_is_brought_up_to_date(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    engine = create_engine(sqlite_url(path))
    with engine.begin() as connection:
        command.upgrade(scripts(connection), "0001")
        for row in OLDEST_ROWS:
            connection.exec_driver_sql(row)
    engine.dispose()
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        journal.check()
        assert journal.begin_session() == 8
        assert journal.start_run(FACTS) == 1
        first, second = journal.arms(1)
        assert (first.state, first.data_crc32, first.reason) == (ArmState.PASSED, 77, "why")
        assert (second.state, second.detect_seq) == (ArmState.ARMED, 2)
        assert (first.correction, first.printed_at, first.passed_at) == (0, None, None)
        assert journal.prints() == []
        assert journal.correct(1, press_key="aa", drift="{}", reason="why").number == 1
        assert journal.runs()[0].correction == 1
        assert journal.face_states(1).reprints == ((0, 1),)
        assert journal.intend(1, [(0, 2), (2, 1)])[1].arm_id == 14
        assert journal.notes()[0].detail == {"state": "running"}


@pytest.fixture
def later(tmp_path: Path) -> Path:
    """Migrations with one more than this program knows."""
    folder = tmp_path / "migrations"
    shutil.copytree(_FOLDER, folder, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "versions" / "9999_later.py").write_text(LATER.format(before=HEAD, then=""))
    return folder


def brought_up(path: Path, folder: Path) -> None:
    store = Store(sqlite_url(path), line=LINE, read_only=False)
    try:
        with store.transaction("migrate") as connection:
            migrate(connection, HEAD, str(path), folder=folder)
    finally:
        store.close()


def test_a_migration_keeps_what_is_there_and_the_older_program_refuses_it(tmp_path: Path, later: Path) -> None:
    path = tmp_path / "journal.sqlite"
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        journal.intend(journal.start_run(FACTS), [(0, 1), (1, 1)])
    brought_up(path, later)
    plain = sqlite3.connect(path)
    assert plain.execute("SELECT arm_id, extra FROM arms").fetchall() == [(1, 5), (2, 5)]
    plain.close()
    before = path.read_bytes()
    for open_journal in (Journal.open, Journal.look):
        with pytest.raises(JournalError, match="newer schema"):
            open_journal(sqlite_url(path), line=LINE)
    assert path.read_bytes() == before


def test_a_migration_that_fails_changes_nothing(tmp_path: Path, later: Path) -> None:
    path = tmp_path / "journal.sqlite"
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        journal.intend(journal.start_run(FACTS), [(0, 1)])
    (later / "versions" / "9999_later.py").write_text(LATER.format(before=HEAD, then='op.drop_table("nothing")'))
    with pytest.raises(JournalError, match="can't migrate"):
        brought_up(path, later)
    with Journal.open(sqlite_url(path), line=LINE) as journal:
        assert len(journal.arms()) == 1
        assert "extra" not in {column["name"] for column in inspect(journal._store.connection).get_columns("arms")}


def test_lookers_on_bring_nothing_up_to_date(tmp_path: Path, later: Path) -> None:
    path = tmp_path / "journal.sqlite"
    Journal.open(sqlite_url(path), line=LINE).close()
    store = Store(sqlite_url(path), line=LINE, read_only=True)
    try:
        with store.transaction("look") as connection, pytest.raises(JournalError, match="older schema"):
            migrate(connection, HEAD, str(path), read_only=True, folder=later)
    finally:
        store.close()
