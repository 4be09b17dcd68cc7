"""What a fix says of the car's heading: said itself, the course over ground, or the way between two fixes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vehicle_client.frames import GeoOrigin, yaw_from_heading
from vehicle_client.positioning.odometry_history import OdometryHistory, PlanarPose, in_axes_of, turn_between
from vehicle_client.sources.frame import GnssFix

SMOOTHED_S = 1.0
"""Receivers and compasses smooth over about a second: what they say more often counts for less each time."""

HEADING_SD_RAD = math.radians(1.0)
"""Two antennas half a metre apart state 0.3 to 0.8 degrees; a calibrated compass reaches 1 to 2."""

COURSE_FROM_MPS = 2.0
"""Below it, a velocity's error of some cm/s is degrees, and receivers hold the last course."""

VELOCITY_SD_MPS = 0.074
"""Across the way, from Doppler: u-blox M8's data sheet says that half of all velocities err by less than 0.05 m/s (at
30 m/s), which makes 0.074 m/s one standard deviation."""

VELOCITY_LAG_S = 0.1
"""In a curve, a smoothed course is late by about one fix."""

MOTION_S = 0.3
"""Odometry's direction of motion is taken over this time before the fix."""

LEAST_MOTION_M = 0.2
"""Shorter than this, the direction of a motion is odometry's noise."""

TRACK_S = 120.0
"""Longer than this between two fixes, and odometry's own turn spoils the heading between them."""


@dataclass(frozen=True, slots=True)
class YawMeasurement:
    """Yaw of the car now, counter-clockwise from east, with its standard deviation."""

    yaw_rad: float
    sd_rad: float


@dataclass(frozen=True, slots=True)
class StampDelay:
    """How long after their moment fixes are stamped, with its standard deviation."""

    delay_s: float
    sd_s: float


def measured_yaw(
    fix: GnssFix, at: PlanarPose, history: OdometryHistory, last_s: float, late: StampDelay
) -> YawMeasurement | None:
    """What a fix says itself, carried to now by odometry; None if nothing, or if a later one spoke at `last_s`.

    A course is `late` and the car has turned on since; a heading comes from another device.
    """
    if at.stamp_s <= last_s:
        return None
    turned = history.poses[-1].yaw_rad - at.yaw_rad
    smoothed = repeated(at.stamp_s - last_s)
    if fix.heading_rad is not None and math.isfinite(fix.heading_rad):
        return YawMeasurement(yaw_from_heading(fix.heading_rad) + turned, smoothed * HEADING_SD_RAD)
    course = _course(fix)
    before = history.at(at.stamp_s - MOTION_S)
    if course is None or before is None:
        return None
    moved = in_axes_of(before, at.place_m - before.place_m)
    turning = turn_between(before, at)
    if np.hypot(*moved) < LEAST_MOTION_M:
        return None
    # The chord of an arc points where the car does half-way; going backwards it points behind.
    slip = math.atan2(moved[1], moved[0]) - turning / 2
    rate_rps = turning / MOTION_S
    sd_rad = math.hypot(VELOCITY_SD_MPS / course.speed_mps, math.hypot(VELOCITY_LAG_S, late.sd_s) * rate_rps)
    return YawMeasurement(course.yaw_rad - slip + turned + late.delay_s * rate_rps, smoothed * sd_rad)


def repeated(elapsed_s: float) -> float:
    """Factor on a deviation, so that readings so far apart together say as much as one in `SMOOTHED_S`."""
    return math.sqrt(SMOOTHED_S / min(max(elapsed_s, 0.01), SMOOTHED_S))


@dataclass(frozen=True, slots=True)
class _Course:
    yaw_rad: float
    speed_mps: float


def _course(fix: GnssFix) -> _Course | None:
    course, speed = fix.course_rad, fix.speed_mps
    if course is None or speed is None or not (math.isfinite(course) and COURSE_FROM_MPS <= speed < math.inf):
        return None
    return _Course(yaw_from_heading(course), speed)


@dataclass(frozen=True, slots=True)
class FirstFix:
    """A fix and where odometry was, while the heading is not known yet."""

    fix: GnssFix
    at: PlanarPose

    def is_near(self, at: PlanarPose) -> bool:
        """Whether odometry has hardly drifted since."""
        return at.stamp_s - self.at.stamp_s < TRACK_S


def yaw_of_track(first: FirstFix, fix: GnssFix, at: PlanarPose, now: PlanarPose) -> YawMeasurement | None:
    """Yaw now from the way between two fixes against odometry's between their moments; None if the car stood."""
    way_enu_m = GeoOrigin(first.fix.position, first.fix.altitude_m).enu(fix.position, fix.altitude_m)
    way_odom_m = at.place_m - first.at.place_m
    way_m = float(np.hypot(*way_odom_m[:2]))
    if way_m == 0:
        return None
    turn = math.atan2(way_enu_m[1], way_enu_m[0]) - math.atan2(way_odom_m[1], way_odom_m[0])
    return YawMeasurement(now.yaw_rad + turn, math.hypot(first.fix.sd_m, fix.sd_m) / way_m)
