"""All routers of the service, and those that vehicles use: observations, push."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response, WebSocket

from contract.observation import ObservationBatchResult
from server.ogc import endpoints as ogc_endpoints
from server.web import operation_endpoints, operator_endpoints, reader_endpoints
from server.web.dependencies import REFUSALS, Parts, bearer, must_be_json, once_each, refusals
from server.web.events_socket import serve_events
from server.web.posted import REQUEST_BODY, posted_batch

__all__ = ["ROUTERS", "Parts"]

vehicles = APIRouter(prefix="/v1", responses=REFUSALS)
push = APIRouter(prefix="/v1")


@vehicles.post(
    "/observations",
    tags=["observations"],
    response_model=ObservationBatchResult,
    openapi_extra={**REQUEST_BODY, "security": [{bearer.scheme_name: []}]},
    responses=refusals(
        s403="a key of role reader may not post",
        s413="the body exceeds 1 MiB: send half",
        s415="the body is not application/json",
    ),
)
async def post_observations(request: Request) -> Response:
    """Take a batch of reports and answer each, in order. Safe to repeat: a report counts once by its id and key."""
    # Asked by hand: the framework takes longer to resolve dependencies than to do all else for a request.
    await once_each(request)
    await must_be_json(request)
    parts: Parts = request.app.state.parts
    caller = await parts.admission.caller(request)
    batch = await posted_batch(request)
    parts.admission.reports(caller, len(batch.reports))
    result = await parts.service.observe(caller, batch)
    return Response(result.model_dump_json(), media_type="application/json")


@push.websocket("/events")
async def events(socket: WebSocket) -> None:
    """Push around a moving vehicle: see `contract/events.py`."""
    parts: Parts = socket.app.state.parts
    await serve_events(socket, parts)


ROUTERS = (
    vehicles,
    reader_endpoints.readers,
    operator_endpoints.operators,
    ogc_endpoints.ogc,
    push,
    operation_endpoints.operation,
)
