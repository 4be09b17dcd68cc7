"""The full segmentation view: every pixel in the colour of what the LiDAR saw there, the gaps between rays filled.

Points are projected as small discs, nearest last; empty pixels then take the class of their nearest painted
neighbour, step by step, so that a class grows over the gaps between scan lines but not into the sky.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.types import PointClass
from vehicle_client.ar.camera import is_inside, project
from vehicle_client.sensing.calibration import CameraCalibration

Image = NDArray[np.uint8]

COLOURS_BGR: NDArray[np.uint8] = np.array(
    [(128, 128, 128), (235, 110, 30), (40, 220, 250), (230, 220, 40), (190, 50, 150), (45, 40, 230)], dtype=np.uint8
)
"""The paper's colours by class: unclassified grey, safe blue, negative yellow, positive cyan, outside purple, red."""

OPACITY = 0.45
"""The road must be seen through the colours."""

OCCLUDER_MARGIN = 0.12
"""A point farther than its neighbour by this share of the range is behind it: the camera sits below the LiDAR."""

NOWHERE_M = 1e6
"""Depth of a pixel without a point: farther than any, and finite."""


def paint_classes(
    camera: CameraCalibration, points_vehicle_m: NDArray[np.floating], labels: NDArray[np.uint8], image: Image
) -> Image:
    """The image (H, W, 3) uint8 BGR under the colours of the classes of points (N, 3) in `vehicle`."""
    classes = filled(class_image(camera, points_vehicle_m, labels), steps=_gap_px(camera))
    return _blend(image, COLOURS_BGR[np.maximum(classes, 0)], classes > PointClass.UNCLASSIFIED)


def paint_saliency(
    camera: CameraCalibration, points_vehicle_m: NDArray[np.floating], saliency: NDArray[np.float32], image: Image
) -> Image:
    """The image under a heat map of the saliency [0, 1] of points (N, 3) in `vehicle`."""
    # Levels from 1, since 0 is an empty pixel.
    levels = 1 + np.rint(np.clip(saliency, 0, 1) * 254).astype(np.int16)
    filled_levels = filled(class_image(camera, points_vehicle_m, levels), steps=_gap_px(camera))
    heat = cv2.applyColorMap(np.clip(filled_levels - 1, 0, 254).astype(np.uint8), cv2.COLORMAP_TURBO)
    return _blend(image, np.asarray(heat, dtype=np.uint8), filled_levels > 0)


def class_image(
    camera: CameraCalibration, points_vehicle_m: NDArray[np.floating], values: NDArray[np.integer]
) -> NDArray[np.int16]:
    """(H, W) of the value of the nearest point on each pixel, -1 where there is none or only hidden ones."""
    pixels, depth_m = project(camera, points_vehicle_m)
    usable = np.flatnonzero(is_inside(camera, pixels))
    order = usable[np.argsort(-depth_m[usable], kind="stable")]
    u, v = pixels[order].astype(int).T
    nearest = np.full((camera.height_px, camera.width_px), NOWHERE_M, dtype=np.float32)
    classes = np.full(nearest.shape, -1, dtype=np.int16)
    # Farthest first: where several points share a pixel, the nearest is written last.
    nearest[v, u] = depth_m[order]
    classes[v, u] = values[order]
    kernel = np.ones((2 * _gap_px(camera) + 1,) * 2, np.uint8)
    front = cv2.erode(nearest, kernel)
    classes[nearest > front * (1 + OCCLUDER_MARGIN) + 0.5] = -1
    return classes


def filled(classes: NDArray[np.int16], steps: int) -> NDArray[np.int16]:
    """The image with empty pixels (-1) given the value of the nearest painted one, at most `steps` pixels away."""
    empty = (classes < 0).astype(np.uint8)
    distance, index = cv2.distanceTransformWithLabels(empty, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.full(int(index.max()) + 1, -1, dtype=np.int16)
    painted = empty == 0
    table[index[painted]] = classes[painted]
    return np.where(distance <= steps, table[index], np.int16(-1))


def _gap_px(camera: CameraCalibration) -> int:
    # Scan lines of a 64-channel LiDAR over 40 degrees lie 0.6 degrees apart, columns 0.9.
    return max(2, round(float(camera.matrix[0, 0]) * math.radians(0.8)))


def _blend(image: Image, colours: NDArray[np.uint8], where: NDArray[np.bool_]) -> Image:
    mixed = cv2.addWeighted(image, 1 - OPACITY, colours, OPACITY, 0)
    result: Image = np.where(where[..., None], mixed, image).astype(np.uint8)
    return result
