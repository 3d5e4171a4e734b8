"""What the journal asks its tables: each within a transaction of the caller."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import Connection, Row, and_, exists, func, select

from tilefab.control.ledger import UNSETTLED, ArmState, FaceStates
from tilefab.io.journal_records import ArmRecord, CorrectionRecord, NoteRecord, PrintRecord, RunFacts, RunRecord
from tilefab.io.journal_schema import (
    PRINTED_ARMS,
    UNPRINTED_ARMS,
    UNSETTLED_ARMS,
    arms,
    corrections,
    reprints,
    runs,
)

FACTS = ("detect_seq", "tile_seq", "printer_boot", "plc_boot", "rows_printed", "data_crc32")
"""Columns of arms that hold what the devices told."""

_PRINT_COLUMNS = (
    "run_id",
    "arm_id",
    "face",
    "attempt",
    "correction",
    "data_crc32",
    "state",
    "printed_ms",
    "passed_ms",
)
"""In the order of the fields of `PrintRecord`."""

_STATES = {state.value: state for state in ArmState}

_MOST_AT_ONCE = 500
"""Faces or arms asked for in one statement: databases bound its length."""


def newest_run(connection: Connection, line_id: int, job_hash: str) -> Row[Any] | None:
    """The line's newest run of a job, over or not."""
    query = select(runs).where(runs.c.line_id == line_id, runs.c.job_hash == job_hash)
    return connection.execute(query.order_by(runs.c.run_id.desc()).limit(1)).first()


def last_arms(connection: Connection, run_id: int, faces: Sequence[int]) -> dict[int, Row[Any]]:
    """The last arm of each of some faces that have one."""
    found: dict[int, Row[Any]] = {}
    for begin in range(0, len(faces), _MOST_AT_ONCE):
        asked = arms.c.face.in_(faces[begin : begin + _MOST_AT_ONCE])
        query = select(arms).where(arms.c.run_id == run_id, asked).order_by(arms.c.attempt)
        found |= {row.face: row for row in connection.execute(query)}
    return found


def last_reprint(connection: Connection, run_id: int, face: int) -> int:
    """Number of the last reprint that was ordered of a face, 0 if none."""
    query = select(func.max(reprints.c.number)).where(reprints.c.run_id == run_id, reprints.c.face == face)
    return int(connection.execute(query).scalar() or 0)


def states(connection: Connection, line_id: int, arm_ids: Iterable[int]) -> dict[int, tuple[int, ArmState]]:
    """Run and state of each of some arms."""
    ids = sorted(arm_ids)
    found: dict[int, tuple[int, ArmState]] = {}
    for begin in range(0, len(ids), _MOST_AT_ONCE):
        asked = arms.c.arm_id.in_(ids[begin : begin + _MOST_AT_ONCE])
        query = select(arms.c.arm_id, arms.c.run_id, arms.c.state).where(arms.c.line_id == line_id, asked)
        found |= {row.arm_id: (int(row.run_id), ArmState(row.state)) for row in connection.execute(query)}
    return found


def find_arms(
    connection: Connection, line_id: int, run_id: int | None, wanted: Collection[ArmState] | None, last: int | None
) -> Sequence[Row[Any]]:
    """Arms in rising order; see `Journal.arms`."""
    of_line, of_run = arms.c.line_id == line_id, arms.c.run_id == run_id
    few = wanted is not None and UNSETTLED.issuperset(wanted)
    if few:
        # Sums, so that no other index looks better than the one that holds only these few.
        of_line, of_run = arms.c.line_id + 0 == line_id, arms.c.run_id + 0 == run_id
    query = select(arms).where(of_line)
    if few:
        query = query.where(UNSETTLED_ARMS)
    if run_id is not None:
        query = query.where(of_run)
    if wanted is not None:
        query = query.where(arms.c.state.in_([state.value for state in wanted]))
    if last is None:
        return connection.execute(query.order_by(arms.c.arm_id)).all()
    return connection.execute(query.order_by(arms.c.arm_id.desc()).limit(last)).all()[::-1]


def find_prints(
    connection: Connection, line_id: int, run_id: int | None, since_ms: int | None, until_ms: int | None
) -> list[PrintRecord]:
    """Arms whose faces were printed whole, by the time of that; see `Journal.prints`."""
    columns = [arms.c[name] for name in _PRINT_COLUMNS]
    of_line, of_run = arms.c.line_id == line_id, arms.c.run_id == run_id
    timed = since_ms is not None or until_ms is not None
    # Sums, so that the index of times looks better than that of the run's faces, or the other way round.
    if run_id is not None and timed:
        of_run = arms.c.run_id + 0 == run_id
    elif run_id is not None:
        of_line = arms.c.line_id + 0 == line_id
    query = select(*columns).where(of_line, PRINTED_ARMS)
    if run_id is not None:
        query = query.where(of_run)
    if since_ms is not None:
        query = query.where(arms.c.printed_ms >= since_ms)
    if until_ms is not None:
        query = query.where(arms.c.printed_ms < until_ms)
    # A run may have a million of them: rows are taken apart at once, not name by name.
    return [
        PrintRecord(run, arm, face, attempt, correction, crc, _STATES[state], _time(printed_ms), _maybe_time(passed_ms))
        for run, arm, face, attempt, correction, crc, state, printed_ms, passed_ms in connection.execute(
            query.order_by(arms.c.printed_ms, arms.c.arm_id)
        )
    ]


def find_runs(connection: Connection, line_id: int, last: int) -> list[RunRecord]:
    """The newest runs of a line, oldest first."""
    latest = select(func.max(corrections.c.number)).where(corrections.c.run_id == runs.c.run_id).scalar_subquery()
    query = select(runs, latest.label("correction")).where(runs.c.line_id == line_id)
    rows = connection.execute(query.order_by(runs.c.run_id.desc()).limit(last)).all()
    return [_run_record(row) for row in reversed(rows)]


def last_correction(connection: Connection, run_id: int) -> int:
    """Number of a run's latest correction, 0 if none."""
    query = select(func.max(corrections.c.number)).where(corrections.c.run_id == run_id)
    return int(connection.execute(query).scalar() or 0)


def find_corrections(
    connection: Connection, run_id: int, numbers: Collection[int] | None = None
) -> list[CorrectionRecord]:
    """A run's corrections, all or some, in order."""
    query = select(corrections).where(corrections.c.run_id == run_id)
    if numbers is not None:
        query = query.where(corrections.c.number.in_(sorted(numbers)))
    return [
        CorrectionRecord(row.run_id, row.number, row.press_key, row.drift, row.reason, _time(row.made_ms))
        for row in connection.execute(query.order_by(corrections.c.number))
    ]


def count_arms(connection: Connection, line_id: int, run_id: int) -> dict[ArmState, int]:
    """Arms of a run by state."""
    ours = and_(arms.c.line_id == line_id, arms.c.run_id == run_id)
    query = select(arms.c.state, func.count()).where(ours).group_by(arms.c.state)
    found = {ArmState(state): int(many) for state, many in connection.execute(query)}
    return {state: found.get(state, 0) for state in ArmState}


def face_states(connection: Connection, line_id: int, run_id: int, faces: int) -> FaceStates:
    """Where the faces of a run stand."""
    tried = select(func.max(arms.c.face), func.count()).where(arms.c.run_id == run_id, arms.c.attempt == 1)
    highest, many = connection.execute(tried).one()
    next_new = 0 if highest is None else highest + 1
    unsettled = select(arms.c.face, arms.c.attempt, arms.c.state).where(
        arms.c.line_id == line_id, arms.c.run_id == run_id, UNSETTLED_ARMS
    )
    return FaceStates(
        faces=faces,
        next_new=next_new,
        gaps=_gaps(connection, run_id) if many < next_new else (),
        unprinted=_unprinted(connection, run_id),
        reprints=_open_reprints(connection, run_id),
        unsettled=tuple(
            (row.face, row.attempt, ArmState(row.state)) for row in connection.execute(unsettled.order_by(arms.c.face))
        ),
    )


def _gaps(connection: Connection, run_id: int) -> tuple[tuple[int, int], ...]:
    """Ranges of faces below the highest tried that were left out."""
    before = func.lag(arms.c.face, 1, -1).over(order_by=arms.c.face) + 1
    tried = select(before.label("begin"), arms.c.face.label("end"))
    pairs = tried.where(arms.c.run_id == run_id, arms.c.attempt == 1).subquery()
    query = select(pairs.c.begin, pairs.c.end).where(pairs.c.begin < pairs.c.end).order_by(pairs.c.begin)
    return tuple((int(begin), int(end)) for begin, end in connection.execute(query))


def _unprinted(connection: Connection, run_id: int) -> tuple[tuple[int, int], ...]:
    """Faces whose last attempt printed nothing, each with that attempt."""
    later = arms.alias("later")
    none_later = ~exists().where(
        later.c.run_id == arms.c.run_id, later.c.face == arms.c.face, later.c.attempt > arms.c.attempt
    )
    query = select(arms.c.face, arms.c.attempt).where(arms.c.run_id == run_id, UNPRINTED_ARMS, none_later)
    return tuple((int(face), int(attempt)) for face, attempt in connection.execute(query.order_by(arms.c.face)))


def _open_reprints(connection: Connection, run_id: int) -> tuple[tuple[int, int], ...]:
    """Faces with an order that no attempt was made for, each with its last attempt, oldest order first."""
    none_made = ~exists().where(
        arms.c.run_id == reprints.c.run_id, arms.c.face == reprints.c.face, arms.c.reprint == reprints.c.number
    )
    query = select(reprints.c.face).where(reprints.c.run_id == run_id, none_made)
    ordered = [
        int(face) for face in connection.execute(query.order_by(reprints.c.ordered_ms, reprints.c.face)).scalars()
    ]
    last = last_arms(connection, run_id, ordered)
    return tuple((face, last[face].attempt) for face in ordered)


def _time(milliseconds: int) -> datetime:
    return datetime.fromtimestamp(milliseconds / 1000, UTC)


def _maybe_time(milliseconds: int | None) -> datetime | None:
    return None if milliseconds is None else _time(milliseconds)


def _run_record(row: Row[Any]) -> RunRecord:
    facts = RunFacts(**{name: getattr(row, name) for name in RunFacts.__dataclass_fields__})
    return RunRecord(row.run_id, facts, _time(row.begun_ms), _maybe_time(row.finished_ms), row.correction or 0)


def arm_record(row: Row[Any]) -> ArmRecord:
    """A row of the table, for the journal's callers."""
    plain = ("arm_id", "run_id", "face", "attempt", "reprint", *FACTS, "reason", "correction")
    return ArmRecord(
        **{name: getattr(row, name) for name in plain},
        state=ArmState(row.state),
        intended_at=_time(row.intended_ms),
        changed_at=_time(row.changed_ms),
        printed_at=_maybe_time(row.printed_ms),
        passed_at=_maybe_time(row.passed_ms),
    )


def note_record(row: Row[Any]) -> NoteRecord:
    """A row of the table, for the journal's callers."""
    return NoteRecord(row.note_id, _time(row.at_ms), row.kind, json.loads(row.detail))
