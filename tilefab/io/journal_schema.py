"""Tables of the line's journal; the database itself refuses what the ledger forbids.

Types are portable between SQLite and PostgreSQL. Times are milliseconds since 1970 (UTC). Alembic's scripts in
``journal_migrations`` lead to this schema; a test compares the two.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    text,
)

from tilefab.control.ledger import UNSETTLED, ArmState

HEAD = "0002"
"""Revision that this module describes."""

MOST_SESSIONS = 1 << 32
"""The printer's protocol holds a session in 32 bits."""

# Partial indexes are used only where a query says the same, word for word.
UNSETTLED_ARMS = text(f"state IN ({', '.join(repr(state.value) for state in ArmState if state in UNSETTLED)})")
UNPRINTED_ARMS = text(f"state = '{ArmState.UNPRINTED.value}'")
_MAY_BE_PRINTED = f"state <> '{ArmState.UNPRINTED.value}'"
MAY_BE_PRINTED_FIRST = text(f"{_MAY_BE_PRINTED} AND reprint IS NULL")
MAY_BE_PRINTED_AGAIN = text(f"{_MAY_BE_PRINTED} AND reprint IS NOT NULL")
UNFINISHED_RUNS = text("finished_ms IS NULL")
PRINTED_ARMS = text("printed_ms IS NOT NULL")

metadata = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
    }
)

lines = Table(
    "lines",
    metadata,
    Column("line_id", Integer, primary_key=True),
    Column("name", Text, nullable=False, unique=True),
    Column("last_session", BigInteger, nullable=False),
    Column("last_arm", BigInteger, nullable=False),
    CheckConstraint(f"last_session >= 0 AND last_session < {MOST_SESSIONS}", name="last_session"),
    CheckConstraint("last_arm >= 0", name="last_arm"),
)

runs = Table(
    "runs",
    metadata,
    Column("run_id", Integer, primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("job_hash", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("job_file", Text, nullable=False),
    Column("faces", BigInteger, nullable=False),
    Column("seed", BigInteger, nullable=False),
    Column("map_hash", Text, nullable=False),
    Column("begun_ms", BigInteger, nullable=False),
    Column("finished_ms", BigInteger),
    UniqueConstraint("line_id", "run_id"),
    CheckConstraint(f"faces >= 1 AND faces <= {1 << 40}", name="faces"),
    CheckConstraint("seed >= 0", name="seed"),
    sqlite_autoincrement=True,
)
Index(
    "ix_runs_unfinished",
    runs.c.line_id,
    runs.c.job_hash,
    unique=True,
    sqlite_where=UNFINISHED_RUNS,
    postgresql_where=UNFINISHED_RUNS,
)

reprints = Table(
    "reprints",
    metadata,
    Column("run_id", Integer, ForeignKey("runs.run_id"), primary_key=True),
    Column("face", BigInteger, primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("ordered_ms", BigInteger, nullable=False),
    CheckConstraint("number >= 1", name="number"),
)

corrections = Table(
    "corrections",
    metadata,
    Column("run_id", Integer, ForeignKey("runs.run_id"), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("press_key", Text, nullable=False),
    Column("drift", Text, nullable=False),
    Column("reason", Text, nullable=False),
    Column("made_ms", BigInteger, nullable=False),
    CheckConstraint("number >= 1", name="number"),
)

_U32 = 1 << 32

arms = Table(
    "arms",
    metadata,
    Column("line_id", Integer, primary_key=True, autoincrement=False),
    Column("arm_id", BigInteger, primary_key=True, autoincrement=False),
    Column("run_id", Integer, nullable=False),
    Column("face", BigInteger, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("reprint", Integer),
    Column("state", Text, nullable=False),
    Column("detect_seq", BigInteger),
    Column("tile_seq", BigInteger),
    Column("printer_boot", BigInteger),
    Column("plc_boot", BigInteger),
    Column("rows_printed", BigInteger),
    Column("data_crc32", BigInteger),
    Column("reason", Text, nullable=False),
    Column("intended_ms", BigInteger, nullable=False),
    Column("changed_ms", BigInteger, nullable=False),
    # 0: as the job's file says. No key of another table, so that those before need no row.
    Column("correction", Integer, nullable=False, server_default=text("0")),
    Column("printed_ms", BigInteger),
    Column("passed_ms", BigInteger),
    ForeignKeyConstraint(["line_id", "run_id"], ["runs.line_id", "runs.run_id"]),
    ForeignKeyConstraint(["run_id", "face", "reprint"], ["reprints.run_id", "reprints.face", "reprints.number"]),
    CheckConstraint(f"state IN ({', '.join(repr(state.value) for state in ArmState)})", name="state"),
    CheckConstraint("arm_id >= 1", name="arm_id"),
    CheckConstraint("face >= 0", name="face"),
    CheckConstraint("attempt >= 1", name="attempt"),
    *(
        CheckConstraint(f"{name} >= 0 AND {name} < {_U32}", name=name)
        for name in ("detect_seq", "tile_seq", "printer_boot", "plc_boot", "rows_printed", "data_crc32")
    ),
    sqlite_with_rowid=False,
)
Index("ix_arms_attempt", arms.c.run_id, arms.c.face, arms.c.attempt, unique=True)
Index(
    "ix_arms_unsettled",
    arms.c.line_id,
    arms.c.run_id,
    arms.c.face,
    unique=True,
    sqlite_where=UNSETTLED_ARMS,
    postgresql_where=UNSETTLED_ARMS,
)
# A face is printed at most once for the run itself, and at most once for each order of an operator.
Index(
    "ix_arms_printed_first",
    arms.c.run_id,
    arms.c.face,
    unique=True,
    sqlite_where=MAY_BE_PRINTED_FIRST,
    postgresql_where=MAY_BE_PRINTED_FIRST,
)
Index(
    "ix_arms_printed_again",
    arms.c.run_id,
    arms.c.face,
    arms.c.reprint,
    unique=True,
    sqlite_where=MAY_BE_PRINTED_AGAIN,
    postgresql_where=MAY_BE_PRINTED_AGAIN,
)
Index(
    "ix_arms_unprinted",
    arms.c.run_id,
    arms.c.face,
    sqlite_where=UNPRINTED_ARMS,
    postgresql_where=UNPRINTED_ARMS,
)
Index(
    "ix_arms_printed",
    arms.c.line_id,
    arms.c.printed_ms,
    sqlite_where=PRINTED_ARMS,
    postgresql_where=PRINTED_ARMS,
)

notes = Table(
    "notes",
    metadata,
    Column("note_id", Integer().with_variant(BigInteger, "postgresql"), primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("at_ms", BigInteger, nullable=False),
    Column("kind", Text, nullable=False),
    Column("detail", Text, nullable=False),
    sqlite_autoincrement=True,
)
Index("ix_notes_kind", notes.c.line_id, notes.c.kind, notes.c.note_id)
Index("ix_notes_line", notes.c.line_id, notes.c.note_id)
