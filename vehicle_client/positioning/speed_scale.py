"""What a receiver's speed says of odometry: by how much wheels count too short or too long."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vehicle_client.positioning.heading import VELOCITY_SD_MPS, repeated
from vehicle_client.positioning.odometry_history import OdometryHistory, PlanarPose
from vehicle_client.sources.frame import GnssFix

FROM_MPS = 5.0
"""Below it, a speed's error of 0.1 m/s is more than wheels ever err."""

LAG_S = 0.2
"""Receivers smooth, and odometry's speed is that of the time before: while a car brakes both differ."""

MOTION_S = 0.3


@dataclass(frozen=True, slots=True)
class ScaleMeasurement:
    """True way over odometry's, less one, with its standard deviation."""

    scale: float
    sd: float


def measured_scale(fix: GnssFix, at: PlanarPose, history: OdometryHistory, elapsed_s: float) -> ScaleMeasurement | None:
    """Speed over ground against odometry's about the same moment, `elapsed_s` after the last; None where slow."""
    before, earlier = history.at(at.stamp_s - MOTION_S), history.at(at.stamp_s - 2 * MOTION_S)
    if fix.speed_mps is None or not math.isfinite(fix.speed_mps) or before is None or earlier is None:
        return None
    speed, old_speed = (_speed_mps(one, other) for one, other in ((before, at), (earlier, before)))
    if min(speed, fix.speed_mps) < FROM_MPS:
        return None
    sd_mps = math.hypot(VELOCITY_SD_MPS, LAG_S * (speed - old_speed) / MOTION_S)
    return ScaleMeasurement(fix.speed_mps / speed - 1, repeated(elapsed_s) * sd_mps / speed)


def _speed_mps(one: PlanarPose, other: PlanarPose) -> float:
    return float(np.hypot(*(other.place_m - one.place_m)[:2])) / (other.stamp_s - one.stamp_s)
