"""The routes of OGC API - Features. Here a parameter that does not fit is answered 400, as the standard wants it."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from datetime import UTC, datetime
from typing import Annotated, Any
from urllib.parse import urlencode
from uuid import UUID

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute

from server.errors import InvalidParameterError, ObstacleNotFoundError, complaints
from server.formats.registry import GEOJSON
from server.life.obstacle import Obstacle
from server.ogc import documents, features
from server.ogc.models import Collection, Collections, Conformance, Items, LandingPage, SingleItem
from server.ogc.query import ItemsQuery
from server.reading import collection, representation
from server.reading.query import Parameters
from server.reading.search import Page, Search
from server.storage.features import feature_of
from server.storage.repository import Repository
from server.web.dependencies import CallerNow, PartsNow, bearer, once_each, refusals
from server.web.reader_endpoints import GeoJson

_HERE = f"/collections/{documents.COLLECTION_ID}"


class _OgcRoute(APIRoute):
    """A route whose invalid parameters are answered 400 (part 1, requirements `query-param-invalid`, `-unknown`)."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler with that translation."""
        handler = super().get_route_handler()

        async def translated(request: Request) -> Response:
            try:
                return await handler(request)
            except RequestValidationError as error:
                found = "; ".join(f"{item['where']}: {item['what']}" for item in complaints(error))
                raise InvalidParameterError(found) from None

        return translated


ogc = APIRouter(
    prefix="/ogc",
    tags=["OGC API - Features"],
    route_class=_OgcRoute,
    dependencies=[Depends(bearer), Depends(once_each)],
    responses=refusals(
        s400="a parameter is unknown or does not fit",
        s4XX="another refusal",
        s401="no key, or one that is unknown or revoked",
        s503="the database did not answer in time",
    ),
)


async def _no_parameters(query: Annotated[Parameters, Query()]) -> None:
    """Refuse every parameter."""
    del query


async def _base(request: Request) -> str:
    """Absolute address of the API as the caller sees it; links of the standard are absolute."""
    try:
        return f"{str(request.base_url).rstrip('/')}/ogc"
    except ValueError:
        raise InvalidParameterError("the header Host is no host") from None


BaseNow = Annotated[str, Depends(_base)]


@ogc.get("", dependencies=[Depends(_no_parameters)])
async def get_landing(base: BaseNow, _caller: CallerNow) -> LandingPage:
    """The entry: links to everything."""
    return documents.landing(base)


@ogc.get("/conformance", dependencies=[Depends(_no_parameters)])
async def get_conformance(_caller: CallerNow) -> Conformance:
    """The conformance classes: core and GeoJSON."""
    return documents.conformance()


@ogc.get("/api", dependencies=[Depends(_no_parameters)])
async def get_api(request: Request, _caller: CallerNow) -> dict[str, Any]:
    """The OpenAPI document, as plain JSON: GDAL refuses the media type of version 3.1."""
    document: dict[str, Any] = request.app.openapi()
    return document


@ogc.get("/collections", dependencies=[Depends(_no_parameters)])
async def get_collections(base: BaseNow, _caller: CallerNow) -> Collections:
    """All collections: there is one."""
    return documents.collections(base)


@ogc.get(_HERE, dependencies=[Depends(_no_parameters)])
async def get_collection(base: BaseNow, _caller: CallerNow) -> Collection:
    """The collection of obstacles."""
    return documents.collection(base)


@ogc.get(
    f"{_HERE}/items",
    response_class=GeoJson,
    responses={200: {"model": Items}, 304: representation.UNCHANGED},
)
async def get_items(
    request: Request, base: BaseNow, _caller: CallerNow, parts: PartsNow, query: Annotated[ItemsQuery, Query()]
) -> Response:
    """Live obstacles, page by page."""
    now = datetime.now(UTC)
    async with parts.database.read() as connection:
        search = Search(connection, parts.life, now)
        page = await search.inside(query.bounds, query.filters, query.after(), query.limit)
        matched = await search.count(query.bounds, query.filters) if query.count else None
    links = documents.items_links(base, _address(request, base), _next_address(request, base, query, page))
    tag = collection.tag(
        (collection.mark_of(item.id, item.properties.revision) for item in page.features), matched, links
    )
    if representation.holds(request.headers.get("if-none-match"), tag):
        return representation.unchanged(tag)
    items = Items(
        features=tuple(map(features.item, page.features)),
        links=links,
        timeStamp=now,
        numberReturned=len(page.features),
        numberMatched=matched,
    )
    body = items.model_dump_json(exclude=None if query.count else {"numberMatched"}).encode()
    return representation.answer(request, body, GEOJSON, tag)


@ogc.get(
    f"{_HERE}/items/{{feature_id}}",
    response_class=GeoJson,
    dependencies=[Depends(_no_parameters)],
    responses={
        200: {"model": SingleItem},
        304: representation.UNCHANGED,
        **refusals(s404="no obstacle ever had this id"),
    },
)
async def get_item(request: Request, feature_id: str, base: BaseNow, _caller: CallerNow, parts: PartsNow) -> Response:
    """One obstacle, also one that was removed."""
    async with parts.database.read() as connection:
        obstacle = await _found(Repository(connection, parts.life), feature_id)
    flat = features.item(feature_of(obstacle, parts.life))
    item = SingleItem(**dict(flat), links=documents.item_links(base, feature_id))
    tag = collection.tag([collection.mark_of(obstacle.id, obstacle.revision)], base)
    return representation.answer(request, item.model_dump_json().encode(), GEOJSON, tag)


async def _found(repository: Repository, feature_id: str) -> Obstacle:
    try:
        found = await repository.obstacle(UUID(feature_id))
    except ValueError:
        found = None
    if found is None:
        raise ObstacleNotFoundError(f"there is no obstacle {feature_id[:64]}")
    return found


def _address(request: Request, base: str) -> str:
    query = urlencode(request.query_params.multi_items())
    return f"{base}{_HERE}/items" + (f"?{query}" if query else "")


def _next_address(request: Request, base: str, query: ItemsQuery, page: Page) -> str | None:
    if page.more_behind is None:
        return None
    kept = [(name, value) for name, value in request.query_params.multi_items() if name != "cursor"]
    return f"{base}{_HERE}/items?{urlencode([*kept, ('cursor', query.cursor_behind(page.more_behind))])}"
