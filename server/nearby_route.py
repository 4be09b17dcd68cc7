"""`GET /v1/obstacles` as every vehicle asks it all the time, answered with encoded features from memory.

Only a plain circle in the default format comes here, parsed by hand: a typed route takes longer for its parameters
than the search does. Everything else, and every faulty request, is for the typed route behind it
(`server.reader_endpoints`), whose answers have the same bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from starlette.requests import Request
from starlette.routing import BaseRoute, Match
from starlette.types import Receive, Scope, Send

from contract.geometry import LatLon
from server import collection, representation
from server.formats.names import FormatName
from server.formats.registry import GEOJSON
from server.nearby import GREATEST_RADIUS_M
from server.query import DEFAULT_RADIUS_M, MAX_FEATURES

if TYPE_CHECKING:
    from server.dependencies import Parts

_PATH = "/v1/obstacles"
_ASKED, _TOO_MANY = "headsup.nearby", "headsup.nearby.too_many"
_ANY = (b"*/*", GEOJSON.encode())
_NAMES = {b"lat", b"lon", b"radius_m", b"limit"}


@dataclass(frozen=True, slots=True)
class Asked:
    """A circle and the number of features that one page may hold."""

    centre: LatLon
    radius_m: float
    limit: int


class NearbyRoute(BaseRoute):
    """Matches plain requests only; must stand before the typed route."""

    path = _PATH

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """A match with the parsed request, or none."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != _PATH or _TOO_MANY in scope:
            return Match.NONE, {}
        asked = parsed(scope["query_string"])
        if asked is None or not _takes_geojson(scope):
            return Match.NONE, {}
        return Match.FULL, {_ASKED: asked, "route": self}

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer; a circle with more than one page goes on to the typed route."""
        request = Request(scope, receive)
        parts: Parts = scope["app"].state.parts
        asked: Asked = scope[_ASKED]
        await parts.admission.caller(request)
        found = await parts.nearby.within(asked.centre, asked.radius_m, datetime.now(UTC))
        if len(found) > asked.limit:
            await scope["router"]({**scope, _TOO_MANY: True}, receive, send)
            return
        tag = collection.tag((item.mark for item in found), FormatName.GEOJSON, [])
        if representation.holds(request, tag):
            response = representation.unchanged(tag)
        else:
            body = collection.joined([item.body for item in found])
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
    if not (-90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        return None
    if not (0 < radius_m <= GREATEST_RADIUS_M and 1 <= limit <= MAX_FEATURES):
        return None
    return Asked(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg), radius_m, limit)


def _takes_geojson(scope: Scope) -> bool:
    return all(value in _ANY for name, value in scope["headers"] if name == b"accept")
