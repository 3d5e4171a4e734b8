"""The database under the store of inspections: as the journal's, with tables of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

from sqlalchemy import Engine, event, inspect, text

from tilefab.errors import JournalError
from tilefab.io.inspection_schema import HEAD, POSTGRES_SCHEMA
from tilefab.io.journal_store import Store, migrate

_FOLDER = Path(__file__).parent / "inspection_migrations"
_NONE = "nothing was inspected yet: start tilefab line inspect once"


class NothingInspectedError(JournalError):
    """There is no store of inspections, or it knows nothing of a line."""


class InspectionDatabase(Store):
    """One connection to a database of inspections.

    Parameters
    ----------
    url
        ``sqlite:////folder/file``: a file of its own; or ``postgresql://...``: may be the journal's database, the
        tables are in a schema of their own.
    line
        Name of the line, 1 to 80 characters.
    read_only
        For lookers-on: takes no lock, changes nothing.

    Raises
    ------
    JournalError
        As for the journal's.
    """

    def __init__(self, url: str, *, line: str, read_only: bool) -> None:
        # In PostgreSQL the lock's key is made of this name: the line's daemon holds one of its own.
        super().__init__(url, line=f"inspection of {line}", read_only=read_only)

    def _make_engine(self) -> Engine:
        engine = super()._make_engine()
        if not self.is_sqlite:
            # Before the dialect asks for its default schema, so that it, and alembic, look into ours.
            event.listen(engine, "connect", self._choose_schema, insert=True)
        return engine

    def _choose_schema(self, driver: Any, _: object) -> None:
        before, driver.autocommit = driver.autocommit, True
        try:
            with driver.cursor() as cursor:
                if not self.read_only:
                    cursor.execute(f"CREATE SCHEMA IF NOT EXISTS {POSTGRES_SCHEMA}")
                cursor.execute(f"SET SESSION search_path = {POSTGRES_SCHEMA}")
        finally:
            driver.autocommit = before

    def _bring_up_to_date(self) -> None:
        with self.connection.begin():
            if not (self.is_sqlite or self.read_only):
                # Lines of one plant may start at the same moment.
                self.connection.execute(text(f"SELECT pg_advisory_xact_lock(hashtext('{POSTGRES_SCHEMA}'))"))
            found = None
            schema = None if self.is_sqlite else POSTGRES_SCHEMA
            if self._check_present(inspect(self.connection).get_table_names(schema=schema)):
                found = self.connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
            if found == HEAD:
                return
            if self.read_only and found is None:
                raise NothingInspectedError(f"{self.name}: {_NONE}", path=self.name)
            migrate(self.connection, found, self.name, read_only=self.read_only, folder=_FOLDER)

    def _check_file(self, path: Path) -> None:
        if self.read_only and path.parent.is_dir() and not path.exists():
            raise NothingInspectedError(f"{path}: {_NONE}", path=str(path))
        super()._check_file(path)

    def _check_present(self, tables: list[str]) -> bool:
        present = super()._check_present(tables)
        if present and "arms" in tables:
            raise JournalError(f"{self.name}: is a line's journal: name another for inspections", path=self.name)
        return present

    def _taken(self, holder: str = "") -> NoReturn:
        raise JournalError(f"{self.name}: another inspector{holder} works for this line: end it first", path=self.name)
