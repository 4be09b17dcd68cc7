"""Real scans of sound roads stay empty of potholes."""

from __future__ import annotations

import os
from pathlib import Path

import laspy
import numpy as np
import pytest

from detector.pipeline import detect, estimate_sensor_height
from detector.types import DetectorInput, ObstacleKind

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[4] / "shared" / "data"))

pytestmark = pytest.mark.realdata


def frames(pattern: str) -> list[Path]:
    found = sorted(DATA.glob(pattern))
    if not found:
        pytest.skip(f"no {pattern} under {DATA}: set HEADSUP_DATA")
    return found


def potholes_in(points: np.ndarray, sensor_height_m: float) -> int:
    detection = detect(DetectorInput(np.ascontiguousarray(points, dtype=np.float32), sensor_height_m))
    return sum(o.kind is ObstacleKind.POTHOLE for o in detection.obstacles)


def test_sixteen_kitti_frames_have_at_most_one_false_pothole() -> None:
    scans = [np.fromfile(f, np.float32).reshape(-1, 4)[:, :3] for f in frames("kitti_sequence/velodyne/*.bin")]
    assert sum(potholes_in(scan, 1.73) for scan in scans) <= 1


def test_along_a_kitti_drive_false_potholes_are_fewer_than_one_a_frame() -> None:
    clouds = [laspy.read(f) for f in frames("kitti_drive/*.laz")[::15]]
    counts = [potholes_in(np.stack([c.x, c.y, c.z], axis=1), 1.73) for c in clouds]
    assert np.mean(counts) < 1.0


def test_a_thirty_two_beam_frame_is_read_with_its_estimated_height() -> None:
    raw = np.fromfile(frames("nuscenes/*.bin")[0], np.float32).reshape(-1, 5)
    forward = np.stack([raw[:, 1], -raw[:, 0], raw[:, 2]], axis=1)
    height = estimate_sensor_height(forward)
    assert height == pytest.approx(1.84, abs=0.1)
    assert potholes_in(forward, height) == 0
