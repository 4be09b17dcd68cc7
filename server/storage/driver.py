"""PostgreSQL's driver without SQLAlchemy, for the one statement that every nearby query waits for.

A statement through the pool costs six round trips (a ping in a transaction of its own, then the statement in another)
and more processor time than the database needs to answer it.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

import asyncpg
from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection, AsyncEngine

from server.errors import UnavailableError

_LOST = (OSError, asyncpg.PostgresError, asyncpg.InterfaceError, DBAPIError)


class Driver:
    """One connection that is kept, for one statement at a time."""

    def __init__(self, engine: AsyncEngine, deadline_s: float) -> None:
        self._engine, self._deadline_s = engine, deadline_s
        self._kept: AsyncConnection | None = None

    async def fetch(self, statement: str, *values: Any) -> list[asyncpg.Record]:
        """Rows of a statement that reads; `$1`... are its values.

        A connection that was lost since the last call is replaced. Raises `UnavailableError` when that fails, or when
        the database does not answer in time.
        """
        try:
            async with asyncio.timeout(self._deadline_s):
                if self._kept is not None:
                    with suppress(*_LOST):
                        return await self._fetch(self._kept, statement, values)
                    await self.close()
                self._kept = await self._engine.connect()
                return await self._fetch(self._kept, statement, values)
        except (TimeoutError, *_LOST) as error:
            await self.close()
            raise UnavailableError("the database did not answer") from error

    async def close(self) -> None:
        """Give the connection up; the next statement makes another."""
        kept, self._kept = self._kept, None
        if kept is not None:
            with suppress(*_LOST):
                await kept.invalidate()
            await kept.close()

    async def _fetch(self, kept: AsyncConnection, statement: str, values: tuple[Any, ...]) -> list[asyncpg.Record]:
        connection = (await kept.get_raw_connection()).driver_connection
        assert isinstance(connection, asyncpg.Connection)  # noqa: S101  # what the engine's URL names
        rows: list[asyncpg.Record] = await connection.fetch(statement, *values)
        return rows
