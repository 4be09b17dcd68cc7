"""Domain errors, which know no HTTP, and the one table that maps them to problems (RFC 9457)."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

PROBLEM_JSON = "application/problem+json"
_LOG = logging.getLogger(__name__)


class ServiceError(Exception):
    """Base of what the service refuses; the text is meant for the caller."""


class ObstacleNotFoundError(ServiceError):
    """No obstacle ever had this id."""


class UnauthenticatedError(ServiceError):
    """No key, or one that is unknown or revoked."""


class ForbiddenError(ServiceError):
    """The key's role may not do this."""


class BodyTooLargeError(ServiceError):
    """The body exceeds the limit."""


class UnavailableError(ServiceError):
    """The database did not take the write in time; the same request may be repeated."""


class SchemaOutOfDateError(ServiceError):
    """The database's schema is not this version's."""


class UnguardedError(ServiceError):
    """The server would listen beyond loopback without any key."""


@dataclass(frozen=True, slots=True)
class _Problem:
    type: str
    status: HTTPStatus
    headers: Mapping[str, str]


_PROBLEMS: dict[type[ServiceError], _Problem] = {
    ObstacleNotFoundError: _Problem("obstacle-not-found", HTTPStatus.NOT_FOUND, {}),
    UnauthenticatedError: _Problem("unauthenticated", HTTPStatus.UNAUTHORIZED, {"WWW-Authenticate": "Bearer"}),
    ForbiddenError: _Problem("forbidden", HTTPStatus.FORBIDDEN, {}),
    BodyTooLargeError: _Problem("body-too-large", HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {}),
    UnavailableError: _Problem("unavailable", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "1"}),
    SchemaOutOfDateError: _Problem("schema-out-of-date", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "10"}),
}


def problem(
    type_: str, status: HTTPStatus, detail: str, headers: Mapping[str, str] | None = None, **more: Any
) -> Response:
    """A problem answer; `type_` is stable, `detail` is for people."""
    body = {"type": f"urn:headsup:problem:{type_}", "title": status.phrase, "status": status.value, "detail": detail}
    # ASCII, since a hostile body may have put lone surrogates into a name that the detail repeats.
    text = json.dumps(body | more, ensure_ascii=True)
    return Response(text, status.value, dict(headers or {}), PROBLEM_JSON)


def problem_of(error: ServiceError) -> Response:
    """The problem that a domain error maps to."""
    known = _PROBLEMS[type(error)]
    return problem(known.type, known.status, str(error), known.headers)


def install(app: FastAPI) -> None:
    """Answer every error of the application as a problem."""

    async def service_error(_request: Request, error: Exception) -> Response:
        assert isinstance(error, ServiceError)  # noqa: S101  # registered for that type below
        return problem_of(error)

    async def invalid(_request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)  # noqa: S101  # registered for that type below
        # Neither the input nor the exception's context: they may be huge, not a number, or secret.
        errors = [
            {"where": ".".join(map(str, item["loc"]))[:200], "what": str(item["msg"])[:500]}
            for item in error.errors()[:20]
        ]
        return problem("invalid", HTTPStatus.UNPROCESSABLE_ENTITY, "the request does not fit the schema", errors=errors)

    async def http_error(_request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)  # noqa: S101  # registered for that type below
        status = HTTPStatus(error.status_code)
        return problem(status.phrase.lower().replace(" ", "-"), status, status.description, error.headers)

    async def unexpected(request: Request, error: Exception) -> Response:
        _LOG.error("unexpected error at %s %s", request.method, request.url.path, exc_info=error)
        return problem("internal", HTTPStatus.INTERNAL_SERVER_ERROR, "the server failed; the failure has been logged")

    app.add_exception_handler(ServiceError, service_error)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(HTTPException, http_error)
    app.add_exception_handler(Exception, unexpected)
