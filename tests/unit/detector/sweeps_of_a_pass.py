"""A drive past one place, as the accumulator sees it: poses a little wrong, odometry's way."""

from __future__ import annotations

import numpy as np

from detector.passes.accumulator import Accumulator, PlaceHits, accumulate, hits_around
from detector.types import DetectorInput, FrameDetection
from tests.unit.detector.scenes import Lidar, Street, cast

FRONT_AND_REAR = (-14.0, 14.0)
FRONT_ONLY = (-14.0, -3.9)


def detection_without_residual(count: int) -> FrameDetection:
    """An answer whose residuals keep every point: what the accumulator needs of `detect`."""
    zeros = np.zeros(count, dtype=np.float32)
    return FrameDetection(zeros.astype(np.uint8), zeros, zeros, ())


def drive_past(
    street: Street, x: float, y: float, lane: float, seed: int, stretch: tuple[float, float] = FRONT_AND_REAR
) -> Accumulator:
    """State after a pass at 1.4 m a sweep with 1 cm and 0.1 degree of pose noise; rays near the place only."""
    rng = np.random.default_rng(seed)
    state = Accumulator()
    for at in np.arange(x + stretch[0] + rng.uniform(0, 1.4), x + stretch[1], 1.4):
        points, pose = cast(street, Lidar(), float(at), lane, seed, (x, y, 2.6), float(rng.normal(0, 0.00175)))
        pose = pose.copy()
        pose[:3, 3] += rng.normal(0.0, 0.01, 3)
        sweep = DetectorInput(points, 2.4, odom_from_sensor=pose)
        state = accumulate(state, sweep, detection_without_residual(len(points)))
    return state


def hits_of_pass(
    street: Street,
    x: float,
    y: float,
    lane: float,
    seed: int,
    stretch: tuple[float, float] = FRONT_AND_REAR,
    half_size_m: float = 1.5,
) -> PlaceHits:
    """Hits about a place, looked up a little beside it, as a track's estimate would be."""
    return hits_around(drive_past(street, x, y, lane, seed, stretch), np.array([x + 0.1, y - 0.05]), half_size_m)
