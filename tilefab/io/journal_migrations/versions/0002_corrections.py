"""Corrections of a run, which one each face was printed with, and when faces were printed and passed."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

_PRINTED = "printed_ms IS NOT NULL"


def upgrade() -> None:
    """To this revision; of arms from before it isn't known when they were printed."""
    op.create_table(
        "corrections",
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("press_key", sa.Text(), nullable=False),
        sa.Column("drift", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("number >= 1", name=op.f("ck_corrections_number")),
        sa.ForeignKeyConstraint(["run_id"], ["runs.run_id"], name=op.f("fk_corrections_run_id")),
        sa.PrimaryKeyConstraint("run_id", "number", name=op.f("pk_corrections")),
    )
    # Columns of their own rather than tables: none of them rewrites what is there, however much that is.
    op.add_column("arms", sa.Column("correction", sa.Integer(), nullable=False, server_default=sa.text("0")))
    op.add_column("arms", sa.Column("printed_ms", sa.BigInteger(), nullable=True))
    op.add_column("arms", sa.Column("passed_ms", sa.BigInteger(), nullable=True))
    where = sa.text(_PRINTED)
    op.create_index("ix_arms_printed", "arms", ["line_id", "printed_ms"], sqlite_where=where, postgresql_where=where)
