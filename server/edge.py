"""The outermost layer around all routes: names each request, times it, logs it, and answers what nobody expected."""

from __future__ import annotations

import logging
import time
from collections.abc import Awaitable
from typing import Literal

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from server.errors import unexpected_problem
from server.logs import FIELDS
from server.metrics import RequestCounts
from server.request_context import CURRENT, RequestContext, RequestNames
from server.security_headers import RawHeaders, headers_for

_LOG = logging.getLogger(__name__)
# Ten times what the slowest search takes.
_SLOW_S = 1.0
_FAILED, _LIMITED, _BROKEN = 400, 429, 500
# Of a path that no route has: a name that the caller cannot make up.
_NO_ROUTE = "none"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class Edge:
    """ASGI middleware; puts the request's context into `request_context.CURRENT`.

    It is on the way of every nearby query: where a coroutine can be handed on, none is wrapped around it.
    """

    def __init__(self, app: ASGIApp, counts: RequestCounts, log_requests: Literal["failed", "all"]) -> None:
        self._app, self._counts, self._names = app, counts, RequestNames()
        self._logs_all = log_requests == "all"

    def __call__(self, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
        """Serve one request or socket."""
        if scope["type"] == "http":
            return self._serve(scope, receive, send)
        if scope["type"] == "websocket":
            return self._connect(scope, receive, send)
        return self._app(scope, receive, send)

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun_s = time.perf_counter()
        context = self._names.context(scope["headers"])
        added = _headers(context, scope["path"])
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
            _LOG.exception("unexpected error", extra={FIELDS: _asked(scope)})
            if status:
                raise
            await unexpected_problem()(scope, receive, named)
        finally:
            # Without a status the caller has gone before the answer.
            if status:
                self._done(scope, status, time.perf_counter() - begun_s)
            CURRENT.reset(before)

    async def _connect(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun_s = time.perf_counter()
        context = self._names.context(scope["headers"])

        def named(message: Message) -> Awaitable[None]:
            # A refusal before the socket is accepted is an ordinary answer.
            if message["type"] == "websocket.http.response.start":
                message["headers"] = [*message["headers"], *_headers(context, "")]
                self._done(scope, message["status"], time.perf_counter() - begun_s)
            return send(message)

        before = CURRENT.set(context)
        try:
            await self._app(scope, receive, named)
        finally:
            CURRENT.reset(before)

    def _done(self, scope: Scope, status: int, took_s: float) -> None:
        self._counts.observe(_method(scope), _route(scope), status, took_s)
        if status >= _FAILED or self._logs_all or took_s >= _SLOW_S:
            fields = _asked(scope) | {"status": status, "duration_ms": round(1000 * took_s, 2)}
            _LOG.log(_level(status), "request", extra={FIELDS: fields})


def _level(status: int) -> int:
    if status >= _BROKEN:
        return logging.WARNING
    # Whoever is over a limit must not fill the disk with lines that say so: `headsup_refused_total` counts them.
    return logging.DEBUG if status == _LIMITED else logging.INFO


def _headers(context: RequestContext, path: str) -> RawHeaders:
    named: RawHeaders = (*headers_for(path), (b"x-request-id", context.request_id.encode()))
    if context.traceparent is None:
        return named
    return (*named, (b"traceparent", context.traceparent.encode()))


def _asked(scope: Scope) -> dict[str, str]:
    """What was asked for, without what the caller wrote into it."""
    return {"method": _method(scope), "route": _route(scope)}


def _route(scope: Scope) -> str:
    path = getattr(scope.get("route"), "path", None)
    return path if isinstance(path, str) else _NO_ROUTE


def _method(scope: Scope) -> str:
    # A handshake has none of its own; it is a GET (RFC 6455, 4.1).
    method: str = scope.get("method", "GET")
    return method if method in _METHODS else "other"
