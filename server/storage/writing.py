"""Writes what a transaction decided, in bulk: one statement for each table, whatever the number of reports."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import TypeAdapter
from sqlalchemy import Table, Update, bindparam, case, literal_column, update
from sqlalchemy.ext.asyncio import AsyncConnection

from server.geometry.quadkey import shard_of_tile
from server.life.identity import shard_of_id
from server.life.obstacle import Obstacle
from server.life.plausibility import LastPlace
from server.life.policy import Life
from server.storage import rows, tables
from server.storage.executing import Executor, executor_of
from server.storage.working_set import WorkingSet

HeldTiles = dict[int, int]
"""Tiles that a report locked, with its `lock_seq` there: the order in which reports were decided."""
_held = TypeAdapter(HeldTiles)


@dataclass(frozen=True, slots=True)
class LoggedReport:
    """A line of the observation log: what was sent, and what was answered."""

    key_id: str
    report_id: UUID
    body_sha256: str
    witness: str
    observed_at: datetime
    received_at: datetime
    body: str
    answer: str
    tiles: HeldTiles


async def write(connection: AsyncConnection, changes: WorkingSet, life: Life) -> None:
    """Write obstacles, evidence, ended versions and events, and advance the tiles."""
    to = await executor_of(connection)
    created = [rows.row_of(obstacle, life) | _feature(changes, obstacle) for obstacle in changes.created]
    await to.insert(tables.obstacle, created)
    changed = [rows.row_of(obstacle, life) | _feature(changes, obstacle) for obstacle in changes.changed]
    await _update(to, _UPDATE_OBSTACLE, [row for row in changed if "feature" in row])
    await _update(to, _UPDATE_UNSERVED, [row for row in changed if "feature" not in row])
    await to.insert(tables.obstacle_version, _ended_versions(changes))
    evidence = {
        key: rows.witness_row(shard_of_id(key[0]), key[0], witness) for key, witness in changes.evidence.items()
    }
    await to.insert(tables.witness, [row for key, row in evidence.items() if key not in changes.stored_evidence])
    await _update(to, _UPDATE_WITNESS, [row for key, row in evidence.items() if key in changes.stored_evidence])
    await to.insert(tables.creation, _creations(changes))
    await _update(to, _UPDATE_CREATION, _outcomes(changes))
    await to.insert(tables.event, _events(changes))
    await _update(to, _UPDATE_TILE, _tiles(changes))


async def move(connection: AsyncConnection, places: Mapping[str, LastPlace], known: Container[str]) -> None:
    """Write where witnesses were last; `known` have a row already. In one order, so that transactions do not cross."""
    to = await executor_of(connection)
    values = [
        {
            "witness": witness,
            "observed_at": place.observed_at,
            "latitude_deg": place.position.latitude_deg,
            "longitude_deg": place.position.longitude_deg,
            "sd_m": place.sd_m,
        }
        for witness, place in sorted(places.items())
    ]
    await to.insert(tables.vehicle_place, [row for row in values if row["witness"] not in known])
    await _update(to, _UPDATE_PLACE, [row for row in values if row["witness"] in known])


async def log(connection: AsyncConnection, lines: Sequence[LoggedReport]) -> None:
    """Append to the observation log; the primary key refuses a second line of one report's name."""
    to = await executor_of(connection)
    values = [
        {
            "key_id": line.key_id,
            "report_id": line.report_id,
            "body_sha256": line.body_sha256,
            "witness": line.witness,
            "observed_at": line.observed_at,
            "received_at": line.received_at,
            "body": line.body,
            "answer": line.answer,
            "tiles": _held.dump_json(line.tiles).decode(),
        }
        for line in lines
    ]
    await to.insert(tables.report, values)


def _feature(changes: WorkingSet, obstacle: Obstacle) -> dict[str, str]:
    """The column `feature` when it is to be written."""
    text = changes.features.get(obstacle.id)
    return {} if text is None else {"feature": text}


def _ended_versions(changes: WorkingSet) -> list[dict[str, Any]]:
    return [
        {
            "shard": ended.obstacle.shard,
            "obstacle_id": ended.obstacle.id,
            "version": ended.obstacle.version,
            "shape": rows.shape_json(ended.obstacle.shape),
            "replaced_at": ended.replaced_at,
        }
        for ended in changes.ended
    ]


def _events(changes: WorkingSet) -> list[dict[str, Any]]:
    return [
        {
            "shard": shard_of_tile(line.tile),
            "tile": line.tile,
            "seq": line.seq,
            "obstacle_id": line.obstacle_id,
            "body": line.body,
            "written_at": line.written_at,
        }
        for line in changes.events
    ]


def _creations(changes: WorkingSet) -> list[dict[str, Any]]:
    return [
        {
            "shard": shard_of_id(creation.obstacle_id),
            "obstacle_id": creation.obstacle_id,
            "witness": creation.witness,
            "created_at": creation.created_at,
            "outcome": "sole",
        }
        for creation in changes.creations
    ]


def _outcomes(changes: WorkingSet) -> list[dict[str, Any]]:
    return [
        {"shard": shard_of_id(identifier), "obstacle_id": identifier, "outcome": outcome, "by": by}
        for identifier, (outcome, by) in changes.outcomes.items()
    ]


def _tiles(changes: WorkingSet) -> list[dict[str, Any]]:
    return [
        {"shard": shard_of_tile(number), "tile": number, "version": tile.version, "lock_seq": tile.lock_seq}
        for number, tile in changes.tiles.items()
    ]


async def _update(to: Executor, statement: Update, values: list[dict[str, Any]]) -> None:
    """Update rows by their primary key; the names of its columns are bound with a trailing underscore."""
    await to.update(statement, [{f"{name}_": value for name, value in row.items()} for row in values])


def _update_by_key(table: Table, *untouched: str) -> Update:
    key = table.primary_key.columns
    here = [column == bindparam(f"{column.name}_") for column in key]
    rest: dict[str, Any] = {
        column.name: bindparam(f"{column.name}_")
        for column in table.columns
        if column.name not in key and column.name not in untouched
    }
    return update(table).where(*here).values(rest)


_UPDATE_OBSTACLE = _update_by_key(tables.obstacle)
_UPDATE_UNSERVED = _update_by_key(tables.obstacle, "feature")
_UPDATE_WITNESS = _update_by_key(tables.witness)
_UPDATE_PLACE = _update_by_key(tables.vehicle_place)
_UPDATE_CREATION = (
    update(tables.creation)
    .where(
        tables.creation.c.shard == bindparam("shard_"),
        tables.creation.c.obstacle_id == bindparam("obstacle_id_"),
        tables.creation.c.outcome == literal_column("'sole'"),
    )
    # Whoever takes back what only they had reported is not refuted by it.
    .values(
        outcome=case(
            (tables.creation.c.witness == bindparam("by_"), literal_column("'withdrawn'")), else_=bindparam("outcome_")
        )
    )
)
_UPDATE_TILE = _update_by_key(tables.tile)
