"""The five classes of a point, in the paper's colours."""

from __future__ import annotations

import numpy as np
from numba import njit

from detector.arrays import FloatArray, IntArray, LabelArray
from detector.types import PointClass

# What stands higher than a kerb is dangerous to drive into.
STANDING_M = 0.2
# Off the road the ground may rise by the first over the road's long profile: where the hits of a square metre lie
# within the second of each other, they are a bank or a lawn and not a wall's foot.
BANK_M, BANK_RELIEF_M = 1.0, 0.4
CELL_M = 1.0
REACH_M = 60.0
UNCLASSIFIED, OUTSIDE = int(PointClass.UNCLASSIFIED), int(PointClass.OUTSIDE)


def segment(
    points_m: FloatArray,
    height_m: FloatArray,
    on_strip: IntArray,
    *,
    safe: np.ndarray,
    below: IntArray,
    above: IntArray,
    standing: np.ndarray,
    on_obstacle: IntArray,
) -> LabelArray:
    """Classes (N,) uint8 of points (N, 3).

    `height_m` (N,) is over the road's long profile, `on_strip` (S,) the indices of the strip of road. Of the strip are
    a mask of the road and of what stands on it, and indices of what deviates from it together, low and high, and of
    recognised obstacles.
    """
    classes = np.zeros(len(on_strip), dtype=np.uint8)
    classes[safe] = PointClass.SAFE_ROAD
    classes[below] = PointClass.NEGATIVE
    classes[above] = PointClass.POSITIVE
    classes[standing] = PointClass.POSITIVE
    classes[on_obstacle] = PointClass.OBSTACLE
    labels: LabelArray = _off_road(points_m, height_m)
    _write_known(classes, on_strip, labels)
    return labels


@njit(cache=True, nogil=True)
def _write_known(classes: LabelArray, on_strip: IntArray, labels: LabelArray) -> None:
    for i in range(len(classes)):
        if classes[i] != UNCLASSIFIED:
            labels[on_strip[i]] = classes[i]


@njit(cache=True, nogil=True)
def _off_road(points: FloatArray, height: FloatArray) -> LabelArray:
    """OUTSIDE for what stands, UNCLASSIFIED for flat ground."""
    cells = int(2.0 * REACH_M / CELL_M)
    lowest, highest = np.full((cells, cells), np.inf), np.full((cells, cells), -np.inf)
    for i in range(len(points)):
        row, column = int(np.floor((points[i, 0] + REACH_M) / CELL_M)), int(np.floor((points[i, 1] + REACH_M) / CELL_M))
        if 0 <= row < cells and 0 <= column < cells:
            lowest[row, column] = min(lowest[row, column], height[i])
            highest[row, column] = max(highest[row, column], height[i])
    labels = np.zeros(len(points), dtype=np.uint8)
    for i in range(len(points)):
        row, column = int(np.floor((points[i, 0] + REACH_M) / CELL_M)), int(np.floor((points[i, 1] + REACH_M) / CELL_M))
        is_bank = False
        if 0 <= row < cells and 0 <= column < cells:
            low, high = lowest[row, column], highest[row, column]
            is_bank = low < BANK_M and high - low < BANK_RELIEF_M
        if height[i] > STANDING_M and not is_bank:
            labels[i] = OUTSIDE
    return labels
