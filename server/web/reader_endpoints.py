"""What anybody with a key may read: obstacles around a place or in a box, one obstacle, its history, its points."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any
from uuid import UUID

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import JSONResponse
from pydantic import Field, model_validator

from contract.history import ObstacleHistory
from contract.obstacle import Link, ObstacleCollection, ObstacleFeature, ObstaclePoints
from server.errors import ObstacleNotFoundError, ServiceError, VersionNotFoundError
from server.formats.names import FormatName
from server.formats.registry import FORMATS, GEOJSON, Format, chosen
from server.life.obstacle import Obstacle
from server.logs import FIELDS
from server.reading import collection, remembered, representation
from server.reading.around import Circle, Key
from server.reading.cursors import cursor_of, position_of
from server.reading.query import Missing, ObstacleQuery, Parameters
from server.reading.search import Search
from server.storage import history
from server.storage.repository import Repository
from server.storage.versions import all_versions, points_of
from server.web.dependencies import REFUSALS, CallerNow, Parts, PartsNow, bearer, once_each, refusals

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Page:
    """Obstacles in order by their marks, how they become a body, and the last one's key when more follow."""

    marks: Sequence[bytes]
    body: Callable[[Format, Sequence[Link], datetime], bytes]
    more_behind: Key | None = None


class GeoJson(JSONResponse):
    """A GeoJSON answer (RFC 7946); the class tells the OpenAPI document its media type."""

    media_type = GEOJSON


def _other_formats() -> dict[str, Any]:
    """Media types besides GeoJSON, for the OpenAPI document; their shapes are other standards'."""
    others = [item.media_type for item in FORMATS.values() if item.name is not FormatName.GEOJSON]
    return {name: {"schema": {"type": "string"} if name.endswith("xml") else {}} for name in others}


_NO_OBSTACLE = refusals(s404="no obstacle ever had this id")
_FORMATTED: dict[int | str, dict[str, Any]] = {
    304: representation.UNCHANGED,
    **refusals(s406="none of the formats is accepted"),
}
readers = APIRouter(
    prefix="/v1", tags=["obstacles"], responses=REFUSALS, dependencies=[Depends(bearer), Depends(once_each)]
)


class FormatQuery(Parameters):
    """Query of one obstacle."""

    f: Annotated[FormatName, Field(description="format; else the header Accept decides")] | Missing = None


class PointsQuery(Parameters):
    """Query of an obstacle's points."""

    version: Annotated[int, Field(ge=1, le=2**31 - 1, description="a former version; else the current")] | Missing = (
        None
    )


class HistoryQuery(Parameters):
    """Query of an obstacle's history."""

    limit: Annotated[int, Field(ge=1, le=1_000, description="entries in one page")] = 100
    cursor: Annotated[str, Field(max_length=200, description="from the link `next` of the page before")] | Missing = (
        None
    )

    @model_validator(mode="after")
    def _has_a_good_cursor(self) -> HistoryQuery:
        self.after()
        return self

    def after(self) -> history.Place | None:
        """Where the page begins."""
        if self.cursor is None:
            return None
        at, sort, number = position_of(self.cursor, "history", (datetime, int, int))
        return history.Place(at, sort, number)


@readers.get(
    "/obstacles",
    response_class=GeoJson,
    responses={200: {"model": ObstacleCollection, "content": _other_formats()}, **_FORMATTED},
)
async def get_obstacles(
    request: Request, _caller: CallerNow, parts: PartsNow, query: Annotated[ObstacleQuery, Query()]
) -> Response:
    """Obstacles within a geodesic radius of a place, nearest first, or in a box, by id. Removed ones only if asked."""
    form = chosen(query.f, request.headers.get("accept"))
    now = datetime.now(UTC)
    page = await _remembered(parts, query, now) or await _searched(parts, query, now)
    links = []
    if page.more_behind is not None:
        links.append(representation.next_link(request, query.cursor_behind(page.more_behind), form.media_type))
    tag = collection.tag(page.marks, form.name, [link.href for link in links])
    if representation.holds(request.headers.get("if-none-match"), tag):
        return representation.unchanged(tag, links)
    return representation.answer(request, page.body(form, links, now), form.media_type, tag, links)


@readers.get(
    "/obstacles/{obstacle_id}",
    response_class=GeoJson,
    responses={200: {"model": ObstacleFeature, "content": _other_formats()}, **_FORMATTED, **_NO_OBSTACLE},
)
async def get_obstacle(
    request: Request, obstacle_id: UUID, _caller: CallerNow, parts: PartsNow, query: Annotated[FormatQuery, Query()]
) -> Response:
    """One obstacle, also one that was removed (state `removed`). Its entity tag is what `If-Match` takes."""
    form = chosen(query.f, request.headers.get("accept"))
    return one(request, await parts.service.obstacle(obstacle_id), form)


@readers.get("/obstacles/{obstacle_id}/history", responses=_NO_OBSTACLE)
async def get_history(
    request: Request, obstacle_id: UUID, _caller: CallerNow, parts: PartsNow, query: Annotated[HistoryQuery, Query()]
) -> ObstacleHistory:
    """What became of an obstacle, oldest first: its shapes, every change that was served, operators' actions."""
    async with parts.database.read() as connection:
        obstacle = await _stored(Repository(connection, parts.life), obstacle_id)
        page = await history.read(connection, obstacle, query.after(), query.limit)
    links = []
    if (last := page.more_behind) is not None:
        cursor = cursor_of("history", (last.at, last.sort, last.number))
        links.append(representation.next_link(request, cursor, "application/json"))
    return ObstacleHistory(obstacle_id=obstacle_id, entries=page.entries, links=tuple(links))


@readers.get(
    "/obstacles/{obstacle_id}/points",
    response_class=GeoJson,
    responses={
        200: {"model": ObstaclePoints},
        304: representation.UNCHANGED,
        **refusals(s404="no obstacle ever had this id, or it never had this version"),
    },
)
async def get_points(
    request: Request, obstacle_id: UUID, _caller: CallerNow, parts: PartsNow, query: Annotated[PointsQuery, Query()]
) -> Response:
    """The points of the current or a former version: longitude, latitude and height in WGS 84."""
    async with parts.database.read() as connection:
        obstacle = await _stored(Repository(connection, parts.life), obstacle_id)
        versions = {version.number: version for version in await all_versions(connection, obstacle)}
    number = obstacle.version if query.version is None else query.version
    if number not in versions:
        raise VersionNotFoundError(f"the obstacle has no version {number}: it has {', '.join(map(str, versions))}")
    body = points_of(obstacle, versions[number]).model_dump_json().encode()
    tag = collection.tag([collection.mark_of(obstacle.id, obstacle.revision)], "points", number)
    return representation.answer(request, body, GEOJSON, tag)


def one(request: Request, feature: ObstacleFeature, form: Format) -> Response:
    """One obstacle with its strong entity tag."""
    tag = f'"{feature.properties.revision}-{form.name}"'
    return representation.answer(request, form.one(feature, datetime.now(UTC)), form.media_type, tag)


async def _searched(parts: Parts, query: ObstacleQuery, now: datetime) -> _Page:
    """The page by SQL."""
    area, after = query.area, query.after()
    async with parts.database.read() as connection:
        search = Search(connection, parts.life, now)
        if isinstance(area, Circle):
            page = await search.around(area, query.filters, after, query.limit)
        else:
            page = await search.inside(area, query.filters, after, query.limit)
    marks = [collection.mark_of(feature.id, feature.properties.revision) for feature in page.features]
    return _Page(marks, lambda form, links, at: form.page(page.features, links, at), page.more_behind)


async def _remembered(parts: Parts, query: ObstacleQuery, now: datetime) -> _Page | None:
    """The only page of a small area from memory; None when SQL must tell, or still may."""
    area, filters = query.area, query.filters
    circle = None if query.cursor is not None else remembered.circle_of(area, filters)
    if circle is None:
        return None
    try:
        entries = await remembered.found_in(parts.nearby, area, circle, filters, parts.life, now)
    except ServiceError:
        raise
    except Exception:  # a fault of this way costs the caller time, not the answer
        _LOG.exception("unexpected error", extra={FIELDS: {"route": "/v1/obstacles"}})
        return None
    if entries is None or len(entries) > query.limit:
        return None
    texts = [entry[3] for entry in entries]

    def body(form: Format, links: Sequence[Link], at: datetime) -> bytes:
        if form.name is FormatName.GEOJSON:
            return collection.joined(texts, links)
        return form.page(tuple(map(ObstacleFeature.model_validate_json, texts)), links, at)

    return _Page([entry[2] for entry in entries], body)


async def _stored(repository: Repository, identifier: UUID) -> Obstacle:
    found = await repository.obstacle(identifier)
    if found is None:
        raise ObstacleNotFoundError(f"there is no obstacle {identifier}")
    return found
