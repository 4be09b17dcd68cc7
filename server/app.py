"""The application: `create_app(settings)` builds everything, nothing exists before."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from importlib.metadata import version
from typing import Any

from fastapi import FastAPI
from starlette.middleware.cors import CORSMiddleware
from starlette.types import Receive, Scope, Send

from contract.observation import MAX_BODY_BYTES
from server import errors
from server.ingesting.service import Service
from server.operators import Operators
from server.policy_file import policy_of
from server.push.relay import Relay
from server.push.stream import Hub
from server.reading.nearby import Nearby
from server.reading.tile_reader import TileReader
from server.settings import Settings
from server.startup import make_ready
from server.storage.database import Database
from server.storage.repository import Repository
from server.trust.admission import Admission
from server.trust.keys import Keys
from server.upkeep import Upkeep
from server.web import endpoints, posted
from server.web.body_limit import BodyLimit
from server.web.edge import Edge
from server.web.endpoints import Parts
from server.web.head import Head
from server.web.journal import Journal
from server.web.metrics import Metrics, RequestCounts
from server.web.nearby_route import NearbyLane
from server.web.readiness import Readiness

_LOG = logging.getLogger(__name__)


class _Application(FastAPI):
    """The framework's application behind `NearbyLane`: its own layers take longer than a nearby query."""

    def __init__(self, journal: Journal, **named: Any) -> None:
        super().__init__(**named)
        self._lane = NearbyLane(super().__call__, self.state, journal)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        await self._lane(scope, receive, send)

    def openapi(self) -> dict[str, Any]:
        """The OpenAPI document."""
        return posted.described(super().openapi())


def create_app(settings: Settings) -> FastAPI:
    """The obstacle service as an ASGI application; the database is opened by its lifespan."""
    counts = RequestCounts()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        database = Database.open(settings.database_url)
        try:
            app.state.parts = await _parts(database, settings)
            app.state.metrics = Metrics(app.state.parts, counts)
            parts: Parts = app.state.parts
            async with parts.service.running(), _background(parts.upkeep.run()), _background(parts.relay.run()):
                yield
        finally:
            await database.close()

    app = _Application(
        journal := Journal(counts, settings.log_requests),
        title="HeadsUp",
        summary="A car that sees a pothole warns every car behind it.",
        version=version("headsup"),
        lifespan=lifespan,
    )
    app.state.settings, app.state.readiness = settings, Readiness()
    _wrap(app, settings, journal)
    errors.install(app)
    for router in endpoints.ROUTERS:
        app.include_router(router)
    return app


def _wrap(app: FastAPI, settings: Settings, journal: Journal) -> None:
    """Layers around the routes; the last one added is the outermost."""
    app.add_middleware(BodyLimit, limit_bytes=MAX_BODY_BYTES)
    if settings.cors_origins:
        app.add_middleware(
            CORSMiddleware,
            allow_origins=settings.cors_origins,
            allow_methods=["GET"],
            allow_headers=["Authorization", "If-None-Match"],
            expose_headers=["ETag", "Link", "Retry-After", "X-Request-Id"],
        )
    app.add_middleware(Head)
    app.add_middleware(Edge, journal=journal)


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
    keys, hub, policy = Keys(database, settings.bootstrap_operator_key), Hub(), policy_of(settings)
    if not await make_ready(database, keys, settings):
        _LOG.warning("running open: there is no API key, so everybody on this machine may read and post")
    async with database.write() as connection:
        secret = await Repository(connection, policy.life).secret("witness", secrets.token_hex(32))
    operators = Operators(database, policy.life, settings.write_deadline_s, hub.publish)
    upkeep = Upkeep(database, operators, policy.life)
    service = Service(
        database, policy, secret, settings.write_deadline_s, hub.publish, distrusted=lambda: upkeep.distrusted
    )
    nearby = Nearby(database, policy.life, settings.cache_mib << 20)
    relay = Relay(TileReader(database, policy.life), hub, service.near)
    return Parts(database, keys, Admission(keys, settings), service, hub, policy.life, operators, nearby, upkeep, relay)
