"""Cars on bends and in swerves: when the driver is warned of what only the own LiDAR sees in the own lane."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.unit.vehicle_client.making import NOON_S, map_of, planar, pose_at, track_at
from vehicle_client.alerts import Alerts, choose
from vehicle_client.positioning.odometry_history import OdometryHistory

STEP_S, SEEN_FROM_M = 0.01, 25.0


def path(curvature_per_m: np.ndarray, speed_mps: float) -> np.ndarray:
    """x, y and heading (N, 3) every `STEP_S`, from the curvature there (N,)."""
    heading = np.cumsum(curvature_per_m) * speed_mps * STEP_S
    return np.stack([*(np.cumsum(f(heading)) * speed_mps * STEP_S for f in (np.cos, np.sin)), heading], axis=1)


def bend(radius_m: float, speed_mps: float) -> np.ndarray:
    """A straight of 60 m, a clothoid, an arc to the left and a clothoid of 40 m each, and a straight of 80 m."""
    ends_m = np.cumsum([0.0, 60.0, 40.0, 40.0, 40.0, 80.0])
    way_m = np.arange(0, ends_m[-1], speed_mps * STEP_S)
    return path(np.interp(way_m, ends_m, [0.0, 0.0, 1 / radius_m, 1 / radius_m, 0.0, 0.0]), speed_mps)


def swerve(seconds: float, speed_mps: float) -> np.ndarray:
    """Round a parked car: 2.5 m aside within so long, half a second past it, back within as long; 3 s before and 5 s
    after it straight."""
    time_s = np.arange(0, 8.5 + 2 * seconds, STEP_S)
    sideways = 2 * math.pi * 2.5 / seconds**2 * np.sin(2 * math.pi * (time_s - 3) / seconds)
    back = -2 * math.pi * 2.5 / seconds**2 * np.sin(2 * math.pi * (time_s - 3.5 - seconds) / seconds)
    out, home = (time_s >= 3) & (time_s < 3 + seconds), (time_s >= 3.5 + seconds) & (time_s < 3.5 + 2 * seconds)
    return path(np.where(out, sideways, np.where(home, back, 0.0)) / speed_mps**2, speed_mps)


def warned_before_s(way: np.ndarray, at: int, left_m: float, yaw_noise_rad: float = 0.0) -> float:
    """Seconds from the first warning to the passing of a thing beside a point of the way; ten sweeps a second, of which
    three have to see it. Every `STEP_S` there is a point."""
    rng, history, alerts, sweeps = np.random.default_rng(1), OdometryHistory(), Alerts(), 0
    x, y, heading = way[at]
    thing = np.array([x - left_m * math.sin(heading), y + left_m * math.cos(heading)])
    for here in range(0, at, 10):
        x, y, heading = way[here]
        odom_from_vehicle = planar(x, y, heading + rng.normal(0.0, yaw_noise_rad))
        history = history.with_pose(NOON_S + here * STEP_S, odom_from_vehicle)
        if math.dist(thing, (x, y)) > SEEN_FROM_M:
            continue
        sweeps += 1
        if sweeps < 3:
            continue
        # Where the thing is seen has the yaw's noise as well.
        offset = planar(x, y, heading)[:2, :2].T @ (thing - (x, y))
        centre = odom_from_vehicle[:2, :2] @ offset + (x, y)
        pose = replace(
            pose_at(odom_from_vehicle=odom_from_vehicle, speed_mps=history.speed_mps, stamp_s=NOON_S), bend=history.bend
        )
        alerts = choose(alerts, map_of(), (track_at(*map(float, centre)),), pose, NOON_S)
        if alerts.hazards:
            return (at - here) * STEP_S
    return 0.0


@pytest.mark.parametrize("radius_m", [60.0, 100.0, 250.0])
@pytest.mark.parametrize("left_m", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("noise_rad", [0.0, math.radians(0.2)])
def test_at_50_km_h_bends_that_begin_and_end_delay_no_warning_beyond_1_4_s(
    radius_m: float, left_m: float, noise_rad: float
) -> None:
    """By the straight line it would be 0.9 s on a radius of 60 m, 1.2 s on one of 100 m."""
    way = bend(radius_m, 14.0)
    for at in range(400, len(way) - 100, 40):
        assert warned_before_s(way, at, left_m, noise_rad) >= 1.4


@pytest.mark.parametrize(
    ("speed_mps", "at_least_s"), [(20 / 3.6, 1.9), (30 / 3.6, 1.7), (40 / 3.6, 1.3), (50 / 3.6, 1.3)]
)
@pytest.mark.parametrize("seconds", [2.5, 3.0, 4.0])
def test_whoever_swerves_round_a_parked_car_is_warned_of_what_lies_behind_it(
    speed_mps: float, at_least_s: float, seconds: float
) -> None:
    """By the straight line 1.5 s at the latest: while the curvature swings over, nothing is surely on the way."""
    way = swerve(seconds, speed_mps)
    for at in range(round((3 + seconds / 2) / STEP_S), len(way), 20):
        assert warned_before_s(way, at, 0.0) >= at_least_s
