"""The outbox's file: SQLite, durable at every transaction, held by one process, replaced when it is broken.

A car in the field has nobody to type commands: what cannot be read is moved aside, what can still be read of it is
taken over, and a new file is begun. What belongs to somebody else is refused and left as it is.
"""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

_LOG = logging.getLogger(__name__)

# "HdUp" as a number: tells this file from any other program's database (PRAGMA application_id).
_APPLICATION_ID = 0x48645570
_FORMAT = 2
_TABLES = (
    "CREATE TABLE IF NOT EXISTS report"
    " (position INTEGER PRIMARY KEY, id TEXT UNIQUE NOT NULL, sees INTEGER NOT NULL, body TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS dropped"
    " (position INTEGER PRIMARY KEY, id TEXT NOT NULL, reason TEXT NOT NULL, dropped_at TEXT NOT NULL,"
    " body TEXT NOT NULL)",
    "CREATE TABLE IF NOT EXISTS tally (fate TEXT PRIMARY KEY, number INTEGER NOT NULL)",
)
_NAMES = {"report", "dropped", "tally"}
_BROKEN = frozenset({sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_FORMAT})

Statement = tuple[str, Sequence[Sequence[Any]]]
"""A statement and the values of each time that it is executed."""


class OutboxError(RuntimeError):
    """The file cannot be this vehicle's outbox; the message says what to do."""


class DiskError(RuntimeError):
    """The disk does not take or give what was asked: it is full, write-protected or failing."""


class OutboxFile:
    """The tables of an outbox: `report`, `dropped` and `tally`.

    Made, it raises `OutboxError` when another process or program has the file. Later a call raises `DiskError` when the
    disk does not do it; the next call opens the file again.
    """

    def __init__(self, path: Path) -> None:
        if not path.parent.is_dir():
            raise OutboxError(f"{path.parent} is no folder: make it, or name another file for the outbox")
        self._path = path
        self._database: sqlite3.Connection | None = None
        self._is_closed = False
        with suppress(DiskError):
            self._do(lambda _: None, is_start=True)

    def write(self, statements: Iterable[Statement]) -> None:
        """Execute all of them in one transaction; it is on disk when this returns."""
        todo = list(statements)

        def transact(database: sqlite3.Connection) -> None:
            database.execute("BEGIN IMMEDIATE")
            try:
                for sql, values in todo:
                    database.executemany(sql, values)
                database.execute("COMMIT")
            except sqlite3.Error:
                # A full disk has ended the transaction by itself.
                with suppress(sqlite3.Error):
                    database.execute("ROLLBACK")
                raise

        self._do(transact)

    def read(self, sql: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Rows of a query."""
        rows: list[tuple[Any, ...]] = []

        def query(database: sqlite3.Connection) -> None:
            rows[:] = database.execute(sql, values).fetchall()

        try:
            self._do(query)
        except DiskError:
            # A disk that takes nothing more can still be read; one that was taken out must be opened again.
            self._let_go()
            raise
        return rows

    def close(self) -> None:
        """Close the file for good."""
        self._is_closed = True
        self._let_go()

    def _let_go(self) -> None:
        if self._database is not None:
            with suppress(sqlite3.Error):
                self._database.close()
            self._database = None

    def _do(self, action: Callable[[sqlite3.Connection], None], *, is_start: bool = False) -> None:
        if self._is_closed:
            raise DiskError(f"{self._path} is closed")
        for is_last in (False, True):
            try:
                if self._database is None:
                    self._database = self._opened()
                action(self._database)
                return
            except OutboxError as error:
                if is_start:
                    raise
                raise DiskError(str(error)) from error
            except OSError as error:
                raise DiskError(f"{self._path}: {error}") from error
            except sqlite3.Error as error:
                code = _code_of(error)
                if is_start and code == sqlite3.SQLITE_BUSY:
                    raise OutboxError(
                        f"{self._path} is in use by another process: end that one, or name another file"
                    ) from None
                if code not in _BROKEN or is_last:
                    raise DiskError(f"{self._path}: {error}") from error
                self._begin_anew(str(error))

    def _opened(self) -> sqlite3.Connection:
        database = _connected(self._path)
        try:
            (application,) = database.execute("PRAGMA application_id").fetchone()
            tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if tables and application != _APPLICATION_ID and not tables >= _NAMES:
                raise OutboxError(f"{self._path} is the database of another program: name another file for the outbox")
            database.execute("PRAGMA journal_mode=WAL")
            database.execute("PRAGMA synchronous=FULL")
            (sound,) = database.execute("PRAGMA quick_check(1)").fetchone()
            (version,) = database.execute("PRAGMA user_version").fetchone()
            if sound != "ok" or (tables and (application, version) != (_APPLICATION_ID, _FORMAT)):
                raise _broken(f"quick_check says {sound}, format {version} of {application}")
            database.execute("BEGIN EXCLUSIVE")
            for table in _TABLES:
                database.execute(table)
            database.execute(f"PRAGMA application_id={_APPLICATION_ID}")
            database.execute(f"PRAGMA user_version={_FORMAT}")
            database.execute("COMMIT")
        except (sqlite3.Error, OutboxError):
            database.close()
            raise
        return database

    def _begin_anew(self, reason: str) -> None:
        """Move the broken file aside, begin a new one, and take over the reports that can still be read."""
        self._let_go()
        aside = self._path.with_name(f"{self._path.name}.broken-{datetime.now(UTC):%Y%m%dT%H%M%S%fZ}")
        try:
            self._path.rename(aside)
            for suffix in ("-wal", "-shm"):
                with suppress(FileNotFoundError):
                    Path(f"{self._path}{suffix}").rename(f"{aside}{suffix}")
        except OSError as error:
            raise DiskError(f"{self._path} is broken ({reason}) and cannot be moved aside: {error}") from error
        saved = _salvaged(aside)
        _LOG.warning("%s is broken (%s): moved to %s, %d reports taken over", self._path, reason, aside, len(saved))
        self._database = self._opened()
        self._database.executemany("INSERT OR IGNORE INTO report (id, sees, body) VALUES (?, ?, ?)", saved)


def _connected(path: Path) -> sqlite3.Connection:
    # It says where the car was: for its owner only. SQLite gives its other files the same mode.
    path.touch(mode=0o600)
    # One thread at a time is the caller's lock; no waiting, since whoever holds the file keeps it.
    database = sqlite3.connect(path, isolation_level=None, timeout=0, check_same_thread=False)
    # The lock is held from the first access on, and lost with the process: also by one that is killed.
    database.execute("PRAGMA locking_mode=EXCLUSIVE")
    return database


def _broken(reason: str) -> sqlite3.DatabaseError:
    error = sqlite3.DatabaseError(reason)
    error.sqlite_errorcode = sqlite3.SQLITE_CORRUPT
    return error


def _code_of(error: sqlite3.Error) -> int:
    # Without the extended part, and none where the module itself complains.
    return int(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR)) & 0xFF


def _salvaged(path: Path) -> list[tuple[Any, ...]]:
    """Reports of a broken file, oldest first, up to the first page that cannot be read."""
    rows: list[tuple[Any, ...]] = []
    with suppress(sqlite3.Error), closing(sqlite3.connect(path)) as database:
        for row in database.execute("SELECT id, sees, body FROM report ORDER BY position"):
            if isinstance(row[0], str) and isinstance(row[2], str):
                rows.append(row)
    return rows
