"""What every part of the line's journal rests on: opening and closing, transactions, the line's counters, notes."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from types import TracebackType
from typing import Self

from sqlalchemy import Connection, delete, func, insert, select, update

from tilefab.errors import JournalError
from tilefab.io import journal_queries as queries
from tilefab.io.journal_records import NoteRecord
from tilefab.io.journal_schema import lines, notes
from tilefab.io.journal_store import Store

MOST_NOTES = 100_000
"""How many notes of a line are kept, besides the newest of each kind; of each of `FREQUENT` ones so many of its own."""

FREQUENT = ("kiln", "gauged")
"""Kinds of notes that come so often that they would push the others out."""

_MOST_DETAIL = 16_000
_TIDY_EVERY = 1000


class JournalBase:
    """A line's journal, open; see `tilefab.io.journal.Journal`."""

    def __init__(self, store: Store, line: str, now: Callable[[], datetime]) -> None:
        self._store, self._line, self._now = store, line, now
        self._thread = threading.get_ident()
        self._closed = False
        self._line_id = -1
        self._written = 0

    @classmethod
    def open(cls, url: str, *, line: str, now: Callable[[], datetime] | None = None) -> Self:
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
    def look(cls, url: str, *, line: str) -> Self:
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

    def __enter__(self) -> Self:
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

    def notes_between(
        self, since: datetime, until: datetime | None = None, *, kinds: Collection[str] | None = None
    ) -> list[NoteRecord]:
        """Notes put down from a time on and before another, of some kinds or of all, oldest first."""
        with self._transaction("read notes") as connection:
            query = select(notes).where(notes.c.line_id == self._line_id, notes.c.at_ms >= milliseconds(since))
            if until is not None:
                query = query.where(notes.c.at_ms < milliseconds(until))
            if kinds is not None:
                query = query.where(notes.c.kind.in_(sorted(kinds)))
            return [queries.note_record(row) for row in connection.execute(query.order_by(notes.c.note_id))]

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
        return milliseconds(self._now())

    def _last(self, connection: Connection, column: str) -> int:
        return int(connection.execute(select(lines.c[column]).where(lines.c.line_id == self._line_id)).scalar_one())

    def _set_line(self, connection: Connection, **values: int) -> None:
        connection.execute(update(lines).where(lines.c.line_id == self._line_id).values(values))

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
        newest = select(func.max(notes.c.note_id)).where(ours).group_by(notes.c.kind)
        for which in (notes.c.kind.not_in(FREQUENT), *(notes.c.kind == kind for kind in FREQUENT)):
            kept = select(notes.c.note_id).where(ours, which).order_by(notes.c.note_id.desc())
            bound = connection.execute(kept.offset(MOST_NOTES - 1).limit(1)).scalar()
            if bound is not None:
                old = delete(notes).where(ours, which, notes.c.note_id < bound)
                connection.execute(old.where(notes.c.note_id.not_in(newest)))


def milliseconds(time: datetime) -> int:
    """A time as the tables hold it: milliseconds since 1970."""
    return round(time.timestamp() * 1000)


def _utc_now() -> datetime:
    return datetime.now(UTC)
