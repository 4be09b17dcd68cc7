"""The log of operators' actions: what is written of one, and reading the log in pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from uuid import UUID

from sqlalchemy import RowMapping, select, tuple_, update
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.history import ActionRecord, Standing
from server.life import operating
from server.life.identity import obstacle_id, shard_of_id
from server.life.obstacle import Obstacle
from server.life.operating import Deed
from server.storage import rows, tables
from server.storage.versions import stored_versions

Moment = tuple[datetime, UUID]
"""Where an action stands in the log."""


@dataclass(frozen=True, slots=True)
class Order:
    """Who wants what done to which obstacle, and in which revisions of it (None: in any)."""

    obstacle_id: UUID
    deed: Deed
    key_id: str
    request_id: str | None
    revisions: frozenset[int] | None

    @property
    def kind(self) -> str:
        """The action's name in the log."""
        return self.deed if isinstance(self.deed, str) else self.deed.action

    @property
    def detail(self) -> dict[str, Any]:
        """What a replay of the action needs besides its name: its own members."""
        return {} if isinstance(self.deed, str) else self.deed.model_dump(mode="json", exclude={"action"})


def line(order: Order, before: Obstacle, after: Obstacle, tiles: dict[int, int], now: datetime) -> dict[str, Any]:
    """Values of the table `action`; the id follows from the time, the key and the revision that was acted upon."""
    standings = {"before": operating.standing(before), "after": operating.standing(after)}
    return {
        "id": obstacle_id(now, after.shard, order.key_id, after.id, before.revision),
        "at": now,
        "key_id": order.key_id,
        "kind": order.kind,
        "shard": after.shard,
        "obstacle_id": after.id,
        "detail": order.detail | {name: item.model_dump(mode="json") for name, item in standings.items()},
        "request_id": order.request_id,
        "tiles": {str(tile): lock_seq for tile, lock_seq in tiles.items()},
    }


async def erase_versions(connection: AsyncConnection, obstacle: Obstacle) -> None:
    """Delete the points and descriptors of an obstacle's earlier versions."""
    table = tables.obstacle_version
    for version in await stored_versions(connection, obstacle.id):
        here = (table.c.shard == obstacle.shard) & (table.c.obstacle_id == obstacle.id)
        shape = rows.shape_json(operating.erased(version.shape))
        await connection.execute(update(table).where(here, table.c.version == version.number).values(shape=shape))


async def actions(
    connection: AsyncConnection, of_obstacle: UUID | None, after: Moment | None, limit: int
) -> Sequence[RowMapping]:
    """Lines of the log, oldest first, behind `after`."""
    table = tables.action
    query = select(table).order_by(table.c.at, table.c.id).limit(limit)
    if of_obstacle is not None:
        query = query.where(table.c.shard == shard_of_id(of_obstacle), table.c.obstacle_id == of_obstacle)
    if after is not None:
        # The first condition is what the index by time can use.
        query = query.where(table.c.at >= after[0], tuple_(table.c.at, table.c.id) > after)
    return (await connection.execute(query)).mappings().all()


def record(row: RowMapping) -> ActionRecord:
    """A line of the log as it is served."""
    before, after = standings(row)
    return ActionRecord(
        id=row["id"],
        at=row["at"],
        key_id=row["key_id"],
        action=row["kind"],
        obstacle_id=row["obstacle_id"],
        note=row["detail"].get("note", ""),
        before=before,
        after=after,
        request_id=row["request_id"],
    )


def standings(row: RowMapping) -> tuple[Standing | None, Standing | None]:
    """The obstacle before and after; None for an action that does not say."""
    detail = row["detail"]
    before, after = (Standing.model_validate(detail[name]) if name in detail else None for name in ("before", "after"))
    return before, after
