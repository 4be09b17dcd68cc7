"""What the server said around the car: a pure fold over its messages; the latest revision of each obstacle wins.

`obstacles` lie around the car, `remembered` farther away: in areas that the server no longer speaks of. Both may hold
what the server vouches for no longer (`unvouched_s`); such an obstacle goes as soon as the server speaks of its place
without naming it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from types import MappingProxyType
from uuid import UUID

from contract.events import Appeared, Left, Removed, Updated
from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature
from vehicle_client.area import Heard, Reached, Surveyed, distance_m
from vehicle_client.frames import Vector
from vehicle_client.positioning.pose import Pose

FRESH_FOR_S = 10.0
"""Age of the last word from the server after which the map is shown as not fresh."""

NEAR_M = 800.0
"""Obstacles within this are looked at in every frame: twice as far as any warning, and beyond what the server watches
around the car (600 m) by what it drives before it is sorted anew."""

SORTED_ANEW_M = 100.0
"""Driven distance after which it is decided again what is near."""

MOST_REMEMBERED = 2_000
"""Of those far away the nearest are kept: three to the kilometre of a day's drive, and sorted anew within 15 ms."""

REMEMBERED_S = 14 * 86_400.0
"""A pothole is mended in about a month: after two weeks without word a fourth of the warnings would be false."""

MOST_TOMBSTONES = 1_000
"""A removal is remembered only to outlast messages that it has overtaken; those are seconds late, not hours."""


@dataclass(frozen=True, slots=True)
class KnownObstacle:
    """An obstacle as the server described it, and when this car first heard of it (Unix seconds).

    `unvouched_s` is when the server spoke of it last, once it no longer does: None while it does.
    """

    feature: ObstacleFeature
    told_s: float
    unvouched_s: float | None = None
    position: LatLon = field(init=False, compare=False)
    """The feature's, which makes it anew at each call: a map is searched for places all the time."""

    def __post_init__(self) -> None:
        """Take the position out of the feature."""
        object.__setattr__(self, "position", self.feature.position)


Obstacles = Mapping[UUID, KnownObstacle]
_NOTHING: Obstacles = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ObstacleMap:
    """Obstacles by id, near and far, tombstones by id with their revision, and the time of the server's last word."""

    obstacles: Obstacles = field(default_factory=lambda: _NOTHING)
    remembered: Obstacles = field(default_factory=lambda: _NOTHING)
    removed_revisions: Mapping[UUID, int] = field(default_factory=lambda: MappingProxyType({}))
    heard_s: float | None = None
    sorted_at: LatLon | None = None

    def is_fresh(self, now_s: float) -> bool:
        """Whether the server was heard lately."""
        return self.heard_s is not None and now_s - self.heard_s <= FRESH_FOR_S


def apply(known: ObstacleMap, message: Heard, now_s: float) -> ObstacleMap:
    """The map after one message. An older revision changes nothing; a removed obstacle never comes back."""
    before_s = now_s if known.heard_s is None else known.heard_s
    known = replace(known, heard_s=now_s)
    match message:
        case Surveyed(area=area, obstacles=features):
            told = {f.id: _newer(_entry(known, f.id), f, now_s) for f in features if not _is_gone(known, f)}

            def lies_outside(obstacle_id: UUID, entry: KnownObstacle) -> bool:
                return obstacle_id not in told and not area.surely_holds(entry.position)

            near = {i: _unvouched(e, before_s) for i, e in _within(known.obstacles, lies_outside).items()}
            return replace(
                known,
                obstacles=MappingProxyType(told | near),
                remembered=_within(known.remembered, lies_outside),
            )
        case Reached(area=area):
            there = _within(known.obstacles, lambda _, e: e.unvouched_s is None or not area.surely_holds(e.position))
            return replace(known, obstacles=there)
        case Appeared(obstacle=feature) | Updated(obstacle=feature):
            if _is_gone(known, feature):
                return known
            entry = _newer(_entry(known, feature.id), feature, now_s)
            others = _without(known, feature.id)
            return replace(others, obstacles=MappingProxyType({**others.obstacles, feature.id: entry}))
        case Removed(obstacle_id=obstacle_id, revision=revision):
            return replace(_without(known, obstacle_id), removed_revisions=_buried(known, obstacle_id, revision))
        case Left(obstacle_id=obstacle_id):
            entry_left = known.obstacles.get(obstacle_id)
            if entry_left is None:
                return known
            left = {**known.obstacles, obstacle_id: _unvouched(entry_left, now_s)}
            return replace(known, obstacles=MappingProxyType(left))


def around(known: ObstacleMap, position: LatLon, now_s: float) -> ObstacleMap:
    """The map sorted anew into near and far when the car has come some way; without what has expired or is too old.

    Of what is far away the nearest `MOST_REMEMBERED` stay.
    """
    if known.sorted_at is not None and distance_m(known.sorted_at, position) < SORTED_ANEW_M:
        return drop_expired(known, now_s)
    alive = _within({**known.remembered, **known.obstacles}, lambda _, entry: _is_alive(entry, now_s))
    distances_m = {i: distance_m(position, entry.position) for i, entry in alive.items()}
    near = {i: entry for i, entry in alive.items() if distances_m[i] <= NEAR_M}
    far = sorted(alive.keys() - near.keys(), key=lambda i: (distances_m[i], i))
    return replace(
        known,
        obstacles=MappingProxyType(near),
        remembered=MappingProxyType({i: alive[i] for i in islice(far, MOST_REMEMBERED)}),
        sorted_at=position,
    )


def drop_expired(known: ObstacleMap, now_s: float) -> ObstacleMap:
    """The map without near obstacles whose `expires_at` has passed, or that nobody has vouched for in two weeks."""
    kept = _within(known.obstacles, lambda _, entry: _is_alive(entry, now_s))
    return known if len(kept) == len(known.obstacles) else replace(known, obstacles=kept)


def place_in_vehicle(feature: ObstacleFeature, pose: Pose) -> Vector:
    """Centre of a known obstacle in the `vehicle` frame, (3,)."""
    return pose.in_vehicle(feature.position, feature.properties.altitude_m)


def stored_sd_m(feature: ObstacleFeature) -> float:
    """Standard deviation per axis of a known obstacle's position."""
    covariance = feature.properties.position_covariance
    return math.sqrt((covariance.east_m2 + covariance.north_m2) / 2)


def _is_alive(entry: KnownObstacle, now_s: float) -> bool:
    is_recent = entry.unvouched_s is None or now_s - entry.unvouched_s <= REMEMBERED_S
    return is_recent and entry.feature.properties.expires_at.timestamp() > now_s


def _is_gone(known: ObstacleMap, feature: ObstacleFeature) -> bool:
    return feature.properties.revision <= known.removed_revisions.get(feature.id, 0)


def _entry(known: ObstacleMap, obstacle_id: UUID) -> KnownObstacle | None:
    return known.obstacles.get(obstacle_id) or known.remembered.get(obstacle_id)


def _newer(entry: KnownObstacle | None, feature: ObstacleFeature, now_s: float) -> KnownObstacle:
    if entry is None:
        return KnownObstacle(feature, told_s=now_s)
    if feature.properties.revision <= entry.feature.properties.revision:
        feature = entry.feature
    return replace(entry, feature=feature, unvouched_s=None)


def _unvouched(entry: KnownObstacle, since_s: float) -> KnownObstacle:
    return entry if entry.unvouched_s is not None else replace(entry, unvouched_s=since_s)


def _within(obstacles: Obstacles, stays: Callable[[UUID, KnownObstacle], bool]) -> Obstacles:
    return MappingProxyType({i: entry for i, entry in obstacles.items() if stays(i, entry)})


def _buried(known: ObstacleMap, obstacle_id: UUID, revision: int) -> Mapping[UUID, int]:
    revisions = {i: r for i, r in known.removed_revisions.items() if i != obstacle_id}
    revisions[obstacle_id] = revision
    return MappingProxyType(dict(islice(revisions.items(), max(0, len(revisions) - MOST_TOMBSTONES), None)))


def _without(known: ObstacleMap, obstacle_id: UUID) -> ObstacleMap:
    return replace(
        known,
        obstacles=_other_than(obstacle_id, known.obstacles),
        remembered=_other_than(obstacle_id, known.remembered),
    )


def _other_than(obstacle_id: UUID, obstacles: Obstacles) -> Obstacles:
    return _within(obstacles, lambda i, _: i != obstacle_id) if obstacle_id in obstacles else obstacles
