"""How early a driver is warned of what lies on a way that bends, and of what lies on other streets.

Drives with known paths carry obstacles all along; the client has heard of all of them, or has heard of none and sees
them by its own LiDAR, knows where it is by its own pose, and warns. It does not know the way: an obstacle behind the
next corner is nobody's before the car turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from types import MappingProxyType
from uuid import UUID

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from contract.geometry import Box, BoxSd, Kind, PlaneCovariance
from contract.observation import State
from contract.obstacle import ObstacleFeature, ObstacleProperties, PointGeometry
from detector.types import ObstacleKind
from evaluation.pose_drives import PoseDrive
from vehicle_client.alerts import Alerts, Stage, choose
from vehicle_client.frames import apply
from vehicle_client.obstacle_map import KnownObstacle, ObstacleMap
from vehicle_client.positioning.odometry import Given, Tracker, Wheels
from vehicle_client.positioning.pose import Pose, PoseFilter, update
from vehicle_client.sensing.calibration import WHEELBASE_M
from vehicle_client.tracking import CONFIRMED_AFTER, Track
from vehicle_client.way_ahead import Bend

FloatArray = NDArray[np.float64]

SPACING_M = 20.0
"""From one obstacle to the next: each in a place of its own, as many as a drive holds."""

BESIDE_M = 1.0
"""They lie so far to either side of the car's own line, uniformly."""

PLACE_SD_M = 0.5
"""What the server's places are wrong by, and say so, along either axis."""

PASSED_WITHIN_M, SOON_S = 6.0, 40.0
"""A warning is right if the car then comes so near within so long: its own lane and the one beside it."""

AGAIN_AFTER_S = 20.0
"""A warning of the same place counts anew after so long without."""

HEARD_WITHIN_M = 450.0
"""Beyond that nobody is warned of anything."""

SEEN_FROM_M, SEEN_WITHIN_RAD = 25.0, math.radians(80)
"""Where the own LiDAR sees what lies on a road: so far away, and no farther beside its forward axis."""

THINGS_EVERY_M = 10.0
"""Along the way each carries one thing in the lane and one beside it, for the own LiDAR."""

NEXT_TO_M, NEVER_NEARER_M = (4.0, 8.0), 3.5
"""How far to either side, uniformly, the things beside lie: from the middle of the next lane to the far pavement. Those
that the car comes nearer to at another time of its drive are left out."""

FLICKER_S = 0.5
"""A marker shown for less is gone before anybody understood it."""

Way = Callable[[Pose], Pose]
"""What of a pose the choice of warnings gets to see."""


def as_driven(pose: Pose) -> Pose:
    """All of it."""
    return pose


def straight_ahead(pose: Pose) -> Pose:
    """Without the bend: a strip straight ahead, which most warners take."""
    return replace(pose, bend=Bend())


@dataclass(frozen=True, slots=True)
class Warned:
    """Of the obstacles of a drive, the seconds (K,) from the first warning to the passing, 0 without one; how often the
    driver was warned of what the car did not come to; and the way driven."""

    ahead_s: FloatArray
    wrong: int
    metres: float


def warned(drive: PoseDrive, way: Way, seed: int) -> Warned:
    """What a driver is told along a drive, of obstacles that a seed puts on it and the server knows."""
    obstacles = _obstacles(drive, np.random.default_rng([seed, 53]))
    times_s = np.array([frame.stamp_s for frame in drive.frames])
    first_s = np.full(len(obstacles.passed_s), np.inf)
    last_wrong_s = np.full(len(obstacles.passed_s), -np.inf)
    wrong, alerts = 0, Alerts()
    for number, pose in _poses(drive):
        if pose is None:
            alerts = Alerts()
            continue
        now_s = times_s[number]
        alerts = choose(alerts, obstacles.heard_at(drive.place_m[number], now_s), (), way(pose), now_s)
        shown = [h.obstacle_id.int for h in alerts.hazards if h.obstacle_id is not None and h.stage >= Stage.WARN]
        if not shown:
            continue
        soon = drive.place_m[number : int(np.searchsorted(times_s, now_s + SOON_S))]
        distance_m, _ = KDTree(soon).query(obstacles.place_m[shown])
        for which, comes_to_m in zip(shown, np.asarray(distance_m), strict=True):
            if comes_to_m > PASSED_WITHIN_M:
                wrong += int(now_s - last_wrong_s[which] > AGAIN_AFTER_S)
                last_wrong_s[which] = now_s
            elif 0 <= obstacles.passed_s[which] - now_s < SOON_S:
                first_s[which] = min(first_s[which], now_s)
    ahead_s = np.where(np.isfinite(first_s), obstacles.passed_s - first_s, 0.0)
    return Warned(ahead_s, wrong, float(np.hypot(*np.diff(drive.place_m, axis=0).T).sum()))


@dataclass(frozen=True, slots=True)
class OwnWarned:
    """Of what only the own LiDAR sees: the seconds from the first warning to the passing, 0 without one, of things in
    the lane (K,) and of things beside it (B,); the seconds from when each in the lane was first believed (K,); and how
    many markers were shown for less than `FLICKER_S`."""

    ahead_s: FloatArray
    believed_s: FloatArray
    beside_ahead_s: FloatArray
    flickers: int


def warned_by_own(drive: PoseDrive, way: Way, seed: int) -> OwnWarned:
    """What a driver is told along a drive of things in the lane and beside it, of which the server knows nothing."""
    things = _things(drive, np.random.default_rng([seed, 59]))
    sightings = np.zeros(len(things.passed_s), dtype=int)
    believed_s, first_s = np.full(len(sightings), np.inf), np.full(len(sightings), np.inf)
    shown_since_s: dict[int, float] = {}
    flickers, alerts = 0, Alerts()
    for number, pose in _poses(drive):
        now_s = drive.frames[number].stamp_s
        place_m, is_seen = things.seen_from(drive.place_m[number], float(drive.yaw_rad[number]))
        sightings += is_seen
        if pose is None:
            alerts = Alerts()
            continue
        # Passed in this round: what a car sees again ten minutes later is another matter.
        is_coming = (now_s <= things.passed_s) & (things.passed_s - now_s < SOON_S)
        (seen,) = np.nonzero(is_seen & is_coming & (sightings >= CONFIRMED_AFTER))
        believed_s[seen] = np.minimum(believed_s[seen], now_s)
        centres = apply(pose.odom_from_vehicle, np.column_stack([place_m[seen], np.zeros(len(seen))]))
        tracks = [_track(int(k), centre) for k, centre in zip(seen, centres, strict=True)]
        alerts = choose(alerts, ObstacleMap(heard_s=now_s), tracks, way(pose), now_s)
        shown = {h.track_id for h in alerts.hazards if h.track_id is not None and h.stage >= Stage.WARN}
        for which in shown_since_s.keys() - shown:
            flickers += now_s - shown_since_s.pop(which) < FLICKER_S and which in seen
        for which in shown:
            shown_since_s.setdefault(which, now_s)
            first_s[which] = min(first_s[which], now_s)
    was_seen = np.isfinite(believed_s)
    ahead_s = np.where(np.isfinite(first_s), things.passed_s - first_s, 0.0)
    in_lane, beside = was_seen & things.in_lane, was_seen & ~things.in_lane
    return OwnWarned(ahead_s[in_lane], (things.passed_s - believed_s)[in_lane], ahead_s[beside], flickers)


def _poses(drive: PoseDrive) -> Iterator[tuple[int, Pose | None]]:
    """Number of each frame, and the car's own pose at it."""
    state = PoseFilter(delay_sd_s=drive.delay_sd_s)
    tracker: Tracker = Wheels(WHEELBASE_M) if drive.frames[0].odom_from_vehicle is None else Given()
    for number, frame in enumerate(drive.frames):
        state, found = update(state, replace(frame, odom_from_vehicle=tracker.odom_from_vehicle(frame)))
        yield number, found.pose


@dataclass(frozen=True, slots=True)
class _Obstacles:
    """Places (K, 2) east and north of the drive's origin, when the car passes them (K,), and what the server says."""

    place_m: FloatArray
    passed_s: FloatArray
    told: tuple[KnownObstacle, ...]

    def heard_at(self, here_m: FloatArray, now_s: float) -> ObstacleMap:
        """The map of a car that has just heard of all that is near."""
        (near,) = np.nonzero(np.linalg.norm(self.place_m - here_m, axis=1) < HEARD_WITHIN_M)
        heard = {self.told[k].feature.id: self.told[k] for k in near}
        return ObstacleMap(MappingProxyType(heard), heard_s=now_s)


def _obstacles(drive: PoseDrive, rng: np.random.Generator) -> _Obstacles:
    """Obstacles all along a drive, but for its ends: the first has a place before it, the last is passed."""
    way = _along(drive, SPACING_M)
    place_m = way.beside(rng.uniform(-BESIDE_M, BESIDE_M, len(way.passed_s)))
    said_m = place_m + rng.normal(0.0, PLACE_SD_M, place_m.shape)
    told = tuple(KnownObstacle(_feature(drive, k, east_north), 0.0) for k, east_north in enumerate(said_m))
    return _Obstacles(place_m, way.passed_s, told)


@dataclass(frozen=True, slots=True)
class _Things:
    """Places (K, 2) east and north of the drive's origin, when the car passes them (K,), and which lie in its lane."""

    place_m: FloatArray
    passed_s: FloatArray
    in_lane: NDArray[np.bool_]

    def seen_from(self, here_m: FloatArray, yaw_rad: float) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Their places (K, 2) in the `vehicle` frame, and which of them its LiDAR sees."""
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        place_m = (self.place_m - here_m) @ np.array([[cos, -sin], [sin, cos]])
        is_ahead = np.abs(np.arctan2(place_m[:, 1], place_m[:, 0])) < SEEN_WITHIN_RAD
        return place_m, is_ahead & (np.hypot(*place_m.T) < SEEN_FROM_M)


def _things(drive: PoseDrive, rng: np.random.Generator) -> _Things:
    way = _along(drive, THINGS_EVERY_M)
    number = len(way.passed_s)
    in_lane = way.beside(rng.uniform(-BESIDE_M, BESIDE_M, number))
    beside = way.beside(rng.uniform(*NEXT_TO_M, number) * rng.choice([-1.0, 1.0], number))
    nearest_m, _ = KDTree(drive.place_m).query(beside)
    left = np.asarray(nearest_m) > NEVER_NEARER_M
    return _Things(
        np.concatenate([in_lane, beside[left]]),
        np.concatenate([way.passed_s, way.passed_s[left]]),
        np.arange(number + int(left.sum())) < number,
    )


@dataclass(frozen=True, slots=True)
class _Along:
    """Points (K, 2) of the car's own line, the unit vectors (K, 2) to its left there, and when it comes by (K,)."""

    middle_m: FloatArray
    left: FloatArray
    passed_s: FloatArray

    def beside(self, left_m: FloatArray) -> FloatArray:
        """Places (K, 2) so far to the left (K,)."""
        return self.middle_m + self.left * left_m[:, None]


def _along(drive: PoseDrive, every_m: float) -> _Along:
    """Evenly along a drive, without its ends."""
    steps_m = np.diff(drive.place_m, axis=0)
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*steps_m.T))])
    at_m = np.arange(SPACING_M, way_m[-1] - SPACING_M, every_m)
    # While the car stands its way does not grow: the moment that it comes to a place is the first.
    moving = np.concatenate([[True], np.diff(way_m) > 0])
    times_s = np.array([frame.stamp_s for frame in drive.frames])[moving]
    middle, yaw = (
        np.stack([np.interp(at_m, way_m[moving], values[moving]) for values in columns], axis=-1)
        for columns in (drive.place_m.T, [np.unwrap(drive.yaw_rad)])
    )
    left = np.concatenate([-np.sin(yaw), np.cos(yaw)], axis=1)
    return _Along(middle, left, np.interp(at_m, way_m[moving], times_s))


def _track(number: int, centre_odom_m: FloatArray) -> Track:
    """A hole as the tracking believes in it."""
    return Track(
        track_id=number,
        centre_odom_m=centre_odom_m,
        is_negative=ObstacleKind.POTHOLE.is_negative,
        bump_votes=0,
        debris_votes=0,
        length_m=0.9,
        width_m=0.7,
        relief_m=0.1,
        yaw_rad=0.0,
        sightings=CONFIRMED_AFTER,
        first_stamp_s=0.0,
        first_range_m=SEEN_FROM_M,
        last_stamp_s=0.0,
        looks=CONFIRMED_AFTER,
        was_ahead=True,
        first_m=(centre_odom_m[:2],),
        latest_m=(centre_odom_m[:2],),
    )


def _feature(drive: PoseDrive, number: int, east_north_m: FloatArray) -> ObstacleFeature:
    position, altitude_m = drive.origin.geodetic(np.array([*east_north_m, 0.0]))
    seen = datetime(2026, 1, 1, tzinfo=UTC)
    properties = ObstacleProperties(
        kind=Kind.POTHOLE,
        sign=Kind.POTHOLE.sign,
        state=State.CONFIRMED,
        version=1,
        revision=1,
        box=Box(length_mm=900, width_mm=700, yaw_rad=0.0, relief_mm=100),
        box_sd=BoxSd(ln_length=0.05, ln_width=0.05, ln_area=0.07, relief_mm=5),
        volume_m3=0.03,
        position_covariance=PlaneCovariance(east_m2=PLACE_SD_M**2, north_m2=PLACE_SD_M**2),
        altitude_m=altitude_m,
        confidence=0.9,
        as_of=seen,
        half_life_s=2_592_000.0,
        expires_at=seen + timedelta(days=60),
        first_seen=seen,
        last_seen=seen,
        sightings=3,
        witnesses=2,
    )
    return ObstacleFeature(id=UUID(int=number), geometry=PointGeometry.at(position), properties=properties)
