"""The application: `create_app(settings)` builds everything, nothing exists before."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from contract.observation import MAX_BODY_BYTES
from server import endpoints, errors
from server.body_limit import BodyLimit
from server.database import Database
from server.endpoints import Parts
from server.keys import Keys
from server.policy import policy_named
from server.repository import Repository
from server.service import Service
from server.settings import Settings
from server.startup import make_ready
from server.stream import Hub


def create_app(settings: Settings) -> FastAPI:
    """The obstacle service as an ASGI application; the database is opened by its lifespan."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        database = Database.open(settings.database_url)
        try:
            app.state.parts = await _parts(database, settings)
            async with app.state.parts.service.running():
                yield
        finally:
            await database.close()

    app = FastAPI(
        title="HeadsUp",
        summary="A car that sees a pothole warns every car behind it.",
        version=version("headsup"),
        lifespan=lifespan,
    )
    app.add_middleware(BodyLimit, limit_bytes=MAX_BODY_BYTES)
    errors.install(app)
    for router in (endpoints.api, endpoints.push, endpoints.operation):
        app.include_router(router)
    return app


async def _parts(database: Database, settings: Settings) -> Parts:
    keys, hub, policy = Keys(database, settings.bootstrap_operator_key), Hub(), policy_named(settings.policy)
    await make_ready(database, keys, settings)
    async with database.write() as connection:
        secret = await Repository(connection, policy.life).secret("witness", secrets.token_hex(32))
    service = Service(database, policy, secret, settings.write_deadline_s, hub.publish)
    return Parts(database, keys, service, hub)
