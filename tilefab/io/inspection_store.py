"""What inspection found out, kept beside the line's journal: tiles, defects, innovations, proposals, alarms.

Every call that changes something is one transaction, on the disk when the call returns; several become one within
`InspectionStore.together`. Only the thread that opened a store may use it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from sqlalchemy import Connection, delete, insert, select, update

from tilefab.errors import JournalError
from tilefab.inspection.records import DefectKind, Grade, TileInspection
from tilefab.io import inspection_queries as queries
from tilefab.io.inspection_database import InspectionDatabase, NothingInspectedError
from tilefab.io.inspection_json import inspection_from_json
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
    DETAILED,
    RAISED,
    WATCHED,
    alarms,
    defects,
    innovations,
    inspections,
    lines,
    proposals,
    remembered,
    skipped,
)

MOST_DETAILED = 100_000
"""Of so many tiles of a line, the newest, everything is kept; of older ones the figures."""

_TIDY_EVERY = 1000
_MOST_TEXT = 1000


class InspectionStore:
    """Made by `InspectionStore.open` or `InspectionStore.look`; a context manager that closes.

    Every method raises `JournalError` if the database fails.
    """

    def __init__(self, database: InspectionDatabase, line: str, now: Callable[[], datetime]) -> None:
        self._database, self._line, self._now = database, line, now
        self._thread = threading.get_ident()
        self._closed = False
        self._line_id = -1
        self._joined: Connection | None = None
        self._added = 0

    @classmethod
    def open(cls, url: str, *, line: str, now: Callable[[], datetime] | None = None) -> InspectionStore:
        """Open a line's store to write it; made or brought up to date if need be.

        Parameters
        ----------
        url
            ``sqlite:////folder/file`` of a file of its own, or ``postgresql://...``, which may be the journal's.
        line
            Name of the line, as in its journal.
        now
            Clock for the times put down.

        Raises
        ------
        JournalError
            If it can't be opened or trusted, is of a newer schema, or another inspector writes it.
        """
        store = cls(InspectionDatabase(url, line=line, read_only=False), line, now or _utc_now)
        try:
            with store._transaction("open") as connection:
                found = connection.execute(select(lines.c.line_id).where(lines.c.name == line)).scalar()
                if found is None:
                    found = connection.execute(insert(lines).values(name=line).returning(lines.c.line_id)).scalar_one()
                store._line_id = found
                store._prune(connection)
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def look(cls, url: str, *, line: str) -> InspectionStore:
        """Open a line's store only to read it, while its inspector runs or not.

        Raises
        ------
        NothingInspectedError
            If there is none.
        JournalError
            If it can't be read, or is of another schema.
        """
        store = cls(InspectionDatabase(url, line=line, read_only=True), line, _utc_now)
        try:
            with store._transaction("look") as connection:
                found = connection.execute(select(lines.c.line_id).where(lines.c.name == line)).scalar()
            if found is None:
                raise NothingInspectedError(f"{store._database.name}: knows no line {line!r}: check the line's name")
            store._line_id = found
        except BaseException:
            store.close()
            raise
        return store

    @classmethod
    def exists(cls, url: str, line: str) -> bool:
        """Whether anything of a line was ever inspected.

        Raises
        ------
        JournalError
            If that can't be found out.
        """
        try:
            cls.look(url, line=line).close()
        except NothingInspectedError:
            return False
        return True

    def __enter__(self) -> InspectionStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close it; twice is once."""
        self._check_thread()
        self._closed = True
        self._database.close()

    @property
    def lost(self) -> bool:
        """Whether it failed in a way after which only opening it anew helps."""
        return self._database.lost

    @contextmanager
    def together(self, what: str) -> Iterator[None]:
        """Make all changes within the block one transaction: all on the disk when it is left, or none."""
        with self._transaction(what) as connection:
            self._joined = connection
            try:
                yield
            finally:
                self._joined = None

    # Tiles

    def add_tile(self, tile: SeenTile, pictures: Pictures | None = None) -> int:
        """Put down an image that was inspected; returns its number.

        Raises
        ------
        JournalError
            If that image was put down before.
        """
        with self._transaction(f"put down {tile.image:.80}") as connection:
            values = queries.tile_values(tile, pictures)
            values |= {"line_id": self._line_id, "inspected_ms": self._now_ms()}
            made = insert(inspections).values(values).returning(inspections.c.inspection_id)
            inspection_id = int(connection.execute(made).scalar_one())
            rows = queries.defect_rows(inspection_id, tile.inspection.defects)
            if rows:
                connection.execute(insert(defects), rows)
            self._added += 1
            if self._added % _TIDY_EVERY == 0:
                self._prune(connection)
            return inspection_id

    def drop_pictures(self, inspection_ids: Collection[int]) -> None:
        """Put down that pictures of tiles are kept no longer."""
        if not inspection_ids:
            return
        with self._transaction("drop pictures") as connection:
            ours = inspections.c.line_id == self._line_id, inspections.c.inspection_id.in_(list(inspection_ids))
            gone = {"badness": None, "predicted_picture": "", "fired_picture": ""}
            connection.execute(update(inspections).where(*ours).values(gone))

    def skip(self, images: Sequence[SkippedImage]) -> None:
        """Put down images that will not be inspected; those that are down already stay as they are."""
        with self._transaction("skip images") as connection:
            known = queries.done_images(connection, self._line_id, [image.image for image in images])
            rows = [
                {
                    "line_id": self._line_id,
                    "image": image.image,
                    "taken_ms": queries.milliseconds(image.taken_at),
                    "skipped_ms": self._now_ms(),
                    "reason": image.reason[:_MOST_TEXT],
                }
                for image in {image.image: image for image in images}.values()
                if image.image not in known
            ]
            if rows:
                connection.execute(insert(skipped), rows)

    def done_images(self, names: Sequence[str]) -> frozenset[str]:
        """Those of some images that were inspected or skipped."""
        with self._transaction("read images") as connection:
            return queries.done_images(connection, self._line_id, names)

    def seen_arms(self, arm_ids: Sequence[int]) -> frozenset[int]:
        """Those of some arms whose tiles were seen."""
        with self._transaction("read arms") as connection:
            return queries.seen_arms(connection, self._line_id, arm_ids)

    def tiles(
        self,
        run_id: int | None = None,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        face: int | None = None,
        last: int | None = None,
    ) -> list[InspectionRecord]:
        """Inspections of a run or of all, taken from ``since`` to before ``until``, in the order they were taken.

        Parameters
        ----------
        run_id, since, until
            ``None``: any.
        face
            Only those of one face.
        last
            Only the newest so many.
        """
        with self._transaction("read inspections") as connection:
            return queries.tiles(connection, self._line_id, run_id, since, until, face, last)

    def tile_of_image(self, image: str) -> InspectionRecord | None:
        """The inspection of an image."""
        with self._transaction("read an inspection") as connection:
            return queries.tile_of_image(connection, self._line_id, image)

    def full(self, inspection_id: int) -> TileInspection | None:
        """All that was found out about a tile; ``None`` if it is too long ago, see `MOST_DETAILED`, or unknown.

        Raises
        ------
        JournalError
            If what is in the store can't be read.
        """
        with self._transaction("read an inspection") as connection:
            ours = inspections.c.line_id == self._line_id, inspections.c.inspection_id == inspection_id
            detail = connection.execute(select(inspections.c.detail).where(*ours)).scalar()
        if not detail:
            return None
        try:
            return inspection_from_json(detail)
        except ValueError as error:
            raise self._error(f"inspection {inspection_id} is of another version or damaged: {error}") from error

    def worst(self, run_id: int | None = None, *, last: int = 10) -> list[InspectionRecord]:
        """Tiles of a run, or of all, whose pictures are kept, the worst first."""
        with self._transaction("read inspections") as connection:
            return queries.worst(connection, self._line_id, run_id, last)

    def grades(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> dict[Grade, int]:
        """Tiles by grade, each tile once; only those that were recognised."""
        with self._transaction("count grades") as connection:
            return queries.grades(connection, self._line_id, run_id, since, until)

    def defects(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> list[DefectRecord]:
        """Defects of recognised tiles, in the order in which the tiles were seen; of each tile the worst first."""
        with self._transaction("read defects") as connection:
            return queries.defects_of(connection, self._line_id, run_id, since, until)

    def defect_counts(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> dict[DefectKind, int]:
        """How many tiles had a defect of each kind, the most frequent first."""
        with self._transaction("count defects") as connection:
            return queries.defect_counts(connection, self._line_id, run_id, since, until)

    def shade_lots(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> list[ShadeLotRecord]:
        """Shade lots of the tiles, by name."""
        with self._transaction("read shade lots") as connection:
            return queries.shade_lots(connection, self._line_id, run_id, since, until)

    def skipped(self, *, since: datetime | None = None, until: datetime | None = None) -> list[SkippedImage]:
        """Images that weren't inspected, in the order they were taken."""
        with self._transaction("read skipped images") as connection:
            return queries.skipped_images(connection, self._line_id, since, until)

    # The loop

    def add_innovation(self, innovation: InnovationRecord) -> None:
        """Put down what the controller and its charts made of a tile."""
        with self._transaction("put down an innovation") as connection:
            values = {
                "line_id": self._line_id,
                "run_id": innovation.run_id,
                "inspection_id": innovation.inspection_id,
                "at_ms": queries.milliseconds(innovation.at),
                "surprise": innovation.surprise,
                **dict(zip(WATCHED, innovation.values, strict=True)),
                "accepted": innovation.accepted,
                "signals": " ".join(innovation.signals),
            }
            connection.execute(insert(innovations).values(values))

    def innovations(
        self, run_id: int | None = None, *, since: datetime | None = None, until: datetime | None = None
    ) -> list[InnovationRecord]:
        """Innovations of a run, or of all, in the order in which they came."""
        with self._transaction("read innovations") as connection:
            return queries.innovations_of(connection, self._line_id, run_id, since, until)

    def remember(self, name: str, state: str) -> None:
        """Put down what must be remembered under a name; replaces what was before."""
        with self._transaction(f"remember {name:.80}") as connection:
            ours = remembered.c.line_id == self._line_id, remembered.c.name == name
            values = {"kept_ms": self._now_ms(), "state": state}
            if connection.execute(update(remembered).where(*ours).values(values)).rowcount == 0:
                connection.execute(insert(remembered).values(line_id=self._line_id, name=name, **values))

    def remembered(self, name: str) -> str | None:
        """What was remembered under a name."""
        with self._transaction(f"read what was remembered of {name:.80}") as connection:
            ours = remembered.c.line_id == self._line_id, remembered.c.name == name
            return connection.execute(select(remembered.c.state).where(*ours)).scalar()

    def propose(self, run_id: int, reason: str, drift: str) -> int:
        """Put down a correction that is proposed; returns its number."""
        with self._transaction("put down a proposal") as connection:
            values = {
                "line_id": self._line_id,
                "run_id": run_id,
                "made_ms": self._now_ms(),
                "reason": reason[:_MOST_TEXT],
                "drift": drift,
                "answer": "",
            }
            made = insert(proposals).values(values).returning(proposals.c.proposal_id)
            return int(connection.execute(made).scalar_one())

    def answer(self, proposal_id: int, *, number: int | None, answer: str = "") -> None:
        """Put down what became of a proposal: the correction's number in the journal, or why there is none."""
        with self._transaction("put down an answer") as connection:
            ours = proposals.c.line_id == self._line_id, proposals.c.proposal_id == proposal_id
            values = {"answered_ms": self._now_ms(), "number": number, "answer": answer[:_MOST_TEXT]}
            connection.execute(update(proposals).where(*ours).values(values))

    def proposals(
        self,
        run_id: int | None = None,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        unanswered: bool = False,
    ) -> list[ProposalRecord]:
        """Corrections as proposed and answered, oldest first; all, or only those without an answer."""
        with self._transaction("read proposals") as connection:
            return queries.proposals_of(connection, self._line_id, run_id, since, until, unanswered=unanswered)

    # Alarms

    def raise_alarm(self, code: str, text: str, *, subject: str = "", run_id: int | None = None) -> int | None:
        """Put down an alarm; returns its number, or ``None`` if one of this code and subject is up already."""
        with self._transaction("raise an alarm") as connection:
            ours = alarms.c.line_id == self._line_id, alarms.c.code == code, alarms.c.subject == subject, RAISED
            if connection.execute(select(alarms.c.alarm_id).where(*ours)).first() is not None:
                return None
            values = {
                "line_id": self._line_id,
                "run_id": run_id,
                "code": code,
                "subject": subject,
                "text": text[:_MOST_TEXT],
                "raised_ms": self._now_ms(),
                "told": False,
            }
            return int(connection.execute(insert(alarms).values(values).returning(alarms.c.alarm_id)).scalar_one())

    def clear_alarm(self, code: str, *, subject: str = "") -> bool:
        """Put down that what an alarm was about is over; whether one was up."""
        with self._transaction("clear an alarm") as connection:
            ours = alarms.c.line_id == self._line_id, alarms.c.code == code, alarms.c.subject == subject, RAISED
            return connection.execute(update(alarms).where(*ours).values(cleared_ms=self._now_ms())).rowcount > 0

    def alarm_told(self, alarm_id: int) -> None:
        """Put down that the line's daemon was told of an alarm."""
        with self._transaction("put down an alarm as told") as connection:
            ours = alarms.c.line_id == self._line_id, alarms.c.alarm_id == alarm_id
            connection.execute(update(alarms).where(*ours).values(told=True))

    def alarms(
        self,
        run_id: int | None = None,
        *,
        since: datetime | None = None,
        until: datetime | None = None,
        up: bool = False,
    ) -> list[InspectionAlarm]:
        """Alarms raised in a run, or in any, oldest first; all, or only those still up."""
        with self._transaction("read alarms") as connection:
            return queries.alarms_of(connection, self._line_id, run_id, since, until, up=up)

    # Within a transaction

    @contextmanager
    def _transaction(self, what: str) -> Iterator[Connection]:
        self._check_thread()
        if self._closed:
            raise self._error(f"can't {what}: it is closed")
        if self._joined is not None:
            with self._database.explained(what):
                yield self._joined
            return
        with self._database.transaction(what) as connection:
            yield connection

    def _prune(self, connection: Connection) -> None:
        """Let details of old tiles go, and the oldest skipped images."""
        ours = inspections.c.line_id == self._line_id
        newest = select(inspections.c.inspection_id).where(ours, DETAILED).order_by(inspections.c.inspection_id.desc())
        bound = connection.execute(newest.offset(MOST_DETAILED).limit(1)).scalar()
        if bound is not None:
            old = inspections.c.inspection_id <= bound
            connection.execute(update(inspections).where(ours, DETAILED, old).values(detail=""))
        mine = skipped.c.line_id == self._line_id
        latest = select(skipped.c.taken_ms).where(mine).order_by(skipped.c.taken_ms.desc())
        oldest = connection.execute(latest.offset(MOST_DETAILED).limit(1)).scalar()
        if oldest is not None:
            connection.execute(delete(skipped).where(mine, skipped.c.taken_ms <= oldest))

    def _check_thread(self) -> None:
        if threading.get_ident() != self._thread:
            raise self._error("is used from another thread than the one that opened it: this is a defect")

    def _error(self, message: str) -> JournalError:
        return JournalError(f"{self._database.name}: {message}", path=self._database.name)

    def _now_ms(self) -> int:
        return queries.milliseconds(self._now())


def _utc_now() -> datetime:
    return datetime.now(UTC)


def pictures_folder(state_directory: Path) -> Path:
    """Folder of kept pictures of a line."""
    return state_directory / "inspection_pictures"
