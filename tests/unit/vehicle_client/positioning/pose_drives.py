"""Drives for the tests of the pose: straight, at 10 m/s, with the odometry and the fixes that a test asks for."""

from __future__ import annotations

import math

import numpy as np

from tests.unit.vehicle_client.making import NOON_S, ORIGIN, planar
from vehicle_client.frames import Matrix, inverse, yaw_from_heading
from vehicle_client.positioning.pose import (
    Pose,
    PoseFilter,
    PoseUpdate,
    update,
)
from vehicle_client.sources.frame import GnssFix, LidarFrame

RATE_HZ = 10
SPEED_MPS = 10.0
NO_POINTS = np.empty((0, 3), dtype=np.float32)
EAST = math.pi / 2


def fix_at(
    east_m: float, north_m: float, heading_rad: float | None, sd_m: float = 1.0, stamp_s: float | None = None
) -> GnssFix:
    position, altitude_m = ORIGIN.geodetic(np.array([east_m, north_m, 0.0]))
    heading = None if heading_rad is None else heading_rad % (2 * math.pi)
    return GnssFix(position, altitude_m, heading, sd_m, 2.0, stamp_s=stamp_s)


def frame_at(stamp_s: float, odom_from_vehicle: Matrix | None, fix: GnssFix | None) -> LidarFrame:
    return LidarFrame(stamp_s, NO_POINTS, odom_from_vehicle=odom_from_vehicle, gnss=fix, speed_mps=SPEED_MPS)


def along_x(
    count: int, *, first: int = 0, state: PoseFilter | None = None, north_m: float = 0.0, heading: float | None = EAST
) -> tuple[PoseFilter, PoseUpdate]:
    """A drive east at 10 m/s with perfect odometry and perfect fixes, `north_m` off."""
    state, found = PoseFilter() if state is None else state, PoseUpdate(None, None)
    for number in range(first, first + count):
        fix = fix_at(number, north_m, heading)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fix))
    return state, found


def without_fixes(state: PoseFilter, first: int, count: int) -> tuple[PoseFilter, PoseUpdate]:
    found = PoseUpdate(None, None)
    for number in range(first, first + count):
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), None))
    return state, found


def east_north_m(found: PoseUpdate) -> Matrix:
    assert found.pose is not None, found.reason
    return ORIGIN.enu(found.pose.position, found.pose.altitude_m)[:2]


def driven(
    heading_rad: float = 0.0,
    *,
    frames: int = 150,
    noise_m: float = 0.0,
    bias_m: tuple[float, float] = (0.0, 0.0),
    heading_noise_rad: float = 0.0,
    odom_yaw_rad: float = 0.4,
) -> Pose:
    """The last pose of a straight drive at 10 m/s from the origin; odometry has axes of its own."""
    random = np.random.default_rng(7)
    ahead = np.array([math.sin(heading_rad), math.cos(heading_rad)])
    enu_from_odom = planar(50.0, -20.0, odom_yaw_rad)
    state, pose = PoseFilter(), None
    for number in range(frames):
        east, north = ahead * number
        truth = planar(east, north, yaw_from_heading(heading_rad))
        noisy = np.array([east, north]) + random.normal(0, noise_m, 2) + bias_m
        fix = fix_at(noisy[0], noisy[1], heading_rad + random.normal(0, heading_noise_rad))
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, inverse(enu_from_odom) @ truth, fix))
        pose = found.pose
    assert pose is not None
    return pose


def error_m(pose: Pose, heading_rad: float, frames: int = 150) -> Matrix:
    """East and north error at the end of `driven`, on the ellipsoid."""
    east, north = (frames - 1) * math.sin(heading_rad), (frames - 1) * math.cos(heading_rad)
    return ORIGIN.enu(pose.position, pose.altitude_m)[:2] - [east, north]
