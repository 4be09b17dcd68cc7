"""Points of a sweep brought to one moment: a sensor that spins while the car drives draws a bent picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, Vector, rigid

Float32Array = NDArray[np.float32]

LONGEST_STEP_S = 0.5
"""Over a longer step between two poses, neither speed nor turn is constant."""


@dataclass(frozen=True, slots=True)
class Twist:
    """Constant motion of a frame in its own axes: velocity (3,) m/s and angular velocity (3,) rad/s."""

    velocity_mps: Vector
    angular_rps: Vector

    def now_from_then(self, after_s: float) -> Matrix:
        """(4, 4) pose of the frame `after_s` later (or earlier, if negative) in the frame now."""
        moved = _moved(np.vstack([np.zeros(3), np.eye(3)]).astype(np.float32), np.full(4, after_s), self)
        axes = moved.astype(np.float64)
        return rigid((axes[1:] - axes[0]).T, axes[0])


@dataclass(frozen=True, slots=True)
class Spin:
    """How a LiDAR turns: `end_azimuth_rad` (counter-clockwise from x) is where it looks at the sweep's stamp."""

    rate_hz: float
    clockwise: bool = True
    end_azimuth_rad: float = math.pi

    def point_time_s(self, points_m: Float32Array) -> Float32Array:
        """Seconds (N,) after the stamp, within the turn before it, at which points (N, 3) were measured."""
        azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
        turned = (azimuth - self.end_azimuth_rad) if self.clockwise else (self.end_azimuth_rad - azimuth)
        return np.asarray(-(turned % (2 * math.pi)) / (2 * math.pi * self.rate_hz), dtype=np.float32)


def twist_between(before_from_now: Matrix, elapsed_s: float, longest_s: float = LONGEST_STEP_S) -> Twist | None:
    """The constant motion that leads from one pose of a frame to the next, (4, 4); None for a step over `longest_s`.

    It is a screw (the logarithm of the rigid motion), so that a car in a curve moves on an arc.
    """
    if not 0 < elapsed_s <= longest_s or not np.isfinite(before_from_now).all():
        return None
    turn = Rotation.from_matrix(before_from_now[:3, :3]).as_rotvec()
    angle = float(np.linalg.norm(turn))
    cross = np.cross(np.eye(3), turn)
    # Inverse of the left Jacobian of SO(3); 1/12 is the limit of the factor for small angles.
    factor = 1 / 12 if angle < 1e-4 else (1 - angle / 2 / math.tan(angle / 2)) / angle**2
    left = np.eye(3) - cross / 2 + factor * cross @ cross
    return Twist(left @ before_from_now[:3, 3] / elapsed_s, turn / elapsed_s)


def deskew(points_m: Float32Array, point_time_s: Float32Array, twist: Twist) -> Float32Array:
    """Points (N, 3), each measured `point_time_s` (N,) after the stamp in the sensor's frame of that moment, in its
    frame at the stamp, when the sensor moves by `twist`. A time beyond `LONGEST_STEP_S`, or none at all, counts as 0.

    Raises `ValueError` if there are not as many times as points.
    """
    if point_time_s.shape != (len(points_m),):
        raise ValueError(f"{len(points_m)} points need as many times, not {point_time_s.shape}")
    said = np.asarray(point_time_s, dtype=np.float64)
    return _moved(points_m, np.where(np.abs(said) <= LONGEST_STEP_S, said, 0.0), twist)


def _moved(points_m: Float32Array, times_s: Vector, twist: Twist) -> Float32Array:
    rate = float(np.linalg.norm(twist.angular_rps))
    axis = twist.angular_rps / rate if rate > 0 else np.array([0.0, 0.0, 1.0])
    moved = np.empty((len(points_m), 3), dtype=np.float32)
    _move(np.ascontiguousarray(points_m, dtype=np.float32), times_s, twist.velocity_mps, axis, max(rate, 1e-9), moved)
    return moved


@numba.njit(cache=True)
def _move(
    points: Float32Array, times: Vector, velocity: Vector, axis: Vector, rate: float, moved: Float32Array
) -> None:
    """Rodrigues' formula for each point, and the way of a constant screw."""
    ax, ay, az = axis[0], axis[1], axis[2]
    vx, vy, vz = velocity[0], velocity[1], velocity[2]
    wx, wy, wz = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
    along = ax * vx + ay * vy + az * vz
    for i in range(len(points)):
        x, y, z, t = points[i, 0], points[i, 1], points[i, 2], times[i]
        s, c = math.sin(rate * t), 1.0 - math.cos(rate * t)
        dot = ax * x + ay * y + az * z
        straight, bent, screw = s / rate, c / rate, (t - s / rate) * along
        moved[i, 0] = x + s * (ay * z - az * y) + c * (ax * dot - x) + straight * vx + bent * wx + screw * ax
        moved[i, 1] = y + s * (az * x - ax * z) + c * (ay * dot - y) + straight * vy + bent * wy + screw * ay
        moved[i, 2] = z + s * (ax * y - ay * x) + c * (az * dot - z) + straight * vz + bent * wz + screw * az
