"""The server process: uvicorn around the application, saying where it listens, and ending without losing an answer."""

from __future__ import annotations

import asyncio
import gc
import logging
import math
import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from types import FrameType

import uvicorn
from fastapi import FastAPI

from server import logs
from server.app import create_app
from server.settings import Settings, unknown_variables
from server.startup import preflight
from server.web.http_protocol import BoundedHttp, QuietWebSocket

_LOG = logging.getLogger(__name__)
# For what follows a request's last write, and for sockets to close.
_AFTER_WRITES_S = 5
# A position is some 150 bytes.
_MAX_WS_MESSAGE_BYTES = 4_096
# A group of reports keeps some 30,000 objects until its commit, which nothing but their count frees: by default the
# collector looks at them at every 700th, a twentieth of all that a report costs.
_YOUNG_OBJECTS = 50_000


def run(settings: Settings) -> int:
    """Serve until interrupted; the exit code. Raises a `ServiceError` when the server must not start."""
    logs.configure(settings.log_level, settings.log_format)
    for line in unknown_variables(os.environ):
        _LOG.warning("%s", line)
    asyncio.run(preflight(settings))
    app = create_app(settings)
    server = _Server(listening(app, settings), settings.drain_s, app.state.readiness.end)
    # uvicorn's own end, with a code of its own, when it cannot listen; it has said why.
    with suppress(SystemExit):
        server.run()
    return 0 if server.started else 1


def listening(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """How the application listens."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        http=BoundedHttp,
        ws=QuietWebSocket,
        log_config=None,
        # `server.web.journal` writes a better one: these lines have the query, and so positions.
        access_log=False,
        server_header=False,
        proxy_headers=bool(settings.trusted_proxies),
        forwarded_allow_ips=list(settings.trusted_proxies),
        limit_concurrency=settings.max_connections,
        ws_max_size=_MAX_WS_MESSAGE_BYTES,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=math.ceil(settings.write_deadline_s) + _AFTER_WRITES_S,
    )


class _Server(uvicorn.Server):
    """Prints its address once it listens; told to end, first says that it is not ready, then ends."""

    def __init__(self, config: uvicorn.Config, drain_s: float, not_ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._drain_s, self._not_ready = drain_s, not_ready
        self._ends_at_s = math.inf

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if self.started:
            # What is there by now stays: a full round of the collector looked at all of it, and every request waited.
            gc.collect()
            gc.freeze()
            gc.set_threshold(_YOUNG_OBJECTS, *gc.get_threshold()[1:])
            host, port = self.servers[0].sockets[0].getsockname()[:2]
            # For people, and for scripts that asked for port 0.
            print(f"listening on http://{f'[{host}]' if ':' in host else host}:{port}", flush=True)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """A signal to end: the first one after the drain, a second one at once."""
        self._not_ready()
        if sig == signal.SIGTERM and self._drain_s and math.isinf(self._ends_at_s):
            self._ends_at_s = time.monotonic() + self._drain_s
            return
        super().handle_exit(sig, frame)

    async def on_tick(self, counter: int) -> bool:
        """Whether to end now; called every tenth of a second."""
        if time.monotonic() >= self._ends_at_s:
            self.should_exit = True
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        _LOG.info("ending: %d connections", len(self.server_state.connections))
        await super().shutdown(sockets)
        _LOG.info("ended")
