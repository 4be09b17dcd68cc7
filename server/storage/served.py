"""Obstacles as readers get them, from the text that was written with each; shapes with their points are not read."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any
from uuid import UUID

from sqlalchemy import Row, Select, select
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.obstacle import ObstacleFeature
from server.life.identity import shard_of_id
from server.life.policy import Life
from server.storage import rows, tables
from server.storage.features import feature_of

Texts = Sequence[Row[UUID, str | None]]

SERVED = (tables.obstacle.c.id, tables.obstacle.c.feature)
"""The columns that are read."""


async def read(connection: AsyncConnection, query: Select[Any], life: Life) -> tuple[ObstacleFeature, ...]:
    """The obstacles that a `select` of `SERVED` finds, in its order."""
    found: Texts = (await connection.execute(query)).all()
    # Stored before texts were, and not seen since.
    textless = [row.id for row in found if row.feature is None]
    made = await _made(connection, textless, life) if textless else {}
    # In a thread: a thousand texts must not hold up those who ask for what is near.
    return await asyncio.to_thread(_features, found, made)


async def _made(connection: AsyncConnection, identifiers: Sequence[UUID], life: Life) -> dict[UUID, ObstacleFeature]:
    table = tables.obstacle
    shards = sorted(set(map(shard_of_id, identifiers)))
    query = select(table).where(table.c.shard.in_(shards), table.c.id.in_(identifiers))
    whole = (await connection.execute(query)).mappings()
    return {row["id"]: feature_of(rows.obstacle_of(row), life) for row in whole}


def _features(found: Texts, made: Mapping[UUID, ObstacleFeature]) -> tuple[ObstacleFeature, ...]:
    return tuple(
        made[row.id] if row.feature is None else ObstacleFeature.model_validate_json(row.feature) for row in found
    )
