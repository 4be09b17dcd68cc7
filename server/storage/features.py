"""Obstacles as they are served: GeoJSON features and events."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from uuid import UUID

from pydantic_core import to_json

from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature, ObstacleProperties, PointGeometry
from server.life.decay import expires_at
from server.life.obstacle import Obstacle, RemovalReason
from server.life.policy import Life


@dataclass(frozen=True)
class ObstacleEvent:
    """A served field of an obstacle changed, or the obstacle is gone; published after the commit."""

    obstacle_id: UUID
    revision: int
    position: LatLon
    told: ObstacleFeature | str
    """The feature, or its text: few events have a vehicle near them that must be told."""
    removed_reason: RemovalReason | None
    merged_into: UUID | None

    @staticmethod
    def of(feature: ObstacleFeature) -> ObstacleEvent:
        """The event that tells of a feature as it was logged."""
        properties = feature.properties
        return ObstacleEvent(
            obstacle_id=feature.id,
            revision=properties.revision,
            position=feature.position,
            told=feature,
            removed_reason=properties.removed_reason,
            merged_into=properties.merged_into,
        )

    @cached_property
    def feature(self) -> ObstacleFeature:
        """The obstacle after the change."""
        return ObstacleFeature.model_validate_json(self.told) if isinstance(self.told, str) else self.told


def feature_of(obstacle: Obstacle, life: Life) -> ObstacleFeature:
    """An obstacle as a GeoJSON feature."""
    properties = ObstacleProperties(
        kind=obstacle.kind,
        sign=obstacle.sign,
        state=obstacle.state,
        version=obstacle.version,
        revision=obstacle.revision,
        box=obstacle.shape.box,
        box_sd=obstacle.shape.box_sd,
        volume_m3=obstacle.shape.volume_m3,
        position_covariance=obstacle.place.covariance,
        altitude_m=obstacle.place.altitude_m,
        confidence=obstacle.confidence,
        as_of=obstacle.as_of,
        half_life_s=life.half_life_s[obstacle.kind],
        expires_at=expires_at(obstacle, life),
        first_seen=obstacle.first_seen,
        last_seen=obstacle.last_seen,
        sightings=obstacle.sightings,
        witnesses=obstacle.witness_count,
        succeeds=obstacle.succeeds,
        merged_into=obstacle.merged_into,
        removed_reason=obstacle.removed_reason,
        inspection_state=obstacle.inspection_state,
    )
    return ObstacleFeature(id=obstacle.id, geometry=PointGeometry.at(obstacle.place.position), properties=properties)


def feature_text(obstacle: Obstacle, life: Life) -> str:
    """The text of `feature_of`, byte for byte: every report changes one, and few are looked at before they are sent."""
    shape, place = obstacle.shape, obstacle.place
    properties = {
        "kind": obstacle.kind.value,
        "sign": obstacle.sign.value,
        "state": obstacle.state.value,
        "version": obstacle.version,
        "revision": obstacle.revision,
        "box": vars(shape.box),
        "box_sd": vars(shape.box_sd),
        "volume_m3": shape.volume_m3,
        "position_covariance": vars(place.covariance),
        "altitude_m": place.altitude_m,
        "confidence": obstacle.confidence,
        "as_of": obstacle.as_of,
        "half_life_s": life.half_life_s[obstacle.kind],
        "expires_at": expires_at(obstacle, life),
        "first_seen": obstacle.first_seen,
        "last_seen": obstacle.last_seen,
        "sightings": obstacle.sightings,
        "witnesses": obstacle.witness_count,
        "succeeds": obstacle.succeeds,
        "merged_into": obstacle.merged_into,
        "removed_reason": obstacle.removed_reason,
        "inspection_state": obstacle.inspection_state.value,
    }
    point = {"type": "Point", "coordinates": (place.position.longitude_deg, place.position.latitude_deg)}
    feature = {"type": "Feature", "id": obstacle.id, "geometry": point, "properties": properties}
    return to_json(feature).decode()


def event_of(obstacle: Obstacle, text: str) -> ObstacleEvent:
    """The event that tells of an obstacle's latest revision, whose `feature_text` is given."""
    return ObstacleEvent(
        obstacle_id=obstacle.id,
        revision=obstacle.revision,
        position=obstacle.place.position,
        told=text,
        removed_reason=obstacle.removed_reason,
        merged_into=obstacle.merged_into,
    )
