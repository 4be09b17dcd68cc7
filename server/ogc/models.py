"""The documents of OGC API - Features, part 1 (OGC 17-069r4), as the schemas of its annex describe them."""

from __future__ import annotations

from datetime import datetime
from typing import Literal
from uuid import UUID

from pydantic import BaseModel, Field

from contract.geometry import Kind, UtcDatetime
from contract.observation import State
from contract.obstacle import InspectionState, Link, PointGeometry


class Titled(Link):
    """A link with a title; `href` is absolute."""

    title: str


class LandingPage(BaseModel):
    """7.2: where everything is."""

    title: str
    description: str
    links: tuple[Titled, ...]


class Conformance(BaseModel):
    """7.4: the conformance classes."""

    conformsTo: tuple[str, ...]  # noqa: N815  # the standard's name


class SpatialExtent(BaseModel):
    """Box of all features: west, south, east, north."""

    bbox: tuple[tuple[float, float, float, float], ...]
    crs: str


class TemporalExtent(BaseModel):
    """Interval of all features; null is open."""

    interval: tuple[tuple[datetime | None, datetime | None], ...]


class Extent(BaseModel):
    """7.14: where and when the features are."""

    spatial: SpatialExtent
    temporal: TemporalExtent


class Collection(BaseModel):
    """7.14: a collection of features."""

    id: str
    title: str
    description: str
    links: tuple[Titled, ...]
    extent: Extent
    itemType: Literal["feature"] = "feature"  # noqa: N815  # the standard's name
    crs: tuple[str, ...]


class Collections(BaseModel):
    """7.13: all collections."""

    links: tuple[Titled, ...]
    collections: tuple[Collection, ...]


class FlatProperties(BaseModel):
    """An obstacle's properties without nesting, in metres and degrees: a row of a GIS table."""

    kind: Kind
    sign: str
    state: State
    length_m: float
    width_m: float
    relief_m: float = Field(description="depth below the road or height above it")
    yaw_deg: float = Field(description="direction of the length, counter-clockwise from east, below 180")
    volume_m3: float
    altitude_m: float
    position_sd_m: float = Field(description="of the worse direction")
    confidence: float = Field(description="as of `as_of`; halves every `half_life_s`")
    as_of: UtcDatetime
    half_life_s: float
    expires_at: UtcDatetime
    first_seen: UtcDatetime
    last_seen: UtcDatetime
    sightings: int
    witnesses: int
    version: int
    revision: int
    inspection_state: InspectionState


class Item(BaseModel):
    """A feature of a page."""

    type: Literal["Feature"] = "Feature"
    id: UUID
    geometry: PointGeometry
    properties: FlatProperties


class SingleItem(Item):
    """7.16: a feature on its own, with its links."""

    links: tuple[Titled, ...]


class Items(BaseModel):
    """7.15: a page of features."""

    type: Literal["FeatureCollection"] = "FeatureCollection"
    features: tuple[Item, ...]
    links: tuple[Titled, ...]
    timeStamp: datetime  # noqa: N815  # the standard's name
    numberReturned: int  # noqa: N815  # the standard's name
    numberMatched: int | None = None  # noqa: N815  # the standard's name
