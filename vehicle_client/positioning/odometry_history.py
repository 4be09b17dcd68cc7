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

BEND_S = 0.5
"""Sweeps enough that a yaw's noise of 0.1 degrees is no bend, and half a second before the car is out of one."""

LEAST_WAY_M = 1.0
"""Over less the noise of a yaw is a bend."""

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
    def bend(self) -> Bend:
        """Of the last `BEND_S`; what it was over all that is remembered tells how fast it changes."""
        now = self._curvature_per_m(BEND_S)
        return Bend(now, abs(now - self._curvature_per_m(REMEMBERED_S)) / 2)

    def _curvature_per_m(self, last_s: float) -> float:
        """Of the way of the last seconds, positive to the left; 0 while the car hardly moves."""
        since_s = self.poses[-1].stamp_s - last_s if self.poses else 0.0
        steps = [(one, other) for one, other in pairwise(self.poses) if other.stamp_s > since_s]
        # Backwards counts as less than nothing: the bend ahead is the same.
        way_m = sum(float(in_axes_of(one, other.place_m - one.place_m)[0]) for one, other in steps)
        if abs(way_m) < LEAST_WAY_M:
            return 0.0
        turned_rad = sum(turn_between(one, other) for one, other in steps)
        return max(-TIGHTEST_PER_M, min(turned_rad / way_m, TIGHTEST_PER_M))

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
