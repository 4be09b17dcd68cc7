"""The pinhole camera: known points fall on known pixels."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import camera_ahead
from vehicle_client.ar.camera import NEAR_M, arcmin_px, is_inside, project

CAMERA = camera_ahead(1280, 720, fov_deg=90)


@pytest.mark.parametrize(
    ("point_m", "pixel"),
    [
        ((11.5, 0.0, 1.3), (640, 360)),
        ((11.5, 10.0, 1.3), (0, 360)),
        ((11.5, -5.0, 1.3), (960, 360)),
        ((11.5, 0.0, 0.0), (640, 443.2)),
        ((21.5, 0.0, 2.3), (640, 328)),
    ],
)
def test_known_points_fall_on_known_pixels(point_m: tuple[float, float, float], pixel: tuple[float, float]) -> None:
    pixels, depth_m = project(CAMERA, np.array([point_m]))
    assert pixels[0] == pytest.approx(pixel)
    assert depth_m[0] == pytest.approx(point_m[0] - 1.5)


def test_what_is_behind_the_windscreen_has_no_pixel() -> None:
    points = np.array([[1.5 + NEAR_M - 0.01, 0, 1], [1.5, 0, 1.3], [-10, 2, 0], [1.5 + NEAR_M + 0.01, 0, 1.3]])
    pixels, depth_m = project(CAMERA, points)
    assert np.isnan(pixels[:3]).all()
    assert np.isfinite(pixels[3]).all()
    assert (depth_m[:3] < NEAR_M).all()
    assert is_inside(CAMERA, pixels).tolist() == [False, False, False, True]


def test_nothing_projects_to_nothing() -> None:
    pixels, depth_m = project(CAMERA, np.empty((0, 3)))
    assert (pixels.shape, depth_m.shape) == ((0, 2), (0,))
    assert is_inside(CAMERA, pixels).shape == (0,)


@given(st.floats(3, 200), st.floats(-50, 50), st.floats(-2, 5), st.floats(1.1, 10))
def test_points_on_one_ray_share_a_pixel_and_left_and_up_stay_so(
    x_m: float, y_m: float, z_m: float, times: float
) -> None:
    eye = CAMERA.vehicle_from_camera[:3, 3]
    near = np.array([x_m, y_m, z_m])
    pixels, depth_m = project(CAMERA, near + np.array([[0, 0, 0], (times - 1) * (near - eye), [0, 1, 0], [0, 0, 1]]))
    assert pixels[1] == pytest.approx(pixels[0], abs=1e-6)
    assert depth_m[1] == pytest.approx(times * depth_m[0])
    assert pixels[2, 0] < pixels[0, 0]
    assert pixels[3, 1] < pixels[0, 1]


def test_an_image_ends_at_its_size() -> None:
    pixels = np.array([[0.0, 0.0], [1279.9, 719.9], [1280.0, 5.0], [5.0, 720.0], [-0.1, 5.0], [np.nan, 5.0]])
    assert is_inside(CAMERA, pixels).tolist() == [True, True, False, False, False, False]


def test_twenty_arcmin_at_a_hundred_metres_are_58_centimetres() -> None:
    pixels, _ = project(CAMERA, np.array([[101.5, 0, 1.3], [101.5, 0, 1.3 + 100 * math.tan(math.radians(1 / 3))]]))
    assert arcmin_px(CAMERA, 20.0) == pytest.approx(pixels[0, 1] - pixels[1, 1])
