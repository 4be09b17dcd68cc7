"""A database that takes no writes: who is told, and when it is over."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import httpx
import psutil
import pytest
from fastapi import FastAPI
from sqlalchemy import event
from sqlalchemy.engine import make_url
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.pool import ConnectionPoolEntry

from server.settings import Settings
from server.storage.database import Database
from server.web import readiness
from tests.integration.asking import JSON, ago
from tests.integration.keys_of import client_of, opened
from tests.integration.serving import refused, served
from tests.integration.test_server_trust import batch, problem
from tests.unit.server.making import detection, message


def body(number: int = 0) -> str:
    return batch(message(detection(20 * number, 0), at=ago(1), number=number))


@asynccontextmanager
async def read_only(app: FastAPI) -> AsyncIterator[None]:
    """The server's connections take no writes within the block."""
    database: Database = app.state.parts.database
    await _set_read_only(database, True)
    try:
        yield
    finally:
        await _set_read_only(database, False)


def _only_read(connection: DBAPIConnection, _entry: ConnectionPoolEntry) -> None:
    connection.cursor().execute("PRAGMA query_only=1")


async def _set_read_only(database: Database, yes: bool) -> None:
    if database.is_sqlite:
        while database.connections[0]:  # noqa: ASYNC110  # the round at the start may still be reading
            await asyncio.sleep(0.01)
        # Each connection of the pool, and those that are opened meanwhile.
        async with AsyncExitStack() as held:
            for _ in range(max(1, sum(database.connections))):
                connection = await held.enter_async_context(database.read())
                await connection.exec_driver_sql(f"PRAGMA query_only={int(yes)}")
            (event.listen if yes else event.remove)(connection.engine.sync_engine, "connect", _only_read)
        return
    async with database.read() as connection:
        name = make_url(str(connection.engine.url)).database
        await connection.exec_driver_sql("SET TRANSACTION READ WRITE")
        await connection.exec_driver_sql(f'ALTER DATABASE "{name}" SET default_transaction_read_only = {int(yes)}')
        await connection.commit()
        # Sessions keep what they began with.
        others = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database() AND pid <>"
        await connection.exec_driver_sql(f"{others} pg_backend_pid()")
        await connection.invalidate()


async def test_a_server_whose_database_takes_no_writes_is_not_ready_until_it_does(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(readiness, "_PROBE_EVERY_S", 0.0)
    async with opened(settings.model_copy(update={"write_deadline_s": 0.5})) as app, client_of(app) as client:
        assert (await client.post("/v1/observations", content=body(), headers=JSON)).status_code == 200
        async with read_only(app):
            for number in (1, 2):
                lost = await client.post("/v1/observations", content=body(number), headers=JSON)
                assert problem(lost) == (503, "unavailable")
                asked = await client.get("/readyz")
                assert problem(asked) == (503, "unavailable")
                assert asked.json()["detail"] == "the database takes no writes: the database is read-only"
            assert (await client.get("/v1/obstacles?lat=38.2466&lon=21.7346")).json()["features"]
        # No report need come: whoever is not ready gets none.
        assert (await client.get("/readyz")).status_code == 200
        assert (await client.post("/v1/observations", content=body(1), headers=JSON)).status_code == 200
    told = [(item.levelno, item.message) for item in caplog.records if item.name == "server.storage.write_health"]
    assert told == [
        (logging.ERROR, "the database takes no writes: the database is read-only"),
        (logging.WARNING, "the database takes writes again"),
    ]


def test_a_disk_that_fails_is_told_by_the_log_and_by_readiness(tmp_path: Path) -> None:
    with served(tmp_path / "headsup.sqlite3", HEADSUP_WRITE_DEADLINE_S="0.5") as server, server.client() as client:
        assert client.post("/v1/observations", content=body(), headers=JSON).status_code == 200
        process = psutil.Process(server.process.pid)
        _, most = process.rlimit(psutil.RLIMIT_FSIZE)
        written = (tmp_path / "headsup.sqlite3-wal").stat().st_size
        process.rlimit(psutil.RLIMIT_FSIZE, (written, most))
        lost: httpx.Response = client.post("/v1/observations", content=body(1), headers=JSON)
        not_ready = client.get("/readyz")
        process.rlimit(psutil.RLIMIT_FSIZE, (most, most))
        again = client.post("/v1/observations", content=body(1), headers=JSON)
    assert [problem(lost), problem(not_ready)] == [(503, "unavailable")] * 2
    assert again.json()["results"][0]["status"] == "accepted"
    assert server.log().count("the database takes no writes: the disk") == 1


def test_a_database_that_cannot_be_opened_is_refused_with_its_cause(tmp_path: Path) -> None:
    (tmp_path / "damaged").write_text("no database" * 1_000)
    causes = {"damaged": "file is not a database", "": "is no file", "nowhere/at/all": "No such file or directory"}
    for name, cause in causes.items():
        (told,) = refused(HEADSUP_DATABASE_URL=f"sqlite+aiosqlite:///{tmp_path}/{name}").splitlines()
        assert told.startswith("the database cannot be opened: ")
        assert told.endswith(cause)


def test_only_its_owner_may_read_a_database_of_sqlite(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        with served(tmp_path / "headsup.sqlite3"):
            modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.glob("*.sqlite3*")}
    finally:
        os.umask(before)
    assert modes == {f"headsup.sqlite3{end}": 0o600 for end in ("", "-wal", "-shm")}
