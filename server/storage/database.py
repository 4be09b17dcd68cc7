"""The database behind the service: connections, transactions, and which failures are worth a retry."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import Self

import asyncpg
from sqlalchemy import Connection, event
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine, create_async_engine
from sqlalchemy.pool import ConnectionPoolEntry, QueuePool

from server.errors import StorageError, UnavailableError
from server.storage.driver import Driver
from server.storage.tables import secret
from server.storage.write_health import WriteHealth, storage_failure

# Well below a request's deadline, so that it is the request that gives up; commands wait this long.
_BUSY_TIMEOUT_MS = 2_000
# A page of the widest search takes a second; a database that stands still must not hold its readers for ever.
_READ_DEADLINE_S = 10.0
# Ending a transaction takes some milliseconds, and seconds on a disk that is busy: later nobody is there who answers.
_ENDING_S = 10.0
# Our longest pause within a transaction is a second. A server that was cut off must not hold its tiles for the two
# hours after which PostgreSQL's host gives its connection up.
_ABANDONED_MS = 30_000
# PostgreSQL: serialization failure, deadlock, unique violation, too many connections; shut down, crashed, starting;
# cancelled by an administrator or a time-out, lock not had in time, idle for too long in a transaction; a statement
# prepared before its tables were altered.
_STATES_WORTH_A_RETRY = frozenset(
    {"40001", "40P01", "23505", "53300", "57P01", "57P02", "57P03", "57014", "55P03", "25P03", "0A000"}
)
_SQLITE_WORTH_A_RETRY = ("database is locked", "UNIQUE constraint failed")
# While it starts, asyncpg's own errors come through SQLAlchemy as they are.
_NOT_CONNECTED = (OSError, DBAPIError, PoolTimeoutError, asyncpg.PostgresError, asyncpg.InterfaceError)
_WRITES = "headsup_writes"
_PROBE = "probe"


class Database:
    """An engine and its two kinds of transaction. Made by `Database.open`, ended by `close`."""

    def __init__(self, engine: AsyncEngine) -> None:
        self._engine = engine
        # SQLite has one writer: queueing here is fair, where its busy handler would let some wait for ever.
        self._writer = asyncio.Lock() if engine.dialect.name == "sqlite" else None
        self.driver = None if engine.dialect.name == "sqlite" else Driver(engine, _READ_DEADLINE_S)
        """Of PostgreSQL, for a statement that is sent all the time."""
        self.writes = WriteHealth()

    @classmethod
    def open(cls, url: str) -> Database:
        """A database by its SQLAlchemy URL; nothing is connected yet, but a new file of SQLite is made.

        Raises `UnavailableError` when there can be none.
        """
        # JSON columns are text on both engines: the tables' types parse it (asyncpg's codec would do so before them).
        # Values of statements are what vehicles sent: they must not get into the text of an error.
        engine = create_async_engine(url, pool_pre_ping=True, json_deserializer=str, hide_parameters=True)
        if engine.dialect.name == "sqlite":
            _make_file(Path(engine.url.database or ""))
            event.listen(engine.sync_engine, "connect", _configure_sqlite)
            event.listen(engine.sync_engine, "begin", _begin_sqlite)
        else:
            event.listen(engine.sync_engine, "connect", _configure_postgres)
        return cls(engine)

    @property
    def is_sqlite(self) -> bool:
        """Whether it is the embedded database."""
        return self._writer is not None

    @property
    def connections(self) -> tuple[int, int]:
        """How many connections are in use, and how many are open and idle."""
        pool = self._engine.pool
        assert isinstance(pool, QueuePool)  # noqa: S101  # of every asynchronous engine
        return pool.checkedout(), pool.checkedin()

    @asynccontextmanager
    async def read(self) -> AsyncIterator[AsyncConnection]:
        """A connection for reading, in one transaction.

        Raises `UnavailableError` when the database is lost meanwhile, or does not answer in time.
        """
        try:
            async with asyncio.timeout(_READ_DEADLINE_S), self._transaction(writes=False) as connection:
                yield connection
        except TimeoutError:
            raise UnavailableError("the database did not answer in time") from None
        except DBAPIError as error:
            if not is_worth_a_retry(error):
                raise
            raise UnavailableError("the database was lost while it answered") from error

    @asynccontextmanager
    async def snapshot(self) -> AsyncIterator[AsyncConnection]:
        """A connection on which all reading, however long, sees one state."""
        async with self._transaction(writes=False) as connection:
            if not self.is_sqlite:
                # Of SQLite every transaction is one.
                await connection.execution_options(isolation_level="REPEATABLE READ")
            yield connection

    @asynccontextmanager
    async def write(self) -> AsyncIterator[AsyncConnection]:
        """A transaction that commits at the end of the block, or rolls back when it raises.

        Raises `StorageError` when the database's storage takes no writes.
        """
        try:
            with self.writes.watched():
                async with self._transaction(writes=True) as connection:
                    yield connection
        except DBAPIError as error:
            if failure := storage_failure(error):
                raise StorageError(f"the database takes no writes: {failure}") from error
            raise

    async def probe(self) -> None:
        """Write what leaves nothing behind. Raises `UnavailableError` when the database takes no writes."""
        try:
            async with self.write() as connection:
                # An update to the same value would not reach the disk: SQLite compares first.
                await connection.execute(secret.insert().values(name=_PROBE, value=""))
                await connection.execute(secret.delete().where(secret.c.name == _PROBE))
        except DBAPIError as error:
            raise UnavailableError("the database takes no writes") from error

    @asynccontextmanager
    async def _transaction(self, *, writes: bool) -> AsyncIterator[AsyncConnection]:
        async with AsyncExitStack() as stack:
            if writes and self._writer is not None:
                await stack.enter_async_context(self._writer)
            ending = stack.enter_context(_Ending())
            connection = await self._connected(stack)
            driver = (await connection.get_raw_connection()).driver_connection
            if writes:
                await connection.execution_options(**{_WRITES: True})
                await stack.enter_async_context(connection.begin())
            if isinstance(driver, asyncpg.Connection):
                stack.callback(ending.begins, driver)
            yield connection

    async def _connected(self, stack: AsyncExitStack) -> AsyncConnection:
        try:
            return await stack.enter_async_context(self._engine.connect())
        except _NOT_CONNECTED as error:
            raise UnavailableError("the database cannot be opened") from error

    async def close(self) -> None:
        """Close all connections."""
        if self.driver is not None:
            await self.driver.close()
        await self._engine.dispose()


class _Ending:
    """The end of a transaction on PostgreSQL, cut off when it takes too long.

    A peer that was lost without a word answers neither a commit nor a rollback; all reports would wait for it.
    """

    def __init__(self) -> None:
        self._timer: asyncio.TimerHandle | None = None

    def begins(self, driver: asyncpg.Connection) -> None:
        """From now on it may take `_ENDING_S`."""
        self._timer = asyncio.get_running_loop().call_later(_ENDING_S, driver.terminate)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer is not None:
            self._timer.cancel()


def is_worth_a_retry(error: DBAPIError) -> bool:
    """Whether the same transaction may succeed when it is tried again.

    A lost connection is: report ids make a second attempt harmless even if the first has committed. So is a unique
    violation: another transaction has just written the same row, and the next attempt will see it. A full disk is, as
    somebody will make room.
    """
    if storage_failure(error) is not None or error.connection_invalidated:
        return True
    if getattr(error.orig, "sqlstate", None) in _STATES_WORTH_A_RETRY:
        return True
    return str(error.orig).startswith(_SQLITE_WORTH_A_RETRY)


def _make_file(path: Path) -> None:
    """A new file that only its owner may read, for keys' hashes are in it; SQLite's log beside it follows."""
    try:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
    except FileExistsError:
        if not path.is_file():
            raise UnavailableError(f"the database cannot be opened: {path} is no file") from None
    except OSError as error:
        raise UnavailableError(f"the database cannot be opened: {path}: {error.strerror}") from None


def _configure_sqlite(connection: DBAPIConnection, _entry: ConnectionPoolEntry) -> None:
    # The driver must not begin transactions of its own accord; `_begin_sqlite` does.
    connection.isolation_level = None
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", f"busy_timeout={_BUSY_TIMEOUT_MS}"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _configure_postgres(connection: DBAPIConnection, _entry: ConnectionPoolEntry) -> None:
    # Not among the parameters of the connection: poolers refuse those that they do not know.
    cursor = connection.cursor()
    cursor.execute(f"SET idle_in_transaction_session_timeout = {_ABANDONED_MS}")
    cursor.close()
    connection.commit()


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get(_WRITES, False)
    # A deferred transaction that turns into a write fails as busy; an immediate one waits its turn.
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
