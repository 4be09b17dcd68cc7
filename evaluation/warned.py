"""How early a driver is warned of what lies on a way that bends, and of what lies on other streets.

Drives with known paths carry obstacles all along; the client has heard of all of them, knows where it is by its own
pose, and warns. It does not know the way: an obstacle behind the next corner is nobody's before the car turns.
"""

from __future__ import annotations

from collections.abc import Callable
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
from evaluation.pose_drives import PoseDrive
from vehicle_client.alerts import Alerts, Stage, choose
from vehicle_client.obstacle_map import KnownObstacle, ObstacleMap
from vehicle_client.positioning.odometry import Given, Tracker, Wheels
from vehicle_client.positioning.pose import Pose, PoseFilter, update
from vehicle_client.sensing.calibration import WHEELBASE_M
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
    """What a driver is told along a drive, of obstacles that a seed puts on it."""
    obstacles = _obstacles(drive, np.random.default_rng([seed, 53]))
    times_s = np.array([frame.stamp_s for frame in drive.frames])
    first_s = np.full(len(obstacles.passed_s), np.inf)
    last_wrong_s = np.full(len(obstacles.passed_s), -np.inf)
    wrong, alerts, state = 0, Alerts(), PoseFilter(delay_sd_s=drive.delay_sd_s)
    tracker: Tracker = Wheels(WHEELBASE_M) if drive.frames[0].odom_from_vehicle is None else Given()
    for number, frame in enumerate(drive.frames):
        state, found = update(state, replace(frame, odom_from_vehicle=tracker.odom_from_vehicle(frame)))
        if found.pose is None:
            alerts = Alerts()
            continue
        now_s, here_m = frame.stamp_s, drive.place_m[number]
        known = obstacles.heard_at(here_m, now_s)
        alerts = choose(alerts, known, (), way(found.pose), now_s)
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
    steps_m = np.diff(drive.place_m, axis=0)
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(*steps_m.T))])
    at_m = np.arange(SPACING_M, way_m[-1] - SPACING_M, SPACING_M)
    # While the car stands its way does not grow: the moment that it comes to a place is the first.
    moving = np.concatenate([[True], np.diff(way_m) > 0])
    times_s = np.array([frame.stamp_s for frame in drive.frames])[moving]
    middle, yaw = (
        np.stack([np.interp(at_m, way_m[moving], values[moving]) for values in columns], axis=-1)
        for columns in (drive.place_m.T, [np.unwrap(drive.yaw_rad)])
    )
    left = np.concatenate([-np.sin(yaw), np.cos(yaw)], axis=1)
    place_m = middle + left * rng.uniform(-BESIDE_M, BESIDE_M, (len(at_m), 1))
    said_m = place_m + rng.normal(0.0, PLACE_SD_M, place_m.shape)
    told = tuple(KnownObstacle(_feature(drive, k, east_north), 0.0) for k, east_north in enumerate(said_m))
    return _Obstacles(place_m, np.interp(at_m, way_m[moving], times_s), told)


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
