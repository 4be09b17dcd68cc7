"""A drive from a recording in the layout of CARLA recordings (`docs/recordings.md`), in both dialects of its axes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import (
    GeoOrigin,
    Matrix,
    heading_from_yaw,
    inverse,
    rigid,
    rotation_about_z,
    yaw_from_heading,
    yaw_of,
)
from vehicle_client.sources.carla_folder import (
    PointTimes,
    Rings,
    find_dialect,
    lidar_folder,
    picture_paths,
    read_point_times,
    read_steering,
    recorded_frames,
    sweep_path,
)
from vehicle_client.sources.carla_text import RecordedFrame, in_sensor_frame, read_carla_ply
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import OF_VEHICLE, GnssFix, LidarFrame, Motion, SourceError
from vehicle_client.sources.pictures import read_picture
from vehicle_client.sources.recorded_tables import (
    RecordedOdometry,
    Timeline,
    compass_of,
    fix_of,
    number_of,
    odometry_of,
    read_description,
    read_table,
    yaw_rate_of,
)
from vehicle_client.sources.stamps import StampGate

Row = TypeVar("Row")

PAPER_MOUNTING = rigid(np.eye(3), np.array([0.0, 0.0, 2.4]))
"""`vehicle_from_sensor` of the paper's LiDAR, for recordings that say nothing of it."""

EXACT_SD_M = 0.02
"""Stated for a place that comes from the simulator's own transform, which has micrometres: it must not be 0."""


class CarlaRecording:
    """The drive of one vehicle: `folder` holds `ego0`, `ego1`, ...

    Sweeps come in the right-handed sensor frame, with intensity, rings and point times where they were recorded;
    `odom_from_vehicle` from odometry.csv, else from the sweep's transform; yaw rates from imu.csv. Fixes come from
    gnss.csv, moved from the antenna to the vehicle's origin, with the heading of imu.csv's compass; where there is
    none, from the transform and the place of the world's origin: that of recording.json, or `origin`, about which x is
    east and y north. What is missing, cut or corrupt, or does not follow in time, is
    skipped with a warning and counted. `SourceError` if this is no such recording.
    """

    def __init__(self, folder: Path, ego: int = 0, origin: GeoOrigin | None = None) -> None:
        self._complaints = Complaints()
        self._ego = folder / f"ego{ego}"
        self._lidar = lidar_folder(self._ego)
        self._said = read_description(folder)
        self._origin = origin or self._said.origin
        self._enu_from_world = np.eye(4) if origin else self._said.enu_from_world
        self._frames, recorded = recorded_frames(self._lidar, self._complaints)
        self._old_dialect = find_dialect(self._lidar, self._frames)
        mounting = self._said.mounting(self._lidar.name)
        self._vehicle_from_sensor = PAPER_MOUNTING if mounting is None else mounting
        self._pictures = Timeline(picture_paths(self._ego))
        self._fixes = self._timeline("gnss", fix_of)
        self._compass = self._timeline("imu", compass_of)
        self._yaw_rates = self._timeline("imu", yaw_rate_of)
        self._odometry = dict(self._rows("odometry.csv", odometry_of))
        ticks = self._rows("poses.csv", number_of)
        self._steering = read_steering(self._ego, ticks or recorded, self._complaints)
        self._speeds = _speeds(self._frames)

    @property
    def skipped(self) -> int:
        """How many frames, pictures and lines could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        """Frames whose sweep is there; one that turns out to be corrupt is skipped all the same."""
        return len(self._frames)

    def __iter__(self) -> Iterator[LidarFrame]:
        after = RecordedFrame(-1, -math.inf, np.eye(4))
        gate = StampGate()
        for frame in self._frames:
            try:
                refusal = gate.refusal(self._said.start_s + frame.time_s)
                if refusal is not None:
                    raise SourceError(f"{self._lidar}, frame {frame.number}: {refusal}")
                joined = self._joined(frame, after)
            except SourceError as error:
                self._complaints.add(str(error))
                continue
            yield joined
            after = frame

    def _joined(self, frame: RecordedFrame, after: RecordedFrame) -> LidarFrame:
        """The sweep with all that was recorded since the one before it."""
        sweep = read_carla_ply(sweep_path(self._lidar, frame.number))
        world_from_vehicle = frame.world_from_sensor @ inverse(self._vehicle_from_sensor)
        odometry = self._odometry.get(frame.number) or RecordedOdometry(world_from_vehicle, self._speeds[frame.number])
        ring, point_time_s = self._point_times(frame, len(sweep.raw_m))
        image = self._picture(self._pictures.latest(after.number, frame.number))
        return LidarFrame(
            stamp_s=self._said.start_s + frame.time_s,
            points_m=in_sensor_frame(sweep, self._old_dialect),
            intensity=sweep.intensity,
            ring=ring,
            point_time_s=point_time_s,
            image=image,
            odom_from_vehicle=odometry.odom_from_vehicle,
            gnss=self._fix(frame, after, world_from_vehicle),
            steering_rad=self._steering.get(frame.number, 0.0),
            speed_mps=odometry.speed_mps,
            motions=tuple(
                Motion(self._said.start_s + time_s, None, rate)
                for time_s, rate in self._yaw_rates.between(after.time_s, frame.time_s)
            ),
        )

    def _point_times(self, frame: RecordedFrame, count: int) -> tuple[Rings, PointTimes] | tuple[None, None]:
        try:
            return read_point_times(self._lidar, frame.number, count) or (None, None)
        except SourceError as error:
            self._complaints.add(str(error))
            return None, None

    def _fix(self, frame: RecordedFrame, after: RecordedFrame, world_from_vehicle: Matrix) -> GnssFix | None:
        enu_from_vehicle = self._enu_from_world @ world_from_vehicle
        if not self._fixes.rows:
            return _exact_fix(self._origin, enu_from_vehicle)
        fix = self._fixes.latest(after.time_s, frame.time_s)
        if fix is None:
            return None
        heading = self._compass.latest(-math.inf, frame.time_s)
        yaw = yaw_of(enu_from_vehicle)
        if heading is not None:
            yaw = yaw_from_heading(heading) - yaw_of(self._mounting("imu"))
        level = rotation_about_z(-yaw_of(world_from_vehicle)) @ world_from_vehicle[:3, :3]
        lever = rotation_about_z(yaw) @ level @ self._mounting("gnss")[:3, 3]
        position, altitude_m = GeoOrigin(fix.position, fix.altitude_m).geodetic(-lever)
        stamp_s = self._said.start_s + fix.time_s
        heading_rad = heading_from_yaw(yaw)
        return GnssFix(
            position, altitude_m, heading_rad, fix.sd_m, fix.altitude_sd_m, stamp_s=stamp_s, antenna_m=OF_VEHICLE
        )

    def _mounting(self, name: str) -> Matrix:
        """`vehicle_from_sensor` of the receiver or inertial unit that `_timeline` reads."""
        path = self._table(name)
        folder = f"sensor.other.{path.stem}" if path else ""
        mounting = self._said.mounting(folder)
        return np.eye(4) if mounting is None else mounting

    def _picture(self, path: Path | None) -> NDArray[np.uint8] | None:
        try:
            return None if path is None else read_picture(path)
        except SourceError as error:
            self._complaints.add(str(error))
            return None

    def _table(self, name: str) -> Path | None:
        """`gnss.csv`, or the first of `gnss.ROLE.csv`."""
        return next(iter(sorted(self._ego.glob(f"{name}*.csv"))), None)

    def _timeline(self, name: str, row_of: Callable[[dict[str, str]], tuple[float, Row]]) -> Timeline[Row]:
        path = self._table(name)
        return Timeline(sorted(self._rows(path.name, row_of), key=lambda row: row[0]) if path else [])

    def _rows(self, name: str, row_of: Callable[[dict[str, str]], Row]) -> list[Row]:
        rows, bad = read_table(self._ego / name, row_of)
        if bad:
            self._complaints.add(f"{self._ego / name}: {bad} lines cannot be understood")
        return rows


def _exact_fix(origin: GeoOrigin | None, enu_from_vehicle: Matrix) -> GnssFix | None:
    """The true place, where it is known on earth."""
    if origin is None:
        return None
    position, altitude_m = origin.geodetic(enu_from_vehicle[:3, 3])
    heading_rad = heading_from_yaw(yaw_of(enu_from_vehicle))
    return GnssFix(position, altitude_m, heading_rad, EXACT_SD_M, EXACT_SD_M, antenna_m=OF_VEHICLE)


def _speeds(frames: list[RecordedFrame]) -> dict[int, float]:
    """Speed at each frame from the sensor's places at its neighbours; 0 where there are none."""
    speeds = {}
    for index, frame in enumerate(frames):
        first, last = frames[max(0, index - 1)], frames[min(len(frames) - 1, index + 1)]
        moved_m = float(np.linalg.norm(last.world_from_sensor[:3, 3] - first.world_from_sensor[:3, 3]))
        elapsed_s = last.time_s - first.time_s
        speeds[frame.number] = moved_m / elapsed_s if elapsed_s > 0 else 0.0
    return speeds
