from __future__ import annotations

import math

import numpy as np
import pytest

from simulator.mesh import pose
from simulator.sensors.camera import CameraModel
from simulator.streets.street import fill
from simulator.world import World

CAMERA = CameraModel(width_px=320, height_px=180)


def pixel_of(camera: CameraModel, street_from_vehicle: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    camera_from_street = np.linalg.inv(street_from_vehicle @ camera.vehicle_from_camera)
    ray = camera_from_street[:3, :3] @ point_m + camera_from_street[:3, 3]
    return (camera.matrix @ ray)[:2] / ray[2]


def test_the_camera_looks_ahead_and_a_little_down() -> None:
    rotation = CAMERA.vehicle_from_camera[:3, :3]
    assert np.linalg.det(rotation) == pytest.approx(1)
    forward = rotation @ np.array([0.0, 0.0, 1.0])
    assert forward[0] > 0.99
    assert forward[2] < 0
    assert 2 * math.atan(CAMERA.width_px / 2 / CAMERA.focal_px) == pytest.approx(CAMERA.horizontal_fov_rad)


def test_a_picture_is_bgr_bytes_of_the_size_asked_for_and_repeats(world: World) -> None:
    at = pose(208.0, -1.75, -0.03)
    image = world.render(CAMERA, at)
    assert image.shape == (180, 320, 3)
    assert image.dtype == np.uint8
    assert image.tobytes() == world.render(CAMERA, at).tobytes()


def test_the_sky_is_blue_and_brighter_than_the_road(world: World) -> None:
    image = world.render(CAMERA, pose(150.0, -1.75, -0.03)).astype(float)
    sky, road = image[:20, 150:190].mean(axis=(0, 1)), image[150:, 130:200].mean(axis=(0, 1))
    assert sky[0] > sky[2]
    assert sky.mean() > road.mean()
    assert np.ptp(road) < 25


def test_the_pothole_is_drawn_where_it_projects_and_darker_than_the_road(world: World) -> None:
    at = pose(208.0, -1.75, -0.03)
    hole = world.street.obstacle(1)
    with_hole = world.render(CAMERA, at, supersample=2).astype(float)
    changed = np.abs(with_hole - World(fill(world.street, 1)).render(CAMERA, at, supersample=2)).max(axis=2) > 12
    rows, columns = np.nonzero(changed)
    u, v = pixel_of(CAMERA, at, np.array([hole.x_m, hole.y_m, -0.05]))
    assert np.median(columns) == pytest.approx(u, abs=4)
    assert np.median(rows) == pytest.approx(v, abs=4)
    inside = with_hole[round(v) - 1 : round(v) + 2, round(u) - 3 : round(u) + 4].mean()
    beside = with_hole[round(v) + 12 : round(v) + 16, round(u) - 3 : round(u) + 4].mean()
    assert inside < 0.75 * beside


def test_supersampling_smooths_and_keeps_the_brightness(world: World) -> None:
    at = pose(208.0, -1.75, -0.03)
    plain, smooth = (world.render(CAMERA, at, supersample=n).astype(float) for n in (1, 3))
    assert np.abs(np.diff(smooth, axis=1)).mean() < np.abs(np.diff(plain, axis=1)).mean()
    assert smooth.mean() == pytest.approx(plain.mean(), rel=0.03)
