"""What the platform asks: does the process live, should it be sent requests, what has it counted."""

from __future__ import annotations

import ipaddress

from fastapi import APIRouter, Depends, HTTPException, Request, Response

from server.errors import ForbiddenError
from server.trust.keys import Role
from server.web.dependencies import Parts, PartsNow, bearer, refusals
from server.web.metrics import MEDIA_TYPE
from server.web.request_context import CURRENT

operation = APIRouter(tags=["operation"])


@operation.get("/healthz")
async def healthz() -> dict[str, str]:
    """The process answers."""
    return {"status": "ok"}


@operation.get(
    "/readyz",
    responses=refusals(s503="the database does not answer, its schema is not this version's, or the server is ending"),
)
async def readyz(request: Request, parts: PartsNow) -> dict[str, str]:
    """The database answers, its schema is this version's, and the server is to stay."""
    await request.app.state.readiness.check(parts.database)
    return {"status": "ready"}


@operation.get(
    "/metrics",
    dependencies=[Depends(bearer)],
    response_class=Response,
    responses={
        200: {"content": {"text/plain": {"schema": {"type": "string"}}}},
        **refusals(s401="no key, or one that is unknown", s403="the key's role is not operator", s404="switched off"),
    },
)
async def metrics(request: Request, parts: PartsNow) -> Response:
    """What this process counts, for Prometheus (text format 0.0.4)."""
    await _must_be_allowed(request, parts)
    return Response(request.app.state.metrics.text(), media_type=MEDIA_TYPE)


async def _must_be_allowed(request: Request, parts: Parts) -> None:
    access = request.app.state.settings.metrics
    if access == "off":
        raise HTTPException(404)
    if access == "loopback" and _is_of_this_machine(request):
        return
    if (await parts.admission.caller(request)).role is not Role.OPERATOR:
        raise ForbiddenError("metrics are for keys of role operator: see HEADSUP_METRICS")


def _is_of_this_machine(request: Request) -> bool:
    """Whether a program beside this one asks: what a proxy passes on may come from anywhere."""
    context = CURRENT.get()
    if request.client is None or context is None or context.is_forwarded:
        return False
    try:
        return ipaddress.ip_address(request.client.host).is_loopback
    except ValueError:
        return False
