"""One vehicle's folder in the layout of CARLA recordings, with labels and exact poses beside it.

egoN/sensor.lidar.ray_cast/00012.ply, labels/00012.npz, lidar_metadata.txt
egoN/sensor.camera.rgb/00012.png, camera_metadata.txt
egoN/steering_norm.txt, steering_true.txt, poses.csv, odometry.csv, gnss.csv, imu.csv
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.readings import (
    EgoFrame,
    GnssReading,
    ImageReading,
    ImuReading,
    LidarReading,
    SensorName,
    Sweep,
)
from simulator.recording.files import GrowingFiles, csv_line, npz_bytes, write_whole
from simulator.recording.handedness import carla_transform, mirrored_points
from simulator.recording.header import RecordingHeader
from simulator.recording.ply_text import LIDAR_PROPERTIES, SEMANTIC_PROPERTIES, ply_text
from simulator.recording.rotation import quaternion
from simulator.recording.semantic_tags import object_indices, semantic_tags

FULL_STEERING_DEG = 70.0
"""The front wheels' angle at CARLA's steer of 1, in its vehicles and in the authors' recorder."""

POSE_COLUMNS = "frame,time_s,x_m,y_m,z_m,qx,qy,qz,qw,latitude_deg,longitude_deg,altitude_m,speed_mps,steering_rad\n"
ODOMETRY_COLUMNS = "frame,time_s,x_m,y_m,z_m,qx,qy,qz,qw,speed_mps\n"
GNSS_COLUMNS = "frame,time_s,latitude_deg,longitude_deg,altitude_m,sd_m,altitude_sd_m\n"
IMU_COLUMNS = (
    "frame,time_s,accelerometer_x_mps2,accelerometer_y_mps2,accelerometer_z_mps2,"
    "gyroscope_x_radps,gyroscope_y_radps,gyroscope_z_radps,compass_rad\n"
)

SEMANTIC_LIDAR = "sensor.lidar.ray_cast_semantic"


class EgoFolder:
    """Writes frames of one vehicle; every file of a frame is in place before the line that speaks of it."""

    def __init__(self, folder: Path, header: RecordingHeader, folders: Mapping[SensorName, str]) -> None:
        self._folder = folder
        self._header = header
        self._folders = folders
        self._texts = GrowingFiles()
        for name in folders.values():
            if name.startswith(("sensor.lidar", "sensor.camera")):
                (folder / name).mkdir(parents=True)
            if name.startswith("sensor.lidar"):
                (folder / name / "labels").mkdir()

    def write(self, frame: EgoFrame, pictures: Mapping[SensorName, bytes]) -> None:
        """Write all files and lines of a frame; `pictures` holds the PNG of every image reading."""
        for reading in frame.readings:
            match reading:
                case LidarReading():
                    self._write_sweep(frame, reading)
                case ImageReading():
                    self._write_picture(frame, reading, pictures[reading.sensor])
                case GnssReading():
                    self._write_fix(frame, reading)
                case ImuReading():
                    self._write_inertia(frame, reading)
        self._write_state(frame)

    def close(self) -> None:
        """Close the text files."""
        self._texts.close()

    def _write_sweep(self, frame: EgoFrame, reading: LidarReading) -> None:
        folder = self._folder / self._folders[reading.sensor]
        is_semantic = reading.sensor.type == SEMANTIC_LIDAR
        content = semantic_ply(reading.sweep) if is_semantic else lidar_ply(reading.sweep)
        write_whole(folder / f"{frame.number:05d}.ply", content)
        write_whole(folder / "labels" / f"{frame.number:05d}.npz", npz_bytes(labels(reading.sweep)))
        measurement = "SemanticLidarMeasurement" if is_semantic else "LidarMeasurement"
        told = f"number_of_points={len(reading.sweep.points_m)}"
        self._texts.add(
            folder / "lidar_metadata.txt", metadata_line(measurement, frame, told, reading.street_from_sensor)
        )

    def _write_picture(self, frame: EgoFrame, reading: ImageReading, png: bytes) -> None:
        folder = self._folder / self._folders[reading.sensor]
        write_whole(folder / f"{frame.number:05d}.png", png)
        height, width = reading.pixels.shape[:2]
        line = metadata_line("Image", frame, f"size={width}x{height}", reading.street_from_sensor)
        self._texts.add(folder / "camera_metadata.txt", line)

    def _write_fix(self, frame: EgoFrame, reading: GnssReading) -> None:
        place = reading.position
        row = (frame.number, reading.time_s, place.latitude_deg, place.longitude_deg, reading.altitude_m)
        path = self._table("gnss", reading.sensor)
        self._texts.add(path, csv_line([*row, reading.sd_m, reading.altitude_sd_m]), before_first=GNSS_COLUMNS)

    def _write_inertia(self, frame: EgoFrame, reading: ImuReading) -> None:
        vectors = (*reading.accelerometer_mps2.tolist(), *reading.gyroscope_radps.tolist())
        row = (frame.number, reading.time_s, *vectors, reading.compass_rad)
        self._texts.add(self._table("imu", reading.sensor), csv_line(row), before_first=IMU_COLUMNS)

    def _write_state(self, frame: EgoFrame) -> None:
        position, altitude_m = self._header.georeference.geodetic_from_enu(frame.enu_from_vehicle[:3, 3])
        place = (position.latitude_deg, position.longitude_deg, altitude_m)
        row = (
            frame.number,
            frame.time_s,
            *_numbers(frame.street_from_vehicle),
            *place,
            frame.speed_mps,
            frame.steering_rad,
        )
        self._texts.add(self._folder / "poses.csv", csv_line(row), before_first=POSE_COLUMNS)
        odometry = (frame.number, frame.time_s, *_numbers(frame.odom_from_vehicle), frame.speed_mps)
        self._texts.add(self._folder / "odometry.csv", csv_line(odometry), before_first=ODOMETRY_COLUMNS)
        steering_deg = -math.degrees(frame.steering_rad)
        self._texts.add(self._folder / "steering_norm.txt", repr(steering_deg / FULL_STEERING_DEG), between=", ")
        self._texts.add(self._folder / "steering_true.txt", repr(steering_deg), between=", ")

    def _table(self, name: str, sensor: SensorName) -> Path:
        """`gnss.csv`, or `gnss.ROLE.csv` where the vehicle has two."""
        return self._folder / (name + self._folders[sensor].removeprefix(sensor.type) + ".csv")


def lidar_ply(sweep: Sweep) -> bytes:
    """A sweep as CARLA's ray-cast LiDAR is saved: x y z I."""
    return ply_text(LIDAR_PROPERTIES, np.column_stack([mirrored_points(sweep.points_m), sweep.intensity]))


def semantic_ply(sweep: Sweep) -> bytes:
    """A sweep as CARLA's semantic LiDAR is saved: x y z CosAngle ObjIdx ObjTag."""
    decimals = np.column_stack([mirrored_points(sweep.points_m), sweep.cos_incidence])
    objects = object_indices(sweep.obstacle_id, sweep.mover_id)
    return ply_text(SEMANTIC_PROPERTIES, decimals, np.column_stack([objects, semantic_tags(sweep.surface)]))


def labels(sweep: Sweep) -> dict[str, NDArray[np.generic]]:
    """The arrays that stand beside a sweep, (N,) each."""
    return {
        "surface": sweep.surface,
        "obstacle_id": sweep.obstacle_id,
        "mover_id": sweep.mover_id,
        "ring": sweep.ring,
        "time_offset_s": sweep.time_offset_s,
    }


def metadata_line(measurement: str, frame: EgoFrame, told: str, street_from_sensor: NDArray[np.float64]) -> str:
    """A line of lidar_metadata.txt or camera_metadata.txt: CARLA's texts of the measurement and its transform."""
    transform = carla_transform(street_from_sensor)
    return f"{measurement}(frame={frame.number}, timestamp={frame.time_s:.6f}, {told}), {transform}\n"


def _numbers(a_from_b: NDArray[np.float64]) -> tuple[float, ...]:
    """Position and unit quaternion of a (4, 4) transform."""
    return (*a_from_b[:3, 3].tolist(), *quaternion(a_from_b))
