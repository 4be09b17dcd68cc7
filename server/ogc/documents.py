"""Landing page, conformance and collections: documents that depend on nothing but where the server is. Pure."""

from __future__ import annotations

from server.ogc.models import (
    Collection,
    Collections,
    Conformance,
    Extent,
    LandingPage,
    SpatialExtent,
    TemporalExtent,
    Titled,
)

JSON, GEOJSON, HTML = "application/json", "application/geo+json", "text/html"
CRS84 = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
COLLECTION_ID = "obstacles"
# Not `oas30`: the description is OpenAPI 3.1.
CONFORMANCE = tuple(f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" for name in ("core", "geojson"))


def landing(base: str) -> LandingPage:
    """The entry; `base` is the absolute address of the API, without a slash at its end."""
    return LandingPage(
        title="HeadsUp obstacles",
        description="Potholes, bumps and debris on roads, as vehicles saw them.",
        links=(
            _link("self", base, "this document"),
            _link("service-desc", f"{base}/api", "the API's description"),
            _link("service-doc", f"{base.removesuffix('/ogc')}/docs", "the API's description for people", HTML),
            _link("conformance", f"{base}/conformance", "conformance classes"),
            _link("data", f"{base}/collections", "collections"),
        ),
    )


def conformance() -> Conformance:
    """What the API conforms to."""
    return Conformance(conformsTo=CONFORMANCE)


def collections(base: str) -> Collections:
    """The one collection there is."""
    return Collections(links=(_link("self", f"{base}/collections", "this document"),), collections=(collection(base),))


def collection(base: str) -> Collection:
    """The obstacles that are live."""
    here = f"{base}/collections/{COLLECTION_ID}"
    return Collection(
        id=COLLECTION_ID,
        title="Obstacles",
        description="One point for each obstacle, with its box, depth or height, and how sure it is.",
        links=(
            _link("self", here, "this document"),
            _link("items", f"{here}/items", "the obstacles", GEOJSON),
        ),
        extent=Extent(
            spatial=SpatialExtent(bbox=((-180.0, -90.0, 180.0, 90.0),), crs=CRS84),
            temporal=TemporalExtent(interval=((None, None),)),
        ),
        crs=(CRS84,),
    )


def items_links(base: str, here: str, behind: str | None) -> tuple[Titled, ...]:
    """Links of a page: itself, the next one if there is one, its collection."""
    links = [_link("self", here, "this page", GEOJSON)]
    if behind is not None:
        links.append(_link("next", behind, "the next page", GEOJSON))
    return (*links, _link("collection", f"{base}/collections/{COLLECTION_ID}", "the collection"))


def item_links(base: str, identifier: str) -> tuple[Titled, ...]:
    """Links of a feature: itself, the whole record, its collection."""
    here = f"{base}/collections/{COLLECTION_ID}"
    whole = f"{base.removesuffix('/ogc')}/v1/obstacles/{identifier}"
    return (
        _link("self", f"{here}/items/{identifier}", "this feature", GEOJSON),
        _link("alternate", whole, "the whole record of the obstacle", GEOJSON),
        _link("collection", here, "the collection"),
    )


def _link(rel: str, href: str, title: str, media_type: str = JSON) -> Titled:
    return Titled(rel=rel, href=href, type=media_type, title=title)
