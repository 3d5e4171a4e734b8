"""What the store of inspections asks its tables: each within a transaction of the caller."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Column, ColumnElement, Connection, Row, Select, distinct, false, func, select

from tilefab.inspection.records import ColourFigures, Defect, DefectKind, Grade, ImageProblem
from tilefab.io.inspection_json import inspection_text
from tilefab.io.inspection_records import (
    DefectRecord,
    InnovationRecord,
    InspectionAlarm,
    InspectionRecord,
    Pictures,
    ProposalRecord,
    SeenTile,
    ShadeLotRecord,
    SkippedImage,
)
from tilefab.io.inspection_schema import (
    FIGURES,
    KEPT,
    RAISED,
    SIZES,
    UNANSWERED,
    alarms,
    defects,
    innovations,
    inspections,
    proposals,
    skipped,
)

_MOST_AT_ONCE = 500
"""Images or arms asked for in one statement: databases bound its length."""

_PLACE = ("x_mm", "y_mm", "width_mm", "height_mm", "area_mm2", "delta_e", "severity")
_SHOWN = [column for column in inspections.c if column.name != "detail"]


def milliseconds(at: datetime) -> int:
    """A time as the tables have it."""
    return round(at.timestamp() * 1000)


def _time(value: int) -> datetime:
    return datetime.fromtimestamp(value / 1000, UTC)


def _maybe(value: int | None) -> datetime | None:
    return None if value is None else _time(value)


# Rows


def tile_values(tile: SeenTile, pictures: Pictures | None) -> dict[str, Any]:
    """Columns of an inspection."""
    found, seen = tile.inspection, tile.inspection.recognition
    values: dict[str, Any] = {
        "image": tile.image,
        "taken_ms": milliseconds(tile.taken_at),
        "run_id": tile.run_id,
        "face": seen.face,
        "arm_id": tile.arm_id,
        "correction": tile.correction,
        "printed_ms": None if tile.printed_at is None else milliseconds(tile.printed_at),
        "repeat": tile.repeat,
        "problem": None if seen.problem is None else seen.problem.value,
        "grade": found.grade.value,
        "confidence": seen.confidence,
        "visible": seen.visible,
        "shade_lot": tile.shade_lot,
        "badness": None if pictures is None else pictures.badness,
        "predicted_picture": "" if pictures is None else pictures.predicted,
        "fired_picture": "" if pictures is None else pictures.fired,
        "detail": inspection_text(found),
    }
    if found.colour is not None:
        values |= dict(zip(FIGURES, _figures(found.colour), strict=True))
    if found.dimensions is not None:
        size = found.dimensions
        measured = (size.width_mm, size.height_mm, size.size_deviation_percent)
        values |= dict(zip(SIZES, (*measured, size.straightness_percent, size.rectangularity_percent), strict=True))
    return values


def _figures(colour: ColourFigures) -> tuple[float, ...]:
    first = (colour.delta_e_mean, colour.delta_e_p95, colour.delta_e_worst, *colour.worst_at_mm)
    middle = (colour.cmc_mean, colour.cmc_p95, colour.lightness, colour.chroma, colour.hue)
    return tuple(map(float, (*first, *middle, *colour.fired_lab, *colour.predicted_lab)))


def _colour(row: Row[Any]) -> ColourFigures | None:
    if row.delta_e_mean is None:
        return None
    return ColourFigures(
        delta_e_mean=row.delta_e_mean,
        delta_e_p95=row.delta_e_p95,
        delta_e_worst=row.delta_e_worst,
        worst_at_mm=(row.worst_x_mm, row.worst_y_mm),
        cmc_mean=row.cmc_mean,
        cmc_p95=row.cmc_p95,
        lightness=row.lightness,
        chroma=row.chroma,
        hue=row.hue,
        fired_lab=(row.fired_l, row.fired_a, row.fired_b),
        predicted_lab=(row.predicted_l, row.predicted_a, row.predicted_b),
    )


def defect_rows(inspection_id: int, found: Sequence[Defect]) -> list[dict[str, Any]]:
    """Rows of a tile's defects."""
    return [
        {
            "inspection_id": inspection_id,
            "number": number,
            "kind": defect.kind.value,
            **{name: float(getattr(defect, name)) for name in _PLACE},
            "grade": defect.grade.value,
        }
        for number, defect in enumerate(found)
    ]


def inspection_record(row: Row[Any]) -> InspectionRecord:
    """A row of the table, for the store's callers."""
    kept = row.badness is not None
    return InspectionRecord(
        inspection_id=int(row.inspection_id),
        image=row.image,
        taken_at=_time(row.taken_ms),
        inspected_at=_time(row.inspected_ms),
        run_id=row.run_id,
        face=row.face,
        arm_id=row.arm_id,
        correction=row.correction,
        printed_at=_maybe(row.printed_ms),
        repeat=bool(row.repeat),
        problem=None if row.problem is None else ImageProblem(row.problem),
        grade=Grade(row.grade),
        confidence=row.confidence,
        visible=row.visible,
        shade_lot=row.shade_lot,
        colour=_colour(row),
        sizes=None if row.width_mm is None else tuple(getattr(row, name) for name in SIZES),
        pictures=Pictures(row.badness, row.predicted_picture, row.fired_picture) if kept else None,
    )


# Questions


def done_images(connection: Connection, line_id: int, names: Sequence[str]) -> frozenset[str]:
    """Those of some images that were inspected or skipped."""
    found: set[str] = set()
    for begin in range(0, len(names), _MOST_AT_ONCE):
        asked = list(names[begin : begin + _MOST_AT_ONCE])
        for table in (inspections, skipped):
            query = select(table.c.image).where(table.c.line_id == line_id, table.c.image.in_(asked))
            found.update(connection.execute(query).scalars())
    return frozenset(found)


def seen_arms(connection: Connection, line_id: int, arm_ids: Sequence[int]) -> frozenset[int]:
    """Those of some arms whose tiles were seen."""
    found: set[int] = set()
    for begin in range(0, len(arm_ids), _MOST_AT_ONCE):
        asked = inspections.c.arm_id.in_(list(arm_ids[begin : begin + _MOST_AT_ONCE]))
        query = select(inspections.c.arm_id).where(inspections.c.line_id == line_id, asked)
        found.update(int(arm_id) for arm_id in connection.execute(query).scalars())
    return frozenset(found)


def tiles(
    connection: Connection,
    line_id: int,
    run_id: int | None,
    since: datetime | None,
    until: datetime | None,
    face: int | None,
    last: int | None,
) -> list[InspectionRecord]:
    """Inspections; see `InspectionStore.tiles`."""
    query = select(*_SHOWN).where(*_of(line_id, run_id, since, until))
    if face is not None:
        query = query.where(inspections.c.face == face)
    if last is None:
        rows = connection.execute(query.order_by(inspections.c.taken_ms, inspections.c.inspection_id)).all()
    else:
        newest = query.order_by(inspections.c.taken_ms.desc(), inspections.c.inspection_id.desc()).limit(last)
        rows = connection.execute(newest).all()[::-1]
    return [inspection_record(row) for row in rows]


def tile_of_image(connection: Connection, line_id: int, image: str) -> InspectionRecord | None:
    """The inspection of an image."""
    query = select(*_SHOWN).where(inspections.c.line_id == line_id, inspections.c.image == image)
    row = connection.execute(query).first()
    return None if row is None else inspection_record(row)


def worst(connection: Connection, line_id: int, run_id: int | None, last: int) -> list[InspectionRecord]:
    """Tiles whose pictures are kept, the worst first."""
    query = select(*_SHOWN).where(inspections.c.line_id == line_id, KEPT)
    if run_id is not None:
        query = query.where(inspections.c.run_id == run_id)
    ordered = query.order_by(inspections.c.badness.desc(), inspections.c.inspection_id).limit(last)
    return [inspection_record(row) for row in connection.execute(ordered)]


def grades(
    connection: Connection, line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> dict[Grade, int]:
    """Recognised tiles by grade."""
    query = select(inspections.c.grade, func.count()).where(*_tiles_of(line_id, run_id, since, until))
    found = {Grade(grade): int(many) for grade, many in connection.execute(query.group_by(inspections.c.grade))}
    return {grade: found.get(grade, 0) for grade in Grade}


def defects_of(
    connection: Connection, line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> list[DefectRecord]:
    """Defects of recognised tiles."""
    query = (
        select(
            defects,
            inspections.c.run_id,
            inspections.c.face,
            inspections.c.taken_ms,
        )
        .join(inspections, inspections.c.inspection_id == defects.c.inspection_id)
        .where(*_tiles_of(line_id, run_id, since, until))
        .order_by(inspections.c.taken_ms, inspections.c.inspection_id, defects.c.number)
    )
    return [
        DefectRecord(
            int(row.inspection_id),
            row.run_id,
            row.face,
            _time(row.taken_ms),
            Defect(kind=DefectKind(row.kind), grade=Grade(row.grade), **{name: getattr(row, name) for name in _PLACE}),
        )
        for row in connection.execute(query)
    ]


def defect_counts(
    connection: Connection, line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> dict[DefectKind, int]:
    """Tiles that had a defect of each kind."""
    many = func.count(distinct(defects.c.inspection_id))
    query = (
        select(defects.c.kind, many)
        .join(inspections, inspections.c.inspection_id == defects.c.inspection_id)
        .where(*_tiles_of(line_id, run_id, since, until))
        .group_by(defects.c.kind)
        .order_by(many.desc(), defects.c.kind)
    )
    return {DefectKind(kind): int(count) for kind, count in connection.execute(query)}


def shade_lots(
    connection: Connection, line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> list[ShadeLotRecord]:
    """Shade lots by name."""
    table = inspections.c
    query = (
        select(
            table.shade_lot,
            func.count().label("tiles"),
            func.min(table.taken_ms).label("first"),
            func.max(table.taken_ms).label("last"),
            *(func.avg(table[f"fired_{axis}"] - table[f"predicted_{axis}"]).label(axis) for axis in "lab"),
        )
        .where(*_tiles_of(line_id, run_id, since, until), table.shade_lot != "")
        .group_by(table.shade_lot)
    )
    found = [
        ShadeLotRecord(
            row.shade_lot,
            int(row.tiles),
            _time(row.first),
            _time(row.last),
            tuple(0.0 if offset is None else float(offset) for offset in (row.l, row.a, row.b)),  # type: ignore[arg-type]
        )
        for row in connection.execute(query)
    ]
    # Lots are named A to Z, then AA and on.
    return sorted(found, key=lambda lot: (len(lot.name), lot.name))


def skipped_images(
    connection: Connection, line_id: int, since: datetime | None, until: datetime | None
) -> list[SkippedImage]:
    """Images that weren't inspected."""
    query = select(skipped).where(skipped.c.line_id == line_id, *_between(skipped.c.taken_ms, since, until))
    ordered = query.order_by(skipped.c.taken_ms, skipped.c.image)
    return [SkippedImage(row.image, _time(row.taken_ms), row.reason) for row in connection.execute(ordered)]


def innovations_of(
    connection: Connection, line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> list[InnovationRecord]:
    """Innovations in the order in which they came."""
    query = select(innovations).where(innovations.c.line_id == line_id, *_between(innovations.c.at_ms, since, until))
    if run_id is not None:
        query = query.where(innovations.c.run_id == run_id)
    return [
        InnovationRecord(
            run_id=row.run_id,
            at=_time(row.at_ms),
            surprise=row.surprise,
            values=(row.lightness, row.redness, row.yellowness),
            accepted=bool(row.accepted),
            signals=tuple(row.signals.split()),
            inspection_id=row.inspection_id,
        )
        for row in connection.execute(query.order_by(innovations.c.innovation_id))
    ]


def proposals_of(
    connection: Connection,
    line_id: int,
    run_id: int | None,
    since: datetime | None,
    until: datetime | None,
    *,
    unanswered: bool,
) -> list[ProposalRecord]:
    """Proposals, oldest first."""
    query = select(proposals).where(proposals.c.line_id == line_id, *_between(proposals.c.made_ms, since, until))
    query = _narrowed(query, proposals.c.run_id, run_id)
    if unanswered:
        query = query.where(UNANSWERED)
    return [
        ProposalRecord(
            proposal_id=int(row.proposal_id),
            run_id=row.run_id,
            made_at=_time(row.made_ms),
            reason=row.reason,
            drift=row.drift,
            answered_at=_maybe(row.answered_ms),
            number=row.number,
            answer=row.answer,
        )
        for row in connection.execute(query.order_by(proposals.c.proposal_id))
    ]


def alarms_of(
    connection: Connection,
    line_id: int,
    run_id: int | None,
    since: datetime | None,
    until: datetime | None,
    *,
    up: bool,
) -> list[InspectionAlarm]:
    """Alarms, oldest first."""
    query = select(alarms).where(alarms.c.line_id == line_id, *_between(alarms.c.raised_ms, since, until))
    query = _narrowed(query, alarms.c.run_id, run_id)
    if up:
        query = query.where(RAISED)
    return [
        InspectionAlarm(
            alarm_id=int(row.alarm_id),
            run_id=row.run_id,
            code=row.code,
            subject=row.subject,
            text=row.text,
            raised_at=_time(row.raised_ms),
            cleared_at=_maybe(row.cleared_ms),
            told=bool(row.told),
        )
        for row in connection.execute(query.order_by(alarms.c.alarm_id))
    ]


def _narrowed(query: Select[Any], column: Column[Any], value: int | None) -> Select[Any]:
    return query if value is None else query.where(column == value)


def _of(line_id: int, run_id: int | None, since: datetime | None, until: datetime | None) -> list[ColumnElement[bool]]:
    wanted = [inspections.c.line_id == line_id, *_between(inspections.c.taken_ms, since, until)]
    if run_id is not None:
        wanted.append(inspections.c.run_id == run_id)
    return wanted


def _tiles_of(
    line_id: int, run_id: int | None, since: datetime | None, until: datetime | None
) -> list[ColumnElement[bool]]:
    """Each recognised tile once."""
    return [*_of(line_id, run_id, since, until), inspections.c.face.is_not(None), inspections.c.repeat == false()]


def _between(column: Column[Any], since: datetime | None, until: datetime | None) -> list[ColumnElement[bool]]:
    bounds: list[ColumnElement[bool]] = []
    if since is not None:
        bounds.append(column >= milliseconds(since))
    if until is not None:
        bounds.append(column < milliseconds(until))
    return bounds
