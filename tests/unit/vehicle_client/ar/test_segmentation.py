"""The full segmentation view: nearest surfaces win, gaps are filled, the sky stays empty."""

from __future__ import annotations

import math

import numpy as np
import pytest

from detector.types import PointClass
from vehicle_client.ar.segmentation import COLOURS_BGR, class_image, filled, paint_classes, paint_saliency
from vehicle_client.frames import rigid
from vehicle_client.sensing.calibration import CameraCalibration

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@pytest.fixture
def camera() -> CameraCalibration:
    focal_px = 160 / math.tan(math.radians(32))
    matrix = np.array([[focal_px, 0, 160], [0, focal_px, 90], [0, 0, 1.0]])
    return CameraCalibration(matrix, 320, 180, rigid(AHEAD, np.array([0.0, 0.0, 1.5])))


def road(step_m: float = 0.25) -> np.ndarray:
    x, y = np.meshgrid(np.arange(4, 30, step_m), np.arange(-4, 4, step_m))
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def test_gaps_between_points_take_the_class_of_the_road_around_them(camera: CameraCalibration) -> None:
    labels = np.full(len(road()), PointClass.SAFE_ROAD, np.uint8)
    image = class_image(camera, road(), labels)
    assert (image[130:160, 120:200] < 0).any()
    classes = filled(image, steps=8)
    assert (classes[130:175, 120:200] == PointClass.SAFE_ROAD).all()


def test_the_sky_keeps_its_picture(camera: CameraCalibration) -> None:
    image = np.full((180, 320, 3), 200, np.uint8)
    labels = np.full(len(road()), PointClass.SAFE_ROAD, np.uint8)
    painted = paint_classes(camera, road(), labels, image)
    assert (painted[:70] == 200).all()
    assert (painted[150, 160] != 200).any()


def test_what_stands_in_front_hides_what_lies_behind(camera: CameraCalibration) -> None:
    y, z = np.meshgrid(np.arange(-1, 1, 0.03), np.arange(0, 2.5, 0.03))
    car = np.column_stack([np.full(y.size, 8.0), y.ravel(), z.ravel()])
    wall = car * (5, 5, 1)
    labels = np.repeat([PointClass.POSITIVE, PointClass.OUTSIDE], len(car)).astype(np.uint8)
    classes = filled(class_image(camera, np.concatenate([car, wall]), labels), steps=4)
    assert (classes[80:100, 150:170] == PointClass.POSITIVE).all()


def test_unclassified_points_leave_the_picture_as_it_is(camera: CameraCalibration) -> None:
    image = np.random.default_rng(2).integers(0, 255, (180, 320, 3), dtype=np.uint8)
    labels = np.zeros(len(road()), np.uint8)
    assert (paint_classes(camera, road(), labels, image) == image).all()


def test_every_class_has_a_colour_of_its_own() -> None:
    assert len({tuple(c) for c in COLOURS_BGR.tolist()}) == len(PointClass)


def test_no_points_and_points_behind_paint_nothing(camera: CameraCalibration) -> None:
    image = np.full((180, 320, 3), 90, np.uint8)
    behind = -road()
    assert (paint_saliency(camera, np.empty((0, 3)), np.empty(0, np.float32), image) == image).all()
    assert (paint_saliency(camera, behind, np.ones(len(behind), np.float32), image) == image).all()
