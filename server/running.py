"""The server process: uvicorn around the application, saying where it listens."""

from __future__ import annotations

import asyncio
import socket

import uvicorn

from server.app import create_app
from server.settings import Settings
from server.startup import preflight

# Requests under way may finish; longer than the longest write.
_GRACE_S = 10
# A position is some 150 bytes.
_MAX_WS_MESSAGE_BYTES = 4_096


def run(settings: Settings) -> int:
    """Serve until interrupted; the exit code. Raises a `ServiceError` when the server must not start."""
    asyncio.run(preflight(settings))
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level,
        # Queries carry positions, which are nobody's business.
        access_log=False,
        ws_max_size=_MAX_WS_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=_GRACE_S,
    )
    server = _AnnouncingServer(config)
    server.run()
    return 0 if server.started else 1


class _AnnouncingServer(uvicorn.Server):
    """Prints the address once it listens, for people and for scripts that asked for port 0."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            print(f"listening on http://{f'[{host}]' if ':' in host else host}:{port}", flush=True)
