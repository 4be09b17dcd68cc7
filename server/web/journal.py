"""What every answer gets and leaves behind: the request's name, headers, a count and a line in the log."""

from __future__ import annotations

import logging
import time
from typing import Literal

from starlette.types import Scope

from server.logs import FIELDS
from server.trust.security_headers import RawHeaders, headers_for
from server.web.metrics import RequestCounts
from server.web.request_context import RequestContext, RequestNames

_LOG = logging.getLogger(__name__)
# Ten times what the slowest search takes.
_SLOW_S = 1.0
_FAILED, _LIMITED, _BROKEN = 400, 429, 500
# Of a path that no route has: a name that the caller cannot make up.
_NO_ROUTE = "none"
# Where a request keeps its name and its time, since it may be answered behind several layers.
_CONTEXT, _BEGUN_S = "headsup.context", "headsup.begun_s"
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class Journal:
    """Of one application; requests are named here, wherever they are answered."""

    def __init__(self, counts: RequestCounts, log_requests: Literal["failed", "all"]) -> None:
        self._counts, self._names, self._logs_all = counts, RequestNames(), log_requests == "all"

    def begin(self, scope: Scope) -> RequestContext:
        """The context of a request or socket: made once, and its time counts from then on."""
        context: RequestContext | None = scope.get(_CONTEXT)
        if context is None:
            scope[_BEGUN_S] = time.perf_counter()
            context = scope[_CONTEXT] = self._names.context(scope["headers"])
        return context

    def done(self, scope: Scope, status: int) -> None:
        """Count an answer, and log it if it failed, was slow, or all are logged."""
        took_s = time.perf_counter() - scope[_BEGUN_S]
        self._counts.observe(_method(scope), _route(scope), status, took_s)
        if status >= _FAILED or self._logs_all or took_s >= _SLOW_S:
            fields = asked(scope) | {"status": status, "duration_ms": round(1000 * took_s, 2)}
            _LOG.log(_level(status), "request", extra={FIELDS: fields})


def headers_of(context: RequestContext, path: str) -> RawHeaders:
    """Headers of an answer at `path`, whatever it says."""
    named: RawHeaders = (*headers_for(path), (b"x-request-id", context.request_id.encode()))
    if context.traceparent is None:
        return named
    return (*named, (b"traceparent", context.traceparent.encode()))


def asked(scope: Scope) -> dict[str, str]:
    """What was asked for, without what the caller wrote into it."""
    return {"method": _method(scope), "route": _route(scope)}


def _level(status: int) -> int:
    if status >= _BROKEN:
        return logging.WARNING
    # Whoever is over a limit must not fill the disk with lines that say so: `headsup_refused_total` counts them.
    return logging.DEBUG if status == _LIMITED else logging.INFO


def _route(scope: Scope) -> str:
    path = getattr(scope.get("route"), "path", None)
    return path if isinstance(path, str) else _NO_ROUTE


def _method(scope: Scope) -> str:
    # A handshake has none of its own; it is a GET (RFC 6455, 4.1).
    method: str = scope.get("method", "GET")
    return method if method in _METHODS else "other"
