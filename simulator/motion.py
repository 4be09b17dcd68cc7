"""Where a body is at any time: what carries sensors and what moves through the street."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class Motion(Protocol):
    """A rigid body's movement, smooth enough to be differentiated twice."""

    def poses(self, time_s: FloatArray) -> FloatArray:
        """`street_from_body` (N, 4, 4) at times (N,) of the world's clock."""
        ...


@dataclass(frozen=True, slots=True)
class Standing:
    """A body that stays at one (4, 4) pose."""

    street_from_body: FloatArray

    def poses(self, time_s: FloatArray) -> FloatArray:
        """The same pose at every time."""
        return np.broadcast_to(self.street_from_body, (len(time_s), 4, 4))


@dataclass(frozen=True, slots=True)
class Carried:
    """A body fixed to another one: a sensor on its vehicle."""

    carrier: Motion
    carrier_from_body: FloatArray

    def poses(self, time_s: FloatArray) -> FloatArray:
        """The carrier's poses, with the mounting applied."""
        return np.asarray(self.carrier.poses(time_s) @ self.carrier_from_body)


def rigid(position_m: FloatArray, yaw_rad: FloatArray, pitch_rad: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """(N, 4, 4) poses at positions (N, 3): turned by roll about x, then pitch about y (nose down), then yaw about z."""
    cy, cp, cr = np.cos(yaw_rad), np.cos(pitch_rad), np.cos(roll_rad)
    sy, sp, sr = np.sin(yaw_rad), np.sin(pitch_rad), np.sin(roll_rad)
    poses = np.zeros((len(position_m), 4, 4))
    poses[:, 0, :3] = np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], axis=1)
    poses[:, 1, :3] = np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], axis=1)
    poses[:, 2, :3] = np.stack([-sp, cp * sr, cp * cr], axis=1)
    poses[:, :3, 3] = position_m
    poses[:, 3, 3] = 1.0
    return poses
