"""A server that listens in this process, and bytes sent to it as no client library would."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, suppress

import uvicorn
from fastapi import FastAPI

from server.app import create_app
from server.running import listening
from server.settings import Settings


@asynccontextmanager
async def served_here(settings: Settings) -> AsyncIterator[tuple[FastAPI, int]]:
    """The application as it listens in production, and its port."""
    app = create_app(settings)
    server = uvicorn.Server(listening(app, settings.model_copy(update={"port": 0})))
    task = asyncio.create_task(server.serve())
    while not server.started:  # noqa: ASYNC110  # uvicorn offers no event
        await asyncio.sleep(0.01)
    yield app, server.servers[0].sockets[0].getsockname()[1]
    server.should_exit = True
    await task


async def exchanged(port: int, chunks: Iterable[bytes], until: bytes | None = None) -> bytes:
    """What the server answers until it closes, or to the end of `until`; what it takes no more is not sent."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    answer = asyncio.create_task(_read(reader, until))
    with suppress(ConnectionError):
        for chunk in chunks:
            if answer.done():
                break
            writer.write(chunk)
            await writer.drain()
            # So that the server, which runs in this loop, gets to answer.
            await asyncio.sleep(0)
    async with asyncio.timeout(30):
        found = await answer
    writer.close()
    return found


async def _read(reader: asyncio.StreamReader, until: bytes | None) -> bytes:
    found = b""
    with suppress(ConnectionError):
        while part := await reader.read(65_536):
            found += part
            if until is not None and until in found:
                break
    return found


def status_of(answer: bytes) -> int:
    """The status of the (first) answer; 0 for a connection that was closed without one."""
    return int(answer.split(b" ", 2)[1]) if answer else 0
