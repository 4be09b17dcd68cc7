"""Operators' actions on the database: lock, read, decide, write, log; committed when answered, then published."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy.exc import DBAPIError

from contract.obstacle import ObstacleFeature
from server.errors import ObstacleNotFoundError, RevisionMismatchError, UnavailableError
from server.geometry.quadkey import cell_of, tile_of_cell
from server.life import operating
from server.life.obstacle import Obstacle
from server.life.policy import Life
from server.storage import audit, tables, writing
from server.storage.audit import Order
from server.storage.database import Database, is_worth_a_retry
from server.storage.features import ObstacleEvent, feature_of
from server.storage.repository import Repository
from server.storage.working_set import WorkingSet

_FIRST_PAUSE_S, _GREATEST_PAUSE_S = 0.01, 0.5


@dataclass(frozen=True, slots=True)
class _Outcome:
    feature: ObstacleFeature
    event: ObstacleEvent | None = None


class Operators:
    """Carries out orders on one database. `publish` is called with the event, after its commit."""

    def __init__(
        self, database: Database, life: Life, write_deadline_s: float, publish: Callable[[ObstacleEvent], None]
    ) -> None:
        self._database, self._life = database, life
        self._write_deadline_s, self._publish = write_deadline_s, publish

    async def carry_out(self, order: Order) -> ObstacleFeature:
        """The obstacle as it is served afterwards. An order that changes nothing leaves no trace.

        Raises `ObstacleNotFoundError`, `ObstacleRemovedError`, `RevisionMismatchError`, and `UnavailableError` when
        the database did not take it in time.
        """
        deadline_s = time.monotonic() + self._write_deadline_s
        pause_s = _FIRST_PAUSE_S
        while time.monotonic() < deadline_s:
            try:
                async with asyncio.timeout(deadline_s - time.monotonic()):
                    outcome = await self._attempt(order)
            except TimeoutError:
                break
            except DBAPIError as error:
                if not is_worth_a_retry(error):
                    raise
            except _MovedError:
                pass
            else:
                if outcome.event is not None:
                    self._publish(outcome.event)
                return outcome.feature
            await asyncio.sleep(random.uniform(0, pause_s))  # noqa: S311  # jitter, not a secret
            pause_s = min(2 * pause_s, _GREATEST_PAUSE_S)
        raise UnavailableError("the database did not take the action in time; send it again")

    async def repeat(self, order: Order, at: datetime) -> None:
        """Carry out an order of the log again, as of its time; nothing is published."""
        await self._attempt(order, at)

    async def _attempt(self, order: Order, at: datetime | None = None) -> _Outcome:
        """One transaction, as of `at` or else of now; it has committed when this returns."""
        async with self._database.write() as connection:
            repository = Repository(connection, self._life)
            tile = _tile_of(await _found(repository, order.obstacle_id))
            held = await repository.hold([tile])
            # Read again: until the lock was held, a report may have changed it, or moved it to another tile.
            before = await _found(repository, order.obstacle_id)
            if _tile_of(before) != tile:
                raise _MovedError
            _check_revision(order, before)
            # Not before the lock: what waited for it is decided, and told, after what it waited for.
            now = datetime.now(UTC) if at is None else at
            after = self._decided(before, order, now)
            if after is before:
                return _Outcome(feature_of(before, self._life))
            changes = WorkingSet(held, (before,), {}, self._life)
            event = changes.put(after, f"operator:{order.key_id}", now)
            changes.tiles[tile].lock_seq += 1
            await writing.write(connection, changes, self._life)
            if order.deed == "delete":
                await audit.erase_versions(connection, after)
            line = audit.line(order, before, after, {tile: changes.tiles[tile].lock_seq}, now)
            await connection.execute(tables.action.insert().values(line))
        return _Outcome(feature_of(after, self._life), event)

    def _decided(self, before: Obstacle, order: Order, now: datetime) -> Obstacle:
        if order.deed == "expire":
            return operating.expired(before, now, self._life)
        return operating.decide(before, order.deed, now)


class _MovedError(Exception):
    """The obstacle left the tile that was locked: lock its new one."""


async def _found(repository: Repository, identifier: UUID) -> Obstacle:
    found = await repository.obstacle(identifier)
    if found is None:
        raise ObstacleNotFoundError(f"there is no obstacle {identifier}")
    return found


def _check_revision(order: Order, before: Obstacle) -> None:
    if order.revisions is not None and before.revision not in order.revisions:
        raise RevisionMismatchError(f"the obstacle is at revision {before.revision}: read it again, then decide")


def _tile_of(obstacle: Obstacle) -> int:
    return tile_of_cell(cell_of(obstacle.place.position))
