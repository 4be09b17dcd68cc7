"""A simulated drive as a vehicle's source: what the simulator measured, without what it knows."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from simulator.changes import ChangingStreet, Worlds
from simulator.drive import Drive
from simulator.mesh import pose
from simulator.readings import EgoFrame, GnssReading, ImuReading, LidarReading, SensorName
from simulator.scenario import Ego
from simulator.scene import car
from simulator.scene.mover import Mover
from simulator.scene.people import pedestrian
from simulator.sensors.camera import CameraModel
from simulator.sensors.gnss import GnssModel
from simulator.sensors.imu import ImuModel
from simulator.sensors.lidar import LidarModel
from simulator.sensors.sensor_config import RigSensor, SensorRig
from simulator.streets.street import DRAWN_BEYOND_M, LANE_CENTRE_M, Street
from simulator.streets.trajectory import STEADY, Sway, Trajectory, path_beside
from simulator.world import World
from vehicle_client.sensing.calibration import CameraCalibration, VehicleCalibration
from vehicle_client.sources.frame import GnssFix, LidarFrame

FRAME_S = 0.1
"""Of the LiDAR's 30 turns a second, 10 are processed."""

LIDAR_HEIGHT_M = 2.4
"""The paper's."""


class SimulatedSource:
    """Frames of one drive that began at a Unix time. `moment` is the last one's, for pictures of the same world."""

    def __init__(self, drive: Drive, started_s: float) -> None:
        self._drive, self._started_s = drive, started_s
        self.moment: EgoFrame | None = None

    def __len__(self) -> int:
        return len(self._drive)

    def __iter__(self) -> Iterator[LidarFrame]:
        for moment in self._drive:
            self.moment = moment
            yield frame_of(moment, self._started_s)


def drive_on(world: World, from_x_m: float, to_x_m: float, speed_mps: float, seed: int) -> Drive:
    """A drive at constant speed along the right lane of a straight street."""
    seconds = (to_x_m - from_x_m) / speed_mps
    times = np.linspace(0, seconds, 4)
    path = path_beside(world.street.main, LANE_CENTRE_M, 1)
    trajectory = Trajectory(path, times, DRAWN_BEYOND_M + from_x_m + speed_mps * times, Sway(), seed)
    ego = Ego(trajectory, start_s=0.0, mover=0)
    worlds = Worlds(ChangingStreet(world.street), lambda _: world)
    return Drive(worlds, ego, _rig(), seed=seed, seconds=seconds + FRAME_S, tick_s=FRAME_S)


def _rig() -> SensorRig:
    """The paper's LiDAR, turning as it drives; a receiver at the vehicle's origin with one bias a drive; a compass."""
    lidar, gnss, imu = (SensorName(f"sensor.{kind}", "") for kind in ("lidar.ray_cast", "other.gnss", "other.imu"))
    receiver = GnssModel((1.0, 1.0, 1.5), noise_sd_m=(0.1, 0.1, 0.15))
    compass = ImuModel(compass_sd_rad=math.radians(0.3))
    return SensorRig(
        (
            RigSensor(lidar, LidarModel(rolling=True), pose(0.0, 0.0, LIDAR_HEIGHT_M), 0.0, {}),
            RigSensor(gnss, receiver, np.eye(4), 0.0, {}),
            RigSensor(imu, compass, np.eye(4), 0.0, {}),
        )
    )


def frame_of(moment: EgoFrame, started_s: float) -> LidarFrame:
    """The measurements of a moment; the exact poses and the labels stay behind."""
    (lidar,) = (r for r in moment.readings if isinstance(r, LidarReading))
    fixes = [r for r in moment.readings if isinstance(r, GnssReading)]
    (inertia,) = (r for r in moment.readings if isinstance(r, ImuReading))
    return LidarFrame(
        stamp_s=started_s + moment.time_s,
        points_m=lidar.sweep.points_m,
        ring=lidar.sweep.ring,
        point_time_s=lidar.sweep.time_offset_s,
        odom_from_vehicle=moment.odom_from_vehicle,
        gnss=fix_of(fixes[-1], inertia) if fixes else None,
        steering_rad=moment.steering_rad,
        speed_mps=moment.speed_mps,
    )


def fix_of(reading: GnssReading, inertia: ImuReading) -> GnssFix:
    """Satellites and compass together, as a receiver with two antennas gives them."""
    return GnssFix(reading.position, reading.altitude_m, inertia.compass_rad, reading.sd_m, reading.altitude_sd_m)


def calibration() -> VehicleCalibration:
    """Where the simulated car carries its LiDAR."""
    return VehicleCalibration(pose(0.0, 0.0, LIDAR_HEIGHT_M), sensor="ray-cast-64")


def camera_calibration(model: CameraModel) -> CameraCalibration:
    """The simulated camera as the vehicle knows it."""
    return CameraCalibration(model.matrix, model.width_px, model.height_px, model.vehicle_from_camera)


def passers_by(street: Street, seed: int) -> tuple[Mover, ...]:
    """Cars that come the other way, and people on the pavements."""
    main, rng = street.main, np.random.default_rng([seed, 3])
    oncoming = path_beside(main, -LANE_CENTRE_M, -1)
    times, cars = (
        np.arange(4.0),
        [(270.0, (0.32, 0.32, 0.33)), (395.0, (0.05, 0.10, 0.06)), (470.0, (0.55, 0.55, 0.53))],
    )
    ways = [(oncoming, DRAWN_BEYOND_M + street.length_m - x, 12.0, car.model(colour)) for x, colour in cars]
    for side, direction, x in ((1, 1, 205.0), (-1, 1, 236.0), (1, -1, 281.0)):
        pavement = path_beside(main, side * 4.7, direction, main.section.kerb_height_m + 0.02)
        start = DRAWN_BEYOND_M + (x if direction > 0 else street.length_m - x)
        ways.append((pavement, start, float(rng.uniform(0.9, 1.5)), pedestrian(seed + int(x))))
    return tuple(
        Mover(number, model, Trajectory(path, times, start + speed * times, STEADY, number))
        for number, (path, start, speed, model) in enumerate(ways, start=1)
    )
