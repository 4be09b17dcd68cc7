"""`GET /v1/obstacles` as every vehicle asks it all the time, answered with encoded features from memory.

Only a plain circle in the default format is answered here, parsed by hand and before the framework's routing, which
takes longer than the search does. Everything else, and every faulty request, is for the typed route
(`server.reader_endpoints`), whose answers have the same bytes.
"""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from contract.geometry import LatLon
from server import collection, representation
from server.errors import ServiceError, problem_of
from server.formats.names import FormatName
from server.formats.registry import GEOJSON
from server.nearby import GREATEST_RADIUS_M
from server.quadkey import MERCATOR_LATITUDE_DEG
from server.query import DEFAULT_RADIUS_M, MAX_FEATURES

if TYPE_CHECKING:
    from server.dependencies import Parts

_PATH = "/v1/obstacles"
_ANY = (b"*/*", GEOJSON.encode())
_NAMES = {b"lat", b"lon", b"radius_m", b"limit"}


@dataclass(frozen=True, slots=True)
class Asked:
    """A circle and the number of features that one page may hold."""

    centre: LatLon
    radius_m: float
    limit: int


class NearbyLane:
    """ASGI middleware that answers plain circles of one page, and hands on all else."""

    path = _PATH

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    def __call__(self, scope: Scope, receive: Receive, send: Send) -> Awaitable[None]:
        """Serve one request or socket."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != _PATH or not _takes_geojson(scope):
            return self._app(scope, receive, send)
        asked = parsed(scope["query_string"])
        return self._app(scope, receive, send) if asked is None else self._serve(asked, scope, receive, send)

    async def _serve(self, asked: Asked, scope: Scope, receive: Receive, send: Send) -> None:
        # Where the framework notes the route, for whoever counts.
        scope["route"] = self
        request = Request(scope, receive)
        parts: Parts = scope["app"].state.parts
        try:
            await parts.admission.caller(request)
            found = await parts.nearby.within(asked.centre, asked.radius_m, datetime.now(UTC))
        except ServiceError as error:
            await problem_of(error)(scope, receive, send)
            return
        if len(found) > asked.limit:
            await self._app(scope, receive, send)
            return
        tag = collection.tag([mark for _, mark, *_ in found], FormatName.GEOJSON, [])
        if representation.holds(request, tag):
            response = representation.unchanged(tag)
        else:
            body = collection.joined([body for _, _, body, *_ in found])
            response = representation.answer(request, body, GEOJSON, tag)
        await response(scope, receive, send)


def parsed(query: bytes) -> Asked | None:
    """The circle that a query string asks for; None when anything about it is not plain, or not right."""
    pairs = [part.partition(b"=") for part in query.split(b"&")]
    values = {name: value for name, _, value in pairs}
    if len(values) != len(pairs) or not values.keys() <= _NAMES or not {b"lat", b"lon"} <= values.keys():
        return None
    try:
        latitude_deg, longitude_deg = float(values[b"lat"]), float(values[b"lon"])
        radius_m = float(values.get(b"radius_m", DEFAULT_RADIUS_M))
        limit = int(values.get(b"limit", MAX_FEATURES))
    except ValueError:
        return None
    # Towards the poles a circle touches tiles without number, and no obstacle is taken there.
    if not (abs(latitude_deg) <= MERCATOR_LATITUDE_DEG and -180 <= longitude_deg <= 180):
        return None
    if not (0 < radius_m <= GREATEST_RADIUS_M and 1 <= limit <= MAX_FEATURES):
        return None
    return Asked(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg), radius_m, limit)


def _takes_geojson(scope: Scope) -> bool:
    return all(value in _ANY for name, value in scope["headers"] if name == b"accept")
