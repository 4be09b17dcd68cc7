"""Drives in KITTI's layouts, written by the format's description."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np

from vehicle_client.frames import GeoOrigin

START_S = datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp()
SPEED_MPS = 8.0
HEADING_YAW_RAD = 0.5
"""Counter-clockwise from east."""


def cloud(seed: int, count: int = 300) -> np.ndarray:
    """(N, 4) float32 x, y, z, reflectance."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.normal(0, 15, (count, 3)), rng.random(count)]).astype("<f4")


def stamp(time_s: float) -> str:
    whole = math.floor(time_s)
    nanoseconds = round((time_s - whole) * 1e9)
    return f"{datetime.fromtimestamp(whole, UTC):%Y-%m-%d %H:%M:%S}.{nanoseconds:09d}\n"


def oxts_line(origin: GeoOrigin, index: int, accuracy_m: float = 0.05) -> str:
    """A car that drives along `HEADING_YAW_RAD` and turns at 0.1 rad/s in what the unit says."""
    along = SPEED_MPS * 0.1 * index * np.array([math.cos(HEADING_YAW_RAD), math.sin(HEADING_YAW_RAD), 0.0])
    position, altitude_m = origin.geodetic(along)
    north, east = SPEED_MPS * math.sin(HEADING_YAW_RAD), SPEED_MPS * math.cos(HEADING_YAW_RAD)
    values = [0.0] * 30
    values[:6] = [position.latitude_deg, position.longitude_deg, altitude_m, 0.0, 0.0, HEADING_YAW_RAD]
    values[6:9] = [north, east, SPEED_MPS]
    values[22], values[23] = 0.1, accuracy_m
    return " ".join(repr(v) for v in values)


def write_raw(folder: Path, origin: GeoOrigin, frames: int = 4) -> Path:
    """A `_sync` drive with its calibration of the day beside it."""
    drive = folder / "2011_09_26" / "2011_09_26_drive_0001_sync"
    for name in ("velodyne_points", "image_02", "oxts"):
        (drive / name / "data").mkdir(parents=True)
        (drive / name / "timestamps.txt").write_text("".join(stamp(START_S + 0.1 * i) for i in range(frames)))
    for index in range(frames):
        (drive / f"velodyne_points/data/{index:010d}.bin").write_bytes(cloud(index).tobytes())
        cv2.imwrite(str(drive / f"image_02/data/{index:010d}.png"), np.full((6, 8, 3), 40 + index, np.uint8))
        (drive / f"oxts/data/{index:010d}.txt").write_text(oxts_line(origin, index))
    (drive.parent / "calib_imu_to_velo.txt").write_text(
        "calib_time: 25-May-2012 16:47:16\nR: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n"
    )
    return drive


def write_odometry(folder: Path, frames: int = 4) -> Path:
    """A sequence whose camera drives along its z; the camera sits 0.27 m before and 0.08 m below the LiDAR."""
    sequence = folder / "sequences" / "07"
    (sequence / "velodyne").mkdir(parents=True)
    (sequence / "image_2").mkdir()
    (folder / "poses").mkdir()
    for index in range(frames):
        (sequence / f"velodyne/{index:06d}.bin").write_bytes(cloud(index).tobytes())
        cv2.imwrite(str(sequence / f"image_2/{index:06d}.png"), np.full((6, 8, 3), 40 + index, np.uint8))
    (sequence / "times.txt").write_text("".join(f"{0.1 * i:e}\n" for i in range(frames)))
    (sequence / "calib.txt").write_text("P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27\n")
    poses = (f"1 0 0 {0.02 * i} 0 1 0 0 0 0 1 {0.8 * i}\n" for i in range(frames))
    (folder / "poses/07.txt").write_text("".join(poses))
    return sequence
