"""What the detector says of real, sound roads: every obstacle is a false alarm or has to be explained."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detector.arrays import Float32Array
from detector.passes.accumulator import Accumulator, accumulate
from detector.passes.over_frames import detect_over_frames
from detector.pipeline import detect, estimate_sensor_height
from detector.types import DetectedObstacle, DetectorInput
from evaluation.carving import read_scan

FloatArray = NDArray[np.float64]

# A place that is called a hole in so many sweeps, each within so much of the first, lasts.
LASTING_SWEEPS, SAME_PLACE_M = 3, 0.7
# The map that sweeps are matched to: KISS-ICP's own default, a hundredth of its range.
VOXEL_M = 1.0


@dataclass(frozen=True, slots=True)
class RealSweep:
    """One sweep of a drive: obstacles of the sweep and of the last ten together, in `sensor`, and the pose."""

    path: Path
    of_sweep: tuple[DetectedObstacle, ...]
    together: tuple[DetectedObstacle, ...]
    odom_from_sensor: FloatArray


def single_sweeps(paths: Sequence[Path]) -> Iterator[tuple[Path, tuple[DetectedObstacle, ...]]]:
    """The obstacles of each sweep alone."""
    for path in paths:
        points = read_scan(path)
        yield path, detect(DetectorInput(points, estimate_sensor_height(points))).obstacles


def along_a_drive(paths: Sequence[Path]) -> Iterator[RealSweep]:
    """The obstacles of each sweep of a drive without poses: they come from matching the sweeps (KISS-ICP).

    One sensor height for all, the first sweep's; the steering is unknown.
    """
    matcher = _Matcher()
    state = Accumulator()
    height_m: float | None = None
    for path in paths:
        points = read_scan(path)
        height_m = height_m or estimate_sensor_height(points)
        sweep = DetectorInput(points, height_m, 0.0, matcher.pose_of(points))
        detection = detect(sweep)
        state = accumulate(state, sweep, detection)
        pose = sweep.odom_from_sensor
        if pose is not None:
            yield RealSweep(path, detection.obstacles, detect_over_frames(state, sweep, detection), pose)


class _Matcher:
    """KISS-ICP (Vizzo et al., 2023) without deskewing: KITTI's sweeps are already rectified."""

    def __init__(self) -> None:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.mapping.voxel_size = VOXEL_M
        config.data.deskew = False
        config.registration.max_num_threads = 1
        self._odometry = KissICP(config)

    def pose_of(self, points_m: Float32Array) -> FloatArray:
        """(4, 4) pose of the next sweep in the frame of the first."""
        self._odometry.register_frame(points_m.astype(np.float64), np.empty(0))
        return np.asarray(self._odometry.last_pose, dtype=np.float64)


def lasting_holes(sweeps: Sequence[RealSweep], *, together: bool) -> list[tuple[FloatArray, int]]:
    """Places (2,) in `odom` that several sweeps call a hole, and how many do."""
    places: list[list[FloatArray]] = []
    last_seen: list[int] = []
    for number, sweep in enumerate(sweeps):
        for obstacle in sweep.together if together else sweep.of_sweep:
            if not obstacle.kind.is_negative:
                continue
            place = (sweep.odom_from_sensor @ np.r_[obstacle.centre_m, 1.0])[:2]
            near = [k for k, seen in enumerate(places) if np.hypot(*(seen[0] - place)) < SAME_PLACE_M]
            if not near:
                places.append([place])
                last_seen.append(number)
            elif last_seen[near[0]] != number:
                places[near[0]].append(place)
                last_seen[near[0]] = number
    return [(np.mean(seen, axis=0), len(seen)) for seen in places if len(seen) >= LASTING_SWEEPS]
