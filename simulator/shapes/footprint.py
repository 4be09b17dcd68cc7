"""Footprints as polygons, for label files."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from simulator.shapes.debris import Debris
from simulator.shapes.relief import Relief

FloatArray = NDArray[np.float64]


def footprint_polygon(shape: Relief | Debris) -> FloatArray:
    """Corners (N, 2) of the footprint in metres about the shape's centre, counter-clockwise, not closed.

    Its box is the shape's length and width. Of a footprint in several pieces it is the largest.
    """
    if isinstance(shape, Debris):
        plan = shape.mesh.vertices_m[:, :2]
        return np.asarray(plan[ConvexHull(plan).vertices])
    contours, _ = cv2.findContours(shape.footprint.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cells = max(contours, key=cv2.contourArea)[:, 0].astype(np.float64)
    low, high = cells.min(axis=0), cells.max(axis=0)
    middle = (low + high) / 2
    # The contour joins the middles of the outermost cells; the footprint reaches half a cell farther.
    cells = middle + (cells - middle) * (1 + 1 / np.maximum(high - low, 1))
    origin = (np.array(shape.footprint.shape[::-1]) - 1) / 2
    corners = (cells - origin) * shape.step_m
    x, y = corners.T
    counter_clockwise = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) > 0
    return np.asarray(corners if counter_clockwise else corners[::-1])
