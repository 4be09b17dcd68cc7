"""The outermost layer around all routes: names each request, times it, logs it, and answers what nobody expected."""

from __future__ import annotations

import logging
from collections.abc import Awaitable

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import unexpected_problem
from server.logs import FIELDS
from server.web.journal import Journal, asked, headers_of
from server.web.request_context import CURRENT

_LOG = logging.getLogger(__name__)


class Edge:
    """ASGI middleware; puts the request's context into `request_context.CURRENT`.

    Where a coroutine can be handed on, none is wrapped around it.
    """

    def __init__(self, app: ASGIApp, journal: Journal) -> None:
        self._app, self._journal = app, journal

    def __call__(self, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
        """Serve one request or socket."""
        if scope["type"] == "http":
            return self._serve(scope, receive, send)
        if scope["type"] == "websocket":
            return self._connect(scope, receive, send)
        return self._app(scope, receive, send)

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        context = self._journal.begin(scope)
        added = headers_of(context, scope["path"])
        status = 0

        def named(message: Message) -> Awaitable[None]:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                message["headers"] = [*message["headers"], *added]
            return send(message)

        before = CURRENT.set(context)
        try:
            await self._app(scope, receive, named)
        except Exception:  # whatever it is, the caller gets a problem and the log its place
            _LOG.exception("unexpected error", extra={FIELDS: asked(scope)})
            if status:
                raise
            await unexpected_problem()(scope, receive, named)
        finally:
            # Without a status the caller has gone before the answer.
            if status:
                self._journal.done(scope, status)
            CURRENT.reset(before)

    async def _connect(self, scope: Scope, receive: Receive, send: Send) -> None:
        context = self._journal.begin(scope)

        def named(message: Message) -> Awaitable[None]:
            # A refusal before the socket is accepted is an ordinary answer.
            if message["type"] == "websocket.http.response.start":
                message["headers"] = [*message["headers"], *headers_of(context, "")]
                self._journal.done(scope, message["status"])
            return send(message)

        before = CURRENT.set(context)
        try:
            await self._app(scope, receive, named)
        finally:
            CURRENT.reset(before)
