"""When the driver is told what: a table of stages by time to arrival and a pure choice (`docs/driver.md`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple
from uuid import UUID

from contract.geometry import Kind
from vehicle_client.frames import Vector, apply, inverse
from vehicle_client.obstacle_map import ObstacleMap, place_in_vehicle
from vehicle_client.pose import Pose
from vehicle_client.tracking import Track


class Stage(IntEnum):
    """How urgent an obstacle is; a stage never falls while the obstacle is ahead."""

    INFO = 1
    """The status line counts it."""
    ADVISE = 2
    """A card with sign and distance."""
    WARN = 3
    """A marker on the ground and one chime."""
    MARK = 4
    """About to be passed: the marker stays, faded; no new alarm."""


class StageRow(NamedTuple):
    """From which time to arrival a stage holds, and whether entering it sounds the chime."""

    stage: Stage
    arrival_s: float
    chime: bool


STAGES: tuple[StageRow, ...] = (
    # Werneke et al. 2014: first information at 26.5 s, advice at 12.1 s; Wan et al. 2016: warnings work best at
    # 5 to 8 s; 2.5 s lies above the 2.1 s floor of forward-collision tests: later, an alarm only startles.
    StageRow(Stage.INFO, 26.5, chime=False),
    StageRow(Stage.ADVISE, 12.0, chime=False),
    StageRow(Stage.WARN, 8.0, chime=True),
    StageRow(Stage.MARK, 2.5, chime=False),
)

TITLES: Mapping[Kind, str] = MappingProxyType(
    {Kind.POTHOLE: "Pothole ahead", Kind.BUMP: "Bump ahead", Kind.DEBRIS: "Debris on road"}
)
"""At most 24 characters, so that a glance is enough."""

MIN_DISTANCE_M, MAX_DISTANCE_M = 30.0, 400.0
"""A stage begins no later than 30 m and no earlier than 400 m before the obstacle, whatever the speed."""

STANDSTILL_MPS = 2.0
"""Below walking pace nothing is announced."""

CORRIDOR_M = 3.5
"""Half width of the way ahead: the own lane and half of the next, since both places are known to a metre or two."""

OWN_GATE_M = 4.0
"""An own track and a server's obstacle of one sign nearer than this are one: 3 sigma of two satellite positions."""


@dataclass(frozen=True, slots=True)
class Hazard:
    """One obstacle ahead, from the server, from the own LiDAR, or from both.

    `centre_vehicle_m` is (3,) in the `vehicle` frame; `yaw_rad` is in the same frame. `distance_m` is along the road.
    """

    kind: Kind
    stage: Stage
    distance_m: float
    arrival_s: float
    centre_vehicle_m: Vector
    length_m: float
    width_m: float
    yaw_rad: float
    obstacle_id: UUID | None
    track_id: int | None

    @property
    def title(self) -> str:
        """What the card says."""
        return TITLES[self.kind]

    @property
    def recognised(self) -> bool:
        """Whether the own LiDAR sees it."""
        return self.track_id is not None


@dataclass(frozen=True, slots=True)
class Alerts:
    """What the driver is to be shown now, nearest hazard first, and the memory for the next choice."""

    hazards: tuple[Hazard, ...] = ()
    chime: bool = False
    fresh: bool = True
    stages: Mapping[str, Stage] = field(default_factory=lambda: MappingProxyType({}))


def choose(previous: Alerts, known: ObstacleMap, tracks: Sequence[Track], pose: Pose, now_s: float) -> Alerts:
    """Hazards ahead in the order of distance, each with its stage; one chime for each obstacle on entering WARN."""
    if pose.speed_mps < STANDSTILL_MPS:
        return Alerts(fresh=known.is_fresh(now_s), stages=previous.stages)
    stages: dict[str, Stage] = dict(previous.stages)
    hazards: list[Hazard] = []
    chime = False
    for hazard in _ahead(known, tracks, pose):
        stage = stage_at(hazard.distance_m, pose.speed_mps)
        if stage is None:
            continue
        key = str(hazard.obstacle_id or f"track-{hazard.track_id}")
        before = stages.get(key)
        stages[key] = max(stage, before or stage)
        chime |= any(row.chime and (before or 0) < row.stage <= stages[key] for row in STAGES)
        hazards.append(replace(hazard, stage=stages[key]))
    hazards.sort(key=lambda h: h.distance_m)
    return Alerts(tuple(hazards), chime, known.is_fresh(now_s), MappingProxyType(stages))


def stage_at(distance_m: float, speed_mps: float) -> Stage | None:
    """The stage for a distance along the road at a speed, None when too far away."""
    reached = None
    for row in STAGES:
        begins_m = min(row.arrival_s * speed_mps, MAX_DISTANCE_M)
        if row.stage is not Stage.MARK:
            begins_m = max(begins_m, MIN_DISTANCE_M)
        if distance_m <= begins_m:
            reached = row.stage
    return reached


def _ahead(known: ObstacleMap, tracks: Sequence[Track], pose: Pose) -> list[Hazard]:
    vehicle_from_odom = inverse(pose.odom_from_vehicle)
    own = {t.track_id: (t, apply(vehicle_from_odom, t.centre_odom_m)) for t in tracks if t.confirmed}
    hazards = []
    for entry in known.obstacles.values():
        place = place_in_vehicle(entry.feature, pose)
        kind = entry.feature.properties.kind
        track_id = _own_match(place, kind, own)
        box = entry.feature.properties.box
        if track_id is None:
            yaw = box.yaw_rad - (math.pi / 2 - pose.heading_rad)
            shape = (box.length_mm / 1000, box.width_mm / 1000, yaw % math.pi)
            hazards.append(_hazard(kind, place, shape, pose, entry.feature.id, None))
        else:
            track, centre = own.pop(track_id)
            hazards.append(_hazard(kind, centre, _shape(track, pose), pose, entry.feature.id, track_id))
    hazards += [_hazard(Kind(t.kind), centre, _shape(t, pose), pose, None, t.track_id) for t, centre in own.values()]
    return [h for h in hazards if h.distance_m > 0 and abs(h.centre_vehicle_m[1]) < CORRIDOR_M]


def _own_match(place: Vector, kind: Kind, own: Mapping[int, tuple[Track, Vector]]) -> int | None:
    distances = {
        track_id: math.dist(place[:2], centre[:2])
        for track_id, (track, centre) in own.items()
        if Kind(track.kind).sign is kind.sign
    }
    nearest = min(distances, key=distances.__getitem__, default=None)
    return nearest if nearest is not None and distances[nearest] < OWN_GATE_M else None


def _shape(track: Track, pose: Pose) -> tuple[float, float, float]:
    odom_yaw = math.atan2(pose.odom_from_vehicle[1, 0], pose.odom_from_vehicle[0, 0])
    return track.length_m, track.width_m, (track.yaw_rad - odom_yaw) % math.pi


def _hazard(
    kind: Kind,
    centre: Vector,
    shape: tuple[float, float, float],
    pose: Pose,
    obstacle_id: UUID | None,
    track_id: int | None,
) -> Hazard:
    distance_m = float(centre[0])
    length_m, width_m, yaw_rad = shape
    arrival_s = distance_m / pose.speed_mps
    return Hazard(kind, Stage.INFO, distance_m, arrival_s, centre, length_m, width_m, yaw_rad, obstacle_id, track_id)
