"""The journal: lines, runs, arms, reprints, notes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_STATES = "state IN ('intent', 'armed', 'printed', 'passed', 'diverted', 'partial', 'unprinted', 'in_doubt')"
_FACTS = ("detect_seq", "tile_seq", "printer_boot", "plc_boot", "rows_printed", "data_crc32")


def upgrade() -> None:
    """To this revision."""
    _create_runs()
    _create_arms()
    op.create_table(
        "notes",
        sa.Column("note_id", sa.Integer().with_variant(sa.BigInteger(), "postgresql"), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("at_ms", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["line_id"], ["lines.line_id"], name=op.f("fk_notes_line_id")),
        sa.PrimaryKeyConstraint("note_id", name=op.f("pk_notes")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_notes_kind", "notes", ["line_id", "kind", "note_id"])
    op.create_index("ix_notes_line", "notes", ["line_id", "note_id"])


def _create_runs() -> None:
    op.create_table(
        "lines",
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("last_session", sa.BigInteger(), nullable=False),
        sa.Column("last_arm", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("last_session >= 0 AND last_session < 4294967296", name=op.f("ck_lines_last_session")),
        sa.CheckConstraint("last_arm >= 0", name=op.f("ck_lines_last_arm")),
        sa.PrimaryKeyConstraint("line_id", name=op.f("pk_lines")),
        sa.UniqueConstraint("name", name=op.f("uq_lines_name")),
    )
    op.create_table(
        "runs",
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("job_hash", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("job_file", sa.Text(), nullable=False),
        sa.Column("faces", sa.BigInteger(), nullable=False),
        sa.Column("seed", sa.BigInteger(), nullable=False),
        sa.Column("map_hash", sa.Text(), nullable=False),
        sa.Column("begun_ms", sa.BigInteger(), nullable=False),
        sa.Column("finished_ms", sa.BigInteger(), nullable=True),
        sa.CheckConstraint("faces >= 1 AND faces <= 1099511627776", name=op.f("ck_runs_faces")),
        sa.CheckConstraint("seed >= 0", name=op.f("ck_runs_seed")),
        sa.ForeignKeyConstraint(["line_id"], ["lines.line_id"], name=op.f("fk_runs_line_id")),
        sa.PrimaryKeyConstraint("run_id", name=op.f("pk_runs")),
        sa.UniqueConstraint("line_id", "run_id", name=op.f("uq_runs_line_id_run_id")),
        sqlite_autoincrement=True,
    )
    _create_partial_index("ix_runs_unfinished", "runs", ["line_id", "job_hash"], "finished_ms IS NULL", unique=True)
    op.create_table(
        "reprints",
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("face", sa.BigInteger(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("ordered_ms", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("number >= 1", name=op.f("ck_reprints_number")),
        sa.ForeignKeyConstraint(["run_id"], ["runs.run_id"], name=op.f("fk_reprints_run_id")),
        sa.PrimaryKeyConstraint("run_id", "face", "number", name=op.f("pk_reprints")),
    )


def _create_arms() -> None:
    op.create_table(
        "arms",
        sa.Column("line_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("arm_id", sa.BigInteger(), autoincrement=False, nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("face", sa.BigInteger(), nullable=False),
        sa.Column("attempt", sa.Integer(), nullable=False),
        sa.Column("reprint", sa.Integer(), nullable=True),
        sa.Column("state", sa.Text(), nullable=False),
        *(sa.Column(name, sa.BigInteger(), nullable=True) for name in _FACTS),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("intended_ms", sa.BigInteger(), nullable=False),
        sa.Column("changed_ms", sa.BigInteger(), nullable=False),
        sa.CheckConstraint(_STATES, name=op.f("ck_arms_state")),
        sa.CheckConstraint("arm_id >= 1", name=op.f("ck_arms_arm_id")),
        sa.CheckConstraint("face >= 0", name=op.f("ck_arms_face")),
        sa.CheckConstraint("attempt >= 1", name=op.f("ck_arms_attempt")),
        *(sa.CheckConstraint(f"{name} >= 0 AND {name} < 4294967296", name=op.f(f"ck_arms_{name}")) for name in _FACTS),
        sa.ForeignKeyConstraint(
            ["line_id", "run_id"], ["runs.line_id", "runs.run_id"], name=op.f("fk_arms_line_id_run_id")
        ),
        sa.ForeignKeyConstraint(
            ["run_id", "face", "reprint"],
            ["reprints.run_id", "reprints.face", "reprints.number"],
            name=op.f("fk_arms_run_id_face_reprint"),
        ),
        sa.PrimaryKeyConstraint("line_id", "arm_id", name=op.f("pk_arms")),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_arms_attempt", "arms", ["run_id", "face", "attempt"], unique=True)
    _create_partial_index(
        "ix_arms_unsettled",
        "arms",
        ["line_id", "run_id", "face"],
        "state IN ('intent', 'armed', 'printed', 'in_doubt')",
        unique=True,
    )
    _create_partial_index(
        "ix_arms_printed_first",
        "arms",
        ["run_id", "face"],
        "state <> 'unprinted' AND reprint IS NULL",
        unique=True,
    )
    _create_partial_index(
        "ix_arms_printed_again",
        "arms",
        ["run_id", "face", "reprint"],
        "state <> 'unprinted' AND reprint IS NOT NULL",
        unique=True,
    )
    _create_partial_index("ix_arms_unprinted", "arms", ["run_id", "face"], "state = 'unprinted'", unique=False)


def _create_partial_index(name: str, table: str, columns: list[str], where: str, *, unique: bool) -> None:
    op.create_index(name, table, columns, unique=unique, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
