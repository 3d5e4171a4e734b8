"""The line's journal: what was meant to be printed, put down before it is, and what became of it.

Every call that changes something is one transaction, on the disk when the call returns; if it raises, nothing of it is
visible. Only the thread that opened a journal may use it.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Row, insert, select, update

from tilefab.control.ledger import MOST_FACES, UNSETTLED, ArmState, FaceStates, check_transition
from tilefab.io import journal_queries as queries
from tilefab.io.journal_base import JournalBase, milliseconds
from tilefab.io.journal_records import (
    ArmChange,
    ArmRecord,
    CorrectionRecord,
    Intent,
    NoteRecord,
    PrintRecord,
    RunFacts,
    RunRecord,
)
from tilefab.io.journal_schema import MOST_SESSIONS, arms, corrections, reprints, runs
from tilefab.io.journal_store import Store

__all__ = [
    "ArmChange",
    "ArmRecord",
    "CorrectionRecord",
    "Intent",
    "Journal",
    "NoteRecord",
    "PrintRecord",
    "RunFacts",
    "RunRecord",
    "sqlite_url",
]

_MOST_REASON = 500
_MOST_ID = (1 << 63) - 1
_TIMED = {ArmState.PRINTED: "printed_ms", ArmState.PASSED: "passed_ms"}
"""Columns that tell when arms came into a state."""


def sqlite_url(path: Path) -> str:
    """Url of a journal in a file."""
    return URL.create("sqlite", database=str(path)).render_as_string()


class Journal(JournalBase):
    """Made by `Journal.open` or `Journal.look`; a context manager that closes.

    Every method raises `JournalError` if the database fails, or if what is asked would contradict the ledger.
    """

    def __init__(self, store: Store, line: str, now: Callable[[], datetime]) -> None:
        super().__init__(store, line, now)
        self._counts: dict[int, dict[ArmState, int]] = {}

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
            return queries.find_runs(connection, self._line_id, last)

    # Corrections

    def correct(self, run_id: int, *, press_key: str, drift: str, reason: str) -> CorrectionRecord:
        """Put down a correction of a run.

        Parameters
        ----------
        run_id
            An unfinished run.
        press_key, drift, reason
            See `CorrectionRecord`.
        """
        with self._transaction("correct a run") as connection:
            if self._run(connection, run_id).finished_ms is not None:
                raise self._error(f"run {run_id} is finished: there is nothing left to correct")
            number = queries.last_correction(connection, run_id) + 1
            values = {"number": number, "press_key": press_key, "drift": drift, "reason": reason[:_MOST_REASON]}
            connection.execute(insert(corrections).values(run_id=run_id, made_ms=self._now_ms(), **values))
            return queries.find_corrections(connection, run_id, [number])[0]

    def corrections(self, run_id: int, numbers: Collection[int] | None = None) -> list[CorrectionRecord]:
        """Corrections of a run, all or some, in order."""
        with self._transaction("read corrections") as connection:
            self._run(connection, run_id)
            return queries.find_corrections(connection, run_id, numbers)

    def latest_correction(self, run_id: int) -> CorrectionRecord | None:
        """The correction that a run's next faces are printed with; ``None``: as its job says."""
        with self._transaction("read the latest correction") as connection:
            self._run(connection, run_id)
            number = queries.last_correction(connection, run_id)
            return queries.find_corrections(connection, run_id, [number])[0] if number else None

    # Arms

    def intend(self, run_id: int, faces: Sequence[tuple[int, int]], *, correction: int = 0) -> list[Intent]:
        """Put down, in one commit, faces that are about to be printed.

        Parameters
        ----------
        run_id
            An unfinished run.
        faces
            Faces, each with the number of the attempt: 1 for the first, then one more than the last.
        correction
            Which of the run's corrections they are printed with; 0: none.

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
            if correction and not queries.find_corrections(connection, run_id, [correction]):
                raise self._error(f"run {run_id} has no correction {correction}")
            if len({face for face, _ in faces}) < len(faces):
                raise self._error("a face is intended twice at once")
            known = queries.last_arms(connection, run_id, [face for face, _ in faces])
            last_arm, now = self._last(connection, "last_arm"), self._now_ms()
            if last_arm > _MOST_ID - len(faces):
                raise self._error("there are no arms left")
            intents, rows = [], []
            for arm_id, (face, attempt) in enumerate(faces, last_arm + 1):
                reprint = self._reprint_of(connection, run, face, attempt, known.get(face))
                intents.append(Intent(arm_id, run_id, face, attempt, correction))
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
                        "correction": correction,
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

    def arm_of(self, run_id: int, face: int) -> ArmRecord | None:
        """The last arm of a face, ``None`` if it was never tried."""
        with self._transaction("read an arm") as connection:
            found = queries.last_arms(connection, self._run(connection, run_id).run_id, [face]).get(face)
            return None if found is None else queries.arm_record(found)

    def prints(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> list[PrintRecord]:
        """Arms whose faces were printed whole, by the time that the journal heard of it; quick also in a long journal.

        Parameters
        ----------
        run_id
            Only this run's.
        since, until
            Only those printed then or later, and before then.
        """
        with self._transaction("read prints") as connection:
            times = [None if time is None else milliseconds(time) for time in (since, until)]
            return queries.find_prints(connection, self._line_id, run_id, *times)

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

    # Within a transaction

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
        now = self._now_ms()
        values: dict[str, object] = {"state": change.state.value, "changed_ms": now}
        # What an operator found out was so before he said it: nobody knows since when.
        timed = _TIMED.get(change.state)
        if timed is not None and change.state is not old and old is not ArmState.IN_DOUBT:
            values[timed] = now
        values |= {name: value for name in queries.FACTS if (value := getattr(change, name)) is not None}
        if change.reason:
            values["reason"] = change.reason[:_MOST_REASON]
        ours = (arms.c.line_id == self._line_id) & (arms.c.arm_id == change.arm_id) & (arms.c.state == old.value)
        if connection.execute(update(arms).where(ours).values(values)).rowcount != 1:
            raise self._error(f"arm {change.arm_id} was changed by another program: end that one")

    def _count(self, run_id: int, state: ArmState, many: int) -> None:
        if run_id in self._counts:
            self._counts[run_id][state] += many
