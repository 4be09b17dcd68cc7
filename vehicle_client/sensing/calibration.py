"""Where the sensors sit on the car and how the camera sees: stated once a vehicle, never measured while driving."""

from __future__ import annotations

import math
from dataclasses import dataclass

from vehicle_client.frames import Matrix

WHEELBASE_M = 2.7
"""Distance of the axles of a middle-sized car; turns the steering angle into the curvature of the path."""


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Pinhole camera: (3, 3) matrix K in pixels, image size, and its place on the car."""

    matrix: Matrix
    width_px: int
    height_px: int
    vehicle_from_camera: Matrix


@dataclass(frozen=True, slots=True)
class VehicleCalibration:
    """Place of the LiDAR on the car, and its class by name."""

    vehicle_from_sensor: Matrix
    sensor: str

    @property
    def sensor_height_m(self) -> float:
        """Height of the LiDAR over the road."""
        return float(self.vehicle_from_sensor[2, 3])


def curvature_of(steering_rad: float, wheelbase_m: float = WHEELBASE_M) -> float:
    """Curvature of the path, 1/m, positive to the left (kinematic bicycle model)."""
    return math.tan(steering_rad) / wheelbase_m
