"""The living record of an obstacle as it is served: a GeoJSON feature (RFC 7946)."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal
from uuid import UUID

from pydantic import Field

from contract.geometry import Box, BoxSd, Kind, LatLon, Message, PlaneCovariance, Sign, UtcDatetime
from contract.observation import State


class PointGeometry(Message):
    """GeoJSON point: longitude first, degrees (the only place where that order exists)."""

    type: Literal["Point"] = "Point"
    coordinates: tuple[float, float]

    @classmethod
    def at(cls, position: LatLon) -> PointGeometry:
        """Geometry of a position."""
        return cls(coordinates=(position.longitude_deg, position.latitude_deg))

    @property
    def position(self) -> LatLon:
        """The position of the geometry."""
        return LatLon(latitude_deg=self.coordinates[1], longitude_deg=self.coordinates[0])


class InspectionState(StrEnum):
    """Where an obstacle stands in the road operator's work."""

    OPEN = "open"
    INSPECTED = "inspected"
    SCHEDULED = "scheduled"
    REPAIRED = "repaired"
    NOT_AN_ISSUE = "not_an_issue"


RemovalReason = Literal["absent", "merged", "expired", "operator"]


class ObstacleProperties(Message):
    """What is known of an obstacle. `version` counts shapes, `revision` every change of a served field."""

    kind: Kind
    sign: Sign
    state: State
    version: Annotated[int, Field(ge=1)]
    revision: Annotated[int, Field(ge=1)]
    box: Box
    box_sd: BoxSd
    volume_m3: float
    position_covariance: PlaneCovariance
    altitude_m: float
    confidence: Annotated[float, Field(ge=0, le=1, description="as of `as_of`; halves every `half_life_s`")]
    as_of: UtcDatetime
    half_life_s: float
    expires_at: UtcDatetime
    first_seen: UtcDatetime
    last_seen: UtcDatetime
    sightings: Annotated[int, Field(ge=1)]
    witnesses: Annotated[int, Field(ge=1)]
    succeeds: UUID | None = None
    merged_into: UUID | None = None
    removed_reason: RemovalReason | None = None
    inspection_state: InspectionState = InspectionState.OPEN


class ObstacleFeature(Message):
    """One obstacle."""

    type: Literal["Feature"] = "Feature"
    id: UUID
    geometry: PointGeometry
    properties: ObstacleProperties

    @property
    def position(self) -> LatLon:
        """Position of the centre of the obstacle's box."""
        return self.geometry.position


class Link(Message):
    """A related resource (RFC 8288). `href` is relative to the server unless the resource says otherwise."""

    rel: str
    href: str
    type: str | None = None


class ObstacleCollection(Message):
    """A page of obstacles: nearest first around a place, by id in a box. A link `next` when there is more."""

    type: Literal["FeatureCollection"] = "FeatureCollection"
    features: tuple[ObstacleFeature, ...]
    links: tuple[Link, ...] = ()


class MultiPointGeometry(Message):
    """GeoJSON points: longitude, latitude in degrees, ellipsoidal height in metres (WGS 84)."""

    type: Literal["MultiPoint"] = "MultiPoint"
    coordinates: tuple[tuple[float, float, float], ...]


class PointsProperties(Message):
    """Which version the points show; `observed_at` is when they were measured."""

    kind: Kind
    version: Annotated[int, Field(ge=1)]
    observed_at: UtcDatetime


class ObstaclePoints(Message):
    """The voxel-thinned points of one version of an obstacle, about the place where it is known to be now."""

    type: Literal["Feature"] = "Feature"
    id: UUID
    geometry: MultiPointGeometry
    properties: PointsProperties
