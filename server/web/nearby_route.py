"""`GET /v1/obstacles` as every vehicle asks it all the time, answered with encoded features from memory.

Only a plain circle in the default format is answered here, parsed by hand and before the framework, which takes longer
than the search does. Everything else, and what goes wrong but for a database that does not answer, is for the typed
route (`server.web.reader_endpoints`), whose answers have the same bytes.
"""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from operator import itemgetter
from typing import TYPE_CHECKING, NamedTuple

from starlette.datastructures import State
from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from contract.geometry import LatLon
from server.errors import ServiceError, UnavailableError, problem_of
from server.formats.names import FormatName
from server.formats.registry import GEOJSON
from server.geometry.quadkey import MERCATOR_LATITUDE_DEG
from server.logs import FIELDS
from server.reading import collection, representation
from server.reading.nearby import GREATEST_RADIUS_M
from server.reading.query import DEFAULT_RADIUS_M, MAX_FEATURES
from server.reading.tile_cache import Found
from server.web.journal import Journal, headers_of
from server.web.request_context import CURRENT

if TYPE_CHECKING:
    from server.web.dependencies import Parts

_LOG = logging.getLogger(__name__)
_PATH = "/v1/obstacles"
_ANY = (b"*/*", GEOJSON.encode())
# What pages of other origins may read, and how much of a body is taken, is decided behind this layer.
_ELSEWHERE = frozenset({b"origin", b"content-length", b"transfer-encoding"})
_NAMES = frozenset({b"lat", b"lon", b"radius_m", b"limit"})
_MARK = itemgetter(1)
_TAGS = collection.Tags(FormatName.GEOJSON, [])
# What decides an answer, but for its entity tag: as `representation.answer` has it.
_ALWAYS = [(name.lower().encode(), value.encode()) for name, value in representation.KEPT.items()]
_CONTENT_TYPE = (b"content-type", GEOJSON.encode())


class Asked(NamedTuple):
    """A circle and the number of features that one page may hold."""

    centre: LatLon
    radius_m: float
    limit: int


class NearbyLane:
    """ASGI layer around an application: answers plain circles of one page, and hands on all else.

    `state` is the application's, which holds its parts.
    """

    path = _PATH

    def __init__(self, app: ASGIApp, state: State, journal: Journal) -> None:
        self._app, self._state, self._journal = app, state, journal

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or socket."""
        if scope["type"] == "http" and scope["path"] == _PATH and scope["method"] == "GET":
            asked = parsed(scope["query_string"])
            if asked is not None and await self._has_answered(asked, scope, receive, send):
                return
        await self._app(scope, receive, send)

    async def _has_answered(self, asked: Asked, scope: Scope, receive: Receive, send: Send) -> bool:
        given = dict(scope["headers"])
        # Which of two headers counts is decided elsewhere.
        if len(given) != len(scope["headers"]) or given.get(b"accept", b"*/*") not in _ANY:
            return False
        if not _ELSEWHERE.isdisjoint(given):
            return False
        context = self._journal.begin(scope)
        CURRENT.set(context)
        try:
            parts: Parts = self._state.parts
            if not parts.admission.is_known(scope, given.get(b"authorization")):
                await parts.admission.caller(Request(scope, receive))
            found = await parts.nearby.within(asked.centre, asked.radius_m, datetime.now(UTC))
            if len(found) > asked.limit:
                return False
            status, headers, body = _answer(found, given)
        except UnavailableError as error:
            # Whoever has waited for the database in vain is not made to wait for it again.
            refusal = problem_of(error)
            status, headers, body = refusal.status_code, refusal.raw_headers, bytes(refusal.body)
        except ServiceError:
            return False
        except Exception:  # a fault of this way costs the caller time, not the answer
            _LOG.exception("unexpected error", extra={FIELDS: {"route": _PATH}})
            return False
        headers += headers_of(context, _PATH)
        await send({"type": "http.response.start", "status": status, "headers": headers})
        await send({"type": "http.response.body", "body": body})
        # Where the framework notes the route, for whoever counts.
        scope["route"] = self
        self._journal.done(scope, status)
        return True


def _answer(found: list[Found], given: dict[bytes, bytes]) -> tuple[int, list[tuple[bytes, bytes]], bytes]:
    """Status, headers and body."""
    tag = _TAGS.of(map(_MARK, found))
    headers = [(b"etag", tag.encode()), *_ALWAYS]
    if b"if-none-match" in given and representation.holds(given[b"if-none-match"].decode("latin-1"), tag):
        return 304, headers, b""
    body = collection.joined([entry[3] for _, _, entry in found])
    encodings = given.get(b"accept-encoding")
    if encodings is not None and representation.takes_gzip(encodings.decode("latin-1"), body):
        body = representation.compressed(body)
        headers.append((b"content-encoding", b"gzip"))
    headers += ((b"content-length", b"%d" % len(body)), _CONTENT_TYPE)
    return 200, headers, body


def parsed(query: bytes) -> Asked | None:
    """The circle that a query string asks for; None when anything about it is not plain, or not right."""
    # A space, which only some places of a number may have.
    if b"+" in query:
        return None
    values: dict[bytes, bytes] = {}
    for part in query.split(b"&"):
        name, _, value = part.partition(b"=")
        if name not in _NAMES or name in values:
            return None
        values[name] = value
    try:
        latitude_deg, longitude_deg = float(values[b"lat"]), float(values[b"lon"])
        radius_m = float(values.get(b"radius_m", DEFAULT_RADIUS_M))
        limit = int(values.get(b"limit", MAX_FEATURES))
    except (KeyError, ValueError):
        return None
    # Towards the poles a circle touches tiles without number, and no obstacle is taken there.
    if not (abs(latitude_deg) <= MERCATOR_LATITUDE_DEG and -180 <= longitude_deg <= 180):
        return None
    if not (0 < radius_m <= GREATEST_RADIUS_M and 1 <= limit <= MAX_FEATURES):
        return None
    return Asked(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg), radius_m, limit)
