"""Obstacles as they are served: GeoJSON features and events."""

from __future__ import annotations

from dataclasses import dataclass
from uuid import UUID

from sqlalchemy import RowMapping

from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature, ObstacleProperties, PointGeometry
from server.life.decay import expires_at
from server.life.obstacle import Obstacle, RemovalReason
from server.life.policy import Life
from server.storage.rows import obstacle_of


@dataclass(frozen=True, slots=True)
class ObstacleEvent:
    """A served field of an obstacle changed, or the obstacle is gone; published after the commit."""

    obstacle_id: UUID
    revision: int
    position: LatLon
    feature: ObstacleFeature
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
            feature=feature,
            removed_reason=properties.removed_reason,
            merged_into=properties.merged_into,
        )


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


def stored_feature(row: RowMapping, life: Life) -> ObstacleFeature:
    """An obstacle as a GeoJSON feature from its row, whose text was made when it last changed."""
    text = row["feature"]
    if text is None:
        return feature_of(obstacle_of(row), life)
    return ObstacleFeature.model_validate_json(text)


def event_of(obstacle: Obstacle, life: Life) -> ObstacleEvent:
    """The event that tells of an obstacle's latest revision."""
    return ObstacleEvent.of(feature_of(obstacle, life))
