"""When the driver is told what: a table of stages by time to arrival and a pure choice (`docs/driver.md`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple
from uuid import UUID

import numpy as np

from contract.geometry import Kind
from contract.obstacle import ObstacleFeature
from vehicle_client.alignment import UNALIGNED, Alignment
from vehicle_client.frames import Vector, apply, inverse
from vehicle_client.obstacle_map import ObstacleMap, place_in_vehicle, stored_sd_m
from vehicle_client.positioning.pose import Pose
from vehicle_client.posts import POST_BESIDE_M, is_slender
from vehicle_client.tracking import Track
from vehicle_client.way_ahead import along_bend, on_way


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

CHIMING = frozenset(row.stage for row in STAGES if row.chime)

TITLES: Mapping[Kind, str] = MappingProxyType(
    {Kind.POTHOLE: "Pothole ahead", Kind.BUMP: "Bump ahead", Kind.DEBRIS: "Debris on road"}
)
"""At most 24 characters, so that a glance is enough."""

MIN_DISTANCE_M, MAX_DISTANCE_M = 30.0, 400.0
"""A stage begins no later than 30 m and no earlier than 400 m before the obstacle, whatever the speed."""

STANDSTILL_MPS = 2.0
"""Below walking pace nothing is announced, nor while the car backs."""

CORRIDOR_M = 2.5
"""Half width of the way ahead: half a lane (1.75 m) and half a large hole; how unsure both places are comes on top."""

STAYS_M = CORRIDOR_M - POST_BESIDE_M
"""What was announced stays so while it lies no farther outside the way, also where it turns out to be slender: who can
read a marker that comes and goes?"""

WIDE_SDS = 2.0
SURE_BEFORE_S, AT_LATEST_S = 3.0, 2.0
"""How unsure it may be whether a place lies on the way. Most of what a bend could yet lead to lies beside it: what only
the own LiDAR sees has to lie on it by two standard deviations 3 s ahead, where there is time to become surer, and is
warned of 2 s ahead unless it lies beside by two: within 2 s a car stops from 30 km/h, a second of them gone before the
driver brakes with 4 m/s^2. What the server tells comes seconds earlier, and is warned of if it may lie on the way."""

OWN_GATE_M = 4.0
"""An own track and a server's obstacle of one sign nearer than this are one: 3 sigma of two satellite positions."""


@dataclass(frozen=True, slots=True)
class Hazard:
    """One obstacle ahead, from the server, from the own LiDAR, or from both.

    `centre_vehicle_m` is (3,) in the `vehicle` frame; `yaw_rad` is in the same frame. `distance_m` is along the way
    ahead, `beside_m` from it to the left, `beside_sd_m` the standard deviation of that; within `reach_m` to either side
    it is on the way.
    """

    kind: Kind
    stage: Stage
    distance_m: float
    arrival_s: float
    centre_vehicle_m: Vector
    length_m: float
    width_m: float
    yaw_rad: float
    beside_m: float
    beside_sd_m: float
    reach_m: float
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

    @property
    def keys(self) -> tuple[str, ...]:
        """Under which names its stage is remembered: the server's and the own one, since the two may part again."""
        names = (("obstacle", self.obstacle_id), ("track", self.track_id))
        return tuple(f"{name}-{number}" for name, number in names if number is not None)


@dataclass(frozen=True, slots=True)
class Alerts:
    """What the driver is to be shown now, nearest hazard first, and the memory for the next choice."""

    hazards: tuple[Hazard, ...] = ()
    chime: bool = False
    fresh: bool = True
    stages: Mapping[str, Stage] = field(default_factory=lambda: MappingProxyType({}))


def choose(
    previous: Alerts,
    known: ObstacleMap,
    tracks: Sequence[Track],
    pose: Pose,
    now_s: float,
    alignment: Alignment = UNALIGNED,
) -> Alerts:
    """Hazards ahead in the order of distance, each with its stage; one chime for each obstacle on entering WARN.

    The map is laid on what the car sees by `alignment`. What was passed or is gone is forgotten, so that a second
    approach warns again.
    """
    if pose.speed_mps < STANDSTILL_MPS:
        return Alerts(fresh=known.is_fresh(now_s), stages=previous.stages)
    stages: dict[str, Stage] = {}
    hazards: list[Hazard] = []
    chime = False
    for hazard in _not_passed(known, tracks, pose, alignment):
        before = max((previous.stages[k] for k in hazard.keys if k in previous.stages), default=None)
        is_on_way = _stays_on_way(hazard) if before is not None else _is_on_way(hazard)
        now = stage_at(hazard.distance_m, pose.speed_mps) if is_on_way else None
        stage = max((s for s in (before, now) if s is not None), default=None)
        if stage is None:
            continue
        stages.update(dict.fromkeys(hazard.keys, stage))
        if is_on_way:
            chime |= stage in CHIMING and stage != before
            hazards.append(replace(hazard, stage=stage))
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


def _is_on_way(hazard: Hazard) -> bool:
    sds = WIDE_SDS
    if hazard.obstacle_id is None:
        sds = float(np.interp(hazard.arrival_s, (AT_LATEST_S, SURE_BEFORE_S), (WIDE_SDS, -WIDE_SDS)))
    return abs(hazard.beside_m) < hazard.reach_m + sds * hazard.beside_sd_m


def _stays_on_way(hazard: Hazard) -> bool:
    # Also while it lies straight ahead: a bend ends.
    beside_m = min(abs(hazard.beside_m), abs(float(hazard.centre_vehicle_m[1])))
    return beside_m < hazard.reach_m + STAYS_M + WIDE_SDS * hazard.beside_sd_m


def _not_passed(known: ObstacleMap, tracks: Sequence[Track], pose: Pose, alignment: Alignment) -> list[Hazard]:
    vehicle_from_odom = inverse(pose.odom_from_vehicle)
    own = {t.track_id: (t, apply(vehicle_from_odom, t.centre_odom_m)) for t in tracks if t.confirmed and t.is_static}
    shift = vehicle_from_odom[:3, :3] @ np.array([*alignment.shift_m, 0.0])
    told = {i: (entry.feature, place_in_vehicle(entry.feature, pose) + shift) for i, entry in known.obstacles.items()}
    pairs = _one_to_one(told, own)
    hazards = []
    for obstacle_id, (feature, place) in told.items():
        kind, box = feature.properties.kind, feature.properties.box
        track_id = pairs.get(obstacle_id)
        if track_id is None:
            yaw = box.yaw_rad - (math.pi / 2 - pose.heading_rad)
            shape = (box.length_mm / 1000, box.width_mm / 1000, yaw % math.pi)
            place_sd_m = alignment.place_sd_m(stored_sd_m(feature), pose.sd_m)
            sd_m = math.hypot(place_sd_m, pose.heading_sd_rad * float(place[0]))
            hazards.append(_hazard(kind, place, shape, pose, sd_m, CORRIDOR_M, obstacle_id, None))
        else:
            track, centre = own.pop(track_id)
            hazards.append(_hazard(kind, centre, _shape(track, pose), pose, 0.0, CORRIDOR_M, obstacle_id, track_id))
    for track, centre in own.values():
        # What would be a post beside the lane (`vehicle_client.posts`) is no hazard unless it may stand in the lane.
        slender = is_slender(track.kind, track.length_m, track.width_m, track.relief_m)
        reach_m = POST_BESIDE_M if slender else CORRIDOR_M
        hazards.append(_hazard(Kind(track.kind), centre, _shape(track, pose), pose, 0.0, reach_m, None, track.track_id))
    return [h for h in hazards if h.distance_m > 0]


def _one_to_one(
    told: Mapping[UUID, tuple[ObstacleFeature, Vector]], own: Mapping[int, tuple[Track, Vector]]
) -> dict[UUID, int]:
    """Track of each obstacle that the own LiDAR sees too: the nearest pairs of one sign first."""
    distances = (
        (math.dist(place[:2], centre[:2]), obstacle_id, track_id)
        for obstacle_id, (feature, place) in told.items()
        for track_id, (track, centre) in own.items()
        if Kind(track.kind).sign is feature.properties.sign
    )
    pairs: dict[UUID, int] = {}
    for distance_m, obstacle_id, track_id in sorted(distances):
        if distance_m < OWN_GATE_M and obstacle_id not in pairs and track_id not in pairs.values():
            pairs[obstacle_id] = track_id
    return pairs


def _shape(track: Track, pose: Pose) -> tuple[float, float, float]:
    odom_yaw = math.atan2(pose.odom_from_vehicle[1, 0], pose.odom_from_vehicle[0, 0])
    return track.length_m, track.width_m, (track.yaw_rad - odom_yaw) % math.pi


def _hazard(
    kind: Kind,
    centre: Vector,
    shape: tuple[float, float, float],
    pose: Pose,
    beside_sd_m: float,
    reach_m: float,
    obstacle_id: UUID | None,
    track_id: int | None,
) -> Hazard:
    if obstacle_id is None:
        # The own LiDAR looks no farther than bends hold; what stands outside of one would lie straight ahead.
        way = along_bend(centre, pose.bend.curvature_per_m)
    else:
        way = on_way(centre, pose.bend.curvature_per_m)
    beside_sd_m = math.hypot(beside_sd_m, pose.bend.beside_sd_m(way.along_m))
    length_m, width_m, yaw_rad = shape
    return Hazard(
        kind,
        Stage.INFO,
        distance_m=way.along_m,
        arrival_s=way.along_m / pose.speed_mps,
        centre_vehicle_m=centre,
        length_m=length_m,
        width_m=width_m,
        yaw_rad=yaw_rad,
        beside_m=way.left_m,
        beside_sd_m=beside_sd_m,
        reach_m=reach_m,
        obstacle_id=obstacle_id,
        track_id=track_id,
    )
