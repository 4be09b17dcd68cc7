"""The HTTP and WebSocket routes. Bodies and answers are contract types; answers are sent after their commit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any
from uuid import UUID

from fastapi import APIRouter, Depends, Query, Request, Response, WebSocket
from fastapi.security import HTTPBearer
from pydantic import BaseModel, ConfigDict

from contract.geometry import LatLon
from contract.observation import ObservationBatch, ObservationBatchResult
from contract.obstacle import ObstacleCollection, ObstacleFeature
from server import schema
from server.database import Database
from server.events_socket import serve_events
from server.keys import Caller, Keys
from server.service import Service
from server.stream import Hub

GEOJSON = "application/geo+json"
MAX_RADIUS_M = 50_000.0
MAX_FEATURES = 1_000


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
    service: Service
    hub: Hub


def _parts(request: Request) -> Parts:
    parts: Parts = request.app.state.parts
    return parts


async def _caller(request: Request, parts: Annotated[Parts, Depends(_parts)]) -> Caller:
    return await parts.keys.caller(request.headers.get("authorization"))


PartsNow = Annotated[Parts, Depends(_parts)]
CallerNow = Annotated[Caller, Depends(_caller)]
# Only for the OpenAPI document: `_caller` reads the header, since a missing one is fine on an open server.
_bearer = HTTPBearer(auto_error=False, description="an API key, made by `headsup keys create`")

_PROBLEM: dict[str, Any] = {"model": Problem, "description": "Problem (application/problem+json)"}
_REFUSALS: dict[int | str, dict[str, Any]] = dict.fromkeys((401, 422, 503), _PROBLEM)

api = APIRouter(prefix="/v1", responses=_REFUSALS, dependencies=[Depends(_bearer)])
operation = APIRouter(tags=["operation"])
push = APIRouter(prefix="/v1")


@api.post("/observations", tags=["observations"], responses={403: _PROBLEM, 413: _PROBLEM})
async def post_observations(batch: ObservationBatch, caller: CallerNow, parts: PartsNow) -> ObservationBatchResult:
    """Take a batch of reports and answer each, in order. Safe to repeat: a report counts once by its id and key."""
    return await parts.service.observe(caller, batch)


@api.get("/obstacles", tags=["obstacles"], responses={200: {"content": {GEOJSON: {}}, "model": ObstacleCollection}})
async def get_obstacles(
    _caller: CallerNow,
    parts: PartsNow,
    lat: Annotated[float, Query(ge=-90, le=90, allow_inf_nan=False, description="latitude, degrees, WGS 84")],
    lon: Annotated[float, Query(ge=-180, le=180, allow_inf_nan=False, description="longitude, degrees, WGS 84")],
    radius_m: Annotated[float, Query(gt=0, le=MAX_RADIUS_M, allow_inf_nan=False)] = 1_000.0,
    limit: Annotated[int, Query(ge=1, le=MAX_FEATURES)] = MAX_FEATURES,
) -> Response:
    """Obstacles within a geodesic radius of a place, nearest first, as GeoJSON."""
    centre = LatLon(latitude_deg=lat, longitude_deg=lon)
    collection = ObstacleCollection(features=await parts.service.near(centre, radius_m, limit))
    return Response(collection.model_dump_json(), media_type=GEOJSON)


@api.get(
    "/obstacles/{obstacle_id}",
    tags=["obstacles"],
    responses={200: {"content": {GEOJSON: {}}, "model": ObstacleFeature}, 404: _PROBLEM},
)
async def get_obstacle(obstacle_id: UUID, _caller: CallerNow, parts: PartsNow) -> Response:
    """One obstacle, also one that was removed (state `removed`)."""
    feature = await parts.service.obstacle(obstacle_id)
    return Response(feature.model_dump_json(), media_type=GEOJSON)


@push.websocket("/events")
async def events(socket: WebSocket) -> None:
    """Push around a moving vehicle: see `contract/events.py`."""
    parts: Parts = socket.app.state.parts
    await serve_events(socket, parts.service, parts.hub, parts.keys)


@operation.get("/healthz")
async def healthz() -> dict[str, str]:
    """The process answers."""
    return {"status": "ok"}


@operation.get("/readyz", responses={503: _PROBLEM})
async def readyz(parts: PartsNow) -> dict[str, str]:
    """The database answers and its schema is this version's."""
    await schema.check(parts.database)
    return {"status": "ready"}
