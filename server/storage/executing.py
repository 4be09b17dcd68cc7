"""Statements of a write transaction on their way to the database: by SQLAlchemy to SQLite, by asyncpg to PostgreSQL.

They are the same statements. SQLAlchemy takes several times as long to send one as PostgreSQL to answer it, and as
long again for each row; so for PostgreSQL it only writes their text, once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import lru_cache
from operator import itemgetter
from typing import Any, Protocol

import asyncpg
from sqlalchemy import RowMapping, Select, Table, TypeDecorator, Update, text
from sqlalchemy.dialects.postgresql.asyncpg import dialect
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection
from sqlalchemy.sql.dml import Insert

from server.storage.rows import Row
from server.storage.statements import insert_of_arrays

Values = Mapping[str, Any]
# What no SQLAlchemy stands between.
_FAILURES = (asyncpg.PostgresError, asyncpg.InterfaceError, OSError)


class Executor(Protocol):
    """Sends statements within one transaction. Failures are SQLAlchemy's `DBAPIError`."""

    async def rows(self, statement: Select[Any], values: Values) -> Sequence[Row]:
        """What is selected, by the names of columns."""
        ...

    async def insert(self, table: Table, rows: Sequence[Values]) -> None:
        """Insert whole rows, all with the same columns."""
        ...

    async def update(self, statement: Update, values: Sequence[Values]) -> None:
        """Run an update once for each of `values`."""
        ...


async def executor_of(connection: AsyncConnection) -> Executor:
    """The executor for a connection, whose transaction has begun when this returns."""
    if connection.dialect.name == "sqlite":
        return SqliteExecutor(connection)
    driver = (await connection.get_raw_connection()).driver_connection
    assert isinstance(driver, asyncpg.Connection)  # noqa: S101  # what the engine's URL names
    if not driver.is_in_transaction():
        # SQLAlchemy begins one with its first statement.
        await connection.execute(text("SELECT 1"))
    return PostgresExecutor(driver)


class SqliteExecutor:
    """By SQLAlchemy."""

    def __init__(self, connection: AsyncConnection) -> None:
        self._connection = connection

    async def rows(self, statement: Select[Any], values: Values) -> Sequence[Row]:
        """What is selected, by the names of columns."""
        found: Sequence[RowMapping] = (await self._connection.execute(statement, values)).mappings().all()
        return found

    async def insert(self, table: Table, rows: Sequence[Values]) -> None:
        """Insert whole rows, all with the same columns."""
        if rows:
            await self._connection.execute(table.insert(), rows)

    async def update(self, statement: Update, values: Sequence[Values]) -> None:
        """Run an update once for each of `values`."""
        if values:
            await self._connection.execute(statement, values)


class PostgresExecutor:
    """By asyncpg, with statements that it has prepared."""

    def __init__(self, driver: asyncpg.Connection) -> None:
        self._driver = driver

    async def rows(self, statement: Select[Any], values: Values) -> Sequence[Row]:
        """What is selected, by the names of columns."""
        made = _selecting(statement)
        with self._failing_as_sqlalchemy():
            found = await self._driver.fetch(made.text, *made.parameters(values))
        return [made.row(record) for record in found]

    async def insert(self, table: Table, rows: Sequence[Values]) -> None:
        """Insert whole rows, all with the same columns: one statement, whose parameters are the columns."""
        if not rows:
            return
        made = _made(insert_of_arrays(table))
        columns = {name: list(map(itemgetter(name), rows)) for name in made.names}
        with self._failing_as_sqlalchemy():
            await self._driver.execute(made.text, *made.parameters(columns))

    async def update(self, statement: Update, values: Sequence[Values]) -> None:
        """Run an update once for each of `values`, in one round trip: each finds its row by the primary key."""
        if values:
            made = _made(statement)
            with self._failing_as_sqlalchemy():
                await self._driver.executemany(made.text, list(map(made.parameters, values)))

    @contextmanager
    def _failing_as_sqlalchemy(self) -> Iterator[None]:
        try:
            yield
        except _FAILURES as error:
            is_lost = self._driver.is_closed()
            raise DBAPIError(None, None, error, hide_parameters=True, connection_invalidated=is_lost) from error


class _Made:
    """The text of a statement, and how its parameters are told to PostgreSQL."""

    def __init__(self, statement: Select[Any] | Update | Insert) -> None:
        here = dialect()  # type: ignore[no-untyped-call]  # SQLAlchemy's
        compiled = statement.compile(dialect=here)
        self.text = str(compiled)
        self.names: list[str] = list(compiled.positiontup or ())
        types = [compiled.binds[name].type.dialect_impl(here) for name in self.names]
        self._inputs = [(name, kind.bind_processor(here)) for name, kind in zip(self.names, types, strict=True)]

    def parameters(self, values: Values) -> list[Any]:
        """Values in the order of the statement's parameters."""
        return [values[name] if told is None else told(values[name]) for name, told in self._inputs]


class _Selecting(_Made):
    """A statement that reads, and how its columns are understood."""

    def __init__(self, statement: Select[Any]) -> None:
        super().__init__(statement)
        here = dialect()  # type: ignore[no-untyped-call]  # SQLAlchemy's
        # asyncpg's own values are right for all types but those of our making.
        made = [column for column in statement.selected_columns if isinstance(column.type, TypeDecorator)]
        understood = [(column.name, column.type.result_processor(here, None)) for column in made]
        self._outputs = [(name, read) for name, read in understood if read is not None]

    def row(self, record: asyncpg.Record) -> Row:
        """Values by the names of columns."""
        values = dict(record)
        for name, read in self._outputs:
            values[name] = read(values[name])
        return values


@lru_cache
def _made(statement: Update | Insert) -> _Made:
    return _Made(statement)


@lru_cache
def _selecting(statement: Select[Any]) -> _Selecting:
    return _Selecting(statement)
