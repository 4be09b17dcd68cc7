"""What a bag states of how far its measurements may be off, row-major as ROS messages carry it."""

from __future__ import annotations

import math

import numpy as np

from vehicle_client.frames import Matrix, Vector
from vehicle_client.positioning.height_filter import GRADE_SD
from vehicle_client.positioning.pose_filter import SCALE_SD, TURN_SD_RAD_PER_M, WAY_SD_M, YAW_SD_RAD

HEADING_SD_RAD = math.radians(0.3)
"""What is stated of a heading: antennas 2 m apart, or a good inertial unit."""

NOT_MEASURED = 1e6
"""Variance of what odometry does not measure: zero would be read as exact, and nav_msgs has no word for it, so that
drivers state a variance of this size."""


def unsaid() -> Vector:
    """Of a quantity that the unit says nothing of (9,): -1 in the first element, sensor_msgs/Imu."""
    covariance = np.zeros(9)
    covariance[0] = -1.0
    return covariance


def of_heading() -> Vector:
    """Of an orientation of which only the heading is known (9,); the road is taken to be level."""
    return np.diag([GRADE_SD, GRADE_SD, HEADING_SD_RAD]).ravel() ** 2


def of_odometry(odom_from_vehicle: Matrix, way_m: float) -> Vector:
    """Of a pose after so long a way (36,), by what the vehicle's own filter takes odometry to err by.

    A scale that is wrong errs along the line from the begin; a constant turn across it, by half of what it has turned.
    """
    x, y, z = odom_from_vehicle[:3, 3]
    by_scale = SCALE_SD * np.array([x, y, z, 0.0, 0.0, 0.0])
    by_turn = TURN_SD_RAD_PER_M * way_m * np.array([-y / 2, x / 2, 0.0, 0.0, 0.0, 1.0])
    # At the begin as after a metre: no sensor is exact.
    noise = np.diag([WAY_SD_M] * 3 + [YAW_SD_RAD] * 3) ** 2 * max(1.0, way_m)
    covariance: Matrix = np.outer(by_scale, by_scale) + np.outer(by_turn, by_turn) + noise
    return covariance.ravel()


def of_speed(speed_mps: float | None) -> Vector:
    """Of a twist of which wheels say at most the speed forward (36,); of a standing car as of one at 1 m/s."""
    forward = NOT_MEASURED if speed_mps is None else (SCALE_SD * max(1.0, abs(speed_mps))) ** 2
    return np.diag([forward, *[NOT_MEASURED] * 5]).ravel()
