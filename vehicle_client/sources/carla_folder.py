"""What the folder of one recorded vehicle holds: which frames, which pictures, how the wheels were turned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.carla_text import RecordedFrame, is_old_dialect, parse_metadata_line, read_carla_ply
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import SourceError

FULL_STEERING_RAD = math.radians(70.0)
"""The front wheels' angle at CARLA's steer of 1; CARLA steers to the right with positive numbers."""

SWEEPS_TO_TRY = 20
"""Sweeps among which one must show the road, for the dialect to be known."""

Rings = NDArray[np.uint16]
PointTimes = NDArray[np.float32]

LIDAR, CAMERA = "sensor.lidar.ray_cast", "sensor.camera.rgb"


def lidar_folder(ego: Path) -> Path:
    """The vehicle's LiDAR, rather than its semantic one; `SourceError` where there is none."""
    found = sorted(p for p in ego.glob(f"{LIDAR}*") if (p / "lidar_metadata.txt").is_file())
    plain = [p for p in found if not p.name.startswith(f"{LIDAR}_semantic")]
    if not found:
        raise SourceError(
            f"{ego}: expected a recording in CARLA's layout: {LIDAR}/NNNNN.ply and {LIDAR}/lidar_metadata.txt in it"
        )
    return (plain or found)[0]


def recorded_frames(lidar: Path, complaints: Complaints) -> tuple[list[RecordedFrame], list[int]]:
    """The frames whose sweep is there, in order; and the numbers of all that were recorded."""
    text = (lidar / "lidar_metadata.txt").read_text(errors="replace")
    frames: dict[int, RecordedFrame] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        frame = parse_metadata_line(line)
        if frame is None and line.strip():
            complaints.add(f"{lidar / 'lidar_metadata.txt'}, line {number}: not a measurement and its transform")
        elif frame is not None:
            frames[frame.number] = frame
    there = {number for number, _ in numbered(lidar, "ply")}
    for number in sorted(frames.keys() - there):
        complaints.add(f"{lidar}: the sweep of frame {number} is missing")
    for number in sorted(there - frames.keys()):
        complaints.add(f"{lidar}: lidar_metadata.txt has no line for frame {number}")
    usable = [frames[number] for number in sorted(frames.keys() & there)]
    if not usable:
        raise SourceError(f"{lidar}: expected sweeps NNNNN.ply that lidar_metadata.txt has lines for, found none")
    return usable, sorted(frames)


def numbered(folder: Path, ending: str) -> list[tuple[int, Path]]:
    """Files named by a frame's number, in order."""
    return sorted((int(p.stem), p) for p in folder.glob(f"*.{ending}") if p.stem.isascii() and p.stem.isdigit())


def sweep_path(lidar: Path, number: int) -> Path:
    """A frame's sweep; numbers have five digits or more."""
    return lidar / f"{number:05d}.ply"


def find_dialect(lidar: Path, frames: Sequence[RecordedFrame]) -> bool:
    """Whether the recording has the axes of CARLA before 0.9.10, by the first sweep that tells."""
    reason = SourceError(f"{lidar}: no sweeps")
    for frame in frames[:SWEEPS_TO_TRY]:
        try:
            return is_old_dialect(read_carla_ply(sweep_path(lidar, frame.number)))
        except SourceError as error:
            reason = error
    raise SourceError(f"{lidar}: none of the first sweeps can be used: {reason}")


def read_point_times(lidar: Path, number: int, count: int) -> tuple[Rings, PointTimes] | None:
    """Ring and seconds after the stamp of each point, which our own recordings keep beside the sweep (`labels`).

    None where they are not there; `SourceError` where they do not fit the sweep.
    """
    path = lidar / "labels" / f"{number:05d}.npz"
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as labels:
            ring, time_s = np.asarray(labels["ring"]), np.asarray(labels["time_offset_s"])
    except Exception as error:  # NumPy's and zipfile's parsers raise a dozen types where bytes make no sense
        raise SourceError(f"{path}: expected ring and time_offset_s of each point") from error
    fits = ring.shape == time_s.shape == (count,) and ring.dtype == np.uint16 and time_s.dtype == np.float32
    if not fits or not np.isfinite(time_s).all():
        raise SourceError(f"{path}: ring and time_offset_s do not fit the {count} points of the sweep")
    return ring, time_s


def picture_paths(ego: Path) -> list[tuple[int, Path]]:
    """The pictures of the vehicle's first camera, by frame."""
    cameras = sorted(p for p in ego.glob(f"{CAMERA}*") if p.is_dir())
    return numbered(cameras[0], "png") if cameras else []


def read_steering(ego: Path, numbers: Sequence[int], complaints: Complaints) -> dict[int, float]:
    """The front wheels' angle at each frame, positive to the left; none where values and frames cannot be paired."""
    path = ego / "steering_norm.txt"
    if not path.is_file():
        return {}
    try:
        values = [float(word) for word in path.read_text().replace(",", " ").split()]
    except ValueError:
        complaints.add(f"{path}: expected numbers, separated by commas")
        return {}
    if len(values) != len(numbers) or not all(math.isfinite(value) for value in values):
        complaints.add(f"{path}: {len(values)} values do not fit {len(numbers)} frames")
        return {}
    return {number: -value * FULL_STEERING_RAD for number, value in zip(numbers, values, strict=True)}
