"""The five classes of a point, in the paper's colours."""

from __future__ import annotations

import numpy as np

from detector.types import FloatArray, LabelArray, PointClass

# Off the road, what stands higher than a kerb is dangerous to drive into.
OUTSIDE_HEIGHT_M = 0.2


def segment(
    in_corridor: np.ndarray,
    height_m: FloatArray,
    below: np.ndarray,
    above: np.ndarray,
    on_obstacle: np.ndarray,
) -> LabelArray:
    """Classes (N,) uint8 of points.

    `in_corridor`, `below`, `above` and `on_obstacle` are masks (N,); `height_m` is above the ground below the car.
    """
    labels = np.zeros(in_corridor.size, dtype=np.uint8)
    labels[in_corridor] = PointClass.SAFE_ROAD
    labels[in_corridor & below] = PointClass.NEGATIVE
    labels[in_corridor & above] = PointClass.POSITIVE
    labels[~in_corridor & (height_m > OUTSIDE_HEIGHT_M)] = PointClass.OUTSIDE
    labels[on_obstacle] = PointClass.OBSTACLE
    return labels
