"""Odometry from wheels and gyro: smooth, and wrong by a scale and a slow turn."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import pose

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class OdometryModel:
    """1 sigma of the errors: scale and turn are drawn once a drive, the attitude's noise is new each time."""

    scale_sd: float = 0.001
    yaw_sd_rad_per_m: float = math.radians(0.1) / 100
    attitude_sd_rad: float = math.radians(0.02)


class Odometer:
    """Starts level at the first pose, with x ahead."""

    def __init__(self, model: OdometryModel, rng: np.random.Generator) -> None:
        self._model, self._rng = model, rng
        self._scale = 1 + rng.normal(0, model.scale_sd)
        self._yaw_per_m = rng.normal(0, model.yaw_sd_rad_per_m)
        self._odom_from_street: FloatArray | None = None
        self._last_m, self._position_m, self._travelled_m = np.zeros(3), np.zeros(3), 0.0

    def measure(self, street_from_vehicle: FloatArray) -> FloatArray:
        """`odom_from_vehicle` (4, 4) after the way from the last pose to this one."""
        odom_from_street = self._started_at(street_from_vehicle)
        step = odom_from_street[:3, :3] @ (street_from_vehicle[:3, 3] - self._last_m)
        self._last_m = street_from_vehicle[:3, 3]
        self._travelled_m += float(np.linalg.norm(step))
        turned = pose(0, 0, 0, self._yaw_per_m * self._travelled_m)
        self._position_m = self._position_m + self._scale * (turned[:3, :3] @ step)
        roll, pitch = self._rng.normal(0, self._model.attitude_sd_rad, 2)
        odom_from_vehicle: FloatArray = turned @ odom_from_street @ street_from_vehicle
        odom_from_vehicle = odom_from_vehicle @ pose(0, 0, 0, 0.0, pitch, roll)
        odom_from_vehicle[:3, 3] = self._position_m
        return odom_from_vehicle

    def _started_at(self, street_from_vehicle: FloatArray) -> FloatArray:
        """`odom_from_street` (4, 4), fixed by the first pose."""
        if self._odom_from_street is None:
            x, y, z = (float(value) for value in street_from_vehicle[:3, 3])
            yaw = math.atan2(street_from_vehicle[1, 0], street_from_vehicle[0, 0])
            odom_from_street: FloatArray = np.asarray(np.linalg.inv(pose(x, y, z, yaw)), dtype=np.float64)
            self._odom_from_street, self._last_m = odom_from_street, street_from_vehicle[:3, 3]
        return self._odom_from_street
