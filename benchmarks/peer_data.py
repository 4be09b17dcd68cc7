"""The service's own obstacles in PostGIS: each served field a column, as who begins with PostGIS would have it."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import asyncpg

BY_HAND, FEATURES = "obstacle", "feature"
"""Two tables of the same rows: places as geography, which knows metres, and as geometry, which the peers expect."""

_BOX, _BOX_SD, _COVARIANCE = "p->'box'->>", "p->'box_sd'->>", "p->'position_covariance'->>"
# Name, type, and where the service's feature has it.
_COLUMNS = (
    ("id", "uuid", "id"),
    ("latitude_deg", "double precision", "latitude_deg"),
    ("longitude_deg", "double precision", "longitude_deg"),
    *((name, "text", f"p->>'{name}'") for name in ("kind", "sign", "state")),
    *((name, "integer", f"p->>'{name}'") for name in ("version", "revision")),
    *((f"box_{name}", "integer", f"{_BOX}'{name}'") for name in ("length_mm", "width_mm", "relief_mm")),
    ("box_yaw_rad", "double precision", f"{_BOX}'yaw_rad'"),
    *(
        (f"box_sd_{name}", "double precision", f"{_BOX_SD}'{name}'")
        for name in ("ln_length", "ln_width", "ln_area", "relief_mm")
    ),
    ("volume_m3", "double precision", "p->>'volume_m3'"),
    *((name, "double precision", f"{_COVARIANCE}'{name}'") for name in ("east_m2", "north_m2", "east_north_m2")),
    *((name, "double precision", f"p->>'{name}'") for name in ("altitude_m", "confidence", "half_life_s")),
    *(
        (name, "timestamp with time zone", f"p->>'{name}'")
        for name in ("as_of", "expires_at", "first_seen", "last_seen")
    ),
    *((name, "integer", f"p->>'{name}'") for name in ("sightings", "witnesses")),
    *((name, "uuid", f"p->>'{name}'") for name in ("succeeds", "merged_into")),
    *((name, "text", f"p->>'{name}'") for name in ("removed_reason", "inspection_state")),
)
# The latest moments tell one filling from another, in microseconds as the service stores them.
_FINGERPRINT = "SELECT count(*), max(last_seen), max(expires_at) FROM obstacle WHERE state <> 'removed'"
_FINGERPRINT_THERE = """
    SELECT count(*), (extract(epoch FROM max(last_seen)) * 1000000)::bigint,
           (extract(epoch FROM max(expires_at)) * 1000000)::bigint FROM obstacle WHERE state <> 'removed'
"""


async def fill(service_url: str, peers_url: str, advance: Callable[[int, int], None]) -> None:
    """Bring what the service's database holds to the peers' one, unless it is there; both are drivers' URLs.

    `advance` is told how many obstacles there are, and how many of them have come.
    """
    source, target = await asyncpg.connect(service_url), await asyncpg.connect(peers_url)
    try:
        wanted = await source.fetchrow(_FINGERPRINT)
        if tuple(wanted) != await _held(target):
            await _copy(source, target, lambda done: advance(wanted[0], done))
    finally:
        await source.close()
        await target.close()


async def create(maintenance_url: str, name: str) -> None:
    """A database with PostGIS, made unless it is there."""
    connection = await asyncpg.connect(maintenance_url)
    try:
        if not await connection.fetchval("SELECT count(*) FROM pg_database WHERE datname = $1", name):
            await connection.execute(f'CREATE DATABASE "{name}"')
    finally:
        await connection.close()


async def _held(target: asyncpg.Connection) -> tuple[Any, ...]:
    if await target.fetchval("SELECT to_regclass($1) IS NULL", BY_HAND):
        return ()
    return tuple(await target.fetchrow(_FINGERPRINT_THERE))


async def _copy(source: asyncpg.Connection, target: asyncpg.Connection, advance: Callable[[int], None]) -> None:
    await target.execute(_tables())
    names, done = [name for name, _, _ in _COLUMNS], 0
    for (shard,) in await source.fetch("SELECT DISTINCT shard FROM obstacle ORDER BY shard"):
        rows = io.BytesIO()
        copied = await source.copy_from_query(_selection(), shard, output=rows, format="binary")
        for table in (FEATURES, BY_HAND):
            rows.seek(0)
            await target.copy_to_table(table, source=rows, columns=names, format="binary")
        done += int(copied.split()[-1])
        advance(done)
    # The peers' features have their place once, as ours have.
    await target.execute(f"ALTER TABLE {FEATURES} ALTER geom DROP EXPRESSION")
    await target.execute(f"ALTER TABLE {FEATURES} DROP latitude_deg, DROP longitude_deg")
    await target.execute(f"CREATE INDEX ON {BY_HAND} USING gist (place); CREATE INDEX ON {FEATURES} USING gist (geom)")
    await target.execute(f"ALTER TABLE {BY_HAND} ADD PRIMARY KEY (id); ALTER TABLE {FEATURES} ADD PRIMARY KEY (id)")
    await target.execute("VACUUM ANALYZE")
    await target.execute("CHECKPOINT")


def _tables() -> str:
    columns = ", ".join(f"{name} {kind}" for name, kind, _ in _COLUMNS)
    point = "ST_SetSRID(ST_MakePoint(longitude_deg, latitude_deg), 4326)"
    place = f"place geography(Point, 4326) GENERATED ALWAYS AS ({point}::geography) STORED"
    geom = f"geom geometry(Point, 4326) GENERATED ALWAYS AS ({point}) STORED"
    return f"""
        CREATE EXTENSION IF NOT EXISTS postgis;
        DROP TABLE IF EXISTS {BY_HAND}, {FEATURES};
        CREATE TABLE {BY_HAND} ({columns}, {place});
        CREATE TABLE {FEATURES} ({columns}, {geom});
    """


def _selection() -> str:
    fields = ", ".join(f"({source})::{kind} AS {name}" for name, kind, source in _COLUMNS)
    return f"""
        SELECT {fields} FROM obstacle, LATERAL (SELECT feature::jsonb -> 'properties' AS p OFFSET 0) AS served
        WHERE shard = $1 AND state <> 'removed'
    """  # noqa: S608  # our own names
