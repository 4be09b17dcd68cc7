"""The application: `create_app(settings)` builds everything, nothing exists before."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI

from contract.observation import MAX_BODY_BYTES
from server import endpoints, errors
from server.body_limit import BodyLimit
from server.database import Database
from server.endpoints import Parts
from server.keys import Keys
from server.nearby import Nearby
from server.nearby_route import NearbyRoute
from server.operators import Operators
from server.policy import policy_named
from server.repository import Repository
from server.service import Service
from server.settings import Settings
from server.startup import make_ready
from server.stream import Hub
from server.upkeep import Upkeep


def create_app(settings: Settings) -> FastAPI:
    """The obstacle service as an ASGI application; the database is opened by its lifespan."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        database = Database.open(settings.database_url)
        try:
            app.state.parts = await _parts(database, settings)
            async with app.state.parts.service.running(), _background(app.state.parts.upkeep.run()):
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
    app.router.routes.append(NearbyRoute())
    for router in endpoints.ROUTERS:
        app.include_router(router)
    return app


@asynccontextmanager
async def _background(work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    """Do `work` beside the block, and stop it at its end."""
    task = asyncio.create_task(work)
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def _parts(database: Database, settings: Settings) -> Parts:
    keys, hub, policy = Keys(database, settings.bootstrap_operator_key), Hub(), policy_named(settings.policy)
    await make_ready(database, keys, settings)
    async with database.write() as connection:
        secret = await Repository(connection, policy.life).secret("witness", secrets.token_hex(32))
    operators = Operators(database, policy.life, settings.write_deadline_s, hub.publish)
    upkeep = Upkeep(database, operators, policy.life)
    service = Service(
        database, policy, secret, settings.write_deadline_s, hub.publish, distrusted=lambda: upkeep.distrusted
    )
    nearby = Nearby(database, policy.life, settings.cache_mib << 20)
    return Parts(database, keys, service, hub, policy.life, operators, nearby, upkeep)
