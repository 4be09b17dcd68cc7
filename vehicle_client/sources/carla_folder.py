"""What the folder of one recorded vehicle holds: which frames, which pictures, how the wheels were turned."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.carla_text import RecordedFrame, is_old_dialect, parse_metadata_line, read_carla_ply
from vehicle_client.sources.frame import SourceError

LOG = logging.getLogger(__name__)

FULL_STEERING_RAD = math.radians(70.0)
"""The front wheels' angle at CARLA's steer of 1; CARLA steers to the right with positive numbers."""

SWEEPS_TO_TRY = 20
"""Sweeps among which one must show the road, for the dialect to be known."""

PNG_END = b"IEND\xaeB`\x82"

LIDAR, CAMERA = "sensor.lidar.ray_cast", "sensor.camera.rgb"


@dataclass(slots=True)
class Complaints:
    """What of a recording could not be used: a warning each, and their number."""

    count: int = field(default=0, init=False)

    def add(self, message: str) -> None:
        """Log one and count it."""
        self.count += 1
        LOG.warning("%s", message)


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


def picture_paths(ego: Path) -> list[tuple[int, Path]]:
    """The pictures of the vehicle's first camera, by frame."""
    cameras = sorted(p for p in ego.glob(f"{CAMERA}*") if p.is_dir())
    return numbered(cameras[0], "png") if cameras else []


def read_picture(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 BGR; `SourceError` where the file is not whole: OpenCV would fill what is missing with grey."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data.endswith(PNG_END) else None
    except cv2.error:
        image = None
    if image is None:
        raise SourceError(f"{path}: expected a whole PNG picture")
    return np.asarray(image, dtype=np.uint8)


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
