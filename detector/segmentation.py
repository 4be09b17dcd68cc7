"""The five classes of a point, in the paper's colours."""

from __future__ import annotations

import numpy as np
from numba import njit

from detector.types import FloatArray, LabelArray, PointClass

# Off the road, what stands higher than a kerb is dangerous to drive into.
OUTSIDE_HEIGHT_M = 0.2
SAFE_ROAD, OUTSIDE = int(PointClass.SAFE_ROAD), int(PointClass.OUTSIDE)


def segment(
    height_m: FloatArray,
    safe: np.ndarray,
    below: np.ndarray,
    above: np.ndarray,
    on_obstacle: np.ndarray,
) -> LabelArray:
    """Classes (N,) uint8 of points.

    `height_m` is over the road's long profile; `safe`, `below`, `above` and `on_obstacle` are indices of points.
    """
    labels: LabelArray = _off_road(height_m)
    labels[safe] = PointClass.SAFE_ROAD
    labels[below] = PointClass.NEGATIVE
    labels[above] = PointClass.POSITIVE
    labels[on_obstacle] = PointClass.OBSTACLE
    return labels


@njit(cache=True, nogil=True)
def _off_road(height: FloatArray) -> LabelArray:
    labels = np.zeros(len(height), dtype=np.uint8)
    for i in range(len(height)):
        if height[i] > OUTSIDE_HEIGHT_M:
            labels[i] = OUTSIDE
    return labels
