"""The database under the line's journal: one connection, durable commits, one writer a line, errors that explain."""

from __future__ import annotations

import fcntl
import hashlib
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, NoReturn
from urllib.parse import quote

from sqlalchemy import URL, Connection, Engine, create_engine, event, inspect, make_url, text
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from tilefab.errors import JournalError
from tilefab.io.journal_schema import HEAD

BUSY_SECONDS = 5.0
_CHECKED_BYTES = 32 << 20
_WAL_BYTES = 4 << 20
_MIGRATION_KEY = 0x74696C65
_POSTGRES_BOUNDS = {"connect_timeout": 5, "tcp_user_timeout": 10_000}
"""Seconds and milliseconds after which a silent server counts as lost."""

_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
_FOLDER = Path(__file__).parent / "journal_migrations"

_EXPLAINED = {
    sqlite3.SQLITE_FULL: ("there is no space left", "make room on its disk"),
    sqlite3.SQLITE_READONLY: ("it can't be written", "check the permissions of the file and its folder"),
    sqlite3.SQLITE_PERM: ("it can't be used", "check the permissions of the file and its folder"),
    sqlite3.SQLITE_CANTOPEN: ("it can't be opened", "check that its folder exists and may be written"),
    sqlite3.SQLITE_BUSY: ("another program holds it", "end that program, and try again"),
    sqlite3.SQLITE_LOCKED: ("another program holds it", "end that program, and try again"),
    sqlite3.SQLITE_IOERR: ("its disk failed", "check the disk, then start again"),
    sqlite3.SQLITE_CORRUPT: ("it is damaged", "keep the file for its makers, and put back a copy or move it away"),
    sqlite3.SQLITE_NOTADB: ("it is no journal, or damaged", "check the path, or put back a copy"),
}
_LOST = {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}


class Store:
    """One connection to a journal's database.

    Parameters
    ----------
    url
        ``sqlite:////folder/file`` or ``postgresql://...``.
    line
        Name of the line.
    read_only
        For lookers-on: takes no lock, changes nothing.

    Raises
    ------
    JournalError
        If there is no such database, it can't be trusted to keep what it is given, or is another daemon's.
    """

    def __init__(self, url: str, *, line: str, read_only: bool) -> None:
        if not 1 <= len(line) <= 100 or not line.isprintable():
            raise JournalError(f"journal of line {line!r:.120}: a line's name has 1 to 100 printable characters")
        self._url = _parse(url)
        self.is_sqlite = self._url.get_backend_name() == "sqlite"
        self.path = Path(self._url.database or "").resolve() if self.is_sqlite else None
        self.name = str(self.path) if self.path else self._url.render_as_string(hide_password=True)
        self._line, self.read_only = line, read_only
        self._lost = ""
        self._lock: IO[str] | None = None
        self._engine: Engine | None = None
        try:
            if self.path is not None:
                self._check_file(self.path)
                if not read_only:
                    self._lock = self._locked_file(self.path)
            with self.explained("open"):
                self._engine = self._make_engine()
                self.connection = self._engine.connect()
                self._settle_connection()
                self._bring_up_to_date()
        except BaseException:
            self.close()
            raise

    @contextmanager
    def transaction(self, what: str) -> Iterator[Connection]:
        """One transaction: durable on leaving, or undone as a whole.

        Parameters
        ----------
        what
            What is being done, for messages.

        Raises
        ------
        JournalError
            If the database refuses or fails. After a failure that leaves open what is on the disk, every later call
            raises: only opening the journal anew shows it.
        """
        if self._lost:
            raise JournalError(f"{self.name}: can't {what}: {self._lost}", path=self.name)
        with self.explained(what), self.connection.begin():
            yield self.connection

    @contextmanager
    def explained(self, what: str) -> Iterator[None]:
        """Turn every failure of the database into a `JournalError`."""
        try:
            yield
        except DBAPIError as error:
            self._refuse(what, error)
        except SQLAlchemyError as error:
            raise JournalError(f"{self.name}: can't {what}: {_first_line(error)}", path=self.name) from error
        except OSError as error:
            raise JournalError(
                f"{self.name}: can't {what}: {error.strerror}: check the path and its permissions", path=self.name
            ) from error
        except ImportError as error:
            raise JournalError(
                f"{self.name}: can't {what}: {error}: install tilefab[postgres]", path=self.name
            ) from error

    @property
    def lost(self) -> bool:
        """Whether the connection can't be used any more."""
        return bool(self._lost)

    def tidy(self) -> None:
        """Give back what the write-ahead log takes up, if lookers-on let it grow; never waits for them."""
        if self.path is None:
            return
        log = self.path.with_name(self.path.name + "-wal")
        if not log.exists() or log.stat().st_size <= 4 * _WAL_BYTES:
            return
        with self.explained("tidy up"):
            cursor = self._driver().cursor()
            cursor.execute("PRAGMA busy_timeout = 0")
            cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
            cursor.execute(f"PRAGMA busy_timeout = {round(1000 * BUSY_SECONDS)}").fetchall()

    def check(self) -> None:
        """Read everything and compare; takes a second a hundred megabytes or so.

        Raises
        ------
        JournalError
            If anything is damaged.
        """
        if self.is_sqlite:
            with self.transaction("check") as connection:
                found = connection.execute(text("PRAGMA integrity_check(1)")).scalar()
                broken = connection.execute(text("PRAGMA foreign_key_check")).first()
            if found != "ok" or broken is not None:
                self._damaged(str(found) if found != "ok" else "a row refers to one that isn't there")

    def close(self) -> None:
        """Give everything back; twice is once."""
        engine, self._engine = self._engine, None
        try:
            if engine is not None:
                with self.explained("close"):
                    if hasattr(self, "connection"):
                        self.connection.close()
                    engine.dispose()
        finally:
            if self._lock is not None:
                self._lock.close()
                self._lock = None

    def _check_file(self, path: Path) -> None:
        if not path.parent.is_dir():
            raise JournalError(f"{path}: its folder doesn't exist: make it, or name another", path=str(path))
        if path.is_dir():
            raise JournalError(f"{path}: is a folder: name a file", path=str(path))
        if self.read_only and not path.exists():
            raise JournalError(f"{path}: there is no journal: start the line once", path=str(path))

    def _locked_file(self, path: Path) -> IO[str]:
        """A file beside the database that its one writer holds locked, be it of this line or another."""
        with self.explained("lock"):
            lock = path.with_name(f"{path.name}.writer").open("a+", encoding="utf-8")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.seek(0)
            holder = lock.read(200).strip()
            lock.close()
            self._taken(f" ({holder})" if holder else "")
        except OSError as error:
            lock.close()
            raise JournalError(
                f"{path}: its file system can't lock files: {error.strerror}: use a local disk", path=str(path)
            ) from error
        lock.truncate(0)
        lock.write(f"process {os.getpid()}, line {self._line}\n")
        lock.flush()
        return lock

    def _taken(self, holder: str = "") -> NoReturn:
        raise JournalError(
            f"{self.name}: another daemon{holder} writes this journal: end it first, or look on only",
            path=self.name,
        )

    def _make_engine(self) -> Engine:
        path = self.path
        if path is None:
            bounds = {name: value for name, value in _POSTGRES_BOUNDS.items() if name not in self._url.query}
            return create_engine(self._url, poolclass=NullPool, connect_args=bounds)

        def connect() -> sqlite3.Connection:
            mode = "ro" if self.read_only else "rwc"
            return sqlite3.connect(
                f"file:{quote(str(path))}?mode={mode}",
                uri=True,
                isolation_level=None,
                timeout=BUSY_SECONDS,
                check_same_thread=False,
            )

        engine = create_engine("sqlite+pysqlite://", creator=connect, poolclass=NullPool)
        begin = "BEGIN" if self.read_only else "BEGIN IMMEDIATE"
        event.listen(engine, "begin", lambda connection: connection.exec_driver_sql(begin))
        return engine

    def _driver(self) -> sqlite3.Connection:
        driver = self.connection.connection.driver_connection
        assert isinstance(driver, sqlite3.Connection)
        return driver

    def _settle_connection(self) -> None:
        if not self.is_sqlite:
            self._settle_postgres()
            return
        driver = self._driver()
        # Before anything is read: what the file says must not be able to run anything.
        driver.execute("PRAGMA trusted_schema = OFF").close()
        driver.execute("PRAGMA cell_size_check = ON").close()
        with self._sqlite_explained("open"):
            self._check_present([name for (name,) in driver.execute(_TABLES)])
        wanted: list[tuple[str, object, object]] = [("foreign_keys", "ON", 1)]
        if self.read_only:
            wanted.append(("query_only", "ON", 1))
        else:
            wanted += [
                ("synchronous", "FULL", 2),
                ("fullfsync", "ON", 1),
                ("checkpoint_fullfsync", "ON", 1),
                ("journal_mode", "WAL", "wal"),
                ("journal_size_limit", _WAL_BYTES, _WAL_BYTES),
            ]
        for name, value, told in wanted:
            with self._sqlite_explained("open"):
                driver.execute(f"PRAGMA {name} = {value}").fetchall()
                found = driver.execute(f"PRAGMA {name}").fetchone()[0]
            if found != told:
                raise JournalError(
                    f"{self.name}: {name} can't be set to {value}, it is {found}: put the journal on a local disk",
                    path=self.name,
                )
        with self._sqlite_explained("open"):
            pages, size = (driver.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
            found = driver.execute("PRAGMA quick_check(1)").fetchone()[0] if pages * size <= _CHECKED_BYTES else "ok"
        if found != "ok":
            self._damaged(str(found))

    @contextmanager
    def _sqlite_explained(self, what: str) -> Iterator[None]:
        """As `explained`, for what goes to the driver directly."""
        try:
            yield
        except sqlite3.Error as error:
            self._refuse(what, DBAPIError(None, None, error))

    def _settle_postgres(self) -> None:
        with self.connection.begin():
            ask = self.connection.execute
            if self.read_only:
                ask(text("SET SESSION CHARACTERISTICS AS TRANSACTION ISOLATION LEVEL REPEATABLE READ, READ ONLY"))
                return
            ask(text("SET synchronous_commit = on"))
            if ask(text("SHOW fsync")).scalar() != "on":
                raise JournalError(f"{self.name}: the server runs with fsync off: turn it on", path=self.name)
            key = int.from_bytes(hashlib.blake2b(self._line.encode(), digest_size=8).digest(), "big", signed=True)
            # Held by the connection: when that is lost so is the lock, and then this store refuses everything.
            if not ask(text("SELECT pg_try_advisory_lock(:key)"), {"key": key}).scalar():
                self._taken()

    def _bring_up_to_date(self) -> None:
        with self.connection.begin():
            if not (self.is_sqlite or self.read_only):
                self.connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATION_KEY})
            found = None
            if self._check_present(inspect(self.connection).get_table_names()):
                found = self.connection.execute(text("SELECT version_num FROM alembic_version")).scalar()
            if found == HEAD:
                return
            if self.read_only and found is None:
                raise JournalError(f"{self.name}: there is no journal yet: start the line once", path=self.name)
            migrate(self.connection, found, self.name, read_only=self.read_only)

    def _check_present(self, tables: list[str]) -> bool:
        """Whether there is a journal; refuses the database of another program before anything of it is changed."""
        if tables and "alembic_version" not in tables:
            raise JournalError(f"{self.name}: is the database of something else: name another", path=self.name)
        return bool(tables)

    def _damaged(self, found: str) -> NoReturn:
        self._lost = f"it is damaged: {_first_line(found)}: put back a copy, or move it away"
        raise JournalError(f"{self.name}: {self._lost}", path=self.name)

    def _refuse(self, what: str, error: DBAPIError) -> NoReturn:
        """Explain an error of the database."""
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF
        reason, advice = _EXPLAINED.get(code, (_first_line(error.orig), "see the message of the database"))
        if isinstance(error, IntegrityError) or code == sqlite3.SQLITE_CONSTRAINT:
            reason, advice = f"it would contradict the journal ({_first_line(error.orig)})", "this is a defect"
        if error.connection_invalidated or code in _LOST:
            self._lost = f"{reason}, and what it holds must be read anew: open it again"
        raise JournalError(f"{self.name}: can't {what}: {reason}: {advice}", path=self.name) from error


def migrate(
    connection: Connection, found: str | None, name: str, *, read_only: bool = False, folder: Path = _FOLDER
) -> None:
    """Lead a database to the newest schema, within the connection's transaction.

    Parameters
    ----------
    connection
        With a transaction begun.
    found
        Its revision, or ``None`` where there is nothing yet.
    name
        Of the database, for messages.
    read_only
        Only say what would have to be done.
    folder
        Alembic's scripts.

    Raises
    ------
    JournalError
        If the database is of a revision that this program doesn't know.
    """
    # Alembic is a tenth of a second to import, and rarely wanted.
    from alembic import command
    from alembic.config import Config
    from alembic.script import ScriptDirectory

    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(folder).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    known = {script.revision for script in ScriptDirectory.from_config(config).walk_revisions()}
    if found is not None and found not in known:
        raise JournalError(
            f"{name}: is of a newer schema ({found!r:.40}): use the tilefab that wrote it, or a later one", path=name
        )
    if read_only:
        raise JournalError(f"{name}: is of an older schema ({found}): start the line once, it brings it up to date")
    command.upgrade(config, "head")


def _parse(url: str) -> URL:
    try:
        parsed = make_url(url)
    except ArgumentError as error:
        raise JournalError(
            "journal: its url can't be read: write sqlite:////folder/file or postgresql://..."
        ) from error
    backend = parsed.get_backend_name()
    if backend not in ("sqlite", "postgresql"):
        raise JournalError(f"journal: {backend!r:.40} isn't known here: use sqlite or postgresql")
    if backend == "postgresql":
        return parsed.set(drivername="postgresql+psycopg")
    if parsed.database in (None, "", ":memory:") or parsed.query:
        raise JournalError("journal: its url must name a file on a disk: write sqlite:////folder/file")
    return parsed


def _first_line(error: object) -> str:
    lines = str(error).strip().splitlines()
    return lines[0][:300] if lines else type(error).__name__
