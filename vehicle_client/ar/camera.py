"""From the car's frame to pixels: the pinhole model, K [R | t] (the paper's printed matrix is not a valid one)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix, apply, inverse
from vehicle_client.sensing.calibration import CameraCalibration

NEAR_M = 0.5
"""Points nearer than this to the image plane are not drawn: the windscreen is between them and the eye."""


def project(camera: CameraCalibration, points_vehicle_m: NDArray[np.floating]) -> tuple[Matrix, Matrix]:
    """Pixels (N, 2) (u right, v down) and depths (N,) in metres of points (N, 3) in `vehicle`.

    Points behind `NEAR_M` get NaN pixels.
    """
    points = apply(inverse(camera.vehicle_from_camera), points_vehicle_m)
    depth_m = points[:, 2]
    visible = np.where(depth_m > NEAR_M, depth_m, np.nan)
    homogeneous = points @ camera.matrix.T
    return homogeneous[:, :2] / visible[:, None], depth_m


def is_inside(camera: CameraCalibration, pixels: Matrix) -> NDArray[np.bool_]:
    """Which pixels (N, 2) lie inside the image."""
    inside = (pixels >= 0) & (pixels < np.array([camera.width_px, camera.height_px]))
    return np.asarray(inside.all(axis=1))


def arcmin_px(camera: CameraCalibration, arcmin: float) -> float:
    """Height in pixels, at the image's middle, of a visual angle seen from the camera."""
    return float(camera.matrix[1, 1] * math.tan(math.radians(arcmin / 60)))
