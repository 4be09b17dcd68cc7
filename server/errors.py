"""Domain errors, which know no HTTP, and the one table that maps them to problems (RFC 9457)."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException

from server.trust.security_headers import DATA

PROBLEM_JSON = "application/problem+json"


class ServiceError(Exception):
    """Base of what the service refuses; the text is meant for the caller."""


class ObstacleNotFoundError(ServiceError):
    """No obstacle ever had this id."""


class VersionNotFoundError(ServiceError):
    """The obstacle never had this version, or its shape was deleted."""


class InvalidParameterError(ServiceError):
    """A parameter of the OGC API that is unknown or does not fit (part 1, 7.15: status 400)."""


class ObstacleRemovedError(ServiceError):
    """The obstacle is gone, and the action needs a live one."""


class RevisionMismatchError(ServiceError):
    """The obstacle has changed since the caller read it (`If-Match`)."""


class NotAcceptableError(ServiceError):
    """No format that the caller accepts."""


class UnsupportedMediaTypeError(ServiceError):
    """The body is not JSON, or compressed."""


class UnauthenticatedError(ServiceError):
    """No key, or one that is unknown or revoked."""


class ForbiddenError(ServiceError):
    """The key's role may not do this."""


class BodyTooLargeError(ServiceError):
    """The body exceeds the limit."""


class BodyTooSlowError(ServiceError):
    """The body did not arrive in time."""


class TooManyRequestsError(ServiceError):
    """A limit on requests, reports, connections or unknown keys is used up for `wait_s` seconds."""

    def __init__(self, what: str, wait_s: float) -> None:
        super().__init__(what)
        self.wait_s = wait_s


class UnavailableError(ServiceError):
    """The database did not take the write in time; the same request may be repeated."""


class StorageError(UnavailableError):
    """The database takes no writes before somebody has made room, or mended its disk: there is no use in waiting."""


class SchemaOutOfDateError(ServiceError):
    """The database's schema is not this version's."""


class ShuttingDownError(ServiceError):
    """The server is about to end."""


class UnguardedError(ServiceError):
    """The server would listen beyond loopback without any key."""


@dataclass(frozen=True, slots=True)
class _Problem:
    type: str
    status: HTTPStatus
    headers: Mapping[str, str]


_PROBLEMS: dict[type[ServiceError], _Problem] = {
    ObstacleNotFoundError: _Problem("obstacle-not-found", HTTPStatus.NOT_FOUND, {}),
    VersionNotFoundError: _Problem("version-not-found", HTTPStatus.NOT_FOUND, {}),
    InvalidParameterError: _Problem("invalid-parameter", HTTPStatus.BAD_REQUEST, {}),
    ObstacleRemovedError: _Problem("obstacle-removed", HTTPStatus.CONFLICT, {}),
    RevisionMismatchError: _Problem("revision-mismatch", HTTPStatus.PRECONDITION_FAILED, {}),
    NotAcceptableError: _Problem("not-acceptable", HTTPStatus.NOT_ACCEPTABLE, {}),
    UnsupportedMediaTypeError: _Problem(
        "unsupported-media-type",
        HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
        # What would be taken: RFC 9110, 15.5.16.
        {"Accept": "application/json", "Accept-Encoding": "identity"},
    ),
    UnauthenticatedError: _Problem("unauthenticated", HTTPStatus.UNAUTHORIZED, {"WWW-Authenticate": "Bearer"}),
    ForbiddenError: _Problem("forbidden", HTTPStatus.FORBIDDEN, {}),
    BodyTooLargeError: _Problem("body-too-large", HTTPStatus.REQUEST_ENTITY_TOO_LARGE, {}),
    BodyTooSlowError: _Problem("body-too-slow", HTTPStatus.REQUEST_TIMEOUT, {}),
    TooManyRequestsError: _Problem("too-many-requests", HTTPStatus.TOO_MANY_REQUESTS, {}),
    UnavailableError: _Problem("unavailable", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "1"}),
    StorageError: _Problem("unavailable", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "10"}),
    SchemaOutOfDateError: _Problem("schema-out-of-date", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "10"}),
    ShuttingDownError: _Problem("shutting-down", HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "5"}),
}


def problem(
    type_: str, status: HTTPStatus, detail: str, headers: Mapping[str, str] | None = None, **more: Any
) -> Response:
    """A problem answer; `type_` is stable, `detail` is for people."""
    body = {"type": f"urn:headsup:problem:{type_}", "title": status.phrase, "status": status.value, "detail": detail}
    # ASCII, since a hostile body may have put lone surrogates into a name that the detail repeats.
    text = json.dumps(body | more, ensure_ascii=True)
    return Response(text, status.value, dict(headers or {}), PROBLEM_JSON)


def raw_problem(status: int, type_: str, detail: str) -> bytes:
    """A problem as bytes of HTTP/1.1, for who is refused before there is a request; the connection ends with it."""
    answer = problem(type_, HTTPStatus(status), detail, {"Connection": "close"})
    head = [f"HTTP/1.1 {status} {HTTPStatus(status).phrase}".encode()]
    head += [name + b": " + value for name, value in (*answer.raw_headers, *DATA)]
    return b"\r\n".join([*head, b"", bytes(answer.body)])


def problem_of(error: ServiceError) -> Response:
    """The problem that a domain error maps to."""
    known = _PROBLEMS[type(error)]
    headers = dict(known.headers)
    if isinstance(error, TooManyRequestsError):
        headers["Retry-After"] = str(max(1, math.ceil(error.wait_s)))
    return problem(known.type, known.status, str(error), headers)


def for_operators(error: ServiceError) -> str:
    """The error and its cause in one line: for the terminal only, since drivers name hosts, users and files."""
    cause = error.__cause__
    said = "" if cause is None else str(getattr(cause, "orig", cause))
    # SQLAlchemy puts the name of asyncpg's class before what it says.
    (line, *_) = re.sub(r"^<class '[^']*'>: ", "", said).splitlines() or [""]
    return f"{error}: {line}" if line else str(error)


def unexpected_problem() -> Response:
    """The answer to a fault of the server's own: nothing of it is shown."""
    return problem("internal", HTTPStatus.INTERNAL_SERVER_ERROR, "the server failed; the failure has been logged")


def complaints(error: RequestValidationError) -> list[dict[str, str]]:
    """Where a request does not fit its schema, and how.

    Neither the input nor the exception's context: they may be huge, not a number, or secret.
    """
    errors = error.errors()
    places = {item["loc"] for item in errors}
    found = [item for item in errors if not _is_an_echo(item, places)][:20]
    return [{"where": _place(item), "what": _what(item)[:500]} for item in found]


def _is_an_echo(item: Mapping[str, Any], places: set[tuple[int | str, ...]]) -> bool:
    """Whether a complaint only follows from how another was found."""
    # Of an optional parameter it is also complained that it is not missing, of a list that it lacks its faulty items.
    if item["type"] == "too_short":
        return any(len(place) > len(item["loc"]) and place[: len(item["loc"])] == item["loc"] for place in places)
    return bool(item["type"] == "none_required")


def _what(item: Mapping[str, Any]) -> str:
    if item["type"] == "json_invalid":
        return f"no JSON in UTF-8: {item['ctx']['error']}"
    if item["type"] == "too_short":
        return f"give at least {item['ctx']['min_length']}"
    return str(item["msg"]).removeprefix("Value error, ")


# How pydantic names alternatives of a type: no part of the path that the caller wrote.
_ALTERNATIVES = ("constrained-", "function-", "str-enum[", "literal[")


def _place(item: Mapping[str, Any]) -> str:
    location: Sequence[int | str] = item["loc"][:1] if item["type"] == "json_invalid" else item["loc"]
    return ".".join(str(part) for part in location if not str(part).startswith(_ALTERNATIVES))[:200]


def install(app: FastAPI) -> None:
    """Answer every error of the application as a problem; what nobody expected is for `server.web.edge`."""

    async def service_error(_request: Request, error: Exception) -> Response:
        assert isinstance(error, ServiceError)  # noqa: S101  # registered for that type below
        return problem_of(error)

    async def invalid(_request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)  # noqa: S101  # registered for that type below
        errors = complaints(error)
        return problem("invalid", HTTPStatus.UNPROCESSABLE_ENTITY, "the request does not fit the schema", errors=errors)

    async def http_error(_request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)  # noqa: S101  # registered for that type below
        status = HTTPStatus(error.status_code)
        # Raised by the framework for what is no text, or is nested without end.
        is_body = status is HTTPStatus.BAD_REQUEST
        detail = "the body cannot be read: send JSON in UTF-8" if is_body else status.description
        return problem(status.phrase.lower().replace(" ", "-"), status, detail, error.headers)

    app.add_exception_handler(ServiceError, service_error)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(HTTPException, http_error)
