"""Where on the car a receiver and an inertial unit sit: what they measure is moved to the vehicle's origin."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from vehicle_client.frames import GeoOrigin, Vector, rotation_about_z, yaw_from_heading
from vehicle_client.sources.frame import GnssFix


@dataclass(frozen=True, slots=True)
class Lever:
    """`antenna_m` (3,) in the `vehicle` frame, and how far the inertial unit is turned to the left."""

    antenna_m: Vector = field(default_factory=lambda: np.zeros(3))
    imu_yaw_rad: float = 0.0

    def moved(self, fix: GnssFix) -> GnssFix:
        """The fix of the vehicle's origin, of a car that stands level; only its height where no heading is known."""
        if not self.antenna_m.any():
            return fix
        east_north = np.zeros(3)
        if fix.heading_rad is not None:
            east_north = rotation_about_z(yaw_from_heading(fix.heading_rad)) @ (self.antenna_m * [1, 1, 0])
        offset = east_north + self.antenna_m * [0, 0, 1]
        position, altitude_m = GeoOrigin(fix.position, fix.altitude_m).geodetic(-offset)
        return replace(fix, position=position, altitude_m=altitude_m)
