"""What the routes share: the parts they work with, who is calling, and how refusals are described."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.exceptions import RequestValidationError
from fastapi.security import HTTPBearer
from pydantic import BaseModel, ConfigDict

from server.errors import PROBLEM_JSON, ForbiddenError, UnsupportedMediaTypeError
from server.ingesting.service import Service
from server.life.policy import Life
from server.operators import Operators
from server.push.relay import Relay
from server.push.stream import Hub
from server.reading.nearby import Nearby
from server.storage.database import Database
from server.trust.admission import Admission
from server.trust.keys import Caller, Keys, Role
from server.upkeep import Upkeep

# Parameters whose values add up.
_LISTS = frozenset({"kind", "state"})


class Problem(BaseModel):
    """A problem answer (RFC 9457), sent as application/problem+json."""

    model_config = ConfigDict(extra="allow")
    type: str
    title: str
    status: int
    detail: str


@dataclass(frozen=True, slots=True)
class Parts:
    """What the routes work with; made by the application's lifespan."""

    database: Database
    keys: Keys
    admission: Admission
    service: Service
    hub: Hub
    life: Life
    operators: Operators
    nearby: Nearby
    upkeep: Upkeep
    relay: Relay


# Coroutines all, though none waits: the framework would send a function to a thread, for each request.
async def _parts(request: Request) -> Parts:
    parts: Parts = request.app.state.parts
    return parts


async def _caller(request: Request, parts: Annotated[Parts, Depends(_parts)]) -> Caller:
    return await parts.admission.caller(request)


async def _operator(caller: Annotated[Caller, Depends(_caller)]) -> Caller:
    if caller.role is not Role.OPERATOR:
        raise ForbiddenError(f"a key of role {caller.role} may not do this: use one of role operator")
    return caller


async def once_each(request: Request) -> None:
    """Refuse a parameter that is given more than once: which one counts, the caller could not know."""
    counted = Counter(name for name, _ in request.query_params.multi_items())
    repeated = [name for name, number in counted.items() if number > 1 and name not in _LISTS]
    if repeated:
        raise RequestValidationError(
            [{"type": "repeated", "loc": ("query", name), "msg": "give it once"} for name in repeated]
        )


async def must_be_json(request: Request) -> None:
    """Refuse a body that does not say it is JSON."""
    media_type = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if media_type != "application/json":
        raise UnsupportedMediaTypeError("send the body as Content-Type: application/json")


PartsNow = Annotated[Parts, Depends(_parts)]
CallerNow = Annotated[Caller, Depends(_caller)]
OperatorNow = Annotated[Caller, Depends(_operator)]
# Only for the OpenAPI document: `_caller` reads the header, since a missing one is fine on an open server.
bearer = HTTPBearer(auto_error=False, description="an API key, made by `headsup keys create`")


def refusals(**because: str) -> dict[int | str, dict[str, Any]]:
    """Responses of the OpenAPI document: a problem for each status, given as `s404="why"`."""
    # Inline, since a reference would be listed under the media type of the route's own answers.
    content = {PROBLEM_JSON: {"schema": Problem.model_json_schema()}}
    return {status.removeprefix("s"): {"description": why, "content": content} for status, why in because.items()}


REFUSALS = refusals(
    s401="no key, or one that is unknown or revoked",
    s429="a limit is used up; try again after `Retry-After` seconds",
    s422="the request does not fit the schema; `errors` names each place",
    s503="the database did not answer in time; try again after `Retry-After` seconds",
)
