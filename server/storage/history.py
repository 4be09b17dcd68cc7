"""What became of an obstacle: events, shapes and operators' actions in one order of time, read in pages."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from sqlalchemy import RowMapping, select
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.history import HistoryAction, HistoryEntry, HistoryEvent, HistoryVersion
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.geometry.quadkey import shard_of_tile, tiles
from server.life.obstacle import Obstacle
from server.storage import audit, tables
from server.storage.versions import Version, all_versions

# At one moment: what was measured, then what an operator did, then what was told of it.
_VERSION, _ACTION, _EVENT = 0, 1, 2
# Twice the drift that the rule's default allows.
_GREATEST_DRIFT_M = 40.0


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """Where an entry stands in a history: its time, its sort, and its number among those of its sort.

    Numbers are a version's, an event's revision, and the revision that an action found.
    """

    at: datetime
    sort: int
    number: int


Entry = tuple[Place, HistoryEntry]


@dataclass(frozen=True, slots=True)
class HistoryPage:
    """Entries, oldest first, and the last one's place when more follow."""

    entries: tuple[HistoryEntry, ...]
    more_behind: Place | None


async def read(connection: AsyncConnection, obstacle: Obstacle, after: Place | None, limit: int) -> HistoryPage:
    """A page of an obstacle's history, beginning behind `after`."""
    versions = [_of_version(version) for version in await all_versions(connection, obstacle)]
    actions = [_of_action(row) for row in await _actions(connection, obstacle, after, limit)]
    events = await _events(connection, obstacle, after, limit, frozenset(_after_removal(actions)))
    entries = (entry for entry in (*versions, *actions, *events) if after is None or entry[0] > after)
    ordered = sorted(entries, key=lambda entry: entry[0])
    page = ordered[:limit]
    return HistoryPage(tuple(entry for _, entry in page), page[-1][0] if len(ordered) > limit else None)


async def _events(
    connection: AsyncConnection, obstacle: Obstacle, after: Place | None, limit: int, no_removals: frozenset[datetime]
) -> list[Entry]:
    """Events behind `after`, at least one more than `limit` if there are as many."""
    table = tables.event
    query = (
        select(table.c.written_at, table.c.body)
        .where(table.c.shard.in_(_shards(obstacle)), table.c.obstacle_id == obstacle.id)
        .order_by(table.c.written_at)
    )
    if after is not None:
        query = query.where(table.c.written_at >= after.at)
    found: dict[Place, HistoryEntry] = {}
    latest_at: datetime | None = None
    async with connection.stream(query) as events:
        async for row in events.mappings():
            place, entry = _of_event(row, no_removals)
            # Events of one transaction have one time, and come in no order: all of them are read.
            if len(found) > limit and place.at != latest_at:
                break
            latest_at = place.at
            if after is None or place > after:
                # An obstacle that moves to another tile is announced in both.
                found.setdefault(place, entry)
    return list(found.items())


async def _actions(
    connection: AsyncConnection, obstacle: Obstacle, after: Place | None, limit: int
) -> Sequence[RowMapping]:
    """Actions at or behind `after`, at least one more behind it than `limit` if there are as many."""
    table = tables.action
    query = select(table).where(table.c.shard == obstacle.shard, table.c.obstacle_id == obstacle.id)
    if after is not None:
        query = query.where(table.c.at >= after.at)
    return (await connection.execute(query.order_by(table.c.at, table.c.id).limit(limit + 2))).mappings().all()


def _after_removal(actions: Iterable[tuple[Place, HistoryAction]]) -> Iterator[datetime]:
    """When operators changed what was removed already: those events tell of no second removal."""
    for place, action in actions:
        if action.before is not None and action.before.state is State.REMOVED:
            yield place.at


def _shards(obstacle: Obstacle) -> list[int]:
    """Shards whose events may be the obstacle's: it drifts from its birth, but not far."""
    return sorted({shard_of_tile(tile) for tile in tiles(obstacle.born_at, _GREATEST_DRIFT_M)})


def _of_version(version: Version) -> Entry:
    shape = version.shape
    entry = HistoryVersion(
        at=shape.observed_at,
        version=version.number,
        box=shape.box,
        box_sd=shape.box_sd,
        volume_m3=shape.volume_m3,
        points=len(shape.points_cm),
        until=version.replaced_at,
    )
    return Place(shape.observed_at, _VERSION, version.number), entry


def _of_event(row: RowMapping, no_removals: frozenset[datetime]) -> Entry:
    feature = ObstacleFeature.model_validate_json(row["body"])
    properties = feature.properties
    what: Literal["created", "updated", "removed"] = "created" if properties.revision == 1 else "updated"
    if properties.state is State.REMOVED and row["written_at"] not in no_removals:
        what = "removed"
    entry = HistoryEvent(at=row["written_at"], what=what, reason=properties.removed_reason, obstacle=feature)
    return Place(row["written_at"], _EVENT, properties.revision), entry


def _of_action(row: RowMapping) -> tuple[Place, HistoryAction]:
    before, after = audit.standings(row)
    entry = HistoryAction(at=row["at"], action=row["kind"], before=before, after=after)
    return Place(row["at"], _ACTION, 0 if before is None else before.revision), entry
