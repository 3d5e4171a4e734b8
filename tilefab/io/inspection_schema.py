"""Tables of what inspection found out, beside the journal and never in it.

Types are portable between SQLite and PostgreSQL. Times are milliseconds since 1970 (UTC). Runs and arms are the
journal's numbers; nothing here refers to it by keys, since the two may be different databases. Alembic's scripts in
``inspection_migrations`` lead to this schema; a test compares the two.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
    text,
)

from tilefab.inspection.records import DefectKind, Grade, ImageProblem
from tilefab.io.journal_schema import metadata as journal_metadata

HEAD = "0001"
"""Revision that this module describes."""

POSTGRES_SCHEMA = "tilefab_inspection"
"""Where these tables are in PostgreSQL: the journal's own may be in the same database."""

FIGURES = (
    "delta_e_mean",
    "delta_e_p95",
    "delta_e_worst",
    "worst_x_mm",
    "worst_y_mm",
    "cmc_mean",
    "cmc_p95",
    "lightness",
    "chroma",
    "hue",
    "fired_l",
    "fired_a",
    "fired_b",
    "predicted_l",
    "predicted_a",
    "predicted_b",
)
"""Columns of a tile's colour."""

SIZES = ("width_mm", "height_mm", "size_percent", "straightness_percent", "rectangularity_percent")
"""Columns of a tile's dimensions."""

WATCHED = ("lightness", "redness", "yellowness")
"""Columns of what an innovation says of L*, a* and b*."""

# Partial indexes are used only where a query says the same, word for word.
DETAILED = text("detail <> ''")
KEPT = text("badness IS NOT NULL")
RAISED = text("cleared_ms IS NULL")
UNANSWERED = text("answered_ms IS NULL")

metadata = MetaData(naming_convention=journal_metadata.naming_convention)
_ID = Integer().with_variant(BigInteger, "postgresql")


def _one_of(column: str, values: type[DefectKind] | type[Grade] | type[ImageProblem]) -> CheckConstraint:
    return CheckConstraint(f"{column} IN ({', '.join(repr(value.value) for value in values)})", name=column)


lines = Table(
    "lines",
    metadata,
    Column("line_id", Integer, primary_key=True),
    Column("name", Text, nullable=False, unique=True),
)

inspections = Table(
    "inspections",
    metadata,
    Column("inspection_id", _ID, primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("image", Text, nullable=False),
    Column("taken_ms", BigInteger, nullable=False),
    Column("inspected_ms", BigInteger, nullable=False),
    Column("run_id", Integer),
    Column("face", BigInteger),
    Column("arm_id", BigInteger),
    Column("correction", Integer),
    Column("printed_ms", BigInteger),
    Column("repeat", Boolean(create_constraint=False), nullable=False),
    Column("problem", Text),
    Column("grade", Text, nullable=False),
    Column("confidence", Double, nullable=False),
    Column("visible", Double, nullable=False),
    Column("shade_lot", Text, nullable=False),
    *(Column(name, Double) for name in FIGURES),
    *(Column(name, Double) for name in SIZES),
    Column("badness", Double),
    Column("predicted_picture", Text, nullable=False),
    Column("fired_picture", Text, nullable=False),
    Column("detail", Text, nullable=False),
    UniqueConstraint("line_id", "image"),
    _one_of("problem", ImageProblem),
    _one_of("grade", Grade),
    CheckConstraint("face >= 0", name="face"),
    CheckConstraint("correction >= 0", name="correction"),
    CheckConstraint("face IS NULL OR run_id IS NOT NULL", name="face_of_run"),
    sqlite_autoincrement=True,
)
Index("ix_inspections_taken", inspections.c.line_id, inspections.c.taken_ms)
Index("ix_inspections_run", inspections.c.line_id, inspections.c.run_id, inspections.c.taken_ms)
Index("ix_inspections_arm", inspections.c.line_id, inspections.c.arm_id)
Index(
    "ix_inspections_detailed",
    inspections.c.line_id,
    inspections.c.inspection_id,
    sqlite_where=DETAILED,
    postgresql_where=DETAILED,
)
Index(
    "ix_inspections_kept",
    inspections.c.line_id,
    inspections.c.run_id,
    inspections.c.badness,
    sqlite_where=KEPT,
    postgresql_where=KEPT,
)

defects = Table(
    "defects",
    metadata,
    Column("inspection_id", _ID, ForeignKey("inspections.inspection_id"), primary_key=True, autoincrement=False),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("kind", Text, nullable=False),
    *(
        Column(name, Double, nullable=False)
        for name in ("x_mm", "y_mm", "width_mm", "height_mm", "area_mm2", "delta_e", "severity")
    ),
    Column("grade", Text, nullable=False),
    _one_of("kind", DefectKind),
    _one_of("grade", Grade),
    CheckConstraint("number >= 0", name="number"),
)

skipped = Table(
    "skipped",
    metadata,
    Column("line_id", Integer, ForeignKey("lines.line_id"), primary_key=True),
    Column("image", Text, primary_key=True),
    Column("taken_ms", BigInteger, nullable=False),
    Column("skipped_ms", BigInteger, nullable=False),
    Column("reason", Text, nullable=False),
)
Index("ix_skipped_taken", skipped.c.line_id, skipped.c.taken_ms)

innovations = Table(
    "innovations",
    metadata,
    Column("innovation_id", _ID, primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("run_id", Integer, nullable=False),
    Column("inspection_id", _ID, ForeignKey("inspections.inspection_id")),
    Column("at_ms", BigInteger, nullable=False),
    Column("surprise", Double, nullable=False),
    *(Column(name, Double, nullable=False) for name in WATCHED),
    Column("accepted", Boolean(create_constraint=False), nullable=False),
    Column("signals", Text, nullable=False),
    sqlite_autoincrement=True,
)
Index("ix_innovations_run", innovations.c.line_id, innovations.c.run_id, innovations.c.innovation_id)
Index("ix_innovations_at", innovations.c.line_id, innovations.c.at_ms)

remembered = Table(
    "remembered",
    metadata,
    Column("line_id", Integer, ForeignKey("lines.line_id"), primary_key=True, autoincrement=False),
    Column("name", Text, primary_key=True),
    Column("kept_ms", BigInteger, nullable=False),
    Column("state", Text, nullable=False),
)

proposals = Table(
    "proposals",
    metadata,
    Column("proposal_id", _ID, primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("run_id", Integer, nullable=False),
    Column("made_ms", BigInteger, nullable=False),
    Column("reason", Text, nullable=False),
    Column("drift", Text, nullable=False),
    Column("answered_ms", BigInteger),
    Column("number", Integer),
    Column("answer", Text, nullable=False),
    CheckConstraint("number >= 1", name="number"),
    CheckConstraint("number IS NULL OR answered_ms IS NOT NULL", name="answered"),
    sqlite_autoincrement=True,
)
Index("ix_proposals_run", proposals.c.line_id, proposals.c.run_id, proposals.c.proposal_id)
Index(
    "ix_proposals_unanswered",
    proposals.c.line_id,
    proposals.c.proposal_id,
    sqlite_where=UNANSWERED,
    postgresql_where=UNANSWERED,
)

alarms = Table(
    "alarms",
    metadata,
    Column("alarm_id", _ID, primary_key=True),
    Column("line_id", Integer, ForeignKey("lines.line_id"), nullable=False),
    Column("run_id", Integer),
    Column("code", Text, nullable=False),
    Column("subject", Text, nullable=False),
    Column("text", Text, nullable=False),
    Column("raised_ms", BigInteger, nullable=False),
    Column("cleared_ms", BigInteger),
    Column("told", Boolean(create_constraint=False), nullable=False),
    sqlite_autoincrement=True,
)
Index("ix_alarms_raised_ms", alarms.c.line_id, alarms.c.raised_ms)
Index(
    "ix_alarms_up",
    alarms.c.line_id,
    alarms.c.code,
    alarms.c.subject,
    unique=True,
    sqlite_where=RAISED,
    postgresql_where=RAISED,
)
