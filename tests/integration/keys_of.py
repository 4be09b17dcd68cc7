"""Applications in this process with keys of several roles, for the tests of trust and operation."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
from fastapi import FastAPI

from server.app import create_app
from server.settings import Settings
from server.trust.keys import Role


@asynccontextmanager
async def opened(settings: Settings) -> AsyncIterator[FastAPI]:
    """A running application."""
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        yield app


def client_of(app: FastAPI, address: str = "127.0.0.1") -> httpx.AsyncClient:
    """A client of it that calls from an address."""
    transport = httpx.ASGITransport(app, client=(address, 40_000))
    return httpx.AsyncClient(transport=transport, base_url="http://localhost")


async def keyed(app: FastAPI, *roles: Role) -> list[str]:
    """New keys of these roles."""
    return [await app.state.parts.keys.create(role, f"{role.value}{number}") for number, role in enumerate(roles)]


def bearer(key: str) -> dict[str, str]:
    """The header that shows a key."""
    return {"Authorization": f"Bearer {key}"}
