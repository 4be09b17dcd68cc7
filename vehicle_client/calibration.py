"""Where the sensors sit on the car and how the camera sees: stated once a vehicle, never measured while driving."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vehicle_client.frames import Matrix, rigid

WHEELBASE_M = 2.7
"""Distance of the axles of a middle-sized car; turns the steering angle into the curvature of the path."""

CAMERA_AXES_IN_VEHICLE = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Columns: the camera's x (right), y (down) and z (forward) in the vehicle frame, for a camera that looks ahead."""


@dataclass(frozen=True, slots=True)
class CameraCalibration:
    """Pinhole camera: (3, 3) matrix K in pixels, image size, and its place on the car."""

    matrix: Matrix
    width_px: int
    height_px: int
    vehicle_from_camera: Matrix

    @classmethod
    def looking_ahead(
        cls, width_px: int, height_px: int, horizontal_fov_rad: float, vehicle_from_camera: Matrix
    ) -> CameraCalibration:
        """Camera with square pixels and its principal point in the middle of the image."""
        focal_px = width_px / 2 / math.tan(horizontal_fov_rad / 2)
        matrix = np.array([[focal_px, 0, width_px / 2], [0, focal_px, height_px / 2], [0, 0, 1]])
        return cls(matrix, width_px, height_px, vehicle_from_camera)

    def scaled(self, factor: float) -> CameraCalibration:
        """The same camera with an image `factor` times the size."""
        matrix = np.diag([factor, factor, 1.0]) @ self.matrix
        return CameraCalibration(
            matrix, round(self.width_px * factor), round(self.height_px * factor), self.vehicle_from_camera
        )


@dataclass(frozen=True, slots=True)
class VehicleCalibration:
    """Place of the LiDAR on the car, its class by name, and the camera if there is one."""

    vehicle_from_sensor: Matrix
    sensor: str
    camera: CameraCalibration | None = None

    @property
    def sensor_height_m(self) -> float:
        """Height of the LiDAR over the road."""
        return float(self.vehicle_from_sensor[2, 3])


def mounted_at(x_m: float, z_m: float) -> Matrix:
    """`vehicle_from_sensor` of a level sensor on the car's middle line."""
    return rigid(np.eye(3), np.array([x_m, 0.0, z_m]))


def curvature_of(steering_rad: float) -> float:
    """Curvature of the path, 1/m, positive to the left (kinematic bicycle model)."""
    return math.tan(steering_rad) / WHEELBASE_M
