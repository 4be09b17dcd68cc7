"""What the server does of its own accord, now and then: obstacles expire, and witnesses are judged by their record."""

from __future__ import annotations

import asyncio
import logging
import random
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy import func, select
from sqlalchemy.exc import DBAPIError

from contract.observation import State
from server.errors import ServiceError
from server.life.policy import Life
from server.operators import Operators
from server.storage import tables
from server.storage.audit import Order
from server.storage.database import Database

SWEEPER = "sweeper"
"""Stands in the action log for whoever expired an obstacle."""
_INTERVAL_S = 20.0
# In one round; expiry is no emergency, since readers see `expires_at` and searches leave out what is past it.
_MOST_AT_ONCE = 200
_LOG = logging.getLogger(__name__)


class Upkeep:
    """Rounds of one process. Several replicas may run them: whoever comes second finds nothing to do."""

    def __init__(self, database: Database, operators: Operators, life: Life) -> None:
        self._database, self._operators, self._life = database, operators, life
        self.distrusted: frozenset[str] = frozenset()

    async def run(self) -> None:
        """Make rounds until cancelled; one that fails is logged, and the next is tried."""
        while True:
            try:
                await self.judge()
                await self.sweep(datetime.now(UTC))
            except (ServiceError, DBAPIError, OSError) as error:
                _LOG.warning("upkeep failed and will be tried again: %s", type(error).__name__)
            except Exception:  # nobody would notice that the rounds had ended
                _LOG.exception("upkeep failed and will be tried again")
            # Replicas that started together drift apart.
            await asyncio.sleep(_INTERVAL_S * random.uniform(0.75, 1.25))  # noqa: S311  # jitter, not a secret

    async def sweep(self, now: datetime) -> int:
        """Remove what has expired; the number of obstacles."""
        found = await self._expired(now)
        for identifier in found:
            await self._operators.carry_out(Order(identifier, "expire", SWEEPER, None, None))
        return len(found)

    async def judge(self) -> None:
        """Find the witnesses of whose latest sole creations too many were refuted by others."""
        self.distrusted = frozenset([name for name in await self._suspects() if await self._is_refuted(name)])

    async def _expired(self, now: datetime) -> list[UUID]:
        table = tables.obstacle
        query = (
            select(table.c.id)
            .where(table.c.expires_at <= now, table.c.state != State.REMOVED.value)
            .order_by(table.c.expires_at)
            .limit(_MOST_AT_ONCE)
        )
        async with self._database.read() as connection:
            return list((await connection.execute(query)).scalars())

    async def _suspects(self) -> list[str]:
        table = tables.creation
        query = (
            select(table.c.witness)
            .where(table.c.outcome == "refuted")
            .group_by(table.c.witness)
            .having(func.count() >= self._life.refuted_creations)
        )
        async with self._database.read() as connection:
            return list((await connection.execute(query)).scalars())

    async def _is_refuted(self, witness: str) -> bool:
        table = tables.creation
        query = (
            select(table.c.outcome)
            .where(table.c.witness == witness, table.c.outcome.in_(["sole", "refuted"]))
            .order_by(table.c.created_at.desc())
            .limit(self._life.judged_creations)
        )
        async with self._database.read() as connection:
            latest = list((await connection.execute(query)).scalars())
        return latest.count("refuted") >= self._life.refuted_creations
