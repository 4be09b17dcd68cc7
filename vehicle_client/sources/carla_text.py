"""The texts that CARLA writes: sweeps as ASCII PLY, transforms as lines; turned to our right-handed frames here.

CARLA (since 0.9.10): x forward, y right, z up; yaw turns right, pitch lifts the nose, roll lowers the right side.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.number_text import parse_numbers

Float32Array = NDArray[np.float32]

_NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_LINE = re.compile(
    r"\s*\w+\(frame=(\d+), timestamp=" + _NUMBER + r"\D.*?"
    rf"Transform\(Location\(x={_NUMBER}, y={_NUMBER}, z={_NUMBER}\), "
    rf"Rotation\(pitch={_NUMBER}, yaw={_NUMBER}, roll={_NUMBER}\)\)\s*"
)

HEADER_BYTES = 4_096
"""CARLA's header has ten short lines."""

MOST_POINTS = 20_000_000
"""A hundred times what the densest LiDAR measures in a turn."""

ROAD_BELOW_M = (0.8, 5.0)
"""A LiDAR on a car or lorry is that high above the road."""

ROAD_WITHIN_M = 25.0
"""Farther out a road that rises or falls leaves the sensor's level plane."""


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """A line of lidar_metadata.txt: the frame's number, the world's time and `world_from_sensor` (4, 4), ours."""

    number: int
    time_s: float
    world_from_sensor: Matrix


@dataclass(frozen=True, slots=True)
class RecordedSweep:
    """Points (N, 3) as the file has them, and intensity (N,) if it is there."""

    raw_m: Float32Array
    intensity: Float32Array | None


def parse_metadata_line(line: str) -> RecordedFrame | None:
    """The frame that a line speaks of; None if it is not such a line."""
    found = _LINE.fullmatch(line)
    if found is None:
        return None
    x, y, z, pitch, yaw, roll = (float(value) for value in found.groups()[2:])
    transform = right_handed(np.array([x, y, z]), pitch, yaw, roll)
    return RecordedFrame(int(found[1]), float(found[2]), transform) if np.isfinite(transform).all() else None


def right_handed(location_m: Matrix, pitch_deg: float, yaw_deg: float, roll_deg: float) -> Matrix:
    """(4, 4) right-handed transform of a CARLA location (3,) and rotation: y, yaw and pitch change their sign.

    Turning about z by minus the yaw, then about y (left) by minus the pitch, then about x by the roll.
    """
    yaw, pitch, roll = math.radians(-yaw_deg), math.radians(-pitch_deg), math.radians(roll_deg)
    cy, sy, cp, sp, cr, sr = (f(a) for a in (yaw, pitch, roll) for f in (math.cos, math.sin))
    transform = np.eye(4)
    transform[:3, :3] = (
        np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    )
    transform[:3, 3] = location_m * [1, -1, 1]
    return transform


def read_carla_ply(path: Path) -> RecordedSweep:
    """A sweep as CARLA saves it; `SourceError` where it is not whole."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    header, found, body = data.partition(b"end_header\n")
    lines = header[:HEADER_BYTES].decode("ascii", "replace").split("\n")
    names = [line.split()[-1] for line in lines if line.startswith("property ")]
    counts = [line.split()[2] for line in lines if re.fullmatch(r"element vertex \d{1,9}", line)]
    if not found or "format ascii 1.0" not in lines or len(counts) != 1 or names[:3] != ["x", "y", "z"]:
        raise SourceError(f"{path}: expected an ASCII PLY file of CARLA with x, y, z")
    values = parse_numbers(body)
    if values is None:
        raise SourceError(f"{path}: expected nothing but numbers after the header")
    if int(counts[0]) > MOST_POINTS or len(values) != int(counts[0]) * len(names):
        raise SourceError(f"{path}: the header announces {counts[0]} points, the file holds {len(values)} numbers")
    if not len(values):
        raise SourceError(f"{path}: holds no points")
    rows = values.reshape(-1, len(names))
    return RecordedSweep(rows[:, :3], rows[:, names.index("I")].copy() if "I" in names else None)


def is_old_dialect(sweep: RecordedSweep) -> bool:
    """Whether a sweep has the axes of CARLA before 0.9.10, where z points down; `SourceError` if it cannot be told.

    Intensity came with 0.9.10. Without it the road tells: the densest level plane near the sensor lies below it.
    """
    if sweep.intensity is not None:
        return False
    x, y, z = sweep.raw_m.T
    near = np.isfinite(sweep.raw_m).all(axis=1) & (np.hypot(x, y) < ROAD_WITHIN_M)
    up, down = (_densest_level(sign * z[near]) for sign in (-1, 1))
    if up == down:
        raise SourceError("no road below the sensor tells which way z points: expected a CARLA sweep over a road")
    return down > up


def in_sensor_frame(sweep: RecordedSweep, old_dialect: bool) -> Float32Array:
    """Points (N, 3) with x forward, y left, z up.

    The old axes are right, back, down: -y, -x, -z (carla_ros_bridge 0.9.8, lidar.py).
    """
    x, y, z = sweep.raw_m.T
    return np.stack([-y, -x, -z] if old_dialect else [x, -y, z], axis=1)


def _densest_level(depth_m: Float32Array) -> int:
    """Most points in any 0.2 m of depth that a road can have."""
    counts, _ = np.histogram(depth_m, bins=21, range=ROAD_BELOW_M)
    return int(counts.max())
