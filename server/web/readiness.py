"""Whether this process should be sent requests: the database answers, its schema is right, writes work, no end near."""

from __future__ import annotations

import asyncio
import math
import time
from contextlib import suppress

from server.errors import ShuttingDownError, UnavailableError
from server.storage import schema
from server.storage.database import Database

# Below the time that probes usually wait (3 s in docker-compose.yml), so that they hear why.
_WITHIN_S = 2.0
# Anybody may ask, and a probe is a write.
_PROBE_EVERY_S = 5.0


class Readiness:
    """Asked by `/readyz`."""

    def __init__(self) -> None:
        self._is_ending = False
        self._probed_at_s = -math.inf

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
                await self._check_writes(database)
        except TimeoutError:
            raise UnavailableError(f"the database did not answer within {_WITHIN_S:.0f} s") from None

    async def _check_writes(self, database: Database) -> None:
        """When the last write failed, try another: nobody else may, as long as this process is not ready."""
        if database.writes.failure is None:
            return
        if time.monotonic() >= self._probed_at_s + _PROBE_EVERY_S:
            self._probed_at_s = time.monotonic()
            with suppress(UnavailableError):
                await database.probe()
        if database.writes.failure is not None:
            raise UnavailableError(f"the database takes no writes: {database.writes.failure}")
