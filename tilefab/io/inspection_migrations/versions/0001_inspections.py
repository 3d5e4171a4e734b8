"""What inspection finds out: tiles, defects, innovations, what must be remembered, proposals, alarms."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_GRADES = "grade IN ('first', 'second', 'scrap')"
_PROBLEMS = "problem IN ('black', 'blown_out', 'torn', 'no_tile', 'two_tiles', 'wrong_size')"
_KINDS = (
    "kind IN ('nozzle_line', 'banding', 'spot', 'pinhole', 'scratch', 'crack', 'chip', 'misregistration', "
    "'missing_ink', 'double_print')"
)
_FIGURES = (
    *("delta_e_mean", "delta_e_p95", "delta_e_worst", "worst_x_mm", "worst_y_mm", "cmc_mean", "cmc_p95"),
    *("lightness", "chroma", "hue", "fired_l", "fired_a", "fired_b", "predicted_l", "predicted_a", "predicted_b"),
)
_SIZES = ("width_mm", "height_mm", "size_percent", "straightness_percent", "rectangularity_percent")
_OF_DEFECT = ("x_mm", "y_mm", "width_mm", "height_mm", "area_mm2", "delta_e", "severity")


def upgrade() -> None:
    """To this revision."""
    op.create_table(
        "lines",
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("line_id", name=op.f("pk_lines")),
        sa.UniqueConstraint("name", name=op.f("uq_lines_name")),
    )
    _create_inspections()
    _create_loop()
    op.create_table(
        "alarms",
        sa.Column("alarm_id", _id(), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=True),
        sa.Column("code", sa.Text(), nullable=False),
        sa.Column("subject", sa.Text(), nullable=False),
        sa.Column("text", sa.Text(), nullable=False),
        sa.Column("raised_ms", sa.BigInteger(), nullable=False),
        sa.Column("cleared_ms", sa.BigInteger(), nullable=True),
        sa.Column("told", sa.Boolean(), nullable=False),
        _line("alarms"),
        sa.PrimaryKeyConstraint("alarm_id", name=op.f("pk_alarms")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_alarms_raised_ms", "alarms", ["line_id", "raised_ms"])
    _partial_index("ix_alarms_up", "alarms", ["line_id", "code", "subject"], "cleared_ms IS NULL", unique=True)


def _create_inspections() -> None:
    op.create_table(
        "inspections",
        sa.Column("inspection_id", _id(), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("image", sa.Text(), nullable=False),
        sa.Column("taken_ms", sa.BigInteger(), nullable=False),
        sa.Column("inspected_ms", sa.BigInteger(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=True),
        sa.Column("face", sa.BigInteger(), nullable=True),
        sa.Column("arm_id", sa.BigInteger(), nullable=True),
        sa.Column("correction", sa.Integer(), nullable=True),
        sa.Column("printed_ms", sa.BigInteger(), nullable=True),
        sa.Column("repeat", sa.Boolean(), nullable=False),
        sa.Column("problem", sa.Text(), nullable=True),
        sa.Column("grade", sa.Text(), nullable=False),
        sa.Column("confidence", sa.Double(), nullable=False),
        sa.Column("visible", sa.Double(), nullable=False),
        sa.Column("shade_lot", sa.Text(), nullable=False),
        *(sa.Column(name, sa.Double(), nullable=True) for name in (*_FIGURES, *_SIZES)),
        sa.Column("badness", sa.Double(), nullable=True),
        sa.Column("predicted_picture", sa.Text(), nullable=False),
        sa.Column("fired_picture", sa.Text(), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.CheckConstraint(_PROBLEMS, name=op.f("ck_inspections_problem")),
        sa.CheckConstraint(_GRADES, name=op.f("ck_inspections_grade")),
        sa.CheckConstraint("face >= 0", name=op.f("ck_inspections_face")),
        sa.CheckConstraint("correction >= 0", name=op.f("ck_inspections_correction")),
        sa.CheckConstraint("face IS NULL OR run_id IS NOT NULL", name=op.f("ck_inspections_face_of_run")),
        _line("inspections"),
        sa.PrimaryKeyConstraint("inspection_id", name=op.f("pk_inspections")),
        sa.UniqueConstraint("line_id", "image", name=op.f("uq_inspections_line_id_image")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_inspections_taken", "inspections", ["line_id", "taken_ms"])
    op.create_index("ix_inspections_run", "inspections", ["line_id", "run_id", "taken_ms"])
    op.create_index("ix_inspections_arm", "inspections", ["line_id", "arm_id"])
    _partial_index("ix_inspections_detailed", "inspections", ["line_id", "inspection_id"], "detail <> ''")
    _partial_index("ix_inspections_kept", "inspections", ["line_id", "run_id", "badness"], "badness IS NOT NULL")
    op.create_table(
        "defects",
        sa.Column("inspection_id", _id(), autoincrement=False, nullable=False),
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        *(sa.Column(name, sa.Double(), nullable=False) for name in _OF_DEFECT),
        sa.Column("grade", sa.Text(), nullable=False),
        sa.CheckConstraint(_KINDS, name=op.f("ck_defects_kind")),
        sa.CheckConstraint(_GRADES, name=op.f("ck_defects_grade")),
        sa.CheckConstraint("number >= 0", name=op.f("ck_defects_number")),
        sa.ForeignKeyConstraint(
            ["inspection_id"], ["inspections.inspection_id"], name=op.f("fk_defects_inspection_id")
        ),
        sa.PrimaryKeyConstraint("inspection_id", "number", name=op.f("pk_defects")),
    )
    op.create_table(
        "skipped",
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("image", sa.Text(), nullable=False),
        sa.Column("taken_ms", sa.BigInteger(), nullable=False),
        sa.Column("skipped_ms", sa.BigInteger(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        _line("skipped"),
        sa.PrimaryKeyConstraint("line_id", "image", name=op.f("pk_skipped")),
    )
    op.create_index("ix_skipped_taken", "skipped", ["line_id", "taken_ms"])


def _create_loop() -> None:
    op.create_table(
        "innovations",
        sa.Column("innovation_id", _id(), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("inspection_id", _id(), nullable=True),
        sa.Column("at_ms", sa.BigInteger(), nullable=False),
        sa.Column("surprise", sa.Double(), nullable=False),
        *(sa.Column(name, sa.Double(), nullable=False) for name in ("lightness", "redness", "yellowness")),
        sa.Column("accepted", sa.Boolean(), nullable=False),
        sa.Column("signals", sa.Text(), nullable=False),
        _line("innovations"),
        sa.ForeignKeyConstraint(
            ["inspection_id"], ["inspections.inspection_id"], name=op.f("fk_innovations_inspection_id")
        ),
        sa.PrimaryKeyConstraint("innovation_id", name=op.f("pk_innovations")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_innovations_run", "innovations", ["line_id", "run_id", "innovation_id"])
    op.create_index("ix_innovations_at", "innovations", ["line_id", "at_ms"])
    op.create_table(
        "remembered",
        sa.Column("line_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("kept_ms", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        _line("remembered"),
        sa.PrimaryKeyConstraint("line_id", "name", name=op.f("pk_remembered")),
    )
    op.create_table(
        "proposals",
        sa.Column("proposal_id", _id(), nullable=False),
        sa.Column("line_id", sa.Integer(), nullable=False),
        sa.Column("run_id", sa.Integer(), nullable=False),
        sa.Column("made_ms", sa.BigInteger(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("drift", sa.Text(), nullable=False),
        sa.Column("answered_ms", sa.BigInteger(), nullable=True),
        sa.Column("number", sa.Integer(), nullable=True),
        sa.Column("answer", sa.Text(), nullable=False),
        sa.CheckConstraint("number >= 1", name=op.f("ck_proposals_number")),
        sa.CheckConstraint("number IS NULL OR answered_ms IS NOT NULL", name=op.f("ck_proposals_answered")),
        _line("proposals"),
        sa.PrimaryKeyConstraint("proposal_id", name=op.f("pk_proposals")),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_proposals_run", "proposals", ["line_id", "run_id", "proposal_id"])
    _partial_index("ix_proposals_unanswered", "proposals", ["line_id", "proposal_id"], "answered_ms IS NULL")


def _id() -> sa.types.TypeEngine[int]:
    return sa.Integer().with_variant(sa.BigInteger(), "postgresql")


def _line(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["line_id"], ["lines.line_id"], name=op.f(f"fk_{table}_line_id"))


def _partial_index(name: str, table: str, columns: list[str], where: str, *, unique: bool = False) -> None:
    op.create_index(name, table, columns, unique=unique, sqlite_where=sa.text(where), postgresql_where=sa.text(where))
