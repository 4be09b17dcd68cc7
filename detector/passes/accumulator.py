"""What the last metres of road looked like: hits near the road of successive sweeps, in `odom`, with their origins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from detector.arrays import Float32Array, FloatArray, IntArray
from detector.errors import DetectorError
from detector.passes.height_grid import GridFrame, grid_frame
from detector.types import DetectorInput, FrameDetection

# Two sweeps from the same place say the same twice; standing still must not fill the memory.
KEYFRAME_SPACING_M = 0.3
# Beyond this range hits are too sparse and their pitch error too large to sharpen a shape.
MAX_RANGE_M = 12.0
# Behind this nothing of a place is kept: it was measured when it was passed.
FORGET_BEHIND_M = 30.0
# Holes and obstacles are within these residuals; cars and branches are above.
RESIDUAL_BAND_M = (-0.5, 0.6)
# Sweeps whose cells are searched together for what one of them hits once or twice.
RECENT_FRAMES = 10
# Poses that were written with four decimals are still rigid.
RIGID_TOLERANCE = 1e-3
# 30 m behind and 12 m around at 0.3 m spacing make 140; twice that bounds a car that drives in circles.
MAX_KEYFRAMES = 280


@dataclass(frozen=True, slots=True)
class Keyframe:
    """Hits of one sweep relative to its sensor's place: `origin_odom_m` (3,) + `offsets_m` (N, 3) are in `odom`."""

    origin_odom_m: FloatArray
    offsets_m: Float32Array


@dataclass(frozen=True, slots=True)
class Accumulator:
    """The keyframes of a drive's last metres, and the height grids of its last few, oldest first."""

    keyframes: tuple[Keyframe, ...] = ()
    recent: tuple[GridFrame, ...] = ()


@dataclass(frozen=True, slots=True)
class PlaceHits:
    """Hits around a place, in `odom`: points (N, 3), the frame (N,) of each, and the sensor's place (F, 3) by frame.

    `centre_odom_m` (2,) and `half_size_m` are the square window that was asked for.
    """

    points_m: FloatArray
    frame: IntArray
    origins_m: FloatArray
    centre_odom_m: FloatArray
    half_size_m: float

    @property
    def frames(self) -> int:
        """Number of sweeps with hits here."""
        return len(self.origins_m)


def accumulate(state: Accumulator, sweep: DetectorInput, detection: FrameDetection) -> Accumulator:
    """The state after one more sweep; the same state if the car has not moved since the last one kept.

    Raises DetectorError without `odom_from_sensor`, or with one that is not a rigid (4, 4) transform.
    """
    odom_from_sensor = _pose(sweep)
    origin = odom_from_sensor[:3, 3]
    if state.keyframes and np.linalg.norm(origin - state.keyframes[-1].origin_odom_m) < KEYFRAME_SPACING_M:
        return state
    keyframe = _keyframe(odom_from_sensor, sweep.points_m, detection.residual_m)
    cells = grid_frame(sweep.points_m, detection.residual_m, odom_from_sensor)
    forward = odom_from_sensor[:3, 0]
    near = tuple(k for k in state.keyframes if (k.origin_odom_m - origin) @ forward > -FORGET_BEHIND_M)
    return Accumulator((*near, keyframe)[-MAX_KEYFRAMES:], (*state.recent, cells)[-RECENT_FRAMES:])


def hits_around(state: Accumulator, centre_odom_xy: FloatArray, half_size_m: float = 1.5) -> PlaceHits:
    """All hits in the square window about a place (2,) in `odom`; frames are renumbered from 0, oldest first."""
    centre = np.asarray(centre_odom_xy, dtype=np.float64)[:2]
    points, frames = [np.empty((0, 3))], [np.empty(0, dtype=np.int64)]
    origins: list[FloatArray] = []
    for keyframe in state.keyframes:
        middle = (centre - keyframe.origin_odom_m[:2]).astype(np.float32)
        if np.abs(middle).max() > MAX_RANGE_M + half_size_m:
            continue
        inside = _within(keyframe.offsets_m, middle, half_size_m)
        if inside.size:
            points.append(keyframe.offsets_m[inside].astype(np.float64) + keyframe.origin_odom_m)
            frames.append(np.full(inside.size, len(origins), dtype=np.int64))
            origins.append(keyframe.origin_odom_m)
    places = np.array(origins).reshape(-1, 3)
    return PlaceHits(np.concatenate(points), np.concatenate(frames), places, centre, half_size_m)


def _pose(sweep: DetectorInput) -> FloatArray:
    pose = sweep.odom_from_sensor
    if pose is None:
        raise DetectorError("accumulating needs odom_from_sensor: sweeps without a pose cannot be put together")
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise DetectorError("odom_from_sensor is not a finite (4, 4) transform")
    turn = pose[:3, :3]
    is_rigid = np.allclose(turn @ turn.T, np.eye(3), atol=RIGID_TOLERANCE) and np.linalg.det(turn) > 0.0
    if not is_rigid or not np.allclose(pose[3], (0.0, 0.0, 0.0, 1.0)):
        raise DetectorError("odom_from_sensor is no rigid transform: a turn and a place in metres are expected")
    return pose


def _keyframe(odom_from_sensor: FloatArray, points_m: Float32Array, residual_m: Float32Array) -> Keyframe:
    offsets = _turned_near(points_m, residual_m, np.ascontiguousarray(odom_from_sensor))
    return Keyframe(odom_from_sensor[:3, 3].copy(), offsets)


@njit(cache=True, nogil=True)
def _turned_near(points: Float32Array, residual: Float32Array, odom_from_sensor: FloatArray) -> Float32Array:
    """What is near and not far off the road, relative to the sensor in the axes of `odom`, (K, 3)."""
    turned, number = np.empty((len(points), 3), dtype=np.float32), 0
    for i in range(len(points)):
        x, y, z = np.float64(points[i, 0]), np.float64(points[i, 1]), np.float64(points[i, 2])
        near = x * x + y * y < MAX_RANGE_M * MAX_RANGE_M
        if near and RESIDUAL_BAND_M[0] < residual[i] < RESIDUAL_BAND_M[1]:
            for k in range(3):
                turned[number, k] = odom_from_sensor[k, 0] * x + odom_from_sensor[k, 1] * y + odom_from_sensor[k, 2] * z
            number += 1
    return turned[:number].copy()


@njit(cache=True, nogil=True)
def _within(offsets: Float32Array, middle: Float32Array, half_size: float) -> IntArray:
    """Indices of the rows whose first two values lie in a square."""
    inside, number = np.empty(len(offsets), dtype=np.int64), 0
    for i in range(len(offsets)):
        if abs(offsets[i, 0] - middle[0]) <= half_size and abs(offsets[i, 1] - middle[1]) <= half_size:
            inside[number] = i
            number += 1
    return inside[:number].copy()
