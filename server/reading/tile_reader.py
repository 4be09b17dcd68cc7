"""Tiles from the database: their versions, all that is live in one, and what changed in it since a version."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from uuid import UUID

from sqlalchemy import and_, bindparam, func, select
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.geometry.quadkey import cell_of, cells_of_tile, shard_of_tile, tile_of_cell
from server.life.identity import shard_of_id
from server.life.policy import Life
from server.reading.collection import mark_of
from server.reading.tile_cache import Served, TileChange, TileFeatures
from server.storage import rows, tables
from server.storage.database import Database
from server.storage.executing import executor_of
from server.storage.features import feature_of
from server.storage.rows import Row
from server.storage.statements import tile_versions_of_arrays

Versions = Mapping[int, int]
"""Versions by tile; a tile without one was never written to."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Beyond this, reading the tile anew costs less than its changes.
_MOST_CHANGES = 256

_obstacle, _event = tables.obstacle, tables.event
_VERSION = select(tables.tile.c.version).where(
    tables.tile.c.shard == bindparam("shard"), tables.tile.c.tile == bindparam("tile")
)
_VERSIONS = "SELECT tile, version FROM tile WHERE shard = ANY($1::int2[]) AND tile = ANY($2::int8[])"
# Of SQLite: shards and tiles as one parameter. Near 85 degrees a circle has hundreds of tiles, and a statement with as
# many parameters takes SQLAlchemy seconds to make, during which nobody is served.
_WANTED = func.json_each(bindparam("wanted")).table_valued("value")
_WANTED_SHARD, _WANTED_TILE = (func.json_extract(_WANTED.c.value, place) for place in ("$[0]", "$[1]"))
_VERSIONS_OF_JSON = select(tables.tile.c.tile, tables.tile.c.version).select_from(
    _WANTED.join(tables.tile, and_(tables.tile.c.shard == _WANTED_SHARD, tables.tile.c.tile == _WANTED_TILE))
)
# The texts as they are served, and no more: shapes with their points are ten times as long.
_SERVED = (_obstacle.c.id, _obstacle.c.revision, _obstacle.c.latitude_deg, _obstacle.c.longitude_deg)
_LIVE = select(*_SERVED, _obstacle.c.expires_at, _obstacle.c.feature).where(
    _obstacle.c.cell.between(bindparam("low"), bindparam("high")),
    _obstacle.c.state != State.REMOVED.value,
    _obstacle.c.expires_at > bindparam("now", type_=_obstacle.c.expires_at.type),
)
_WHOLE = select(_obstacle).where(
    _obstacle.c.shard == bindparam("shard"), _obstacle.c.id == bindparam("id", type_=_obstacle.c.id.type)
)
_CHANGES = (
    select(_event.c.seq, _event.c.body)
    .where(_event.c.shard == bindparam("shard"), _event.c.tile == bindparam("tile"), _event.c.seq > bindparam("after"))
    .order_by(_event.c.seq)
    .limit(_MOST_CHANGES + 1)
)


class TileReader:
    """Reads tiles for the cache."""

    def __init__(self, database: Database, life: Life) -> None:
        self._database, self._life = database, life

    async def versions(self, wanted: Sequence[int]) -> Versions:
        """The present versions of any number of tiles, for one caller at a time."""
        if self._database.driver is None:
            return await self.versions_aside(wanted)
        shards = sorted({shard_of_tile(number) for number in wanted})
        return dict(await self._database.driver.fetch(_VERSIONS, shards, wanted))

    async def versions_aside(self, wanted: Sequence[int]) -> Versions:
        """The same on a connection of its own, for whoever nearby queries must not wait for."""
        shards = list(map(shard_of_tile, wanted))
        async with self._database.read() as connection:
            found: Iterable[Row]
            if self._database.is_sqlite:
                values = {"wanted": json.dumps(list(zip(shards, wanted, strict=True)))}
                found = (await connection.execute(_VERSIONS_OF_JSON, values)).mappings()
            else:
                executor = await executor_of(connection)
                found = await executor.rows(tile_versions_of_arrays(), {"shards": shards, "tiles": wanted})
            return {row["tile"]: row["version"] for row in found}

    async def tile(self, tile: int) -> TileFeatures:
        """All that is live in a tile, as of its version."""
        low, high = cells_of_tile(tile)
        here = {"shard": shard_of_tile(tile), "tile": tile}
        async with self._database.read() as connection:
            version = (await connection.execute(_VERSION, here)).scalar_one()
            while True:
                values = {"low": low, "high": high, "now": datetime.now(UTC)}
                found = (await connection.execute(_LIVE, values)).all()
                before, version = version, (await connection.execute(_VERSION, here)).scalar_one()
                # Between two equal versions nothing has changed.
                if before == version:
                    return TileFeatures(version, [await self._served(connection, *row) for row in found])

    async def changes(self, tile: int, after: int) -> list[TileChange] | None:
        """What changed in a tile after a version; None when that is too much, or no longer in the log."""
        logged = await self.logged(tile, after)
        return None if logged is None else [_change(tile, seq, body) for seq, body in logged]

    async def logged(self, tile: int, after: int) -> list[tuple[int, str]] | None:
        """The same as lines of the log: number and encoded feature."""
        async with self._database.read() as connection:
            values = {"shard": shard_of_tile(tile), "tile": tile, "after": after}
            found = (await connection.execute(_CHANGES, values)).all()
        if not found or len(found) > _MOST_CHANGES or found[0].seq != after + 1:
            return None
        return [(row.seq, row.body) for row in found]

    async def _served(
        self,
        connection: AsyncConnection,
        identifier: UUID,
        revision: int,
        latitude_deg: float,
        longitude_deg: float,
        expires_at: datetime,
        body: str | None,
    ) -> Served:
        if body is None:
            # Stored before texts were, and not seen since.
            row = (await connection.execute(_WHOLE, {"shard": shard_of_id(identifier), "id": identifier})).mappings()
            body = feature_of(rows.obstacle_of(row.one()), self._life).model_dump_json()
        mark = mark_of(identifier, revision)
        return Served(mark, latitude_deg, longitude_deg, microseconds(expires_at), body.encode())


def _change(tile: int, seq: int, body: str) -> TileChange:
    feature = ObstacleFeature.model_validate_json(body)
    is_here = tile_of_cell(cell_of(feature.position)) == tile
    is_served = is_here and feature.properties.state is not State.REMOVED
    return TileChange(seq, feature.id.bytes, _served(feature, body) if is_served else None)


def _served(feature: ObstacleFeature, body: str) -> Served:
    return Served(
        mark=mark_of(feature.id, feature.properties.revision),
        latitude_deg=feature.position.latitude_deg,
        longitude_deg=feature.position.longitude_deg,
        expires_at_us=microseconds(feature.properties.expires_at),
        body=body.encode(),
    )


def microseconds(moment: datetime) -> int:
    """A moment as it is kept in memory: since 1970."""
    return (moment - _EPOCH) // timedelta(microseconds=1)
