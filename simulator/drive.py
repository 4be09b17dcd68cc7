"""One vehicle's drive along a street: exact poses, and what its sensors, odometry and GNSS say of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from simulator.camera import CameraModel
from simulator.lidar import LidarModel
from simulator.mesh import pose
from simulator.motion import Standing
from simulator.street import LANE_CENTRE_M, Street
from simulator.world import World

FloatArray = NDArray[np.float64]

WHEELBASE_M = 2.7


@dataclass(frozen=True, slots=True)
class Wander:
    """How far what a car believes lies from the truth (1 sigma), and how it moves on its springs."""

    gnss_bias_m: float = 1.0
    """Each axis, once a drive: code multipath and atmosphere change over minutes."""
    gnss_noise_m: float = 0.1
    gnss_altitude_factor: float = 1.5
    """Satellites are only above: the vertical is worse by half."""
    heading_sd_rad: float = math.radians(0.3)
    odometry_scale_sd: float = 0.001
    odometry_yaw_sd_rad_per_m: float = math.radians(0.1) / 100
    attitude_sd_rad: float = math.radians(0.02)
    suspension_rad: float = math.radians(0.1)
    lateral_m: float = 0.08
    """Drivers weave about their line by a decimetre, over some fifty metres."""


@dataclass(frozen=True, slots=True)
class DrivePlan:
    """Where and when a vehicle drives, at constant speed in the direction of the street's x, and what it records.

    A LiDAR turn is recorded every `every_nth` turns; with a `camera`, a picture with each of those.
    """

    start_x_m: float
    end_x_m: float
    speed_mps: float
    seed: int
    start_time_s: float = 1_750_000_000.0
    lateral_m: float = LANE_CENTRE_M
    every_nth: int = 1
    lidar: LidarModel = field(default_factory=LidarModel)
    camera: CameraModel | None = None
    wander: Wander = field(default_factory=Wander)

    @property
    def period_s(self) -> float:
        """Time between two recorded turns."""
        return self.every_nth / self.lidar.rate_hz

    @property
    def vehicle_from_sensor(self) -> FloatArray:
        """(4, 4): the LiDAR on the roof, above the origin of the vehicle frame."""
        return pose(0.0, 0.0, self.lidar.height_m)


@dataclass(frozen=True, slots=True)
class GnssMeasurement:
    """A satellite fix of the vehicle frame's origin; the standard deviations (1 sigma) are those of `Wander`."""

    position: LatLon
    altitude_m: float
    heading_rad: float
    """Clockwise from north, in [0, 2 pi)."""
    sd_m: float
    altitude_sd_m: float


@dataclass(frozen=True, slots=True)
class DriveSample:
    """One moment of a drive: measurements as a vehicle has them, and the truth (last four fields).

    `points_m` (N, 3) float32, frame `sensor`, with `ring` (N,). `odom_from_vehicle` (4, 4) drifts;
    `enu_from_vehicle` (4, 4) is exact. `surface` (N,) are `Surface` values, `obstacle_id` (N,) numbers or 0.
    """

    stamp_s: float
    points_m: NDArray[np.float32]
    ring: NDArray[np.uint16]
    image: NDArray[np.uint8] | None
    odom_from_vehicle: FloatArray
    gnss: GnssMeasurement
    steering_rad: float
    speed_mps: float
    enu_from_vehicle: FloatArray
    street_from_vehicle: FloatArray
    surface: NDArray[np.uint8]
    obstacle_id: NDArray[np.int32]


class Drive:
    """The samples of one drive, in the order of time; each iteration yields the same."""

    def __init__(self, world: World, plan: DrivePlan) -> None:
        self._world = world
        self._plan = plan
        self._path = _Path(world.street, plan)

    def __len__(self) -> int:
        return len(self._path.distance_m)

    def __iter__(self) -> Iterator[DriveSample]:
        rng = np.random.default_rng([self._plan.seed, 1])
        enu_from_street = self._world.street.enu_from_street
        fixes = _GnssReceiver(self._world.street, self._plan.wander, rng)
        odometry = _odometry(self._path.street_from_vehicle, self._plan.wander, rng)
        for index, street_from_vehicle in enumerate(self._path.street_from_vehicle):
            enu_from_vehicle = enu_from_street @ street_from_vehicle
            sensor = Standing(street_from_vehicle @ self._plan.vehicle_from_sensor)
            sweep = self._world.sweep(self._plan.lidar, sensor, index * self._plan.period_s, rng)
            camera = self._plan.camera
            yield DriveSample(
                stamp_s=self._plan.start_time_s + index * self._plan.period_s,
                points_m=sweep.points_m,
                ring=sweep.ring,
                image=self._world.render(camera, street_from_vehicle) if camera else None,
                odom_from_vehicle=odometry[index],
                gnss=fixes.measure(enu_from_vehicle),
                steering_rad=float(self._path.steering_rad[index]),
                speed_mps=self._plan.speed_mps,
                enu_from_vehicle=enu_from_vehicle,
                street_from_vehicle=street_from_vehicle,
                surface=sweep.surface,
                obstacle_id=sweep.obstacle_id,
            )


def drive(world: World, plan: DrivePlan) -> Drive:
    """The drive of a plan through a world."""
    return Drive(world, plan)


class _Path:
    """Exact poses along the street: a weaving line on the sound road, rolled with its crown, rocking on springs."""

    def __init__(self, street: Street, plan: DrivePlan) -> None:
        rng = np.random.default_rng([plan.seed, 0])
        spacing_m = plan.speed_mps * plan.period_s
        count = max(0, math.floor((plan.end_x_m - plan.start_x_m) / spacing_m + 1e-9) + 1)
        self.distance_m = np.arange(count) * spacing_m
        x = plan.start_x_m + self.distance_m
        wave = 2 * math.pi / rng.uniform(40, 60)
        phase = rng.uniform(0, 2 * math.pi)
        y = plan.lateral_m + plan.wander.lateral_m * np.sin(wave * x + phase)
        slope = plan.wander.lateral_m * wave * np.cos(wave * x + phase)
        curvature = -plan.wander.lateral_m * wave**2 * np.sin(wave * x + phase)
        self.steering_rad = np.arctan(WHEELBASE_M * curvature)
        time_s = np.arange(count) * plan.period_s
        pitch = plan.wander.suspension_rad * _rocking(rng, time_s, 1.3)
        roll = plan.wander.suspension_rad * _rocking(rng, time_s, 1.6)
        self.street_from_vehicle = [
            pose(
                x[i],
                y[i],
                float(street.sound_height(x[i : i + 1], y[i : i + 1])[0]),
                math.atan(slope[i]),
                pitch[i],
                roll[i] + math.atan(float(street.main.cross_slope(x[i : i + 1], y[i : i + 1])[0])),
            )
            for i in range(count)
        ]


def _rocking(rng: np.random.Generator, time_s: NDArray[np.floating], frequency_hz: float) -> FloatArray:
    """Oscillation of unit standard deviation about the natural frequency of a car's body on its springs."""
    parts = [
        np.sin(2 * math.pi * frequency_hz * factor * time_s + rng.uniform(0, 2 * math.pi))
        for factor in (0.7, 1.0, 1.37)
    ]
    return np.asarray(np.sum(parts, axis=0) * math.sqrt(2 / 3))


def _odometry(truth: list[FloatArray], wander: Wander, rng: np.random.Generator) -> list[FloatArray]:
    """`odom_from_vehicle` of each pose: starts level at the first one, with an error of scale and a yaw that drifts."""
    if not truth:
        return []
    scale = 1 + rng.normal(0, wander.odometry_scale_sd)
    yaw_per_m = rng.normal(0, wander.odometry_yaw_sd_rad_per_m)
    start = truth[0]
    x, y, z = start[:3, 3]
    odom_from_street = np.linalg.inv(pose(x, y, z, _yaw(start)))
    position, travelled = np.zeros(3), 0.0
    poses = []
    for index, street_from_vehicle in enumerate(truth):
        if index:
            step = odom_from_street[:3, :3] @ (street_from_vehicle[:3, 3] - truth[index - 1][:3, 3])
            travelled += float(np.linalg.norm(step))
            position = position + scale * (pose(0, 0, 0, yaw_per_m * travelled)[:3, :3] @ step)
        roll, pitch = rng.normal(0, wander.attitude_sd_rad, 2)
        turned: FloatArray = pose(0, 0, 0, yaw_per_m * travelled) @ odom_from_street @ street_from_vehicle
        turned = turned @ pose(0, 0, 0, 0.0, pitch, roll)
        turned[:3, 3] = position
        poses.append(turned)
    return poses


class _GnssReceiver:
    """A receiver with one bias for the drive and white noise."""

    def __init__(self, street: Street, wander: Wander, rng: np.random.Generator) -> None:
        self._street, self._wander, self._rng = street, wander, rng
        self._axes = np.array([1.0, 1.0, wander.gnss_altitude_factor])
        self._bias_m = rng.normal(0, wander.gnss_bias_m, 3) * self._axes

    def measure(self, enu_from_vehicle: FloatArray) -> GnssMeasurement:
        """A fix at a pose."""
        wander = self._wander
        noise_m = self._rng.normal(0, wander.gnss_noise_m, 3) * self._axes
        enu = enu_from_vehicle[:3, 3] + self._bias_m + noise_m
        position, altitude = self._street.georeference.geodetic_from_enu(enu)
        heading = math.pi / 2 - _yaw(enu_from_vehicle) + self._rng.normal(0, wander.heading_sd_rad)
        sd_m = math.hypot(wander.gnss_bias_m, wander.gnss_noise_m)
        return GnssMeasurement(position, altitude, heading % (2 * math.pi), sd_m, sd_m * wander.gnss_altitude_factor)


def _yaw(a_from_b: FloatArray) -> float:
    return math.atan2(a_from_b[1, 0], a_from_b[0, 0])
