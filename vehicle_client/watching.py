"""Which known obstacles a pass inspects: a pure fold over the map, from coming within range to being left behind."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from uuid import UUID

from contract.obstacle import ObstacleFeature
from vehicle_client.frames import Vector
from vehicle_client.obstacle_map import ObstacleMap, place_in_vehicle
from vehicle_client.positioning.pose import Pose
from vehicle_client.tracking import FORGET_M

INSPECTED_M = 18.0
"""A known place is judged this far behind the car: as late as its hits are kept (30 m of memory less 12 m of range),
since what the car meets meanwhile tells how the map lies on the road."""

WATCH_AHEAD_M = 30.0
"""A known obstacle nearer than this ahead is on the list to be inspected."""

WATCH_BESIDE_M = 10.0
"""Beyond this sideways, no sweep of the pass is dense enough for a verdict."""


@dataclass(frozen=True, slots=True)
class Watch:
    """A known obstacle as the server described it when it came within range.

    What the server makes of this car's own reports moves the obstacle towards this car's error; a pass is judged by
    what was known before it.
    """

    feature: ObstacleFeature
    inspected: bool = False


Watches = Mapping[UUID, Watch]
NO_WATCHES: Watches = MappingProxyType({})


def watch(watches: Watches, known: ObstacleMap, pose: Pose, own: Collection[UUID] = ()) -> Watches:
    """Add what lies ahead within range; drop what the server removed and what is far behind.

    `own` are obstacles that this pass has told the server of: they were not known before it.
    """
    near = {
        obstacle_id: Watch(entry.feature)
        for obstacle_id, entry in known.obstacles.items()
        if obstacle_id not in own and _is_approached(place_in_vehicle(entry.feature, pose))
    }
    kept = {
        obstacle_id: entry
        for obstacle_id, entry in watches.items()
        if obstacle_id in known.obstacles and place_in_vehicle(entry.feature, pose)[0] > -FORGET_M
    }
    return MappingProxyType(near | kept)


def due(watches: Watches, pose: Pose, *, at_end: bool) -> list[ObstacleFeature]:
    """Obstacles not yet inspected that the car has passed (at the end of a drive: all that remain)."""
    return [
        entry.feature
        for entry in watches.values()
        if not entry.inspected and (at_end or place_in_vehicle(entry.feature, pose)[0] < -INSPECTED_M)
    ]


def marked_inspected(watches: Watches, obstacle_ids: Collection[UUID]) -> Watches:
    """The same list, with those of `obstacle_ids` marked as inspected."""
    return MappingProxyType(
        {i: replace(entry, inspected=entry.inspected or i in obstacle_ids) for i, entry in watches.items()}
    )


def _is_approached(place_vehicle_m: Vector) -> bool:
    ahead_m, beside_m = float(place_vehicle_m[0]), float(place_vehicle_m[1])
    return 0 < ahead_m < WATCH_AHEAD_M and abs(beside_m) < WATCH_BESIDE_M
