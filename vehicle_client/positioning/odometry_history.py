"""Where odometry was during the last seconds: fixes and pictures come with stamps of their own."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vehicle_client.frames import Matrix, Vector, yaw_of
from vehicle_client.way_ahead import Bend

REMEMBERED_S = 1.5
"""Receivers and serial lines deliver within a second; what is older comes from a clock that is off."""

ODOMETRY_GAP_S = 1.5
"""After a longer silence nobody knows the way since: a car that brakes is metres from where its last speed leads."""

IMPOSSIBLE_MPS, LEAST_STEP_S = 100.0, 0.2
"""Odometry that moves faster has begun anew; stamps of neighbouring poses err by up to a sweep or two."""

MOST_POSES = 256
"""More than 1.5 s of a sensor at 100 Hz."""

BEND_S, BEND_WAY_M = 0.5, 3.0
"""A bend is measured over so long, and over so much way where that takes longer: late where a bend ends, but over less
the noise of a yaw is a bend."""

YAW_SD_RAD = math.radians(0.1)
"""Noise of a yaw from sweep to sweep, of scan matching or of a gyro."""

UNSURE_SHARE = 0.15
"""Bends end: of a curvature so much is unsure, also where it has been the same for a while. Between 0.1 and 0.25 it
makes little difference on the drives of `headsup evaluate warned`."""

TIGHTEST_PER_M = 1 / 5
"""No car turns in less than a circle of 10 m."""


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """A car in `odom`, at a moment: place (3,), yaw counter-clockwise from x."""

    stamp_s: float
    place_m: Vector
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class OdometryHistory:
    """Poses in the order of time, the last `REMEMBERED_S` of them."""

    poses: tuple[PlanarPose, ...] = ()

    def with_pose(self, stamp_s: float, odom_from_vehicle: Matrix) -> OdometryHistory:
        """The history with the pose of a later moment; one that is not later (a clock was set back) begins it anew."""
        pose = PlanarPose(stamp_s, odom_from_vehicle[:3, 3].copy(), yaw_of(odom_from_vehicle))
        if self.poses and stamp_s <= self.poses[-1].stamp_s:
            return OdometryHistory((pose,))
        kept = tuple(p for p in self.poses if p.stamp_s >= stamp_s - REMEMBERED_S)
        return OdometryHistory((*kept[-MOST_POSES:], pose))

    @property
    def velocity_mps(self) -> Vector:
        """Velocity (3,) in `odom` between the last two poses; 0 while there is one."""
        if len(self.poses) < 2:
            return np.zeros(3)
        before, now = self.poses[-2:]
        return (now.place_m - before.place_m) / (now.stamp_s - before.stamp_s)

    @property
    def speed_mps(self) -> float:
        """Speed between the last two poses, below 0 backwards."""
        velocity_mps = self.velocity_mps
        ahead_mps = in_axes_of(self.poses[-1], velocity_mps)[0] if self.poses else 0.0
        return math.copysign(float(np.linalg.norm(velocity_mps)), ahead_mps)

    @property
    def bend(self) -> Bend:
        """Of the last half second; what it was over all that is remembered tells how fast it changes."""
        now, way_m = self._curvature_per_m(BEND_S)
        if way_m == 0:
            return Bend()
        before, _ = self._curvature_per_m(REMEMBERED_S)
        return Bend(now, math.hypot((now - before) / 2, math.sqrt(2) * YAW_SD_RAD / way_m, UNSURE_SHARE * now))

    def _curvature_per_m(self, last_s: float) -> tuple[float, float]:
        """Of the last seconds and `BEND_WAY_M` at least, positive to the left, and the way; 0 while there is less."""
        way_m, turned_rad = 0.0, 0.0
        for other, one in pairwise(reversed(self.poses)):
            # Backwards counts as less than nothing: the bend ahead is the same.
            way_m += float(in_axes_of(one, other.place_m - one.place_m)[0])
            turned_rad += turn_between(one, other)
            if self.poses[-1].stamp_s - one.stamp_s >= last_s and abs(way_m) >= BEND_WAY_M:
                break
        if abs(way_m) < BEND_WAY_M:
            return 0.0, 0.0
        return max(-TIGHTEST_PER_M, min(turned_rad / way_m, TIGHTEST_PER_M)), abs(way_m)

    def at(self, stamp_s: float) -> PlanarPose | None:
        """The pose at a moment between the first and the last, by straight lines; None outside."""
        stamps = [p.stamp_s for p in self.poses]
        after = bisect.bisect_left(stamps, stamp_s)
        if not stamps or after == len(stamps) or stamp_s < stamps[0]:
            return None
        if stamps[after] == stamp_s:
            return self.poses[after]
        return between(self.poses[after - 1], self.poses[after], stamp_s)


def has_begun_anew(moved_m: float, elapsed_s: float) -> bool:
    """Whether a step of odometry is one that no car makes."""
    return moved_m > IMPOSSIBLE_MPS * max(elapsed_s, LEAST_STEP_S)


def between(one: PlanarPose, other: PlanarPose, stamp_s: float) -> PlanarPose:
    """The pose at a moment on the straight line through two, also beyond them."""
    share = (stamp_s - one.stamp_s) / (other.stamp_s - one.stamp_s)
    turn = turn_between(one, other)
    return PlanarPose(stamp_s, one.place_m + share * (other.place_m - one.place_m), one.yaw_rad + share * turn)


def turn_between(one: PlanarPose, other: PlanarPose) -> float:
    """Radians counter-clockwise from one pose to the other, the short way."""
    return math.remainder(other.yaw_rad - one.yaw_rad, 2 * math.pi)


def in_axes_of(pose: PlanarPose, offset_m: Vector) -> Vector:
    """An offset in the plane of `odom`, (2,) or more, in the axes of the car at a pose, (2,)."""
    cos, sin = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return np.array([cos * offset_m[0] + sin * offset_m[1], -sin * offset_m[0] + cos * offset_m[1]])
