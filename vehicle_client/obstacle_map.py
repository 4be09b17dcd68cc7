"""What the server said around the car: a pure fold over its messages; the latest revision of each obstacle wins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from uuid import UUID

from contract.events import Appeared, Left, Moved, Removed, ServerMessage, Snapshot, Updated
from contract.obstacle import ObstacleFeature
from vehicle_client.frames import Vector
from vehicle_client.pose import Pose

FRESH_FOR_S = 10.0
"""Age of the last word from the server after which the map is shown as not fresh."""


def _nothing() -> Mapping[UUID, KnownObstacle]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class KnownObstacle:
    """An obstacle as the server described it, and when this car first heard of it (Unix seconds)."""

    feature: ObstacleFeature
    told_s: float


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """Obstacles by id, tombstones by id with their revision, and the time of the server's last word."""

    obstacles: Mapping[UUID, KnownObstacle] = field(default_factory=_nothing)
    removed_revisions: Mapping[UUID, int] = field(default_factory=lambda: MappingProxyType({}))
    heard_s: float | None = None

    def is_fresh(self, now_s: float) -> bool:
        """Whether the server was heard lately."""
        return self.heard_s is not None and now_s - self.heard_s <= FRESH_FOR_S


def apply(known: ObstacleMap, message: ServerMessage, now_s: float) -> ObstacleMap:
    """The map after one message. An older revision changes nothing; a removed obstacle never comes back."""
    known = replace(known, heard_s=now_s)
    match message:
        case Snapshot(obstacles=features):
            told = {f.id: _newer(known.obstacles.get(f.id), f, now_s) for f in features if not _is_gone(known, f)}
            return replace(known, obstacles=MappingProxyType(told))
        case Appeared(obstacle=feature) | Updated(obstacle=feature):
            if _is_gone(known, feature):
                return known
            entry = _newer(known.obstacles.get(feature.id), feature, now_s)
            return replace(known, obstacles=MappingProxyType({**known.obstacles, feature.id: entry}))
        case Removed(obstacle_id=obstacle_id, revision=revision):
            revisions = MappingProxyType({**known.removed_revisions, obstacle_id: revision})
            return replace(_without(known, obstacle_id), removed_revisions=revisions)
        case Left(obstacle_id=obstacle_id):
            return _without(known, obstacle_id)
        case Moved():
            return known


def drop_expired(known: ObstacleMap, now_s: float) -> ObstacleMap:
    """The map without obstacles whose `expires_at` has passed."""
    kept = {i: k for i, k in known.obstacles.items() if k.feature.properties.expires_at.timestamp() > now_s}
    return known if len(kept) == len(known.obstacles) else replace(known, obstacles=MappingProxyType(kept))


def place_in_vehicle(feature: ObstacleFeature, pose: Pose) -> Vector:
    """Centre of a known obstacle in the `vehicle` frame, (3,)."""
    return pose.in_vehicle(feature.position, feature.properties.altitude_m)


def stored_sd_m(feature: ObstacleFeature) -> float:
    """Standard deviation per axis of a known obstacle's position."""
    covariance = feature.properties.position_covariance
    return math.sqrt((covariance.east_m2 + covariance.north_m2) / 2)


def _is_gone(known: ObstacleMap, feature: ObstacleFeature) -> bool:
    return feature.properties.revision <= known.removed_revisions.get(feature.id, 0)


def _newer(entry: KnownObstacle | None, feature: ObstacleFeature, now_s: float) -> KnownObstacle:
    if entry is None:
        return KnownObstacle(feature, told_s=now_s)
    if feature.properties.revision <= entry.feature.properties.revision:
        return entry
    return replace(entry, feature=feature)


def _without(known: ObstacleMap, obstacle_id: UUID) -> ObstacleMap:
    kept = {i: k for i, k in known.obstacles.items() if i != obstacle_id}
    return replace(known, obstacles=MappingProxyType(kept))
