"""The line's journal: what was meant to be printed, put down before it is, and what became of it.

Every call that changes something is one transaction, on the disk when the call returns; if it raises, nothing of it is
visible. Only the thread that opened a journal may use it.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from sqlalchemy import URL, Connection, Row, delete, func, insert, select, update

from tilefab.control.ledger import MOST_FACES, UNSETTLED, ArmState, FaceStates, check_transition
from tilefab.errors import JournalError
from tilefab.io import journal_queries as queries
from tilefab.io.journal_records import ArmChange, ArmRecord, Intent, NoteRecord, RunFacts, RunRecord
from tilefab.io.journal_schema import MOST_SESSIONS, arms, lines, notes, reprints, runs
from tilefab.io.journal_store import Store

__all__ = ["ArmChange", "ArmRecord", "Intent", "Journal", "NoteRecord", "RunFacts", "RunRecord", "sqlite_url"]

MOST_NOTES = 100_000
"""How many notes of a line are kept, besides the newest of each kind."""

_MOST_REASON = 500
_MOST_DETAIL = 16_000
_MOST_ID = (1 << 63) - 1
_TIDY_EVERY = 1000


def sqlite_url(path: Path) -> str:
    """Url of a journal in a file."""
    return URL.create("sqlite", database=str(path)).render_as_string()


class Journal:
    """Made by `Journal.open` or `Journal.look`; a context manager that closes.

    Every method raises `JournalError` if the database fails, or if what is asked would contradict the ledger.
    """

    def __init__(self, store: Store, line: str, now: Callable[[], datetime]) -> None:
        self._store, self._line, self._now = store, line, now
        self._thread = threading.get_ident()
        self._closed = False
        self._line_id = -1
        self._written = 0
        self._counts: dict[int, dict[ArmState, int]] = {}

    @classmethod
    def open(cls, url: str, *, line: str, now: Callable[[], datetime] | None = None) -> Journal:
        """Open a line's journal to write it; made or brought up to date if need be.

        Parameters
        ----------
        url
            ``sqlite:////folder/file`` (see `sqlite_url`) or ``postgresql://...``.
        line
            Name of the line, 1 to 100 characters. PostgreSQL serves many lines at once, each with one daemon; a file
            serves one daemon.
        now
            Clock for the times put down.

        Raises
        ------
        JournalError
            If it can't be opened or trusted, is of a newer schema, or another daemon writes it.
        """
        journal = cls(Store(url, line=line, read_only=False), line, now or _utc_now)
        try:
            with journal._transaction("open") as connection:
                found = connection.execute(select(lines.c.line_id).where(lines.c.name == line)).scalar()
                if found is None:
                    values = {"name": line, "last_session": 0, "last_arm": 0}
                    found = connection.execute(insert(lines).values(values).returning(lines.c.line_id)).scalar_one()
                journal._line_id = found
                journal._prune(connection)
        except BaseException:
            journal.close()
            raise
        return journal

    @classmethod
    def look(cls, url: str, *, line: str) -> Journal:
        """Open a line's journal only to read it, while its daemon runs or not.

        Raises
        ------
        JournalError
            If there is none, or it is of another schema.
        """
        journal = cls(Store(url, line=line, read_only=True), line, _utc_now)
        try:
            with journal._transaction("look") as connection:
                found = connection.execute(select(lines.c.line_id).where(lines.c.name == line)).scalar()
            if found is None:
                raise JournalError(f"{journal._store.name}: knows no line {line!r}: check the line's name")
            journal._line_id = found
        except BaseException:
            journal.close()
            raise
        return journal

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close it; twice is once."""
        self._check_thread()
        self._closed = True
        self._store.close()

    @property
    def lost(self) -> bool:
        """Whether it failed in a way after which only opening it anew helps."""
        return self._store.lost

    def check(self) -> None:
        """Read and compare everything; see `Store.check`."""
        self._check_thread()
        self._store.check()

    # Sessions and numbers

    def begin_session(self, *, above: int = 0) -> int:
        """Number of a new session with the devices: above every earlier one, and above ``above``; below 2**32."""
        with self._transaction("begin a session") as connection:
            session = max(self._last(connection, "last_session"), above) + 1
            if session >= MOST_SESSIONS:
                raise self._error(f"session {session} doesn't fit into 32 bits: reset the printer's memory of sessions")
            self._set_line(connection, last_session=session)
            return session

    def last_arm(self) -> int:
        """Highest arm ever handed out, 0 if none."""
        with self._transaction("read the last arm") as connection:
            return self._last(connection, "last_arm")

    def skip_arms(self, last: int) -> None:
        """Hand out only arms above ``last`` from now on, as for a printer that remembers those of a lost journal."""
        with self._transaction("skip arms") as connection:
            if not 0 <= last < _MOST_ID:
                raise self._error(f"arm {last} isn't one")
            self._set_line(connection, last_arm=max(last, self._last(connection, "last_arm")))

    # Runs

    def start_run(self, facts: RunFacts) -> int:
        """Begin a run, or go on with this line's run of the same job; returns its number.

        A job is never begun a second time, since that would print each face once more. A run of more faces than before
        goes on behind the last of them, also if it was finished.

        Raises
        ------
        JournalError
            If every face of the job was printed already, or the run can't go on as these facts have it.
        """
        if not 1 <= facts.faces <= MOST_FACES or not 0 <= facts.seed <= _MOST_ID:
            raise self._error(f"a run of {facts.faces} faces with seed {facts.seed} can't be")
        values = {name: getattr(facts, name) for name in RunFacts.__dataclass_fields__}
        with self._transaction("start a run") as connection:
            found = queries.newest_run(connection, self._line_id, facts.job_hash)
            if found is None:
                values |= {"line_id": self._line_id, "begun_ms": self._now_ms()}
                return int(connection.execute(insert(runs).values(values).returning(runs.c.run_id)).scalar_one())
            for name in ("seed", "map_hash"):
                if getattr(found, name) != getattr(facts, name):
                    raise self._error(
                        f"run {found.run_id} of {facts.name!r:.100} began with {name} {getattr(found, name)}, not "
                        f"{getattr(facts, name)}: put back its texture map"
                    )
            if facts.faces < found.faces:
                raise self._error(
                    f"run {found.run_id} of {facts.name!r:.100} began with {found.faces} faces, it can't go on with "
                    f"{facts.faces}: put back its count"
                )
            states = queries.face_states(connection, self._line_id, found.run_id, facts.faces)
            left = states.next_new < facts.faces or states.gaps or states.unprinted or states.reprints
            if found.finished_ms is not None and not left:
                raise self._error(
                    f"run {found.run_id} printed all {found.faces} faces of {facts.name!r:.100}: for more of them "
                    "raise its count, for others change its seed, for single ones order reprints"
                )
            changes = {"name": facts.name, "job_file": facts.job_file, "faces": facts.faces, "finished_ms": None}
            connection.execute(update(runs).where(runs.c.run_id == found.run_id).values(changes))
            return int(found.run_id)

    def finish_run(self, run_id: int, *, abandoned: bool = False) -> None:
        """Put down that a run is over; refused while arms are open.

        Parameters
        ----------
        run_id
            The run; one that is finished stays so.
        abandoned
            Whether faces may be left unprinted. A note says how many.
        """
        with self._transaction("finish a run") as connection:
            run = self._run(connection, run_id)
            if run.finished_ms is not None:
                return
            states = queries.face_states(connection, self._line_id, run_id, run.faces)
            still_open = sum(state is not ArmState.IN_DOUBT for _, _, state in states.unsettled)
            left = run.faces - states.next_new + sum(end - begin for begin, end in states.gaps)
            left += len(states.unprinted) + len(states.reprints)
            if still_open or (left and not abandoned):
                what = f"{still_open} arms are open" if still_open else f"{left} faces are to be printed"
                raise self._error(f"run {run_id} can't be finished: {what}")
            connection.execute(update(runs).where(runs.c.run_id == run_id).values(finished_ms=self._now_ms()))
            self._note(connection, "run_finished", {"run_id": run_id, "faces_left": left})

    def runs(self, *, last: int = 50) -> list[RunRecord]:
        """The newest runs, oldest first."""
        with self._transaction("read runs") as connection:
            query = select(runs).where(runs.c.line_id == self._line_id).order_by(runs.c.run_id.desc()).limit(last)
            return [queries.run_record(row) for row in reversed(connection.execute(query).all())]

    # Arms

    def intend(self, run_id: int, faces: Sequence[tuple[int, int]]) -> list[Intent]:
        """Put down, in one commit, faces that are about to be printed.

        Parameters
        ----------
        run_id
            An unfinished run.
        faces
            Faces, each with the number of the attempt: 1 for the first, then one more than the last.

        Returns
        -------
        list of Intent
            In the order of ``faces``, with rising arms above all that this line ever had.

        Raises
        ------
        JournalError
            If a face isn't to be printed: it is under way, in doubt, or may have been printed and no reprint was
            ordered. Nothing is put down then.
        """
        if not faces:
            return []
        with self._transaction("intend faces") as connection:
            run = self._run(connection, run_id)
            if run.finished_ms is not None:
                raise self._error(f"run {run_id} is finished: start it anew")
            if len({face for face, _ in faces}) < len(faces):
                raise self._error("a face is intended twice at once")
            known = queries.last_arms(connection, run_id, [face for face, _ in faces])
            last_arm, now = self._last(connection, "last_arm"), self._now_ms()
            if last_arm > _MOST_ID - len(faces):
                raise self._error("there are no arms left")
            intents, rows = [], []
            for arm_id, (face, attempt) in enumerate(faces, last_arm + 1):
                reprint = self._reprint_of(connection, run, face, attempt, known.get(face))
                intents.append(Intent(arm_id, run_id, face, attempt))
                rows.append(
                    {
                        "line_id": self._line_id,
                        "arm_id": arm_id,
                        "run_id": run_id,
                        "face": face,
                        "attempt": attempt,
                        "reprint": reprint,
                        "state": ArmState.INTENT.value,
                        "reason": "",
                        "intended_ms": now,
                        "changed_ms": now,
                    }
                )
            connection.execute(insert(arms), rows)
            self._set_line(connection, last_arm=intents[-1].arm_id)
        self._count(run_id, ArmState.INTENT, len(intents))
        return intents

    def mark(self, changes: Sequence[ArmChange]) -> None:
        """Put down, in one commit, what became of arms; all or, if one isn't allowed, none.

        An arm that is open may be given its own state again, to add facts. Changes of one arm take effect in order.
        """
        if not changes:
            return
        counted: list[tuple[int, ArmState, int]] = []
        with self._transaction("mark arms") as connection:
            known = queries.states(connection, self._line_id, {change.arm_id for change in changes})
            for change in changes:
                if change.arm_id not in known:
                    raise self._error(f"arm {change.arm_id} isn't in the journal")
                run_id, old = known[change.arm_id]
                if change.state is not old or old not in UNSETTLED:
                    self._check_transition(change.arm_id, old, change.state, by_operator=False)
                self._change(connection, change, old)
                known[change.arm_id] = run_id, change.state
                counted += [(run_id, old, -1), (run_id, change.state, 1)]
        for run_id, state, many in counted:
            self._count(run_id, state, many)

    def settle(self, run_id: int, face: int, state: ArmState) -> ArmRecord:
        """Put down what an operator found of a face in doubt: passed, diverted or unprinted; returns its arm.

        A finished run is taken up again if the face is to be printed after all.
        """
        with self._transaction("settle a face") as connection:
            arm = queries.last_arms(connection, self._run(connection, run_id).run_id, [face]).get(face)
            if arm is None or arm.state != ArmState.IN_DOUBT:
                raise self._error(f"face {face} of run {run_id} isn't in doubt: there is nothing to settle")
            self._check_transition(arm.arm_id, ArmState.IN_DOUBT, state, by_operator=True)
            self._change(connection, ArmChange(arm.arm_id, state, reason="settled by the operator"), ArmState.IN_DOUBT)
            if state is ArmState.UNPRINTED:
                self._reopen(connection, run_id)
            self._note(connection, "settled", {"run_id": run_id, "face": face, "state": state.value})
            settled = queries.arm_record(queries.last_arms(connection, run_id, [face])[face])
        self._count(run_id, ArmState.IN_DOUBT, -1)
        self._count(run_id, state, 1)
        return settled

    def order_reprint(self, run_id: int, face: int) -> int:
        """Put down that an operator wants a face printed once more; returns the attempt it will be.

        Ordering again before it was printed changes nothing. A finished run is taken up again.
        """
        with self._transaction("order a reprint") as connection:
            run = self._run(connection, run_id)
            arm = queries.last_arms(connection, run_id, [face]).get(face)
            where = f"face {face} of run {run_id}"
            if not 0 <= face < run.faces:
                raise self._error(f"{where} isn't one of its {run.faces} faces")
            if arm is None or arm.state == ArmState.UNPRINTED:
                raise self._error(f"{where} is still to be printed: a reprint would be one too many")
            if arm.state in UNSETTLED:
                advice = "settle it first" if arm.state == ArmState.IN_DOUBT else "wait until its tile is through"
                raise self._error(f"{where} is {arm.state}: {advice}")
            ordered = queries.last_reprint(connection, run_id, face)
            if ordered == (arm.reprint or 0):
                values = {"run_id": run_id, "face": face, "number": ordered + 1, "ordered_ms": self._now_ms()}
                connection.execute(insert(reprints).values(values))
                self._reopen(connection, run_id)
                self._note(connection, "reprint_ordered", {"run_id": run_id, "face": face})
            return int(arm.attempt) + 1

    def arms(
        self,
        run_id: int | None = None,
        *,
        states: Sequence[ArmState] | frozenset[ArmState] | None = None,
        last: int | None = None,
    ) -> list[ArmRecord]:
        """Arms of a run or of all, in some states or in any, all or only the newest; rising.

        Those not settled are found quickly however many there are.
        """
        with self._transaction("read arms") as connection:
            return [
                queries.arm_record(row) for row in queries.find_arms(connection, self._line_id, run_id, states, last)
            ]

    def face_states(self, run_id: int) -> FaceStates:
        """Where the faces of a run stand: what a `FaceQueue` begins with."""
        with self._transaction("read faces") as connection:
            return queries.face_states(connection, self._line_id, run_id, self._run(connection, run_id).faces)

    def counts(self, run_id: int) -> dict[ArmState, int]:
        """How many arms of a run are in each state; read once, then kept."""
        self._check_thread()
        if run_id not in self._counts or self._store.read_only:
            with self._transaction("count arms") as connection:
                self._run(connection, run_id)
                self._counts[run_id] = queries.count_arms(connection, self._line_id, run_id)
        return dict(self._counts[run_id])

    # Notes

    def note(self, kind: str, **detail: object) -> None:
        """Put down an event; ``detail`` as JSON, what that doesn't know as text. Old ones go, see `MOST_NOTES`."""
        with self._transaction("make a note") as connection:
            self._note(connection, kind, detail)

    def notes(self, last: int = 50) -> list[NoteRecord]:
        """The newest notes, oldest first."""
        with self._transaction("read notes") as connection:
            query = select(notes).where(notes.c.line_id == self._line_id).order_by(notes.c.note_id.desc()).limit(last)
            return [queries.note_record(row) for row in reversed(connection.execute(query).all())]

    def latest_note(self, kind: str) -> NoteRecord | None:
        """The newest note of a kind, or ``None``."""
        with self._transaction("read a note") as connection:
            ours = (notes.c.line_id == self._line_id) & (notes.c.kind == kind)
            row = connection.execute(select(notes).where(ours).order_by(notes.c.note_id.desc()).limit(1)).first()
            return queries.note_record(row) if row is not None else None

    # Within a transaction

    @contextmanager
    def _transaction(self, what: str) -> Iterator[Connection]:
        self._check_thread()
        if self._closed:
            raise self._error(f"can't {what}: it is closed")
        with self._store.transaction(what) as connection:
            yield connection
        self._written += 1
        if self._written % _TIDY_EVERY == 0 and not self._store.read_only:
            self._store.tidy()

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise self._error("is used from another thread than the one that opened it: this is a defect")

    def _error(self, message: str) -> JournalError:
        return JournalError(f"{self._store.name}: {message}", path=self._store.name)

    def _now_ms(self) -> int:
        return round(self._now().timestamp() * 1000)

    def _last(self, connection: Connection, column: str) -> int:
        return int(connection.execute(select(lines.c[column]).where(lines.c.line_id == self._line_id)).scalar_one())

    def _set_line(self, connection: Connection, **values: int) -> None:
        connection.execute(update(lines).where(lines.c.line_id == self._line_id).values(values))

    def _run(self, connection: Connection, run_id: int) -> Row[Any]:
        ours = (runs.c.line_id == self._line_id) & (runs.c.run_id == run_id)
        row = connection.execute(select(runs).where(ours)).first()
        if row is None:
            raise self._error(f"line {self._line!r} has no run {run_id}")
        return row

    def _reopen(self, connection: Connection, run_id: int) -> None:
        run = self._run(connection, run_id)
        if run.finished_ms is None:
            return
        connection.execute(update(runs).where(runs.c.run_id == run_id).values(finished_ms=None))

    def _reprint_of(
        self, connection: Connection, run: Row[Any], face: int, attempt: int, last: Row[Any] | None
    ) -> int | None:
        """Number of the operator's order that an attempt serves; raises if it isn't to be made."""
        where = f"face {face} of run {run.run_id}"
        if not 0 <= face < run.faces:
            raise self._error(f"{where} isn't one of its {run.faces} faces")
        expected = 1 if last is None else last.attempt + 1
        if attempt != expected:
            raise self._error(f"{where}: its next attempt is {expected}, not {attempt}")
        if last is None:
            return None
        if last.state == ArmState.UNPRINTED:
            return last.reprint  # type: ignore[no-any-return]
        if last.state not in UNSETTLED:
            ordered = queries.last_reprint(connection, run.run_id, face)
            if ordered > (last.reprint or 0):
                return ordered
        raise self._error(f"{where} is {last.state} and no reprint was ordered: it may not be printed again")

    def _check_transition(self, arm_id: int, old: ArmState, new: ArmState, *, by_operator: bool) -> None:
        try:
            check_transition(old, new, by_operator=by_operator)
        except ValueError as error:
            raise self._error(f"arm {arm_id}: {error}") from error

    def _change(self, connection: Connection, change: ArmChange, old: ArmState) -> None:
        values: dict[str, object] = {"state": change.state.value, "changed_ms": self._now_ms()}
        values |= {name: value for name in queries.FACTS if (value := getattr(change, name)) is not None}
        if change.reason:
            values["reason"] = change.reason[:_MOST_REASON]
        ours = (arms.c.line_id == self._line_id) & (arms.c.arm_id == change.arm_id) & (arms.c.state == old.value)
        if connection.execute(update(arms).where(ours).values(values)).rowcount != 1:
            raise self._error(f"arm {change.arm_id} was changed by another program: end that one")

    def _count(self, run_id: int, state: ArmState, many: int) -> None:
        if run_id in self._counts:
            self._counts[run_id][state] += many

    def _note(self, connection: Connection, kind: str, detail: dict[str, object]) -> None:
        told = json.dumps(detail, ensure_ascii=False, default=str)
        if len(told) > _MOST_DETAIL:
            told = json.dumps({"shortened": told[:_MOST_DETAIL]}, ensure_ascii=False)
        values = {"line_id": self._line_id, "at_ms": self._now_ms(), "kind": kind, "detail": told}
        note_id = connection.execute(insert(notes).values(values).returning(notes.c.note_id)).scalar_one()
        if note_id % _TIDY_EVERY == 0:
            self._prune(connection)

    def _prune(self, connection: Connection) -> None:
        """Let old notes go, but for the newest of each kind."""
        ours = notes.c.line_id == self._line_id
        oldest = select(notes.c.note_id).where(ours).order_by(notes.c.note_id.desc()).offset(MOST_NOTES - 1).limit(1)
        bound = connection.execute(oldest).scalar()
        if bound is not None:
            kept = select(func.max(notes.c.note_id)).where(ours).group_by(notes.c.kind)
            connection.execute(delete(notes).where(ours, notes.c.note_id < bound, notes.c.note_id.not_in(kept)))


def _utc_now() -> datetime:
    return datetime.now(UTC)
