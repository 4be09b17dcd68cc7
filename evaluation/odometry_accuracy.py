"""Odometry from sweeps, and points of one moment, against the simulator's truth and on a recorded drive."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evaluation.carving import read_scan
from simulator.mesh import pose
from simulator.motion import Carried
from simulator.readings import Sweep
from simulator.sensors.lidar_presets import hdl64e
from simulator.streets.street import LANE_CENTRE_M, first_light_street
from simulator.world import World
from vehicle_client.frames import inverse, yaw_of
from vehicle_client.positioning.odometry import ScanMatching
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sources.frame import LidarFrame

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

TURN_S = 0.1
STREET_SEED = 3
NEAR_M = 30.0
"""Obstacles are detected up to here."""

BEGUN = 5
"""Drives are measured from this sweep on: the first ones come from a car whose motion is not known, and stay bent."""


@dataclass(frozen=True, slots=True)
class Arc:
    """A `Motion` from a place of the street on: speed and yaw rate constant, the speed changing evenly."""

    name: str
    speed_mps: float
    yaw_rate_rps: float = 0.0
    acceleration_mps2: float = 0.0
    start_x_m: float = 40.0

    def poses(self, time_s: FloatArray) -> FloatArray:
        """`street_from_vehicle` (N, 4, 4), by short straight steps of 1 ms for curves."""
        way = self.speed_mps * time_s + self.acceleration_mps2 * time_s**2 / 2
        yaw = self.yaw_rate_rps * time_s
        bent = np.abs(self.yaw_rate_rps) > 0
        x = self.speed_mps * np.sin(yaw) / self.yaw_rate_rps if bent else way
        y = self.speed_mps * (1 - np.cos(yaw)) / self.yaw_rate_rps if bent else np.zeros_like(way)
        return np.stack(
            [
                pose(self.start_x_m + float(a), LANE_CENTRE_M + float(b), 0.0, float(c))
                for a, b, c in zip(x, y, yaw, strict=True)
            ]
        )


MANOEUVRES = (
    Arc("50 km/h", 14.0),
    Arc("130 km/h", 36.0),
    Arc("130 km/h, braking 6 m/s2", 36.0, acceleration_mps2=-6.0),
    Arc("a corner: 29 km/h, radius 20 m", 8.0, yaw_rate_rps=0.4),
)


@dataclass(frozen=True, slots=True)
class Deskewed:
    """A sweep as it was measured, brought to its stamp, and as it would have been seen at once: points (N, 3) nearer
    than 30 m."""

    manoeuvre: Arc
    raw_m: FloatArray
    deskewed_m: FloatArray
    truth_m: FloatArray

    @property
    def raw_error_m(self) -> FloatArray:
        """Distance (N,) of each point from where it was at the stamp."""
        return np.asarray(np.linalg.norm(self.raw_m - self.truth_m, axis=1))

    @property
    def error_m(self) -> FloatArray:
        """The same after the motion was taken out."""
        return np.asarray(np.linalg.norm(self.deskewed_m - self.truth_m, axis=1))


def deskewed(manoeuvre: Arc, seed: int) -> Deskewed:
    """The third sweep of a rolling HDL-64E: the motion comes from odometry at the stamps of the two before."""
    world, lidar = World(first_light_street(seed=STREET_SEED)), hdl64e()
    mounting = pose(0.0, 0.0, lidar.height_m)
    preparation = Preparation(CarCalibration(VehicleCalibration(mounting, "hdl-64")))
    rng = np.random.default_rng([seed, 2])
    for number in range(3):
        end_s = number * TURN_S
        sweep = world.sweep(lidar, Carried(manoeuvre, mounting), end_s, rng)
        odom_from_vehicle = manoeuvre.poses(np.array([end_s]))[0]
        frame = preparation.prepared(_frame(sweep, end_s, odom_from_vehicle))
    truth = at_one_moment(sweep, Carried(manoeuvre, mounting), end_s)
    near = np.linalg.norm(truth, axis=1) < NEAR_M
    raw, found = sweep.points_m.astype(np.float64), frame.points_m.astype(np.float64)
    return Deskewed(manoeuvre, raw[near], found[near], truth[near])


def _frame(sweep: Sweep, end_s: float, odom_from_vehicle: FloatArray | None) -> LidarFrame:
    points = sweep.points_m.astype(np.float32)
    times = sweep.time_offset_s.astype(np.float32)
    return LidarFrame(end_s, points, point_time_s=times, odom_from_vehicle=odom_from_vehicle)


def at_one_moment(sweep: Sweep, sensor: Carried, end_s: float) -> FloatArray:
    """Points (N, 3) in the sensor's frame at the end of the turn, by the exact poses at which they were measured."""
    moments, which = np.unique(sweep.time_offset_s, return_inverse=True)
    poses = sensor.poses(np.concatenate([[end_s], end_s + moments]))
    end_from_moment = inverse(poses[0]) @ poses[1:]
    turned = np.einsum("nij,nj->ni", end_from_moment[which, :3, :3], sweep.points_m.astype(np.float64))
    return np.asarray(turned + end_from_moment[which, :3, 3])


@dataclass(frozen=True, slots=True)
class MatchedDrive:
    """Scan matching along a drive: poses (N, 4, 4), true ones if known, and seconds a sweep (N,)."""

    name: str
    poses: FloatArray
    truth: FloatArray | None
    seconds: FloatArray

    @property
    def length_m(self) -> float:
        """Of the matched path."""
        return float(np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1).sum())

    @property
    def drift_percent(self) -> float:
        """Distance of the last place from the true one, per 100 m of the way; NaN without truth."""
        if self.truth is None:
            return math.nan
        away = float(np.linalg.norm(self.poses[-1, :3, 3] - self.truth[-1, :3, 3]))
        return 100 * away / float(np.linalg.norm(np.diff(self.truth[:, :3, 3], axis=0), axis=1).sum())

    @property
    def turn_deg_per_100_m(self) -> float:
        """False turn at the end; NaN without truth."""
        if self.truth is None:
            return math.nan
        turn = math.remainder(yaw_of(self.poses[-1]) - yaw_of(self.truth[-1]), 2 * math.pi)
        return math.degrees(abs(turn)) * 100 / self.length_m

    @property
    def roughness_m(self) -> float:
        """RMS of the change of the step from sweep to sweep: a car's is below 2 cm at 10 Hz (2 m/s2)."""
        steps = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1)
        return float(np.sqrt((np.diff(steps) ** 2).mean()))


def matched(name: str, frames: Iterator[LidarFrame], vehicle_from_sensor: FloatArray) -> MatchedDrive:
    """Match the sweeps of a drive, and say how long each took."""
    matcher = ScanMatching(vehicle_from_sensor)
    poses, truth, seconds = [], [], []
    for frame in frames:
        began = time.perf_counter()
        found = matcher.odom_from_vehicle(frame)
        seconds.append(time.perf_counter() - began)
        if found is not None:
            poses.append(found)
            truth.extend([] if frame.odom_from_vehicle is None else [frame.odom_from_vehicle])
    known = inverse(truth[BEGUN]) @ np.stack(truth[BEGUN:]) if truth else None
    return MatchedDrive(name, inverse(poses[BEGUN]) @ np.stack(poses[BEGUN:]), known, np.array(seconds))


def simulated_sweeps(way_m: float, speed_mps: float, seed: int, *, times: bool) -> Iterator[LidarFrame]:
    """A rolling HDL-64E along the demo's street, with or without the times of points; the odometry is the truth."""
    world, lidar = World(first_light_street(seed=STREET_SEED)), hdl64e()
    motion = Arc("straight", speed_mps, start_x_m=30.0)
    carried, rng = Carried(motion, pose(0.0, 0.0, lidar.height_m)), np.random.default_rng([seed, 3])
    for number in range(int(way_m / speed_mps / TURN_S)):
        end_s = number * TURN_S
        sweep = world.sweep(lidar, carried, end_s, rng)
        frame = _frame(sweep, end_s, motion.poses(np.array([end_s]))[0])
        yield frame if times else LidarFrame(end_s, frame.points_m, odom_from_vehicle=frame.odom_from_vehicle)


def recorded_sweeps(paths: Sequence[Path]) -> Iterator[LidarFrame]:
    """KITTI's sweeps, ten a second; they were rectified by who recorded them."""
    for number, path in enumerate(paths):
        yield LidarFrame(number * TURN_S, read_scan(path))
