"""Potholes before a depth camera: how many are found, and their volume beside what was filled in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detector.types import DetectedObstacle
from evaluation.composed_scan import ScanError
from evaluation.survey_detection import detect_survey

# Measured by filling with sand, by the scans' authors.
SAND_M3 = {"p1": 0.001036, "p2": 0.001761}


@dataclass(frozen=True, slots=True)
class CameraScan:
    """What is found in one scan, and the sand's volume in m3 where it is known."""

    name: str
    points: int
    obstacles: tuple[DetectedObstacle, ...]
    sand_m3: float | None

    def record(self) -> dict[str, object]:
        """As JSON, lengths in metres."""
        return {
            "scan": self.name,
            "points": self.points,
            "sand_m3": self.sand_m3,
            "obstacles": [
                {
                    "kind": o.kind.value,
                    "length_m": o.length_m,
                    "width_m": o.width_m,
                    "depth_m": o.relief_m,
                    "volume_m3": o.volume_m3,
                    "confidence": o.confidence,
                }
                for o in self.obstacles
            ],
        }


def camera_scans_in(folder: Path) -> list[Path]:
    """The PLY files of a folder's `pothole_rgbd`, or its own. Raises ScanError where there are none."""
    found = sorted((folder / "pothole_rgbd").glob("*.ply")) or sorted(folder.glob("*.ply"))
    if not found:
        raise ScanError(f"{folder}: no *.ply there nor in {folder / 'pothole_rgbd'}; give --data the scans' folder")
    return found


def measure_scan(path: Path) -> CameraScan:
    """Detect in one scan. Raises ScanError for a file without points."""
    points = to_road_axes(read_camera_points(path))
    return CameraScan(path.stem, len(points), detect_survey(points).obstacles, SAND_M3.get(path.stem))


def read_camera_points(path: Path) -> NDArray[np.float64]:
    """Points (N, 3) in metres in the file's axes. Raises ScanError."""
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        points = np.asarray(open3d.io.read_point_cloud(path).points, dtype=np.float64)
    if len(points) == 0:
        raise ScanError(f"{path}: no points were read: a PLY cloud is expected")
    return points


def to_road_axes(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 3) with z up, from a camera above the road.

    Files with depth as negative z (x right, y up, as OpenGL) look along -z and are right already; those with positive
    depth (x right, y down) are turned by half about x.
    """
    if float(np.median(points_m[:, 2])) > 0.0:
        return np.asarray(points_m * np.array([1.0, -1.0, -1.0]))
    return points_m
