"""Owners of keys, as the database says now; lookups that wait while a statement runs share the next one.

Whoever tries unknown keys then costs the database one connection, however many are tried, and delays nobody's good
key by more than two statements.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from itertools import islice

from sqlalchemy import select

from server.storage.database import Database
from server.storage.tables import api_key

# PostgreSQL takes 32,767 values in a statement, SQLite as many; the answer for so many takes some 10 ms.
_MOST_AT_ONCE = 1_000


class KeyOwners:
    """Id and role of valid keys by their hash."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._waiting: dict[str, asyncio.Future[tuple[str, str] | None]] = {}
        self._work: asyncio.Task[None] | None = None

    async def of(self, sha256: str) -> tuple[str, str] | None:
        """Id and role of the key with this hash; None when there is none, or it is revoked.

        Raises `UnavailableError` when the database does not answer.
        """
        answer = self._waiting.get(sha256)
        if answer is None:
            answer = self._waiting[sha256] = asyncio.get_running_loop().create_future()
        if self._work is None or self._work.done():
            self._work = asyncio.create_task(self._look_up())
        # Others may wait for the same answer.
        return await asyncio.shield(answer)

    async def _look_up(self) -> None:
        while self._waiting:
            group = {sha256: self._waiting.pop(sha256) for sha256 in list(islice(self._waiting, _MOST_AT_ONCE))}
            try:
                found = await self._read(list(group))
            except Exception as error:  # it is told to everybody who waits
                for answer in group.values():
                    answer.set_exception(error)
                    # Those who waited may be gone.
                    answer.exception()
            else:
                for sha256, answer in group.items():
                    answer.set_result(found.get(sha256))

    async def _read(self, hashes: list[str]) -> Mapping[str, tuple[str, str]]:
        query = select(api_key.c.sha256, api_key.c.id, api_key.c.role).where(
            api_key.c.sha256.in_(hashes), api_key.c.revoked_at.is_(None)
        )
        async with self._database.read() as connection:
            return {row.sha256: (str(row.id), row.role) for row in await connection.execute(query)}
