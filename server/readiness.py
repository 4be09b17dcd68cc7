"""Whether this process should be sent requests: the database answers, its schema is right, and no end is near."""

from __future__ import annotations

import asyncio

from server import schema
from server.database import Database
from server.errors import ShuttingDownError, UnavailableError

# Below the time that probes usually wait (3 s in docker-compose.yml), so that they hear why.
_WITHIN_S = 2.0


class Readiness:
    """Asked by `/readyz`."""

    def __init__(self) -> None:
        self._is_ending = False

    def end(self) -> None:
        """From now on the process is not ready."""
        self._is_ending = True

    async def check(self, database: Database) -> None:
        """Raises `ShuttingDownError`, `UnavailableError` or `SchemaOutOfDateError` when it is not ready."""
        if self._is_ending:
            raise ShuttingDownError("the server is shutting down: ask another")
        try:
            async with asyncio.timeout(_WITHIN_S):
                await schema.check(database)
        except TimeoutError:
            raise UnavailableError(f"the database did not answer within {_WITHIN_S:.0f} s") from None
