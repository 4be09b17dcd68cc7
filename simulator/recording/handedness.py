"""Between our right-handed frames and CARLA's left-handed ones; nothing else in the simulator knows of the latter.

CARLA (Unreal): x forward, y right, z up; yaw turns to the right, pitch lifts the nose, roll lowers the right side, in
degrees, applied as yaw, then pitch, then roll. Mirroring y turns one into the other, for the world and a sensor alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, slots=True)
class CarlaTransform:
    """A pose as CARLA writes it: metres and degrees, left-handed."""

    x: float
    y: float
    z: float
    pitch: float
    yaw: float
    roll: float

    def __str__(self) -> str:
        """CARLA's own text, six decimals each."""
        x, y, z, pitch, yaw, roll = (
            f"{value:.6f}" for value in (self.x, self.y, self.z, self.pitch, self.yaw, self.roll)
        )
        return f"Transform(Location(x={x}, y={y}, z={z}), Rotation(pitch={pitch}, yaw={yaw}, roll={roll}))"


def carla_transform(a_from_b: FloatArray) -> CarlaTransform:
    """CARLA's form of a (4, 4) right-handed rigid transform; pitch in [-90, 90], yaw and roll in [-180, 180].

    The rotation is read off the matrix of `carla.Transform.get_matrix`. Looking straight up or down, where yaw and roll
    turn about the same axis, all of it counts as yaw.
    """
    m = MIRROR @ a_from_b @ MIRROR
    level = math.hypot(m[0, 0], m[1, 0])
    pitch = math.atan2(m[2, 0], level)
    if level > 1e-9:
        yaw, roll = math.atan2(m[1, 0], m[0, 0]), math.atan2(-m[2, 1], m[2, 2])
    else:
        yaw, roll = math.atan2(-m[0, 1], m[1, 1]), 0.0
    x, y, z = (float(value) for value in m[:3, 3])
    return CarlaTransform(x, y, z, *(math.degrees(angle) for angle in (pitch, yaw, roll)))


def right_handed_transform(pose: CarlaTransform) -> FloatArray:
    """(4, 4) right-handed rigid transform of CARLA's form."""
    pitch, yaw, roll = (math.radians(angle) for angle in (pose.pitch, pose.yaw, pose.roll))
    cp, sp, cy, sy, cr, sr = (f(a) for a in (pitch, yaw, roll) for f in (math.cos, math.sin))
    left_handed = np.array(
        [
            [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr, pose.x],
            [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr, pose.y],
            [sp, -cp * sr, cp * cr, pose.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    return np.asarray(MIRROR @ left_handed @ MIRROR)


def mirrored_points(points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Points (N, 3) with y turned round: from either hand to the other."""
    return points_m * np.array([1, -1, 1], dtype=np.float32)
