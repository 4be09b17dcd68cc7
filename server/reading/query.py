"""What a reader asks for: the parameters of `GET /v1/obstacles` as one value, checked as a whole. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated
from uuid import UUID

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from contract.geometry import Kind, LatLon, UtcDatetime
from contract.observation import State
from server.formats.names import FormatName
from server.geometry.bounds import PATTERN, Bounds
from server.reading.around import Ahead, Circle, Key
from server.reading.cursors import cursor_of, position_of

MAX_RADIUS_M = 50_000.0
DEFAULT_RADIUS_M = 1_000.0
MAX_FEATURES = 1_000
# Geodesic radii are shorter than this, so nothing wider says more.
_MAX_CORRIDOR_M = 2 * MAX_RADIUS_M


@dataclass(frozen=True, slots=True)
class Filters:
    """What obstacles must be like. `states` None: all that are live. Edges belong to the interval of time."""

    kinds: frozenset[Kind] = frozenset()
    states: frozenset[State] | None = None
    min_confidence: float = 0.0
    seen_since: datetime | None = None
    first_seen_until: datetime | None = None


def split_commas(value: object) -> object:
    """Repeated parameters and comma lists alike as one list of items."""
    if not isinstance(value, list | tuple):
        return value
    return [item for text in value for item in (text.split(",") if isinstance(text, str) else [text])]


def _is_bounds(text: str) -> str:
    Bounds.parsed(text)
    return text


_BBOX = Field(
    description="west,south,east,north in degrees; west > east runs across the antimeridian",
    json_schema_extra={"pattern": PATTERN},
    examples=["21.70,38.20,21.78,38.28"],
)
KindList = Annotated[tuple[Kind, ...], BeforeValidator(split_commas), Field(description="repeated, or a comma list")]
StateList = Annotated[
    tuple[State, ...],
    BeforeValidator(split_commas),
    Field(description="repeated, or a comma list; without it: candidate and confirmed. Expired ones are never live"),
]
Missing = SkipJsonSchema[None]


class Parameters(BaseModel):
    """Query parameters of one route; those it does not know are refused by name."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ObstacleQuery(Parameters):
    """Query of `GET /v1/obstacles`: exactly one area, filters, and the page."""

    lat: Annotated[float, Field(ge=-90, le=90, description="latitude of a circle's centre, degrees")] | Missing = None
    lon: Annotated[float, Field(ge=-180, le=180, description="its longitude, degrees")] | Missing = None
    radius_m: (
        Annotated[float, Field(gt=0, le=MAX_RADIUS_M, description="geodesic; 1000 when it is not given")] | Missing
    ) = None
    bbox: Annotated[str, AfterValidator(_is_bounds), _BBOX] | Missing = None
    kind: KindList = ()
    state: StateList = ()
    min_confidence: Annotated[float, Field(ge=0, le=1, description="of the confidence as decayed to now")] = 0.0
    seen_since: Annotated[UtcDatetime, Field(description="last seen at or after this RFC 3339 moment")] | Missing = None
    heading_deg: (
        Annotated[float, Field(ge=0, le=360, description="clockwise from north: only what lies ahead of lat, lon")]
        | Missing
    ) = None
    corridor_m: (
        Annotated[float, Field(gt=0, le=_MAX_CORRIDOR_M, description="full width of the strip along the heading")]
        | Missing
    ) = None
    limit: Annotated[int, Field(ge=1, le=MAX_FEATURES, description="features in one page")] = MAX_FEATURES
    cursor: Annotated[str, Field(max_length=200, description="from the link `next` of the page before")] | Missing = (
        None
    )
    f: Annotated[FormatName, Field(description="format; else the header Accept decides")] | Missing = None

    @model_validator(mode="after")
    def _is_one_area(self) -> ObstacleQuery:
        around = (self.lat, self.lon, self.radius_m, self.heading_deg, self.corridor_m)
        if self.bbox is not None and any(value is not None for value in around):
            raise ValueError("give one area: either lat, lon and radius_m, or bbox (heading_deg needs lat and lon)")
        if self.corridor_m is not None and self.heading_deg is None:
            raise ValueError("corridor_m needs heading_deg")
        _ = self.area, self.after()
        return self

    @property
    def area(self) -> Circle | Bounds:
        """The circle or the box asked for."""
        if self.bbox is not None:
            return Bounds.parsed(self.bbox)
        if self.lat is None or self.lon is None:
            raise ValueError("give one area: lat, lon and radius_m, or bbox")
        ahead = None
        if self.heading_deg is not None:
            ahead = Ahead(math.radians(self.heading_deg), self.corridor_m)
        radius_m = DEFAULT_RADIUS_M if self.radius_m is None else self.radius_m
        return Circle(LatLon(latitude_deg=self.lat, longitude_deg=self.lon), radius_m, ahead)

    @property
    def filters(self) -> Filters:
        """What the obstacles must be like."""
        return Filters(
            kinds=frozenset(self.kind),
            states=frozenset(self.state) or None,
            min_confidence=self.min_confidence,
            seen_since=self.seen_since,
        )

    def after(self) -> Key | None:
        """Where the page begins; raises `ValueError` for a cursor of another query."""
        return None if self.cursor is None else Key(*position_of(self.cursor, self._scope(), (float, UUID)))

    def cursor_behind(self, key: Key) -> str:
        """The cursor of the page that begins behind a key."""
        return cursor_of(self._scope(), (key.distance_m, key.id))

    def _scope(self) -> str:
        return self.model_dump_json(exclude={"limit", "cursor", "f"})
