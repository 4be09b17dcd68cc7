"""The small texts of KITTI's drives: stamps, calibrations, poses, and what its inertial unit measured."""

from __future__ import annotations

import math
import re
from calendar import timegm
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from contract.geometry import LatLon
from vehicle_client.frames import GeoOrigin, Matrix, heading_from_yaw, rigid, rotation_about_z
from vehicle_client.sources.frame import OF_VEHICLE, GnssFix, Motion, SourceError

LIDAR_HEIGHT_M = 1.73
"""Of KITTI's car (Geiger et al. 2013, figure 3: all heights with respect to the road)."""

VEHICLE_FROM_LIDAR = rigid(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))

LIDAR_FROM_IMU = rigid(np.eye(3), np.array([-0.81, 0.32, -0.80]))
"""Where calib_imu_to_velo.txt is missing: the distances of figure 3, without the mounting's tenths of a degree."""

_STAMP = re.compile(r"(\d{4}-\d\d-\d\d \d\d:\d\d:\d\d)(?:\.(\d{1,9}))?\s*")

OXTS_VALUES = 30
"""Numbers in a line of oxts/data, as oxts/dataformat.txt lists them."""


def stamp_of(line: str) -> float | None:
    """Unix time of a line of timestamps.txt; None if it is none. KITTI's clocks ran on UTC."""
    found = _STAMP.fullmatch(line)
    if found is None:
        return None
    try:
        seconds = timegm(datetime.strptime(found[1], "%Y-%m-%d %H:%M:%S").timetuple())
    except ValueError:
        return None
    return seconds + int((found[2] or "0").ljust(9, "0")) / 1e9


def read_stamps(path: Path) -> list[float | None]:
    """Unix time of each line of timestamps.txt, None where it cannot be understood; `SourceError` without the file."""
    try:
        text = path.read_text(errors="replace")
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    return [stamp_of(line) for line in text.splitlines()]


def numbers_of(text: str, count: int) -> Matrix | None:
    """So many finite numbers, separated by white space; None if it is anything else."""
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        return None
    return values if len(values) == count and np.isfinite(values).all() else None


def read_calibration(path: Path) -> dict[str, str]:
    """The lines `name: numbers` of a calibration file; none where there is no such file."""
    if not path.is_file():
        return {}
    lines = (line.partition(":") for line in path.read_text(errors="replace").splitlines())
    return {name.strip(): values for name, _, values in lines}


def rigid_of(rotation: Matrix | None, translation: Matrix | None) -> Matrix | None:
    """A (4, 4) transform of nine and three numbers, None unless the nine are a rotation."""
    if rotation is None or translation is None:
        return None
    turn = rotation.reshape(3, 3)
    # Printed calibrations have seven digits; a camera's intrinsic matrix in the same place has not.
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3) or np.linalg.det(turn) < 0:
        return None
    return rigid(turn, translation)


@dataclass(frozen=True, slots=True)
class InertialRow:
    """A file of oxts/data: the unit's place, its attitude in `enu` and its motion."""

    stamp_s: float
    position: LatLon
    altitude_m: float
    enu_from_imu: Matrix
    """(3, 3)."""
    east_mps: float
    north_mps: float
    forward_mps: float
    yaw_rate_rps: float
    sd_m: float

    @property
    def motion(self) -> Motion:
        """Speed and yaw rate."""
        return Motion(self.stamp_s, self.forward_mps, self.yaw_rate_rps)

    def fix(self, lidar_from_imu: Matrix) -> GnssFix:
        """The fix of the `vehicle` frame's origin, on the road below the LiDAR."""
        imu_from_vehicle = np.linalg.inv(lidar_from_imu) @ np.linalg.inv(VEHICLE_FROM_LIDAR)
        offset_enu = self.enu_from_imu @ imu_from_vehicle[:3, 3]
        position, altitude_m = GeoOrigin(self.position, self.altitude_m).geodetic(offset_enu)
        forward = self.enu_from_imu @ imu_from_vehicle[:3, 0]
        speed_mps = math.hypot(self.east_mps, self.north_mps)
        return GnssFix(
            position,
            altitude_m,
            heading_from_yaw(math.atan2(forward[1], forward[0])),
            self.sd_m,
            self.sd_m,
            course_rad=heading_from_yaw(math.atan2(self.north_mps, self.east_mps)),
            speed_mps=speed_mps,
            stamp_s=self.stamp_s,
            antenna_m=OF_VEHICLE,
        )


def read_inertial(path: Path, stamp_s: float) -> InertialRow:
    """A file of oxts/data; `SourceError` if it is not whole.

    dataformat.txt: lat lon alt roll pitch yaw vn ve vf vl vu ax ay az af al au wx wy wz wf wl wu pos_accuracy ...;
    yaw is counter-clockwise from east, wu the turning rate about the unit's vertical axis.
    """
    try:
        values = numbers_of(path.read_text(errors="replace"), OXTS_VALUES)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    if values is None or abs(values[0]) > 90 or abs(values[1]) > 180:
        raise SourceError(f"{path}: expected the {OXTS_VALUES} numbers of oxts/dataformat.txt")
    roll, pitch, yaw = values[3:6]
    return InertialRow(
        stamp_s,
        LatLon(latitude_deg=float(values[0]), longitude_deg=float(values[1])),
        float(values[2]),
        rotation_about_z(float(yaw)) @ _about_y(float(pitch)) @ _about_x(float(roll)),
        east_mps=float(values[7]),
        north_mps=float(values[6]),
        forward_mps=float(values[8]),
        yaw_rate_rps=float(values[22]),
        sd_m=max(float(values[23]), LEAST_SD_M),
    )


LEAST_SD_M = 0.01
"""The unit states whole centimetres and at times 0."""


def _about_y(angle: float) -> Matrix:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])


def _about_x(angle: float) -> Matrix:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
