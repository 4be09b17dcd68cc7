"""What is known of the car: its place about an origin on the earth, its heading and its height, each with variances."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vehicle_client.frames import GeoOrigin, Vector, rotation_about_z, yaw_from_heading
from vehicle_client.positioning import height_filter, pose_filter
from vehicle_client.positioning.heading import StampDelay, YawMeasurement
from vehicle_client.positioning.height_filter import HeightFilter
from vehicle_client.positioning.odometry_history import OdometryHistory, PlanarPose, in_axes_of, turn_between
from vehicle_client.positioning.pose_filter import DELAY, YAW, Expectation, PlaceMeasurement, PlaneFilter
from vehicle_client.positioning.speed_scale import ScaleMeasurement
from vehicle_client.sources.frame import GnssFix

ANCHOR_M = 1_000.0
"""Distance after which the origin follows the car: north turns by 0.3 mrad over it at 60 degrees of latitude, which
displaces a pose by centimetres; over 50 km it would be by 2 m."""

LARGEST_SCALE = 0.1
"""Worn, other or flat tyres change a wheel's way by some percent; slipping ones by more, and not for long."""

LEAST_SD_M = 0.01
"""Of an altitude or of a stated place: no variance may be zero."""


@dataclass(frozen=True, slots=True)
class CarEstimate:
    """The filters, and the origin of the `enu` frame that they are in."""

    origin: GeoOrigin
    plane: PlaneFilter
    height: HeightFilter

    @property
    def place_m(self) -> Vector:
        """East, north, up of the vehicle frame's origin, (3,)."""
        return np.array([*self.plane.state[:2], self.height.height_m])

    @property
    def yaw_rad(self) -> float:
        """Counter-clockwise from east."""
        return float(self.plane.state[YAW])

    @property
    def delay(self) -> StampDelay:
        """How late fixes are stamped."""
        variance = float(self.plane.state_covariance[DELAY, DELAY])
        return StampDelay(float(self.plane.state[DELAY]), math.sqrt(variance))


def begun(
    fix: GnssFix, at: PlanarPose, history: OdometryHistory, yaw: YawMeasurement, antenna_m: Vector, delay_sd_s: float
) -> CarEstimate:
    """The car now, from a fix of its antenna (3,) at an earlier moment and the yaw now.

    `delay_sd_s` is how well the moments of fixes are known.
    """
    origin = GeoOrigin(fix.position, fix.altitude_m)
    up_m = float(history.poses[-1].place_m[2] - at.place_m[2] - antenna_m[2])
    return CarEstimate(
        origin,
        pose_filter.started(
            _measured_place(origin, fix, at, history, antenna_m), yaw.yaw_rad, yaw.sd_rad, delay_sd_s=delay_sd_s
        ),
        height_filter.started(up_m, max(fix.altitude_sd_m, LEAST_SD_M)),
    )


def begun_at_stated_place(origin: GeoOrigin, heading_rad: float) -> CarEstimate:
    """The car at a place and heading that somebody says."""
    here = PlaceMeasurement(np.zeros(2), LEAST_SD_M, np.zeros(2), np.zeros(2), np.zeros(2))
    plane = pose_filter.started(here, yaw_from_heading(heading_rad), 0.0)
    return CarEstimate(origin, plane, height_filter.started(0.0, LEAST_SD_M))


def moved(estimate: CarEstimate, before: PlanarPose, now: PlanarPose) -> CarEstimate:
    """After what odometry says happened between two moments."""
    elapsed_s = max(0.0, now.stamp_s - before.stamp_s)
    offset = now.place_m - before.place_m
    step = in_axes_of(before, offset)
    plane = pose_filter.advanced(estimate.plane, step, turn_between(before, now), elapsed_s)
    height = height_filter.advanced(estimate.height, float(offset[2]), float(np.hypot(*step)), elapsed_s)
    return replace(estimate, plane=plane, height=height)


def anchored(estimate: CarEstimate) -> CarEstimate:
    """The same about an origin at the car, when that has gone far from the old one."""
    place_m = estimate.place_m
    if np.linalg.norm(place_m) < ANCHOR_M:
        return estimate
    here = GeoOrigin(*estimate.origin.geodetic(place_m))
    plane_mean, height_mean = estimate.plane.mean.copy(), estimate.height.mean.copy()
    plane_mean[:, :2] -= place_m[:2]
    height_mean[0] = 0.0
    return CarEstimate(here, replace(estimate.plane, mean=plane_mean), replace(estimate.height, mean=height_mean))


def expectation(
    estimate: CarEstimate, fix: GnssFix, at: PlanarPose, history: OdometryHistory, antenna_m: Vector
) -> Expectation:
    """What is expected of a fix of the antenna (3,) at an earlier moment."""
    return pose_filter.expectation(estimate.plane, _measured_place(estimate.origin, fix, at, history, antenna_m))


def _measured_place(
    origin: GeoOrigin, fix: GnssFix, at: PlanarPose, history: OdometryHistory, antenna_m: Vector
) -> PlaceMeasurement:
    now = history.poses[-1]
    return PlaceMeasurement(
        place_m=origin.enu(fix.position, fix.altitude_m)[:2],
        sd_m=fix.sd_m,
        antenna_m=(rotation_about_z(at.yaw_rad - now.yaw_rad) @ antenna_m)[:2],
        behind_m=in_axes_of(now, now.place_m - at.place_m),
        velocity_mps=in_axes_of(now, history.velocity_mps),
    )


def with_place(estimate: CarEstimate, expected: Expectation, elapsed_s: float) -> CarEstimate:
    """After a fix that is believed, `elapsed_s` after the one before."""
    return replace(estimate, plane=pose_filter.with_place(estimate.plane, expected, elapsed_s))


def jumped(estimate: CarEstimate, to: Expectation) -> CarEstimate:
    """At another place, that of a fix which many others agree on."""
    return replace(estimate, plane=pose_filter.moved_to(estimate.plane, to.fix))


def with_yaw(estimate: CarEstimate, yaw: YawMeasurement) -> CarEstimate:
    """After a measured yaw."""
    return replace(estimate, plane=pose_filter.with_yaw(estimate.plane, yaw.yaw_rad, yaw.sd_rad))


def with_scale(estimate: CarEstimate, scale: ScaleMeasurement) -> CarEstimate:
    """After a measurement of odometry's scale; one that no tyre explains is left out."""
    if abs(scale.scale) > LARGEST_SCALE:
        return estimate
    return replace(estimate, plane=pose_filter.with_scale(estimate.plane, scale.scale, scale.sd))


def with_altitude(
    estimate: CarEstimate, fix: GnssFix, at: PlanarPose, now: PlanarPose, antenna_m: Vector
) -> CarEstimate:
    """After the altitude of a fix."""
    up_m = estimate.origin.enu(fix.position, fix.altitude_m)[2] - antenna_m[2] + now.place_m[2] - at.place_m[2]
    sd_m = max(fix.altitude_sd_m, LEAST_SD_M)
    return replace(estimate, height=height_filter.with_altitude(estimate.height, float(up_m), sd_m))
