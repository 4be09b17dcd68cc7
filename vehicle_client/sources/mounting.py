"""Where on the car a receiver and an inertial unit sit: what they measure is moved to the vehicle's origin."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vehicle_client.frames import GeoOrigin, Vector, rotation_about_z, yaw_from_heading
from vehicle_client.sources.frame import OF_VEHICLE, GnssFix


@dataclass(frozen=True, slots=True)
class Lever:
    """`antenna_m` (3,) in the `vehicle` frame, None where a recording does not say; and how far the inertial unit is
    turned to the left."""

    antenna_m: Vector | None = None
    imu_yaw_rad: float = 0.0

    def moved(self, fix: GnssFix) -> GnssFix:
        """The fix of the vehicle's origin, of a car that stands level.

        Without a heading it is of the road below the antenna.
        """
        if self.antenna_m is None:
            return fix
        ahead_m, left_m, up_m = (float(value) for value in self.antenna_m)
        if fix.heading_rad is None:
            return _moved(fix, np.array([0.0, 0.0, up_m]), (ahead_m, left_m, 0.0))
        return _moved(fix, rotation_about_z(yaw_from_heading(fix.heading_rad)) @ self.antenna_m, OF_VEHICLE)


def _moved(fix: GnssFix, offset_enu_m: Vector, is_of_m: tuple[float, float, float]) -> GnssFix:
    position, altitude_m = GeoOrigin(fix.position, fix.altitude_m).geodetic(-offset_enu_m)
    return replace(fix, position=position, altitude_m=altitude_m, antenna_m=is_of_m)
